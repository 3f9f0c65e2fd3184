//! Checks the numbers of cells in the rows of tables.

use anyhow::{Result, bail};
use csv::StringRecord;

/// Checks that a record of a table with the given text has as many cells as the header; the error names the record's
/// line. `comments` says whether lines that begin with `#` are skipped.
pub(crate) fn check_cells(text: &str, record: &StringRecord, expected: usize, comments: bool) -> Result<()> {
    let found = record.len();
    if found == expected {
        return Ok(());
    }
    let line = line_of(text, record.position().map_or(0, |start| start.byte() as usize), comments);
    let hint = if found > expected { " (decimal comma or missing quotes?)" } else { "" };
    bail!("line {line}: expected {expected} cells as in the header, found {found}{hint}")
}

/// Returns the number of the line of the first record at or after a byte. The lines counted by the crate csv are too
/// low by one if lines end in a carriage return and a newline.
fn line_of(text: &str, from: usize, comments: bool) -> usize {
    let bytes = text.as_bytes();
    let mut at = from.min(bytes.len());
    loop {
        match bytes.get(at) {
            Some(b'\n' | b'\r') => at += 1,
            Some(b'#') if comments => {
                let rest = &bytes[at..];
                at += rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
            }
            _ => return 1 + bytes[..at].iter().filter(|byte| **byte == b'\n').count(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_line_with_any_line_ends() {
        for (end, comment) in [("\n", ""), ("\r\n", ""), ("\n", "# c\n"), ("\r\n", "\r\n# c\r\n")] {
            let text = format!("id,age{end}a,3{end}{comment}b,4,5{end}");
            let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).flexible(true).from_reader(text.as_bytes());
            let records: Vec<StringRecord> = reader.records().map(|record| record.unwrap()).collect();
            check_cells(&text, &records[0], 2, true).unwrap();
            let error = check_cells(&text, &records[1], 2, true).unwrap_err().to_string();
            let line = 3 + comment.matches('\n').count();
            let expected =
                format!("line {line}: expected 2 cells as in the header, found 3 (decimal comma or missing quotes?)");
            assert_eq!(error, expected, "{text:?}");
        }
    }
}
