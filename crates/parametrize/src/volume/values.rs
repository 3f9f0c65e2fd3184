//! Reads the values of voxels from a file, and converts them to labels, which are 32-bit integers.

use std::io::Read;
use std::path::Path;

use spharm_monitor::{Stage, number};
pub(super) use spharm_surface::io::Scalar;
use spharm_surface::io::{NoRoom, check_room};

use super::affine::Affine;
use super::doubt::VolumeDoubt;
use super::grey::VoxelValues;
use super::runs::{Builder, Runs};
use super::source::{Source, no_room};
use crate::error::ParametrizeError;

/// A volume from a file: the numbers of voxels along x, y, z, the matrix from voxel coordinates to mm, and the voxels'
/// values.
pub(super) struct Volume {
    pub(super) size: [usize; 3],
    pub(super) affine: Affine,
    pub(super) voxels: Voxels,
    /// Reason to doubt the matrix, if any.
    pub(super) doubt: Option<VolumeDoubt>,
}

/// The labels of all voxels. For grey values or probabilities, also each voxel's value minus the level (the value at
/// the body's surface).
pub(super) struct Voxels {
    pub(super) labels: Runs,
    pub(super) values: Vec<f32>,
}

impl Voxels {
    /// Returns the voxels with the axes reversed: converts from z varying fastest, with sizes `[z, y, x]`, to x varying
    /// fastest.
    pub(super) fn transposed(&self, [nz, ny, nx]: [usize; 3]) -> Result<Self, NoRoom> {
        let labels = self.labels.transposed()?;
        check_room(4 * self.values.len() as u64)?;
        let mut values = Vec::with_capacity(self.values.len());
        if !self.values.is_empty() {
            let rows = (0..nz).flat_map(|z| (0..ny).map(move |y| (y, z)));
            values.extend(rows.flat_map(|(y, z)| (0..nx).map(move |x| self.values[z + nz * (y + ny * x)])));
        }
        Ok(Self { labels, values })
    }
}

/// Converts the values of voxels to labels, one after another, and also keeps the values themselves if they are grey
/// values or probabilities.
pub(super) struct Collector<'a> {
    path: &'a Path,
    meaning: VoxelValues,
    labels: Builder,
    values: Vec<f32>,
    /// Smallest and largest value added so far.
    range: (f64, f64),
    /// Numbers of voxels outside and inside the body; not counted if the values are labels.
    sides: [usize; 2],
}

impl<'a> Collector<'a> {
    pub(super) fn new(source: &Source<'a>, size: [usize; 3]) -> Self {
        let range = (f64::INFINITY, f64::NEG_INFINITY);
        Self {
            path: source.path,
            meaning: source.values,
            labels: Builder::new(size),
            values: Vec::new(),
            range,
            sides: [0; 2],
        }
    }

    /// Checks that memory suffices for a number of voxels in the worst case: 4 bytes for a voxel's label, 1 byte for
    /// its entry in a mask, and 12 bytes for its value, in a vector that doubles its capacity as it grows.
    pub(super) fn check_room(&self, voxels: u64) -> Result<(), ParametrizeError> {
        let bytes = if self.meaning == VoxelValues::Labels { 5 } else { 17 };
        check_room(voxels.saturating_mul(bytes)).map_err(|room| no_room(self.path, room))
    }

    /// Returns the number of voxels added so far.
    pub(super) fn len(&self) -> usize {
        self.labels.len()
    }

    /// Sets the number of slices. Used by readers of formats that don't state this number in advance.
    pub(super) fn slices(&mut self, count: usize) {
        self.labels.slices(count);
    }

    /// Adds the next voxel.
    pub(super) fn push(&mut self, value: f64) -> Result<(), ParametrizeError> {
        let label = match self.meaning.level() {
            None => whole(self.path, self.len(), value)?,
            Some(level) => {
                if self.meaning == VoxelValues::Probability && !(value.is_nan() || PROBABILITIES.contains(&value)) {
                    return Err(ParametrizeError::NotProbability {
                        path: self.path.to_owned(),
                        value,
                        voxel: self.len(),
                    });
                }
                self.range = (self.range.0.min(value), self.range.1.max(value));
                // A file may have rounded its values to 32 bits, so a value that rounds to the same 32-bit number as
                // the level is treated as equal to the level.
                let above = if value as f32 == level as f32 { 0.0 } else { (value - level) as f32 };
                self.values.push(above);
                self.sides[usize::from(above >= 0.0)] += 1;
                i32::from(above >= 0.0)
            }
        };
        self.labels.push(label).map_err(|room| no_room(self.path, room))
    }

    /// Adds `count` voxels of background.
    fn background(&mut self, count: usize) -> Result<(), ParametrizeError> {
        if self.meaning == VoxelValues::Labels {
            return self.labels.to(self.len() + count).map_err(|room| no_room(self.path, room));
        }
        (0..count).try_for_each(|_| self.push(0.0))
    }

    fn wrong(&self, expected: &'static str, found: String) -> ParametrizeError {
        ParametrizeError::NotAVolume { path: self.path.to_owned(), expected, found }
    }

    pub(super) fn finish(self) -> Result<Voxels, ParametrizeError> {
        let (path, (low, high)) = (self.path, self.range);
        if let Some(level) = self.meaning.level().filter(|_| self.sides.contains(&0)) {
            let side = if self.sides[1] == 0 { "below" } else { "at or above" };
            let found = match low > high {
                true => "no values".to_owned(),
                false => format!("values from {} to {}, all {side} the threshold {level}", number(low), number(high)),
            };
            return Err(self.wrong("values both below and above the threshold", found));
        }
        Ok(Voxels { labels: self.labels.finish().map_err(|room| no_room(path, room))?, values: self.values })
    }
}

/// Accepted probabilities, with an allowance for rounding by the program that wrote them.
const PROBABILITIES: std::ops::RangeInclusive<f64> = -1e-3..=1.0 + 1e-3;

/// Converts the little-endian bytes of a value to a number. Bytes beyond the value's width are ignored.
fn value_of(scalar: Scalar, raw: [u8; 8]) -> f64 {
    let [a, b, c, d, ..] = raw;
    match scalar {
        Scalar::U8 => f64::from(a),
        Scalar::I8 => f64::from(i8::from_le_bytes([a])),
        Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
        Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
        Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
        Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
        Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
        Scalar::U64 => u64::from_le_bytes(raw) as f64,
        Scalar::I64 => i64::from_le_bytes(raw) as f64,
        Scalar::F64 => f64::from_le_bytes(raw),
    }
}

/// Skips a number of bytes in the stream.
pub(super) fn skip(source: &Source<'_>, stream: &mut impl Read, bytes: u64) -> Result<(), ParametrizeError> {
    let mut left = bytes;
    while left > 0 {
        source.monitor.check()?;
        let part = left.min(CHUNK as u64);
        let skipped = std::io::copy(&mut stream.take(part), &mut std::io::sink());
        let skipped = skipped.map_err(|error| cut_short(source.path, &error.to_string()))?;
        if skipped < part {
            return Err(cut_short(source.path, "fewer bytes than the header states"));
        }
        left -= part;
    }
    Ok(())
}

/// Layout of a file's values, as described by its header.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    /// Numbers of voxels along the axes, the fastest-varying axis first.
    pub(super) size: [usize; 3],
    /// Type of a value.
    pub(super) scalar: Scalar,
    /// Whether the values are little-endian.
    pub(super) little_endian: bool,
    /// Slope and intercept by which values are scaled, if any.
    pub(super) scaling: Option<(f64, f64)>,
}

/// Number of bytes read between checks of the monitor; a multiple of every value's width.
const CHUNK: usize = 1 << 20;

impl Layout {
    /// Returns the number of bytes of all values.
    pub(super) fn bytes(&self) -> u64 {
        self.size.iter().fold(self.scalar.size() as u64, |bytes, &n| bytes.saturating_mul(n as u64))
    }

    /// Reads the values from a stream. The caller must have checked that the file can contain [`bytes`](Self::bytes)
    /// bytes.
    pub(super) fn read(&self, source: &Source<'_>, mut stream: impl Read) -> Result<Voxels, ParametrizeError> {
        let (path, monitor) = (source.path, source.monitor);
        let mut voxels = Collector::new(source, self.size);
        voxels.check_room(self.bytes() / self.scalar.size() as u64)?;
        monitor.begin(Stage::bytes("reading"), self.bytes());
        let mut left = self.bytes();
        let mut bytes = Vec::with_capacity(CHUNK);
        while left > 0 {
            monitor.check()?;
            bytes.clear();
            let wanted = left.min(CHUNK as u64);
            (&mut stream).take(wanted).read_to_end(&mut bytes).map_err(|error| cut_short(path, &error.to_string()))?;
            if (bytes.len() as u64) < wanted {
                let there = self.bytes() - left + bytes.len() as u64;
                return Err(cut_short(path, &format!("only {there} of {} bytes of values", self.bytes())));
            }
            if self.scaling.is_none() && bytes.iter().all(|&byte| byte == 0) {
                voxels.background(bytes.len() / self.scalar.size())?;
            } else {
                for raw in bytes.chunks_exact(self.scalar.size()) {
                    voxels.push(self.value(raw))?;
                }
            }
            left -= wanted;
            monitor.step(wanted);
        }
        monitor.end();
        voxels.finish()
    }

    fn value(&self, bytes: &[u8]) -> f64 {
        let mut raw = [0; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        if !self.little_endian {
            raw[..bytes.len()].reverse();
        }
        let value = value_of(self.scalar, raw);
        self.scaling.map_or(value, |(slope, intercept)| slope * value + intercept)
    }
}

/// Converts a value to a label. Returns an error if the value isn't a 32-bit integer.
fn whole(path: &Path, index: usize, value: f64) -> Result<i32, ParametrizeError> {
    if value.fract() == 0.0 && value.abs() <= f64::from(i32::MAX) {
        return Ok(value as i32);
    }
    if value.is_nan() {
        // NaN has its own message, because the usual advice to give a threshold, or to read probabilities, would be
        // wrong.
        let found = format!("NaN (voxel {index} of the file, counted from 0); if NaN is the background, set it to 0");
        return Err(ParametrizeError::NotAVolume {
            path: path.to_owned(),
            expected: "32-bit integers as labels",
            found,
        });
    }
    Err(ParametrizeError::NotLabels { path: path.to_owned(), value, voxel: index })
}

/// Returns the error for a file that is truncated or damaged.
pub(super) fn cut_short(path: &Path, found: &str) -> ParametrizeError {
    let found = format!("a truncated or damaged file ({found})");
    ParametrizeError::NotAVolume { path: path.to_owned(), expected: "a volume", found }
}
