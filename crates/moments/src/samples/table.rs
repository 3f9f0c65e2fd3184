//! The interface of tables in all formats.

use crate::MomentsError;

/// A table that is read sequentially, from its first row to its last.
pub(crate) trait Table: Send {
    /// Returns the names of the columns; their indices from 0 if they have none.
    fn columns(&self) -> &[String];

    /// Selects the columns to read, by their indices.
    fn select(&mut self, columns: Vec<usize>);

    /// Appends at most `most` rows, (rows, selected columns) row-major, and returns their number; 0 at the end.
    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError>;

    /// Returns the number, from 1 and in the entire table, of a row counted from 0 in the shard.
    fn number_of(&self, row: u64) -> u64;
}
