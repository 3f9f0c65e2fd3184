//! Reads per-vertex files in GIfTI, FreeSurfer and similar formats, with one row per vertex and columns named by their
//! indices from 0.

use std::path::Path;

use spharm_surface::io::read_signal_with_gaps;
use spharm_surface::{Signal, SurfaceError};

use super::table::Table;

/// The values of a per-vertex file, held in memory.
pub(super) struct Values {
    signal: Signal,
    names: Vec<String>,
    selected: Vec<usize>,
    /// Number of rows that have been read.
    done: usize,
}

/// Reads a per-vertex file. If a vertex has no data, its value is NaN, which causes an error only if the vertex's row
/// is used.
pub(super) fn open(path: &Path) -> Result<Values, SurfaceError> {
    let signal = read_signal_with_gaps(path)?;
    let names = (0..signal.channels).map(|channel| channel.to_string()).collect();
    Ok(Values { signal, names, selected: Vec::new(), done: 0 })
}

impl Values {
    pub(super) fn rows(&self) -> u64 {
        self.signal.vertices as u64
    }
}

impl Table for Values {
    fn columns(&self) -> &[String] {
        &self.names
    }

    fn select(&mut self, columns: Vec<usize>) {
        self.selected = columns;
    }

    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, crate::MomentsError> {
        let count = most.min(self.signal.vertices - self.done);
        let rows = self.signal.values.chunks_exact(self.signal.channels).skip(self.done).take(count);
        out.extend(rows.flat_map(|row| self.selected.iter().map(|&column| row[column])));
        self.done += count;
        Ok(count)
    }

    fn number_of(&self, row: u64) -> u64 {
        row + 1
    }
}
