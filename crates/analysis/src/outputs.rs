//! Names and writes the results of a subcommand: its models (one file, or a folder for several models), its tables and
//! its report.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::{Value, json};
use spharm_cli::Usage;
use spharm_cli::machine::memory;
use spharm_cli::names::is_named_file;
use spharm_cli::output::{
    OutputFile, check_files, check_outputs, is_stdout, prepare, print, print_json, table, write_json,
};
use spharm_cli::paths::{model_file_name, with_ending};
use spharm_cohort::{cell, guarded};
use spharm_surface::io::{to_write_mesh, write_new};

use super::args::{Models, ReportArgs};

/// Returns the output of each model: the named file for a single model, otherwise `NAME.ENDING` in the output folder.
pub(super) fn outputs(models: &Models, paths: &[PathBuf], output: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    if models.single(paths) && !output.is_dir() {
        return Ok(vec![output.to_owned()]);
    }
    check_folder(output)?;
    Ok(paths.iter().map(|path| with_ending(&output.join(model_file_name(path)), ending)).collect())
}

/// Refuses an output folder whose name has the extension of a file, such as `.npz`, unless this folder exists.
pub(super) fn check_folder(output: &Path) -> Result<()> {
    if is_named_file(output) || !output.is_dir() && to_write_mesh(output).is_ok() {
        return Err(Usage::conflict("--output must name a folder if several files are written").into());
    }
    Ok(())
}

/// Refuses outputs that can't be written, before the models are read.
pub(super) fn check<'a>(files: impl IntoIterator<Item = OutputFile<'a>>, report: &'a ReportArgs) -> Result<()> {
    let of_report = report.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    check_outputs(files.into_iter().chain(of_report), report.force)
}

/// Checks outputs that may be in the models' folder. Checks the same conditions as [`check`], and also refuses an
/// output that would overwrite one of the models.
pub(super) fn check_beside<'a>(
    models: &[PathBuf],
    files: impl IntoIterator<Item = OutputFile<'a>>,
    report: &'a ReportArgs,
) -> Result<()> {
    let of_report = report.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    check_files(models.iter().map(PathBuf::as_path), files.into_iter().chain(of_report), report.force)
}

/// Writes and prints a report. `rows` is the printed table; its first row has the names of the columns.
pub(super) fn finish(subcommand: &str, report: &Value, rows: &[Vec<String>], args: &ReportArgs) -> Result<()> {
    let whole = write_report(subcommand, report, args)?;
    if args.report.as_deref().is_some_and(is_stdout) {
        return Ok(());
    }
    if args.json { print_json(&whole) } else { print(&table(rows)) }
}

/// Writes a report if one was requested, and returns it together with the fields common to all reports.
pub(super) fn write_report(subcommand: &str, report: &Value, args: &ReportArgs) -> Result<Value> {
    let mut whole = json!({
        "tool": format!("shape {subcommand}"),
        "versions": spharm::versions(),
        "memory": memory(),
    });
    if let (Some(whole), Some(report)) = (whole.as_object_mut(), report.as_object()) {
        whole.extend(report.clone());
    }
    if let Some(path) = &args.report {
        write_json(path, args.force, &whole)?;
    }
    Ok(whole)
}

/// Returns the text of a CSV table; [`number`] formats the numbers in its cells.
pub(super) fn csv<'a>(header: &[&str], rows: impl IntoIterator<Item = &'a [String]>) -> String {
    let line = |cells: Vec<Cow<'_, str>>| cells.join(",") + "\n";
    let mut text = line(header.iter().map(|name| quoted(name)).collect());
    rows.into_iter().for_each(|row| text += &line(row.iter().map(|cell| quoted(cell)).collect()));
    text
}

/// Extensions that the names of table files may have.
pub(super) const TABLES: [&str; 2] = [".csv", ".tsv"];

/// Returns the text of a table for a file: with tabs if its name ends in .tsv, otherwise CSV.
pub(super) fn table_for<'a>(
    path: Option<&Path>,
    header: &[&str],
    rows: impl IntoIterator<Item = &'a [String]>,
) -> String {
    if !path.and_then(Path::extension).is_some_and(|ending| ending.eq_ignore_ascii_case("tsv")) {
        return csv(header, rows);
    }
    let mut text = header.iter().map(|name| cell(name)).collect::<Vec<_>>().join("\t") + "\n";
    rows.into_iter().for_each(|row| text += &(row.iter().map(|text| cell(text)).collect::<Vec<_>>().join("\t") + "\n"));
    text
}

/// Formats a number with all digits needed to restore it exactly.
pub(super) fn exact(value: f64) -> String {
    format!("{value:?}")
}

/// Writes text to a file, completely or not at all.
pub(super) fn write_text(path: &Path, force: bool, text: &str) -> Result<()> {
    prepare(path)?;
    write_new(path, force, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}

/// Quotes a cell as in RFC 4180, and guards it against being interpreted as a formula by spreadsheets.
fn quoted(cell: &str) -> Cow<'_, str> {
    let cell = guarded(cell);
    if cell.contains([',', '"', '\n', '\r']) { Cow::Owned(format!("\"{}\"", cell.replace('"', "\"\""))) } else { cell }
}

/// Formats a number with at most six significant digits.
pub(super) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value.is_nan() { String::new() } else { value.to_string() };
    }
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    if (1e-4..1e9).contains(&rounded.abs()) { rounded.to_string() } else { format!("{rounded:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_they_have_to_be() {
        let rows = [vec!["a,\"b\".npz".to_owned(), exact(0.1)], vec!["c".to_owned(), exact(1e-300)]];
        let text = csv(&["model", "a"], rows.iter().map(Vec::as_slice));
        assert_eq!(text, "model,a\n\"a,\"\"b\"\".npz\",0.1\nc,1e-300\n");
        let rows = [vec!["=cmd|calc".to_owned(), exact(-0.5)]];
        assert_eq!(csv(&["@x", "a"], rows.iter().map(Vec::as_slice)), "'@x,a\n'=cmd|calc,-0.5\n");
    }

    #[test]
    fn numbers_have_six_digits() {
        let found = [0.1 + 0.2, 1_234.567_891, 1.0 / 3e6, -2e12, 0.0, 50.0].map(short);
        assert_eq!(found, ["0.3", "1234.57", "3.33333e-7", "-2e12", "0", "50"]);
    }
}
