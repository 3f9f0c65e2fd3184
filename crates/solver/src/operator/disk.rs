//! A basis in a store. A block consists of windows: memory maps of the files of its degrees.

use std::ops::RangeInclusive;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::product::Matrix;
use spharm_store::{ChunkWindow, DegreeFile, Scheme};

use super::products::{apply_adjoint_by_blocks, apply_by_blocks};
use super::{Block, BlockOperator, Operator, Residency, Scratch};
use crate::SolverError;

/// A basis in a store, which is streamed from disk.
#[derive(Debug)]
pub struct DiskOperator {
    scheme: Scheme,
}

impl DiskOperator {
    /// Creates the operator over all degrees of an open scheme.
    pub fn new(scheme: Scheme) -> Self {
        Self { scheme }
    }

    /// Returns whether the entire basis can be used in place in the memory maps, without decoding.
    pub fn is_direct(&self) -> bool {
        self.scheme.files().iter().all(DegreeFile::is_direct)
    }

    fn files(&self, degrees: &RangeInclusive<usize>) -> &[DegreeFile] {
        &self.scheme.files()[degrees.clone()]
    }
}

impl Operator for DiskOperator {
    fn rows(&self) -> usize {
        self.scheme.files()[0].header().rows
    }

    fn max_degree(&self) -> usize {
        self.scheme.max_degree()
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        apply_by_blocks(self, x)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        apply_adjoint_by_blocks(self, r)
    }
}

impl BlockOperator for DiskOperator {
    fn chunk_rows(&self) -> usize {
        self.scheme.files()[0].header().chunk_rows
    }

    fn resident_bytes(&self, degrees: &RangeInclusive<usize>, residency: Residency, threads: usize) -> usize {
        let files = self.files(degrees);
        let of = |file: &DegreeFile| {
            let mapped = match residency {
                Residency::Whole => file.file_len() as usize,
                Residency::Chunks => threads * (0..self.chunk_count()).map(|c| file.stored_len(c)).max().unwrap_or(0),
            };
            let rows = match residency {
                Residency::Whole => self.rows(),
                Residency::Chunks => threads * self.chunk_rows(),
            };
            // Decoding needs a buffer for the raw bytes and another for the bytes before unshuffling.
            let decoded = if file.is_direct() { 0 } else { rows * file.header().columns() * 8 };
            let passing = if file.is_direct() { 0 } else { threads * self.chunk_rows() * file.header().columns() * 16 };
            mapped + decoded + passing
        };
        files.iter().map(of).sum()
    }

    fn open<'a>(
        &'a self,
        degrees: RangeInclusive<usize>,
        residency: Residency,
    ) -> Result<Box<dyn Block + 'a>, SolverError> {
        let files = self.files(&degrees);
        let chunks = self.chunk_count();
        let mut block = DiskBlock {
            files,
            windows: Vec::new(),
            decoded: Vec::new(),
            rows: self.rows(),
            chunk_rows: self.chunk_rows(),
            bytes_read: AtomicU64::new(0),
        };
        if residency == Residency::Whole {
            block.windows = files.iter().map(|file| file.window(0..chunks)).collect::<Result<_, _>>()?;
            block.decoded = files.iter().map(|_| (0..chunks).map(|_| OnceLock::new()).collect()).collect();
            let stored: usize = files.iter().map(|f| (0..chunks).map(|c| f.stored_len(c)).sum::<usize>()).sum();
            *block.bytes_read.get_mut() = stored as u64;
        }
        Ok(Box::new(block))
    }
}

struct DiskBlock<'a> {
    files: &'a [DegreeFile],
    /// Windows (memory maps) on entire files, one per degree; empty if chunks are mapped only while they are used.
    windows: Vec<ChunkWindow<'a>>,
    /// Chunks that had to be decoded, by degree and chunk, kept while the block is open.
    decoded: Vec<Vec<OnceLock<Vec<f64>>>>,
    rows: usize,
    chunk_rows: usize,
    bytes_read: AtomicU64,
}

impl DiskBlock<'_> {
    fn matrix<'m>(&self, file: &DegreeFile, chunk: usize, values: &'m [f64]) -> Matrix<'m> {
        let rows = (self.rows - chunk * self.chunk_rows).min(self.chunk_rows);
        Matrix::new(values, rows, file.header().columns(), rows)
    }

    /// Reads a chunk from the windows on entire files.
    fn read_windows(&self, chunk: usize, read: &mut dyn FnMut(&[Matrix<'_>])) -> Result<(), SolverError> {
        let mut matrices = Vec::with_capacity(self.files.len());
        for ((file, window), decoded) in self.files.iter().zip(&self.windows).zip(&self.decoded) {
            let slot = &decoded[chunk];
            let values = if let Some(values) = slot.get() {
                values
            } else {
                window.populate(chunk);
                match window.in_place(chunk)? {
                    Some(values) => values,
                    None => {
                        let mut values = Vec::new();
                        window.decode(chunk, &mut values)?;
                        slot.get_or_init(|| values)
                    }
                }
            };
            matrices.push(self.matrix(file, chunk, values));
        }
        read(&matrices);
        Ok(())
    }

    /// Reads a chunk through windows that are opened only for this use.
    fn read_files(
        &self,
        chunk: usize,
        scratch: &mut Scratch,
        read: &mut dyn FnMut(&[Matrix<'_>]),
    ) -> Result<(), SolverError> {
        let windows: Vec<_> = self.files.iter().map(|file| file.window(chunk..chunk + 1)).collect::<Result<_, _>>()?;
        scratch.buffers.resize_with(self.files.len().max(scratch.buffers.len()), Vec::new);
        let mut matrices = Vec::with_capacity(self.files.len());
        for ((file, window), buffer) in self.files.iter().zip(&windows).zip(&mut scratch.buffers) {
            window.populate(chunk);
            matrices.push(self.matrix(file, chunk, window.values(chunk, buffer)?));
            self.bytes_read.fetch_add(file.stored_len(chunk) as u64, Ordering::Relaxed);
        }
        read(&matrices);
        Ok(windows.iter().try_for_each(ChunkWindow::check)?)
    }
}

impl Block for DiskBlock<'_> {
    fn chunk(
        &self,
        chunk: usize,
        scratch: &mut Scratch,
        read: &mut dyn FnMut(&[Matrix<'_>]),
    ) -> Result<(), SolverError> {
        if self.windows.is_empty() { self.read_files(chunk, scratch, read) } else { self.read_windows(chunk, read) }
    }

    fn prefetch(&self) {
        self.windows.iter().for_each(ChunkWindow::will_need);
    }

    fn bytes_read(&self) -> u64 {
        self.bytes_read.load(Ordering::Relaxed)
    }

    fn check(&self) -> Result<(), SolverError> {
        Ok(self.windows.iter().try_for_each(ChunkWindow::check)?)
    }
}
