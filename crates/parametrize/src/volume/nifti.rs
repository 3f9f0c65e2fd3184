//! NIfTI-1 files (`.nii`, `.nii.gz`): the values, and where the voxels are in space.
//!
//! The header is read by crate `nifti`. The values are taken from the file's bytes here: a header's sizes are held
//! against the bytes that are there before anything is allocated for them, and a type against its own size.
//!
//! The way from voxels to mm is the sform where its code is above 0, else the qform, else the voxel sizes alone (the NIfTI
//! standard's methods 3, 2, 1).

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use nifti::{Endianness, NiftiHeader, NiftiType};

use super::mask::Mask;
use crate::ParametrizeError;
use crate::geometry::{Vec3, cross, dot};

/// From voxel (i, j, k) to RAS+ mm: rows of a 3 x 4 matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine(pub [[f64; 4]; 3]);

impl Affine {
    /// One mm a voxel, from the origin.
    pub const IDENTITY: Self = Self([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);

    /// Where a point given in voxels is.
    #[must_use]
    pub fn apply(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        self.0.map(|[a, b, c, d]| a * x + b * y + c * z + d)
    }

    /// Volume of a voxel in mm^3; negative where the voxels' axes are left-handed.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        let [a, b, c] = self.0.map(|[x, y, z, _]| [x, y, z]);
        dot(a, cross(b, c))
    }

    fn of(header: &NiftiHeader) -> Self {
        let row = |row: [f32; 4]| row.map(f64::from);
        if header.sform_code > 0 {
            return Self([row(header.srow_x), row(header.srow_y), row(header.srow_z)]);
        }
        let sizes = [1, 2, 3].map(|k| f64::from(header.pixdim[k]).abs());
        if header.qform_code <= 0 {
            return Self(std::array::from_fn(|i| std::array::from_fn(|j| if i == j { sizes[i] } else { 0.0 })));
        }
        let [b, c, d] = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let turn = [
            [a * a + b * b - c * c - d * d, 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)],
            [2.0 * (b * c + a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d - a * b)],
            [2.0 * (b * d - a * c), 2.0 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ];
        let mirror = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let offset = [header.quatern_x, header.quatern_y, header.quatern_z].map(f64::from);
        let row = |i: usize| {
            let [x, y, z]: Vec3 = turn[i];
            [x * sizes[0], y * sizes[1], z * sizes[2] * mirror, offset[i]]
        };
        Self([row(0), row(1), row(2)])
    }
}

/// A label volume.
#[derive(Clone, Debug)]
pub struct LabelVolume {
    path: PathBuf,
    size: [usize; 3],
    /// Where the voxels are.
    pub affine: Affine,
    /// (size), x fastest.
    values: Vec<i32>,
}

/// The most that a byte of a gzipped file can stand for: a bound of the method itself.
const MOST_EXPANSION: u64 = 1032;
/// Bytes of a NIfTI-1 header.
const HEADER: usize = 348;

impl LabelVolume {
    /// Reads a volume.
    ///
    /// # Errors
    ///
    /// [`Io`](ParametrizeError::Io); [`NotAVolume`](ParametrizeError::NotAVolume) for a file that isn't NIfTI-1, is
    /// shorter than it says, has more than three dimensions, or values that aren't whole numbers.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ParametrizeError> {
        let path = path.as_ref();
        let io = |cause| ParametrizeError::Io { path: path.to_owned(), cause };
        // Opening a pipe would wait for whoever writes it.
        let kind = std::fs::metadata(path).map_err(io)?;
        if !kind.is_file() {
            return Err(not_a_volume(path, "a regular file", "something else".to_owned()));
        }
        let bytes = std::fs::read(path).map_err(io)?;
        if !bytes.starts_with(&[0x1f, 0x8b]) {
            return Self::parse(path, &bytes[..], bytes.len() as u64);
        }
        let most = (bytes.len() as u64).saturating_mul(MOST_EXPANSION);
        Self::parse(path, flate2::bufread::MultiGzDecoder::new(&bytes[..]), most)
    }

    /// A volume made by a program: `values` has (size), x fastest.
    ///
    /// # Panics
    ///
    /// When the number of values isn't that of the voxels.
    #[must_use]
    pub fn new(size: [usize; 3], values: Vec<i32>, affine: Affine) -> Self {
        assert_eq!(values.len(), size.iter().product(), "values of {size:?} voxels");
        Self { path: PathBuf::from("the volume"), size, affine, values }
    }

    /// Parses a stream that holds at most so many bytes.
    fn parse(path: &Path, mut stream: impl Read, most: u64) -> Result<Self, ParametrizeError> {
        let short = |what: &str| not_a_volume(path, "a NIfTI-1 volume (.nii, .nii.gz)", what.to_owned());
        let broken = |error: std::io::Error| short(&format!("one that ends or breaks off early ({error})"));
        let mut header = [0; HEADER];
        stream.read_exact(&mut header).map_err(|_| short("a file that is shorter than its header"))?;
        if !matches!(&header[344..348], b"n+1\0") {
            let pair = header[344..348] == *b"ni1\0";
            return Err(short(if pair { "a header without its .img: merge them" } else { "another format" }));
        }
        let header = NiftiHeader::from_reader(&header[..]).map_err(|error| short(&error.to_string()))?;
        let dim = header.dim().map_err(|error| short(&error.to_string()))?;
        if dim.len() < 3 || dim[3..].iter().any(|&n| n != 1) {
            return Err(not_a_volume(path, "three dimensions", format!("dimensions {dim:?}; give one volume of them")));
        }
        let size = [dim[0], dim[1], dim[2]].map(usize::from);
        let kind = header.data_type().map_err(|error| short(&error.to_string()))?;
        let Some(width) = width(kind) else {
            return Err(not_a_volume(path, "whole numbers as labels", format!("values of type {kind:?}")));
        };
        // Not beyond 2^48 voxels: no overflow.
        let bytes = size.iter().map(|&n| n as u64).product::<u64>() * width as u64;
        let offset = f64::from(header.vox_offset).max(352.0) as u64;
        if bytes > most || offset > most {
            let found = format!("{} voxels of {width} bytes claimed by a file that can't hold them", size_name(size));
            return Err(short(&found));
        }
        // Extensions between header and values.
        std::io::copy(&mut (&mut stream).take(offset - HEADER as u64), &mut std::io::sink()).map_err(broken)?;
        let mut data = Vec::new();
        (&mut stream).take(bytes).read_to_end(&mut data).map_err(broken)?;
        // On to the end of what was compressed, where its checksum is; files may have something after their values.
        std::io::copy(&mut (&mut stream).take(1 << 20), &mut std::io::sink()).map_err(broken)?;
        if (data.len() as u64) < bytes {
            return Err(short(&format!("{} bytes of values in place of {bytes}: the file is cut short", data.len())));
        }
        let values = labels(path, &data, kind, width, &header)?;
        let affine = Affine::of(&header);
        let volume = affine.determinant();
        if !(volume.is_finite() && volume != 0.0 && affine.0.as_flattened().iter().all(|x| x.is_finite())) {
            return Err(not_a_volume(path, "voxels with a volume", format!("the matrix {:?}", affine.0)));
        }
        Ok(Self { path: path.to_owned(), size, affine, values })
    }

    /// The labels there are and their voxels, 0 (the background) left out.
    #[must_use]
    pub fn labels(&self) -> BTreeMap<i64, usize> {
        let mut found = BTreeMap::new();
        for run in self.values.chunk_by(|a, b| a == b).filter(|run| run[0] != 0) {
            *found.entry(i64::from(run[0])).or_default() += run.len();
        }
        found
    }

    /// The label asked for, or the only one.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel), naming those there are.
    pub fn choose(&self, label: Option<i64>) -> Result<i64, ParametrizeError> {
        let labels = self.labels();
        match (label, labels.len()) {
            (Some(label), _) if labels.contains_key(&label) => Ok(label),
            (None, 1) => Ok(labels.into_keys().next().unwrap_or_default()),
            _ => {
                let mut there: Vec<String> = labels.iter().take(20).map(|(l, n)| format!("{l} ({n} voxels)")).collect();
                if labels.len() > there.len() {
                    there.push(format!("{} more", labels.len() - there.len()));
                }
                let there = if there.is_empty() { "none but 0".to_owned() } else { there.join(", ") };
                Err(ParametrizeError::NoLabel { path: self.path.clone(), label, there })
            }
        }
    }

    /// A label's voxels.
    ///
    /// # Errors
    ///
    /// As [`choose`](Self::choose).
    pub fn mask(&self, label: i64) -> Result<Mask, ParametrizeError> {
        self.choose(Some(label))?;
        let [nx, ny, _] = self.size;
        Ok(Mask::new(self.size, |[x, y, z]| i64::from(self.values[x + nx * (y + ny * z)]) == label))
    }
}

fn not_a_volume(path: &Path, expected: &'static str, found: String) -> ParametrizeError {
    ParametrizeError::NotAVolume { path: path.to_owned(), expected, found }
}

fn size_name(size: [usize; 3]) -> String {
    size.map(|n| n.to_string()).join(" x ")
}

/// Bytes of a value, for types that can hold a label.
fn width(kind: NiftiType) -> Option<usize> {
    use NiftiType::{Float32, Float64, Int8, Int16, Int32, Int64, Uint8, Uint16, Uint32, Uint64};
    match kind {
        Uint8 | Int8 => Some(1),
        Int16 | Uint16 => Some(2),
        Int32 | Uint32 | Float32 => Some(4),
        Int64 | Uint64 | Float64 => Some(8),
        _ => None,
    }
}

/// Values as whole numbers, scaled as the header says.
fn labels(
    path: &Path,
    data: &[u8],
    kind: NiftiType,
    width: usize,
    header: &NiftiHeader,
) -> Result<Vec<i32>, ParametrizeError> {
    let little = header.endianness == Endianness::Little;
    let (slope, inter) = (f64::from(header.scl_slope), f64::from(header.scl_inter));
    // A slope of 0 means no scaling.
    let scaled = slope != 0.0 && slope.is_finite() && inter.is_finite() && (slope, inter) != (1.0, 0.0);
    let one = |(index, bytes): (usize, &[u8])| {
        let mut raw = [0; 8];
        raw[..width].copy_from_slice(bytes);
        if !little {
            raw[..width].reverse();
        }
        let value = number(kind, raw);
        let value = if scaled { slope * value + inter } else { value };
        if value.fract() == 0.0 && value.abs() <= f64::from(i32::MAX) {
            return Ok(value as i32);
        }
        let found =
            format!("{value} at voxel {index} (counted from 0, x fastest); threshold or round the volume first");
        Err(not_a_volume(path, "whole numbers as labels", found))
    };
    data.chunks_exact(width).enumerate().map(one).collect()
}

/// A value from its bytes, little-endian, the unused ones 0.
fn number(kind: NiftiType, raw: [u8; 8]) -> f64 {
    let [a, b, c, d, ..] = raw;
    match kind {
        NiftiType::Uint8 => f64::from(a),
        NiftiType::Int8 => f64::from(i8::from_le_bytes([a])),
        NiftiType::Uint16 => f64::from(u16::from_le_bytes([a, b])),
        NiftiType::Int16 => f64::from(i16::from_le_bytes([a, b])),
        NiftiType::Uint32 => f64::from(u32::from_le_bytes([a, b, c, d])),
        NiftiType::Int32 => f64::from(i32::from_le_bytes([a, b, c, d])),
        NiftiType::Float32 => f64::from(f32::from_le_bytes([a, b, c, d])),
        NiftiType::Uint64 => u64::from_le_bytes(raw) as f64,
        NiftiType::Int64 => i64::from_le_bytes(raw) as f64,
        NiftiType::Float64 => f64::from_le_bytes(raw),
        _ => f64::NAN,
    }
}
