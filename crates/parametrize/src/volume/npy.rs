//! Arrays of NumPy (`.npy`), three axes of whole numbers or truth values. The first axis is x; the voxels' size is given.

use std::io::Read;

use spharm_surface::npy::Header;

use super::source::Source;
use super::values::{Layout, Scalar, Volume, cut_short};
use crate::error::ParametrizeError;

/// Parses a stream that holds at most `most` bytes.
pub(super) fn parse(source: &Source<'_>, mut stream: impl Read, most: u64) -> Result<Volume, ParametrizeError> {
    let header = Header::read(&mut stream).map_err(|error| source.wrong("a NumPy array", error.to_string()))?;
    let scalar = match (header.kind, header.size) {
        ('u' | 'b', 1) => Scalar::U8,
        ('i', 1) => Scalar::I8,
        ('u', 2) => Scalar::U16,
        ('i', 2) => Scalar::I16,
        ('u', 4) => Scalar::U32,
        ('i', 4) => Scalar::I32,
        ('u', 8) => Scalar::U64,
        ('i', 8) => Scalar::I64,
        ('f', 4) => Scalar::F32,
        ('f', 8) => Scalar::F64,
        (kind, size) => return Err(source.wrong("whole numbers as labels", format!("values of type {kind}{size}"))),
    };
    let [x, y, z] = header.shape[..] else {
        return Err(source.wrong("three dimensions", format!("shape {:?}; give one volume of them", header.shape)));
    };
    if header.bytes().is_none_or(|bytes| bytes > most) {
        let found = format!("{x} x {y} x {z} values claimed by a file that can't hold them");
        return Err(source.wrong("a NumPy array", found));
    }
    let affine = source.affine(None, "a NumPy array")?;
    let layout = Layout { voxels: x * y * z, scalar, little_endian: header.little, scaling: None };
    let values = layout.read(source.path, &mut stream, source.monitor)?;
    // Also on to the end of what was compressed, where its checksum is.
    let beyond = stream.take(1).read_to_end(&mut Vec::new());
    if beyond.map_err(|error| cut_short(source.path, &error.to_string()))? > 0 {
        return Err(cut_short(source.path, "more bytes than its shape says"));
    }
    let size = [x, y, z];
    Ok(Volume { size, affine, values: if header.fortran { values } else { x_fastest(size, &values) } })
}

/// Values whose last axis runs fastest, x fastest.
fn x_fastest([nx, ny, nz]: [usize; 3], values: &[i32]) -> Vec<i32> {
    let mut found = Vec::with_capacity(values.len());
    for z in 0..nz {
        for y in 0..ny {
            found.extend((0..nx).map(|x| values[z + nz * (y + ny * x)]));
        }
    }
    found
}
