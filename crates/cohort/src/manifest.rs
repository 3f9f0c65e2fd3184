//! Reads manifests: tables with one row for each surface to fit.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::{Component, Path, PathBuf};

use csv::StringRecord;
use spharm::parametrize::volume::is_volume;

use crate::error::CohortError;
use crate::files::ModelFiles;
use crate::table::{Table, decode, read_text};

const ID: &str = "id";
const SURFACE: &str = "surface";
const SPHERE: &str = "sphere";
const WEIGHTS: &str = "weights";
const OUTPUT: &str = "output";
const LABEL: &str = "label";
const SIGNAL_MASK: &str = "signal_mask";
/// Names of the columns that have a defined meaning in manifests.
const OWN: [&str; 7] = [ID, SURFACE, SPHERE, WEIGHTS, OUTPUT, LABEL, SIGNAL_MASK];
/// Largest length of an id in bytes. An id is used as a file name with an extension, and file names have at most 255
/// bytes.
const LONGEST_ID: usize = 200;

/// A surface to fit.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Row {
    /// Name of the surface in models and reports.
    pub id: String,
    /// Path of the mesh, signal or volume.
    pub surface: PathBuf,
    /// Path of the sphere of the fit, or `None` if the surface is mapped to a sphere during the run.
    pub sphere: Option<PathBuf>,
    /// Weights of the vertices, if the row specifies them: `uniform`, `area`, or the path of a file.
    pub weights: Option<PathBuf>,
    /// Path of a mask or label that marks the region in which the values of a signal are read. Values at other vertices
    /// are extrapolated from the edge of this region.
    pub region: Option<PathBuf>,
    /// Path of the model, relative to the folder of all models; `None` if the file is named by the id.
    pub output: Option<PathBuf>,
    /// Label of the surface, if the input is a volume.
    pub label: Option<i64>,
    /// Cells of the columns without a defined meaning, such as a group or an age. [`Manifest::columns`] has the names
    /// of these columns.
    pub extra: Vec<String>,
    /// Number of the row's line in its table, from 1; 0 for a row that isn't from a table.
    pub line: usize,
}

impl Row {
    /// Returns the path of the model in `folder`, the folder of all models. The file is `output`, with `.spharm.npz`
    /// appended unless it ends in `.npz`. If the row has no output, the file is `ID.spharm.npz`.
    #[must_use]
    pub fn model(&self, folder: &Path) -> PathBuf {
        match &self.output {
            Some(output) if is_model(output) => folder.join(output),
            Some(output) => {
                let mut name = folder.join(output).into_os_string();
                name.push(".spharm.npz");
                name.into()
            }
            None => folder.join(format!("{}.spharm.npz", self.id)),
        }
    }
}

/// Returns whether a file name has the extension of a model, `.npz`.
#[must_use]
pub fn is_model(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npz"))
}

/// A table of surfaces to fit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Manifest {
    /// Path of the table.
    pub path: PathBuf,
    /// Names of the columns without a defined meaning, in the order of [`Row::extra`].
    pub columns: Vec<String>,
    /// The rows, at least one, in the order of the table.
    pub rows: Vec<Row>,
}

/// Checks that a string is a valid id.
///
/// # Errors
///
/// A description of valid ids, if the string is empty, `.` or `..`, contains a path separator or a control character,
/// or is longer than 200 bytes. On Windows, also if the string is the name of a device, such as `con` or `con.left`, or
/// ends in a dot or a space.
pub fn check_id(text: &str) -> Result<(), &'static str> {
    match text {
        "" => Err("an id"),
        "." | ".." => Err("an id that can name a file"),
        _ if text.contains(['/', '\\']) => Err("an id without path separators"),
        _ if text.chars().any(char::is_control) => Err("an id without control characters"),
        _ if text.len() > LONGEST_ID => Err("an id of at most 200 bytes"),
        _ if cfg!(windows) && text.ends_with(['.', ' ']) => Err("an id that doesn't end in a dot or a space"),
        _ if cfg!(windows) && text.contains(['<', '>', ':', '"', '|', '?', '*']) => {
            Err("an id without < > : \" | ? *, which Windows doesn't allow in names of files")
        }
        _ if cfg!(windows) && is_device(text) => {
            Err("an id that isn't a name reserved by Windows, such as con or com1")
        }
        _ => Ok(()),
    }
}

/// Returns whether Windows treats a file name as the name of a device. The comparison ignores case and everything from
/// the first dot on.
fn is_device(name: &str) -> bool {
    let base = name.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let numbered =
        |device: &str| base.strip_prefix(device).is_some_and(|number| matches!(number.as_bytes(), [b'1'..=b'9']));
    ["con", "prn", "aux", "nul"].contains(&base.as_str()) || numbered("com") || numbered("lpt")
}

impl Manifest {
    /// Reads a manifest: UTF-8 text with a header, separated by commas if the file name ends in `.csv` and by tabs
    /// otherwise. The columns `id` and `surface` are required. The columns `sphere`, `weights`, `output`, `label` and
    /// `signal_mask` ([`Row::region`]) are optional, and their cells may be empty. Paths of inputs are relative to the
    /// manifest's folder. A byte-order mark, any kind of line endings, blank lines, lines that begin with `#`, and
    /// further columns are allowed.
    ///
    /// # Errors
    ///
    /// [`CohortError`] if the file can't be read or isn't UTF-8, if a column is missing, if a row has a wrong number of
    /// cells, if an id is empty, duplicate or invalid as a file name, if an output is duplicate, or if an unknown
    /// column has nearly the same name as a known one. The error names the line.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, CohortError> {
        let path = path.as_ref();
        Self::of_text(path, &read_text(path)?)
    }

    /// Parses a manifest from bytes, as if they were the contents of the file at `path`. See [`read`](Self::read).
    ///
    /// # Errors
    ///
    /// The errors of [`read`](Self::read).
    pub fn parse(path: impl AsRef<Path>, bytes: &[u8]) -> Result<Self, CohortError> {
        let path = path.as_ref();
        Self::of_text(path, &decode(path, bytes.to_vec())?)
    }

    /// Sets the label of all volumes that have neither a label of their own nor a sphere.
    pub fn label_volumes(&mut self, label: i64) {
        let unlabelled = |row: &&mut Row| row.label.is_none() && row.sphere.is_none() && is_volume(&row.surface);
        self.rows.iter_mut().filter(unlabelled).for_each(|row| row.label = Some(label));
    }

    /// Returns the folder to which paths in the manifest are relative; empty for the current folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        folder_of(&self.path)
    }

    fn of_text(path: &Path, text: &str) -> Result<Self, CohortError> {
        let table = Table::new(path, text);
        let (header, line) = table.header()?;
        let columns = Columns::new(path, line, header)?;
        let (mut rows, mut is_header) = (Vec::new(), true);
        table.records(|line, record| {
            if !std::mem::take(&mut is_header) {
                rows.push(columns.row(path, line, record)?);
            }
            Ok(true)
        })?;
        if rows.is_empty() {
            return Err(CohortError::NoRows { path: path.to_owned() });
        }
        check_once(path, &rows)?;
        Ok(Self { path: path.to_owned(), columns: columns.extra.into_iter().map(|(name, _)| name).collect(), rows })
    }

    /// Returns the text of a manifest with only the rows that `keep` accepts, to be written to `to`. Comments are
    /// omitted. If `to` is in another folder than this manifest, the paths of inputs are made absolute.
    ///
    /// # Errors
    ///
    /// The errors of [`read`](Self::read), and [`CohortError::Io`] if the current folder is unknown.
    pub fn rest(&self, to: &Path, keep: impl Fn(&Row) -> bool) -> Result<Vec<u8>, CohortError> {
        let io = |source| CohortError::Io { path: to.to_owned(), action: "write", source };
        let elsewhere = absolute(folder_of(to)).map_err(io)? != absolute(self.folder()).map_err(io)?;
        let text = read_text(&self.path)?;
        let table = Table::new(&self.path, &text);
        let (mut writer, mut number) = (Table::new(to, "").writer(), None);
        let mut moved: Vec<bool> = Vec::new();
        table.records(|_, record| {
            let Some(row) = number else {
                moved = record.iter().map(|name| [SURFACE, SPHERE, WEIGHTS, SIGNAL_MASK].contains(&name)).collect();
                number = Some(0);
                writer.write_record(record).map_err(|error| io(std::io::Error::other(error)))?;
                return Ok(true);
            };
            number = Some(row + 1);
            if self.rows.get(row).is_some_and(&keep) {
                let cells = record.iter().zip(&moved).map(|(cell, &moved)| {
                    let is_path = moved && elsewhere && !cell.is_empty() && !["uniform", "area"].contains(&cell);
                    let place = || absolute(&self.folder().join(cell)).map(|path| path.to_string_lossy().into_owned());
                    if is_path { place().map_err(io) } else { Ok(cell.to_owned()) }
                });
                let cells = cells.collect::<Result<Vec<String>, _>>()?;
                writer.write_record(cells).map_err(|error| io(std::io::Error::other(error)))?;
            }
            Ok(true)
        })?;
        writer.into_inner().map_err(|error| io(std::io::Error::other(error.to_string())))
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

/// Returns an absolute path without `.` and `..`. Symbolic links aren't resolved.
fn absolute(path: &Path) -> std::io::Result<PathBuf> {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    Ok(tidy(&std::path::absolute(path)?))
}

/// Removes each `.` from a path, and each `..` together with the folder before it, if any.
fn tidy(path: &Path) -> PathBuf {
    let mut tidy = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir if matches!(tidy.components().next_back(), Some(Component::Normal(_))) => {
                tidy.pop();
            }
            component => tidy.push(component),
        }
    }
    tidy
}

/// Indices of the columns in a row's cells.
struct Columns {
    cells: usize,
    /// Indices of the columns in [`OWN`]; `None` for a missing column.
    own: [Option<usize>; 7],
    extra: Vec<(String, usize)>,
}

impl Columns {
    fn new(path: &Path, line: usize, header: Vec<String>) -> Result<Self, CohortError> {
        if let Some((_, name)) = header.iter().enumerate().find(|(at, name)| header[..*at].contains(name)) {
            return Err(CohortError::ColumnTwice { path: path.to_owned(), line, column: name.clone() });
        }
        let own = OWN.map(|name| header.iter().position(|found| found == name));
        for (column, found) in [(ID, own[0]), (SURFACE, own[1])] {
            if found.is_none() {
                let hint = match &header[..] {
                    [one] if one.contains('\t') => "; the name of a table with tabs must end in .tsv",
                    [one] if one.contains(',') => "; the name of a table with commas must end in .csv",
                    [one] if one.contains(';') => "; separate the cells by tabs, or by commas in a .csv",
                    _ => "",
                };
                return Err(CohortError::NoColumn { path: path.to_owned(), line, column, found: header, hint });
            }
        }
        for column in header.iter().filter(|name| !OWN.contains(&name.as_str())) {
            if let Some(nearest) = OWN.into_iter().find(|own| is_nearly(column, own)) {
                return Err(CohortError::NearlyColumn { path: path.to_owned(), line, column: column.clone(), nearest });
            }
        }
        let cells = header.len();
        let extra = header.into_iter().enumerate().filter(|(_, name)| !OWN.contains(&name.as_str()));
        Ok(Self { cells, own, extra: extra.map(|(at, name)| (name, at)).collect() })
    }

    fn row(&self, path: &Path, line: usize, record: &StringRecord) -> Result<Row, CohortError> {
        if record.len() != self.cells {
            let (expected, found) = (self.cells, record.len());
            return Err(CohortError::Cells { path: path.to_owned(), line, expected, found });
        }
        let refuse = |column, expected, found: &str| CohortError::Cell {
            path: path.to_owned(),
            line,
            column,
            expected,
            found: shown(found),
        };
        let cell = |column: usize| self.own[column].and_then(|at| record.get(at)).unwrap_or_default();
        for (column, name) in OWN.iter().enumerate().skip(1) {
            if cell(column).chars().any(char::is_control) {
                return Err(refuse(name, "text without control characters", cell(column)));
            }
        }
        let (id, surface) = (cell(0), cell(1));
        check_id(id).map_err(|expected| refuse(ID, expected, id))?;
        if surface.is_empty() {
            return Err(refuse(SURFACE, "a file", surface));
        }
        let folder = folder_of(path);
        let input = |column| Some(cell(column)).filter(|cell| !cell.is_empty()).map(|cell| folder.join(cell));
        let weights = match cell(3) {
            word @ ("uniform" | "area") => Some(word.into()),
            _ => input(3),
        };
        let label = Some(cell(5)).filter(|cell| !cell.is_empty()).map(str::parse).transpose();
        let output = cell(4);
        if output.ends_with(['/', '\\']) || Path::new(output).file_name().is_none() && !output.is_empty() {
            return Err(refuse(OUTPUT, "a file", output));
        }
        Ok(Row {
            id: id.to_owned(),
            surface: folder.join(surface),
            sphere: input(2),
            weights,
            region: input(6),
            output: Some(output).filter(|output| !output.is_empty()).map(PathBuf::from),
            label: label.map_err(|_| refuse(LABEL, "a whole number", cell(5)))?,
            extra: self.extra.iter().map(|&(_, at)| record[at].to_owned()).collect(),
            line,
        })
    }
}

/// Returns whether a column's name may be a misspelling of `own`: it differs only by case, or by one letter that is
/// inserted, missing, replaced or swapped.
fn is_nearly(column: &str, own: &str) -> bool {
    let lower = column.trim().to_lowercase();
    // `weight` isn't treated as a misspelling of `weights`, because it may be a covariate such as body weight. Names of
    // two letters are too short for such a comparison.
    lower == own || lower != "weight" && own.len() > 2 && strsim::damerau_levenshtein(&lower, own) == 1
}

/// Returns a cell in quotation marks for error messages. A long cell is shortened.
fn shown(cell: &str) -> String {
    match cell.chars().count() {
        0 => "nothing".to_owned(),
        count if count > 60 => {
            format!("{:?} and {} more characters", cell.chars().take(60).collect::<String>(), count - 60)
        }
        _ => format!("{cell:?}"),
    }
}

/// Refuses a manifest in which an id or output occurs twice.
fn check_once(path: &Path, rows: &[Row]) -> Result<(), CohortError> {
    let twice = |row: &Row, what, value: &str, first| CohortError::Twice {
        path: path.to_owned(),
        line: row.line,
        what,
        value: value.to_owned(),
        first,
    };
    let mut ids = HashMap::with_capacity(rows.len());
    for row in rows {
        if let Some(first) = ids.insert(row.id.as_str(), row.line) {
            return Err(twice(row, ID, &row.id, first));
        }
    }
    // If no row has an output, models are named by their ids, which have been checked above.
    if rows.iter().all(|row| row.output.is_none()) {
        return Ok(());
    }
    let mut outputs = HashMap::with_capacity(rows.len());
    for row in rows {
        // The other files of a model have the model's name without `.spharm.npz`. Compare the models by this shorter
        // name, because two models with the same shorter name in one folder would share files.
        let files = ModelFiles { model: tidy(&row.model(Path::new(""))) };
        match outputs.entry(files.model.with_file_name(files.file_name())) {
            Entry::Occupied(first) => {
                return Err(twice(row, OUTPUT, &row.model(Path::new("")).to_string_lossy(), *first.get()));
            }
            Entry::Vacant(new) => drop(new.insert(row.line)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_devices_are_invalid_ids_on_windows() {
        for name in ["con", "NUL", "aux.left", "Com1", "lpt9.", "prn .x"] {
            assert!(is_device(name), "{name}");
            assert_eq!(check_id(name).is_err(), cfg!(windows), "{name}");
        }
        for name in ["control", "com", "com0", "com10", "sub-con", "a.nul"] {
            assert!(!is_device(name) && check_id(name).is_ok(), "{name}");
        }
        assert_eq!(check_id("a.").is_err(), cfg!(windows));
    }
}
