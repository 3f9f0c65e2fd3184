//! Reads and writes the NumPy array files (`.npy`) in which models and other packages store coefficients.
//!
//! Versions 1 to 3 of the format can be read, in either byte order, and in C or Fortran order. The values may be real
//! numbers of 32 or 64 bits, complex numbers of 64 or 128 bits, or text in UCS-4. Declared sizes are checked against
//! the bytes present before memory is allocated.
//!
//! Source: NumPy Enhancement Proposal 1, and `numpy.lib.format`.

use std::io::{self, Read, Write};

use ndarray::{Array2, ArrayD, ArrayViewD, IxDyn, ShapeBuilder};
use num_complex::Complex64;
use spharm_surface::io::check_room;
use spharm_surface::npy::{Header, MAGIC};

/// Description of a problem with an array file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NpyError(String);

/// An array read from a file.
#[derive(Debug, Clone)]
pub struct Array {
    header: Header,
    bytes: Vec<u8>,
}

impl Array {
    /// Parses the bytes of a file that contains exactly one array.
    ///
    /// # Errors
    ///
    /// [`NpyError`] if the bytes aren't exactly one array, for example if the shape doesn't match the number of bytes.
    pub fn from_bytes(mut bytes: &[u8]) -> Result<Self, NpyError> {
        let most = bytes.len() as u64;
        Self::read(&mut bytes, most).map_err(NpyError)
    }

    /// Returns the lengths of the axes.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.header.shape
    }

    /// Returns whether the values are complex.
    #[must_use]
    pub fn is_complex(&self) -> bool {
        self.header.kind == 'c'
    }

    /// Returns the values as complex numbers, in an array of the same shape.
    ///
    /// # Errors
    ///
    /// [`NpyError`] if the values aren't numbers of a supported type.
    pub fn complex(&self) -> Result<ArrayD<Complex64>, NpyError> {
        let numbers = self.numbers().map_err(NpyError)?;
        let values = if self.is_complex() {
            numbers.as_chunks().0.iter().map(|&[re, im]| Complex64::new(re, im)).collect()
        } else {
            numbers.into_iter().map(Complex64::from).collect()
        };
        let array = ArrayD::from_shape_vec(IxDyn(&self.header.shape).set_f(self.header.fortran), values);
        Ok(array.map_err(|error| NpyError(error.to_string()))?.as_standard_layout().into_owned())
    }

    /// Reads an array. Fails if its values take more than `most` bytes.
    pub(crate) fn read(input: &mut dyn Read, most: u64) -> Result<Self, String> {
        let header = Header::read(input).map_err(|error| error.to_string())?;
        let count = header.bytes().ok_or("a shape with more values than any file can hold")?;
        if count > most {
            return Err(format!("a shape that needs {count} bytes of values, but the file can hold at most {most}"));
        }
        // Check that memory suffices for the bytes of the file, for the parsed numbers, and for the numbers in row
        // order. Complex numbers also need memory for their real and imaginary parts.
        let each = if header.kind == 'c' { 48 } else { 16 };
        let numbers = header.count().map_or(u64::MAX, |values| values.saturating_mul(each));
        check_room(count.saturating_add(numbers)).map_err(|room| format!("the values need {room}"))?;
        let mut bytes = Vec::new();
        // Try to read one byte beyond the values: this reaches the end of the entry, at which the archive's checksum is
        // verified.
        input.take(count + 1).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
        if bytes.len() as u64 != count {
            return Err("a shape that doesn't match the length of the file".to_owned());
        }
        Ok(Self { header, bytes })
    }

    /// Returns all values as f64, in the order of the file.
    fn numbers(&self) -> Result<Vec<f64>, String> {
        fn all<const N: usize>(array: &Array, number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
            let in_order = |mut bytes: [u8; N]| {
                if !array.header.little {
                    bytes.reverse();
                }
                number(bytes)
            };
            array.bytes.as_chunks().0.iter().copied().map(in_order).collect()
        }
        // A complex number is stored as two real numbers, the real part first.
        Ok(match (self.header.kind, self.header.size) {
            ('c', 16) => all(self, f64::from_le_bytes),
            ('c', 8) => all(self, |b| f32::from_le_bytes(b).into()),
            ('f', 8) => all(self, f64::from_le_bytes),
            ('f', 4) => all(self, |b| f32::from_le_bytes(b).into()),
            ('i', 4) => all(self, |b| i32::from_le_bytes(b).into()),
            ('u', 4) => all(self, |b| u32::from_le_bytes(b).into()),
            ('i', 8) => all(self, |b| i64::from_le_bytes(b) as f64),
            ('u', 8) => all(self, |b| u64::from_le_bytes(b) as f64),
            (kind, size) => return Err(format!("values of type {kind}{size}; expected numbers of 32 or 64 bits")),
        })
    }

    /// Returns the array as a matrix. A vector becomes a matrix of one column.
    pub(crate) fn matrix(&self) -> Result<Array2<f64>, String> {
        if self.is_complex() {
            return Err("complex values; expected real ones".to_owned());
        }
        let dimensions = match self.header.shape[..] {
            [rows] => (rows, 1),
            [rows, columns] => (rows, columns),
            _ => return Err(format!("shape {:?}; expected two dimensions", self.header.shape)),
        };
        let matrix = Array2::from_shape_vec(dimensions.set_f(self.header.fortran), self.numbers()?);
        Ok(matrix.map_err(|error| error.to_string())?.as_standard_layout().into_owned())
    }

    /// Returns the value of an array that has exactly one element.
    pub(crate) fn scalar(&self) -> Result<f64, String> {
        match self.numbers()?[..] {
            [value] => Ok(value),
            ref values => Err(format!("{} values; expected one", values.len())),
        }
    }

    /// Returns the string in an array that has exactly one element.
    pub(crate) fn text(&self) -> Result<String, String> {
        if self.header.kind != 'U' || self.header.count() != Some(1) {
            return Err("expected text".to_owned());
        }
        let code = |&bytes: &[u8; 4]| {
            char::from_u32(if self.header.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
        };
        let text: Option<String> = self.bytes.as_chunks().0.iter().map(code).collect();
        Ok(text.ok_or("expected text")?.trim_end_matches('\0').to_owned())
    }
}

/// Writes an array of real numbers as a file, in C order.
///
/// # Errors
///
/// The errors of `out`.
pub fn write_real(out: &mut dyn Write, array: &ArrayViewD<'_, f64>) -> io::Result<()> {
    write_header(out, "<f8", &tuple(array.shape()))?;
    array.iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))
}

/// Writes an array of complex numbers as a file, in C order.
///
/// # Errors
///
/// The errors of `out`.
pub fn write_complex(out: &mut dyn Write, array: &ArrayViewD<'_, Complex64>) -> io::Result<()> {
    write_header(out, "<c16", &tuple(array.shape()))?;
    array.iter().flat_map(|x| [x.re, x.im]).try_for_each(|x| out.write_all(&x.to_le_bytes()))
}

/// Formats a shape as a Python tuple.
fn tuple(shape: &[usize]) -> String {
    let lengths: String = shape.iter().map(|n| format!("{n},")).collect();
    format!("({lengths})")
}

/// Writes the header of an array file in version 1 of the format.
pub(crate) fn write_header(out: &mut dyn Write, descr: &str, shape: &str) -> io::Result<()> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Pad the header so that the values start at a multiple of 64 bytes. The header ends with a newline.
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

/// Writes a string as NumPy stores `numpy.array("text")`: in UCS-4, as an array of shape ().
pub(crate) fn write_text(out: &mut dyn Write, text: &str) -> io::Result<()> {
    // NumPy doesn't support strings of length 0, so an empty string is stored as one null character.
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
    fn arrays_of_any_shape_return() {
        let real = ArrayD::from_shape_fn(IxDyn(&[2, 3, 4]), |i| (i[0] * 12 + i[1] * 4 + i[2]) as f64);
        let complex = real.mapv(|x| Complex64::new(x, -0.5 * x));
        let mut file = Vec::new();
        write_complex(&mut file, &complex.view()).unwrap();
        let array = Array::from_bytes(&file).unwrap();
        assert!(array.is_complex() && array.matrix().is_err());
        assert_eq!((array.shape(), array.complex().unwrap()), (&[2, 3, 4][..], complex));
        assert!(Array::from_bytes(&file[..file.len() - 1]).is_err());
        file.clear();
        write_real(&mut file, &real.view()).unwrap();
        assert_eq!(Array::from_bytes(&file).unwrap().complex().unwrap(), real.mapv(Complex64::from));
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
