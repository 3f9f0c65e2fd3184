//! What tables of all formats have in common.

use crate::MomentsError;

/// A table that is read from its first row to its last.
pub(crate) trait Table: Send {
    /// The names of its columns; their numbers from 0 where they have none.
    fn columns(&self) -> &[String];

    /// Chooses the columns to read, by their numbers.
    fn select(&mut self, columns: Vec<usize>);

    /// Appends at most `most` rows, (rows, selected columns) row-major, and returns how many; none at the end.
    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError>;

    /// The number, from 1 and of the whole table, of a row counted from 0 in the shard.
    fn number_of(&self, row: u64) -> u64;
}
