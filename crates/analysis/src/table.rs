//! Reads tables of subjects: CSV, or TSV if the name ends in .tsv.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use spharm::shape::stats::Column;
use spharm_cli::cells::check_cells;
use spharm_cli::inputs::read_text;
use spharm_cli::paths::model_name;
use spharm_cohort::Manifest;

/// A table of subjects, from which the design of a test is built.
pub trait Subjects {
    /// Returns the number of subjects.
    fn count(&self) -> usize;

    /// Returns the names of the columns.
    fn names(&self) -> Vec<&str>;

    /// Returns the cells of a column.
    ///
    /// # Errors
    ///
    /// If there is no such column, or a cell has no value.
    fn cells(&self, column: &str) -> Result<Vec<&str>>;

    /// Returns the name of the table and the number of the row with index `row`, for error messages.
    fn place(&self, row: usize) -> String;
}

/// A table with a header.
pub struct Table {
    path: PathBuf,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// Maximum size of a table in bytes; the tables of studies are far smaller.
const LARGEST: u64 = 64 << 20;

impl Table {
    /// Reads a table: RFC 4180 with commas, or tabs if the name ends in .tsv; with or without a byte-order mark.
    ///
    /// # Errors
    ///
    /// If the file can't be read, or isn't a table with a header, rows of equal length and distinct columns.
    pub fn read(path: &Path) -> Result<Self> {
        let named = || path.display().to_string();
        let text = read_text(path, "table", LARGEST)?;
        let tabs = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("tsv"));
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(if tabs { b'\t' } else { b',' })
            .trim(csv::Trim::All)
            .flexible(true)
            .from_reader(text.as_bytes());
        let header: Vec<String> = reader.headers().with_context(named)?.iter().map(str::to_owned).collect();
        if let Some(twice) = header.iter().enumerate().find(|(at, name)| header[..*at].contains(name)) {
            bail!("{}: duplicate column {:?}", path.display(), twice.1);
        }
        if let ([whole], false) = (&header[..], tabs) {
            let other = [(';', "semicolons"), ('\t', "tabs")].into_iter().find(|(mark, _)| whole.contains(*mark));
            if let Some((_, marks)) = other {
                let name = path.display();
                bail!(
                    "{name}: expected commas between cells, or tabs in a file named .tsv; found {marks} in the header"
                );
            }
        }
        let rows = reader.records().map(|record| -> Result<Vec<String>> {
            let record = record?;
            check_cells(&text, &record, header.len(), false)?;
            Ok(record.iter().map(str::to_owned).collect())
        });
        let rows: Vec<Vec<String>> = rows.collect::<Result<_>>().with_context(named)?;
        if rows.is_empty() {
            bail!("{}: the table has no rows", path.display());
        }
        Ok(Self { path: path.to_owned(), header, rows })
    }

    /// Returns whether a column of this name exists.
    pub fn has(&self, name: &str) -> bool {
        self.header.iter().any(|other| other == name)
    }

    /// Returns the number of rows.
    pub(crate) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Returns the names of the columns.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.header.iter().map(String::as_str)
    }

    /// Returns the path of the table.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the cells of a column, which may be empty.
    ///
    /// # Errors
    ///
    /// If there is no such column.
    pub fn texts(&self, name: &str) -> Result<Vec<&str>> {
        let Some(column) = self.header.iter().position(|other| other == name) else {
            bail!("{}: no column {name:?}; the columns are {}", self.path.display(), self.header.join(", "));
        };
        Ok(self.rows.iter().map(|row| row[column].as_str()).collect())
    }

    /// Returns the cells of a column.
    ///
    /// # Errors
    ///
    /// If there is no such column, or a cell is empty or a missing value.
    pub fn cells(&self, name: &str) -> Result<Vec<&str>> {
        let cells = self.texts(name)?;
        if let Some(row) = cells.iter().position(|cell| cell.is_empty()) {
            bail!("{}: row {}: the cell in column {name:?} is empty; remove the subject", self.path.display(), row + 1);
        }
        // A missing value would become an additional level, and would turn a column of numbers into a column of
        // levels.
        if let Some(row) = cells.iter().position(|cell| is_missing(cell)) {
            let found = cells[row];
            bail!(
                "{}: row {}: the cell in column {name:?} is {found}, a missing value; remove the subject",
                self.path.display(),
                row + 1
            );
        }
        Ok(cells)
    }

    /// Returns a column of numbers or levels.
    pub(crate) fn column(&self, name: &str) -> Result<Column> {
        let cells = self.cells(name)?;
        column_of(&cells).map_err(|row| {
            anyhow!("{}: row {}: column {name:?}: {}", self.path.display(), row + 1, no_number(cells[row]))
        })
    }

    /// Returns a column of numbers.
    ///
    /// # Errors
    ///
    /// The errors of [`Self::cells`], and an error if a cell isn't a number.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>> {
        match self.column(name)? {
            Column::Numbers(numbers) => Ok(numbers),
            Column::Levels(_) => bail!("{}: column {name:?}: expected numbers, found text", self.path.display()),
        }
    }

    /// Returns a column of paths. Relative paths in the column start from the table's folder. Equal cells are an error.
    pub(crate) fn paths(&self, name: &str) -> Result<Vec<PathBuf>> {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        Ok(self.different(name)?.into_iter().map(|cell| folder.join(cell)).collect())
    }

    /// Returns the cells of a column in which no two cells are equal.
    ///
    /// # Errors
    ///
    /// The errors of [`Self::cells`], and an error if two cells are equal.
    pub fn different(&self, name: &str) -> Result<Vec<&str>> {
        let cells = self.cells(name)?;
        if let Some(row) = (1..cells.len()).find(|row| cells[..*row].contains(&cells[*row])) {
            bail!("{}: row {}: {:?} is already in an earlier row", self.path.display(), row + 1, cells[row]);
        }
        Ok(cells)
    }
}

impl Subjects for Table {
    fn count(&self) -> usize {
        self.len()
    }

    fn names(&self) -> Vec<&str> {
        self.names().collect()
    }

    fn cells(&self, column: &str) -> Result<Vec<&str>> {
        self.cells(column)
    }

    fn place(&self, row: usize) -> String {
        format!("{}: row {}", self.path.display(), row + 1)
    }
}

/// Name of the column with the landmark files.
pub const LANDMARKS: &str = "landmarks";

/// Returns the files named by a column of a `table` of surfaces, one per row. Relative paths in the column start from
/// the table's folder. Returns `None` if the table has no such column.
///
/// # Errors
///
/// If a cell is empty.
pub fn files_of(manifest: &Manifest, column: &str, table: &Path) -> Result<Option<Vec<PathBuf>>> {
    let Some(at) = manifest.columns.iter().position(|name| name == column) else { return Ok(None) };
    let folder = table.parent().unwrap_or(Path::new(""));
    let files = manifest.rows.iter().map(|row| match row.extra.get(at).map_or("", |cell| cell.trim()) {
        "" => bail!("{}: {}: expected a file in column {column}, found nothing", table.display(), row.id),
        cell => Ok(folder.join(cell)),
    });
    files.collect::<Result<_>>().map(Some)
}

/// Returns the finite number in a cell; `None` if the cell has other text. The minus sign U+2212 is read as a hyphen.
pub fn finite(cell: &str) -> Option<f64> {
    cell.trim().replace('\u{2212}', "-").parse().ok().filter(|number: &f64| number.is_finite())
}

/// Returns a column of numbers or of levels. If most cells are numbers, a cell that isn't a number is an error, because
/// it would turn the whole column into levels and so change the tested hypothesis.
///
/// # Errors
///
/// Returns the index of the row whose cell isn't a number.
pub fn column_of(cells: &[&str]) -> Result<Column, usize> {
    let is_number = |cell: &str| finite(cell).is_some();
    // Numbers with a decimal comma, such as 30,5, are meant as numbers rather than levels.
    let is_meant = |cell: &&&str| is_number(cell) || is_number(&cell.replace(',', "."));
    let meant = cells.iter().filter(is_meant).count();
    match cells.iter().position(|cell| !is_number(cell)) {
        Some(row) if 2 * meant > cells.len() => Err(row),
        _ => Ok(Column::of(cells.iter().copied())),
    }
}

/// Returns the error message for a cell that isn't a number in a column of numbers, with the remedy.
pub(crate) fn no_number(cell: &str) -> String {
    format!(
        "expected a number, as in most rows, found {cell:?}; write a number such as 30.5, or omit the subject; if the \
         column has levels, write words such as site1"
    )
}

/// Returns whether a cell is a missing value as written by R, BIDS, SPSS, Python and pandas, or a number that isn't
/// finite.
pub fn is_missing(cell: &str) -> bool {
    let words = ["na", "n/a", "#n/a", "<na>", ".", "-", "?", "none", "null"];
    words.iter().any(|word| cell.eq_ignore_ascii_case(word))
        || cell.parse::<f64>().is_ok_and(|number| !number.is_finite())
}

/// Returns the index of each model's row: the row whose cell is the model's path, or else the row whose cell has its
/// name.
///
/// # Errors
///
/// If a model has no row, if several rows have the name of a model, or if two models have the same row.
pub fn rows_of(cells: Vec<&str>, models: &[PathBuf]) -> Result<Vec<usize>> {
    let named = || cells.iter().enumerate().filter(|(_, cell)| !is_missing(cell));
    let paths: HashMap<&Path, usize> = named().map(|(row, cell)| (Path::new(*cell), row)).collect();
    let mut names: HashMap<String, Vec<usize>> = HashMap::new();
    for (row, cell) in named() {
        names.entry(model_name(Path::new(cell))).or_default().push(row);
    }
    let mut taken: HashMap<usize, &Path> = HashMap::new();
    let row = |model: &PathBuf| match paths.get(model.as_path()) {
        Some(row) => Ok(*row),
        None => match names.get(&model_name(model)).map(Vec::as_slice) {
            Some([row]) => Ok(*row),
            Some(_) => bail!("several rows are named {:?}; write the models' paths in this column", model_name(model)),
            None => bail!("no row for {:?}", model_name(model)),
        },
    };
    let mut rows = Vec::with_capacity(models.len());
    for model in models {
        let row = row(model)?;
        if let Some(other) = taken.insert(row, model) {
            bail!(
                "{} and {} match the same row of the table; write the models' paths in the table",
                other.display(),
                model.display()
            );
        }
        rows.push(row);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(name: &str, text: &[u8]) -> Result<Table> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join(name);
        std::fs::write(&path, text)?;
        Table::read(&path)
    }

    #[test]
    fn commas_tabs_marks_and_quotes() {
        let found = table("a.csv", "\u{feff}model,age\r\n\"a,b.npz\", 31\r\nc.npz,2.5\r\n".as_bytes()).unwrap();
        assert_eq!(found.column("age").unwrap(), Column::Numbers(vec![31.0, 2.5]));
        assert!(found.paths("model").unwrap()[0].ends_with("a,b.npz"));
        let found = table("a.tsv", b"model\tgroup\nx\tpatient\ny\tcontrol\n").unwrap();
        assert_eq!(found.column("group").unwrap(), Column::Levels(vec!["patient".into(), "control".into()]));
    }

    #[test]
    fn tables_that_are_none_are_refused() {
        for text in ["model,age\n", "model,model\na,b\n", "model,age\na\n", ""] {
            assert!(table("a.csv", text.as_bytes()).is_err(), "{text:?}");
        }
        assert!(table("a.csv", b"model\n\xff\n").is_err());
        for (text, marks) in [("model;age\na;3\n", "semicolons"), ("model\tage\na\t3\n", "tabs")] {
            let error = table("a.csv", text.as_bytes()).err().unwrap().to_string();
            assert!(error.contains(marks) && error.contains(".tsv"), "{error}");
        }
        for cell in ["NA", "n/a", "NaN", ".", "inf", "None", "NULL", "-", "?"] {
            let found = table("a.csv", format!("model,age\na,3\nb,{cell}\n").as_bytes()).unwrap();
            let error = found.column("age").unwrap_err().to_string();
            assert!(error.contains("row 2") && error.contains(cell), "{error}");
        }
        for (cell, other) in [("50y", "31"), ("thirty", "31"), ("\"30,5\"", "\"31,5\"")] {
            let text = format!("model,age\na,30\nb,{cell}\nc,{other}\n");
            let error = table("a.csv", text.as_bytes()).unwrap().column("age").unwrap_err().to_string();
            assert!(error.contains("row 2: column \"age\"") && error.contains(cell.trim_matches('"')), "{error}");
        }
        let error = format!("{:#}", table("a.csv", b"model,age\r\na,3\r\nb,4,5\r\n").err().unwrap());
        assert!(error.contains("a.csv: line 3: expected 2 cells as in the header, found 3"), "{error}");
        let found = table("a.csv", b"model,age\na,\na,3\n").unwrap();
        assert!(found.column("age").is_err() && found.column("sex").is_err() && found.paths("model").is_err());
    }

    #[test]
    fn models_of_one_name_have_rows_of_their_own_or_are_refused() {
        let models = ["a/s0.spharm.npz", "b/s0.spharm.npz"].map(PathBuf::from);
        assert_eq!(rows_of(vec!["b/s0.spharm.npz", "a/s0.spharm.npz"], &models).unwrap(), [1, 0]);
        let error = |cells: &[&str]| rows_of(cells.to_vec(), &models).unwrap_err().to_string();
        assert!(error(&["s0", "s1"]).contains("match the same row"));
        assert!(error(&["c/s0", "d/s0"]).contains("several rows are named \"s0\""));
        assert!(error(&["s1"]).contains("no row for \"s0\""));
        // The cell "n/a" isn't the path of a model called a.
        assert!(rows_of(vec!["n/a"], &["a.spharm.npz".into()]).is_err());
    }
}
