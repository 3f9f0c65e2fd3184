//! Reads Parquet files with the typed column readers of the crate `parquet`. The crate's reader of Arrow batches isn't
//! used, because it contains the decoders of all Arrow types and would make the program a megabyte larger.

use std::fs::File;
use std::iter::StepBy;
use std::ops::Range;
use std::path::Path;
use std::slice::IterMut;

use ::parquet::basic::{ConvertedType, LogicalType, Type};
use ::parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use ::parquet::data_type::DataType;
use ::parquet::errors::ParquetError;
use ::parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use ::parquet::schema::types::{ColumnDescriptor, SchemaDescriptor};

use super::batches::{Batch, Batches, Rows, malformed};
use super::pages;
use super::table::NULL;
use crate::MomentsError;
use crate::moments::Shard;

/// Largest number of rows per batch.
const BATCH: usize = 1 << 16;

/// Opens a Parquet file. Returns the shard's rows as a table, and the number of rows.
pub(super) fn open(path: &Path, file: File, shard: Shard) -> Result<(Batches, u64), MomentsError> {
    let format = "Parquet";
    let again = file.try_clone().map_err(MomentsError::io(path, "open"))?;
    let reader = SerializedFileReader::new(file).map_err(|error| malformed(path, format, &error.to_string()))?;
    let metadata = reader.metadata().file_metadata();
    let rows = shard.range(u64::try_from(metadata.num_rows()).unwrap_or(0));
    let fields = metadata.schema_descr().root_schema().get_fields();
    let names = fields.iter().map(|field| field.name().to_owned()).collect();
    let first = rows.start;
    let start = move |columns: Vec<usize>| {
        pages::check(&again, reader.metadata(), &columns)?;
        Ok(Box::new(Groups::new(reader, &columns, first)?) as Rows)
    };
    Ok(Batches::new(path, format, names, Box::new(start), 0, rows))
}

/// Iterator over the batches of the selected columns, in all row groups.
struct Groups {
    reader: SerializedFileReader<File>,
    /// For each selected column, its index among the file's columns that store values (leaves).
    leaves: Vec<usize>,
    columns: Vec<Column>,
    /// Index of the next row group.
    next: usize,
    /// Number of rows of the current row group that haven't been read.
    left: usize,
    /// Number of rows to skip before the first batch.
    skip: u64,
}

impl Groups {
    fn new(reader: SerializedFileReader<File>, columns: &[usize], skip: u64) -> Result<Self, String> {
        let schema = reader.metadata().file_metadata().schema_descr();
        let leaves = columns.iter().map(|&column| leaf(schema, column)).collect::<Result<_, _>>()?;
        Ok(Self { reader, leaves, columns: Vec::new(), next: 0, left: 0, skip })
    }

    /// Opens the next row group that contains rows to be read. Returns false at the end of the file.
    fn open(&mut self) -> Result<bool, String> {
        while self.left == 0 {
            let Some(group) = self.reader.metadata().row_groups().get(self.next) else { return Ok(false) };
            let rows = u64::try_from(group.num_rows()).map_err(|_| "a row group with a negative number of rows")?;
            let skipped = rows.min(self.skip);
            self.skip -= skipped;
            self.left =
                usize::try_from(rows - skipped).map_err(|_| format!("a row group of {rows} rows, too many to read"))?;
            if self.left > 0 {
                let group = self.reader.get_row_group(self.next).map_err(text)?;
                let open = |&leaf: &usize| Column::open(&*group, leaf, skipped as usize);
                self.columns = self.leaves.iter().map(open).collect::<Result<_, _>>().map_err(text)?;
            }
            self.next += 1;
        }
        Ok(true)
    }

    fn batch(&mut self) -> Result<Option<Box<dyn Batch>>, String> {
        if !self.open()? {
            return Ok(None);
        }
        let count = self.left.min(BATCH);
        self.left -= count;
        let columns = self.columns.iter_mut().map(|column| column.read(count)).collect::<Result<_, _>>()?;
        Ok(Some(Box::new(Values { rows: count, columns })))
    }
}

impl Iterator for Groups {
    type Item = Result<Box<dyn Batch>, String>;

    fn next(&mut self) -> Option<Self::Item> {
        self.batch().transpose()
    }
}

/// The values of a batch, one vector per column.
struct Values {
    rows: usize,
    columns: Vec<Vec<f64>>,
}

impl Batch for Values {
    fn rows(&self) -> usize {
        self.rows
    }

    fn copy(&self, column: usize, rows: Range<usize>, out: StepBy<IterMut<'_, f64>>) -> Result<(), String> {
        for (out, &value) in out.zip(&self.columns[column][rows]) {
            *out = value;
        }
        Ok(())
    }
}

/// Returns the index of a column among the file's columns that store values (leaves).
fn leaf(schema: &SchemaDescriptor, column: usize) -> Result<usize, String> {
    let found = (0..schema.num_columns()).find(|&leaf| schema.get_column_root_idx(leaf) == column);
    let leaf = found.ok_or("a column without values")?;
    let descriptor = schema.column(leaf);
    // Columns of lists and structures are nested: they have several values, or several kinds of values, per row.
    let flat = schema.get_column_root(leaf).is_primitive() && descriptor.max_rep_level() == 0;
    if flat && is_number(&descriptor) { Ok(leaf) } else { Err(unusable(schema, leaf)) }
}

fn unusable(schema: &SchemaDescriptor, leaf: usize) -> String {
    format!("a column of type {}: {}", kind(schema, leaf), schema.get_column_root(leaf).name())
}

/// Returns whether a column stores numbers. Dates, times and decimals are not treated as numbers, even if they are
/// stored as integers.
fn is_number(column: &ColumnDescriptor) -> bool {
    match column.physical_type() {
        Type::FLOAT | Type::DOUBLE => true,
        Type::INT32 | Type::INT64 => sign(column).is_some(),
        _ => false,
    }
}

#[derive(PartialEq)]
enum Sign {
    Signed,
    Unsigned,
}

/// Returns whether the integers in a column are signed; `None` if they represent something other than numbers. The type
/// is stated as a logical type or, in older files, as a converted type.
fn sign(column: &ColumnDescriptor) -> Option<Sign> {
    use ConvertedType::{INT_8, INT_16, INT_32, INT_64, NONE, UINT_8, UINT_16, UINT_32, UINT_64};
    match (column.logical_type_ref(), column.converted_type()) {
        (Some(LogicalType::Integer(integer)), _) if integer.is_signed => Some(Sign::Signed),
        (Some(LogicalType::Integer(_)), _) => Some(Sign::Unsigned),
        (Some(_), _) => None,
        (None, NONE | INT_8 | INT_16 | INT_32 | INT_64) => Some(Sign::Signed),
        (None, UINT_8 | UINT_16 | UINT_32 | UINT_64) => Some(Sign::Unsigned),
        (None, _) => None,
    }
}

/// Returns the name of a column's type as in the format's specification, such as `BYTE_ARRAY (String)`.
fn kind(schema: &SchemaDescriptor, leaf: usize) -> String {
    let column = schema.column(leaf);
    if !schema.get_column_root(leaf).is_primitive() {
        return "group".to_owned();
    }
    let physical =
        if column.max_rep_level() > 0 { "repeated " } else { "" }.to_owned() + &column.physical_type().to_string();
    match column.logical_type_ref() {
        // The debug format is the type's name, followed by its parameters.
        Some(logical) => {
            let logical = format!("{logical:?}");
            format!("{physical} ({})", logical.split('(').next().unwrap_or_default())
        }
        None if column.converted_type() == ConvertedType::NONE => physical,
        None => format!("{physical} ({})", column.converted_type()),
    }
}

/// A column of numbers within a row group.
struct Column {
    reader: ColumnReader,
    unsigned: bool,
    /// Whether values may be missing.
    optional: bool,
}

impl Column {
    /// Opens a column, and skips the first `skip` rows of its row group.
    fn open(group: &dyn RowGroupReader, leaf: usize, skip: usize) -> Result<Self, ParquetError> {
        let descriptor = group.metadata().schema_descr().column(leaf);
        let mut reader = group.get_column_reader(leaf)?;
        match &mut reader {
            ColumnReader::Int32ColumnReader(reader) => reader.skip_records(skip)?,
            ColumnReader::Int64ColumnReader(reader) => reader.skip_records(skip)?,
            ColumnReader::FloatColumnReader(reader) => reader.skip_records(skip)?,
            ColumnReader::DoubleColumnReader(reader) => reader.skip_records(skip)?,
            _ => 0,
        };
        let (unsigned, optional) = (sign(&descriptor) == Some(Sign::Unsigned), descriptor.max_def_level() > 0);
        Ok(Self { reader, unsigned, optional })
    }

    /// Reads the next `count` rows. Missing values become [`NULL`].
    fn read(&mut self, count: usize) -> Result<Vec<f64>, String> {
        let (optional, unsigned) = (self.optional, self.unsigned);
        match &mut self.reader {
            ColumnReader::Int32ColumnReader(reader) if unsigned => {
                values(reader, count, optional, |x| f64::from(x as u32))
            }
            ColumnReader::Int32ColumnReader(reader) => values(reader, count, optional, f64::from),
            ColumnReader::Int64ColumnReader(reader) if unsigned => values(reader, count, optional, |x| x as u64 as f64),
            ColumnReader::Int64ColumnReader(reader) => values(reader, count, optional, |x| x as f64),
            ColumnReader::FloatColumnReader(reader) => values(reader, count, optional, f64::from),
            ColumnReader::DoubleColumnReader(reader) => values(reader, count, optional, |x| x),
            _ => Err("a column that isn't numeric".to_owned()),
        }
    }
}

/// Reads the next `count` rows of a column.
fn values<T: DataType>(
    reader: &mut ColumnReaderImpl<T>,
    count: usize,
    optional: bool,
    of: impl Fn(T::T) -> f64,
) -> Result<Vec<f64>, String> {
    let (mut found, mut levels) = (Vec::new(), Vec::new());
    let definition = optional.then_some(&mut levels);
    let (rows, _, _) = reader.read_records(count, definition, None, &mut found).map_err(text)?;
    if rows != count {
        return Err(format!("a column that ends {} rows early", count - rows));
    }
    let mut found = found.into_iter().map(of);
    // The definition level is 1 for a stored value, and 0 for a missing value, which isn't stored.
    let next = |level| if level == 0 { Some(NULL) } else { found.next() };
    let all: Vec<f64> = if optional { levels.into_iter().map_while(next).collect() } else { found.collect() };
    if all.len() == count { Ok(all) } else { Err(format!("{} values in {count} rows of a column", all.len())) }
}

fn text(error: ParquetError) -> String {
    error.to_string()
}
