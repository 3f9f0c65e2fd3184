//! Building the basis of a scheme: every missing `A_l` up to a degree.
//!
//! Threads take runs of rows (chunks) and evaluate the recurrence degree by degree, so that memory doesn't grow with n:
//! a thread holds the recurrence state of one run and one chunk. Degrees are built in groups. The files of a group are
//! open together, and while one group is computed, the files of the previous one are brought to disk and given their
//! names. An interrupted build thus keeps all groups except the last two. The price is that each group repeats the
//! recurrence over the degrees below it, at a quarter of the cost of computing them.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Mutex, PoisonError};

use spharm_harmonics::{Directions, Recurrence, Sweep};
use spharm_monitor::{Interrupted, Level, Monitor, Stage};

use crate::basis::header::Header;
use crate::basis::plan::{BuildParams, Plan, groups};
use crate::basis::writer::{DegreeWriter, file_name};
use crate::container::codec::{Codec, Encoder};
use crate::error::{StoreError, StoreWarning};
use crate::scheme::{Scalar, SchemeKey};
use crate::{folder, temporary};

/// Result of a build.
#[derive(Debug)]
pub struct BuildReport {
    /// The scheme.
    pub key: SchemeKey,
    /// Folder of the scheme.
    pub folder: PathBuf,
    /// Degrees written by this build.
    pub built: usize,
    /// Degrees that existed already, or that another builder published meanwhile.
    pub present: usize,
    /// Bytes of the files written.
    pub bytes_written: u64,
    /// Bytes of all files up to the highest degree.
    pub bytes: u64,
    /// Rows of a chunk.
    pub chunk_rows: usize,
    /// Threads used.
    pub threads: usize,
    /// Planned memory in bytes.
    pub memory: usize,
    /// Damaged files that were replaced, by degree.
    pub warnings: Vec<StoreWarning>,
}

/// Builds the missing files of a scheme's basis in `store`: the harmonics at `directions` up to `params.max_degree`.
///
/// It is safe to run several builds of a scheme at once, to interrupt them and to kill them: published files stay and
/// are skipped by the next build. The bytes of a file depend neither on the number of threads nor on interruptions.
///
/// The monitor gets one stage, `basis`, counted in bytes, and a note if the build waits for another process that builds
/// the same scheme.
///
/// # Errors
///
/// Before anything is written: [`StoreError::ChunkRows`], [`StoreError::Layout`] and [`StoreError::Harmonics`] for
/// parameters that the format or the harmonics don't support, [`StoreError::Space`] and [`StoreError::Budget`] if the
/// disk or the memory budget is too small. Later, leaving no incomplete files: [`StoreError::Io`],
/// [`StoreError::Interrupted`].
pub fn build(
    store: &Path,
    directions: &Directions,
    params: &BuildParams,
    monitor: &dyn Monitor,
) -> Result<BuildReport, StoreError> {
    params.check()?;
    let recurrence = Recurrence::new(params.max_degree)?;
    let key = SchemeKey::of(directions, params.scalar);
    let folder = folder::of_scheme(store, key);
    let plan = Plan::new(&folder, key, directions.len(), params)?;
    // The leftovers of killed builds take up space that this build may need.
    if folder.is_dir() {
        temporary::remove_abandoned(&folder)?;
    }
    // Checked before the folder is created, so that a refused build leaves nothing behind.
    plan.threads(params)?;
    plan.check_space(store, params)?;
    // A finished scheme isn't touched, so that one on a read-only disk is no error.
    let (_lock, plan) = if plan.missing.is_empty() {
        (None, plan)
    } else {
        folder::create(store, &folder)?;
        let lock = folder::lock(&folder, monitor)?;
        // Plan again under the lock: the previous holder may have published missing files.
        let plan = Plan::new(&folder, key, directions.len(), params)?;
        temporary::remove_abandoned(&folder)?;
        (lock, plan)
    };
    let threads = plan.threads(params)?;
    plan.damaged.iter().try_for_each(|(path, _)| folder::remove_damaged(path))?;
    let present = params.max_degree + 1 - plan.missing.len();
    if present > 0 {
        monitor.note(Level::Info, format_args!("{present} degrees are there already"));
    }
    let published = if plan.missing.is_empty() {
        Published::default()
    } else {
        let headers = plan.headers(key, params);
        monitor.begin(Stage::bytes("basis"), plan.bytes);
        let computation = Computation { directions, recurrence: &recurrence, codec: params.codec, threads, monitor };
        let published = compute_and_publish(&computation, &folder, &headers)?;
        monitor.end();
        published
    };
    let mut bytes = 0;
    for degree in 0..=params.max_degree {
        let path = folder.join(file_name(degree));
        bytes += std::fs::metadata(&path).map_err(StoreError::io(&path, "cannot open"))?.len();
    }
    Ok(BuildReport {
        key,
        folder,
        built: published.built,
        present: present + published.by_others,
        bytes_written: published.bytes,
        bytes,
        chunk_rows: plan.chunk_rows,
        threads,
        memory: plan.memory(params, threads),
        warnings: plan.damaged.into_iter().map(|(_, error)| StoreWarning::Replaced(error)).collect(),
    })
}

/// Totals of the published files.
#[derive(Default)]
struct Published {
    built: usize,
    /// Number of files that another builder published first.
    by_others: usize,
    /// Bytes of the files built here.
    bytes: u64,
}

/// Computes one group after another while the previous one is brought to disk.
fn compute_and_publish(
    computation: &Computation<'_>,
    folder: &Path,
    headers: &[Header],
) -> Result<Published, StoreError> {
    std::thread::scope(|scope| {
        // One group waits while another is synced: at most three groups of files are open.
        let (to_disk, computed) = sync_channel::<Vec<DegreeWriter>>(1);
        let publisher = scope.spawn(move || -> Result<Published, StoreError> {
            let mut published = Published::default();
            for group in computed {
                for writer in group {
                    match writer.publish()? {
                        Some(len) => (published.built, published.bytes) = (published.built + 1, published.bytes + len),
                        None => published.by_others += 1,
                    }
                }
                folder::sync(folder)?;
            }
            Ok(published)
        });
        let mut result = Ok(());
        for group in groups(headers) {
            result = computation.run(folder, group).and_then(|writers| {
                // The receiver is gone only if publishing has failed, which is reported below.
                to_disk.send(writers).map_err(|_| Interrupted.into())
            });
            if result.is_err() {
                break;
            }
        }
        drop(to_disk);
        let published = publisher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        result?;
        Ok(published)
    })
}

/// State shared by the threads.
struct Computation<'a> {
    directions: &'a Directions,
    recurrence: &'a Recurrence,
    codec: Codec,
    threads: usize,
    monitor: &'a dyn Monitor,
}

impl Computation<'_> {
    /// Computes a group of degrees. On an error the temporary files are removed.
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
                    if let Err(error) = self.work(group, &writers, &next, &failed) {
                        failed.store(true, Ordering::Relaxed);
                        let mut first = first_error.lock().unwrap_or_else(PoisonError::into_inner);
                        // A thread that stopped because another failed has nothing to add.
                        if first.is_none() || matches!(*first, Some(StoreError::Interrupted(_))) {
                            *first = Some(error);
                        }
                    }
                });
            }
        });
        match first_error.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(error) => Err(error),
            None => Ok(writers),
        }
    }

    /// Runs one thread: takes one chunk after another and evaluates all degrees of the group on it.
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
        let last = group[group.len() - 1].degree;
        let mut block = Vec::new();
        let mut single = Vec::new();
        loop {
            let chunk = next.fetch_add(1, Ordering::Relaxed);
            if chunk >= group[0].chunk_count() {
                return Ok(());
            }
            let rows = group[0].chunk_range(chunk);
            let mut sweep = Sweep::new(self.recurrence, &self.directions.as_slice()[rows.clone()]);
            let mut writers = writers.iter().zip(group).peekable();
            for degree in 0..=last {
                if self.monitor.cancelled() || failed.load(Ordering::Relaxed) {
                    failed.store(true, Ordering::Relaxed);
                    return Err(Interrupted.into());
                }
                let Some((writer, header)) = writers.next_if(|(_, header)| header.degree == degree) else {
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
