//! Reads FreeSurfer volumes (`.mgh`, `.mgz`): a header of 284 bytes, then the values, all big-endian
//! (<https://surfer.nmr.mgh.harvard.edu/fswiki/FsTutorial/MghFormat>).
//!
//! | bytes | field |
//! |---|---|
//! | 0, i32 | version, 1 |
//! | 4, 4 x i32 | width, height, depth, frames |
//! | 20, i32 | type: 0 u8, 1 i32, 3 f32, 4 i16 |
//! | 28, i16 | whether the following fields are valid |
//! | 30, 3 x f32 | voxel sizes |
//! | 42, 9 x f32 | directions of the three axes in RAS |
//! | 78, 3 x f32 | RAS coordinates of the centre, voxel (width / 2, height / 2, depth / 2) |

use std::io::Read;

use super::affine::Affine;
use super::source::Source;
use super::values::{Layout, Scalar, Volume, cut_short, skip};
use crate::error::ParametrizeError;

/// Number of bytes of the header.
const HEADER: usize = 284;

/// Returns how many of the sizes are 1.
fn ones(sizes: [i32; 3]) -> usize {
    sizes.iter().filter(|&&n| n == 1).count()
}

/// Parses a file, given as a stream of at most `most` bytes.
pub(super) fn parse(source: &Source<'_>, mut stream: impl Read, most: u64) -> Result<Volume, ParametrizeError> {
    let (path, wrong) = (source.path, |expected, found| source.wrong(expected, found));
    let not_mgh = |what: String| wrong("a FreeSurfer volume (.mgh, .mgz)", what);
    let mut header = [0; HEADER];
    stream.read_exact(&mut header).map_err(|_| not_mgh("a file that is shorter than its header".to_owned()))?;
    let int = |at: usize| i32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let float = |at: usize| f64::from(f32::from_bits(int(at) as u32));
    if int(0) != 1 {
        return Err(not_mgh(format!("version {}", int(0))));
    }
    let dims = [4, 8, 12].map(int);
    // If two sizes are 1, the file has values on the vertices of a surface. In such a file, the third size can exceed
    // the largest size of a volume, and there are often several frames. It must therefore be recognised before sizes
    // and frames are checked.
    if let (Ok(vertices @ 2..), 2) = (usize::try_from(dims[0].max(dims[1]).max(dims[2])), ones(dims)) {
        return Err(ParametrizeError::VertexMap { path: path.to_owned(), vertices });
    }
    let [Ok(x), Ok(y), Ok(z)] = dims.map(u16::try_from) else {
        return Err(not_mgh(format!("{dims:?} voxels")));
    };
    let frames = usize::try_from(int(16)).ok().filter(|frames| *frames > 0);
    let frames = frames.ok_or_else(|| not_mgh(format!("{} frames", int(16))))?;
    let [_, frame] = source.image(1, frames)?;
    source.fixed_axes("a FreeSurfer volume")?;
    let scalar = match int(20) {
        0 => Scalar::U8,
        1 => Scalar::I32,
        3 => Scalar::F32,
        4 => Scalar::I16,
        other => return Err(wrong("numbers", format!("values of type {other}"))),
    };
    let size = [x, y, z].map(usize::from);
    let layout = Layout { size, scalar, little_endian: false, scaling: None };
    let skipped = layout.bytes().saturating_mul(frame as u64);
    if layout.bytes().saturating_add(skipped) > most {
        let bits = 8 * scalar.size();
        let found = format!("a file too short for the {x} x {y} x {z} voxels of {bits} bits stated in its header");
        return Err(not_mgh(found));
    }
    skip(source, &mut stream, skipped)?;
    let voxels = layout.read(source, &mut stream)?;
    // Reads to the end of the compressed data, so that its checksum is verified. Tags may follow the values.
    let rest = std::io::copy(&mut (&mut stream).take(1 << 20), &mut std::io::sink());
    rest.map_err(|error| cut_short(path, &error.to_string()))?;
    let placed = i16::from_be_bytes([header[28], header[29]]) > 0;
    // If the header states that its fields of positions aren't valid, FreeSurfer's defaults apply: coronal slices,
    // voxels of 1 mm.
    let (sizes, axes, centre) = if placed {
        let axis = |k: usize| [0, 4, 8].map(|i| float(42 + 12 * k + i));
        ([30, 34, 38].map(float), [0, 1, 2].map(axis), [78, 82, 86].map(float))
    } else {
        ([1.0; 3], [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], [0.0; 3])
    };
    let row = |i: usize| {
        let [a, b, c] = [0, 1, 2].map(|k: usize| axes[k][i] * sizes[k]);
        let middle = [x, y, z].map(|n| f64::from(n) / 2.0);
        [a, b, c, centre[i] - (a * middle[0] + b * middle[1] + c * middle[2])]
    };
    let affine = Affine([row(0), row(1), row(2)]);
    if !affine.is_valid() {
        return Err(wrong("voxels of finite, nonzero volume", format!("the matrix {:?}", affine.0)));
    }
    Ok(Volume { size, affine, voxels, doubt: None })
}
