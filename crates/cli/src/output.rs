//! Results to stdout, reports to files.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::Serialize;
use spharm_surface::io::write_new;

/// Marks an error as one of writing to stdout.
#[derive(Debug, Clone, Copy)]
pub struct ToStdout;

impl std::fmt::Display for ToStdout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("cannot write to standard output")
    }
}

/// Prints a text and a new line.
///
/// # Errors
///
/// When stdout can't be written to; a closed pipe ends the tool in peace.
pub fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.write_all(b"\n")).and_then(|()| out.flush()).context(ToStdout)
}

/// Prints a value as JSON.
///
/// # Errors
///
/// As for [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<()> {
    print(&serde_json::to_string_pretty(value)?)
}

/// Writes a value as a JSON file.
///
/// # Errors
///
/// When the file exists and isn't to be replaced, or can't be written.
pub fn write_json(path: &Path, force: bool, value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value)?;
    write_new(path, force, |out| writeln!(out, "{text}"))?;
    Ok(())
}

/// Refuses, before any work, to write where something is: `what` it would be, and the `flag` that names another place.
/// [`write_new`] makes sure of it again when the time comes.
///
/// # Errors
///
/// When `path` exists and isn't to be replaced.
pub fn refuse_existing(path: &Path, force: bool, what: &str, flag: &str) -> Result<()> {
    if path.exists() && !force {
        bail!("{}: the {what} exists; choose another {flag} or give --force", path.display());
    }
    Ok(())
}

/// Lines up the cells of rows in columns: the first to the left, the others to the right.
pub fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, column: usize| row.get(column).map_or(0, |cell| cell.chars().count());
    let widths: Vec<usize> = (0..columns).map(|c| rows.iter().map(|row| cell(row, c)).max().unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate();
        let padded = cells.map(|(c, (cell, &width))| match c {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_line_up() {
        let rows = [vec!["name".to_owned(), "msd".to_owned()], vec!["a".to_owned(), "1.5e-8".to_owned()]];
        assert_eq!(table(&rows), "name     msd\na     1.5e-8");
    }
}
