//! Applies the half turn J about (y + z)/sqrt2 to the coefficients of one degree. Any rotation is a product of two half
//! turns J and three rotations about z.
//!
//! The method is from D. Pinchon and P. E. Hoggan, "Rotation matrices for real spherical harmonics: general rotations
//! of atomic orbitals in space-fixed axes", J. Phys. A 40 (2007): a rotation is `D = Z(al) J Z(be) J Z(ga)`, where
//! `al`, `be` and `ga` are the Euler angles, Z(t) is the rotation about z by t, and J is real, symmetric and its own
//! inverse. J is computed from [`Delta`](crate::quarter), a quarter of Wigner's matrix d^l(pi/2). With c_i = sqrt2
//! except c_0 = 1, `s_i = (-1)^floor(i/2)`, and `w_{ik} = s_i s_k c_i c_k Delta_{ik}`, with another factor -1 in w_{ik}
//! if i and k are both odd, J maps the coefficients of degree l as follows:
//!
//! ```text
//! i + l even: cos'_i = sum over k with i + k even of w_{ik} cos_k,   sin'_i = - sum over i + k odd of w_{ik} cos_k
//! i + l odd:  sin'_i = sum over k with i + k even of w_{ik} sin_k,   cos'_i =   sum over i + k odd of w_{ik} sin_k
//! ```
//!
//! cos_k and sin_k are the coefficients of cos(k phi) and sin(k phi), and cos'_i and sin'_i are the coefficients after
//! J. By these formulas, each row i reads either cosines or sines. A batch of W rows of the same parity is computed at
//! once, with one row per SIMD lane. The values of a row are used immediately and never stored. Cost:
//! `(l+1)^2 (3 + 2c)` flops for c columns, not counting rows that are so small that they are treated as zero, and O(l)
//! memory. The quarter's symmetry could save half of the recurrence, but the sums would then have to be loaded and
//! stored every few products.

use crate::quarter::{Quarter, rows, steps};
use crate::row_sums::{WIDTH, row_sums};

/// Coefficients of one degree, sorted by order, and buffers for the half turn J.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    /// Coefficients (l + 1, columns) of cos(k phi).
    pub(crate) cos: Vec<f64>,
    /// Coefficients (l + 1, columns) of sin(k phi); row 0 is zero.
    pub(crate) sin: Vec<f64>,
    /// For each parity of i, the coefficients (steps, columns) that are multiplied with the rows i of the quarter. The
    /// orders k are sorted by ascending t = l - k. The coefficients are padded with zeros.
    inputs: [Vec<f64>; 2],
    /// The sums over k in the module's formulas, as arrays (columns, rows): one for each parity of the row index i and
    /// each parity of t = l - k.
    sums: [[Vec<f64>; 2]; 2],
}

impl Workspace {
    /// Resizes the workspace for a degree.
    pub(crate) fn resize(&mut self, degree: usize, columns: usize) {
        for values in [&mut self.cos, &mut self.sin] {
            values.clear();
            values.resize((degree + 1) * columns, 0.0);
        }
        for parity in 0..2 {
            self.inputs[parity].clear();
            self.inputs[parity].resize(steps(degree) * columns, 0.0);
            for sums in &mut self.sums[parity] {
                sums.clear();
                sums.resize(rows(degree, parity, WIDTH) * columns, 0.0);
            }
        }
    }

    /// Applies the half turn J to `cos` and `sin`, which have one to three columns.
    pub(crate) fn half_turn(&mut self, quarter: &Quarter, columns: usize) {
        let l = quarter.degree;
        for k in 0..=l {
            let factor = scale(k);
            for c in 0..columns {
                let (from, to) = (k * columns + c, (l - k) * columns + c);
                self.inputs[l % 2][to] = factor * self.cos[from];
                self.inputs[1 - l % 2][to] = factor * self.sin[from];
            }
        }
        for (parity, (inputs, sums)) in self.inputs.iter().zip(&mut self.sums).enumerate() {
            row_sums(quarter, parity, columns, inputs, sums);
        }
        for i in 0..=l {
            let (p, count) = (i % 2, rows(l, i % 2, WIDTH));
            // The sums over even t = l - k are the sums over k with the parity of l.
            let reads_cos = p == l % 2;
            let [same, other] = if reads_cos { [0, 1] } else { [1, 0] };
            let same_sign = if p == 1 { -scale(i) } else { scale(i) };
            for c in 0..columns {
                let at = c * count + i / 2;
                let (same, other) = (same_sign * self.sums[p][same][at], scale(i) * self.sums[p][other][at]);
                let (cos, sin) = if reads_cos { (same, -other) } else { (other, same) };
                self.cos[i * columns + c] = cos;
                self.sin[i * columns + c] = if i == 0 { 0.0 } else { sin };
            }
        }
    }
}

/// Returns the factor `s_i c_i` of the elements `w_{ik}`, both defined at the top of this file.
fn scale(i: usize) -> f64 {
    let c = if i == 0 { 1.0 } else { std::f64::consts::SQRT_2 };
    if i % 4 < 2 { c } else { -c }
}
