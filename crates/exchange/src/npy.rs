//! Reads and writes the arrays of s2fft, ktch, FlowShape and pyshtools as NumPy files.

use std::io::{self, Write};

use ndarray::{Array2, Array3, ArrayD, Axis, Ix2, Ix3, Ix4};
use num_complex::Complex64;
use spharm_harmonics::Coefficients;
use spharm_model::npy::{Array, write_complex, write_real};

use crate::convert::{from_pyshtools, from_s2fft, to_s2fft, with_phase};
use crate::flaw::Flaw;
use crate::format::{Format, Normalization};

pub(crate) fn write(out: &mut dyn Write, a: &Coefficients, format: Format) -> io::Result<()> {
    match format {
        Format::S2fft => write_complex(out, &to_s2fft(a).view().into_dyn()),
        Format::Flowshape => write_real(out, &with_phase(a.values()).view().into_dyn()),
        _ => write_real(out, &a.values().t().view().into_dyn()),
    }
}

/// Returns whether bytes begin like a NumPy array file.
pub(crate) fn is_npy(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x93NUMPY")
}

/// Determines which package's array this is from its shape and type. If they fit no package's array, or several,
/// returns a description of the array.
pub(crate) fn format_of(bytes: &[u8]) -> Result<Format, String> {
    let array = Array::from_bytes(bytes).map_err(|error| error.to_string())?;
    match *array.shape() {
        [.., degrees, orders] if array.is_complex() && orders + 1 == 2 * degrees => Ok(Format::S2fft),
        [2, l, m] | [_, 2, l, m] if !array.is_complex() && l == m => Ok(Format::Pyshtools),
        ref shape => {
            let kind = if array.is_complex() { "complex" } else { "real" };
            Err(format!("a {kind} array of shape {shape:?}"))
        }
    }
}

pub(crate) fn read(bytes: &[u8], format: Format, normalization: Normalization) -> Result<Coefficients, Flaw> {
    let array = Array::from_bytes(bytes).map_err(|error| Flaw::new("a NumPy array", error))?;
    let values = array.complex().map_err(|error| Flaw::new("an array of numbers", error))?;
    let shape = format!("shape {:?}", array.shape());
    let real = |array: ArrayD<Complex64>| array.mapv(|c| c.re);
    let wrong = |expected: &str| Flaw::new(expected, &shape);
    if array.is_complex() && format != Format::S2fft {
        return Err(Flaw::new("real numbers", "complex numbers"));
    }
    let matrix = || -> Option<Array2<f64>> { real(values.clone()).into_dimensionality::<Ix2>().ok() };
    match format {
        Format::S2fft => {
            let values = if values.ndim() == 2 { values.insert_axis(Axis(0)) } else { values };
            let flm: Option<Array3<Complex64>> = values.into_dimensionality::<Ix3>().ok();
            flm.and_then(|flm| from_s2fft(&flm).ok()).ok_or_else(|| wrong("shape (c, L + 1, 2 L + 1)"))
        }
        Format::Pyshtools => {
            let values = if values.ndim() == 3 { values.insert_axis(Axis(0)) } else { values };
            let mut array = real(values).into_dimensionality::<Ix4>().ok();
            for ((_, _, l, m), x) in array.iter_mut().flat_map(|array| array.indexed_iter_mut()) {
                // Values of orders above the degree are ignored.
                *x /= if m <= l { normalization.factor(l, m) } else { 1.0 };
            }
            array.and_then(|array| from_pyshtools(&array).ok()).ok_or_else(|| wrong("shape (c, 2, L + 1, L + 1)"))
        }
        Format::Flowshape => {
            let found = matrix().and_then(|matrix| Coefficients::new(with_phase(&matrix)).ok());
            found.ok_or_else(|| wrong("shape ((L + 1)^2, c)"))
        }
        _ => {
            // A ktch file may also contain all channels one after another, in a vector or in a single row.
            let flat = values.ndim() == 1 || values.shape().first() == Some(&1);
            let rows = if flat && values.len() % 3 == 0 && square(values.len() / 3) { 3 } else { 1 };
            let found = if flat {
                let all: Vec<f64> = real(values.clone()).iter().copied().collect();
                Array2::from_shape_vec((rows, all.len() / rows), all).ok()
            } else {
                matrix()
            };
            let found = found.and_then(|matrix| Coefficients::new(matrix.t().as_standard_layout().into_owned()).ok());
            found.ok_or_else(|| wrong("shape (c, (L + 1)^2)"))
        }
    }
}

fn square(count: usize) -> bool {
    count.isqrt().pow(2) == count
}
