//! Defines the number types that occur in the binary data of several formats.

use super::bytes::{Cursor, Endian};
use super::flaw::Flaw;

/// The type of a number in binary data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants are named like Rust's types")]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Returns the type that NumPy denotes by a letter and a number of bytes, with booleans as [`Self::U8`]. Returns
    /// `None` for other types, such as half precision.
    #[must_use]
    pub fn of_numpy(kind: char, size: usize) -> Option<Self> {
        Some(match (kind, size) {
            ('u' | 'b', 1) => Self::U8,
            ('i', 1) => Self::I8,
            ('u', 2) => Self::U16,
            ('i', 2) => Self::I16,
            ('u', 4) => Self::U32,
            ('i', 4) => Self::I32,
            ('u', 8) => Self::U64,
            ('i', 8) => Self::I64,
            ('f', 4) => Self::F32,
            ('f', 8) => Self::F64,
            _ => return None,
        })
    }

    /// Returns the size of a number of this type, in bytes.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Reads a number. Whole numbers beyond 2^53 are rounded.
    pub(super) fn read(self, cursor: &mut Cursor<'_>, endian: Endian) -> Result<f64, Flaw> {
        Ok(match self {
            Self::I8 => cursor.i8(endian)?.into(),
            Self::U8 => cursor.u8(endian)?.into(),
            Self::I16 => cursor.i16(endian)?.into(),
            Self::U16 => cursor.u16(endian)?.into(),
            Self::I32 => cursor.i32(endian)?.into(),
            Self::U32 => cursor.u32(endian)?.into(),
            Self::I64 => cursor.i64(endian)? as f64,
            Self::U64 => cursor.u64(endian)? as f64,
            Self::F32 => cursor.f32(endian)?.into(),
            Self::F64 => cursor.f64(endian)?,
        })
    }
}

/// Converts a vertex index, which must be a whole number from 0 to 2^32 - 1.
pub(super) fn index(x: f64) -> Result<u32, Flaw> {
    // The conversion is exact for every integer that fits u32. Fractions, negative numbers and NaN fail the comparison.
    let i = x as u32;
    if f64::from(i) == x { Ok(i) } else { Err(Flaw::new("vertex indices from 0 to 2^32 - 1", x.to_string())) }
}
