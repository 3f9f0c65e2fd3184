//! Reads NumPy arrays (`.npy`) with one row per sample. The columns of a plain array are named by their indices from 0;
//! the columns of a structured array have the names of its fields.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use spharm_surface::io::Scalar;
use spharm_surface::npy;

use super::records::{Field, Kind, Records, Stream};
use crate::MomentsError;
use crate::moments::Shard;

pub(super) use spharm_surface::npy::MAGIC;
const FORMAT: &str = "NumPy array";
/// Size in bytes of each stream's read buffer. Arrays in Fortran order are read through one stream per column.
const BUFFER: usize = 1 << 18;

/// Largest accepted number of columns.
const MOST_COLUMNS: usize = 1 << 16;
/// Largest accepted number of bytes per row. The buffer for decoding holds at least one complete row.
const LONGEST_ROW: usize = 1 << 20;

/// The header of an array that represents a table of samples.
pub(super) struct Header {
    /// Offset of the values in bytes: the length of the magic number, version and header.
    pub(super) length: u64,
    pub(super) rows: u64,
    /// Names of the columns; `None` for the columns of a plain array.
    pub(super) names: Vec<Option<String>>,
    /// The fields of a row, with their offsets in a row stored in C order.
    pub(super) fields: Vec<Field>,
    pub(super) row: usize,
    pub(super) fortran: bool,
}

impl Header {
    pub(super) fn names(&self) -> Vec<String> {
        self.names.iter().enumerate().map(|(i, name)| name.clone().unwrap_or_else(|| i.to_string())).collect()
    }

    /// Returns the size of all values in bytes; `None` if the size overflows.
    pub(super) fn bytes(&self) -> Option<u64> {
        self.rows.checked_mul(self.row as u64)
    }
}

/// Opens a `.npy` file. Returns the shard's rows as a table, and the number of rows.
pub(super) fn open(path: &Path, file: File, bytes: u64, shard: Shard) -> Result<(Records, u64), MomentsError> {
    let mut input = BufReader::new(file);
    let header = read_header(path, &mut input)?;
    let expected = header.bytes().and_then(|values| values.checked_add(header.length));
    if expected != Some(bytes) {
        let expected =
            format!("{} rows of {} bytes after a header of {} bytes", header.rows, header.row, header.length);
        return Err(malformed(path, expected, format!("{bytes} bytes in total")));
    }
    let rows = shard.range(header.rows);
    let starts: Vec<(u64, usize, Vec<Field>)> = if header.fortran {
        let column = |field: &Field| {
            let size = field.kind.size() as u64;
            // In Fortran order, the values of a field are contiguous. The offset of its first value is the field's
            // offset in a row, multiplied by the number of rows.
            let at = header.length + field.at as u64 * header.rows + rows.start * size;
            (at, field.kind.size(), vec![Field { at: 0, ..*field }])
        };
        header.fields.iter().map(column).collect()
    } else {
        vec![(header.length + rows.start * header.row as u64, header.row, header.fields.clone())]
    };
    let streams = starts.into_iter().map(|(at, row, fields)| {
        let mut file = File::open(path).map_err(MomentsError::io(path, "open"))?;
        file.seek(SeekFrom::Start(at)).map_err(MomentsError::io(path, "read"))?;
        Ok(Stream { input: Box::new(BufReader::with_capacity(BUFFER, file)), row, fields })
    });
    let streams = streams.collect::<Result<_, MomentsError>>()?;
    let count = rows.end - rows.start;
    Ok((Records::new(path.to_owned(), FORMAT, header.names(), streams, rows), count))
}

/// Opens an array from a stream, such as standard input.
pub(super) fn of_stream(path: &Path, mut input: Box<dyn Read + Send>) -> Result<(Records, u64), MomentsError> {
    let header = read_header(path, &mut input)?;
    if header.bytes().is_none() {
        let found = format!("{} rows of {} bytes", header.rows, header.row);
        return Err(malformed(path, "fewer than 2^64 bytes of rows".to_owned(), found));
    }
    if header.fortran && header.fields.len() > 1 {
        return Err(malformed(path, "an array in C order on standard input".to_owned(), "Fortran order".to_owned()));
    }
    let stream = Stream { input, row: header.row, fields: header.fields.clone() };
    let rows = header.rows;
    Ok((Records::new(path.to_owned(), FORMAT, header.names(), vec![stream], 0..rows), rows))
}

fn malformed(path: &Path, expected: String, found: String) -> MomentsError {
    MomentsError::Malformed { path: path.to_owned(), format: FORMAT, expected, found }
}

/// Reads the header of an array.
pub(super) fn read_header(path: &Path, input: &mut dyn Read) -> Result<Header, MomentsError> {
    let found = npy::Header::read(input).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => malformed(path, "a NumPy header".to_owned(), "the end of the file".to_owned()),
        _ => malformed(path, "a NumPy array".to_owned(), error.to_string()),
    })?;
    of_samples(&found).ok_or_else(|| {
        let expected = "numbers of 8 to 64 bits with one row per sample, or records of such numbers".to_owned();
        let what =
            if found.fields.is_empty() { format!("type {}{}", found.kind, found.size) } else { "fields".to_owned() };
        malformed(path, expected, format!("{what}, shape {:?}", found.shape))
    })
}

/// Interprets an array as a table of samples. Returns `None` if the values of a plain array aren't numbers of a
/// supported type, or if the array's shape isn't supported. Fields without a name, which NumPy writes as padding, are
/// left out.
fn of_samples(found: &npy::Header) -> Option<Header> {
    let (rows, columns) = match found.shape[..] {
        [rows] => (rows, 1),
        [rows, columns] if (1..=MOST_COLUMNS).contains(&columns) && found.fields.is_empty() => (rows, columns),
        _ => return None,
    };
    let (mut fields, mut names, mut at) = (Vec::new(), Vec::new(), 0);
    let mut add = |name: Option<&String>, kind: Kind, little: bool| {
        if name.is_none_or(|name| !name.is_empty()) {
            fields.push(Field { at, kind, little });
            names.push(name.cloned());
        }
        at += kind.size();
    };
    if found.fields.is_empty() {
        let kind = kind_of(found.kind, found.size);
        if matches!(kind, Kind::Other(..)) {
            return None;
        }
        (0..columns).for_each(|_| add(None, kind, found.little));
    }
    for field in &found.fields {
        add(Some(&field.name), kind_of(field.kind, field.size), field.little);
    }
    let (length, rows, fortran) = (found.start, rows as u64, found.fortran && columns > 1);
    (at <= LONGEST_ROW).then_some(Header { length, rows, names, fields, row: at, fortran })
}

fn kind_of(kind: char, size: usize) -> Kind {
    match (kind, Scalar::of_numpy(kind, size)) {
        ('f', None) if size == 2 => Kind::Half,
        ('b', _) | (_, None) => Kind::Other(kind, size),
        (_, Some(scalar)) => Kind::Number(scalar),
    }
}
