//! Infinitesimal rotations of coefficients: `L_k f = <e_k x u, grad f>`, the rate at which f(R_k(t) u) changes with t.
//!
//! Each degree is mapped to itself. For the canonical basis, m > 0, `p = sqrt((l-m+1)(l+m))`, `q = sqrt((l+m+1)(l-m))`,
//! with sqrt2 a_0 for the cosine and 0 for the sine of order 0,
//!
//! ```text
//! (L_x a)_m = -(p a_{-(m-1)} + q a_{-(m+1)})/2     (L_x a)_{-m} =  (p a_{m-1} + q a_{m+1})/2         (L_x a)_0 = -sqrt(l(l+1)/2) a_{-1}
//! (L_y a)_m = -(p a_{m-1} - q a_{m+1})/2           (L_y a)_{-m} = -(p a_{-(m-1)} - q a_{-(m+1)})/2   (L_y a)_0 =  sqrt(l(l+1)/2) a_1
//! (L_z a)_m =  m a_{-m}                            (L_z a)_{-m} = -m a_m                             (L_z a)_0 =  0
//! ```
//!
//! Rotated by a small turn w, `f(R^T u)`, a function changes by `-(w_x L_x + w_y L_y + w_z L_z) f`. The L_k are
//! antisymmetric. Cost: some 10 flops a coefficient.

/// Returns L_x f, L_y f and L_z f of three functions, each (K, 3).
pub(crate) fn generators(values: &[[f64; 3]]) -> [Vec<[f64; 3]>; 3] {
    let mut out = [(); 3].map(|()| vec![[0.0; 3]; values.len()]);
    let [x, y, z] = &mut out;
    let mut l = 1;
    while (l + 1) * (l + 1) <= values.len() {
        let centre = l * l + l;
        let cos = |m: usize| match m {
            0 => values[centre].map(|v| v * std::f64::consts::SQRT_2),
            m if m <= l => values[centre + m],
            _ => [0.0; 3],
        };
        let sin = |m: usize| if m == 0 || m > l { [0.0; 3] } else { values[centre - m] };
        let root = ((l * (l + 1)) as f64 / 2.0).sqrt();
        (x[centre], y[centre]) = (sin(1).map(|v| -root * v), cos(1).map(|v| root * v));
        for m in 1..=l {
            let p = (((l - m + 1) * (l + m)) as f64).sqrt() / 2.0;
            let q = (((l + m + 1) * (l - m)) as f64).sqrt() / 2.0;
            let (below, above) = ([cos(m - 1), sin(m - 1)], [cos(m + 1), sin(m + 1)]);
            for c in 0..3 {
                x[centre + m][c] = -(p * below[1][c] + q * above[1][c]);
                x[centre - m][c] = p * below[0][c] + q * above[0][c];
                y[centre + m][c] = q * above[0][c] - p * below[0][c];
                y[centre - m][c] = q * above[1][c] - p * below[1][c];
                z[centre + m][c] = m as f64 * values[centre - m][c];
                z[centre - m][c] = -(m as f64) * values[centre + m][c];
            }
        }
        l += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::half_turn::Workspace;
    use crate::rotate::Rotator;
    use crate::rotation::Rotation;

    #[test]
    fn they_are_the_derivatives_of_rotations() {
        let values: Vec<[f64; 3]> = (0..49).map(|k| [0, 1, 2].map(|c| ((k * 5 + c * 11) as f64 * 0.7).sin())).collect();
        let (rotator, mut workspace, step) = (Rotator::new(6), Workspace::default(), 1e-5);
        for (axis, generated) in generators(&values).iter().enumerate() {
            let mut turned = [vec![[0.0; 3]; 49], vec![[0.0; 3]; 49]];
            for (out, t) in turned.iter_mut().zip([-step, step]) {
                let w = std::array::from_fn(|k| if k == axis { t } else { 0.0 });
                rotator.rotate(&values, &Rotation::exponential(w), out, &mut workspace);
            }
            for (k, row) in generated.iter().enumerate() {
                for c in 0..3 {
                    let difference = (turned[0][k][c] - turned[1][k][c]) / (2.0 * step);
                    assert!((row[c] - difference).abs() < 1e-8, "{axis} {k} {c}: {} {difference}", row[c]);
                }
            }
        }
    }
}
