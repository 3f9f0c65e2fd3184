//! Merges the tables of outcomes of all processes.

use std::collections::HashMap;
use std::path::Path;

use crate::error::CohortError;
use crate::status::{Entry, HEADER, State};
use crate::table::{Table, read_text};

/// The final outcomes of all rows, merged from several status files.
///
/// Within a file, a later line of a row replaces an earlier line, except that [`State::Skipped`] doesn't replace
/// [`State::Done`]. If several files have a line for the same row, the last file whose line reports that the model
/// exists takes precedence. If no line reports this, the last file given takes precedence.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Merged {
    /// The entries, in the order in which their rows first occur.
    entries: Vec<Entry>,
    places: HashMap<String, usize>,
    /// Number of malformed lines that were ignored, such as lines that were incomplete because the disk was full.
    pub damaged: usize,
}

impl Merged {
    /// Reads and merges status files.
    ///
    /// # Errors
    ///
    /// [`CohortError::NotStatus`] if a file isn't a status file, [`CohortError::Encoding`] if it isn't UTF-8, and
    /// [`CohortError::Io`] if it can't be read.
    pub fn read(paths: impl IntoIterator<Item = impl AsRef<Path>>) -> Result<Self, CohortError> {
        let mut merged = Self::default();
        for path in paths {
            let (entries, damaged) = read_one(path.as_ref())?;
            merged.damaged += damaged;
            entries.into_iter().for_each(|entry| merged.add(entry));
        }
        Ok(merged)
    }

    fn add(&mut self, entry: Entry) {
        match self.places.get(&entry.id) {
            Some(&place) => {
                let known = &mut self.entries[place];
                if entry.state.is_there() || !known.state.is_there() {
                    replace(known, entry);
                }
            }
            None => {
                self.places.insert(entry.id.clone(), self.entries.len());
                self.entries.push(entry);
            }
        }
    }

    /// Returns the entries.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Returns the entry of a row, or `None` if no file has the row.
    #[must_use]
    pub fn entry(&self, id: &str) -> Option<&Entry> {
        self.places.get(id).map(|&place| &self.entries[place])
    }

    /// Returns the number of rows in a state.
    #[must_use]
    pub fn count(&self, state: State) -> usize {
        self.entries.iter().filter(|entry| entry.state == state).count()
    }
}

/// Replaces the entry of a row by a later entry, unless `Skipped` would replace `Done`.
fn replace(known: &mut Entry, entry: Entry) {
    if !(known.state == State::Done && entry.state == State::Skipped) {
        *known = entry;
    }
}

fn read_one(path: &Path) -> Result<(Vec<Entry>, usize), CohortError> {
    let text = read_text(path)?;
    let first = text.lines().next().unwrap_or_default();
    let expected = HEADER.join("\t");
    // Accept an empty file and an incomplete header: a process that was killed immediately leaves such a file.
    if !text.is_empty() && first != expected && !expected.starts_with(text.as_str()) {
        let found = first.chars().take(80).collect();
        return Err(CohortError::NotStatus { path: path.to_owned(), expected, found });
    }
    // Ignore an incomplete last line, because the process that writes the file may not have finished the line.
    let whole = &text[..text.rfind('\n').map_or(0, |at| at + 1)];
    let (mut entries, mut places, mut damaged): (Vec<Entry>, HashMap<String, usize>, usize) = Default::default();
    let mut is_header = true;
    let name = Path::new("status.tsv");
    Table::new(name, whole).records(|_, record| {
        if std::mem::take(&mut is_header) {
            return Ok(true);
        }
        match Entry::of_cells(record.iter()) {
            Some(entry) => match places.get(&entry.id) {
                Some(&place) => replace(&mut entries[place], entry),
                None => {
                    places.insert(entry.id.clone(), entries.len());
                    entries.push(entry);
                }
            },
            None => damaged += 1,
        }
        Ok(true)
    })?;
    Ok((entries, damaged))
}
