//! Reads tables with a header, and the tables of measures and clusters in the folders of tests.

use std::path::{Path, PathBuf, absolute};

use anyhow::{Context, Result, bail};
use spharm_cli::inputs::{read_text, stem};
use spharm_cli::output::counted;
use spharm_cli::paths::shown;
use spharm_report::Table;

/// File in a test's folder with a table of measures.
pub(super) const SUMMARY: &str = "summary.csv";
/// File in a test's folder with a table of clusters, the largest first.
pub(super) const CLUSTERS: &str = "clusters.csv";
/// Maximum size of a table in bytes; tables that a page can show are far smaller.
pub(super) const LARGEST_TABLE: u64 = 64 << 20;
/// Maximum number of clusters in a table of the page.
const MOST: usize = 20;

/// Reads the tables of each test: first its measures, then its clusters. A test may lack either table.
pub(super) fn tables(folders: &[PathBuf], page: &Path) -> Result<Vec<Table>> {
    let mut tables = Vec::new();
    for folder in folders {
        let (measures, clusters) = (folder.join(SUMMARY), folder.join(CLUSTERS));
        if measures.is_file() {
            let title = format!("{}: measures", stem(folder));
            tables.push(of_measures(Table { title, ..table(&measures)? }));
        }
        if clusters.is_file() {
            let title = format!("{}: clusters", stem(folder));
            tables.push(of_clusters(Table { title, ..table(&clusters)? }, &from_page(&clusters, page)));
        }
    }
    Ok(tables)
}

/// Reads a table with a header. Columns are separated by tabs if the header contains a tab, otherwise by commas.
pub(super) fn table(path: &Path) -> Result<Table> {
    let open = || format!("{}: cannot read the table", path.display());
    let text = read_text(path, "table", LARGEST_TABLE)?;
    let tabs = text.lines().next().is_some_and(|line| line.contains('\t'));
    let mut reader = csv::ReaderBuilder::new().delimiter(if tabs { b'\t' } else { b',' }).from_reader(text.as_bytes());
    let cells = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect::<Vec<_>>();
    let columns = cells(reader.headers().with_context(open)?);
    if columns.is_empty() {
        bail!("{}: expected a table with a header, found an empty file", path.display());
    }
    let rows = reader.records().map(|record| Ok(cells(&record?))).collect::<Result<Vec<_>, csv::Error>>();
    Ok(Table { title: stem(path), columns, rows: rows.with_context(open)?, note: None })
}

/// Returns the page's table of measures. The columns with effects and p values are moved before the columns with
/// numbers of subjects, means and standard deviations, so that effects and p values are visible without scrolling.
fn of_measures(mut read: Table) -> Table {
    let first = read.columns.iter().position(|name| ["effect", "statistic"].contains(&name.as_str()));
    if let Some(first) = first.filter(|first| *first > 1) {
        let all = read.rows.iter_mut().chain(std::iter::once(&mut read.columns));
        all.for_each(|cells| cells[1..].rotate_left(first - 1));
    }
    read
}

/// Returns the page's table of clusters: the first rows of a table read from `file`, with headings in words. The
/// columns of directions are omitted if the table has columns of positions.
fn of_clusters(read: Table, file: &str) -> Table {
    let has_positions = read.columns.iter().any(|name| name == "x");
    let left_out: &[&str] = if has_positions { &["unit", "ux", "uy", "uz"] } else { &["unit"] };
    let kept: Vec<bool> = read.columns.iter().map(|name| !left_out.contains(&name.as_str())).collect();
    let keep = |cells: Vec<String>| -> Vec<String> {
        cells.into_iter().zip(&kept).filter(|(_, kept)| **kept).map(|(cell, _)| cell).collect()
    };
    // All rows have the same unit of area. Tables written by earlier versions don't state the unit.
    let unit = read.columns.iter().position(|name| name == "unit");
    let unit = unit.and_then(|at| read.rows.first()?.get(at).cloned());
    let area = match unit.as_deref().unwrap_or(if has_positions { "length^2" } else { "1" }) {
        "1" => "area on the unit sphere".to_owned(),
        unit => format!("area, {}", unit.replace("^2", "²")),
    };
    let note = match (read.rows.len(), read.rows.len().saturating_sub(MOST)) {
        (0, _) => format!("No clusters: {file}"),
        (_, 0) => format!("All clusters of {file}"),
        (_, more) => format!("{} in {file}", counted(more, "more cluster")),
    };
    let columns = keep(read.columns).iter().map(|name| heading(name, &area)).collect();
    let rows = read.rows.into_iter().take(MOST).map(keep).collect();
    Table { title: read.title, columns, rows, note: Some(note) }
}

/// Returns the heading of a column in the table of clusters; `area` is the heading of the areas.
fn heading(column: &str, area: &str) -> String {
    match column {
        "area" => area.to_owned(),
        "peak" => "peak's vertex".to_owned(),
        "p_fwe" => "p-fwe".to_owned(),
        "x" | "y" | "z" => format!("{column} on the mean"),
        _ => column.to_owned(),
    }
}

/// Returns the path of a file, relative to the page's folder if the file is in that folder.
fn from_page(file: &Path, page: &Path) -> String {
    let (Ok(inside), Ok(page)) = (absolute(file), absolute(page)) else { return shown(file) };
    page.parent().and_then(|folder| inside.strip_prefix(folder).ok()).map_or_else(|| shown(file), shown)
}
