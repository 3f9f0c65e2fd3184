//! Checks the sizes declared in the pages of a Parquet file before the crate `parquet` relies on these sizes.
//!
//! A Parquet file stores each column of a row group as a sequence of pages. A page is a header with the compressed and
//! uncompressed sizes, followed by the compressed bytes. `parquet` allocates memory for both declared sizes, up to 2
//! GiB each, and for a dictionary's declared number of values. The crate panics if a page refers to a dictionary that
//! is missing. Source: Apache Parquet format, "Data Pages", and `PageHeader` in `parquet.thrift`; Apache Thrift,
//! "Thrift Compact protocol encoding".

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use ::parquet::file::metadata::{ColumnChunkMetaData, ParquetMetaData};
use spharm_surface::io::{check_room, most_expanded};

/// Number of bytes that a page may have in addition to 9 bytes per row. The 9 bytes hold a value of at most 64 bits,
/// and its repetition and definition levels.
const PADDING: u64 = 1 << 10;
/// Largest accepted nesting depth of structures in a header; the format itself uses three levels.
const DEPTH: usize = 8;
/// Largest accepted length of a header in bytes. A header may be long because it contains the minimum and maximum of
/// text columns.
const HEADER: u64 = 16 << 20;

/// Checks that the pages of the given columns lie within the file, in all row groups, and that the free memory suffices
/// for the uncompressed pages. The memory has to hold one page per column, because all columns are read at the same
/// time, each column page by page.
///
/// # Errors
///
/// Returns a description of the problem.
pub(super) fn check(file: &File, metadata: &ParquetMetaData, columns: &[usize]) -> Result<(), String> {
    let bytes = file.metadata().map_err(|error| error.to_string())?.len();
    let schema = metadata.file_metadata().schema_descr();
    for group in metadata.row_groups() {
        let rows = u64::try_from(group.num_rows()).map_err(|_| "a row group with a negative number of rows")?;
        let mut all = 0_u64;
        for (leaf, column) in (0..schema.num_columns()).zip(group.columns()) {
            if columns.contains(&schema.get_column_root_idx(leaf)) {
                all = all.saturating_add(check_column(file, bytes, column, rows)?);
            }
        }
        check_room(all).map_err(|room| format!("pages that need {room}"))?;
    }
    Ok(())
}

/// Checks the pages of one column in a row group of `rows` rows. Returns the memory in bytes for the largest page,
/// compressed and uncompressed, plus the dictionary.
fn check_column(file: &File, bytes: u64, column: &ColumnChunkMetaData, rows: u64) -> Result<u64, String> {
    let start = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
    let range = u64::try_from(start).ok().zip(u64::try_from(column.compressed_size()).ok());
    let end = |(start, length): (u64, u64)| Some((start, start.checked_add(length).filter(|&end| end <= bytes)?));
    let (mut at, end) = range.and_then(end).ok_or_else(|| format!("a column at byte {start}, outside the file"))?;
    let mut input = BufReader::new(file);
    let (mut page_most, mut dictionary) = (0, None);
    while at < end {
        input.seek(SeekFrom::Start(at)).map_err(|error| error.to_string())?;
        let mut header = Compact { input: input.by_ref().take((end - at).min(HEADER)), read: 0 };
        let page = header.page().map_err(|error| format!("no valid page header at byte {at} ({error})"))?;
        let body = at + header.read;
        let wrong = || format!("a page of {} bytes at byte {at}, outside its column", page.compressed);
        let compressed = u64::try_from(page.compressed).map_err(|_| wrong())?;
        let expanded = u64::try_from(page.expanded).map_err(|_| "a page with a negative number of bytes")?;
        at = body.checked_add(compressed).filter(|&next| next <= end).ok_or_else(wrong)?;
        // A page of equal numbers compresses to almost nothing, so a high ratio is an error only if the page is too
        // large for one value per row.
        if expanded > most_expanded(compressed) && expanded > rows.saturating_mul(9).saturating_add(PADDING) {
            return Err(format!("a page that expands from {compressed} to {expanded} bytes, too many for {rows} rows"));
        }
        let both = compressed + expanded;
        if page.kind == DICTIONARY {
            // A value of the dictionary, text or a number, takes at least one byte, so there can't be more values than
            // bytes.
            let values = u64::try_from(page.values).ok().filter(|&values| values <= expanded);
            let values =
                values.ok_or_else(|| format!("a dictionary of {} values in only {expanded} bytes", page.values))?;
            dictionary = Some(both.saturating_add(8 * values));
        } else {
            if dictionary.is_none() && DICTIONARY_ENCODINGS.contains(&page.encoding) {
                return Err(format!("a page at byte {body} that needs a dictionary, in a column without a dictionary"));
            }
            page_most = both.max(page_most);
        }
    }
    Ok(page_most.saturating_add(dictionary.unwrap_or(0)))
}

/// Code of the page type for dictionaries.
const DICTIONARY: i64 = 2;

/// Codes of the encodings whose pages refer to a dictionary.
const DICTIONARY_ENCODINGS: [i64; 2] = [2, 8];

/// The fields of a page header that [`check`] needs.
#[derive(Debug, Default, PartialEq)]
struct Page {
    kind: i64,
    expanded: i64,
    compressed: i64,
    /// Number of values in the page.
    values: i64,
    /// Code of the encoding of the values.
    encoding: i64,
}

/// Reader of structures in Thrift's compact protocol.
struct Compact<R> {
    input: R,
    /// Number of bytes read so far.
    read: u64,
}

impl<R: Read> Compact<R> {
    /// Reads a whole page header.
    fn page(&mut self) -> io::Result<Page> {
        let (mut page, mut field) = (Page::default(), 0);
        let mut found = [false; 3];
        while let Some((next, kind)) = self.field(field)? {
            field = next;
            let place = match field {
                1 => &mut page.kind,
                2 => &mut page.expanded,
                3 => &mut page.compressed,
                // Fields 5, 7 and 8 of a page header contain the headers of data pages, of dictionaries, and of data
                // pages of version 2.
                5 | 7 | 8 if kind == STRUCT => {
                    (page.values, page.encoding) = self.values(if field == 8 { 4 } else { 2 })?;
                    continue;
                }
                _ => {
                    self.skip(kind, DEPTH)?;
                    continue;
                }
            };
            if kind != I32 {
                return Err(invalid("a size that isn't an integer"));
            }
            *place = self.integer()?;
            if let Some(found) = found.get_mut(field as usize - 1) {
                *found = true;
            }
        }
        if found == [true; 3] { Ok(page) } else { Err(invalid("the page's type or size is missing")) }
    }

    /// Reads the part of a page header that depends on the type of page. Returns the number of values and the code of
    /// their encoding. `encoding` is the number of the field that holds this code.
    fn values(&mut self, encoding: i64) -> io::Result<(i64, i64)> {
        let (mut found, mut last) = ((0, 0), 0);
        while let Some((field, kind)) = self.field(last)? {
            last = field;
            match field {
                1 if kind == I32 => found.0 = self.integer()?,
                _ if field == encoding && kind == I32 => found.1 = self.integer()?,
                _ => self.skip(kind, DEPTH)?,
            }
        }
        Ok(found)
    }

    /// Reads the beginning of a field. Returns its number and type; `None` at the end of the structure. `last` is the
    /// number of the previous field.
    fn field(&mut self, last: i64) -> io::Result<Option<(i64, u8)>> {
        let byte = self.byte()?;
        if byte == 0 {
            return Ok(None);
        }
        let number = match i64::from(byte >> 4) {
            0 => self.integer()?,
            more => last + more,
        };
        let known = (0..=i64::from(i16::MAX)).contains(&number);
        if known { Ok(Some((number, byte & 15))) } else { Err(invalid("a field with an invalid number")) }
    }

    fn byte(&mut self) -> io::Result<u8> {
        let mut byte = [0];
        self.input.read_exact(&mut byte)?;
        self.read += 1;
        Ok(byte[0])
    }

    /// Reads a variable-length integer: seven bits per byte, lowest bits first.
    fn variable(&mut self) -> io::Result<u64> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 127) << shift;
            if byte < 128 {
                return Ok(number);
            }
        }
        Err(invalid("an integer of more than 64 bits"))
    }

    /// Reads a zigzag-encoded integer: the lowest bit holds the sign.
    fn integer(&mut self) -> io::Result<i64> {
        let number = self.variable()?;
        Ok((number >> 1) as i64 ^ -((number & 1) as i64))
    }

    fn pass(&mut self, bytes: u64) -> io::Result<()> {
        let passed = io::copy(&mut self.input.by_ref().take(bytes), &mut io::sink())?;
        self.read += passed;
        if passed == bytes { Ok(()) } else { Err(invalid("the header runs past the end of the column")) }
    }

    /// Skips the value of a field of type `kind`.
    fn skip(&mut self, kind: u8, depth: usize) -> io::Result<()> {
        if depth == 0 {
            return Err(invalid("structures that are nested too deeply"));
        }
        match kind {
            TRUE | FALSE => Ok(()),
            BYTE => self.pass(1),
            I16 | I32 | I64 => self.variable().map(drop),
            DOUBLE => self.pass(8),
            BINARY => {
                let length = self.variable()?;
                self.pass(length)
            }
            LIST | SET => {
                let byte = self.byte()?;
                let count = if byte >> 4 == 15 { self.variable()? } else { u64::from(byte >> 4) };
                self.skip_all(byte & 15, count, depth)
            }
            STRUCT => {
                let mut last = 0;
                while let Some((field, kind)) = self.field(last)? {
                    last = field;
                    self.skip(kind, depth - 1)?;
                }
                Ok(())
            }
            _ => Err(invalid("a field of unknown type")),
        }
    }

    /// Skips the elements of a list. Each element takes at least one byte, so if `count` is too large, skipping fails
    /// at the end of the header.
    fn skip_all(&mut self, kind: u8, count: u64, depth: usize) -> io::Result<()> {
        for _ in 0..count {
            let kind = if matches!(kind, TRUE | FALSE) { BYTE } else { kind };
            self.skip(kind, depth - 1)?;
        }
        Ok(())
    }
}

const TRUE: u8 = 1;
const FALSE: u8 = 2;
const BYTE: u8 = 3;
const I16: u8 = 4;
const I32: u8 = 5;
const I64: u8 = 6;
const DOUBLE: u8 = 7;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const SET: u8 = 10;
const STRUCT: u8 = 12;

fn invalid(what: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> (io::Result<Page>, u64) {
        let mut header = Compact { input: bytes, read: 0 };
        let page = header.page();
        (page, header.read)
    }

    #[test]
    fn a_header_is_read_to_its_end() {
        // Header of a data page of 300 bytes, compressed to 40, with a checksum and a nested structure of a list, a
        // string and a boolean. Other bytes follow the header.
        let text: Vec<u8> = [&[0x18, 3][..], b"abc"].concat();
        let inner = [&[0x15, 6, 0x15, 16, 0x19, 0x25, 2, 4][..], &text, &[0x11, 0][..]].concat();
        let header = [&[0x15, 0, 0x15, 0xd8, 4, 0x15, 80, 0x15, 1, 0x1c][..], &inner, &[0][..]].concat();
        let (page, length) = read(&[&header[..], &[9, 9, 9]].concat());
        assert_eq!(page.unwrap(), Page { kind: 0, expanded: 300, compressed: 40, values: 3, encoding: 8 });
        assert_eq!(length, header.len() as u64);
        for end in 0..header.len() {
            assert!(read(&header[..end]).0.is_err(), "{end}");
        }
    }

    #[test]
    fn what_no_header_has_is_refused() {
        let deep = [&[0x15, 0, 0x15, 2, 0x15, 2][..], &[0x2c; 1000]].concat();
        let long = [&[0x15, 0, 0x15, 2, 0x15, 2, 0x58][..], &[0xff; 9], &[1]].concat();
        let no_end = [&[0x15][..], &[0xff; 11]].concat();
        for bytes in [&deep[..], &long, &no_end, &[0x15, 0, 0x15, 2, 0], &[0x18, 0], &[0x0d; 3]] {
            assert!(read(bytes).0.is_err(), "{bytes:?}");
        }
    }
}
