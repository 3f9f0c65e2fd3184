//! Reads NumPy arrays (`.npy`) with three axes of numbers or booleans. The first axis is x, unless the caller gives the
//! order z, y, x. The format doesn't record the voxel size, so the caller must give it.

use std::io::Read;

use spharm_surface::npy::Header;

use super::axes::AxisOrder;
use super::source::{Source, no_room};
use super::values::{Layout, Scalar, Volume, cut_short};
use crate::error::ParametrizeError;

/// Parses a file, given as a stream of at most `most` bytes.
pub(super) fn parse(source: &Source<'_>, mut stream: impl Read, most: u64) -> Result<Volume, ParametrizeError> {
    let header = Header::read(&mut stream).map_err(|error| source.wrong("a NumPy array", error.to_string()))?;
    let scalar = Scalar::of_numpy(header.kind, header.size).ok_or_else(|| {
        let expected = "booleans, integers, or floats of 32 or 64 bits";
        source.wrong(expected, format!("values of type {}{}", header.kind, header.size))
    })?;
    let [first, middle, last] = header.shape[..] else {
        return Err(source.wrong("three dimensions", format!("shape {:?}; extract one volume", header.shape)));
    };
    if header.bytes().is_none_or(|bytes| bytes > most) {
        let found = format!("a file too short for the {first} x {middle} x {last} values stated in its header");
        return Err(source.wrong("a NumPy array", found));
    }
    source.image(1, 1)?;
    let affine = source.affine(Err("a NumPy array"))?;
    // In C order the last axis varies fastest.
    let ([x, y, z], x_fastest) = match source.axes {
        AxisOrder::Xyz => ([first, middle, last], header.fortran),
        AxisOrder::Zyx => ([last, middle, first], !header.fortran),
    };
    let stored = if x_fastest { [x, y, z] } else { [z, y, x] };
    let layout = Layout { size: stored, scalar, little_endian: header.little, scaling: None };
    let voxels = layout.read(source, &mut stream)?;
    // Reading beyond the values detects surplus bytes, and verifies the checksum at the end of compressed data.
    let beyond = stream.take(1).read_to_end(&mut Vec::new());
    if beyond.map_err(|error| cut_short(source.path, &error.to_string()))? > 0 {
        return Err(cut_short(source.path, "more bytes than the shape allows"));
    }
    let voxels =
        if x_fastest { voxels } else { voxels.transposed(stored).map_err(|room| no_room(source.path, room))? };
    Ok(Volume { size: [x, y, z], affine, voxels, doubt: None })
}
