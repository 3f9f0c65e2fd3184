//! Writes a Cholesky factor: several threads may write tiles in any order, and read back tiles that have been written
//! while others are being computed.
//!
//! The header is written last, because its condition estimate needs the complete factor.

use std::fs::File;
use std::num::NonZeroU64;
use std::path::Path;

use crate::container::codec::Codec;
use crate::container::frame::{ALIGNMENT, HEADER_LEN};
use crate::container::writer::ContainerWriter;
use crate::error::StoreError;
use crate::factor::grid::TileGrid;
use crate::factor::header::{Condition, FactorHeader};
use crate::factor::spec::FactorSpec;
use crate::folder;
use crate::platform;
use crate::scheme::Scalar;

/// A factor being written. Threads may write different tiles at the same time.
#[derive(Debug)]
pub struct FactorWriter {
    header: FactorHeader,
    file: ContainerWriter,
    /// Double-precision copies of the tiles, for reading them back, if the factor is stored in single precision. This
    /// file has no name, so the system removes it even if the process is killed.
    scratch: Option<File>,
    /// Offset of each tile in the file, in bytes.
    offsets: Vec<u64>,
    /// Lock on the scheme's folder, which keeps other builders from computing the same factor.
    _lock: Option<File>,
}

impl FactorWriter {
    /// Creates the temporary file of a factor in a scheme's folder. With `read_back`, f32 tiles are also kept in double
    /// precision.
    pub(crate) fn create(
        folder: &Path,
        spec: &FactorSpec,
        scalar: Scalar,
        grid: TileGrid,
        read_back: bool,
        lock: Option<File>,
    ) -> Result<Self, StoreError> {
        let header = FactorHeader { spec: *spec, scalar, grid, condition: Condition { norm: 0.0, reciprocal: 0.0 } };
        let prefix = format!("factor_{}", spec.max_degree);
        let file = ContainerWriter::create(folder, &spec.file_name(scalar), &prefix, grid.count())?;
        let scratch = (read_back && scalar == Scalar::F32).then(|| tempfile::tempfile_in(folder));
        let scratch = scratch.transpose().map_err(StoreError::io(folder, "cannot create a file in the store"))?;
        let mut offsets = Vec::with_capacity(grid.count());
        let mut next = HEADER_LEN as u64;
        for (row, column) in grid.tiles() {
            offsets.push(next);
            next = (next + header.tile_len(row, column) as u64).next_multiple_of(ALIGNMENT);
        }
        Ok(Self { header, file, scratch, offsets, _lock: lock })
    }

    /// Returns the division of the factor into tiles.
    pub fn grid(&self) -> TileGrid {
        self.header.grid
    }

    /// Writes a tile, given column-major without gaps between columns. Diagonal tiles must have zeros above the
    /// diagonal.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`] if the tile can't be written.
    ///
    /// # Panics
    ///
    /// If `values` doesn't have the tile's length, or if the tile lies above the diagonal or outside the grid.
    pub fn put(&self, row: usize, column: usize, values: &[f64]) -> Result<(), StoreError> {
        assert_eq!(
            values.len(),
            self.header.grid.len(row, column),
            "expected one value per element of tile ({row}, {column})"
        );
        let at = self.header.grid.index(row, column);
        let single: Vec<f32>;
        let bytes: &[u8] = match self.header.scalar {
            Scalar::F64 => bytemuck::cast_slice(values),
            Scalar::F32 => {
                single = values.iter().map(|&value| value as f32).collect();
                bytemuck::cast_slice(&single)
            }
        };
        if let Some(scratch) = &self.scratch {
            let failed = StoreError::io(self.file.path(), "cannot write");
            platform::write_all_at(scratch, bytemuck::cast_slice(values), self.scratch_offset(at)).map_err(failed)?;
        }
        self.file.write_part(at, self.offsets[at], bytes, bytes.len(), Codec::Raw)
    }

    /// Returns the offset of a tile in the scratch file, in bytes. This offset is twice the distance of the tile from
    /// the first tile in the f32 file, because f64 values are twice as large.
    fn scratch_offset(&self, at: usize) -> u64 {
        2 * (self.offsets[at] - HEADER_LEN as u64)
    }

    /// Reads back a tile that [`put`](Self::put) has written, in double precision.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`] if the tile can't be read.
    ///
    /// # Panics
    ///
    /// If `values` doesn't have the tile's length, or if the factor's f32 tiles aren't kept for reading back.
    pub fn get(&self, row: usize, column: usize, values: &mut [f64]) -> Result<(), StoreError> {
        assert_eq!(
            values.len(),
            self.header.grid.len(row, column),
            "expected one value per element of tile ({row}, {column})"
        );
        let at = self.header.grid.index(row, column);
        let (file, offset) = match (&self.scratch, self.header.scalar) {
            (Some(scratch), _) => (scratch, self.scratch_offset(at)),
            (None, Scalar::F64) => (self.file.file(), self.offsets[at]),
            (None, Scalar::F32) => panic!("reading back an f32 factor requires read_back"),
        };
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(values);
        platform::read_exact_at(file, bytes, offset).map_err(StoreError::io(self.file.path(), "cannot read back"))
    }

    /// Asks the system to start reading the tiles of tile column `column`, from tile row `row` downwards, from disk.
    /// The request is only a hint, so a failure is ignored.
    ///
    /// # Panics
    ///
    /// If the tile (row, column) lies above the diagonal or outside the grid.
    pub fn will_need(&self, row: usize, column: usize) {
        let last = self.header.grid.columns() - 1;
        let (first, last) = (self.header.grid.index(row, column), self.header.grid.index(last, column));
        let (file, start, end) = match &self.scratch {
            Some(scratch) => (scratch, self.scratch_offset(first), self.scratch_offset(last)),
            None => (self.file.file(), self.offsets[first], self.offsets[last]),
        };
        if let Some(len) = NonZeroU64::new(end - start) {
            platform::file_will_need(file, start, len);
        }
    }

    /// Writes the header, table and footer, syncs the file to disk, and gives it its final name. Returns the file's
    /// length in bytes. If another builder has published the same factor first, keeps that builder's file and returns
    /// `None`.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`] if the file can't be written; the temporary file is then removed.
    ///
    /// # Panics
    ///
    /// If a tile hasn't been written.
    pub fn publish(mut self, condition: Condition) -> Result<Option<u64>, StoreError> {
        self.header.condition = condition;
        let path = self.file.path().to_path_buf();
        let published = self.file.publish(&self.header)?;
        // Sync the folder even if another builder published the factor first. This function guarantees that the factor
        // is on disk, but the other builder may not have synced the folder yet.
        folder::sync(path.parent().unwrap_or(Path::new(".")))?;
        Ok(published)
    }
}
