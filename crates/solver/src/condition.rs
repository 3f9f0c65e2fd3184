//! An estimate of the condition of a matrix G from a few solves with its factor.
//!
//! N. J. Higham, "FORTRAN codes for estimating the one-norm of a real or complex matrix, with applications to condition
//! estimation", ACM Trans. Math. Softw. 14, 1988, algorithm 4.1 (Hager's, with his safeguards): a lower bound of
//! ||G^-1||_1 that is rarely off by more than a factor of 3. G^-1 is symmetric, which spares its transpose.

/// Estimate of the 1-norm of a symmetric operator (K, K) that `apply` applies in place to vectors, (K).
pub(crate) fn one_norm<E>(size: usize, apply: &mut dyn FnMut(&mut [f64]) -> Result<(), E>) -> Result<f64, E> {
    /// Higham's bound; more than 3 are hardly ever needed.
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
