//! Encodes the arrays of a page: splits them into byte planes, compresses these by gzip, and writes them in base64.
//!
//! In byte planes, the first bytes of all numbers come first, then the second bytes of all numbers, and so on. Bytes at
//! the same position, such as exponents, are similar in all numbers, so this order halves the compressed size.

use std::io::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;

/// Reference to an array in a page: its block and the type of its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub(crate) struct Block {
    /// Number N in the id `data-N` of the block's HTML element.
    id: usize,
    /// Type of the numbers: `f32`, `i32` or `i16`.
    kind: &'static str,
    /// Number of values.
    length: usize,
}

/// Encoded arrays of a page. Equal arrays are stored only once.
#[derive(Debug, Default)]
pub(crate) struct Blocks {
    packed: Vec<(blake3::Hash, String)>,
}

impl Blocks {
    pub(crate) fn f32(&mut self, values: impl IntoIterator<Item = f64>) -> Block {
        let bytes: Vec<u8> = values.into_iter().flat_map(|value| (value as f32).to_le_bytes()).collect();
        self.add("f32", 4, &bytes)
    }

    pub(crate) fn i16(&mut self, values: impl IntoIterator<Item = i16>) -> Block {
        let bytes: Vec<u8> = values.into_iter().flat_map(i16::to_le_bytes).collect();
        self.add("i16", 2, &bytes)
    }

    /// Adds triangles. Each triangle is stored as the differences between its vertex indices and those of the preceding
    /// triangle. Differences compress well, because consecutive triangles in a file are mostly neighbours on the
    /// surface.
    pub(crate) fn faces(&mut self, faces: &[[u32; 3]]) -> Block {
        let mut before = [0u32; 3];
        let mut bytes = Vec::with_capacity(12 * faces.len());
        for face in faces {
            for (vertex, previous) in face.iter().zip(&mut before) {
                bytes.extend(vertex.wrapping_sub(*previous).to_le_bytes());
                *previous = *vertex;
            }
        }
        self.add("i32", 4, &bytes)
    }

    fn add(&mut self, kind: &'static str, width: usize, bytes: &[u8]) -> Block {
        let length = bytes.len() / width;
        let planes: Vec<u8> = (0..width).flat_map(|k| bytes.iter().skip(k).step_by(width).copied()).collect();
        let hash = blake3::hash(&planes);
        let there = self.packed.iter().position(|(other, _)| *other == hash);
        let id = there.unwrap_or_else(|| {
            self.packed.push((hash, STANDARD.encode(gzip(&planes))));
            self.packed.len() - 1
        });
        Block { id, kind, length }
    }

    /// Returns the HTML elements of all blocks.
    pub(crate) fn html(&self) -> String {
        let element = |(id, (_, text)): (usize, &(_, String))| {
            format!("<script type=\"application/octet-stream\" id=\"data-{id}\">{text}</script>\n")
        };
        self.packed.iter().enumerate().map(element).collect()
    }
}

/// Compresses bytes by gzip, without a timestamp in the header.
fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // Writing to a vector never fails.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn planes_return_and_equal_arrays_are_kept_once() {
        let mut blocks = Blocks::default();
        let first = blocks.i16([1, -2, 300]);
        assert_eq!(first, Block { id: 0, kind: "i16", length: 3 });
        assert_eq!((blocks.f32([0.5]).id, blocks.i16([1, -2, 300]).id), (1, 0));
        let mut planes = Vec::new();
        let packed = STANDARD.decode(&blocks.packed[0].1).unwrap();
        flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut planes).unwrap();
        assert_eq!(planes, [1, 254, 44, 0, 255, 1]);
        assert_eq!(blocks.html().matches("<script").count(), 2);
    }

    #[test]
    fn triangles_are_differences() {
        let mut blocks = Blocks::default();
        let differences = [[0u32, 1, 2], [2, 0u32.wrapping_sub(1), 1]].as_flattened().to_vec();
        let faces = blocks.faces(&[[0, 1, 2], [2, 0, 3]]);
        let bytes: Vec<u8> = differences.into_iter().flat_map(u32::to_le_bytes).collect();
        assert_eq!(blocks.add("i32", 4, &bytes), faces);
    }
}
