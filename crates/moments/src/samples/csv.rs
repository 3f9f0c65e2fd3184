//! Reads text tables with one row per line and fields separated by commas, tabs, semicolons or blanks. The first line
//! contains the names of the columns, unless it consists of numbers. Lines that are empty or begin with `#` are
//! skipped. A field may be enclosed in quotation marks. It may then contain separators, but no line ends, because a
//! shard may begin at any line.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::table::Table;
use crate::MomentsError;
use crate::error::cut;
use crate::moments::Shard;

const FORMAT: &str = "table";
/// Number of bytes per read. The bytes of one read are parsed by all threads in parallel.
const BLOCK: usize = 1 << 22;
/// Smallest number of bytes that one thread parses at a time.
const PIECE: usize = 1 << 16;
/// The UTF-8 byte-order mark, which some programs write at the beginning of a file.
const MARK: &[u8] = b"\xef\xbb\xbf";
/// Largest length of a line in bytes; a longer line is an error.
const LONGEST_LINE: usize = 1 << 20;

/// A shard of a text table.
pub(super) struct Text {
    path: PathBuf,
    input: Box<dyn Read + Send>,
    lines: Lines,
    /// Bytes that have been read but not parsed.
    pending: Vec<u8>,
    /// Values of rows that have been parsed but not returned.
    parsed: Vec<f64>,
    /// Byte range of the table's rows before the shard: from the end of the header to the start of the shard.
    before: Range<u64>,
    /// Number of the shard's rows that have been parsed.
    rows: u64,
    ended: bool,
}

/// Layout of the table's lines.
struct Lines {
    names: Vec<String>,
    /// Separator of the fields; `None` if any number of blanks separates them.
    separator: Option<u8>,
    selected: Vec<usize>,
}

/// Opens a shard of a file. A line belongs to the shard if its first byte is in the shard's byte range.
pub(super) fn open(path: &Path, file: File, bytes: u64, shard: Shard) -> Result<Text, MomentsError> {
    let mut input = BufReader::new(file);
    let (names, separator, header) = head(path, &mut input)?;
    shard_of(path, input, header..bytes, Lines { names, separator, selected: Vec::new() }, shard)
}

/// Opens a shard of the rows in a byte range of a file. The fields must be separated by blanks.
pub(super) fn of_rows(
    path: &Path,
    file: File,
    bytes: Range<u64>,
    names: Vec<String>,
    shard: Shard,
) -> Result<Text, MomentsError> {
    let lines = Lines { names, separator: None, selected: Vec::new() };
    shard_of(path, BufReader::new(file), bytes, lines, shard)
}

fn shard_of(
    path: &Path,
    mut input: BufReader<File>,
    bytes: Range<u64>,
    lines: Lines,
    shard: Shard,
) -> Result<Text, MomentsError> {
    let failed = |error| MomentsError::io(path, "read")(error);
    let Range { start, end } = shard.range(bytes.end);
    let start = line_from(&mut input, start.max(bytes.start)).map_err(failed)?;
    let end = if end >= bytes.end { end } else { line_from(&mut input, end.max(bytes.start)).map_err(failed)? };
    input.seek(SeekFrom::Start(start)).map_err(failed)?;
    let input = Box::new(input.take(end.saturating_sub(start)));
    Ok(Text::new(path, input, lines, bytes.start..start))
}

/// Returns the offset of the first line that begins at or after `from`.
fn line_from(input: &mut BufReader<File>, from: u64) -> io::Result<u64> {
    if from == 0 {
        return Ok(0);
    }
    input.seek(SeekFrom::Start(from - 1))?;
    let mut skipped = Vec::new();
    Ok(from - 1 + input.read_until(b'\n', &mut skipped)? as u64)
}

/// Opens a table from a stream, such as standard input.
pub(super) fn of_stream(path: &Path, input: Box<dyn Read + Send>) -> Result<Text, MomentsError> {
    let mut input = BufReader::new(input);
    let mut first = Vec::new();
    let (names, separator, header) = head(path, &mut Kept { input: &mut input, kept: &mut first })?;
    // The bytes that were read after the header belong to the first rows.
    let rows = first.split_off((header as usize).min(first.len()));
    let lines = Lines { names, separator, selected: Vec::new() };
    Ok(Text::new(path, Box::new(io::Cursor::new(rows).chain(input)), lines, header..header))
}

/// A reader that keeps a copy of the bytes read through it.
struct Kept<'a, R> {
    input: &'a mut R,
    kept: &'a mut Vec<u8>,
}

impl<R: BufRead> Read for Kept<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.kept.extend_from_slice(&buffer[..count]);
        Ok(count)
    }
}

impl<R: BufRead> BufRead for Kept<'_, R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.input.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        if let Ok(buffer) = self.input.fill_buf() {
            self.kept.extend_from_slice(&buffer[..count.min(buffer.len())]);
        }
        self.input.consume(count);
    }
}

/// Reads the beginning of a table. Returns the names of the columns, the separator, and the number of bytes before the
/// first row. The names are taken from the header, or from a comment just before the first row, because `numpy.savetxt`
/// writes a header as a comment. Without a header, the names are the columns' indices from 0. A first line that
/// consists of just these indices is treated as a header ([`are_places`]).
fn head(path: &Path, input: &mut dyn BufRead) -> Result<(Vec<String>, Option<u8>, u64), MomentsError> {
    let mut at = 0;
    let mut comment = Vec::new();
    loop {
        let mut line = Vec::new();
        let count = io::Read::take(&mut *input, LONGEST_LINE as u64 + 1).read_until(b'\n', &mut line);
        let count = count.map_err(MomentsError::io(path, "read"))?;
        if count == 0 {
            return Err(MomentsError::Empty { path: path.to_owned() });
        }
        check_encoding(path, &line)?;
        if count > LONGEST_LINE {
            return Err(too_long(path));
        }
        let marked = if at == 0 { line.strip_prefix(MARK) } else { None };
        let (text, mark) = (marked.unwrap_or(&line).trim_ascii(), marked.map_or(0, |_| MARK.len() as u64));
        if text.is_empty() || text.starts_with(b"#") {
            comment = text.strip_prefix(b"#").unwrap_or_default().trim_ascii().to_vec();
            at += count as u64;
            continue;
        }
        let separator = [b',', b';', b'\t'].into_iter().find(|&separator| has_separator(text, separator));
        let mut words: Vec<&[u8]> = Vec::new();
        split(text, separator, &mut words);
        let name = |word: &&[u8]| String::from_utf8_lossy(word).trim_matches('"').replace("\"\"", "\"");
        if words.iter().all(|word| number(word).is_some()) {
            let mut names: Vec<&[u8]> = Vec::new();
            split(&comment, separator, &mut names);
            if names.len() == words.len() && names.iter().all(|word| number(word).is_none()) {
                return Ok((names.iter().map(name).collect(), separator, at + mark));
            }
            if separator.is_none() || !are_places(&words) {
                return Ok(((0..words.len()).map(|i| i.to_string()).collect(), separator, at + mark));
            }
        }
        return Ok((words.iter().map(name).collect(), separator, at + count as u64));
    }
}

/// Returns whether the cells of the first line are the columns' indices 0, 1, 2 and so on, as pandas writes them for
/// columns without names. At least three cells are required, so that a line of two small numbers remains a row.
fn are_places(cells: &[&[u8]]) -> bool {
    cells.len() > 2 && cells.iter().enumerate().all(|(place, cell)| *cell == place.to_string().as_bytes())
}

fn too_long(path: &Path) -> MomentsError {
    let expected = format!("lines of at most {LONGEST_LINE} bytes");
    MomentsError::Malformed { path: path.to_owned(), format: FORMAT, expected, found: "a longer line".to_owned() }
}

/// Returns an error for text in UTF-16 and for lines that end with a carriage return only. The reader would treat
/// either text as one long line.
fn check_encoding(path: &Path, line: &[u8]) -> Result<(), MomentsError> {
    let refuse = |expected: &str, found: &str| MomentsError::Malformed {
        path: path.to_owned(),
        format: FORMAT,
        expected: expected.to_owned(),
        found: found.to_owned(),
    };
    if line.starts_with(b"\xff\xfe") || line.starts_with(b"\xfe\xff") {
        return Err(refuse("text in UTF-8", "UTF-16; save the table as UTF-8"));
    }
    if line.trim_ascii_end().contains(&b'\r') {
        let found = "carriage returns alone; save the table with the line ends of Windows or Linux";
        return Err(refuse("lines that end with a line feed", found));
    }
    Ok(())
}

/// Splits a line into its fields, without the quotation marks around them.
fn split<'a>(line: &'a [u8], separator: Option<u8>, cells: &mut Vec<&'a [u8]>) {
    if line.contains(&b'"') {
        cells.extend(Quoted { rest: Some(line), separator });
    } else {
        cells.extend(fields(line, separator));
    }
}

/// Returns whether a separator occurs outside quotation marks.
fn has_separator(line: &[u8], separator: u8) -> bool {
    Quoted { rest: Some(line), separator: Some(separator) }.nth(1).is_some()
}

/// An iterator over the fields of a line with quotation marks. Within a quoted field, two consecutive quotation marks
/// represent one quotation mark, but this iterator returns both.
struct Quoted<'a> {
    rest: Option<&'a [u8]>,
    separator: Option<u8>,
}

impl<'a> Iterator for Quoted<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let separates = |byte: u8| self.separator.map_or(byte.is_ascii_whitespace(), |separator| byte == separator);
        let line = self.rest?;
        // A tab is whitespace, but must not be skipped here if it is the separator.
        let blank = |byte: &u8| byte.is_ascii_whitespace() && self.separator != Some(*byte);
        let start = line.iter().position(|byte| !blank(byte)).unwrap_or(line.len());
        let line = &line[start..];
        if line.is_empty() && self.separator.is_none() {
            return None;
        }
        let mut quoted = false;
        let starts_quoted = line.starts_with(b"\"");
        let end = line.iter().position(|&byte| {
            quoted ^= byte == b'"' && starts_quoted;
            !quoted && separates(byte)
        });
        let (field, rest) = end.map_or((line, None), |end| (&line[..end], Some(&line[end + 1..])));
        self.rest = rest;
        let field = field.trim_ascii();
        Some(field.strip_prefix(b"\"").and_then(|inner| inner.strip_suffix(b"\"")).unwrap_or(field))
    }
}

fn fields(line: &[u8], separator: Option<u8>) -> impl Iterator<Item = &[u8]> {
    line.split(move |&byte| separator.map_or(byte.is_ascii_whitespace(), |separator| byte == separator))
        .map(<[u8]>::trim_ascii)
        .filter(move |field| separator.is_some() || !field.is_empty())
}

/// Parses a number. NaN and infinity are accepted here and rejected later.
fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// An invalid line: the index of its row within the parsed lines, from 0, and the problem.
struct BadLine {
    row: u64,
    column: String,
    expected: &'static str,
    found: String,
}

impl Text {
    fn new(path: &Path, input: Box<dyn Read + Send>, lines: Lines, before: Range<u64>) -> Self {
        let (pending, parsed) = (Vec::new(), Vec::new());
        Self { path: path.to_owned(), input, lines, pending, parsed, before, rows: 0, ended: false }
    }

    /// Reads and parses another block of bytes.
    fn more(&mut self) -> Result<(), MomentsError> {
        let before = self.pending.len();
        let count = self.input.by_ref().take(BLOCK as u64).read_to_end(&mut self.pending);
        self.ended = count.map_err(MomentsError::io(&self.path, "read"))? == 0;
        let end = match self.pending.iter().rposition(|&byte| byte == b'\n') {
            _ if self.ended => self.pending.len(),
            Some(last) => last + 1,
            None if before + BLOCK > LONGEST_LINE => return Err(too_long(&self.path)),
            None => return Ok(()),
        };
        let rest = self.pending.split_off(end);
        let whole = std::mem::replace(&mut self.pending, rest);
        let mut pieces = Vec::new();
        let mut left = &whole[..];
        while !left.is_empty() {
            let end = left.iter().skip(PIECE).position(|&byte| byte == b'\n').map_or(left.len(), |at| PIECE + at + 1);
            let (piece, rest) = left.split_at(end);
            pieces.push(piece);
            left = rest;
        }
        let lines = &self.lines;
        let found: Vec<(Vec<f64>, Option<BadLine>)> = pieces.into_par_iter().map(|piece| lines.parse(piece)).collect();
        for (rows, bad) in found {
            let before = self.rows;
            self.rows += (rows.len() / self.lines.selected.len().max(1)) as u64;
            self.parsed.extend(rows);
            if let Some(BadLine { row, column, expected, found }) = bad {
                let row = self.number_of(before + row);
                return Err(MomentsError::Row { path: self.path.clone(), row, column, expected, found });
            }
        }
        Ok(())
    }
}

impl Lines {
    /// Parses lines into rows. Stops at the first invalid line.
    fn parse(&self, lines: &[u8]) -> (Vec<f64>, Option<BadLine>) {
        let (columns, width) = (self.names.len(), self.selected.len().max(1));
        let mut rows = Vec::new();
        let mut cells: Vec<&[u8]> = Vec::new();
        for line in lines.split(|&byte| byte == b'\n') {
            let line = line.trim_ascii();
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            cells.clear();
            split(line, self.separator, &mut cells);
            let row = (rows.len() / width) as u64;
            if cells.len() != columns {
                let found = format!("{} fields, but the header or first row has {columns}", cells.len());
                let bad = BadLine { row, column: "the line".to_owned(), expected: "as many fields as columns", found };
                return (rows, Some(bad));
            }
            for &column in &self.selected {
                let Some(value) = number(cells[column]) else {
                    rows.truncate(row as usize * width);
                    let found = format!("\"{}\"", cut(&cells[column].escape_ascii().to_string()));
                    let column = self.names[column].clone();
                    return (rows, Some(BadLine { row, column, expected: "a number", found }));
                };
                rows.push(value);
            }
        }
        (rows, None)
    }
}

impl Table for Text {
    fn columns(&self) -> &[String] {
        &self.lines.names
    }

    fn select(&mut self, columns: Vec<usize>) {
        self.lines.selected = columns;
    }

    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError> {
        let width = self.lines.selected.len().max(1);
        while self.parsed.len() < most * width && !self.ended {
            self.more()?;
        }
        let count = self.parsed.len().min(most * width);
        out.extend(self.parsed.drain(..count));
        Ok(count / width)
    }

    /// Returns the row's number within the whole table, from 1. The rows before the shard are counted only here,
    /// because their number is needed only in error messages.
    fn number_of(&self, row: u64) -> u64 {
        let before = || -> io::Result<u64> {
            if self.before.is_empty() {
                return Ok(0);
            }
            let mut file = File::open(&self.path)?;
            file.seek(SeekFrom::Start(self.before.start))?;
            let mut input = BufReader::new(file).take(self.before.end - self.before.start);
            let (mut rows, mut line) = (0, Vec::new());
            while input.read_until(b'\n', &mut line)? > 0 {
                let text = line.trim_ascii();
                rows += u64::from(!text.is_empty() && !text.starts_with(b"#"));
                line.clear();
            }
            Ok(rows)
        };
        before().unwrap_or(0) + row + 1
    }
}
