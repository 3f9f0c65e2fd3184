//! Arrays with one row per direction that are divided into chunks of rows, like the basis matrix. Each chunk is
//! contiguous and column-major.
//!
//! The targets of a fit are passed in this form, and the fit replaces them by its residual in place. A chunk of the
//! residual is then one slice that stays in the L1 cache while a chunk of the basis is processed. Disjoint runs of
//! chunks can be assigned to different threads.

use std::ops::Range;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use crate::residual::{ResidualNorms, rows_read};

/// An (n, c) array in chunks of rows: the targets of a fit, later its residual.
#[derive(Debug, Clone)]
pub struct ChunkedRows {
    values: Vec<f64>,
    rows: usize,
    channels: usize,
    chunk_rows: usize,
}

impl ChunkedRows {
    /// Creates an array (rows, channels) of zeros. `chunk_rows` must equal the number of rows per chunk of the fit's
    /// operator.
    pub fn zeros(rows: usize, channels: usize, chunk_rows: usize) -> Self {
        Self { values: vec![0.0; rows * channels], rows, channels, chunk_rows }
    }

    /// Copies an array (rows, channels) into chunks of `chunk_rows` rows.
    pub fn from_array(array: ArrayView2<'_, f64>, chunk_rows: usize) -> Self {
        let mut chunked = Self::zeros(array.nrows(), array.ncols(), chunk_rows);
        chunked.set_columns(0, array);
        chunked
    }

    /// Copies `columns` (rows, k) into the columns `first` to `first + k - 1`.
    ///
    /// # Panics
    ///
    /// If the numbers of rows differ or there aren't enough columns.
    pub fn set_columns(&mut self, first: usize, columns: ArrayView2<'_, f64>) {
        assert!(
            columns.nrows() == self.rows && first + columns.ncols() <= self.channels,
            "columns of shape {:?} don't fit at column {first} of an array of shape {:?}",
            columns.dim(),
            (self.rows, self.channels)
        );
        let chunk_rows = self.chunk_rows;
        for (chunk, rows) in self.chunks_mut().into_iter().zip(columns.axis_chunks_iter(ndarray::Axis(0), chunk_rows)) {
            let count = rows.nrows();
            for (column, source) in chunk[first * count..].chunks_exact_mut(count).zip(rows.columns()) {
                for (value, source) in column.iter_mut().zip(source) {
                    *value = *source;
                }
            }
        }
    }

    /// Returns the values as an array (rows, channels).
    pub fn to_array(&self) -> Array2<f64> {
        let mut array = Array2::zeros((self.rows, self.channels));
        for (chunk, mut rows) in array.axis_chunks_iter_mut(ndarray::Axis(0), self.chunk_rows).enumerate() {
            let count = rows.nrows();
            for (column, mut out) in self.chunk(chunk).chunks_exact(count).zip(rows.columns_mut()) {
                for (out, value) in out.iter_mut().zip(column) {
                    *out = *value;
                }
            }
        }
        array
    }

    /// Returns the values (rows, c) of chunk `chunk`, column-major.
    pub(crate) fn chunk(&self, chunk: usize) -> &[f64] {
        let start = chunk * self.chunk_rows * self.channels;
        &self.values[start..(start + self.chunk_rows * self.channels).min(self.values.len())]
    }

    /// Copies the values of an array with the same shape and chunks.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.values.copy_from_slice(&other.values);
    }

    /// Replaces each value by `f(column, value, other)`, where `other` is the corresponding value of an array with the
    /// same shape and chunks.
    pub(crate) fn combine(&mut self, other: &Self, f: impl Fn(usize, f64, f64) -> f64 + Sync) {
        let channels = self.channels.max(1);
        self.chunks_mut().into_par_iter().enumerate().for_each(|(chunk, values)| {
            let rows = (values.len() / channels).max(1);
            let columns = values.chunks_exact_mut(rows).zip(other.chunk(chunk).chunks_exact(rows));
            for (column, (values, others)) in columns.enumerate() {
                values.iter_mut().zip(others).for_each(|(value, other)| *value = f(column, *value, *other));
            }
        });
    }

    pub(crate) fn chunks_mut(&mut self) -> Vec<&mut [f64]> {
        // An array without columns also has chunks, which are empty.
        let count = self.rows.div_ceil(self.chunk_rows);
        let mut rest = &mut self.values[..];
        let mut chunks = Vec::with_capacity(count);
        for _ in 0..count {
            let len = (self.chunk_rows * self.channels).min(rest.len());
            let (chunk, tail) = std::mem::take(&mut rest).split_at_mut(len);
            chunks.push(chunk);
            rest = tail;
        }
        chunks
    }

    /// Returns the number of rows, n.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the number of columns, c.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Returns the row and column of the first NaN or infinite value in storage order; `None` if all values are finite.
    pub(crate) fn not_finite(&self) -> Option<(usize, usize)> {
        (0..self.rows.div_ceil(self.chunk_rows)).find_map(|chunk| {
            let values = self.chunk(chunk);
            let rows = values.len() / self.channels.max(1);
            let at = values.iter().position(|value| !value.is_finite())?;
            Some((chunk * self.chunk_rows + at % rows, at / rows))
        })
    }

    /// Computes the mean and the maximum of the rows' squared norms, over all rows that aren't marked in `unread`. Only
    /// the given columns of a row contribute to its norm.
    pub(crate) fn norms(&self, columns: &Range<usize>, unread: Option<&[bool]>) -> ResidualNorms {
        let (mut sum, mut max) = (0.0, 0.0f64);
        let mut norms = Vec::new();
        for chunk in 0..self.rows.div_ceil(self.chunk_rows) {
            let values = self.chunk(chunk);
            let rows = values.len() / self.channels;
            norms.clear();
            norms.resize(rows, 0.0);
            for column in columns.clone() {
                for (norm, value) in norms.iter_mut().zip(&values[column * rows..(column + 1) * rows]) {
                    *norm += value * value;
                }
            }
            if let Some(unread) = unread {
                let unread = &unread[chunk * self.chunk_rows..];
                norms.iter_mut().zip(unread).filter(|(_, unread)| **unread).for_each(|(norm, _)| *norm = 0.0);
            }
            sum += norms.iter().sum::<f64>();
            max = norms.iter().fold(max, |max, &norm| max.max(norm));
        }
        ResidualNorms { mean_square: sum / rows_read(self.rows, unread) as f64, max_square: max }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_set_combined_and_searched_where_they_are() {
        let array = Array2::from_shape_fn((21, 3), |(i, j)| (10 * i + j) as f64);
        let mut chunked = ChunkedRows::zeros(21, 4, 8);
        assert_eq!((chunked.rows(), chunked.channels()), (21, 4));
        chunked.set_columns(1, array.view());
        let mut wanted = Array2::zeros((21, 4));
        wanted.slice_mut(ndarray::s![.., 1..]).assign(&array);
        assert_eq!(chunked.to_array(), wanted);
        let mut other = chunked.clone();
        other.combine(&chunked, |column, value, other| column as f64 * value - 0.5 * other);
        assert_eq!(other.to_array(), Array2::from_shape_fn((21, 4), |(i, j)| (j as f64 - 0.5) * wanted[[i, j]]));
        other.copy_from(&chunked);
        assert_eq!(other.to_array(), wanted);
        assert_eq!(chunked.not_finite(), None);
        for place in [(0, 0), (7, 3), (8, 1), (19, 2), (20, 3)] {
            let mut broken = wanted.clone();
            broken[place] = f64::NAN;
            assert_eq!(ChunkedRows::from_array(broken.view(), 8).not_finite(), Some(place));
        }
        assert_eq!(ChunkedRows::zeros(21, 0, 8).not_finite(), None);
    }

    #[test]
    fn arrays_come_back_and_norms_are_those_of_the_rows() {
        for rows in [1, 7, 8, 9, 24, 25] {
            let array = Array2::from_shape_fn((rows, 5), |(i, j)| (i * 5 + j) as f64 - 17.0);
            let chunked = ChunkedRows::from_array(array.view(), 8);
            assert_eq!(chunked.to_array(), array);
            let squares: Vec<f64> = array.rows().into_iter().map(|r| r[1] * r[1] + r[2] * r[2]).collect();
            let ResidualNorms { mean_square: mean, max_square: max } = chunked.norms(&(1..3), None);
            assert!((mean - squares.iter().sum::<f64>() / rows as f64).abs() < 1e-12);
            assert_eq!(max, squares.iter().copied().fold(0.0, f64::max));
            let unread: Vec<bool> = (0..rows).map(|i| i % 3 == 1).collect();
            let expected = ResidualNorms::without(array.slice(ndarray::s![.., 1..3]), Some(&unread));
            let found = chunked.norms(&(1..3), Some(&unread));
            assert!((found.mean_square - expected.mean_square).abs() < 1e-12 * expected.mean_square);
            assert_eq!(found.max_square, expected.max_square);
        }
    }
}
