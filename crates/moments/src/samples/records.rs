//! Reads rows of a fixed number of bytes, with each field at a fixed offset in the row: NumPy arrays and the vertices
//! of PLY files.

use std::io::{self, Read};
use std::path::PathBuf;

use spharm_surface::io::Scalar;

use super::table::Table;
use crate::MomentsError;

/// Number of bytes decoded at a time, chosen to fit in a core's L2 cache.
const CACHED: usize = 1 << 18;

/// A field of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    /// Offset of the field in the row, in bytes.
    pub(super) at: usize,
    pub(super) kind: Kind,
    pub(super) little: bool,
}

/// Type of a field's values.
#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    Number(Scalar),
    /// Floating-point numbers of 16 bits.
    Half,
    /// Values that aren't numbers, with NumPy's letter for their type and their size in bytes.
    Other(char, usize),
}

impl Kind {
    /// Returns the number of bytes per value.
    pub(super) fn size(self) -> usize {
        match self {
            Self::Number(scalar) => scalar.size(),
            Self::Half => 2,
            Self::Other(_, size) => size,
        }
    }
}

/// A stream of bytes that contains rows.
pub(super) struct Stream {
    pub(super) input: Box<dyn Read + Send>,
    /// Number of bytes in a row.
    pub(super) row: usize,
    /// The fields of a row.
    pub(super) fields: Vec<Field>,
}

/// A table whose columns may be split among several streams. Each read takes the same range of rows from every stream
/// that contains selected columns.
pub(super) struct Records {
    pub(super) path: PathBuf,
    pub(super) format: &'static str,
    pub(super) names: Vec<String>,
    pub(super) streams: Vec<Stream>,
    /// Number of the table's rows before the shard.
    pub(super) before: u64,
    /// Number of rows of the shard that haven't been read yet.
    pub(super) left: u64,
    /// For each stream, the selected fields, each with the index of its value in the output row.
    selected: Vec<Vec<(Field, usize)>>,
    width: usize,
    buffer: Vec<u8>,
    /// Description of a selected column that doesn't contain numbers.
    unusable: Option<String>,
}

impl Records {
    pub(super) fn new(
        path: PathBuf,
        format: &'static str,
        names: Vec<String>,
        streams: Vec<Stream>,
        rows: std::ops::Range<u64>,
    ) -> Self {
        let (before, left) = (rows.start, rows.end - rows.start);
        let (selected, buffer) = (Vec::new(), Vec::new());
        Self { path, format, names, streams, before, left, selected, width: 0, buffer, unusable: None }
    }
}

impl Table for Records {
    fn columns(&self) -> &[String] {
        &self.names
    }

    fn select(&mut self, columns: Vec<usize>) {
        self.width = columns.len();
        let fields = self.streams.iter().flat_map(|stream| &stream.fields).zip(&self.names).enumerate();
        self.unusable = fields.filter(|(column, _)| columns.contains(column)).find_map(|(_, (field, name))| {
            let Kind::Other(kind, size) = field.kind else { return None };
            Some(format!("the column {name} of type {kind}{size}"))
        });
        let mut first = 0;
        self.selected.clear();
        for stream in &self.streams {
            let own = first..first + stream.fields.len();
            let places = columns.iter().enumerate().filter(|(_, column)| own.contains(column));
            self.selected.push(places.map(|(place, column)| (stream.fields[column - first], place)).collect());
            first = own.end;
        }
    }

    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError> {
        if let Some(found) = &self.unusable {
            return Err(MomentsError::Malformed {
                path: self.path.clone(),
                format: self.format,
                expected: "numbers of 8 to 64 bits".to_owned(),
                found: found.clone(),
            });
        }
        let rows = (most as u64).min(self.left) as usize;
        if rows == 0 {
            return Ok(0);
        }
        let start = out.len();
        out.resize(start + rows * self.width, 0.0);
        for (stream, fields) in self.streams.iter_mut().zip(&self.selected) {
            if fields.is_empty() {
                continue;
            }
            // Decode one field at a time, for a group of rows whose bytes fit in the cache and so stay there from one
            // field to the next.
            let together = (CACHED / stream.row).max(1);
            for out in out[start..].chunks_mut(together * self.width) {
                self.buffer.resize(out.len() / self.width * stream.row, 0);
                stream.input.read_exact(&mut self.buffer).map_err(|error| match error.kind() {
                    io::ErrorKind::UnexpectedEof => MomentsError::Malformed {
                        path: self.path.clone(),
                        format: self.format,
                        expected: format!("{} more rows", self.left),
                        found: "the end of the file; did a program write to the file while it was read?".to_owned(),
                    },
                    _ => MomentsError::io(&self.path, "read")(error),
                })?;
                for (field, place) in fields {
                    decode(&self.buffer, stream.row, *field, out[*place..].iter_mut().step_by(self.width));
                }
            }
        }
        self.left -= rows as u64;
        Ok(rows)
    }

    fn number_of(&self, row: u64) -> u64 {
        self.before + row + 1
    }
}

/// Decodes one field of every row in `bytes`.
fn decode<'a>(bytes: &[u8], row: usize, field: Field, out: impl Iterator<Item = &'a mut f64>) {
    fn each<'a, const N: usize>(
        bytes: &[u8],
        row: usize,
        field: Field,
        out: impl Iterator<Item = &'a mut f64>,
        of: impl Fn([u8; N]) -> f64,
    ) {
        for (out, row) in out.zip(bytes.chunks_exact(row)) {
            if let Some(mut number) = row.get(field.at..).and_then(|rest| rest.first_chunk::<N>()).copied() {
                if !field.little {
                    number.reverse();
                }
                *out = of(number);
            }
        }
    }
    match field.kind {
        Kind::Number(Scalar::I8) => each(bytes, row, field, out, |b| i8::from_le_bytes(b).into()),
        Kind::Number(Scalar::U8) => each(bytes, row, field, out, |b| u8::from_le_bytes(b).into()),
        Kind::Number(Scalar::I16) => each(bytes, row, field, out, |b| i16::from_le_bytes(b).into()),
        Kind::Number(Scalar::U16) => each(bytes, row, field, out, |b| u16::from_le_bytes(b).into()),
        Kind::Number(Scalar::I32) => each(bytes, row, field, out, |b| i32::from_le_bytes(b).into()),
        Kind::Number(Scalar::U32) => each(bytes, row, field, out, |b| u32::from_le_bytes(b).into()),
        Kind::Number(Scalar::I64) => each(bytes, row, field, out, |b| i64::from_le_bytes(b) as f64),
        Kind::Number(Scalar::U64) => each(bytes, row, field, out, |b| u64::from_le_bytes(b) as f64),
        Kind::Number(Scalar::F32) => each(bytes, row, field, out, |b| f32::from_le_bytes(b).into()),
        Kind::Number(Scalar::F64) => each(bytes, row, field, out, f64::from_le_bytes),
        Kind::Half => each(bytes, row, field, out, |b| half(u16::from_le_bytes(b))),
        Kind::Other(..) => {}
    }
}

/// Converts a 16-bit floating-point number to f64. Such a number consists of a sign, 5 bits of exponent and 10 bits of
/// fraction (IEEE 754, binary16).
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff);
    let size = match (bits >> 10) & 0x1f {
        0 => fraction * 2f64.powi(-24),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        exponent => (1024.0 + fraction) * 2f64.powi(i32::from(exponent) - 25),
    };
    if bits >> 15 == 0 { size } else { -size }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_16_bits_are_exact() {
        let values =
            [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x3555, 0.333_251_953_125), (0x0001, 2f64.powi(-24))];
        for (bits, expected) in values {
            assert_eq!(half(bits), expected, "{bits:04x}");
        }
        assert!(half(0x7e00).is_nan() && half(0xfc00) == f64::NEG_INFINITY && half(0x8000) == 0.0);
    }
}
