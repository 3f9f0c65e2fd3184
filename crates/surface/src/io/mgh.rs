//! Reads and writes FreeSurfer's MGH (`.mgh`, or gzipped `.mgz`) with values on vertices, in one or more frames.
//!
//! All numbers are big-endian: version (i32, 1), width, height, depth, frames, type (i32 each), degrees of freedom, and
//! 256 bytes of geometry. The values start at byte 284 (width varies fastest, frames slowest), and tags follow the
//! values. For values on n vertices, width, height and depth are n, 1 and 1 in any order. Files with more than one size
//! above 1 are volumes, which [`volume`](super::volume) recognises.
//!
//! Source: <https://surfer.nmr.mgh.harvard.edu/fswiki/FsTutorial/MghFormat>.

use std::io::{self, Write};

use super::bytes::{Cursor, Endian};
use super::flaw::{Flaw, bounded};
use super::spec::Context;
use crate::mesh::Signal;

const HEADER: usize = 284;

/// The sizes and the value type in a header.
struct Header {
    size: [u64; 3],
    frames: u64,
    kind: Kind,
}

/// The types of values.
#[derive(Clone, Copy)]
enum Kind {
    U8,
    I32,
    F32,
    I16,
}

impl Kind {
    fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::I16 => 2,
            Self::I32 | Self::F32 => 4,
        }
    }
}

fn header(bytes: &[u8]) -> Result<Header, Flaw> {
    let mut cursor = Cursor::new(bytes.get(..HEADER).unwrap_or(bytes));
    let version = cursor.i32(Endian::Big)?;
    if version != 1 {
        return Err(Flaw::new("version 1", version.to_string()));
    }
    let mut count = |what: &str| -> Result<u64, Flaw> {
        let n = cursor.i32(Endian::Big)?;
        let n = u64::try_from(n).ok().filter(|&n| n > 0);
        n.ok_or_else(|| Flaw::new(format!("a {what} above 0"), "0 or less".to_owned()))
    };
    let size = [count("width")?, count("height")?, count("depth")?];
    let frames = count("number of frames")?;
    let kind = match cursor.i32(Endian::Big)? {
        0 => Kind::U8,
        1 => Kind::I32,
        3 => Kind::F32,
        4 => Kind::I16,
        other => {
            return Err(Flaw::unsupported(
                format!("values of type {other}"),
                "convert the file with mri_convert -odt float",
            ));
        }
    };
    Ok(Header { size, frames, kind })
}

/// Returns whether the bytes begin like an MGH file.
pub(super) fn is_mgh(bytes: &[u8]) -> bool {
    bytes.len() >= HEADER && header(bytes).is_ok()
}

/// Returns whether the bytes begin like an MGH file of a volume.
pub(super) fn is_volume(bytes: &[u8]) -> bool {
    bytes.len() >= HEADER && header(bytes).is_ok_and(|header| header.size.iter().filter(|&&n| n > 1).count() > 1)
}

/// Reads values on vertices; each frame becomes a channel.
pub(super) fn read(bytes: &[u8]) -> Result<Signal, Flaw> {
    let Header { size, frames, kind } = header(bytes)?;
    let mut cursor = Cursor::new(bytes);
    cursor.take(HEADER)?;
    // All sizes are below 2^31 and all except one are 1, so the product doesn't overflow.
    let vertices = size.iter().product::<u64>();
    let count = bounded(vertices.saturating_mul(frames), kind.size(), cursor.remaining(), "values")?;
    let (vertices, channels) = (vertices as usize, frames as usize);
    let mut values = vec![0.0; count];
    for frame in 0..channels {
        for vertex in 0..vertices {
            let value = match kind {
                Kind::U8 => cursor.u8(Endian::Big)?.into(),
                Kind::I16 => cursor.i16(Endian::Big)?.into(),
                Kind::I32 => cursor.i32(Endian::Big)?.into(),
                Kind::F32 => cursor.f32(Endian::Big)?.into(),
            };
            if let Some(slot) = values.get_mut(vertex * channels + frame) {
                *slot = value;
            }
        }
    }
    Ok(Signal { values, vertices, channels })
}

/// Writes values on vertices as 32-bit floats of size n x 1 x 1, with one frame per channel.
pub(super) fn write(out: &mut dyn Write, signal: &Signal, _: &Context<'_>) -> io::Result<()> {
    const FLOAT: i32 = 3;
    let count = |n: usize| {
        i32::try_from(n).map_err(|_| {
            io::Error::other(
                "MGH files hold at most 2^31 - 1 vertices, and as many channels; write the values as .func.gii instead",
            )
        })
    };
    for n in [1, count(signal.vertices)?, 1, 1, count(signal.channels)?, FLOAT, 0] {
        out.write_all(&n.to_be_bytes())?;
    }
    // The geometry is all zeros, including the flag that would mark it as valid.
    out.write_all(&[0; HEADER - 28])?;
    for channel in 0..signal.channels {
        for &x in signal.values.iter().skip(channel).step_by(signal.channels) {
            out.write_all(&(x as f32).to_be_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(numbers: [i32; 7], values: &[u8]) -> Vec<u8> {
        let mut bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_be_bytes()).collect();
        bytes.resize(HEADER, 0);
        bytes.extend(values);
        bytes
    }

    #[test]
    fn frames_are_channels_and_what_follows_is_passed_over() {
        let values: Vec<u8> = [1_i16, -2, 3, 40, 50, 60].iter().flat_map(|x| x.to_be_bytes()).collect();
        let mut bytes = file([1, 1, 3, 1, 2, 4, 0], &values);
        bytes.extend(b"tags");
        assert!(is_mgh(&bytes) && !is_volume(&bytes));
        let signal = read(&bytes).unwrap();
        assert_eq!(signal, Signal::new(vec![1.0, 40.0, -2.0, 50.0, 3.0, 60.0], 3, 2));
    }

    #[test]
    fn what_is_written_is_read() {
        let signal = Signal::new(vec![0.5, 1.5, -2.5, 3.5, 4.5, 5.5], 3, 2);
        let mut bytes = Vec::new();
        write(&mut bytes, &signal, &Context { double: false, name: "", structure: None }).unwrap();
        assert_eq!(bytes.len(), HEADER + 24);
        assert_eq!(read(&bytes).unwrap(), signal);
    }

    #[test]
    fn headers_that_promise_too_much_are_refused() {
        for numbers in
            [[1, i32::MAX, 1, 1, i32::MAX, 3, 0], [1, -1, 1, 1, 1, 3, 0], [2, 1, 1, 1, 1, 3, 0], [1, 4, 1, 1, 1, 7, 0]]
        {
            assert!(read(&file(numbers, &[0; 8])).is_err(), "{numbers:?}");
        }
        assert!(read(&file([1, 2, 1, 1, 1, 3, 0], &[0; 7])).is_err());
    }
}
