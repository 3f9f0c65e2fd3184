//! Gram matrices `A^T W A`, for a basis A (n, K) and diagonal weights W, computed tile by tile from the moments of a
//! sampling or from other sources.
//!
//! Summing `A^T W A` over the basis takes `n K (K + 1)` flops. From the moments of the sampling,
//! `spharm_transform::MomentGram` computes the same matrix in a time that doesn't depend on n. The relative error is
//! then 1e-13, which is the accuracy of the finest transform. In a first pass of iterative residual fitting, this error
//! changes the mean squared residual by a relative amount of the order of 1e-10. At L = 100, the change is 5e-10 on a
//! cortex and 6e-10 on an irregular head. Further passes correct the change, because the residual is computed exactly
//! even if a step is slightly inaccurate.
//!
//! Moments give the Gram matrix of harmonics in double precision. A basis stored in f64 equals these harmonics up to
//! rounding. A basis stored in f32 differs from them by 6e-8, so that the solution of a block would be inexact.
//! Therefore moments are only used with f64 bases.

use std::ops::{Range, RangeInclusive};

use ndarray::Array2;
use spharm_harmonics::index::order_count;
use spharm_harmonics::{Directions, HarmonicsError, MAX_DEGREE};
use spharm_transform::{FINEST, MomentGram, Transform, TransformParams};

use crate::{MomentNormal, SolverError};

/// A symmetric matrix `G = A^T diag(w) A` (K, K) that is read tile by tile. Its columns are in the order `l^2 + l + m`.
pub trait GramMatrix: Sync {
    /// Returns the number of rows and columns, K.
    fn size(&self) -> usize;

    /// Returns the number of bytes of memory that the source of the matrix occupies.
    fn bytes(&self) -> usize;

    /// Writes `G[rows, columns]` to `out`, column-major with a stride of `leading` values between columns. Every entry
    /// is written, including the entries above the diagonal.
    ///
    /// # Errors
    ///
    /// If the basis can't be evaluated or read.
    ///
    /// # Panics
    ///
    /// If a range goes past K, if `leading` is less than the number of rows, or if `out` is too short.
    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError>;
}

impl GramMatrix for MomentGram {
    fn size(&self) -> usize {
        MomentGram::size(self)
    }

    fn bytes(&self) -> usize {
        MomentGram::bytes(self.max_degree())
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        match whole_degrees(&columns) {
            // A diagonal tile of complete degrees is computed by `block`, which makes use of the tile's symmetry.
            Some(degrees) if rows == columns && leading == rows.len() => {
                self.block(degrees, &mut out[..rows.len() * rows.len()])
            }
            _ => MomentGram::tile(self, rows, columns, out, leading),
        }
        Ok(())
    }
}

/// Returns the degrees that a range of columns covers, or `None` if the range contains only a part of a degree.
fn whole_degrees(columns: &Range<usize>) -> Option<RangeInclusive<usize>> {
    let (first, end) = (columns.start.isqrt(), columns.end.isqrt());
    (first * first == columns.start && end * end == columns.end && first < end).then(|| first..=end - 1)
}

/// A Gram matrix G with a penalty on its diagonal: `G + diag(penalty)`.
#[derive(Debug)]
pub struct Penalised<'a, S: ?Sized> {
    source: &'a S,
    penalty: Vec<f64>,
}

impl<'a, S: GramMatrix + ?Sized> Penalised<'a, S> {
    /// Creates the sum of `source` and a diagonal matrix with the diagonal `penalty` (K).
    ///
    /// # Panics
    ///
    /// If the penalty's length isn't the matrix's size.
    pub fn new(source: &'a S, penalty: Vec<f64>) -> Self {
        assert_eq!(penalty.len(), source.size(), "expected one penalty per diagonal element");
        Self { source, penalty }
    }
}

impl<S: GramMatrix + ?Sized> GramMatrix for Penalised<'_, S> {
    fn size(&self) -> usize {
        self.source.size()
    }

    fn bytes(&self) -> usize {
        self.source.bytes() + 8 * self.penalty.len()
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        self.source.tile(rows.clone(), columns.clone(), out, leading)?;
        for j in columns.start.max(rows.start)..columns.end.min(rows.end) {
            out[(j - columns.start) * leading + j - rows.start] += self.penalty[j];
        }
        Ok(())
    }
}

/// Returns the diagonal (K) of the smoothness penalty: lambda (l (l + 1))^2 for each column of degree l, up to degree
/// `max_degree`. The penalty is lambda times the squared norm of the Laplacian on the sphere.
pub fn smoothness_penalty(max_degree: usize, lambda: f64) -> Vec<f64> {
    let of = |l: usize| std::iter::repeat_n(lambda * ((l * (l + 1)) as f64).powi(2), order_count(l));
    (0..=max_degree).flat_map(of).collect()
}

/// Returns the diagonal (K) of a penalty with one value per degree: `p_l` for each order of degree l.
pub fn degree_penalty(by_degree: &[f64]) -> Vec<f64> {
    by_degree.iter().enumerate().flat_map(|(l, &p)| std::iter::repeat_n(p, order_count(l))).collect()
}

/// Computes the Gram matrix of the harmonics up to `max_degree` at weighted directions, from the moments of the
/// sampling. Without `weights` each direction has weight 1; otherwise there must be a weight for each direction.
///
/// # Errors
///
/// [`SolverError::Rows`] if the number of weights isn't the number of directions; the errors of the transforms, whose
/// degree is twice `max_degree`.
pub fn moment_gram(
    directions: &Directions,
    weights: Option<&[f64]>,
    max_degree: usize,
) -> Result<MomentGram, SolverError> {
    Ok(MomentGram::new(max_degree, &moments(directions, weights, max_degree, FINEST)?)?)
}

/// Computes the normal matrix of the harmonics up to `max_degree` at weighted directions, from the moments of the
/// sampling, to a relative accuracy of `accuracy`. Without `weights` each direction has weight 1; otherwise there must
/// be a weight for each direction.
///
/// # Errors
///
/// [`SolverError::Rows`] if the number of weights isn't the number of directions; the errors of the transforms, whose
/// degree is twice `max_degree`.
pub fn moment_normal(
    directions: &Directions,
    weights: Option<&[f64]>,
    max_degree: usize,
    accuracy: f64,
) -> Result<MomentNormal, SolverError> {
    MomentNormal::new(max_degree, moments(directions, weights, max_degree, accuracy)?)
}

fn moments(
    directions: &Directions,
    weights: Option<&[f64]>,
    max_degree: usize,
    accuracy: f64,
) -> Result<Vec<f64>, SolverError> {
    check_count(directions.len(), weights)?;
    let transform = Transform::new(directions, &to_twice(max_degree, accuracy))?;
    let none = Array2::zeros((directions.len(), 0));
    Ok(transform.weighted_sums(none.view(), weights)?.into_raw_vec_and_offset().0)
}

/// Returns an error if `weights` is given and doesn't have n entries.
pub(crate) fn check_count(n: usize, weights: Option<&[f64]>) -> Result<(), SolverError> {
    match weights {
        Some(weights) if weights.len() != n => {
            Err(SolverError::Rows { what: "the list of weights", expected: n, found: weights.len() })
        }
        _ => Ok(()),
    }
}

/// Returns the peak memory of [`moment_gram`] in bytes, including its result.
///
/// # Errors
///
/// The errors of the transforms, for example if their degree, twice `max_degree`, is above [`MAX_DEGREE`].
pub fn moment_gram_bytes(directions: usize, max_degree: usize) -> Result<usize, SolverError> {
    if 2 * max_degree > MAX_DEGREE {
        return Err(HarmonicsError::DegreeTooHigh { degree: max_degree, max: MAX_DEGREE / 2 }.into());
    }
    let transform = Transform::bytes(&to_twice(max_degree, FINEST), directions, 1)?;
    Ok(transform.max(MomentGram::bytes(max_degree)) + 8 * directions)
}

/// Returns the parameters of the transform for moments, whose degree is twice `max_degree`. A Gram matrix needs moments
/// of full accuracy, because its condition number is the square of the basis's condition number.
fn to_twice(max_degree: usize, accuracy: f64) -> TransformParams {
    TransformParams { max_degree: 2 * max_degree, accuracy, channels: 1 }
}
