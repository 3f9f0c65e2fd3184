//! Writes status files: tables of the outcomes of one process, one line per outcome.

use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::error::CohortError;
use crate::formulas::{cell, guarded, unguarded};
use crate::table::writer;

/// Names of the columns, in order.
pub(crate) const HEADER: [&str; 7] = ["id", "state", "msd", "xsd", "seconds", "error", "output"];

/// Outcome of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum State {
    /// The model was written.
    Done,
    /// The row was skipped because its model existed.
    Skipped,
    /// The row couldn't be fitted. The column `error` gives the reason.
    Failed,
    /// The run ended before the row was finished, because the run was cancelled, or because of an error, possibly in
    /// another row. The column `error` gives this error.
    Interrupted,
}

impl State {
    /// All states.
    pub const ALL: [Self; 4] = [Self::Done, Self::Skipped, Self::Failed, Self::Interrupted];

    /// Returns the name of the state in the table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Skipped => "skipped",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
        }
    }

    /// Returns whether a model of the row exists.
    #[must_use]
    pub fn is_there(self) -> bool {
        matches!(self, Self::Done | Self::Skipped)
    }
}

impl FromStr for State {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|state| state.name() == text).ok_or(())
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A line of a status file.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Id of the row.
    pub id: String,
    /// Outcome of the row.
    pub state: State,
    /// Mean squared distance at the vertices, for a bounding box scaled to volume 1.
    pub msd: Option<f64>,
    /// Maximal squared distance at the vertices, for a bounding box scaled to volume 1.
    pub xsd: Option<f64>,
    /// Wall time in seconds, from reading the surface to writing its model. Rows that are fitted together share the
    /// time of their common work.
    pub seconds: Option<f64>,
    /// Error of a failed row, or the error that ended the run before the row was finished; empty for other rows.
    pub error: String,
    /// Path of the model as text; empty if unknown. A path with control characters other than tabs isn't written.
    pub output: String,
}

impl Entry {
    /// Creates an entry without distances, time, error or output.
    #[must_use]
    pub fn new(id: &str, state: State) -> Self {
        let (msd, xsd, seconds, error, output) = (None, None, None, String::new(), String::new());
        Self { id: id.to_owned(), state, msd, xsd, seconds, error, output }
    }

    /// Parses an entry from the cells of a line. Returns `None` if the cells are malformed.
    pub(crate) fn of_cells<'a>(cells: impl Iterator<Item = &'a str>) -> Option<Self> {
        let cells: Vec<&str> = cells.collect();
        let [id, state, msd, xsd, seconds, error, output] = cells[..] else { return None };
        let number = |cell: &str| if cell.is_empty() { Some(None) } else { cell.parse().ok().map(Some) };
        Some(Self {
            id: Some(unguarded(id)).filter(|id| !id.is_empty())?.to_owned(),
            state: state.parse().ok()?,
            msd: number(msd)?,
            xsd: number(xsd)?,
            seconds: number(seconds)?,
            error: unguarded(error).to_owned(),
            output: unguarded(output).to_owned(),
        })
    }

    /// Formats the entry as one line, including the line ending.
    fn line(&self) -> io::Result<Vec<u8>> {
        // msd and xsd are written with the fewest digits from which they can be read back exactly.
        let number =
            |value: Option<f64>| value.filter(|value| value.is_finite()).map_or(String::new(), |v| format!("{v:e}"));
        let seconds = self.seconds.map_or(String::new(), |seconds| format!("{seconds:.3}"));
        let state = self.state.name().to_owned();
        let (id, error, output) = (name(&self.id), cell(&self.error), path(&self.output));
        line([id, state, number(self.msd), number(self.xsd), seconds, error, output])
    }
}

/// Converts an id to a cell. Tabs are kept, because the table's writer puts such a cell in quotation marks.
fn name(id: &str) -> String {
    guarded(&id.replace(|c: char| c != '\t' && c.is_control(), " ")).into_owned()
}

/// Converts a path to a cell. A path that contains a line ending can't be written on one line, and a changed path would
/// name another file, so the cell is left empty for such a path.
fn path(output: &str) -> String {
    let kept = name(output);
    if kept == guarded(output) { kept } else { String::new() }
}

fn line(cells: impl IntoIterator<Item = impl AsRef<[u8]>>) -> io::Result<Vec<u8>> {
    let mut writer = writer(b'\t');
    writer.write_record(cells).map_err(io::Error::other)?;
    writer.into_inner().map_err(|error| io::Error::other(error.to_string()))
}

/// A status file to which this process writes. If a row has several lines, the last line is valid, so a resumed run can
/// append to the file.
#[derive(Debug)]
pub struct StatusFile {
    path: PathBuf,
    file: File,
    /// Offset in bytes of the end of the last complete line.
    end: u64,
}

impl StatusFile {
    /// Opens a status file for appending, or creates the file and its folder. An incomplete last line, left by a full
    /// disk or a killed process, is removed.
    ///
    /// # Errors
    ///
    /// [`CohortError::NotStatus`] if the file isn't a status file, [`CohortError::Locked`] if another process has it
    /// open, and [`CohortError::Io`] if it can't be opened, read or written.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, CohortError> {
        let path = path.as_ref();
        let io = |action| move |source| CohortError::Io { path: path.to_owned(), action, source };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(io("create the file's folder"))?;
        }
        let options = OpenOptions::new().read(true).append(true).create(true).clone();
        let mut file = spharm_files::open_with(path, &options).map_err(io("open"))?;
        // On a file system without locks, continue without knowing whether another process has the file open.
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            return Err(CohortError::Locked { path: path.to_owned() });
        }
        let header = line(HEADER).map_err(io("write"))?;
        let mut start = Vec::new();
        (&mut file).take(header.len() as u64).read_to_end(&mut start).map_err(io("read"))?;
        if !header.starts_with(&start) {
            let shown = |bytes: &[u8]| String::from_utf8_lossy(bytes).lines().next().unwrap_or_default().to_owned();
            let (expected, found) = (shown(&header), shown(&start));
            return Err(CohortError::NotStatus { path: path.to_owned(), expected, found });
        }
        if start.len() < header.len() {
            file.set_len(0).and_then(|()| file.write_all(&header)).map_err(io("write"))?;
        }
        let length = file.metadata().map_err(io("read"))?.len();
        let end = whole_lines(&mut file, length).map_err(io("read"))?;
        if end < length {
            file.set_len(end).map_err(io("write"))?;
        }
        Ok(Self { path: path.to_owned(), file, end })
    }

    /// Appends a line and writes it immediately, so that it isn't lost if the process is killed.
    ///
    /// # Errors
    ///
    /// [`CohortError::Io`] if the line can't be written completely. The incomplete line is then removed, if possible.
    pub fn append(&mut self, entry: &Entry) -> Result<(), CohortError> {
        let result = entry.line().and_then(|line| self.file.write_all(&line).map(|()| line.len() as u64));
        match result {
            Ok(length) => {
                self.end += length;
                Ok(())
            }
            Err(source) => {
                // If truncating fails, too, the incomplete line is removed when the file is next opened.
                let _ = self.file.set_len(self.end);
                Err(CohortError::Io { path: self.path.clone(), action: "write", source })
            }
        }
    }
}

/// Returns the offset in bytes of the end of the last complete line.
fn whole_lines(file: &mut File, length: u64) -> io::Result<u64> {
    const STEP: u64 = 1 << 12;
    let mut end = length;
    while end > 0 {
        let start = end.saturating_sub(STEP);
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(start))?;
        file.take(end - start).read_to_end(&mut bytes)?;
        if let Some(at) = bytes.iter().rposition(|&byte| byte == b'\n') {
            return Ok(start + at as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}
