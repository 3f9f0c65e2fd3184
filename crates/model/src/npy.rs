//! NumPy's array files (`.npy`), as far as models need them.
//!
//! Magic, version, length of the header, the header (a Python dictionary), values. Read are versions 1 to 3, numbers of
//! 32 and 64 bits in either byte order, text of UCS-4, C and Fortran order. Sizes are held against the bytes that can be
//! there before anything is allocated for them.
//!
//! Source: NumPy Enhancement Proposal 1, and `numpy.lib.format`.

use std::io::{self, Read, Write};

use ndarray::{Array2, ShapeBuilder};

const MAGIC: &[u8] = b"\x93NUMPY";
/// NumPy's own limit is 10,000 characters.
const LONGEST_HEADER: usize = 1 << 16;

/// An array as it was read.
pub(crate) struct Array {
    /// Kind and size, as NumPy has them: `f8`, `i4`, `U64`.
    kind: char,
    size: usize,
    little: bool,
    fortran: bool,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Array {
    /// Reads an array of at most `most` bytes.
    pub(crate) fn read(input: &mut dyn Read, most: u64) -> Result<Self, String> {
        let text = read_header(input).map_err(|error| error.to_string())?;
        let mut array = Self::of_header(&text).ok_or_else(|| format!("the header {text:?} is not understood"))?;
        let count = array.shape.iter().try_fold(array.size as u64, |product, &n| product.checked_mul(n as u64));
        let count = count.filter(|&count| count <= most).ok_or("its shape doesn't fit its length")?;
        // One more, so that the archive's checksum is compared, which it is at the end.
        input.take(count + 1).read_to_end(&mut array.bytes).map_err(|error| error.to_string())?;
        if array.bytes.len() as u64 != count {
            return Err("its shape doesn't fit its length".to_owned());
        }
        Ok(array)
    }

    fn of_header(text: &str) -> Option<Self> {
        let value = |key: &str| Some(text.split_once(&format!("'{key}':"))?.1.trim_start());
        let descr = value("descr")?.strip_prefix('\'')?.split_once('\'')?.0;
        let order = descr.chars().next()?;
        let descr = descr.trim_start_matches(['<', '>', '|', '=']);
        let kind = descr.chars().next()?;
        let size: usize = descr.get(kind.len_utf8()..)?.parse().ok()?;
        let shape = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let shape = shape.split(',').map(str::trim).filter(|n| !n.is_empty());
        Some(Self {
            kind,
            // Characters have four bytes.
            size: if kind == 'U' { size.checked_mul(4)? } else { size },
            little: order != '>',
            fortran: value("fortran_order")?.starts_with("True"),
            shape: shape.map(|n| n.parse().ok()).collect::<Option<_>>()?,
            bytes: Vec::new(),
        })
    }

    /// Returns all values in the order of the file.
    fn numbers(&self) -> Result<Vec<f64>, String> {
        fn all<const N: usize>(array: &Array, number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
            let in_order = |mut bytes: [u8; N]| {
                if !array.little {
                    bytes.reverse();
                }
                number(bytes)
            };
            array.bytes.as_chunks().0.iter().copied().map(in_order).collect()
        }
        Ok(match (self.kind, self.size) {
            ('f', 8) => all(self, f64::from_le_bytes),
            ('f', 4) => all(self, |b| f32::from_le_bytes(b).into()),
            ('i', 4) => all(self, |b| i32::from_le_bytes(b).into()),
            ('u', 4) => all(self, |b| u32::from_le_bytes(b).into()),
            ('i', 8) => all(self, |b| i64::from_le_bytes(b) as f64),
            ('u', 8) => all(self, |b| u64::from_le_bytes(b) as f64),
            (kind, size) => return Err(format!("values of type {kind}{size}; expected numbers of 32 or 64 bits")),
        })
    }

    /// Returns a matrix; a vector is one of a single column.
    pub(crate) fn matrix(&self) -> Result<Array2<f64>, String> {
        let dimensions = match self.shape[..] {
            [rows] => (rows, 1),
            [rows, columns] => (rows, columns),
            _ => return Err(format!("shape {:?}; expected two dimensions", self.shape)),
        };
        let matrix = Array2::from_shape_vec(dimensions.set_f(self.fortran), self.numbers()?);
        Ok(matrix.map_err(|error| error.to_string())?.as_standard_layout().into_owned())
    }

    /// Returns the only value.
    pub(crate) fn scalar(&self) -> Result<f64, String> {
        match self.numbers()?[..] {
            [value] => Ok(value),
            ref values => Err(format!("{} values; expected one", values.len())),
        }
    }

    /// Returns a text.
    pub(crate) fn text(&self) -> Result<String, String> {
        if self.kind != 'U' || self.shape.iter().product::<usize>() != 1 {
            return Err("expected a text".to_owned());
        }
        let code = |&bytes: &[u8; 4]| {
            char::from_u32(if self.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
        };
        let text: Option<String> = self.bytes.as_chunks().0.iter().map(code).collect();
        Ok(text.ok_or("expected a text")?.trim_end_matches('\0').to_owned())
    }
}

fn read_header(input: &mut dyn Read) -> io::Result<String> {
    let mut start = [0; 8];
    input.read_exact(&mut start)?;
    let invalid = |text| io::Error::new(io::ErrorKind::InvalidData, text);
    let length = match start {
        [magic @ .., 1, _] if magic == MAGIC => {
            let mut length = [0; 2];
            input.read_exact(&mut length)?;
            u16::from_le_bytes(length).into()
        }
        [magic @ .., 2 | 3, _] if magic == MAGIC => {
            let mut length = [0; 4];
            input.read_exact(&mut length)?;
            u32::from_le_bytes(length) as usize
        }
        _ => return Err(invalid("not a NumPy array of version 1 to 3")),
    };
    if length > LONGEST_HEADER {
        return Err(invalid("its header is too long"));
    }
    let mut header = vec![0; length];
    input.read_exact(&mut header)?;
    String::from_utf8(header).map_err(|_| invalid("its header isn't text"))
}

/// Writes an array's header, version 1.
pub(crate) fn write_header(out: &mut dyn Write, descr: &str, shape: &str) -> io::Result<()> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Up to the values it has a multiple of 64 bytes, and it ends in a new line.
    let before = MAGIC.len() + 4;
    let length = (before + header.len() + 1).next_multiple_of(64) - before;
    header.extend(std::iter::repeat_n(' ', length - header.len() - 1));
    header.push('\n');
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    let length = u16::try_from(length).map_err(io::Error::other)?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())
}

/// Writes a text as `numpy.array("text")` is stored: shape (), UCS-4.
pub(crate) fn write_text(out: &mut dyn Write, text: &str) -> io::Result<()> {
    // NumPy has no texts of length 0.
    write_header(out, &format!("<U{}", text.chars().count().max(1)), "()")?;
    for character in text.chars().chain(text.is_empty().then_some('\0')) {
        out.write_all(&u32::from(character).to_le_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array(descr: &str, fortran: bool, shape: &str, bytes: &[u8]) -> Result<Array, String> {
        let order = if fortran { "True" } else { "False" };
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let file = [MAGIC, &[2, 0], &(header.len() as u32).to_le_bytes(), header.as_bytes(), bytes].concat();
        Array::read(&mut &file[..], 1 << 20)
    }

    #[test]
    fn either_order_of_bytes_and_of_axes() {
        let values = [1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0];
        let little = values.map(f32::to_le_bytes).concat();
        let big = values.map(f32::to_be_bytes).concat();
        let rows = array("<f4", false, "(2, 3)", &little).unwrap().matrix().unwrap();
        assert_eq!(rows, ndarray::arr2(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
        let columns = array(">f4", true, "(3, 2)", &big).unwrap().matrix().unwrap();
        assert_eq!(columns, ndarray::arr2(&[[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]));
        assert!(columns.is_standard_layout());
        let vector = array("<f4", false, "(6,)", &little).unwrap().matrix().unwrap();
        assert_eq!(vector.dim(), (6, 1));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        for (descr, shape, bytes) in [
            ("<f8", "(2,)", 15),
            ("<f8", "(2,)", 17),
            ("<f8", "(99999999999, 99999999999)", 16),
            ("<f8", "(-1,)", 0),
            ("f", "()", 0),
            ("", "()", 0),
        ] {
            assert!(array(descr, false, shape, &vec![0; bytes]).is_err(), "{descr} {shape} {bytes}");
        }
        assert!(array("<f2", false, "(2,)", &[0; 4]).unwrap().matrix().is_err());
        assert!(array("<f8", false, "(1, 1, 1)", &[0; 8]).unwrap().matrix().is_err());
        assert!(array("<U1", false, "()", &[255; 4]).unwrap().text().is_err());
    }

    #[test]
    fn texts_return() {
        for text in ["", "f\u{fc}t", "{\"a\": 1}"] {
            let mut file = Vec::new();
            write_text(&mut file, text).unwrap();
            let values = 4 * text.chars().count().max(1);
            assert_eq!((file.len() - values) % 64, 0, "NumPy aligns values");
            assert_eq!(Array::read(&mut &file[..], 1 << 20).unwrap().text().unwrap(), text);
        }
    }
}
