//! Arrays of NumPy (`.npy`): a row a sample. Columns of a plain array are named by their numbers from 0, those of a
//! structured one by its fields.
//!
//! Source: NumPy Enhancement Proposal 1, and `numpy.lib.format`.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::records::{Field, Kind, Records, Stream};
use crate::MomentsError;
use crate::moments::Shard;

pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
const FORMAT: &str = "NumPy array";
/// NumPy's own limit is 10,000 characters.
const LONGEST_HEADER: usize = 1 << 16;
/// Bytes read at a time: of several streams side by side, each has its own.
const BUFFER: usize = 1 << 18;

/// What an array's header says.
pub(super) struct Header {
    /// Bytes of the header, and all before it.
    pub(super) length: u64,
    pub(super) rows: u64,
    /// Names of the columns, none for a plain array's.
    pub(super) names: Vec<Option<String>>,
    /// Fields of a row as in C order.
    pub(super) fields: Vec<Field>,
    pub(super) row: usize,
    pub(super) fortran: bool,
}

impl Header {
    pub(super) fn names(&self) -> Vec<String> {
        self.names.iter().enumerate().map(|(i, name)| name.clone().unwrap_or_else(|| i.to_string())).collect()
    }

    /// Bytes of the values; `None` where there are more than can be.
    fn bytes(&self) -> Option<u64> {
        self.rows.checked_mul(self.row as u64)
    }
}

/// Opens a file, and returns the rows of the shard.
pub(super) fn open(path: &Path, file: File, bytes: u64, shard: Shard) -> Result<(Records, u64), MomentsError> {
    let mut input = BufReader::new(file);
    let header = read_header(path, &mut input)?;
    let expected = header.bytes().and_then(|values| values.checked_add(header.length));
    if expected != Some(bytes) {
        let expected =
            format!("{} rows of {} bytes after {} bytes, as its header says", header.rows, header.row, header.length);
        return Err(malformed(path, expected, format!("{bytes} bytes in all")));
    }
    let rows = shard.range(header.rows);
    let starts: Vec<(u64, usize, Vec<Field>)> = if header.fortran {
        let column = |field: &Field| {
            let size = field.kind.size() as u64;
            // In Fortran order a field is a run of its own, and its place in a row tells which.
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

/// Takes an array from a stream.
pub(super) fn of_stream(path: &Path, mut input: Box<dyn Read + Send>) -> Result<(Records, u64), MomentsError> {
    let header = read_header(path, &mut input)?;
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

/// Reads an array's header.
pub(super) fn read_header(path: &Path, input: &mut dyn Read) -> Result<Header, MomentsError> {
    let short = |_| malformed(path, "a header of NumPy".to_owned(), "the end of the file".to_owned());
    let mut start = [0; 8];
    input.read_exact(&mut start).map_err(short)?;
    let (length, before) = match start {
        [magic @ .., 1, _] if magic == MAGIC => {
            let mut length = [0; 2];
            input.read_exact(&mut length).map_err(short)?;
            (u16::from_le_bytes(length).into(), 10)
        }
        [magic @ .., 2 | 3, _] if magic == MAGIC => {
            let mut length = [0; 4];
            input.read_exact(&mut length).map_err(short)?;
            (u32::from_le_bytes(length) as usize, 12)
        }
        _ => return Err(malformed(path, "an array of version 1 to 3".to_owned(), start.escape_ascii().to_string())),
    };
    if length > LONGEST_HEADER {
        return Err(malformed(path, format!("a header of at most {LONGEST_HEADER} bytes"), format!("{length} bytes")));
    }
    let mut text = vec![0; length];
    input.read_exact(&mut text).map_err(short)?;
    let text = String::from_utf8_lossy(&text).into_owned();
    let unclear = || {
        let expected = "numbers of 8 to 64 bits, a row a sample, or fields of these".to_owned();
        malformed(path, expected, text.trim().escape_debug().to_string())
    };
    let mut header = parse(&text).ok_or_else(unclear)?;
    header.length = (before + length) as u64;
    Ok(header)
}

fn parse(text: &str) -> Option<Header> {
    let value = |key: &str| Some(text.split_once(&format!("'{key}':"))?.1.trim_start());
    let shape = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
    let shape: Option<Vec<u64>> =
        shape.split(',').map(str::trim).filter(|n| !n.is_empty()).map(|n| n.parse().ok()).collect();
    let (rows, columns) = match shape?[..] {
        [rows] => (rows, 1),
        [rows, columns] if columns <= 1 << 16 => (rows, columns as usize),
        _ => return None,
    };
    let descr = value("descr")?;
    let (mut fields, mut names, mut at) = (Vec::new(), Vec::new(), 0);
    if let Some(list) = descr.strip_prefix('[') {
        // [('lon', '<f8'), ('lat', '<f8')]
        for entry in list.split_once(']')?.0.split('(').skip(1) {
            let mut quoted = entry.split('\'').skip(1).step_by(2);
            let (name, kind) = (quoted.next()?, quoted.next()?);
            let (kind, little) = kind_of(kind)?;
            // Not a number each where there is a shape after the type.
            if entry.split_once(&format!("'{}'", entry.split('\'').nth(3)?))?.1.contains(['0', '1', '2', '3', '4', '5'])
            {
                return None;
            }
            fields.push(Field { at, kind, little });
            names.push(Some(name.to_owned()));
            at += kind.size();
        }
        if columns != 1 {
            return None;
        }
    } else {
        let (kind, little) = kind_of(descr.strip_prefix('\'')?.split_once('\'')?.0)?;
        for _ in 0..columns {
            fields.push(Field { at, kind, little });
            names.push(None);
            at += kind.size();
        }
    }
    let fortran = value("fortran_order")?.starts_with("True") && columns > 1;
    (!fields.is_empty()).then_some(Header { length: 0, rows, names, fields, row: at, fortran })
}

fn kind_of(descr: &str) -> Option<(Kind, bool)> {
    let kind = match descr.trim_start_matches(['<', '>', '|', '=']) {
        "f8" => Kind::F64,
        "f4" => Kind::F32,
        "i1" => Kind::I8,
        "u1" => Kind::U8,
        "i2" => Kind::I16,
        "u2" => Kind::U16,
        "i4" => Kind::I32,
        "u4" => Kind::U32,
        "i8" => Kind::I64,
        "u8" => Kind::U64,
        _ => return None,
    };
    Some((kind, !descr.starts_with('>')))
}
