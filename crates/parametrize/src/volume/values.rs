//! Converts the values of voxels in a file to labels, which are 32-bit integers.

use std::io::Read;
use std::path::Path;

use spharm_monitor::{Monitor, Stage};
use spharm_surface::SurfaceError;
use spharm_surface::io::{NoRoom, check_room};

use super::affine::Affine;
use super::runs::{Builder, Runs};
use crate::error::ParametrizeError;

/// A volume from a file: the numbers of voxels along x, y, z, the matrix to mm, and the labels.
pub(super) struct Volume {
    pub(super) size: [usize; 3],
    pub(super) affine: Affine,
    pub(super) labels: Runs,
}

/// The type of a voxel's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Scalar {
    /// Returns the number of bytes per value.
    pub(super) fn width(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Converts the little-endian bytes of a value to a number. Bytes beyond the value's width are ignored.
    fn number(self, raw: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = raw;
        match self {
            Self::U8 => f64::from(a),
            Self::I8 => f64::from(i8::from_le_bytes([a])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::U64 => u64::from_le_bytes(raw) as f64,
            Self::I64 => i64::from_le_bytes(raw) as f64,
            Self::F64 => f64::from_le_bytes(raw),
        }
    }
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
        self.size.iter().fold(self.scalar.width() as u64, |bytes, &n| bytes.saturating_mul(n as u64))
    }

    /// Reads the values from a stream and converts them to labels. The caller must have checked that the file can
    /// contain [`bytes`](Self::bytes) bytes.
    pub(super) fn read(
        &self,
        path: &Path,
        mut stream: impl Read,
        monitor: &dyn Monitor,
    ) -> Result<Runs, ParametrizeError> {
        // 5 bytes per voxel for the worst case: 4 for the label, 1 for the voxel's entry in a mask.
        let room = |room| no_room(path, room);
        check_room(self.bytes() / self.scalar.width() as u64 * 5).map_err(room)?;
        monitor.begin(Stage::bytes("reading"), self.bytes());
        let mut labels = Builder::new(self.size);
        let mut left = self.bytes();
        let mut bytes = Vec::with_capacity(CHUNK);
        while left > 0 {
            monitor.check()?;
            bytes.clear();
            let wanted = left.min(CHUNK as u64);
            (&mut stream).take(wanted).read_to_end(&mut bytes).map_err(|error| cut_short(path, &error.to_string()))?;
            if (bytes.len() as u64) < wanted {
                let there = self.bytes() - left + bytes.len() as u64;
                return Err(cut_short(path, &format!("{there} bytes of values instead of {}", self.bytes())));
            }
            if self.scaling.is_none() && bytes.iter().all(|&byte| byte == 0) {
                labels.to(labels.len() + bytes.len() / self.scalar.width()).map_err(room)?;
            } else {
                for raw in bytes.chunks_exact(self.scalar.width()) {
                    labels.push(self.label(path, labels.len(), raw)?).map_err(room)?;
                }
            }
            left -= wanted;
            monitor.step(wanted);
        }
        monitor.end();
        labels.finish().map_err(room)
    }

    fn label(&self, path: &Path, index: usize, bytes: &[u8]) -> Result<i32, ParametrizeError> {
        let mut raw = [0; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        if !self.little_endian {
            raw[..bytes.len()].reverse();
        }
        let value = self.scalar.number(raw);
        let value = self.scaling.map_or(value, |(slope, intercept)| slope * value + intercept);
        whole(path, index, value)
    }
}

/// Converts a value to a label; an error if the value isn't an integer of 32 bits.
pub(super) fn whole(path: &Path, index: usize, value: f64) -> Result<i32, ParametrizeError> {
    if value.fract() == 0.0 && value.abs() <= f64::from(i32::MAX) {
        return Ok(value as i32);
    }
    let found = format!("{value} at voxel {index} (counted from 0, x fastest); threshold or round the volume first");
    Err(ParametrizeError::NotAVolume { path: path.to_owned(), expected: "whole numbers as labels", found })
}

/// Returns the error for a volume that needs more memory than is free.
pub(super) fn no_room(path: &Path, room: NoRoom) -> ParametrizeError {
    SurfaceError::NoRoom { path: path.to_owned(), room }.into()
}

/// Returns the error for a file that is truncated or damaged.
pub(super) fn cut_short(path: &Path, found: &str) -> ParametrizeError {
    let found = format!("a file that is cut short or damaged ({found})");
    ParametrizeError::NotAVolume { path: path.to_owned(), expected: "a label volume", found }
}
