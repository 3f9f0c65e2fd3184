//! Computes the moments of tables of samples, in limited memory.
//!
//! While one chunk of samples is read, the previous chunk is converted and spread onto the grids of the transforms. The
//! computation needs memory for an [`Accumulator`] and three chunks, regardless of the size of the tables.

use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

use ndarray::ArrayView2;
use serde::Serialize;
use spharm_harmonics::Directions;
use spharm_monitor::{Monitor, Stage};
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::io::bytes_to_read;
use spharm_surface::look_like_radians;
use spharm_transform::{Accumulated as Found, Accumulator};

use crate::MomentsError;
use crate::key::{Key, are_equal};
use crate::moments::{Moments, Shard, Source};
use crate::samples::{BadRow, Chunk, Columns, Opened, Plan, Positions, STDIN, is_table, open, open_over_scheme};

/// Largest number of samples per chunk, enough to occupy all threads. This number is a multiple of the number of
/// samples in a block of the [`Accumulator`], so the sums have the same bits for any number of threads.
const CHUNK: usize = 1 << 19;
/// Largest number of samples per thread and chunk, small enough that the samples stay in the core's cache between the
/// steps of processing. This number is also a multiple of the number of samples in a block.
const CHUNK_OF_THREAD: usize = 1 << 16;

/// A request for moments: the tables to read, their columns, and the highest degree of fits from the moments.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Paths of the tables, in order; `-` is standard input.
    pub files: Vec<PathBuf>,
    /// Names of the columns for positions, values and weights.
    pub columns: Columns,
    /// Highest degree L of fits from the moments.
    pub max_degree: usize,
    /// The part of each table to read.
    pub shard: Shard,
    /// Memory budget in bytes; `None` (default) for no limit.
    pub memory: Option<usize>,
}

impl Request {
    /// Creates a request for the moments of entire tables. The caller must then set the names of the value columns.
    pub fn new(files: Vec<PathBuf>, max_degree: usize) -> Self {
        Self { files, columns: Columns::default(), max_degree, shard: Shard::WHOLE, memory: None }
    }

    /// Returns the sampling scheme that defines the samples' positions, or `None` if columns of the table contain the
    /// positions. With a scheme, each table has one row per direction.
    fn scheme(&self) -> Option<&Directions> {
        match &self.columns.positions {
            Some(Positions::Scheme(directions)) => Some(directions),
            _ => None,
        }
    }
}

/// Moments of the samples, with warnings and timings.
#[derive(Debug, Clone)]
pub struct Accumulated {
    /// Moments of the samples.
    pub moments: Moments,
    /// Warnings of possible problems in the samples.
    pub warnings: Vec<Warning>,
    /// Wall times of the computation.
    pub seconds: Seconds,
}

/// A possible problem found in the samples.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// Longitudes and latitudes, expected in degrees, are so small that they may be in radians.
    #[error("longitudes up to {longitude} and latitudes up to {latitude} look like radians, but degrees are expected")]
    LooksLikeRadians {
        /// Largest absolute longitude.
        longitude: f64,
        /// Largest absolute latitude.
        latitude: f64,
    },
    /// Some samples have weight 0.
    #[error("{zeros} of {rows} samples have the weight 0")]
    ZeroWeights {
        /// Number of samples with weight 0.
        zeros: u64,
        /// Number of all samples.
        rows: u64,
    },
    /// Two paths lead to the same file, or to files with equal bytes. Each sample then enters the sums twice, so a fit
    /// reports errors that are too small.
    #[error(
        "{} and {} are equal, byte for byte: their samples are counted twice, so standard errors are too small",
        .first.display(), .second.display()
    )]
    EqualTables {
        /// Path of a table.
        first: PathBuf,
        /// Path of a later table with the same bytes.
        second: PathBuf,
    },
    /// Two parts of the samples have equal sums, so they probably contain the same samples.
    #[error(
        "{first} and {second} have equal sums: if both contain the same samples, these are counted twice, so \
         standard errors are too small"
    )]
    EqualSums {
        /// Name of a part.
        first: String,
        /// Name of a later part with the same sums.
        second: String,
    },
}

/// Wall time in seconds for each kind of work. Reading runs at the same time as the other work.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Seconds {
    /// Seconds for reading and parsing.
    pub read: f64,
    /// Seconds for checking rows and converting positions.
    pub convert: f64,
    /// Seconds for locating samples on the grids, and sorting them.
    pub place: f64,
    /// Seconds for spreading samples onto the grids.
    pub spread: f64,
    /// Seconds for transforming the grids to spherical-harmonic coefficients.
    pub transform: f64,
    /// Total time in seconds.
    pub total: f64,
}

/// Computes the moments of a shard of tables.
///
/// Reports the stage `moments`, counted in rows, to the monitor, with the total number of rows if it is known.
///
/// # Errors
///
/// [`MomentsError`] if a table can't be read or lacks a column, if any row is invalid, or if the memory budget is too
/// small.
pub fn accumulate(request: &Request, monitor: &dyn Monitor) -> Result<Accumulated, MomentsError> {
    let started = Instant::now();
    request.shard.check()?;
    let channels = request.columns.values.len();
    check_memory(request, channels)?;
    let mut sums = Accumulator::new(request.max_degree, channels)?;
    let scheme = request.scheme();
    let scheme_key = scheme.map(|directions| SchemeKey::of(directions, Scalar::F64));
    let mut key = Key::new(&request.columns, scheme_key);
    // With a sampling scheme, each table is read completely, but only the rows in this range are used.
    let used = scheme.map_or(0..u64::MAX, |directions| request.shard.range(directions.len() as u64));
    let (mut seconds, mut largest) = (Seconds::default(), [0.0f64; 2]);
    let mut has_values = vec![false; channels];
    // Compare the tables before they are read, because a table may be moved or deleted as soon as it has been read.
    let mut warnings = equal_tables(&request.files);
    monitor.begin(Stage::counted("moments", "rows"), 0);
    for path in &request.files {
        let check_rows = |found: u64| match scheme.map(|directions| directions.len() as u64) {
            Some(expected) if expected != found => Err(MomentsError::Rows { path: path.clone(), expected, found }),
            _ => Ok(()),
        };
        let open = if scheme.is_some() { open_over_scheme } else { open };
        let mut opened = open(path, request.shard)?;
        let (plan, numbers) = request.columns.plan(path, opened.table.columns())?;
        opened.table.select(numbers);
        if let Some(rows) = opened.rows {
            check_rows(rows)?;
            monitor.begin(Stage::counted("moments", "rows"), rows);
        }
        let mut reading = Reading {
            path,
            plan: &plan,
            used: used.clone(),
            sums: &mut sums,
            seconds: &mut seconds,
            largest: &mut largest,
            has_values: &mut has_values,
        };
        let rows = reading.all(&mut opened, monitor)?;
        if rows == 0 && request.shard == Shard::WHOLE {
            return Err(MomentsError::Empty { path: path.clone() });
        }
        key.add(path, &opened)?;
        check_rows(rows)?;
    }
    monitor.end();
    sums.spread();
    seconds.place = sums.seconds().place;
    seconds.spread = sums.seconds().spread;
    let spread = Instant::now();
    let Found { sums, rows, occupied } = sums.finish()?;
    seconds.transform = spread.elapsed().as_secs_f64();
    seconds.total = started.elapsed().as_secs_f64();
    let sources = vec![Source { key: key.finish(), shard: request.shard, rows }];
    if sums.count < rows {
        warnings.push(Warning::ZeroWeights { zeros: rows - sums.count, rows });
    }
    let [longitude, latitude] = largest;
    if look_like_radians(usize::try_from(rows).unwrap_or(usize::MAX), latitude, longitude) {
        warnings.push(Warning::LooksLikeRadians { longitude, latitude });
    }
    let moments =
        Moments { channels: request.columns.values.clone(), sums, rows, occupied, scheme: scheme_key, sources };
    let lost =
        |((has, square), channel): ((&bool, &f64), &'_ String)| (*has && *square == 0.0).then(|| channel.clone());
    let lost = has_values.iter().zip(&moments.sums.squares).zip(&moments.channels).find_map(lost);
    if let Some(channel) = lost.as_deref().or(moments.out_of_range()) {
        return Err(MomentsError::Range { channel: channel.to_owned() });
    }
    Ok(Accumulated { moments, warnings, seconds })
}

/// Returns a warning for each table that equals an earlier one, byte for byte. A table that can't be read is treated as
/// different from every other table.
fn equal_tables(files: &[PathBuf]) -> Vec<Warning> {
    let mut known: Vec<(&PathBuf, [u8; 32])> = Vec::new();
    let mut warnings = Vec::new();
    // Opening a pipe would block until another process writes to it.
    for path in files.iter().filter(|path| files.len() > 1 && path.as_os_str() != STDIN && path.is_file()) {
        let Ok(key) = Key::of_ends(path) else { continue };
        let mut candidates = known.iter().filter(|(_, other)| *other == key).map(|(first, _)| *first);
        let equal = candidates.find(|first| are_equal(first, path).unwrap_or(false));
        match equal {
            Some(first) => warnings.push(Warning::EqualTables { first: first.clone(), second: path.clone() }),
            None => known.push((path, key)),
        }
    }
    warnings
}

/// Returns the memory in bytes needed to compute the moments of tables for `channels` channels and fits of degrees up
/// to `max_degree`.
pub fn bytes(max_degree: usize, channels: usize) -> usize {
    // The memory holds two chunks of rows (one being read, one being converted), a buffer for reading, and a chunk of
    // samples.
    let row = 8 * (5 + channels);
    Accumulator::bytes(max_degree, channels) + CHUNK * (3 * row + 8 * (4 + channels))
}

fn check_memory(request: &Request, channels: usize) -> Result<(), MomentsError> {
    // A sampling scheme also needs memory for its directions. Per-vertex files are completely read into memory.
    let directions = request.scheme().map_or(0, |directions| std::mem::size_of_val(directions.as_slice()));
    let values = request.files.iter().filter(|path| directions > 0 && !is_table(path)).map(|path| bytes_to_read(path));
    let values = usize::try_from(values.max().unwrap_or(0)).unwrap_or(usize::MAX);
    let needed = bytes(request.max_degree, channels).saturating_add(directions).saturating_add(values);
    let max_degree = request.max_degree;
    match request.memory {
        Some(budget) if needed > budget => Err(MomentsError::Memory { max_degree, needed, budget }),
        _ => Ok(()),
    }
}

/// State of reading one table.
struct Reading<'a> {
    path: &'a PathBuf,
    plan: &'a Plan,
    /// Range of the rows to use; other rows are read but not used.
    used: Range<u64>,
    sums: &'a mut Accumulator,
    seconds: &'a mut Seconds,
    largest: &'a mut [f64; 2],
    /// Whether each channel has a nonzero value at a sample of nonzero weight.
    has_values: &'a mut [bool],
}

impl Reading<'_> {
    fn all(&mut self, opened: &mut Opened, monitor: &dyn Monitor) -> Result<u64, MomentsError> {
        let table = &mut opened.table;
        let (mut rows, mut next, mut chunk) = (Vec::new(), Vec::new(), Chunk::default());
        let most = (CHUNK_OF_THREAD * rayon::current_num_threads()).min(CHUNK);
        let mut before = 0;
        loop {
            monitor.check()?;
            next.clear();
            let started = Instant::now();
            // If the caller's pool has only one thread, this thread runs the two closures one after the other.
            // Therefore neither closure may wait for the other.
            let (count, done) = rayon::join(
                || table.read(most, &mut next).map(|count| (count, started.elapsed().as_secs_f64())),
                || self.one(&rows, before, &mut chunk),
            );
            let done = done?;
            if let Some(BadRow { row, column, expected, found }) = done {
                let row = table.number_of(before + row as u64);
                return Err(MomentsError::Row { path: self.path.clone(), row, column, expected, found });
            }
            let used = (rows.len() / self.plan.columns()) as u64;
            before += used;
            monitor.step(used);
            let (count, seconds) = count?;
            self.seconds.read += seconds;
            if count == 0 {
                break;
            }
            std::mem::swap(&mut rows, &mut next);
        }
        *self.largest = [self.largest[0].max(chunk.largest[0]), self.largest[1].max(chunk.largest[1])];
        Ok(before)
    }

    /// Adds the samples of a chunk of rows to the sums. `before` is the number of the table's rows before the chunk.
    fn one(&mut self, rows: &[f64], before: u64, chunk: &mut Chunk) -> Result<Option<BadRow>, MomentsError> {
        let started = Instant::now();
        let columns = self.plan.columns();
        let within = |row: u64| row.saturating_sub(before).min((rows.len() / columns) as u64) as usize;
        let (first, end) = (within(self.used.start), within(self.used.end));
        let rows = &rows[first * columns..end * columns];
        if let Err(bad) = self.plan.samples(rows, before as usize + first, chunk) {
            return Ok(Some(BadRow { row: bad.row + first, ..bad }));
        }
        self.seconds.convert += started.elapsed().as_secs_f64();
        note_values(self.has_values, chunk.weights.as_deref(), chunk.values.view());
        self.sums.add(&chunk.directions, chunk.weights.as_deref(), chunk.values.view())?;
        Ok(None)
    }
}

/// Records which channels have a nonzero value at a sample of nonzero weight. If such a channel's sum of squares is
/// zero, the squares have underflowed.
fn note_values(has: &mut [bool], weights: Option<&[f64]>, values: ArrayView2<'_, f64>) {
    let counts = |row: usize| weights.is_none_or(|weights| weights[row] != 0.0);
    for (has, column) in has.iter_mut().zip(values.columns()) {
        *has = *has || column.iter().enumerate().any(|(row, value)| *value != 0.0 && counts(row));
    }
}
