//! Reads and writes TSV and CSV tables in common dialects, and keeps track of line numbers.
//!
//! Tables follow RFC 4180, with commas if the file name ends in `.csv` and tabs otherwise. Cells in quotation marks
//! may contain separators. All kinds of line endings are accepted. A byte-order mark, blank lines, and lines that
//! begin with `#` are skipped.

use std::path::Path;

use csv::StringRecord;

use crate::error::CohortError;

/// Largest accepted size of a table in bytes, far above the size of any study's table.
const LARGEST: u64 = 1 << 30;

/// The text of a table and the separator of its cells.
pub(crate) struct Table<'a> {
    path: &'a Path,
    text: &'a str,
    separator: u8,
}

/// Reads the text of a table's file, without its byte-order mark.
pub(crate) fn read_text(path: &Path) -> Result<String, CohortError> {
    let bytes = spharm_files::read(path, LARGEST);
    decode(path, bytes.map_err(|source| CohortError::Io { path: path.to_owned(), action: "read", source })?)
}

/// Decodes the bytes of a table as UTF-8 text, without the byte-order mark.
pub(crate) fn decode(path: &Path, mut bytes: Vec<u8>) -> Result<String, CohortError> {
    if bytes.starts_with(b"\xef\xbb\xbf") {
        bytes.drain(..3);
    }
    let refuse = |line, found: String| CohortError::Encoding { path: path.to_owned(), line, found };
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(refuse(1, "UTF-16".to_owned()));
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let bytes = error.as_bytes();
        refuse(1 + newlines(&bytes[..at]), format!("byte 0x{:02x}", bytes[at]))
    })
}

fn newlines(bytes: &[u8]) -> usize {
    bytes.iter().filter(|&&byte| byte == b'\n').count()
}

impl<'a> Table<'a> {
    /// Creates a table, separated by commas if the file name ends in `.csv` and by tabs otherwise.
    pub(crate) fn new(path: &'a Path, text: &'a str) -> Self {
        let commas = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
        Self { path, text, separator: if commas { b',' } else { b'\t' } }
    }

    /// Returns a writer with the separator of this table.
    pub(crate) fn writer(&self) -> csv::Writer<Vec<u8>> {
        writer(self.separator)
    }

    /// Returns the header and its line number.
    pub(crate) fn header(&self) -> Result<(Vec<String>, usize), CohortError> {
        let mut header = None;
        self.records(|line, record| {
            header.get_or_insert_with(|| (record.iter().map(str::to_owned).collect(), line));
            Ok(false)
        })?;
        header.ok_or_else(|| CohortError::NoRows { path: self.path.to_owned() })
    }

    /// Calls `row` with the line number and the cells of each record, including the header. Stops when `row` returns
    /// false.
    pub(crate) fn records(
        &self,
        mut row: impl FnMut(usize, &StringRecord) -> Result<bool, CohortError>,
    ) -> Result<(), CohortError> {
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(self.separator)
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .has_headers(false)
            .flexible(true)
            .from_reader(self.text.as_bytes());
        let (mut lines, mut record) = (Lines::new(self.text, true), StringRecord::new());
        loop {
            let from = reader.position().byte() as usize;
            match reader.read_record(&mut record) {
                Ok(true) => {}
                Ok(false) => return Ok(()),
                Err(error) => {
                    let source = std::io::Error::other(error.to_string());
                    return Err(CohortError::Io { path: self.path.to_owned(), action: "read", source });
                }
            }
            // Skip lines that contain only white space.
            if record.len() == 1 && record[0].is_empty() {
                continue;
            }
            if !row(lines.of_record(from), &record)? {
                return Ok(());
            }
        }
    }
}

/// Returns a writer of tables with the given separator, which quotes cells if necessary.
pub(crate) fn writer(separator: u8) -> csv::Writer<Vec<u8>> {
    csv::WriterBuilder::new().delimiter(separator).comment(Some(b'#')).flexible(true).from_writer(Vec::new())
}

/// Returns the line number of the first record at or after a byte offset of a table's text. The crate csv counts one
/// line too few if lines end in a carriage return and a newline. `comments` determines whether lines that begin with
/// `#` are skipped.
#[must_use]
pub fn line_of_record(text: &str, from: usize, comments: bool) -> usize {
    Lines::new(text, comments).of_record(from)
}

/// Determines the line numbers of records. The records must be looked up in order.
struct Lines<'a> {
    bytes: &'a [u8],
    comments: bool,
    at: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    fn new(text: &'a str, comments: bool) -> Self {
        Self { bytes: text.as_bytes(), comments, at: 0, line: 1 }
    }

    /// Returns the line number of the first record at or after a byte offset. Blank lines and comments may precede the
    /// record.
    fn of_record(&mut self, from: usize) -> usize {
        let from = from.min(self.bytes.len());
        if from > self.at {
            self.line += newlines(&self.bytes[self.at..from]);
            self.at = from;
        }
        loop {
            match self.bytes.get(self.at) {
                Some(b'\n') => self.line += 1,
                Some(b'\r') => {}
                Some(b'#') if self.comments => {
                    let rest = &self.bytes[self.at..];
                    let length = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(rest.len());
                    self.at += length;
                    continue;
                }
                _ => return self.line,
            }
            self.at += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(text: &str) -> Vec<(usize, Vec<String>)> {
        let mut found = Vec::new();
        let table = Table::new(Path::new("t.csv"), text);
        table
            .records(|line, record| {
                found.push((line, record.iter().map(str::to_owned).collect()));
                Ok(true)
            })
            .unwrap();
        found
    }

    #[test]
    fn lines_are_counted_through_comments_blank_lines_and_cells_with_breaks() {
        for end in ["\n", "\r\n"] {
            let text = ["# who", "", "id,surface", "# no", "a,b", "", "\"c\nd\",e", "  ", "f,\"g\"\"h\""].join(end);
            let found = lines(&text);
            let expected = [(3, ["id", "surface"]), (5, ["a", "b"]), (7, ["c\nd", "e"]), (10, ["f", "g\"h"])];
            let expected = expected.map(|(line, cells)| (line, cells.map(str::to_owned).to_vec()));
            assert_eq!(found, expected, "{end:?}");
        }
    }

    #[test]
    fn what_is_not_utf8_is_named_with_its_line() {
        let decode = |bytes: &[u8]| decode(Path::new("t.tsv"), bytes.to_vec());
        assert_eq!(decode(b"\xef\xbb\xbfid").unwrap(), "id");
        let error = decode(b"id\nM\xfcller\n").unwrap_err().to_string();
        assert_eq!(error, "t.tsv: line 2: expected UTF-8 text, found byte 0xfc; save the table as UTF-8");
        assert!(decode(b"\xff\xfei\0d\0").unwrap_err().to_string().contains("UTF-16"));
    }
}
