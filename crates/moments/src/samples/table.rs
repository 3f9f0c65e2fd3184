//! Defines the interface that tables of all formats share.

use crate::MomentsError;

/// Value that represents a null: a cell that the file format marks as missing. It is a NaN with a bit pattern that no
/// other source of NaN produces.
pub(crate) const NULL: f64 = f64::from_bits(0x7ff8_6e75_6c6c_0000);

/// A table whose rows are read in order.
pub(crate) trait Table: Send {
    /// Returns the names of the columns. Columns without names are named by their indices from 0.
    fn columns(&self) -> &[String];

    /// Selects the columns to read, by their indices from 0.
    fn select(&mut self, columns: Vec<usize>);

    /// Appends the selected columns of at most `most` rows to `out`, row by row. Returns the number of rows appended,
    /// which is 0 at the end.
    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError>;

    /// Returns the number of a row within the whole table, counted from 1. `row` is its index within the shard, counted
    /// from 0.
    fn number_of(&self, row: u64) -> u64;
}
