//! Reads and writes landmarks as tables: `name,x,y,z`, and 3D Slicer's former format for fiducials (`.fcsv`), whose
//! header is in comments.
//!
//! In some locales, spreadsheet programs write semicolons instead of commas. A cell that contains the separator or a
//! quotation mark is quoted as in RFC 4180.

use super::{Frame, Gathered, Landmarks};
use crate::geometry::Vec3;
use crate::io::flaw::{Flaw, shown};

/// Accepted headings for the column with the landmarks' names.
const NAMES: [&str; 4] = ["name", "label", "id", "landmark"];
/// The columns assumed for a fiducials file that doesn't list its columns.
const FIDUCIALS: &str = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID";

/// Indices of the columns of a table.
struct Columns {
    name: usize,
    /// The column used instead of `name` in rows whose name is empty.
    id: Option<usize>,
    at: [usize; 3],
    /// Number of columns in the table.
    count: usize,
}

/// Splits a table's nonempty lines into cells. Returns the number of each line, counted from 1, and its cells.
fn rows(text: &str, separator: u8) -> impl Iterator<Item = (usize, Vec<String>)> {
    text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).map(move |(number, line)| {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .delimiter(separator)
            .flexible(true)
            .from_reader(line.as_bytes());
        // Parsing can't fail, because a line is UTF-8 text and always forms one record, regardless of its quotation
        // marks.
        let cells = reader.records().next().and_then(Result::ok).unwrap_or_default();
        (number + 1, cells.iter().map(|cell| cell.trim().to_owned()).collect())
    })
}

/// Returns the separator of a .csv table: a semicolon if the first line has semicolons and no comma.
pub(super) fn separator(text: &str) -> u8 {
    let first = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    if first.contains(';') && !first.contains(',') { b';' } else { b',' }
}

/// Returns whether a cell marks a coordinate as missing, in the notation of R or pandas.
fn is_missing(cell: &str) -> bool {
    cell.is_empty() || cell.eq_ignore_ascii_case("na") || cell.eq_ignore_ascii_case("nan")
}

/// Reads a table of `name,x,y,z`. The first line is treated as headings if it has a cell `x` and fewer than three
/// numbers; the columns may then be in any order.
pub(super) fn read(text: &str, separator: u8) -> Result<Landmarks, Flaw> {
    let mut found = Gathered::default();
    let mut columns = None;
    for (line, cells) in rows(text, separator) {
        if columns.is_none() {
            let numbers = cells.iter().filter(|cell| cell.parse::<f64>().is_ok()).count();
            if numbers < 3 && cells.iter().any(|cell| cell.eq_ignore_ascii_case("x")) {
                columns = Some(header(&cells, line)?);
                continue;
            }
        }
        let columns = columns.get_or_insert(Columns { name: 0, id: None, at: [1, 2, 3], count: 4 });
        row(&mut found, columns, &cells, line)?;
    }
    Ok(found.landmarks(None))
}

/// Reads a file of Slicer's fiducials.
pub(super) fn read_fiducials(text: &str) -> Result<Landmarks, Flaw> {
    let mut found = Gathered::default();
    let mut columns = header(&FIDUCIALS.split(',').map(str::to_owned).collect::<Vec<_>>(), 1)?;
    // Files from before Slicer 4.11 don't specify a frame. Their positions are in RAS.
    let mut frame = Frame::Ras;
    for (number, line) in text.lines().enumerate().filter(|(_, line)| line.starts_with('#')) {
        let Some((key, value)) = line.trim_start_matches('#').split_once('=') else { continue };
        match key.trim() {
            "CoordinateSystem" => {
                frame = Frame::named(value).ok_or_else(|| {
                    let expected = format!("LPS, RAS, 0 or 1 as the CoordinateSystem on line {}", number + 1);
                    Flaw::new(expected, shown(value.trim().as_bytes()))
                })?;
            }
            "columns" => {
                let names: Vec<String> = value.split(',').map(|name| name.trim().to_owned()).collect();
                columns = header(&names, number + 1)?;
            }
            _ => {}
        }
    }
    for (line, cells) in rows(text, b',').filter(|(_, cells)| !cells.first().is_some_and(|cell| cell.starts_with('#')))
    {
        row(&mut found, &columns, &cells, line)?;
    }
    Ok(found.landmarks(Some(frame)))
}

fn header(cells: &[String], line: usize) -> Result<Columns, Flaw> {
    let find = |name: &str| cells.iter().position(|cell| cell.eq_ignore_ascii_case(name));
    let missing =
        |what: &str| Flaw::new(format!("a column named {what} on line {line}"), shown(cells.join(",").as_bytes()));
    let mut at = [0; 3];
    for (place, name) in at.iter_mut().zip(["x", "y", "z"]) {
        *place = find(name).ok_or_else(|| missing(name))?;
    }
    let name = NAMES.iter().find_map(|name| find(name)).ok_or_else(|| missing("name"))?;
    Ok(Columns { name, id: find("id"), at, count: cells.len() })
}

fn row(found: &mut Gathered, columns: &Columns, cells: &[String], line: usize) -> Result<(), Flaw> {
    if cells.len() != columns.count {
        return Err(Flaw::new(format!("{} cells on line {line}", columns.count), cells.len().to_string()));
    }
    if columns.at.iter().all(|&column| is_missing(&cells[column])) {
        return Ok(());
    }
    let mut point: Vec3 = [0.0; 3];
    for (x, &column) in point.iter_mut().zip(&columns.at) {
        let cell = &cells[column];
        *x = cell.parse().map_err(|_| {
            Flaw::new(format!("a coordinate in cell {} of line {line}", column + 1), shown(cell.as_bytes()))
        })?;
    }
    let name = [Some(columns.name), columns.id].into_iter().flatten().map(|column| cells[column].as_str());
    let name = name.into_iter().find(|name| !name.is_empty()).unwrap_or_default();
    found.add(&format!("line {line}"), name, point)
}

/// Returns a table with a heading line. Numbers are written such that they read back exactly.
pub(super) fn text(landmarks: &Landmarks, separator: u8) -> Vec<u8> {
    let s = char::from(separator);
    let mut text = format!("name{s}x{s}y{s}z\n");
    for (name, [x, y, z]) in landmarks.names.iter().zip(&landmarks.points) {
        text += &format!("{}{s}{x:?}{s}{y:?}{s}{z:?}\n", quoted(name, s));
    }
    text.into_bytes()
}

/// Returns a fiducials file as written by Slicer 4.11.
pub(super) fn fiducials(landmarks: &Landmarks) -> Vec<u8> {
    let frame = landmarks.frame.unwrap_or(Frame::Lps).name();
    let mut text =
        format!("# Markups fiducial file version = 4.11\n# CoordinateSystem = {frame}\n# columns = {FIDUCIALS}\n");
    for (number, (name, [x, y, z])) in landmarks.names.iter().zip(&landmarks.points).enumerate() {
        text += &format!("{},{x:?},{y:?},{z:?},0,0,0,1,1,1,0,{},,\n", number + 1, quoted(name, ','));
    }
    text.into_bytes()
}

/// Returns a name as a table cell. Newlines are replaced by spaces.
fn quoted(name: &str, separator: char) -> String {
    let name = name.replace(['\n', '\r'], " ");
    if name.contains([separator, '"', '#']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name }
}
