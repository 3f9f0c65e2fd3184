//! Estimates the 1-norm of the inverse of a symmetric matrix G, and thus the condition number of G, from a few solves
//! with its factor.
//!
//! The method is Hager's algorithm with Higham's safeguards (N. J. Higham, "FORTRAN codes for estimating the one-norm
//! of a real or complex matrix, with applications to condition estimation", ACM Trans. Math. Softw. 14, 1988, algorithm
//! 4.1). It computes a lower bound of ||G^-1||_1 that is rarely too small by more than a factor of 3. The algorithm
//! also needs products with the transpose of G^-1. Because G^-1 is symmetric, these are products with G^-1 itself.

/// Estimates the 1-norm of a symmetric operator (K, K). `apply` replaces a vector (K) by its product with the operator.
pub(crate) fn one_norm<E>(size: usize, apply: &mut dyn FnMut(&mut [f64]) -> Result<(), E>) -> Result<f64, E> {
    /// Maximum number of iterations according to Higham. More than 3 iterations are rarely needed.
    const MOST: usize = 5;
    let norm = |v: &[f64]| v.iter().map(|x| x.abs()).sum::<f64>();
    let signs = |v: &[f64]| v.iter().map(|&x| if x >= 0.0 { 1.0 } else { -1.0 }).collect::<Vec<f64>>();
    let largest = |v: &[f64]| {
        v.iter()
            .enumerate()
            .fold((0, 0.0), |most: (usize, f64), (i, x)| if x.abs() > most.1 { (i, x.abs()) } else { most })
    };
    let mut v = vec![1.0 / size as f64; size];
    apply(&mut v)?;
    let mut estimate = norm(&v);
    if size == 1 {
        return Ok(estimate);
    }
    let mut xi = signs(&v);
    let mut x = xi.clone();
    apply(&mut x)?;
    let (mut j, _) = largest(&x);
    for _ in 1..MOST {
        v.fill(0.0);
        v[j] = 1.0;
        apply(&mut v)?;
        let previous = estimate;
        estimate = norm(&v);
        let next = signs(&v);
        if next == xi || estimate <= previous {
            estimate = estimate.max(previous);
            break;
        }
        xi = next;
        x.copy_from_slice(&xi);
        apply(&mut x)?;
        let (at, most) = largest(&x);
        if x[j].abs() == most {
            break;
        }
        j = at;
    }
    let alternating = |i: usize| {
        let value = 1.0 + i as f64 / (size - 1) as f64;
        if i.is_multiple_of(2) { value } else { -value }
    };
    let mut x: Vec<f64> = (0..size).map(alternating).collect();
    apply(&mut x)?;
    Ok(estimate.max(2.0 * norm(&x) / (3.0 * size as f64)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a symmetric matrix (size, size) of pseudorandom numbers from -1 to 1, or from 0 to 1 if `positive` is
    /// set.
    fn matrix(size: usize, seed: usize, positive: bool) -> Vec<Vec<f64>> {
        let value = |i: usize, j: usize| {
            let place = ((seed * 64 + i.max(j)) * 64 + i.min(j) + 1) as f64;
            let unit = ((place * 12.9898).sin() * 43_758.545_3).rem_euclid(1.0);
            if positive { unit } else { 2.0 * unit - 1.0 }
        };
        (0..size).map(|i| (0..size).map(|j| value(i, j)).collect()).collect()
    }

    fn estimate(matrix: &[Vec<f64>]) -> f64 {
        let apply = &mut |v: &mut [f64]| {
            let product: Vec<f64> =
                matrix.iter().map(|row| row.iter().zip(&*v).map(|(a, x)| a * x).sum::<f64>()).collect();
            v.copy_from_slice(&product);
            Ok::<(), ()>(())
        };
        one_norm(matrix.len(), apply).unwrap()
    }

    fn norm(matrix: &[Vec<f64>]) -> f64 {
        matrix.iter().map(|row| row.iter().map(|a| a.abs()).sum::<f64>()).fold(0.0, f64::max)
    }

    /// The estimate never exceeds the norm, and equals it if no entry is negative.
    #[test]
    fn the_estimate_is_a_lower_bound_and_a_good_one() {
        for size in 1..30 {
            for seed in 0..10 {
                let positive = matrix(size, seed, true);
                let (found, exact) = (estimate(&positive), norm(&positive));
                assert!((found / exact - 1.0).abs() < 1e-12, "{size} {seed}: {found} {exact}");
                let mixed = matrix(size, seed, false);
                let (found, exact) = (estimate(&mixed), norm(&mixed));
                assert!(found <= exact * (1.0 + 1e-12) && found > exact / 3.0, "{size} {seed}: {found} {exact}");
            }
        }
    }

    /// Higham's safeguard: a vector of alternating signs detects large norms that the iteration misses.
    #[test]
    fn what_cancels_is_seen_by_alternating_signs() {
        // Each row sums to zero, so the product with a vector of ones is zero and contains no information on the norm.
        let size = 6;
        let cancelling: Vec<Vec<f64>> =
            (0..size).map(|i| (0..size).map(|j| if (i + j) % 2 == 0 { 1.0 } else { -1.0 }).collect()).collect();
        let found = estimate(&cancelling);
        assert!(found > norm(&cancelling) / 3.0 && found <= norm(&cancelling), "{found}");
        let failing = one_norm(3, &mut |_| Err("no"));
        assert_eq!(failing, Err("no"));
    }
}
