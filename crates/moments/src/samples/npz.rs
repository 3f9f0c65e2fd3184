//! Reads NumPy archives (`.npz`) of several arrays with the same number of rows. A one-dimensional array becomes a
//! column with the array's name. The columns of a matrix are named `name.0`, `name.1`, and so on. The columns of a
//! structured array have the names of its fields.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::read::DeflateDecoder;
use zip::{CompressionMethod, ZipArchive};

use super::npy::{Header, read_header};
use super::records::{Records, Stream};
use crate::MomentsError;
use crate::moments::Shard;

const FORMAT: &str = "NumPy archive";
const BUFFER: usize = 1 << 18;

/// Name and position of an array in the archive.
struct Entry {
    name: String,
    start: u64,
    length: u64,
    deflated: bool,
}

/// Opens a `.npz` archive. Returns the shard's rows as a table, and the number of rows.
pub(super) fn open(path: &Path, file: File, shard: Shard) -> Result<(Records, u64), MomentsError> {
    let malformed = |expected: &str, found: String| MomentsError::Malformed {
        path: path.to_owned(),
        format: FORMAT,
        expected: expected.to_owned(),
        found,
    };
    let (mut names, mut streams, mut rows) = (Vec::new(), Vec::new(), None);
    for entry in entries(file).map_err(|problem| malformed("an archive of arrays", problem))? {
        let mut input = entry.open(path)?;
        let header = read_header(path, &mut input)?;
        if header.fortran {
            return Err(malformed("arrays in C order", format!("{} in Fortran order", entry.name)));
        }
        if header.bytes().is_none() {
            let found = format!("{} rows of {} bytes in {}", header.rows, header.row, entry.name);
            return Err(malformed("fewer than 2^64 bytes of rows", found));
        }
        let expected = *rows.get_or_insert(header.rows);
        if header.rows != expected {
            let found = format!("{} rows in {}, but {expected} rows in the arrays before it", header.rows, entry.name);
            return Err(malformed("arrays with the same number of rows", found));
        }
        names.extend(named(&entry.name, &header));
        // The data may be compressed, so seeking isn't possible. Therefore, read the rows before the shard and discard
        // them.
        let before = shard.range(header.rows).start * header.row as u64;
        let skipped = io::copy(&mut input.by_ref().take(before), &mut io::sink());
        if skipped.map_err(MomentsError::io(path, "read"))? != before {
            return Err(malformed("as many rows as the header states", format!("fewer rows in {}", entry.name)));
        }
        streams.push(Stream { input, row: header.row, fields: header.fields });
    }
    let Some(all) = rows else { return Err(MomentsError::Empty { path: path.to_owned() }) };
    let rows = shard.range(all);
    let count = rows.end - rows.start;
    Ok((Records::new(path.to_owned(), FORMAT, names, streams, rows), count))
}

fn entries(file: File) -> Result<Vec<Entry>, String> {
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| error.to_string())?;
    let mut found = Vec::new();
    for index in 0..archive.len() {
        let file = archive.by_index_raw(index).map_err(|error| error.to_string())?;
        let name = file.name().map_err(|error| error.to_string())?;
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let deflated = match file.compression() {
            CompressionMethod::Stored => false,
            CompressionMethod::Deflated => true,
            other => return Err(format!("array {name}, compressed with {other}")),
        };
        let start = file.data_start().ok_or_else(|| format!("array {name}, without data"))?;
        found.push(Entry { name, start, length: file.compressed_size(), deflated });
    }
    Ok(found)
}

impl Entry {
    fn open(&self, path: &Path) -> Result<Box<dyn Read + Send>, MomentsError> {
        let mut file = File::open(path).map_err(MomentsError::io(path, "open"))?;
        file.seek(SeekFrom::Start(self.start)).map_err(MomentsError::io(path, "read"))?;
        let stored = BufReader::with_capacity(BUFFER, file).take(self.length);
        Ok(if self.deflated { Box::new(DeflateDecoder::new(stored)) } else { Box::new(stored) })
    }
}

fn named(array: &str, header: &Header) -> Vec<String> {
    let several = header.names.len() > 1;
    let of = |(i, name): (usize, &Option<String>)| match name {
        Some(name) => name.clone(),
        None if several => format!("{array}.{i}"),
        None => array.to_owned(),
    };
    header.names.iter().enumerate().map(of).collect()
}
