//! Reads a table from a columnar format (Arrow, Parquet) in batches of rows, and returns it row by row.

use std::iter::StepBy;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::slice::IterMut;

use super::table::Table;
use crate::MomentsError;

/// Consecutive rows of the selected columns, in the order of the file.
pub(super) trait Batch {
    /// Returns the number of rows.
    fn rows(&self) -> usize;

    /// Writes the values of a column, in the given range of rows, to `out`. Missing values become
    /// [`NULL`](super::table::NULL).
    ///
    /// # Errors
    ///
    /// A description of the column, if it isn't numeric.
    fn copy(&self, column: usize, rows: Range<usize>, out: StepBy<IterMut<'_, f64>>) -> Result<(), String>;
}

/// Iterator over a file's batches, in order. An error is a description of the problem in the file.
pub(super) type Rows = Box<dyn Iterator<Item = Result<Box<dyn Batch>, String>> + Send>;
/// Function that starts reading the columns with the given indices, which must be in ascending order.
pub(super) type Start = Box<dyn FnOnce(Vec<usize>) -> Result<Rows, String> + Send>;

/// A shard of a table that is read in batches.
pub(super) struct Batches {
    path: PathBuf,
    format: &'static str,
    names: Vec<String>,
    start: Option<Start>,
    rows: Option<Result<Rows, String>>,
    /// For each value of an output row, the index of its column in the batch.
    places: Vec<usize>,
    /// Number of rows still to be skipped, because the batches begin before the shard.
    skip: u64,
    before: u64,
    left: u64,
    /// Values of rows that have been read but not returned.
    pending: Vec<f64>,
}

impl Batches {
    /// Creates a table that consists of the range `rows` of a file's rows. Returns the table and the number of rows in
    /// the range. The first batch begins `skip` rows before the range.
    pub(super) fn new(
        path: &Path,
        format: &'static str,
        names: Vec<String>,
        start: Start,
        skip: u64,
        rows: Range<u64>,
    ) -> (Self, u64) {
        let (before, left) = (rows.start, rows.end - rows.start);
        let (places, pending) = (Vec::new(), Vec::new());
        let path = path.to_owned();
        (Self { path, format, names, start: Some(start), rows: None, places, skip, before, left, pending }, left)
    }

    /// Reads another batch. Returns false if there are no more batches.
    fn more(&mut self) -> Result<bool, MomentsError> {
        let failed = |found: &str| malformed(&self.path, self.format, found);
        let batch = match &mut self.rows {
            Some(Ok(rows)) => rows.next().transpose().map_err(|error| failed(&error))?,
            Some(Err(problem)) => return Err(failed(problem)),
            None => None,
        };
        let Some(batch) = batch else { return Ok(false) };
        let skipped = self.skip.min(batch.rows() as u64);
        self.skip -= skipped;
        let count = (batch.rows() as u64 - skipped).min(self.left) as usize;
        if count == 0 {
            return Ok(true);
        }
        let rows = skipped as usize..skipped as usize + count;
        let (start, width) = (self.pending.len(), self.places.len());
        self.pending.resize(start + count * width, 0.0);
        for (place, &column) in self.places.iter().enumerate() {
            let out = self.pending[start + place..].iter_mut().step_by(width);
            batch.copy(column, rows.clone(), out).map_err(|found| failed(&found))?;
        }
        self.left -= count as u64;
        Ok(true)
    }
}

impl Table for Batches {
    fn columns(&self) -> &[String] {
        &self.names
    }

    fn select(&mut self, columns: Vec<usize>) {
        // Batches have their columns in the order of the file, not in the order of the selection.
        let mut sorted = columns.clone();
        sorted.sort_unstable();
        self.places = columns.iter().filter_map(|column| sorted.iter().position(|found| found == column)).collect();
        self.rows = self.start.take().map(|start| start(sorted));
    }

    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError> {
        let width = self.places.len().max(1);
        while self.pending.len() < most * width && self.left > 0 {
            if !self.more()? {
                return Err(MomentsError::Malformed {
                    path: self.path.clone(),
                    format: self.format,
                    expected: format!("{} more {}", self.left, if self.left == 1 { "row" } else { "rows" }),
                    found: "the end of the table".to_owned(),
                });
            }
        }
        let count = self.pending.len().min(most * width);
        out.extend(self.pending.drain(..count));
        Ok(count / width)
    }

    fn number_of(&self, row: u64) -> u64 {
        self.before + row + 1
    }
}

/// Returns the error for a file that isn't a table of numbers.
pub(super) fn malformed(path: &Path, format: &'static str, found: &str) -> MomentsError {
    let (expected, found) = ("a table of numbers".to_owned(), found.to_owned());
    MomentsError::Malformed { path: path.to_owned(), format, expected, found }
}
