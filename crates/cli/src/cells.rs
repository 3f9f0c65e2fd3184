//! Checks that the rows of a table have the expected number of cells.

use anyhow::{Result, bail};
use csv::StringRecord;
use spharm_cohort::{line_of_record, wrong_cells};

/// Checks that a record (a row of a table) has `expected` cells, the number of cells in the header. The error states
/// the line number of the record. `text` is the text of the table. `comments` states whether lines that begin with `#`
/// are skipped.
///
/// # Errors
///
/// If the number of cells differs.
pub fn check_cells(text: &str, record: &StringRecord, expected: usize, comments: bool) -> Result<()> {
    let found = record.len();
    if found == expected {
        return Ok(());
    }
    let start = record.position().map_or(0, |start| start.byte() as usize);
    bail!(wrong_cells(line_of_record(text, start, comments), expected, found))
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
