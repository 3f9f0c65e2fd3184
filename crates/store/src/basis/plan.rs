//! Plans a build: determines the missing degrees, their grouping, and the memory and disk space needed.

use std::path::{Path, PathBuf};

use spharm_harmonics::{Recurrence, Sweep};

use crate::basis::header::Header;
use crate::basis::reader::DegreeFile;
use crate::basis::writer::file_name;
use crate::container::codec::{Codec, Encoder};
use crate::container::frame::HEADER_LEN;
use crate::container::table::{ENTRY_LEN, FOOTER_LEN};
use crate::error::StoreError;
use crate::folder;
use crate::format::{MAX_CHUNK_ROWS, ROW_MULTIPLE};
use crate::scheme::{Scalar, SchemeKey};

/// Default number of rows in a chunk. At degree 100 a chunk (0.8 MB) and the recurrence state for it (1.7 MB) fit in a
/// core's L2 cache. With a multiple of 512 rows, the columns of a chunk would compete for the same cache sets.
pub const DEFAULT_CHUNK_ROWS: usize = 520;

/// Number of groups of degrees that a large build is divided into.
const GROUPS: u64 = 8;
/// Minimum total size of the files of a group, in bytes before compression. Small builds are therefore divided into
/// fewer groups than large ones. The last group, and groups of `MOST_FILES` files, may be smaller.
const SMALLEST_GROUP: u64 = 256 << 20;
/// Maximum number of files (degrees) in a group.
const MOST_FILES: usize = 256;

/// Parameters for building a basis.
#[derive(Debug, Clone)]
pub struct BuildParams {
    /// Highest degree, L, inclusive; default 100.
    pub max_degree: usize,
    /// Scalar type of the files; default [`Scalar::F64`].
    pub scalar: Scalar,
    /// Codec of the files to write; existing files aren't converted. Default [`Codec::Raw`].
    pub codec: Codec,
    /// Number of rows per chunk: a multiple of 8, at most 2^20. If the scheme already has files, their number of rows
    /// per chunk is used instead. Default [`DEFAULT_CHUNK_ROWS`].
    pub chunk_rows: usize,
    /// Memory budget in bytes; default 512 MiB.
    pub memory: usize,
    /// Maximum number of threads used from the caller's rayon pool; 0 (default) for all threads of the pool.
    pub threads: usize,
    /// Whether to build even if the files are larger than 64 GiB or than the free disk space; default false.
    pub allow_large: bool,
}

impl Default for BuildParams {
    fn default() -> Self {
        Self {
            max_degree: 100,
            scalar: Scalar::F64,
            codec: Codec::Raw,
            chunk_rows: DEFAULT_CHUNK_ROWS,
            memory: 512 << 20,
            threads: 0,
            allow_large: false,
        }
    }
}

impl BuildParams {
    pub(super) fn check(&self) -> Result<(), StoreError> {
        let rows = self.chunk_rows;
        if rows == 0 || rows > MAX_CHUNK_ROWS || !rows.is_multiple_of(ROW_MULTIPLE) {
            return Err(StoreError::ChunkRows { found: rows });
        }
        Ok(())
    }
}

/// The degrees whose files are missing from a scheme, and the sizes needed to plan their build.
pub(super) struct Plan {
    pub(super) missing: Vec<usize>,
    /// Damaged files and their errors. The build replaces these files; `missing` includes their degrees.
    pub(super) damaged: Vec<(PathBuf, StoreError)>,
    pub(super) chunk_rows: usize,
    rows: usize,
    /// Size in bytes of the missing files before compression.
    pub(super) bytes: u64,
}

impl Plan {
    /// Opens the file of every requested degree, with all checks except those of the chunks, and records the missing
    /// and the damaged files.
    pub(super) fn new(folder: &Path, key: SchemeKey, rows: usize, params: &BuildParams) -> Result<Self, StoreError> {
        let mut plan = Self { missing: Vec::new(), damaged: Vec::new(), chunk_rows: 0, rows, bytes: 0 };
        for degree in 0..=params.max_degree {
            let path = folder.join(file_name(degree));
            match DegreeFile::open(&path).and_then(|file| plan.accept(&file, key, degree, params.scalar)) {
                Ok(()) => {}
                Err(error) if error.is_not_found() => plan.missing.push(degree),
                Err(error @ (StoreError::Corrupt { .. } | StoreError::ChangedWhileRead { .. })) => {
                    plan.damaged.push((path, error));
                    plan.missing.push(degree);
                }
                Err(error) => return Err(error),
            }
        }
        if plan.chunk_rows == 0 {
            plan.chunk_rows = params.chunk_rows;
        }
        let bytes = |&degree: &usize| file_bytes(&plan.header(degree, key, params));
        plan.bytes = plan.missing.iter().map(bytes).sum();
        let highest = plan.header(params.max_degree, key, params);
        if !highest.is_within_limits() {
            let Header { rows, degree, chunk_rows, .. } = highest;
            return Err(StoreError::Layout { rows, degree, chunk_rows });
        }
        Ok(plan)
    }

    /// Checks that an existing file belongs to this scheme. The first accepted file determines the number of rows per
    /// chunk.
    fn accept(&mut self, file: &DegreeFile, key: SchemeKey, degree: usize, scalar: Scalar) -> Result<(), StoreError> {
        let header = file.header();
        let describe = |key: SchemeKey, scalar: Scalar, degree: usize, rows: usize| {
            format!("scheme {} ({}), degree {degree}, {rows} rows", key.short(), scalar.name())
        };
        let expected = describe(key, scalar, degree, self.rows);
        let found = describe(header.key, header.scalar, header.degree, header.rows);
        // Compare the keys in addition to the descriptions, which contain only the keys' first digits.
        if header.key != key || found != expected {
            return Err(StoreError::corrupt(file.path(), "contents", expected, found));
        }
        if self.chunk_rows == 0 {
            self.chunk_rows = header.chunk_rows;
        }
        if header.chunk_rows != self.chunk_rows {
            let (expected, found) = (self.chunk_rows, header.chunk_rows);
            return Err(StoreError::ChunkRowsDiffer { path: file.path().to_path_buf(), expected, found });
        }
        Ok(())
    }

    fn header(&self, degree: usize, key: SchemeKey, params: &BuildParams) -> Header {
        let (rows, chunk_rows) = (self.rows, self.chunk_rows);
        Header { key, rows, degree, scalar: params.scalar, codec: params.codec, chunk_rows }
    }

    /// Returns the headers of the missing files, in order of degree.
    pub(super) fn headers(&self, key: SchemeKey, params: &BuildParams) -> Vec<Header> {
        self.missing.iter().map(|&degree| self.header(degree, key, params)).collect()
    }

    /// Returns the number of threads to use: the requested number, or fewer if the memory budget requires it.
    pub(super) fn threads(&self, params: &BuildParams) -> Result<usize, StoreError> {
        let needed = self.memory(params, 1);
        if params.memory < needed {
            return Err(StoreError::Budget { budget: params.memory, needed });
        }
        let most = if params.threads == 0 { rayon::current_num_threads() } else { params.threads };
        let fits = |threads: &usize| self.memory(params, *threads) <= params.memory;
        Ok((1..=most).rev().find(fits).unwrap_or(1))
    }

    /// Returns the memory in bytes that a build needs: the coefficients of the recurrence and, for each thread, the
    /// recurrence state and the values of one chunk.
    pub(super) fn memory(&self, params: &BuildParams, threads: usize) -> usize {
        /// Memory of the program itself with its stacks and allocator, measured on an empty build.
        const BASE: usize = 8 << 20;
        let rows = self.chunk_rows.min(self.rows);
        let chunk = rows * (2 * params.max_degree + 1) * 8;
        let single = if params.scalar == Scalar::F32 { chunk / 2 } else { 0 };
        let encoder = if params.codec == Codec::Zstd { Encoder::bytes(chunk) } else { 0 };
        let thread = Sweep::bytes(rows, params.max_degree) + chunk + single + encoder;
        BASE + Recurrence::bytes(params.max_degree) + threads * thread
    }

    /// Returns an error if the missing files exceed the free disk space or 64 GiB, unless `allow_large` is set.
    pub(super) fn check_space(&self, store: &Path, params: &BuildParams) -> Result<(), StoreError> {
        if params.allow_large || self.missing.is_empty() {
            return Ok(());
        }
        folder::check_space(store, "basis", self.bytes)
    }
}

/// Returns the size in bytes of a file before compression, not counting the padding between chunks.
fn file_bytes(header: &Header) -> u64 {
    let values = header.rows * header.columns() * header.scalar.size();
    (values + header.chunk_count() * ENTRY_LEN + HEADER_LEN + FOOTER_LEN) as u64
}

/// Splits the headers of the missing files into groups. The files of a group are written together.
pub(super) fn groups(headers: &[Header]) -> Vec<&[Header]> {
    let total: u64 = headers.iter().map(file_bytes).sum();
    let target = (total / GROUPS).max(SMALLEST_GROUP);
    let mut groups = Vec::new();
    let (mut start, mut sum) = (0, 0);
    for (at, header) in headers.iter().enumerate() {
        sum += file_bytes(header);
        if sum >= target || at + 1 - start == MOST_FILES || at + 1 == headers.len() {
            groups.push(&headers[start..=at]);
            (start, sum) = (at + 1, 0);
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: SchemeKey = SchemeKey([7; 32]);

    fn plan(rows: usize, params: &BuildParams) -> Plan {
        Plan::new(Path::new("/nowhere"), KEY, rows, params).unwrap()
    }

    /// Recomputes the memory of a build independently from the parts that `Plan::memory` documents.
    #[test]
    fn memory_is_that_of_the_recurrence_and_of_each_thread() {
        for (rows, chunk_rows, used_rows) in [(1000, 64, 64), (40, 64, 40)] {
            for (scalar, codec) in [(Scalar::F64, Codec::Raw), (Scalar::F32, Codec::Raw), (Scalar::F64, Codec::Zstd)] {
                let params = BuildParams { max_degree: 50, chunk_rows, scalar, codec, ..BuildParams::default() };
                let plan = plan(rows, &params);
                let values = used_rows * 101;
                let mut thread = Sweep::bytes(used_rows, 50) + values * 8;
                thread += if scalar == Scalar::F32 { values * 4 } else { 0 };
                // Encoder memory: the shuffled bytes, zstd's largest possible output, and zstd's tables.
                let bound = zstd::zstd_safe::compress_bound(values * 8);
                thread += if codec == Codec::Zstd { values * 8 + bound + (2 << 20) } else { 0 };
                assert_eq!(plan.memory(&params, 1), (8 << 20) + Recurrence::bytes(50) + thread);
                assert_eq!(plan.memory(&params, 3), (8 << 20) + Recurrence::bytes(50) + 3 * thread);
            }
        }
    }

    #[test]
    fn as_many_threads_as_the_budget_has_room_for() {
        let params = BuildParams { threads: 4, ..BuildParams::default() };
        let plan = plan(10_000, &params);
        let threads = |memory, threads| plan.threads(&BuildParams { memory, threads, ..BuildParams::default() });
        for count in 1..=4 {
            let needed = plan.memory(&params, count);
            assert_eq!(threads(needed, 4).unwrap(), count);
            assert_eq!(threads(needed - 1, 4).ok(), (count > 1).then_some(count - 1));
            assert_eq!(threads(usize::MAX, count).unwrap(), count);
        }
        assert_eq!(threads(usize::MAX, 0).unwrap(), rayon::current_num_threads());
        let error = threads(1000, 4).unwrap_err();
        let least = plan.memory(&params, 1);
        assert!(matches!(error, StoreError::Budget { budget: 1000, needed } if needed == least), "{error}");
    }

    /// The file of degree 2 with 100 rows in chunks of 8 has 13 table entries of 64 bytes, a header of 4,096 bytes and
    /// a footer of 128 bytes.
    #[test]
    fn bytes_are_those_of_values_table_header_and_footer() {
        let params = BuildParams { max_degree: 2, chunk_rows: 8, ..BuildParams::default() };
        let plan = plan(100, &params);
        assert_eq!(file_bytes(&plan.headers(KEY, &params)[2]), 100 * 5 * 8 + 13 * 64 + 4096 + 128);
        assert_eq!(plan.bytes, 100 * 9 * 8 + 3 * (13 * 64 + 4096 + 128));
        assert_eq!(plan.missing, [0, 1, 2]);
        assert!(plan.damaged.is_empty());
    }

    #[test]
    fn limits_of_the_format_are_kept() {
        let header = |rows, degree, scalar, chunk_rows| {
            Header { key: KEY, rows, degree, scalar, codec: Codec::Raw, chunk_rows }.is_within_limits()
        };
        // The limit of 2^32 bytes per chunk allows at most 511 columns of 2^20 doubles, or 1,023 columns of
        // single-precision values.
        assert!(header(100, 255, Scalar::F64, 1 << 20) && !header(100, 256, Scalar::F64, 1 << 20));
        assert!(header(100, 511, Scalar::F32, 1 << 20) && !header(100, 512, Scalar::F32, 1 << 20));
        // The limits of the format are 2^22 chunks and 2^40 rows.
        assert!(header(8 << 22, 1, Scalar::F64, 8) && !header((8 << 22) + 1, 1, Scalar::F64, 8));
        assert!(header(1 << 40, 1, Scalar::F64, 1 << 20) && !header((1 << 40) + 1, 1, Scalar::F64, 1 << 20));
    }

    /// Each degree is in exactly one group, in order. No group has more than 256 files. Each group except the last
    /// either reaches the minimum size or has 256 files.
    #[test]
    fn groups_share_out_the_degrees() {
        for (rows, max_degree) in [(18, 2), (18, 700), (40_962, 100), (163_842, 300)] {
            let params = BuildParams { max_degree, ..BuildParams::default() };
            let headers = plan(rows, &params).headers(KEY, &params);
            let groups = groups(&headers);
            let degrees: Vec<usize> = groups.iter().copied().flatten().map(|header| header.degree).collect();
            assert!(degrees.into_iter().eq(0..=max_degree));
            let total: u64 = headers.iter().map(file_bytes).sum();
            let target = (total / 8).max(256 << 20);
            for (at, group) in groups.iter().enumerate() {
                let bytes: u64 = group.iter().map(file_bytes).sum();
                let but_one: u64 = bytes - file_bytes(&group[group.len() - 1]);
                assert!(!group.is_empty() && group.len() <= 256 && but_one < target);
                assert!(bytes >= target || group.len() == 256 || at + 1 == groups.len(), "{rows} {max_degree} {at}");
            }
        }
    }
}
