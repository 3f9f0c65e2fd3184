//! Checks output files before any work is done, and writes results to stdout and reports to files.

use std::borrow::Cow;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};
use serde::Serialize;
pub use spharm_cohort::equal::first_of;
use spharm_surface::io::{Output, check_output, write_new};

use crate::printable;

/// Error context that marks a failure to write to stdout.
#[derive(Debug, Clone, Copy)]
pub struct ToStdout;

impl std::fmt::Display for ToStdout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("cannot write to standard output")
    }
}

/// Prints lines of text and a final line break to stdout. Control characters that a terminal would act on are escaped.
///
/// # Errors
///
/// If stdout can't be written to. If the reason is a closed pipe, the program ends without a message.
pub fn print(text: &str) -> Result<()> {
    if MUTED.load(Ordering::Relaxed) > 0 {
        return Ok(());
    }
    let mut out = std::io::stdout().lock();
    let text = printable::lines(text);
    out.write_all(text.as_bytes()).and_then(|()| out.write_all(b"\n")).and_then(|()| out.flush()).context(ToStdout)
}

/// Prints a string to stdout as one line; line breaks in the string become blanks.
///
/// # Errors
///
/// If stdout can't be written to, as for [`print()`].
pub fn print_line(text: &str) -> Result<()> {
    print(&printable::one_line(text))
}

/// Number of existing [`Muted`] values. If this number isn't 0, output to stdout is suppressed.
static MUTED: AtomicUsize = AtomicUsize::new(0);

/// Suppresses output to stdout until dropped. A verb that runs other verbs uses it to hide their tables.
#[derive(Debug)]
pub struct Muted(());

impl Muted {
    /// Begins to suppress output to stdout.
    #[must_use]
    pub fn begin() -> Self {
        MUTED.fetch_add(1, Ordering::Relaxed);
        Self(())
    }
}

impl Drop for Muted {
    fn drop(&mut self) {
        MUTED.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Prints a value as JSON.
///
/// # Errors
///
/// If stdout can't be written to, as for [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<()> {
    print(&json_text(value)?)
}

fn json_text(value: &impl Serialize) -> Result<String> {
    Ok(printable::json(&serde_json::to_string_pretty(value)?).into_owned())
}

/// Writes a value as a JSON file; creates its folder if needed. `-` is standard output. Pipes and devices are written
/// to directly.
///
/// # Errors
///
/// If the file exists and `force` isn't set, or it can't be written.
pub fn write_json(path: &Path, force: bool, value: &impl Serialize) -> Result<()> {
    if is_stdout(path) {
        return print_json(value);
    }
    let text = json_text(value)?;
    if is_stream(path) {
        let mut out = std::fs::File::options().write(true).open(path).with_context(|| path.display().to_string())?;
        return writeln!(out, "{text}").with_context(|| format!("{}: cannot write", path.display()));
    }
    prepare(path)?;
    write_new(path, force, |out| writeln!(out, "{text}"))?;
    Ok(())
}

/// A file that a verb will write.
#[derive(Debug, Clone, Copy)]
pub struct OutputFile<'a> {
    path: &'a Path,
    flag: &'static str,
    holds: Option<Output<'static>>,
}

impl<'a> OutputFile<'a> {
    /// Describes an output file that may have any name; `flag` is the option that gives the name.
    pub fn new(path: &'a Path, flag: &'static str) -> Self {
        Self { path, flag, holds: None }
    }

    /// Describes an output file whose name has to end in one of `endings`, because its format is fixed.
    pub fn with_ending(path: &'a Path, flag: &'static str, endings: &'static [&'static str]) -> Self {
        Self { path, flag, holds: Some(Output::Ending(endings)) }
    }

    /// Describes an output file for a surface, a sphere or a signal, whose format follows from its name.
    pub fn holding(path: &'a Path, flag: &'static str, holds: Output<'static>) -> Self {
        Self { path, flag, holds: Some(holds) }
    }

    fn check(&self, force: bool) -> Result<()> {
        let Self { path, flag, holds } = *self;
        if flag == REPORT && (is_stdout(path) || is_stream(path)) {
            return Ok(());
        }
        if is_stdout(path) {
            bail!("{}: only {REPORT} can go to standard output; {flag} must name a file", path.display());
        }
        if is_stream(path) {
            bail!("{}: this path is a pipe or a device; {flag} must name a file", path.display());
        }
        if let Some(holds) = holds {
            check_output(path, holds).context(flag)?;
        }
        if path.is_dir() {
            bail!("{}: this path is a folder; {flag} must name a file", path.display());
        }
        if path.exists() && !force {
            bail!("{}: the file exists; choose another {flag} or give --force", path.display());
        }
        let there = folder_of(path).ancestors().find(|folder| folder.exists()).map(Path::to_path_buf);
        if let Some(there) = there.filter(|there| !there.is_dir()) {
            bail!("{}: the path {} isn't a folder; choose another {flag}", path.display(), there.display());
        }
        Ok(())
    }
}

/// Refuses outputs that couldn't be written at the end of a verb's work: existing files (without `force`), folders,
/// names that end in another format's extension, and two outputs with the same name. Verbs call this before any work;
/// the functions that write the files check again.
///
/// # Errors
///
/// If an output can't be written; the message names the flag to change.
pub fn check_outputs<'a>(outputs: impl IntoIterator<Item = OutputFile<'a>>, force: bool) -> Result<()> {
    let mut seen: Vec<PathBuf> = Vec::new();
    for output in outputs {
        output.check(force)?;
        if is_stdout(output.path) || is_stream(output.path) {
            continue;
        }
        let place = place(output.path);
        if seen.contains(&place) {
            bail!("{}: several outputs have this name; give them different names", output.path.display());
        }
        seen.push(place);
    }
    Ok(())
}

/// Returns the canonical path of a file, without links, `.` and `..`. If the file doesn't exist, the existing part of
/// its path is resolved.
pub(crate) fn place(path: &Path) -> PathBuf {
    if let Ok(place) = path.canonicalize() {
        return place;
    }
    let folder = std::path::absolute(folder_of(path)).unwrap_or_default();
    // The file system can't resolve a `..` after a folder that doesn't exist, so resolve it in the text of the path.
    let mut tidy = PathBuf::new();
    for part in folder.components() {
        match part {
            std::path::Component::ParentDir => drop(tidy.pop()),
            part => tidy.push(part),
        }
        tidy = tidy.canonicalize().unwrap_or(tidy);
    }
    tidy.join(path.file_name().unwrap_or_default())
}

/// Checks outputs as [`check_outputs`] does, and also refuses outputs that are inputs, however their paths are written.
/// Hard and symbolic links count as the same file; inputs that don't exist are ignored.
///
/// # Errors
///
/// The errors of [`check_outputs`] and of [`check_not_inputs`].
pub fn check_files<'i, 'a>(
    inputs: impl IntoIterator<Item = &'i Path>,
    outputs: impl IntoIterator<Item = OutputFile<'a>>,
    force: bool,
) -> Result<()> {
    let outputs: Vec<OutputFile<'_>> = outputs.into_iter().collect();
    check_outputs(outputs.iter().copied(), force)?;
    check_not_inputs(inputs, outputs.iter().map(|output| output.path))
}

/// Returns whether two paths lead to the same file, however they are written.
#[must_use]
pub fn same_place(a: &Path, b: &Path) -> bool {
    a.file_name() == b.file_name() && place(a) == place(b)
}

/// Refuses outputs that are inputs, however their paths are written. Hard and symbolic links count as the same file.
///
/// # Errors
///
/// If an output is an input. With `--force`, the output would overwrite this input.
pub fn check_not_inputs<'i, 'a>(
    inputs: impl IntoIterator<Item = &'i Path>,
    outputs: impl IntoIterator<Item = &'a Path>,
) -> Result<()> {
    match spharm_files::first_input(inputs, outputs) {
        Some(output) => bail!("{}: this file is an input; choose another name for the output", output.display()),
        None => Ok(()),
    }
}

/// Path that means standard output.
pub const STDOUT: &str = "-";

/// The flag whose value is the path of a report.
pub const REPORT: &str = "--report";

/// Returns whether a report with this path goes to standard output. If so, the report replaces the printed table.
#[must_use]
pub fn is_stdout(path: &Path) -> bool {
    [STDOUT, "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"].iter().any(|name| path.as_os_str() == *name)
}

/// Returns whether a path leads to a pipe or a device, such as `/dev/null` or `/dev/fd/63`. Pipes and devices are
/// written to, never replaced.
pub(crate) fn is_stream(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// Creates the folder of a file that is about to be written, if it doesn't exist.
///
/// # Errors
///
/// If the folder can't be created.
pub fn prepare(path: &Path) -> Result<()> {
    let folder = folder_of(path);
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot create the folder", folder.display()))
}

fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

/// Returns a number with its noun: `1 panel`, `2 panels`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Aligns the cells of rows in columns: the first column to the left, the others to the right.
pub fn table(rows: &[Vec<String>]) -> String {
    let rows: Vec<Vec<_>> = rows.iter().map(|row| row.iter().map(|cell| printable::one_line(cell)).collect()).collect();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<Cow<'_, str>>, column: usize| row.get(column).map_or(0, |cell| cell.chars().count());
    let widths: Vec<usize> = (0..columns).map(|c| rows.iter().map(|row| cell(row, c)).max().unwrap_or(0)).collect();
    let line = |row: &Vec<Cow<'_, str>>| {
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
    fn a_file_has_one_place_however_it_is_written() {
        let site = tempfile::tempdir().unwrap();
        let at = |name: &str| site.path().join(name);
        std::fs::create_dir(at("a")).unwrap();
        std::fs::write(at("a/in.ply"), "x").unwrap();
        fn file(path: &Path) -> OutputFile<'_> {
            OutputFile::new(path, "--output")
        }
        for (first, second) in [("x.npz", "./x.npz"), ("x.npz", "a/../x.npz"), ("new/x.npz", "a/../new/x.npz")] {
            let (first, second) = (at(first), at(second));
            assert!(check_outputs([file(&first), file(&second)], true).is_err(), "{}", second.display());
        }
        let (x, y) = (at("new/x.npz"), at("a/x.npz"));
        check_outputs([file(&x), file(&y)], true).unwrap();
        let (input, same, other) = (at("a/in.ply"), at("a/../a/in.ply"), at("a/out.ply"));
        assert!(check_not_inputs([input.as_path()], [same.as_path()]).is_err());
        check_not_inputs([input.as_path()], [other.as_path()]).unwrap();
    }

    #[test]
    fn cells_line_up() {
        let rows = [vec!["name".to_owned(), "msd".to_owned()], vec!["a".to_owned(), "1.5e-8".to_owned()]];
        assert_eq!(table(&rows), "name     msd\na     1.5e-8");
    }
}
