//! Reads tables stored by columns: Parquet files and Arrow IPC files. Only numeric columns can be read; missing values
//! become NaN.

use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrowPrimitiveType, RecordBatch};
use arrow_ipc::reader::FileReader;
use arrow_schema::{ArrowError, DataType};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::table::Table;
use super::{ipc, pages};
use crate::MomentsError;
use crate::moments::Shard;

/// Number of rows per batch when reading Parquet.
const BATCH: usize = 1 << 16;

type Rows = Box<dyn Iterator<Item = Result<RecordBatch, ArrowError>> + Send>;
/// Function that starts reading the columns with the given indices, in ascending order.
type Start = Box<dyn FnOnce(Vec<usize>) -> Result<Rows, String> + Send>;

/// A shard of a table stored by columns.
pub(super) struct Batches {
    path: PathBuf,
    format: &'static str,
    names: Vec<String>,
    start: Option<Start>,
    rows: Option<Result<Rows, String>>,
    /// For each value of an output row, the index of the batch's column from which it is read.
    places: Vec<usize>,
    /// Number of rows to skip, because the batches contain rows before the shard.
    skip: u64,
    before: u64,
    left: u64,
    /// Values of rows that have been read but not returned.
    pending: Vec<f64>,
}

/// Opens a Parquet file. Returns the shard's rows as a table, and their number.
pub(super) fn open_parquet(path: &Path, file: File, shard: Shard) -> Result<(Batches, u64), MomentsError> {
    let format = "Parquet";
    let again = file.try_clone().map_err(MomentsError::io(path, "open"))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| malformed(path, format, &error))?;
    let count = u64::try_from(builder.metadata().file_metadata().num_rows()).unwrap_or(0);
    let rows = shard.range(count);
    let (first, many) = (rows.start as usize, (rows.end - rows.start) as usize);
    let names = builder.schema().fields().iter().map(|field| field.name().clone()).collect();
    let start = move |columns: Vec<usize>| {
        pages::check(&again, builder.metadata(), &columns)?;
        let mask = ProjectionMask::roots(builder.parquet_schema(), columns);
        let builder = builder.with_projection(mask).with_batch_size(BATCH).with_offset(first).with_limit(many);
        let reader = builder.build().map_err(|error| error.to_string())?;
        Ok(Box::new(reader) as Rows)
    };
    Ok(Batches::new(path, format, names, Box::new(start), 0, rows))
}

/// Opens an Arrow IPC file. Returns the shard's rows as a table, and their number.
pub(super) fn open_ipc(path: &Path, file: File, shard: Shard) -> Result<(Batches, u64), MomentsError> {
    let format = "Arrow";
    let failed = |error: ArrowError| malformed(path, format, &error);
    let again = file.try_clone().map_err(MomentsError::io(path, "open"))?;
    let bytes = file.metadata().map_err(MomentsError::io(path, "read"))?.len();
    ipc::check(&file, bytes).map_err(|problem| malformed(path, format, &problem))?;
    let reader = FileReader::try_new_buffered(file, None).map_err(failed)?;
    let names = reader.schema().fields().iter().map(|field| field.name().clone()).collect();
    // Count the rows by reading batches without any columns: such batches still have a number of rows.
    let counts = FileReader::try_new_buffered(again, Some(Vec::new())).map_err(failed)?;
    let count = counts.map(|batch| batch.map(|batch| batch.num_rows() as u64)).sum::<Result<u64, _>>();
    let rows = shard.range(count.map_err(failed)?);
    let again = path.to_owned();
    let start = move |columns: Vec<usize>| {
        let file = File::open(again).map_err(|error| error.to_string())?;
        let reader = FileReader::try_new_buffered(file, Some(columns)).map_err(|error| error.to_string())?;
        Ok(Box::new(reader) as Rows)
    };
    let skip = rows.start;
    Ok(Batches::new(path, format, names, Box::new(start), skip, rows))
}

fn malformed(path: &Path, format: &'static str, found: &dyn std::fmt::Display) -> MomentsError {
    let expected = "a table of numbers".to_owned();
    MomentsError::Malformed { path: path.to_owned(), format, expected, found: found.to_string() }
}

impl Batches {
    fn new(
        path: &Path,
        format: &'static str,
        names: Vec<String>,
        start: Start,
        skip: u64,
        rows: std::ops::Range<u64>,
    ) -> (Self, u64) {
        let (before, left) = (rows.start, rows.end - rows.start);
        let (places, pending) = (Vec::new(), Vec::new());
        let path = path.to_owned();
        (Self { path, format, names, start: Some(start), rows: None, places, skip, before, left, pending }, left)
    }

    /// Reads another batch. Returns false at the end.
    fn more(&mut self) -> Result<bool, MomentsError> {
        let failed = |found: &dyn std::fmt::Display| malformed(&self.path, self.format, found);
        let batch = match &mut self.rows {
            Some(Ok(rows)) => rows.next().transpose().map_err(|error| failed(&error))?,
            Some(Err(problem)) => return Err(failed(problem)),
            None => None,
        };
        let Some(batch) = batch else { return Ok(false) };
        let skipped = self.skip.min(batch.num_rows() as u64);
        self.skip -= skipped;
        let count = (batch.num_rows() as u64 - skipped).min(self.left) as usize;
        if count == 0 {
            return Ok(true);
        }
        let batch = batch.slice(skipped as usize, count);
        let (start, width) = (self.pending.len(), self.places.len());
        self.pending.resize(start + count * width, 0.0);
        for (place, &column) in self.places.iter().enumerate() {
            let out = self.pending[start + place..].iter_mut().step_by(width);
            let array = batch.column(column);
            if !numbers(array, out) {
                return Err(failed(&format_args!("a column of type {}", array.data_type())));
            }
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

/// Writes a column's values to `out` as f64. Returns false if the column isn't numeric.
fn numbers<'a>(array: &dyn Array, out: impl Iterator<Item = &'a mut f64>) -> bool {
    fn each<'a, T: ArrowPrimitiveType>(
        array: &dyn Array,
        out: impl Iterator<Item = &'a mut f64>,
        of: impl Fn(T::Native) -> f64,
    ) -> bool {
        for (out, value) in out.zip(array.as_primitive::<T>()) {
            *out = value.map_or(f64::NAN, &of);
        }
        true
    }
    match array.data_type() {
        DataType::Float64 => each::<Float64Type>(array, out, |x| x),
        DataType::Float32 => each::<Float32Type>(array, out, f64::from),
        DataType::Int8 => each::<Int8Type>(array, out, f64::from),
        DataType::Int16 => each::<Int16Type>(array, out, f64::from),
        DataType::Int32 => each::<Int32Type>(array, out, f64::from),
        DataType::Int64 => each::<Int64Type>(array, out, |x| x as f64),
        DataType::UInt8 => each::<UInt8Type>(array, out, f64::from),
        DataType::UInt16 => each::<UInt16Type>(array, out, f64::from),
        DataType::UInt32 => each::<UInt32Type>(array, out, f64::from),
        DataType::UInt64 => each::<UInt64Type>(array, out, |x| x as f64),
        _ => false,
    }
}
