//! Reads and writes tables of values: a row per vertex and a column per channel, after an optional line of column
//! names.

use std::io::{self, Write};

use super::flaw::{Flaw, shown};
use super::spec::FormatSpec;
use super::text::{lines, number};
use crate::mesh::Signal;

/// Reads a table like [`read_columns`], but returns only the signal.
pub(super) fn read(bytes: &[u8], separator: u8) -> Result<Signal, Flaw> {
    Ok(read_columns(bytes, separator)?.0)
}

/// Reads a table whose cells are separated by `separator`. Returns its values and facts about its columns. The first
/// line is treated as column names if one of its cells isn't a number. Columns with row numbers are left out, see
/// [`counts_rows`].
pub(super) fn read_columns(bytes: &[u8], separator: u8) -> Result<(Signal, Columns), Flaw> {
    let mut signal = all_columns(bytes, separator)?;
    let mut names = names(bytes, separator);
    let mut index = Vec::new();
    // Columns are visited from last to first, because leaving out a column shifts the columns after it.
    for column in (0..names.len()).rev() {
        if is_index(&names[column]) && counts_rows(&signal, column, &names[column])? {
            signal = without_column(signal, column);
            index.push(names.remove(column));
        }
    }
    index.reverse();
    let plain = separator == b',' && names.is_empty() && signal.channels == 2;
    let decimal_commas = if plain { decimal_commas(bytes) } else { None };
    Ok((signal, Columns { names, index, decimal_commas }))
}

/// Reads all columns of a table. Missing values become NaN. A blank line between the rows of a table of one column is a
/// missing value.
fn all_columns(bytes: &[u8], separator: u8) -> Result<Signal, Flaw> {
    let mut values: Vec<f64> = Vec::new();
    let (mut vertices, mut channels) = (0, None);
    // `has_number` states for each column whether it has a number, which may be NaN. `blank` is the number of blank
    // lines since the last row.
    let (mut has_number, mut blank): (Vec<bool>, usize) = (Vec::new(), 0);
    for (at, line) in lines(bytes) {
        if is_blank(line, separator) {
            blank += usize::from(channels == Some(1) && vertices > 0);
            continue;
        }
        if channels.is_none() && is_header(line, separator) {
            // A line of names determines the number of columns.
            channels = Some(cells(line, separator).count());
            continue;
        }
        let start = values.len() + blank;
        values.resize(start, f64::NAN);
        vertices += std::mem::take(&mut blank);
        for (column, cell) in cells(line, separator).map(unquoted).enumerate() {
            let found = number(cell);
            if found.is_none() && !is_missing(cell) {
                return Err(Flaw::new(format!("numbers on line {at}"), shown(cell)));
            }
            if column == has_number.len() {
                has_number.push(false);
            }
            has_number[column] |= found.is_some();
            values.push(found.unwrap_or(f64::NAN));
        }
        let found = values.len() - start;
        let wanted = *channels.get_or_insert(found);
        if found != wanted {
            let hint = hint(line, separator, found.saturating_sub(wanted), vertices == 0);
            return Err(Flaw::new(
                format!("{wanted} values on line {at}, as on the first line"),
                format!("{found}{hint}"),
            ));
        }
        vertices += 1;
    }
    if let Some(column) = has_number.iter().position(|has_number| !has_number) {
        return Err(Flaw::new(format!("numbers in column {}", column + 1), "only missing values"));
    }
    Ok(Signal { values, vertices, channels: channels.unwrap_or(0) })
}

/// Returns a possible reason for the surplus values of a row, or an empty string. `is_first` states whether the row is
/// the first one after the names.
fn hint(line: &[u8], separator: u8, surplus: usize, is_first: bool) -> &'static str {
    let has_points = line.contains(&b'.');
    match surplus {
        1 if has_points && is_first => " (do the row names lack a column name?)",
        1.. if !has_points && separator == b',' => " (are there decimal commas?)",
        _ => "",
    }
}

/// Returns the first line of a table that isn't blank.
fn first_row(bytes: &[u8], separator: u8) -> Option<&[u8]> {
    lines(bytes).map(|(_, line)| line).find(|line| !is_blank(line, separator))
}

/// Returns whether a line has no cells. If tabs separate the cells, a line of tabs has cells, although tabs are white
/// space.
fn is_blank(line: &[u8], separator: u8) -> bool {
    line.trim_ascii().is_empty() && !line.contains(&separator)
}

fn cells(line: &[u8], separator: u8) -> impl Iterator<Item = &[u8]> {
    line.split(move |&b| b == separator).map(<[u8]>::trim_ascii)
}

/// Removes the quotation marks around a cell. R puts quotation marks around row numbers, and pandas puts them around an
/// empty cell that is alone in its row.
fn unquoted(cell: &[u8]) -> &[u8] {
    cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\"")).unwrap_or(cell)
}

/// Returns whether a cell denotes a missing value: it is empty, or it is the mark for missing values of R or of a
/// spreadsheet program.
fn is_missing(cell: &[u8]) -> bool {
    [&b""[..], b"NA", b"N/A", b"#N/A"].iter().any(|mark| cell.eq_ignore_ascii_case(mark))
}

/// Returns whether the first line of a table has column names. This is the case if a cell is neither a number nor a
/// missing value, or if the first cell is empty, because an empty name is typical of an index column.
fn is_header(line: &[u8], separator: u8) -> bool {
    let is_value = |cell: &[u8]| number::<f64>(cell).is_some() || is_missing(cell);
    cells(line, separator).next().is_some_and(<[u8]>::is_empty) || !cells(line, separator).all(is_value)
}

/// Returns the names of a table's columns, or an empty vector if the table has no header.
fn names(bytes: &[u8], separator: u8) -> Vec<String> {
    let Some(line) = first_row(bytes, separator).filter(|line| is_header(line, separator)) else { return Vec::new() };
    let name = |cell: &[u8]| String::from_utf8_lossy(cell).trim_matches(['"', '#', ' ']).to_owned();
    cells(line, separator).map(name).collect()
}

/// Returns whether a column's name is typical of a column of row numbers. Pandas and R leave this name empty, and
/// pandas reads an empty name as `Unnamed: 0`.
fn is_index(name: &str) -> bool {
    names_vertices(name)
        || ["index", "id", ""].contains(&name.to_lowercase().as_str())
        || name.to_lowercase().starts_with("unnamed: ")
}

/// Returns whether a column's name states that its values are vertex numbers.
fn names_vertices(name: &str) -> bool {
    let name = name.to_lowercase().replace([' ', '_', '-', '.'], "");
    ["vertex", "vertexid", "vertexindex", "vertexno", "vertexnumber", "vno"].contains(&name.as_str())
}

/// Returns whether the values of a column are the row numbers, counted from 0 or 1. Returns an error if the values are
/// the row numbers in another order, or if `name` states vertex numbers but the values aren't row numbers. Returns
/// `false` if the table has only one column.
fn counts_rows(signal: &Signal, column: usize, name: &str) -> Result<bool, Flaw> {
    if signal.channels < 2 {
        return Ok(false);
    }
    let found: Vec<f64> = signal.values.iter().skip(column).step_by(signal.channels).copied().collect();
    let mut sorted = found.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let counts = |numbers: &[f64], first: usize| numbers.iter().zip(first..).all(|(x, row)| *x == row as f64);
    let is_count = |numbers: &[f64]| counts(numbers, 0) || counts(numbers, 1);
    if is_count(&found) {
        return Ok(true);
    }
    if is_count(&sorted) || names_vertices(name) {
        return Err(Flaw::unsupported(
            format!("a column {} that doesn't number the rows in order from 0 or 1", shown(name.as_bytes())),
            "sort the rows by vertex number; if they are already in the order of the vertices, remove the column",
        ));
    }
    Ok(false)
}

/// Returns the signal without the column at index `column`.
fn without_column(signal: Signal, column: usize) -> Signal {
    let Signal { values, vertices, channels } = signal;
    let kept = values.into_iter().enumerate().filter(|(i, _)| i % channels != column).map(|(_, x)| x).collect();
    Signal { values: kept, vertices, channels: channels - 1 }
}

/// Facts about the columns of a table. They are empty for files that aren't tables.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Columns {
    /// Names of the columns of values; empty if the table has no header.
    pub(crate) names: Vec<String>,
    /// Names of the columns that were left out because they have row numbers.
    pub(crate) index: Vec<String>,
    /// First row of the table if it has two columns that may be a single column of numbers with decimal commas;
    /// otherwise `None`.
    pub(crate) decimal_commas: Option<String>,
}

/// Returns the separator of the cells if a format is a table format.
pub(super) fn separator(format: &FormatSpec) -> Option<u8> {
    match format.endings {
        [".csv"] => Some(b','),
        [".tsv"] => Some(b'\t'),
        _ => None,
    }
}

/// Returns the first row of a table of two columns if each row may be a single number with a decimal comma, as in
/// `2,5000`. This is assumed if all cells are whole numbers and, in the second column, at least one number has a
/// leading zero, or all numbers have the same length of at least [`DECIMALS`]. Returns `None` if all numbers of the
/// first column have the same length of at least [`DECIMALS`], because the columns are then two channels.
fn decimal_commas(bytes: &[u8]) -> Option<String> {
    let (mut zero, mut same, mut lengths) = (false, [true; 2], None);
    for (_, line) in lines(bytes).filter(|(_, line)| !is_blank(line, b',')) {
        let line = line.trim_ascii();
        let at = line.iter().position(|&b| b == b',')?;
        let (whole, decimals) = (line[..at].strip_prefix(b"-").unwrap_or(&line[..at]), &line[at + 1..]);
        if [whole, decimals].iter().any(|digits| digits.is_empty() || !digits.iter().all(u8::is_ascii_digit)) {
            return None;
        }
        zero |= decimals.len() > 1 && decimals.starts_with(b"0");
        let found = [whole.len(), decimals.len()];
        let expected = *lengths.get_or_insert(found);
        same = [0, 1].map(|column| same[column] && found[column] == expected[column]);
    }
    let lengths = lengths?;
    let [channel, long] = [0, 1].map(|column| same[column] && lengths[column] >= DECIMALS);
    let first = first_row(bytes, b',').map(|line| String::from_utf8_lossy(line.trim_ascii()).into_owned());
    first.filter(|_| !channel && (zero || long))
}

/// Whole numbers of equal length may be the digits after a decimal comma if they have at least this number of digits.
const DECIMALS: usize = 3;

/// Writes values in digits that read back exactly, without column names.
pub(super) fn write(out: &mut dyn Write, signal: &Signal, separator: u8) -> io::Result<()> {
    for row in signal.values.chunks_exact(signal.channels) {
        for (i, x) in row.iter().enumerate() {
            if i > 0 {
                out.write_all(&[separator])?;
            }
            write!(out, "{x:?}")?;
        }
        out.write_all(b"\n")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_that_counts_the_rows_is_left_out() {
        for text in [
            "vertex,a\n0,5\n1,7\n",
            "a,Index\n5,1\n7,2\n",
            "\"\",a\n0,5\n1,7\n",
            "\"\",\"a\"\n\"1\",5\n\"2\",7\n",
            "vertex_id,a\n0,5\n1,7\n",
            "vno,a\n0,5\n1,7\n",
            "a,Vertex ID\n5,1\n7,2\n",
            "vertex_index,a\n1,5\n2,7\n",
        ] {
            assert_eq!(read(text.as_bytes(), b',').unwrap(), Signal::new(vec![5.0, 7.0], 2, 1), "{text}");
        }
        // A column `id` whose values aren't row numbers, such as ids of regions, is a channel.
        assert_eq!(read(b"id,a\n9,5\n9,7\n", b',').unwrap().channels, 2);
        assert_eq!(read(b"id\n0\n1\n", b',').unwrap().channels, 1);
    }

    #[test]
    fn all_columns_that_count_the_rows_are_left_out() {
        for (text, left_out) in [
            (",vertex,a\n0,0,5\n1,1,7\n", vec!["", "vertex"]),
            ("Unnamed: 0,a\n0,5\n1,7\n", vec!["Unnamed: 0"]),
            ("Unnamed: 0.1,a,Unnamed: 0\n0,5,1\n1,7,2\n", vec!["Unnamed: 0.1", "Unnamed: 0"]),
        ] {
            let (signal, columns) = read_columns(text.as_bytes(), b',').unwrap();
            assert_eq!(signal, Signal::new(vec![5.0, 7.0], 2, 1), "{text}");
            assert_eq!(columns.names, ["a"], "{text}");
            assert_eq!(columns.index, left_out, "{text}");
        }
        // Both names are typical of row numbers, but only the second column has row numbers. The first column is kept
        // as values.
        let (signal, columns) = read_columns(b"id,vertex\n9,0\n9,1\n", b',').unwrap();
        assert_eq!(signal.values, [9.0, 9.0]);
        assert_eq!(columns.names, ["id"]);
    }

    #[test]
    fn rows_in_another_order_are_refused() {
        for text in
            ["vertex,a\n1,5\n0,7\n", "id\ta\n2\t5\n1\t7\n", "vno,a\n10,5\n11,7\n", ",vertex,a\n10,10,5\n11,11,7\n"]
        {
            let separator = if text.contains(',') { b',' } else { b'\t' };
            let Err(Flaw::Unsupported { found, remedy }) = read(text.as_bytes(), separator) else { panic!("{text}") };
            assert!(found.contains("doesn't number the rows") && remedy.contains("sort the rows"), "{found}");
        }
    }

    #[test]
    fn missing_values_are_read_as_nan() {
        let column = [2.5, f64::NAN, 2.75];
        for (text, separator, channels, expected) in [
            ("a\n2.5\nNA\n2.75\n", b',', 1, &column[..]),
            ("a\n2.5\n\"\"\n2.75\n", b',', 1, &column),
            ("a\r\n2.5\r\n\r\n2.75\r\n\r\n", b',', 1, &column),
            ("\n2.5\n N/A\n2.75\n", b',', 1, &column),
            ("NA\n2.5\n", b',', 1, &[f64::NAN, 2.5]),
            ("vertex,a,b\n0,1,\n1,,2\n2,NaN,#N/A\n", b',', 2, &[1.0, f64::NAN, f64::NAN, 2.0, f64::NAN, f64::NAN]),
            ("1\t2\n\t\n3\tna\n\n", b'\t', 2, &[1.0, 2.0, f64::NAN, f64::NAN, 3.0, f64::NAN]),
        ] {
            let signal = read(text.as_bytes(), separator).unwrap();
            let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!((signal.channels, signal.vertices), (channels, expected.len() / channels), "{text}");
            assert_eq!(bits(&signal.values), bits(expected), "{text}");
        }
        for (text, expected) in [
            ("a\n2.5\nnone\n", "numbers on line 3"),
            ("a,b\n2.5,\n2.75,NA\n", "numbers in column 2"),
            ("a,b\n2.5,\n2.75\n", "2 values on line 3, as on the first line"),
        ] {
            let error = read(text.as_bytes(), b',').unwrap_err();
            assert!(matches!(&error, Flaw::Malformed { expected: found, .. } if found == expected), "{error:?}");
        }
    }

    #[test]
    fn decimal_commas_are_suspected() {
        for (text, suspected) in [
            ("2,5000\n-3,2500\n", true),
            ("2,5\n3,05\n", true),
            ("2,5\n3,7\n", false),
            ("2,500\n3,1\n", false),
            ("2,5000\n3.5,2500\n", false),
            ("2,0\n3,0\n", false),
            ("2,-500\n3,-250\n", false),
            ("1022,1031\n1180,1204\n", false),
            ("98,103\n102,118\n", true),
        ] {
            assert_eq!(decimal_commas(text.as_bytes()).is_some(), suspected, "{text}");
        }
    }

    #[test]
    fn surplus_values_are_explained() {
        for (text, expected) in [
            ("thickness\n2,5\n", "2 (are there decimal commas?)"),
            ("thickness,area\n1,2.5,3.1\n2,2.7,3.3\n", "3 (do the row names lack a column name?)"),
            ("thickness\n1,2.5,3.1\n", "3"),
            ("1,2.5\n1,2.5,3.1\n", "3"),
        ] {
            let error = read(text.as_bytes(), b',').unwrap_err();
            let Flaw::Malformed { found, .. } = error else { panic!("{error:?}") };
            assert_eq!(found, expected, "{text}");
        }
    }
}
