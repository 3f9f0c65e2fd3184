//! Parquet files of all the ways to store numbers in them.

use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, GzipLevel, ZstdLevel};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterVersion};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use spharm_moments::Shard;

use super::{ROWS, column, is_the_same, read, refused};

/// A column: its line of the schema, and its values. The line of a group stands at its first column; the line of the
/// others is empty.
pub(crate) type Column = (&'static str, Values);

pub(crate) enum Values {
    Text(Vec<String>),
    Double(Vec<f64>),
    Float(Vec<f32>),
    /// `None` is a missing value.
    Int32(Vec<Option<i32>>),
    Int64(Vec<i64>),
}

/// The samples of all formats, in columns of other kinds and in another order.
pub(crate) fn table() -> Vec<Column> {
    let single = |c: usize| Values::Float(column(c).iter().map(|x| *x as f32).collect());
    vec![
        ("optional binary name (STRING)", Values::Text((0..ROWS).map(|i| i.to_string()).collect())),
        ("required double f", Values::Double(column(3))),
        ("required float z", single(2)),
        ("required float x", single(0)),
        ("required float y", single(1)),
        ("optional int32 gaps", Values::Int32((0..ROWS as i32).map(|i| (i != 5).then_some(i)).collect())),
    ]
}

/// Writes columns to a Parquet file, in groups of `per_group` rows.
pub(crate) fn write(path: &Path, columns: &[Column], per_group: usize, properties: WriterProperties) {
    let ended = |line: &str| if line.is_empty() || line.ends_with('}') { line.to_owned() } else { format!("{line};") };
    let lines: String = columns.iter().map(|(line, _)| ended(line)).collect();
    let schema = Arc::new(parse_message_type(&format!("message samples {{ {lines} }}")).unwrap());
    let file = std::fs::File::create(path).unwrap();
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties)).unwrap();
    for first in (0..ROWS).step_by(per_group) {
        let rows = first..(first + per_group).min(ROWS);
        let mut group = writer.next_row_group().unwrap();
        for (line, values) in columns {
            let mut column = group.next_column().unwrap().unwrap();
            let optional = line.starts_with("optional");
            let all = vec![1; rows.len()];
            let levels = optional.then_some(&all[..]);
            match (column.untyped(), values) {
                (ColumnWriter::ByteArrayColumnWriter(writer), Values::Text(text)) => {
                    let text: Vec<ByteArray> = text[rows.clone()].iter().map(|text| text.as_str().into()).collect();
                    writer.write_batch(&text, levels, None)
                }
                (ColumnWriter::DoubleColumnWriter(writer), Values::Double(all)) => {
                    writer.write_batch(&all[rows.clone()], levels, None)
                }
                (ColumnWriter::FloatColumnWriter(writer), Values::Float(all)) => {
                    writer.write_batch(&all[rows.clone()], levels, None)
                }
                (ColumnWriter::Int32ColumnWriter(writer), Values::Int32(all)) => {
                    let stored: Vec<i32> = all[rows.clone()].iter().flatten().copied().collect();
                    let levels: Vec<i16> = all[rows.clone()].iter().map(|x| i16::from(x.is_some())).collect();
                    writer.write_batch(&stored, optional.then_some(&levels), None)
                }
                (ColumnWriter::Int64ColumnWriter(writer), Values::Int64(all)) => {
                    writer.write_batch(&all[rows.clone()], levels, None)
                }
                _ => panic!("{line} has values of another type"),
            }
            .unwrap();
            column.close().unwrap();
        }
        group.close().unwrap();
    }
    writer.close().unwrap();
}

/// Files of all writer versions, compressions and encodings are read, also those with many pages.
#[test]
fn pages_of_parquet() {
    let folder = tempfile::tempdir().unwrap();
    let mut columns = table();
    columns.push((
        "optional int32 thirds",
        Values::Int32((0..ROWS as i32).map(|i| (i % 3 > 0).then_some(i % 7)).collect()),
    ));
    let path = folder.path().join("a.parquet");
    for (version, dictionary) in [(WriterVersion::PARQUET_1_0, true), (WriterVersion::PARQUET_2_0, false)] {
        for compression in [
            Compression::UNCOMPRESSED,
            Compression::SNAPPY,
            Compression::LZ4_RAW,
            Compression::GZIP(GzipLevel::default()),
            Compression::ZSTD(ZstdLevel::default()),
        ] {
            let properties = WriterProperties::builder()
                .set_writer_version(version)
                .set_compression(compression)
                .set_dictionary_enabled(dictionary)
                .set_statistics_enabled(EnabledStatistics::Page)
                .set_write_page_header_statistics(true)
                .set_write_batch_size(64)
                .set_data_page_row_count_limit(128)
                .build();
            write(&path, &columns, ROWS, properties);
            is_the_same(folder.path(), &path);
        }
    }
}

/// A column's line of the schema, its values, and the numbers that they mean.
type Case<'a> = (&'static str, Values, &'a dyn Fn(usize) -> f64);

/// Integers of all widths are read as they are meant: unsigned ones aren't negative above the middle of their range.
#[test]
fn integers_of_parquet() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("integers.parquet");
    let place = |c: usize| Values::Double(column(c));
    let places =
        || vec![("required double x", place(0)), ("required double y", place(1)), ("required double z", place(2))];
    let small = |i: usize| (i % 251) as i32 - 125;
    let large = |i: usize| (i as i64 - 500) << 53;
    let cases: [Case<'_>; 7] = [
        ("required int32 f", Values::Int32((0..ROWS).map(|i| Some(small(i))).collect()), &|i| f64::from(small(i))),
        ("optional int32 f (INTEGER(8,true))", Values::Int32((0..ROWS).map(|i| Some(small(i))).collect()), &|i| {
            f64::from(small(i))
        }),
        ("required int32 f (INTEGER(32,false))", Values::Int32((0..ROWS).map(|i| Some(small(i))).collect()), &|i| {
            f64::from(small(i) as u32)
        }),
        ("required int32 f (UINT_32)", Values::Int32((0..ROWS).map(|i| Some(small(i))).collect()), &|i| {
            f64::from(small(i) as u32)
        }),
        ("required int64 f", Values::Int64((0..ROWS).map(large).collect()), &|i| large(i) as f64),
        ("optional int64 f", Values::Int64((0..ROWS).map(large).collect()), &|i| large(i) as f64),
        ("required int64 f (INTEGER(64,false))", Values::Int64((0..ROWS).map(large).collect()), &|i| {
            large(i) as u64 as f64
        }),
    ];
    for (line, values, expected) in cases {
        let mut columns = places();
        let doubles = Values::Double((0..ROWS).map(expected).collect());
        columns.push((line, values));
        write(&path, &columns, 170, WriterProperties::default());
        let found = read(&path, Shard::WHOLE).sums;
        let mut columns = places();
        columns.push(("required double f", doubles));
        write(&path, &columns, ROWS, WriterProperties::default());
        let expected = read(&path, Shard::WHOLE).sums;
        assert_eq!((found.moments, found.right_sides), (expected.moments, expected.right_sides), "{line}");
    }
}

/// Dates, times and decimals are stored as integers, but aren't numbers; lists and structures have no single value.
#[test]
fn other_columns_of_parquet_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.parquet");
    for (line, expected) in [
        ("required int32 f (DATE)", "a column of type INT32 (Date): f"),
        ("required int32 f (DECIMAL(9,2))", "a column of type INT32 (Decimal"),
        ("required int32 f (TIME_MILLIS)", "a column of type INT32 (TIME_MILLIS): f"),
    ] {
        let mut columns = table();
        columns[1] = (line, Values::Int32((0..ROWS as i32).map(Some).collect()));
        write(&path, &columns, ROWS, WriterProperties::default());
        refused(&path, &["other.parquet", expected]);
    }
    let mut columns = table();
    columns[1].0 = "required group f { required double f; required double g; }";
    columns.insert(2, ("", Values::Double(column(3))));
    write(&path, &columns, ROWS, WriterProperties::default());
    refused(&path, &["other.parquet", "a column of type group"]);
}
