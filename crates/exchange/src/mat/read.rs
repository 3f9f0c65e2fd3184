//! Reads MATLAB's MAT files of level 5.
//!
//! Sizes declared in a file are checked against the bytes present before memory is allocated. A compressed matrix is
//! inflated only if it is requested, and to at most [`LARGEST`] bytes.

use std::io::Read;

use flate2::read::ZlibDecoder;
use ndarray::Array2;
use spharm_surface::io::check_room;

use crate::flaw::Flaw;

const COMPRESSED: u32 = 15;
const MATRIX: u32 = 14;
const COMPLEX: u32 = 1 << 11;
/// Maximum size in bytes of an inflated matrix. This is nearly three times the size of the coordinates of 4 million
/// vertices, or of complex coefficients up to degree 1,400 with 3 channels.
const LARGEST: u64 = 256 << 20;
/// Number of bytes at the beginning of a matrix that contain its flags, dimensions and name.
const HEAD: u64 = 512;

/// Returns whether bytes begin like a MAT file.
pub(crate) fn is_mat(bytes: &[u8]) -> bool {
    bytes.starts_with(b"MATLAB ")
}

/// A matrix, stored column by column.
pub(super) struct Matrix {
    pub(super) rows: usize,
    pub(super) columns: usize,
    re: Vec<f64>,
    /// Imaginary parts; empty for a real matrix.
    im: Vec<f64>,
}

impl Matrix {
    pub(super) fn real(&self, row: usize, column: usize) -> f64 {
        self.re.get(column * self.rows + row).copied().unwrap_or(f64::NAN)
    }

    pub(super) fn to_array<T>(&self, value: impl Fn(f64, f64) -> T) -> Array2<T> {
        Array2::from_shape_fn((self.rows, self.columns), |(row, column)| {
            let im = self.im.get(column * self.rows + row).copied().unwrap_or(0.0);
            value(self.real(row, column), im)
        })
    }
}

/// The byte order of a file.
#[derive(Clone, Copy)]
struct Order {
    big: bool,
}

impl Order {
    fn number(self, bytes: &[u8]) -> Option<u32> {
        let bytes = *bytes.first_chunk()?;
        Some(if self.big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    /// Removes the first element from `bytes`. Returns its type and its contents.
    fn element<'a>(self, bytes: &mut &'a [u8]) -> Result<(u32, &'a [u8]), Flaw> {
        let cut = || Flaw::new("another data element", "the end of the file");
        let tag = self.number(bytes).ok_or_else(cut)?;
        // Elements of up to four bytes are stored within the 8-byte tag; their size is in the upper half of the type
        // field.
        let (kind, length, from) = match tag >> 16 {
            0 => (tag, self.number(bytes.get(4..).unwrap_or_default()).ok_or_else(cut)? as usize, 8),
            small => (tag & 0xffff, small as usize, 4),
        };
        if from == 4 && length > 4 {
            return Err(Flaw::new("a small element of at most four bytes", length));
        }
        let found = bytes.get(from..).and_then(|rest| rest.get(..length));
        let found = found.ok_or_else(|| {
            Flaw::new(format!("an element of {length} bytes"), format!("{} bytes", bytes.len().saturating_sub(from)))
        })?;
        // Compressed elements have no padding, and the padding of the last element may be missing.
        let end = if from == 4 {
            8
        } else if kind == COMPRESSED {
            from + length
        } else {
            from + length.next_multiple_of(8)
        };
        *bytes = bytes.get(end..).unwrap_or_default();
        Ok((kind, found))
    }
}

/// Reads the matrices with the given names. A matrix is `None` if the file has none with its name.
pub(super) fn matrices<const N: usize>(bytes: &[u8], names: [&str; N]) -> Result<[Option<Matrix>; N], Flaw> {
    let head = bytes.get(..128).ok_or_else(|| Flaw::new("a header of 128 bytes", format!("{} bytes", bytes.len())))?;
    if head.starts_with(b"MATLAB 7.3") {
        return Err(Flaw::new("a MAT file of level 5, as written by MATLAB's save -v7", "version 7.3"));
    }
    let order = match head.get(126..) {
        Some(b"IM") => Order { big: false },
        Some(b"MI") => Order { big: true },
        _ => return Err(Flaw::new("a byte-order mark at byte 126", "none")),
    };
    let mut rest = bytes.get(128..).unwrap_or_default();
    let mut found = [const { None }; N];
    while !rest.is_empty() {
        let (kind, contents) = order.element(&mut rest)?;
        let inflated;
        let matrix = match kind {
            MATRIX => contents,
            COMPRESSED => {
                inflated = inflate(order, contents, &names)?;
                inflated.as_slice()
            }
            _ => continue,
        };
        let Some(name) = name(order, matrix) else { continue };
        if let Some(place) = names.iter().position(|wanted| wanted.as_bytes() == name) {
            found[place] = Some(parse(order, matrix, names[place])?);
        }
    }
    Ok(found)
}

/// Inflates a compressed matrix if it has one of the given names. Otherwise, inflates only the beginning of the matrix,
/// which contains its name.
fn inflate(order: Order, contents: &[u8], names: &[&str]) -> Result<Vec<u8>, Flaw> {
    let wrong = |error: std::io::Error| Flaw::new("a compressed matrix", error);
    let mut decoder = ZlibDecoder::new(contents);
    let mut head = Vec::new();
    decoder.by_ref().take(HEAD).read_to_end(&mut head).map_err(wrong)?;
    let length = head.get(4..).and_then(|rest| order.number(rest)).map_or(0, u64::from);
    let mut matrix = head.get(8..).unwrap_or_default().to_vec();
    if !name(order, &matrix).is_some_and(|name| names.iter().any(|wanted| wanted.as_bytes() == name)) {
        return Ok(matrix);
    }
    if length > LARGEST {
        return Err(Flaw::new(format!("a matrix of at most {LARGEST} bytes"), length));
    }
    let left = length.saturating_sub(matrix.len() as u64);
    decoder.take(left).read_to_end(&mut matrix).map_err(wrong)?;
    matrix.truncate(length as usize);
    if matrix.len() as u64 != length {
        return Err(Flaw::new(format!("a compressed matrix of {length} bytes"), matrix.len()));
    }
    Ok(matrix)
}

/// Returns the name of a matrix, which is its third element. Returns `None` if the matrix is malformed.
fn name(order: Order, mut matrix: &[u8]) -> Option<&[u8]> {
    for _ in 0..2 {
        order.element(&mut matrix).ok()?;
    }
    order.element(&mut matrix).ok().map(|(_, name)| name)
}

fn parse(order: Order, mut matrix: &[u8], name: &str) -> Result<Matrix, Flaw> {
    let (_, flags) = order.element(&mut matrix)?;
    let flags = order.number(flags).ok_or_else(|| Flaw::new(format!("flags of {name}"), "none"))?;
    // Classes 6 to 15 are full matrices of numbers; sparse matrices, cells, structures and text have lower class
    // numbers.
    if !(6..=15).contains(&(flags & 0xff)) {
        return Err(Flaw::new(format!("{name} as a full matrix of numbers"), format!("class {}", flags & 0xff)));
    }
    let (_, dimensions) = order.element(&mut matrix)?;
    let dimensions: Vec<usize> =
        dimensions.chunks_exact(4).filter_map(|bytes| order.number(bytes)).map(|n| n as usize).collect();
    let [rows, columns] = dimensions[..] else {
        return Err(Flaw::new(format!("{name} with two dimensions"), format!("{dimensions:?}")));
    };
    order.element(&mut matrix)?;
    let mut part = || -> Result<Vec<f64>, Flaw> {
        let (kind, bytes) = order.element(&mut matrix)?;
        // A value may take only one byte in the file, but takes 8 bytes in memory.
        check_room(8 * bytes.len() as u64)
            .map_err(|room| Flaw::new("a matrix that fits in memory", format!("one that needs {room}")))?;
        let values = numbers(order, kind, bytes)
            .ok_or_else(|| Flaw::new(format!("numbers in {name}"), format!("data of type {kind}")))?;
        if rows.checked_mul(columns) != Some(values.len()) {
            return Err(Flaw::new(format!("{rows} x {columns} numbers in {name}"), values.len()));
        }
        match values.iter().find(|x| !x.is_finite()) {
            Some(x) => Err(Flaw::new(format!("finite numbers in {name}"), x)),
            None => Ok(values),
        }
    };
    let re = part()?;
    let im = if flags & COMPLEX == 0 { Vec::new() } else { part()? };
    Ok(Matrix { rows, columns, re, im })
}

/// Converts the numbers of an element to f64; `None` for an unknown type. MATLAB stores whole numbers in the smallest
/// integer type that can hold them.
fn numbers(order: Order, kind: u32, bytes: &[u8]) -> Option<Vec<f64>> {
    fn all<const N: usize>(order: Order, bytes: &[u8], number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        let in_order = |mut bytes: [u8; N]| {
            if order.big {
                bytes.reverse();
            }
            number(bytes)
        };
        bytes.as_chunks().0.iter().copied().map(in_order).collect()
    }
    Some(match kind {
        1 => all(order, bytes, |b| i8::from_le_bytes(b).into()),
        2 => all(order, bytes, |b| u8::from_le_bytes(b).into()),
        3 => all(order, bytes, |b| i16::from_le_bytes(b).into()),
        4 => all(order, bytes, |b| u16::from_le_bytes(b).into()),
        5 => all(order, bytes, |b| i32::from_le_bytes(b).into()),
        6 => all(order, bytes, |b| u32::from_le_bytes(b).into()),
        7 => all(order, bytes, |b| f32::from_le_bytes(b).into()),
        9 => all(order, bytes, f64::from_le_bytes),
        12 => all(order, bytes, |b| i64::from_le_bytes(b) as f64),
        13 => all(order, bytes, |b| u64::from_le_bytes(b) as f64),
        _ => return None,
    })
}
