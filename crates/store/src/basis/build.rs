//! Builds the basis of a sampling scheme: writes the missing files `A_<l>` of all degrees l up to a highest degree.
//!
//! Each thread takes one chunk (a run of rows) at a time and evaluates the harmonics by a recurrence, degree by degree.
//! The thread holds the recurrence state and the values of one chunk, so the memory doesn't grow with the number of
//! directions, n. Degrees are built in groups. All files of a group are open at the same time. While one group is
//! computed, the files of the previous group are synced to disk and given their final names. A build that is killed
//! thus loses at most the last three groups; a build that fails still publishes the groups that have been computed. The
//! disadvantage of groups is that each group repeats the recurrence for all degrees below it. Repeating the recurrence
//! costs a quarter as much as computing the files of those degrees.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::vec::IntoIter;

use spharm_harmonics::{Directions, Recurrence, Sweep};
use spharm_monitor::{Interrupted, Level, Monitor, Stage};

use crate::basis::header::Header;
use crate::basis::plan::{BuildParams, Plan, groups};
use crate::basis::writer::{DegreeWriter, file_name};
use crate::container::codec::{Codec, Encoder};
use crate::error::{StoreError, StoreWarning};
use crate::scheme::{Scalar, SchemeKey};
use crate::{folder, temporary};

/// Result of building a basis.
#[derive(Debug)]
pub struct BuildReport {
    /// Key of the scheme.
    pub key: SchemeKey,
    /// Folder of the scheme.
    pub folder: PathBuf,
    /// Number of degrees written by this build.
    pub built: usize,
    /// Number of degrees whose files existed before the build, or were published by another builder during it.
    pub present: usize,
    /// Total size in bytes of the files written by this build.
    pub bytes_written: u64,
    /// Total size in bytes of the files of all degrees from 0 to [`BuildParams::max_degree`], including files that
    /// existed before the build.
    pub bytes: u64,
    /// Number of rows per chunk.
    pub chunk_rows: usize,
    /// Number of threads used.
    pub threads: usize,
    /// Planned memory in bytes.
    pub memory: usize,
    /// Warnings about damaged files that were replaced, in order of degree.
    pub warnings: Vec<StoreWarning>,
}

/// Builds the missing files of a scheme's basis in `store`: the harmonics at `directions` up to `params.max_degree`.
///
/// Several processes may build a scheme at the same time, and a build may be interrupted or killed at any time.
/// Published files stay valid, and the next build skips them. The bytes of a file don't depend on the number of threads
/// or on earlier interruptions.
///
/// Reports one stage, `basis`, counted in bytes, to the monitor, and a note if the build waits for another process that
/// builds the same scheme.
///
/// # Errors
///
/// Before anything is written: [`StoreError::ChunkRows`], [`StoreError::Layout`] and [`StoreError::Harmonics`] for
/// parameters that the format or the harmonics don't support, [`StoreError::Space`] or [`StoreError::Budget`] if the
/// disk or the memory budget is too small. During the build, after incomplete files have been removed:
/// [`StoreError::Io`] if a file can't be written, [`StoreError::Interrupted`] if the monitor cancels the build.
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
    // Remove the leftovers of killed builds first, because this build may need their disk space.
    if folder.is_dir() {
        temporary::remove_abandoned(&folder)?;
    }
    // Check memory and disk space before the folder is created, so that a refused build creates nothing.
    plan.threads(params)?;
    plan.check_space(store, params)?;
    // If all files exist, nothing is written, so the call succeeds for a store on a read-only disk.
    let (_lock, plan) = if plan.missing.is_empty() {
        (None, plan)
    } else {
        folder::create(store, &folder)?;
        let lock = folder::lock(&folder, monitor)?;
        // Plan again while holding the lock: the builder that held it before may have published missing files.
        let plan = Plan::new(&folder, key, directions.len(), params)?;
        temporary::remove_abandoned(&folder)?;
        (lock, plan)
    };
    let threads = plan.threads(params)?;
    plan.damaged.iter().try_for_each(|(path, _)| folder::remove_damaged(path))?;
    let present = params.max_degree + 1 - plan.missing.len();
    if present > 0 {
        monitor.note(Level::Info, format_args!("{present} of {} degrees already exist", params.max_degree + 1));
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

/// Counts and sizes of the files published by a build.
#[derive(Default)]
struct Published {
    built: usize,
    /// Number of files that another builder published first.
    by_others: usize,
    /// Total size in bytes of the files that this build published.
    bytes: u64,
}

impl Published {
    /// Gives computed files their final names and syncs the folder. After an error, `files` contains the files that
    /// haven't been processed.
    fn publish(&mut self, folder: &Path, files: &mut IntoIter<DegreeWriter>) -> Result<(), StoreError> {
        for writer in files {
            match writer.publish()? {
                Some(len) => (self.built, self.bytes) = (self.built + 1, self.bytes + len),
                None => self.by_others += 1,
            }
        }
        folder::sync(folder)
    }

    /// Publishes all groups of files from the queue `computed`. If publishing fails, sets `failed`, and waits until the
    /// computation has closed the queue. By that time, the computation has removed its unfinished files, which may have
    /// filled the disk. The remaining finished files are then published, and the error is returned.
    fn publish_all(
        mut self,
        folder: &Path,
        computed: &Receiver<Vec<DegreeWriter>>,
        failed: &AtomicBool,
    ) -> Result<Self, StoreError> {
        for group in computed {
            let mut files = group.into_iter();
            if let Err(error) = self.publish(folder, &mut files) {
                failed.store(true, Ordering::Relaxed);
                let mut left = files.chain(computed.iter().flatten()).collect::<Vec<_>>().into_iter();
                while !left.as_slice().is_empty() {
                    let _ = self.publish(folder, &mut left);
                }
                return Err(error);
            }
        }
        Ok(self)
    }
}

/// Computes the groups of degrees one after another. While a group is computed, another thread syncs and publishes the
/// previous one.
fn compute_and_publish(
    computation: &Computation<'_>,
    folder: &Path,
    headers: &[Header],
) -> Result<Published, StoreError> {
    // This flag is set when publishing fails. The computation then stops after its current group.
    let failed = &AtomicBool::new(false);
    std::thread::scope(|scope| {
        // The queue holds one group, so at most three groups of files are open: one being computed, one waiting in the
        // queue, one being synced to disk.
        let (to_disk, computed) = sync_channel::<Vec<DegreeWriter>>(1);
        let publisher = scope.spawn(move || Published::default().publish_all(folder, &computed, failed));
        let mut result = Ok(());
        for group in groups(headers) {
            result = computation.run(folder, group).and_then(|writers| {
                // The receiver only disconnects if the publisher has panicked; the panic is resumed below.
                to_disk.send(writers).map_err(|_| Interrupted.into())
            });
            if result.is_err() || failed.load(Ordering::Relaxed) {
                break;
            }
        }
        drop(to_disk);
        let published = publisher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        result?;
        Ok(published)
    })
}

/// Data shared by the threads of a build.
struct Computation<'a> {
    directions: &'a Directions,
    recurrence: &'a Recurrence,
    codec: Codec,
    threads: usize,
    monitor: &'a dyn Monitor,
}

impl Computation<'_> {
    /// Computes the files of a group of degrees. If an error occurs, the group's temporary files are removed.
    fn run(&self, folder: &Path, group: &[Header]) -> Result<Vec<DegreeWriter>, StoreError> {
        let writers: Vec<_> =
            group.iter().map(|header| DegreeWriter::create(folder, header.clone())).collect::<Result<_, _>>()?;
        let next = AtomicUsize::new(0);
        // This flag is set when a thread fails. The other threads then stop.
        let failed = AtomicBool::new(false);
        let first_error = Mutex::new(None);
        let chunks = group[0].chunk_count();
        rayon::scope(|scope| {
            for _ in 0..self.threads.min(chunks) {
                scope.spawn(|_| {
                    if let Err(error) = self.work(group, &writers, &next, &failed) {
                        failed.store(true, Ordering::Relaxed);
                        let mut first = first_error.lock().unwrap_or_else(PoisonError::into_inner);
                        // A thread that stopped because another thread failed returns `Interrupted`. Such an error
                        // mustn't replace the error of the thread that failed.
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

    /// Runs one thread: takes one chunk after another and evaluates all degrees of the group for that chunk.
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

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;

    use super::*;

    /// If a file can't be published, the other computed files are still published.
    #[test]
    fn finished_files_are_published_after_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let directions = Directions::fibonacci(20).unwrap();
        let params = BuildParams { max_degree: 3, threads: 1, ..BuildParams::default() };
        let key = SchemeKey::of(&directions, params.scalar);
        let plan = Plan::new(folder.path(), key, directions.len(), &params).unwrap();
        let headers = plan.headers(key, &params);
        let recurrence = Recurrence::new(3).unwrap();
        // Another builder has published a damaged file since the plan was made.
        std::fs::write(folder.path().join("A_1"), "damaged").unwrap();
        let (codec, threads, monitor) = (params.codec, 1, &Silent);
        let computation = Computation { directions: &directions, recurrence: &recurrence, codec, threads, monitor };
        let error = compute_and_publish(&computation, folder.path(), &headers).err().unwrap();
        assert!(matches!(error, StoreError::Corrupt { .. }), "{error}");
        let mut names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|item| item.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["A_0", "A_1", "A_2", "A_3"]);
    }
}
