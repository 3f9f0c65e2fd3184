//! A factor on its way to disk: tiles in any order into a temporary file, then header, table and footer, then the name.
//!
//! What makes a file count, and what becomes of it when something fails, is as in `crate::writer`. The header comes last
//! of all, since the condition estimate needs the whole factor.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use spharm_monitor::Monitor;
use tempfile::NamedTempFile;

use crate::build::{LARGE, free_space, lock, make_folder};
use crate::factor::grid::TileGrid;
use crate::factor::header::{Condition, FactorHeader};
use crate::factor::reader::FactorFile;
use crate::factor::spec::FactorSpec;
use crate::header::{ALIGNMENT, HEADER_LEN};
use crate::scheme::Scalar;
use crate::table::{ENTRY_LEN, Entry, FOOTER_LEN};
use crate::writer::{create_temporary, entry, publish, remove_abandoned, sync_folder};
use crate::{StoreError, StoreWarning};

/// What the root of a factor is derived with.
pub(crate) const ROOT_CONTEXT: &str = "spharm-rs 2026-11 factor file root v1";

/// A factor being written. Threads may put different tiles at the same time.
#[derive(Debug)]
pub struct FactorWriter {
    header: FactorHeader,
    path: PathBuf,
    temporary: NamedTempFile,
    /// Double precision of what is stored in single, for those who read tiles back; without a name, so that nothing
    /// is left of it whatever happens.
    scratch: Option<File>,
    /// Where tiles begin in the file, in values for tiles of f64 in the scratch file.
    offsets: Vec<u64>,
    entries: Mutex<Vec<Option<Entry>>>,
    /// Spares other builders the same work.
    _lock: Option<File>,
}

/// What [`begin_factor`] found.
#[derive(Debug)]
pub enum Begun {
    /// It is there already.
    Present(FactorFile),
    /// It isn't, and is to be written.
    New {
        /// Takes the tiles.
        writer: Box<FactorWriter>,
        /// The damaged file that was there and has been removed, if there was one.
        warnings: Vec<StoreWarning>,
    },
}

/// Begins a factor in `store`, unless it is there. One that is damaged is removed first.
///
/// With `read_back` tiles of f32 are kept in double precision as well until the end, for [`FactorWriter::get`].
///
/// # Errors
///
/// [`StoreError::NotAFile`], [`StoreError::Version`], [`StoreError::Io`]; [`StoreError::Interrupted`] while waiting for
/// another builder.
pub fn begin_factor(
    store: &Path,
    spec: &FactorSpec,
    scalar: Scalar,
    grid: TileGrid,
    read_back: bool,
    monitor: &dyn Monitor,
) -> Result<Begun, StoreError> {
    let folder = store.join(spec.key.to_string());
    let path = folder.join(spec.file_name(scalar));
    // Left alone when it is there, so that a store on a disk that can't be written to is no error.
    if let Ok(file) = open(&path, spec)? {
        return Ok(Begun::Present(file));
    }
    make_folder(store, &folder)?;
    let lock = lock(&folder, monitor)?;
    remove_abandoned(&folder)?;
    let damaged = match open(&path, spec)? {
        Ok(file) => return Ok(Begun::Present(file)),
        Err(damaged) => damaged,
    };
    if damaged.is_some() {
        match std::fs::remove_file(&path) {
            // A builder that has no lock either was faster.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            removed => removed.map_err(StoreError::io(&path, "cannot remove"))?,
        }
    }
    let condition = Condition { norm: 0.0, reciprocal: 0.0 };
    let header = FactorHeader { spec: *spec, scalar, grid, condition };
    let writer = Box::new(FactorWriter::create(&folder, path, header, read_back, lock)?);
    Ok(Begun::New { writer, warnings: damaged.map(StoreWarning::Replaced).into_iter().collect() })
}

/// The factor at a path, or what is wrong with it: nothing when there is none.
fn open(path: &Path, spec: &FactorSpec) -> Result<Result<FactorFile, Option<StoreError>>, StoreError> {
    match FactorFile::open(path).and_then(|file| file.expect(spec).map(|()| file)) {
        Ok(file) => Ok(Ok(file)),
        Err(StoreError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Ok(Err(None)),
        Err(
            error @ (StoreError::Corrupt { .. }
            | StoreError::ChangedWhileRead { .. }
            | StoreError::FactorDiffers { .. }),
        ) => Ok(Err(Some(error))),
        Err(error) => Err(error),
    }
}

/// Bytes of a factor's file.
fn file_bytes(grid: TileGrid, scalar: Scalar) -> u64 {
    // The gaps between the tiles, fewer than 64 bytes each, are counted as full.
    let values: u64 = grid.tiles().map(|(row, column)| grid.len(row, column) as u64).sum();
    values * scalar.size() as u64
        + grid.count() as u64 * (ENTRY_LEN as u64 + ALIGNMENT)
        + (HEADER_LEN + FOOTER_LEN) as u64
}

/// Says, before any work, whether a factor fits the disk: the bytes that it takes, with `read_back` while it is made.
///
/// # Errors
///
/// [`StoreError::Space`], unless `allow_large`.
pub fn check_factor_space(
    store: &Path,
    grid: TileGrid,
    scalar: Scalar,
    read_back: bool,
    allow_large: bool,
) -> Result<u64, StoreError> {
    let scratch = if read_back && scalar == Scalar::F32 { file_bytes(grid, Scalar::F64) } else { 0 };
    let needed = file_bytes(grid, scalar) + scratch;
    let free = free_space(store)?;
    let remedy = if needed > free {
        "choose a --store with more room, a lower degree or --factor-dtype f32, or go on all the same with --yes"
    } else if needed > LARGE {
        "go on with --yes, or choose a lower degree or --factor-dtype f32"
    } else {
        return Ok(needed);
    };
    if allow_large {
        return Ok(needed);
    }
    Err(StoreError::Space { path: store.to_path_buf(), what: "factor", needed, free, remedy })
}

impl FactorWriter {
    fn create(
        folder: &Path,
        path: PathBuf,
        header: FactorHeader,
        read_back: bool,
        lock: Option<File>,
    ) -> Result<Self, StoreError> {
        let failed = |error| StoreError::io(folder, "cannot create a file in the store")(error);
        let temporary = create_temporary(folder, &format!(".factor_{}.", header.spec.max_degree)).map_err(failed)?;
        let scratch = (read_back && header.scalar == Scalar::F32).then(|| tempfile::tempfile_in(folder));
        let scratch = scratch.transpose().map_err(failed)?;
        let mut offsets = Vec::with_capacity(header.grid.count());
        let mut next = HEADER_LEN as u64;
        for (row, column) in header.grid.tiles() {
            offsets.push(next);
            next = (next + header.tile_len(row, column) as u64).next_multiple_of(ALIGNMENT);
        }
        let entries = Mutex::new(vec![None; header.grid.count()]);
        Ok(Self { header, path, temporary, scratch, offsets, entries, _lock: lock })
    }

    /// Its tiles.
    pub fn grid(&self) -> TileGrid {
        self.header.grid
    }

    /// Writes a tile, column-major without gaps; those on the diagonal have zeros above it.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`].
    ///
    /// # Panics
    ///
    /// If the tile isn't of the grid's size.
    pub fn put(&self, row: usize, column: usize, values: &[f64]) -> Result<(), StoreError> {
        assert_eq!(values.len(), self.header.grid.len(row, column), "values of tile ({row}, {column})");
        let at = self.header.grid.index(row, column);
        let failed = |error| StoreError::io(&self.path, "cannot write")(error);
        let single: Vec<f32>;
        let bytes: &[u8] = match self.header.scalar {
            Scalar::F64 => bytemuck::cast_slice(values),
            Scalar::F32 => {
                single = values.iter().map(|&value| value as f32).collect();
                bytemuck::cast_slice(&single)
            }
        };
        self.temporary.as_file().write_all_at(bytes, self.offsets[at]).map_err(failed)?;
        if let Some(scratch) = &self.scratch {
            scratch.write_all_at(bytemuck::cast_slice(values), self.scratch_offset(at)).map_err(failed)?;
        }
        let entry = entry(self.offsets[at], bytes, bytes.len(), crate::codec::Codec::Raw);
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)[at] = Some(entry);
        Ok(())
    }

    /// Twice the place in the file of f32, which leaves more than room enough.
    fn scratch_offset(&self, at: usize) -> u64 {
        2 * (self.offsets[at] - HEADER_LEN as u64)
    }

    /// Reads back, in double precision, a tile that was put.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`].
    ///
    /// # Panics
    ///
    /// If the tile isn't of the grid's size, or tiles of f32 are not kept for it.
    pub fn get(&self, row: usize, column: usize, values: &mut [f64]) -> Result<(), StoreError> {
        assert_eq!(values.len(), self.header.grid.len(row, column), "values of tile ({row}, {column})");
        let at = self.header.grid.index(row, column);
        let (file, offset) = match (&self.scratch, self.header.scalar) {
            (Some(scratch), _) => (scratch, self.scratch_offset(at)),
            (None, Scalar::F64) => (self.temporary.as_file(), self.offsets[at]),
            (None, Scalar::F32) => panic!("begun without read_back"),
        };
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(values);
        file.read_exact_at(bytes, offset).map_err(StoreError::io(&self.path, "cannot read back"))
    }

    /// Asks the system to start reading the tiles of a tile column from a row on. Advice only.
    pub fn will_need(&self, row: usize, column: usize) {
        let last = self.header.grid.columns() - 1;
        let (first, last) = (self.header.grid.index(row, column), self.header.grid.index(last, column));
        let (file, start, end) = match &self.scratch {
            Some(scratch) => (scratch, self.scratch_offset(first), self.scratch_offset(last)),
            None => (self.temporary.as_file(), self.offsets[first], self.offsets[last]),
        };
        let len = std::num::NonZeroU64::new(end - start);
        if len.is_some() {
            let _ = rustix::fs::fadvise(file, start, len, rustix::fs::Advice::WillNeed);
        }
    }

    /// Writes header, table and footer, waits for the disk, and gives the file its name. Returns its length, or `None`
    /// when another builder has published the same factor first, which then stays.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`], with nothing left.
    ///
    /// # Panics
    ///
    /// If a tile wasn't put.
    pub fn publish(mut self, condition: Condition) -> Result<Option<u64>, StoreError> {
        self.header.condition = condition;
        let header = self.header.encode();
        let failed = |error| StoreError::io(&self.path, "cannot write")(error);
        self.temporary.as_file().write_all_at(&header, 0).map_err(failed)?;
        let entries = self.entries.into_inner().unwrap_or_else(PoisonError::into_inner);
        let entries: Vec<Entry> = entries.into_iter().flatten().collect();
        assert_eq!(entries.len(), self.header.grid.count(), "every tile was put");
        let published = publish(self.temporary, &self.path, &header, &entries, ROOT_CONTEXT)?;
        match published {
            None => drop(FactorFile::open(&self.path)?),
            Some(_) => sync_folder(self.path.parent().unwrap_or(Path::new(".")))?,
        }
        Ok(published)
    }
}
