//! Reads a Cholesky factor: opens and checks the file, and maps its tile columns into memory.

use std::path::Path;
use std::sync::Arc;

use spharm_monitor::{Monitor, Stage};

use crate::container::reader::{Container, MappedParts};
use crate::error::StoreError;
use crate::factor::header::FactorHeader;
use crate::factor::spec::FactorSpec;
use crate::scheme::Scalar;

/// An open factor whose header, table and footer have passed all checks. Each tile is checked when it is first read.
/// Clones share the open file.
#[derive(Debug, Clone)]
pub struct FactorFile {
    container: Arc<Container<FactorHeader>>,
}

impl FactorFile {
    /// Opens a file and performs all checks except those of the tiles.
    ///
    /// # Errors
    ///
    /// [`StoreError::NotAFile`] if the path names something other than a regular file, [`StoreError::Corrupt`] if the
    /// file violates the format, [`StoreError::Version`] if the file has another format version, [`StoreError::Io`] if
    /// the file can't be read.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Ok(Self { container: Arc::new(Container::open(path)?) })
    }

    /// Returns the file's header.
    pub fn header(&self) -> &FactorHeader {
        self.container.contents()
    }

    /// Returns the file's path.
    pub fn path(&self) -> &Path {
        self.container.source().path()
    }

    /// Returns the file's length in bytes.
    pub fn file_len(&self) -> u64 {
        self.container.source().len()
    }

    /// Checks that this factor has the identity `spec`.
    ///
    /// # Errors
    ///
    /// [`StoreError::FactorDiffers`], with the first property that differs, if the factor has another identity.
    pub fn expect(&self, spec: &FactorSpec) -> Result<(), StoreError> {
        let found = &self.header().spec;
        let differs = |what, expected: &dyn ToString, found: &dyn ToString| {
            let path = self.path().to_path_buf();
            Err(StoreError::FactorDiffers { path, what, expected: expected.to_string(), found: found.to_string() })
        };
        if found.key != spec.key {
            return differs("scheme", &spec.key, &found.key);
        }
        if found.rows != spec.rows {
            return differs("number of directions", &spec.rows, &found.rows);
        }
        if found.max_degree != spec.max_degree {
            return differs("degree", &spec.max_degree, &found.max_degree);
        }
        if found.weights != spec.weights {
            return differs("set of weights", &spec.weights, &found.weights);
        }
        if found.smoothness != spec.smoothness {
            return differs("smoothness", &spec.smoothness, &found.smoothness);
        }
        Ok(())
    }

    /// Maps the tiles of a tile column into memory.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`] if the tiles can't be mapped.
    ///
    /// # Panics
    ///
    /// If the column doesn't exist.
    pub fn window(&self, column: usize) -> Result<TileWindow, StoreError> {
        let grid = self.header().grid;
        let (first, last) = (grid.index(column, column), grid.index(grid.columns() - 1, column));
        let mapped = self.container.map(first..last + 1)?;
        Ok(TileWindow { container: self.container.clone(), mapped, column })
    }

    /// Checks every byte of the file against its hashes. Reports one stage, `verify`, counted in bytes, to the monitor.
    /// Uses a buffer of 1 MiB.
    ///
    /// # Errors
    ///
    /// [`StoreError::TileDamaged`] if a tile or its padding doesn't pass a check, [`StoreError::ChangedWhileRead`] if
    /// the file has changed since it was opened, [`StoreError::Io`] if the file can't be read,
    /// [`StoreError::Interrupted`] if the monitor cancels the verification.
    pub fn verify(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        monitor.begin(Stage::bytes("verify"), self.file_len());
        self.verify_within(monitor)?;
        monitor.end();
        Ok(())
    }

    /// Performs the checks of [`verify`](Self::verify) within a stage that the caller has begun.
    pub(crate) fn verify_within(&self, monitor: &dyn Monitor) -> Result<(), StoreError> {
        self.container.verify(monitor)
    }
}

/// Values of a tile, column-major without gaps between columns.
#[derive(Debug, Clone, Copy)]
pub enum TileValues<'a> {
    /// Double precision.
    F64(&'a [f64]),
    /// Single precision.
    F32(&'a [f32]),
}

/// Mapped tiles of one tile column.
#[derive(Debug)]
pub struct TileWindow {
    container: Arc<Container<FactorHeader>>,
    mapped: MappedParts,
    column: usize,
}

impl TileWindow {
    /// Returns the tile column.
    pub fn column(&self) -> usize {
        self.column
    }

    /// Returns the values of tile (row, column) in place. `column` is the window's tile column. The first read of a
    /// tile verifies its checksum, which also loads the tile into the cache of the calling thread's core.
    ///
    /// Results computed from the values are valid only after [`check`](Self::check) has returned no error.
    ///
    /// # Errors
    ///
    /// [`StoreError::TileDamaged`] if the tile doesn't match its checksum, [`StoreError::ChangedWhileRead`] if the file
    /// has changed or couldn't be read.
    ///
    /// # Panics
    ///
    /// If the tile lies above the diagonal or outside the grid.
    pub fn values(&self, row: usize) -> Result<TileValues<'_>, StoreError> {
        let header = self.container.contents();
        let bytes = self.container.stored(&self.mapped, header.grid.index(row, self.column))?;
        // The casts can't fail: tiles start at multiples of 64 bytes in the file, and memory maps start at pages.
        Ok(match header.scalar {
            Scalar::F64 => TileValues::F64(bytemuck::cast_slice(bytes)),
            Scalar::F32 => TileValues::F32(bytemuck::cast_slice(bytes)),
        })
    }

    /// Asks the system to start reading the entire window from disk. The request is only a hint, so a failure is
    /// ignored.
    pub fn will_need(&self) {
        self.container.will_need(&self.mapped);
    }

    /// Maps all pages of the window with one system call, which costs less than one page fault per page. The request is
    /// only a hint, so a failure is ignored.
    pub fn populate(&self) {
        self.container.populate_all(&self.mapped);
    }

    /// Returns an error if the file has been truncated or changed since it was opened, or if part of it couldn't be
    /// read.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChangedWhileRead`] in each of these cases.
    pub fn check(&self) -> Result<(), StoreError> {
        self.container.check(&self.mapped)
    }
}
