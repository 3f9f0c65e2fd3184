//! Reads NIfTI-2 files, a variant of NIfTI-1 with 64-bit sizes (<https://nifti.nimh.nih.gov/pub/dist/doc/nifti2.h>).
//!
//! | bytes | field |
//! |---|---|
//! | 0, i32 | size of the header, 540 |
//! | 4, 8 bytes | `n+2\0`, then line breaks in four variants |
//! | 12, i16 | type |
//! | 16, 8 x i64 | number of dimensions, sizes |
//! | 104, 8 x f64 | handedness, voxel sizes |
//! | 168, i64 | offset of the values |
//! | 176, 2 x f64 | slope and intercept |
//! | 344, 2 x i32 | qform code, sform code |
//! | 352, 6 x f64 | quaternion and offset |
//! | 400, 12 x f64 | rows of the sform |
//! | 500, i32 | units of length and time |

use std::io::Read;

use super::nifti::{Forms, image, millimetres};
use super::source::Source;
use super::values::{Layout, Scalar, Volume, cut_short, skip};
use crate::error::ParametrizeError;

const HEADER: usize = 540;

/// The bytes of a header, with their byte order.
struct Fields {
    bytes: [u8; HEADER],
    little: bool,
}

impl Fields {
    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&self.bytes[at..at + N]);
        if !self.little {
            bytes.reverse();
        }
        bytes
    }

    fn float(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.bytes(at))
    }

    fn long(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.bytes(at))
    }

    fn floats<const N: usize>(&self, at: usize) -> [f64; N] {
        std::array::from_fn(|k| self.float(at + 8 * k))
    }
}

/// Parses a file, given as a stream of at most `most` bytes.
pub(super) fn parse(source: &Source<'_>, mut stream: impl Read, most: u64) -> Result<Volume, ParametrizeError> {
    let (path, wrong) = (source.path, |expected, found| source.wrong(expected, found));
    let not_nifti = |what: String| wrong("a NIfTI-2 volume (.nii, .nii.gz)", what);
    let mut bytes = [0; HEADER];
    stream.read_exact(&mut bytes).map_err(|_| not_nifti("a file that is shorter than its header".to_owned()))?;
    let header = Fields { bytes, little: bytes[0] != 0 };
    if header.bytes[4..8] != *b"n+2\0" {
        let pair = header.bytes[4..8] == *b"ni2\0";
        let found = if pair { "a header with its values in an .img file; merge both files" } else { "another format" };
        return Err(not_nifti(found.to_owned()));
    }
    let dimensions: [i64; 8] = std::array::from_fn(|k| header.long(16 + 8 * k));
    let used = usize::try_from(dimensions[0]).ok().filter(|n| (3..=7).contains(n));
    let Some(used) = used else {
        return Err(wrong("three to seven dimensions", format!("dimensions {dimensions:?}")));
    };
    let image = image(source, &dimensions[1..=used])?;
    let kind = i16::from_le_bytes(header.bytes(12));
    let scalar = match kind {
        2 => Scalar::U8,
        4 => Scalar::I16,
        8 => Scalar::I32,
        16 => Scalar::F32,
        64 => Scalar::F64,
        256 => Scalar::I8,
        512 => Scalar::U16,
        768 => Scalar::U32,
        1024 => Scalar::I64,
        1280 => Scalar::U64,
        _ => return Err(wrong("numbers", format!("values of type {kind}"))),
    };
    let code = |at| i32::from_le_bytes(header.bytes(at));
    let unit = millimetres(source, code(500))?;
    // Sizes above 2^16 - 1 voxels along an axis are rejected; such a volume doesn't fit in memory.
    let claimed = [dimensions[1], dimensions[2], dimensions[3]];
    let [Ok(x), Ok(y), Ok(z)] = claimed.map(u16::try_from) else {
        return Err(not_nifti(format!("{claimed:?} voxels")));
    };
    let size = [x, y, z].map(usize::from);
    let [slope, intercept] = header.floats(176);
    let scaled = slope != 0.0 && slope.is_finite() && intercept.is_finite() && (slope, intercept) != (1.0, 0.0);
    let layout = Layout { size, scalar, little_endian: header.little, scaling: scaled.then_some((slope, intercept)) };
    let start = header.long(168).max(HEADER as i64 + 4) as u64;
    let offset = start.saturating_add(layout.bytes().saturating_mul(image));
    if layout.bytes() > most || offset > most {
        let bits = 8 * scalar.size();
        let found = format!("a file too short for the {x} x {y} x {z} voxels of {bits} bits stated in its header");
        return Err(not_nifti(found));
    }
    let broken = |error: std::io::Error| cut_short(path, &error.to_string());
    skip(source, &mut stream, offset - HEADER as u64)?;
    let voxels = layout.read(source, &mut stream)?;
    std::io::copy(&mut (&mut stream).take(1 << 20), &mut std::io::sink()).map_err(broken)?;
    let forms = Forms {
        sform: (code(348) > 0).then(|| [400, 432, 464].map(|at| header.floats(at))),
        qform: (code(344) > 0).then(|| (header.floats(352), header.floats(376))),
        codes: [code(348), code(344)],
        sizes: header.floats(112),
        mirrored: header.float(104) < 0.0,
    };
    let (affine, doubt) = (forms.affine().scaled(unit), forms.doubt(size, unit));
    if !affine.is_valid() {
        return Err(wrong("voxels of finite, nonzero volume", format!("the matrix {:?}", affine.0)));
    }
    Ok(Volume { size, affine, voxels, doubt })
}
