//! Building the basis of a scheme: every missing `A_l` up to a degree.
//!
//! Threads take runs of rows (chunks) and sweep through the degrees, so that memory doesn't grow with n: a thread holds
//! one run's recurrence state and one chunk. Degrees are done in groups: a group's files are open together, and while
//! one group is computed the files of the one before it are brought to disk and given their names. An interrupted build
//! so keeps all groups but the last two; the price is that each group's sweep passes once more over the degrees below
//! it, at a quarter of the cost of computing them.

use std::ops::RangeInclusive;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use spharm_harmonics::{Directions, Recurrence, Sweep};
use spharm_monitor::{Interrupted, Level, Monitor, Stage};

use crate::codec::{Codec, Encoder};
use crate::header::{HEADER_LEN, Header, MAX_CHUNK_ROWS, ROW_MULTIPLE};
use crate::reader::DegreeFile;
use crate::scheme::{Scalar, SchemeKey};
use crate::table::{ENTRY_LEN, FOOTER_LEN};
use crate::writer::{DegreeWriter, file_name, remove_abandoned, sync_folder};
use crate::{StoreError, StoreWarning};

/// Rows of a chunk unless asked otherwise. At degree 100 a chunk (0.8 MB) and the state of its sweep (1.7 MB) are at
/// home in a core's L2 cache; not a multiple of 512, so that the columns don't all fall into the same cache sets.
pub const DEFAULT_CHUNK_ROWS: usize = 520;
/// A build that writes more than this asks first.
pub const LARGE: u64 = 64 << 30;

const GROUPS: u64 = 8;
const SMALLEST_GROUP: u64 = 256 << 20;
const MOST_FILES: usize = 256;

/// What to build.
#[derive(Debug, Clone)]
pub struct BuildParams {
    /// Highest degree, L.
    pub max_degree: usize,
    /// Scalar type of the store.
    pub scalar: Scalar,
    /// Codec of the files that are written; files that are there keep theirs.
    pub codec: Codec,
    /// Rows of a chunk; a scheme that is there already keeps its own.
    pub chunk_rows: usize,
    /// Most bytes of memory to take.
    pub memory: usize,
    /// Most threads to use, on the rayon pool that `build` is called in; 0 for all of that pool's.
    pub threads: usize,
    /// Build even what is large or doesn't seem to fit the disk.
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

/// What a build did.
#[derive(Debug)]
pub struct BuildReport {
    /// The scheme.
    pub key: SchemeKey,
    /// Folder of the scheme.
    pub folder: PathBuf,
    /// Degrees written by this build.
    pub built: usize,
    /// Degrees that were there, or that another builder published meanwhile.
    pub present: usize,
    /// Bytes of the files written.
    pub bytes_written: u64,
    /// Bytes of all files to the highest degree.
    pub bytes: u64,
    /// Rows of a chunk.
    pub chunk_rows: usize,
    /// Threads used.
    pub threads: usize,
    /// Bytes of memory that the plan asked for.
    pub memory: usize,
    /// Damaged files that were replaced, by degree.
    pub warnings: Vec<StoreWarning>,
}

fn file_bytes(rows: usize, degree: usize, scalar: Scalar, chunk_rows: usize) -> u64 {
    let chunks = rows.div_ceil(chunk_rows);
    (rows * (2 * degree + 1) * scalar.size() + chunks * ENTRY_LEN + HEADER_LEN + FOOTER_LEN) as u64
}

/// Builds what is missing of a scheme's basis in `store`.
///
/// Safe to run several times at once on the same key, to interrupt and to kill: what is published stays and is skipped by
/// the next run, and the bytes of a file depend on neither threads nor interruptions.
///
/// The monitor gets one stage, `basis`, in bytes, and a note while another process builds the same scheme.
///
/// # Errors
///
/// [`StoreError::Space`] and [`StoreError::Budget`] before anything is written; [`StoreError::Io`],
/// [`StoreError::Interrupted`] later, with nothing half-written left.
pub fn build(
    store: &Path,
    directions: &Directions,
    params: &BuildParams,
    monitor: &dyn Monitor,
) -> Result<BuildReport, StoreError> {
    if params.chunk_rows == 0 || params.chunk_rows > MAX_CHUNK_ROWS || !params.chunk_rows.is_multiple_of(ROW_MULTIPLE) {
        return Err(StoreError::ChunkRows { found: params.chunk_rows });
    }
    let recurrence = Recurrence::new(params.max_degree)?;
    let key = SchemeKey::of(directions, params.scalar);
    let folder = store.join(key.to_string());
    let scan = Scan::of(&folder, key, directions.len(), params)?;
    // What killed builders left takes the room that this one may need.
    if folder.is_dir() {
        remove_abandoned(&folder)?;
    }
    // Said before a folder is made: a refusal leaves nothing behind.
    threads_within(&scan, params)?;
    check_space(store, &scan, params)?;
    // A finished scheme is left alone, so that one on a disk that can't be written to is no error.
    let (_lock, scan) = if scan.missing.is_empty() {
        (None, scan)
    } else {
        make_folder(store, &folder)?;
        let lock = lock(&folder, monitor)?;
        // Again, now that nobody else is building: the other one may have published what was missing.
        let scan = Scan::of(&folder, key, directions.len(), params)?;
        remove_abandoned(&folder)?;
        (lock, scan)
    };
    let threads = threads_within(&scan, params)?;
    for (path, _) in &scan.damaged {
        match std::fs::remove_file(path) {
            // A builder that has no lock either was faster.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            removed => removed.map_err(StoreError::io(path, "cannot remove"))?,
        }
    }
    let present = params.max_degree + 1 - scan.missing.len();
    if present > 0 {
        monitor.note(Level::Info, format_args!("{present} degrees are there already"));
    }
    if scan.bytes > 0 {
        monitor.begin(Stage::bytes("basis"), scan.bytes);
    }

    let mut report = BuildReport {
        key,
        folder: folder.clone(),
        built: 0,
        present,
        bytes_written: 0,
        bytes: 0,
        chunk_rows: scan.chunk_rows,
        threads,
        memory: memory_of(&scan, params, threads),
        warnings: Vec::new(),
    };
    let job = Job { directions, recurrence: &recurrence, codec: params.codec, threads, monitor };
    let headers: Vec<Header> = scan.missing.iter().map(|&degree| scan.header(degree, key, params)).collect();
    std::thread::scope(|scope| {
        // One group waits while another is synced: at most three groups of files are open.
        let (to_disk, groups) = sync_channel::<Vec<DegreeWriter>>(1);
        let folder = &folder;
        let publisher = scope.spawn(move || -> Result<(usize, usize, u64), StoreError> {
            let (mut built, mut others, mut bytes) = (0, 0, 0);
            for group in groups {
                for writer in group {
                    match writer.publish()? {
                        Some(len) => (built, bytes) = (built + 1, bytes + len),
                        None => others += 1,
                    }
                }
                sync_folder(folder)?;
            }
            Ok((built, others, bytes))
        });
        let mut computed = Ok(());
        for group in groups_of(&headers) {
            computed = job.run(folder, group).and_then(|writers| {
                // The receiver is gone only when publishing has failed, which is reported below.
                to_disk.send(writers).map_err(|_| Interrupted.into())
            });
            if computed.is_err() {
                break;
            }
        }
        drop(to_disk);
        let published = publisher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        computed?;
        report.built = published.0;
        report.present += published.1;
        report.bytes_written = published.2;
        Ok::<(), StoreError>(())
    })?;
    if scan.bytes > 0 {
        monitor.end();
    }
    report.warnings = scan.damaged.into_iter().map(|(_, error)| StoreWarning::Replaced(error)).collect();
    for degree in 0..=params.max_degree {
        let path = folder.join(file_name(degree));
        report.bytes += std::fs::metadata(&path).map_err(StoreError::io(&path, "cannot open"))?.len();
    }
    Ok(report)
}

/// Which degrees of a scheme are there, which are not, and what the missing ones take.
struct Scan {
    missing: Vec<usize>,
    damaged: Vec<(PathBuf, StoreError)>,
    chunk_rows: usize,
    rows: usize,
    bytes: u64,
}

impl Scan {
    fn of(folder: &Path, key: SchemeKey, rows: usize, params: &BuildParams) -> Result<Self, StoreError> {
        let mut scan = Self { missing: Vec::new(), damaged: Vec::new(), chunk_rows: 0, rows, bytes: 0 };
        for degree in 0..=params.max_degree {
            let path = folder.join(file_name(degree));
            match DegreeFile::open(&path).and_then(|file| scan.accept(&file, key, degree, params.scalar)) {
                Ok(()) => {}
                Err(StoreError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                    scan.missing.push(degree);
                }
                Err(error @ (StoreError::Corrupt { .. } | StoreError::ChangedWhileRead { .. })) => {
                    scan.damaged.push((path, error));
                    scan.missing.push(degree);
                }
                Err(error) => return Err(error),
            }
        }
        if scan.chunk_rows == 0 {
            scan.chunk_rows = params.chunk_rows;
        }
        let bytes = |&degree: &usize| file_bytes(rows, degree, params.scalar, scan.chunk_rows);
        scan.bytes = scan.missing.iter().map(bytes).sum();
        let highest = scan.header(params.max_degree, key, params);
        if !highest.is_within_bounds() {
            let Header { rows, degree, chunk_rows, .. } = highest;
            return Err(StoreError::Layout { rows, degree, chunk_rows });
        }
        Ok(scan)
    }

    /// Takes a file that is there as one of this scheme's. The first one settles the chunks' rows.
    fn accept(&mut self, file: &DegreeFile, key: SchemeKey, degree: usize, scalar: Scalar) -> Result<(), StoreError> {
        let header = file.header();
        let says = |key: SchemeKey, scalar: Scalar, degree: usize, rows: usize| {
            format!("{} ({}) degree {degree} of {rows} rows", key.short(), scalar.name())
        };
        let expected = says(key, scalar, degree, self.rows);
        let found = says(header.key, header.scalar, header.degree, header.rows);
        // The key is longer than what is shown of it.
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
}

/// Runs of degrees whose files are written together.
fn groups_of(headers: &[Header]) -> Vec<&[Header]> {
    let bytes = |h: &Header| file_bytes(h.rows, h.degree, h.scalar, h.chunk_rows);
    let total: u64 = headers.iter().map(bytes).sum();
    let target = (total / GROUPS).max(SMALLEST_GROUP);
    let mut groups = Vec::new();
    let (mut start, mut sum) = (0, 0);
    for (at, header) in headers.iter().enumerate() {
        sum += bytes(header);
        if sum >= target || at + 1 - start == MOST_FILES || at + 1 == headers.len() {
            groups.push(&headers[start..=at]);
            (start, sum) = (at + 1, 0);
        }
    }
    groups
}

struct Job<'a> {
    directions: &'a Directions,
    recurrence: &'a Recurrence,
    codec: Codec,
    threads: usize,
    monitor: &'a dyn Monitor,
}

impl Job<'_> {
    /// Computes a group of degrees; on an error the temporary files are gone.
    fn run(&self, folder: &Path, group: &[Header]) -> Result<Vec<DegreeWriter>, StoreError> {
        let writers: Vec<_> =
            group.iter().map(|header| DegreeWriter::create(folder, header.clone())).collect::<Result<_, _>>()?;
        let next = AtomicUsize::new(0);
        // Stops the other threads when one fails.
        let failed = AtomicBool::new(false);
        let first_error = Mutex::new(None);
        let chunks = group[0].chunk_count();
        rayon::scope(|scope| {
            for _ in 0..self.threads.min(chunks) {
                scope.spawn(|_| {
                    let result = self.work(group, &writers, &next, &failed);
                    if let Err(error) = result {
                        failed.store(true, Ordering::Relaxed);
                        let mut first = first_error.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                        // A thread that stopped because another failed has nothing to tell.
                        if first.is_none() || matches!(*first, Some(StoreError::Interrupted(_))) {
                            *first = Some(error);
                        }
                    }
                });
            }
        });
        match first_error.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner) {
            Some(error) => Err(error),
            None => Ok(writers),
        }
    }

    fn work(
        &self,
        group: &[Header],
        writers: &[DegreeWriter],
        next: &AtomicUsize,
        failed: &AtomicBool,
    ) -> Result<(), StoreError> {
        let mut encoder = match self.codec {
            Codec::Raw => None,
            Codec::Zstd => Some(Encoder::new().map_err(StoreError::io(Path::new("zstd"), "cannot start"))?),
        };
        let degrees: RangeInclusive<usize> = group[0].degree..=group[group.len() - 1].degree;
        let mut block = Vec::new();
        let mut single = Vec::new();
        loop {
            let chunk = next.fetch_add(1, Ordering::Relaxed);
            if chunk >= group[0].chunk_count() {
                return Ok(());
            }
            let rows = group[0].chunk_range(chunk);
            let mut sweep = Sweep::new(self.recurrence, &self.directions.as_slice()[rows.clone()]);
            let mut writer = writers.iter().zip(group).peekable();
            for degree in 0..=*degrees.end() {
                if self.monitor.cancelled() || failed.load(Ordering::Relaxed) {
                    failed.store(true, Ordering::Relaxed);
                    return Err(Interrupted.into());
                }
                let Some((writer, header)) = writer.next_if(|(_, header)| header.degree == degree) else {
                    sweep.skip_degree();
                    continue;
                };
                block.resize(rows.len() * header.columns(), 0.0);
                sweep.next_degree(&mut block);
                let raw: &[u8] = match header.scalar {
                    Scalar::F64 => bytemuck::cast_slice(&block),
                    Scalar::F32 => {
                        single.clear();
                        single.extend(block.iter().map(|&value| value as f32));
                        bytemuck::cast_slice(&single)
                    }
                };
                writer.put(chunk, raw, encoder.as_mut(), failed)?;
                self.monitor.step(raw.len() as u64);
            }
        }
    }
}

/// The most threads, up to those asked for, that the budget has room for.
fn threads_within(scan: &Scan, params: &BuildParams) -> Result<usize, StoreError> {
    let needed = memory_of(scan, params, 1);
    if params.memory < needed {
        return Err(StoreError::Budget { budget: params.memory, needed });
    }
    let fits = |threads: &usize| memory_of(scan, params, *threads) <= params.memory;
    let most = if params.threads == 0 { rayon::current_num_threads() } else { params.threads };
    Ok((1..=most).rev().find(fits).unwrap_or(1))
}

/// Bytes of memory that a build takes: the coefficients of the recurrence, and for each thread its sweep and a chunk.
fn memory_of(scan: &Scan, params: &BuildParams, threads: usize) -> usize {
    /// The program itself, its stacks and allocator, measured on an empty build.
    const BASE: usize = 8 << 20;
    let rows = scan.chunk_rows.min(scan.rows);
    let chunk = rows * (2 * params.max_degree + 1) * 8;
    let single = if params.scalar == Scalar::F32 { chunk / 2 } else { 0 };
    let encoder = if params.codec == Codec::Zstd { Encoder::bytes(chunk) } else { 0 };
    let thread = Sweep::bytes(rows, params.max_degree) + chunk + single + encoder;
    BASE + Recurrence::bytes(params.max_degree) + threads * thread
}

fn check_space(store: &Path, scan: &Scan, params: &BuildParams) -> Result<(), StoreError> {
    if params.allow_large || scan.missing.is_empty() {
        return Ok(());
    }
    let free = free_space(store)?;
    let remedy = if scan.bytes > free {
        "choose a --store with more room, a lower --max-degree or --dtype f32, or go on all the same with --yes"
    } else if scan.bytes > LARGE {
        "go on with --yes, or choose a lower --max-degree or --dtype f32"
    } else {
        return Ok(());
    };
    Err(StoreError::Space { path: store.to_path_buf(), what: "basis", needed: scan.bytes, free, remedy })
}

/// Bytes free on the disk that a store is, or will be, on.
pub(crate) fn free_space(store: &Path) -> Result<u64, StoreError> {
    // The folder may not be there yet: ask for the nearest one that is.
    let existing = store.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    let existing = if existing.as_os_str().is_empty() { Path::new(".") } else { existing };
    let statistics =
        rustix::fs::statvfs(existing).map_err(|e| StoreError::io(existing, "cannot ask for space")(e.into()))?;
    Ok(statistics.f_bavail.saturating_mul(statistics.f_frsize))
}

pub(crate) fn make_folder(store: &Path, folder: &Path) -> Result<(), StoreError> {
    if !folder.is_dir() {
        std::fs::create_dir_all(folder).map_err(StoreError::io(folder, "cannot create"))?;
        sync_folder(store)?;
    }
    Ok(())
}

/// Waits until no other process builds this scheme. It only spares double work: without a lock (where the file system
/// has none) builders are safe as well.
pub(crate) fn lock(folder: &Path, monitor: &dyn Monitor) -> Result<Option<std::fs::File>, StoreError> {
    let path = folder.join(".lock");
    let open = |write: bool| {
        let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
        std::fs::OpenOptions::new().read(true).write(write).create(write).custom_flags(flags).open(&path)
    };
    // Where another user made it, reading is all one may do, and enough. Where there can be none, go on without: a
    // folder that can't be written to shows when the first file is created.
    let Ok(file) = open(true).or_else(|_| open(false)) else { return Ok(None) };
    let mut told = false;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(std::fs::TryLockError::Error(_)) => return Ok(None),
            Err(std::fs::TryLockError::WouldBlock) => {}
        }
        if !std::mem::replace(&mut told, true) {
            let text = "another basis-build is at work on this scheme; waiting for it";
            monitor.note(Level::Info, format_args!("{text}"));
        }
        monitor.check()?;
        std::thread::sleep(Duration::from_millis(100));
    }
}
