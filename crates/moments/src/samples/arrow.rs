//! Reads Arrow IPC files, also called Feather.

use std::fs::File;
use std::iter::StepBy;
use std::ops::Range;
use std::path::Path;
use std::slice::IterMut;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrowPrimitiveType, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::reader::FileDecoder;
use arrow_schema::{DataType, Field};

use super::batches::{Batch, Batches, Rows, malformed};
use super::ipc;
use super::table::NULL;
use crate::MomentsError;
use crate::moments::Shard;

/// Opens an Arrow IPC file. Returns the shard's rows as a table, and the number of rows.
pub(super) fn open(path: &Path, file: File, shard: Shard) -> Result<(Batches, u64), MomentsError> {
    let format = "Arrow";
    let bytes = file.metadata().map_err(MomentsError::io(path, "read"))?.len();
    let found = ipc::contents(&file, bytes).map_err(|problem| malformed(path, format, &problem))?;
    let names = found.schema.fields().iter().map(|field| field.name().clone()).collect();
    let count = found.blocks.iter().map(|(_, rows)| *rows).fold(0, u64::saturating_add);
    let rows = shard.range(count);
    // Leave out the blocks whose rows all lie before the shard.
    let (mut blocks, mut skip) = (found.blocks.into_iter().peekable(), rows.start);
    while let Some((_, before)) = blocks.next_if(|(_, rows)| *rows <= skip) {
        skip -= before;
    }
    let start = move |columns: Vec<usize>| {
        for &column in &columns {
            let field = found.schema.field(column);
            if !field.data_type().is_numeric() {
                return Err(unusable(field));
            }
        }
        let decoder = FileDecoder::new(found.schema, found.version).with_projection(columns);
        let batches = blocks.map(move |(block, _)| {
            let bytes = Buffer::from(ipc::read_block(&file, &block)?);
            let batch = decoder.read_record_batch(&block, &bytes).map_err(|error| error.to_string())?;
            Ok(Box::new(batch.ok_or("a block without rows")?) as Box<dyn Batch>)
        });
        Ok(Box::new(batches) as Rows)
    };
    Ok(Batches::new(path, format, names, Box::new(start), skip, rows))
}

impl Batch for RecordBatch {
    fn rows(&self) -> usize {
        self.num_rows()
    }

    fn copy(&self, column: usize, rows: Range<usize>, out: StepBy<IterMut<'_, f64>>) -> Result<(), String> {
        let array = self.column(column).slice(rows.start, rows.len());
        numbers(&array, out).ok_or_else(|| unusable(self.schema_ref().field(column)))
    }
}

fn unusable(column: &Field) -> String {
    format!("a column of type {}: {}", column.data_type(), column.name())
}

/// Writes a column's values to `out` as f64. Returns `None` if the column's type isn't supported.
fn numbers(array: &dyn Array, out: StepBy<IterMut<'_, f64>>) -> Option<()> {
    fn each<T: ArrowPrimitiveType>(
        array: &dyn Array,
        out: StepBy<IterMut<'_, f64>>,
        of: impl Fn(T::Native) -> f64,
    ) -> Option<()> {
        for (out, value) in out.zip(array.as_primitive::<T>()) {
            *out = value.map_or(NULL, &of);
        }
        Some(())
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
        _ => None,
    }
}
