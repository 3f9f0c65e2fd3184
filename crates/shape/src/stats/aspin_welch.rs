//! Tests contrasts of any design for groups of observations with unequal variances: Aspin and Welch's v, and its
//! generalisation G to several contrasts.
//!
//! The statistics are from A. M. Winkler, G. R. Ridgway, M. A. Webster, S. M. Smith and T. E. Nichols, "Permutation
//! inference for the general linear model", NeuroImage 92 (2014), section 2.5. Variance group g has n_g observations
//! with the residuals `E_g`. X (n, p) is the design, R is its residual-forming matrix, B are the least-squares
//! coefficients, and C is the contrast, with q rows:
//!
//! ```text
//! w_g = sum of R_ii over g / |E_g|^2,   W = diag of w_g,
//! G   = (C B)^T (C (X^T W X)^-1 C^T)^-1 (C B) / (q Lambda),   Lambda = 1 + 2 (q - 1) b / (q (q + 2)),
//! b   = sum_g (1 - n_g w_g / tr W)^2 / sum of R_ii over g.
//! ```
//!
//! For a contrast of one row, G is the square of v, and v is Welch's t for two groups. For one variance group, G is F.
//!
//! Relabellings are compared by v or G. If groups share a coefficient, `(X^T W X)^-1` isn't the covariance of B but the
//! covariance of weighted estimates. Standard errors, margins and uncorrected p values are therefore based on the
//! covariance of `C B`, `V = sum_g s_g^2 U^T Q_g^T Q_g U`, with `s_g^2 = |E_g|^2 / sum of R_ii`. Q (n, p) is an
//! orthonormal basis of the design, Q_g has its rows for group g, and U is defined by `C B = U^T Q^T y` for values y.
//! With `V_g` the term of group g, `f_g` its sum of `R_ii`, `a_g = tr (V_g V^-1)^2` and `b_g = (tr V_g V^-1)^2`,
//!
//! ```text
//! (C B)^T V^-1 (C B) / (q k),   k = 1 + 2 / (q (q + 2)) sum_g (q a_g - b_g) / f_g
//! ```
//!
//! is approximately F with q and `q (q + 2) / sum_g (2 a_g + b_g) / f_g` degrees of freedom. For a one-way layout,
//! this is the test of B. L. Welch, "On the comparison of several mean values", Biometrika 38 (1951); for one variance
//! group, it is exactly F; for one row, it is the square of Aspin and Welch's t.
//!
//! # Relabellings
//!
//! For a relabelled study y, the statistics are computed from `Q_g^T y_g` and `|y_g|^2` for each of K variance groups
//! g. These are products of at most `K (p + 1)` rows of length n with arrays (n, V). At a vertex, the coefficients are
//! `a = sum_g Q_g^T y_g`, and `|E_g|^2 = |y_g|^2 - 2 a^T Q_g^T y_g + a^T Q_g^T Q_g a`. Then a matrix of order p is
//! factorised by Cholesky's method. Cost: `2 n V K (p + 1)` flops and about `V p^3` per relabelling. Memory: `16 n V`
//! bytes.

use ndarray::{Array2, ArrayView2, Axis, s};

use super::arrangements::{Relabelling, identity};
use super::design::{Contrast, Design};
use super::distributions::{p_of_f, p_of_t, quantile_of_t};
use super::linear::{Effect, Found, Small, Statistic, floors};
use super::projection::{Projection, contrast_in_basis};
use crate::ShapeError;
use crate::product::{COLUMNS, product};

/// Values prepared to compute the statistics of a study and of its relabellings.
pub(crate) struct AspinWelch {
    /// Variance group of each row of the design (n).
    of: Vec<usize>,
    /// Residuals of the reduced model (n, V); `squares` holds the squares of the residuals.
    residuals: Array2<f64>,
    squares: Array2<f64>,
    /// Threshold at each vertex (V): a sum of squared errors is treated as a rounding error if it is at most this
    /// value.
    floor: Vec<f64>,
    /// Orthonormal basis (n, p) of the design; `contrast` (p, q) is the contrast in this basis.
    basis: Array2<f64>,
    contrast: Array2<f64>,
    groups: Vec<VarianceGroup>,
    /// Pairs (group, column) for which the column of the basis isn't zero in the group.
    columns: Vec<(usize, usize)>,
}

struct VarianceGroup {
    size: f64,
    /// Degrees of freedom of the group's errors: the sum of `R_ii` over the group, with the residual-forming matrix R.
    freedom: f64,
    /// Gram matrix `Q_g^T Q_g` (p, p) of `Q_g`, the group's rows of the basis Q.
    gram: Array2<f64>,
    /// Matrix `U^T Q_g^T Q_g U` (q, q): the Gram matrix projected onto the contrast, with `U` the field `contrast`.
    tested: Array2<f64>,
}

/// Results at one vertex.
#[derive(Clone, Copy)]
struct AtVertex {
    /// The statistic G; NaN at a vertex without variance. For a contrast of one row, G has the sign of the estimate.
    signed: f64,
    /// Estimate of the first row of the contrast; `variance` is the variance of this estimate.
    estimate: f64,
    variance: f64,
    /// F statistic of the estimates, computed with their covariance V.
    wald: f64,
    /// Sum of squares of the errors.
    errors: f64,
    /// Denominator degrees of freedom of `wald`.
    freedom: f64,
}

impl AspinWelch {
    /// Prepares the computation for `values` (n, V), given the variance group of each of the n subjects.
    ///
    /// # Errors
    ///
    /// [`ShapeError::VarianceGroup`] if the design leaves no degrees of freedom for the errors of a group.
    pub(crate) fn new(
        values: ArrayView2<'_, f64>,
        design: &Design,
        contrast: &Contrast,
        model: &Projection,
        of: &[usize],
    ) -> Result<Self, ShapeError> {
        let n = values.nrows();
        let (basis, contrast) = contrast_in_basis(design, contrast);
        let count = of.iter().max().map_or(0, |last| last + 1);
        let mut groups = Vec::with_capacity(count);
        for number in 0..count {
            let members: Vec<usize> = (0..n).filter(|i| of[*i] == number).collect();
            let rows = basis.select(Axis(0), &members);
            let gram = product(rows.t(), rows.view());
            let freedom = members.len() as f64 - gram.diag().sum();
            if freedom < 1e-9 {
                return Err(ShapeError::VarianceGroup { group: number + 1, subjects: members.len() });
            }
            let tested = product(contrast.t(), product(gram.view(), contrast.view()).view());
            groups.push(VarianceGroup { size: members.len() as f64, freedom, gram, tested });
        }
        let pairs = (0..count).flat_map(|group| (0..basis.ncols()).map(move |column| (group, column)));
        let columns = pairs.filter(|(group, column)| groups[*group].gram[[*column, *column]] > 0.0).collect();
        let residuals = model.residual(values);
        let squares = residuals.mapv(|value| value * value);
        Ok(Self { of: of.to_vec(), residuals, squares, floor: floors(values), basis, contrast, groups, columns })
    }

    /// Returns the statistics and their p values at all vertices; NaN at vertices without variance.
    pub(crate) fn statistics(&self, confidence: f64) -> Found {
        let mut vertices: Vec<AtVertex> = Vec::with_capacity(self.floor.len());
        self.each(&[identity(self.of.len())], true, |_, _, found| vertices.extend_from_slice(found));
        let q = self.contrast.ncols() as f64;
        let least = vertices.iter().map(|vertex| vertex.freedom).fold(f64::INFINITY, f64::min);
        let column = |value: &dyn Fn(&AtVertex) -> f64| vertices.iter().map(value).collect::<Vec<f64>>();
        if self.contrast.ncols() > 1 {
            let p = column(&|vertex| p_of_f(vertex.wald, q, vertex.freedom));
            let kind = Statistic::F { between: q, within: least };
            return (kind, column(&|vertex| vertex.signed), p, None);
        }
        let v = |vertex: &AtVertex| vertex.signed.abs().sqrt().copysign(vertex.signed);
        let p = column(&|vertex| p_of_t(vertex.wald.sqrt(), vertex.freedom));
        let table = |value: &dyn Fn(&AtVertex) -> f64| {
            Array2::from_shape_vec((vertices.len(), 1), column(value)).unwrap_or_default()
        };
        let known = |vertex: &AtVertex| !vertex.signed.is_nan();
        let error = |vertex: &AtVertex| if known(vertex) { vertex.variance.sqrt() } else { 0.0 };
        let margin = |vertex: &AtVertex| match known(vertex) {
            true => quantile_of_t(confidence, vertex.freedom) * error(vertex),
            false => 0.0,
        };
        let freedom: f64 = self.groups.iter().map(|group| group.freedom).sum();
        let effect = Effect {
            estimate: table(&|vertex| vertex.estimate),
            standard_error: table(&error),
            margin: table(&margin),
            size: column(&|vertex| match known(vertex) {
                true => vertex.estimate / (vertex.errors / freedom).sqrt(),
                false => f64::NAN,
            }),
        };
        (Statistic::T { freedom: least }, column(&v), p, Some(effect))
    }

    /// Calls `use_it` for each relabelling and each range of vertices. The arguments are the index of the relabelling,
    /// the first vertex of the range, and the [signed statistics](AtVertex::signed) of the range, which are 0 at
    /// vertices without variance.
    pub(crate) fn evaluate(&self, relabellings: &[Relabelling], mut use_it: impl FnMut(usize, usize, &[f64])) {
        let mut signed = Vec::new();
        self.each(relabellings, false, |which, first, found| {
            signed.clear();
            signed.extend(found.iter().map(|at| if at.signed.is_nan() { 0.0 } else { at.signed }));
            use_it(which, first, &signed);
        });
    }

    fn each(&self, relabellings: &[Relabelling], detailed: bool, mut use_it: impl FnMut(usize, usize, &[AtVertex])) {
        let (n, each, count) = (self.of.len(), self.columns.len(), self.groups.len());
        let mut rows = Array2::zeros((relabellings.len() * each, n));
        let mut members = Array2::zeros((relabellings.len() * count, n));
        for (which, relabelling) in relabellings.iter().enumerate() {
            for (i, (from, sign)) in relabelling.iter().enumerate() {
                let (from, group) = (*from as usize, self.of[*from as usize]);
                members[[which * count + group, i]] = 1.0;
                for (row, (of, column)) in self.columns.iter().enumerate() {
                    if *of == group {
                        rows[[which * each + row, i]] = sign * self.basis[[from, *column]];
                    }
                }
            }
        }
        let vertices = self.floor.len();
        let mut work = Work::new(self);
        let mut found = Vec::with_capacity(COLUMNS);
        for first in (0..vertices).step_by(COLUMNS) {
            let end = vertices.min(first + COLUMNS);
            let sums = product(rows.view(), self.residuals.slice(s![.., first..end]));
            let squares = product(members.view(), self.squares.slice(s![.., first..end]));
            for which in 0..relabellings.len() {
                found.clear();
                for v in 0..end - first {
                    (0..each).for_each(|row| work.sums[row] = sums[[which * each + row, v]]);
                    (0..count).for_each(|group| work.squares[group] = squares[[which * count + group, v]]);
                    found.push(self.at(self.floor[first + v], &mut work, detailed));
                }
                use_it(which, first, &found);
            }
        }
    }

    /// Computes the statistic at a vertex from the sums in `work`. If `detailed` is set, also computes the variance of
    /// the estimate, F and its degrees of freedom.
    fn at(&self, floor: f64, work: &mut Work, detailed: bool) -> AtVertex {
        let (p, q) = self.contrast.dim();
        let Work { sums, squares, coefficients, weights, scatter, small, columns, estimate } = work;
        // A group's sum of squared errors is a difference of larger terms, so its rounding error is proportional to the
        // size of these terms.
        let rounding = 64.0 * self.of.len() as f64 * f64::EPSILON;
        let floor = floor.max(rounding * squares.iter().sum::<f64>() / squares.len() as f64);
        coefficients.fill(0.0);
        self.columns.iter().zip(sums.iter()).for_each(|((_, column), sum)| coefficients[*column] += sum);
        for (group, square) in self.groups.iter().zip(squares.iter_mut()) {
            for i in 0..p {
                for j in 0..p {
                    *square += coefficients[i] * coefficients[j] * group.gram[[i, j]];
                }
            }
        }
        for ((group, column), sum) in self.columns.iter().zip(sums.iter()) {
            squares[*group] -= 2.0 * coefficients[*column] * sum;
        }
        let errors: f64 = squares.iter().sum();
        for (k, estimate) in estimate.iter_mut().enumerate() {
            *estimate = (0..p).map(|i| self.contrast[[i, k]] * coefficients[i]).sum();
        }
        let none = AtVertex {
            signed: f64::NAN,
            estimate: estimate[0],
            variance: 0.0,
            wald: f64::NAN,
            errors: 0.0,
            freedom: f64::INFINITY,
        };
        if errors <= floor {
            return none;
        }
        for ((group, square), weight) in self.groups.iter().zip(squares.iter()).zip(weights.iter_mut()) {
            *weight = group.freedom / square.max(floor);
        }
        // The weight of a group without variance is limited, because the factorisation would fail otherwise.
        let least = weights.iter().copied().fold(f64::INFINITY, f64::min);
        weights.iter_mut().for_each(|weight| *weight = weight.min(1e10 * least));
        scatter.fill(|i, j| self.groups.iter().zip(weights.iter()).map(|(group, w)| w * group.gram[[i, j]]).sum());
        if !scatter.factorise(0.0) {
            return none;
        }
        for (k, column) in columns.iter_mut().enumerate() {
            column.iter_mut().enumerate().for_each(|(i, value)| *value = self.contrast[[i, k]]);
            scatter.whiten(column);
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let weighted = dot(&columns[0], &columns[0]);
        let (variance, wald, freedom) = match detailed {
            true => self.wald(squares, estimate),
            false => (0.0, f64::NAN, f64::INFINITY),
        };
        if q == 1 {
            let signed = (estimate[0] * estimate[0] / weighted).copysign(estimate[0]);
            return AtVertex { signed, estimate: estimate[0], variance, wald, errors, freedom };
        }
        small.fill(|i, j| dot(&columns[i], &columns[j]));
        if !small.factorise(0.0) {
            return none;
        }
        let trace: f64 = self.groups.iter().zip(weights.iter()).map(|(group, weight)| group.size * weight).sum();
        let off = |(group, weight): (&VarianceGroup, &f64)| (1.0 - group.size * weight / trace).powi(2) / group.freedom;
        let b: f64 = self.groups.iter().zip(weights.iter()).map(off).sum();
        let rows = q as f64;
        let lambda = 1.0 + 2.0 * (rows - 1.0) * b / (rows * (rows + 2.0));
        let signed = small.quotient(estimate) / (rows * lambda);
        AtVertex { signed, estimate: estimate[0], variance, wald, errors, freedom }
    }

    /// Returns the variance of the estimate of the contrast's first row, the F statistic of all rows of the contrast,
    /// and the degrees of freedom of F. `squares` is the sum of squared errors of each group.
    fn wald(&self, squares: &[f64], estimate: &[f64]) -> (f64, f64, f64) {
        let q = self.contrast.ncols();
        let variances: Vec<f64> =
            self.groups.iter().zip(squares).map(|(group, square)| square.max(0.0) / group.freedom).collect();
        let mut covariance = Small::zeros(q);
        let of_group = |(group, variance): (&VarianceGroup, &f64), i: usize, j: usize| variance * group.tested[[i, j]];
        let entry = |i, j| self.groups.iter().zip(&variances).map(|group| of_group(group, i, j)).sum::<f64>();
        covariance.fill(entry);
        let variance = entry(0, 0);
        if !covariance.factorise(0.0) {
            return (variance, f64::NAN, f64::INFINITY);
        }
        let rows = q as f64;
        let (mut excess, mut spread) = (0.0, 0.0);
        for group in self.groups.iter().zip(&variances) {
            let [a, b] = covariance.squared_traces(|i, j| of_group(group, i, j));
            excess += (rows * a - b) / group.0.freedom;
            spread += (2.0 * a + b) / group.0.freedom;
        }
        let scale = 1.0 + 2.0 * excess / (rows * (rows + 2.0));
        (variance, covariance.quotient(estimate) / (rows * scale), rows * (rows + 2.0) / spread)
    }
}

/// Workspace for one vertex.
struct Work {
    sums: Vec<f64>,
    squares: Vec<f64>,
    coefficients: Vec<f64>,
    weights: Vec<f64>,
    scatter: Small,
    small: Small,
    columns: Vec<Vec<f64>>,
    estimate: Vec<f64>,
}

impl Work {
    fn new(of: &AspinWelch) -> Self {
        let (p, q) = of.contrast.dim();
        Self {
            sums: vec![0.0; of.columns.len()],
            squares: vec![0.0; of.groups.len()],
            coefficients: vec![0.0; p],
            weights: vec![0.0; of.groups.len()],
            scatter: Small::zeros(p),
            small: Small::zeros(q),
            columns: vec![vec![0.0; p]; q],
            estimate: vec![0.0; q],
        }
    }
}
