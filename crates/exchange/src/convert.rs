//! Converts coefficients to and from the arrays of other packages.
//!
//! The canonical coefficients `a` have K rows, one per harmonic, and c columns, one per channel. For m > 0, the complex
//! coefficients are `c_lm = (-1)^m (a_lm - i a_l,-m) / sqrt2` and `c_l,-m = (-1)^m conj c_lm`
//! ([`Coefficients::to_complex`]). If a complex series doesn't represent a real function, the real part of the function
//! is used.
//!
//! Source: the packages' own definitions, as stated in `docs/exchange.md`; `python/spharm_rs/convert.py` has the same
//! formulas in NumPy.

use std::f64::consts::SQRT_2;

use ndarray::{Array2, Array3, Array4};
use num_complex::Complex64;
use spharm_harmonics::index::{basis_size, column, degree_order, first_column};
use spharm_harmonics::{Coefficients, HarmonicsError};

/// Returns (-1)^m.
pub(crate) fn phase(order: isize) -> f64 {
    if order % 2 == 0 { 1.0 } else { -1.0 }
}

/// Returns the row of a coefficient in a SPHARM-PDM file, and the factor by which the canonical coefficient is
/// multiplied. `row` is the coefficient's canonical row.
fn pdm(row: usize) -> (usize, f64) {
    let (degree, order) = degree_order(row);
    let at = match order {
        0 => 0,
        m if m > 0 => 2 * m.unsigned_abs() - 1,
        m => 2 * m.unsigned_abs(),
    };
    (first_column(degree) + at, if order == 0 { 1.0 } else { SQRT_2 * phase(order) })
}

/// Returns the rows of a SPHARM-PDM `.coef` file, a (K, c) array. Within a degree, order 0 comes first, followed by the
/// factors of Re Y and Im Y for each higher order.
#[must_use]
pub fn to_pdm(a: &Coefficients) -> Array2<f64> {
    let mut rows = Array2::zeros(a.values().raw_dim());
    for ((row, channel), value) in a.values().indexed_iter() {
        let (at, factor) = pdm(row);
        rows[[at, channel]] = value * factor;
    }
    rows
}

/// Converts the rows of a SPHARM-PDM `.coef` file, a (K, c) array, to canonical coefficients.
///
/// # Errors
///
/// [`NotABasisSize`](HarmonicsError::NotABasisSize) if K isn't (L + 1)^2 for any degree L.
pub fn from_pdm(rows: &Array2<f64>) -> Result<Coefficients, HarmonicsError> {
    Coefficients::new(rows.clone())?;
    Coefficients::new(Array2::from_shape_fn(rows.raw_dim(), |(row, channel)| {
        let (at, factor) = pdm(row);
        rows[[at, channel]] / factor
    }))
}

/// Returns the array `alm` of healpy and ducc0, of shape (c, (L + 1) (L + 2) / 2), whose columns are sorted by order.
/// Also returns the degree and order of each column.
#[must_use]
pub fn to_healpy(a: &Coefficients) -> (Array2<Complex64>, Vec<(usize, usize)>) {
    let complex = a.to_complex();
    let at: Vec<_> = (0..=a.max_degree()).flat_map(|m| (m..=a.max_degree()).map(move |l| (l, m))).collect();
    let alm = Array2::from_shape_fn((a.channels(), at.len()), |(channel, i)| {
        complex[[at.get(i).map_or(0, |&(l, m)| column(l, m.cast_signed())), channel]]
    });
    (alm, at)
}

/// Returns the canonical coefficients of a real function. `value(l, m)` returns its complex coefficient of degree l and
/// order m >= 0.
#[must_use]
pub fn from_orders(max_degree: usize, value: impl Fn(usize, usize) -> Complex64) -> Vec<f64> {
    let canonical = |row| {
        let (l, m) = degree_order(row);
        let c = value(l, m.unsigned_abs());
        match m {
            0 => c.re,
            m if m > 0 => SQRT_2 * phase(m) * c.re,
            m => -SQRT_2 * phase(m) * c.im,
        }
    };
    (0..basis_size(max_degree)).map(canonical).collect()
}

/// Returns s2fft's array `flm` of shape (c, L + 1, 2 L + 1), in which the orders begin at -L. s2fft's band limit is
/// `max_degree` + 1.
#[must_use]
pub fn to_s2fft(a: &Coefficients) -> Array3<Complex64> {
    let degree = a.max_degree();
    let mut flm = Array3::zeros((a.channels(), degree + 1, 2 * degree + 1));
    for ((row, channel), value) in a.to_complex().indexed_iter() {
        let (l, m) = degree_order(row);
        flm[[channel, l, degree.wrapping_add_signed(m)]] = *value;
    }
    flm
}

/// Converts s2fft's array `flm` of shape (c, L + 1, 2 L + 1) to canonical coefficients.
///
/// # Errors
///
/// [`NotABasisSize`](HarmonicsError::NotABasisSize) if the array has a different shape.
pub fn from_s2fft(flm: &Array3<Complex64>) -> Result<Coefficients, HarmonicsError> {
    let (channels, degrees, orders) = flm.dim();
    if degrees == 0 || orders != 2 * degrees - 1 {
        return Err(HarmonicsError::NotABasisSize { rows: orders });
    }
    let complex = Array2::from_shape_fn((degrees * degrees, channels), |(row, channel)| {
        let (l, m) = degree_order(row);
        flm[[channel, l, (degrees - 1).wrapping_add_signed(m)]]
    });
    Coefficients::from_complex(&complex)
}

/// Returns pyshtools' orthonormal coefficients with `csphase=1`, an array of shape (c, 2, L + 1, L + 1). The element
/// `[k, i, l, m]` belongs to channel k, degree l and order m, and i is 0 for cosines and 1 for sines.
#[must_use]
pub fn to_pyshtools(a: &Coefficients) -> Array4<f64> {
    let size = a.max_degree() + 1;
    let mut array = Array4::zeros((a.channels(), 2, size, size));
    for ((row, channel), value) in a.values().indexed_iter() {
        let (l, m) = degree_order(row);
        array[[channel, usize::from(m < 0), l, m.unsigned_abs()]] = *value;
    }
    array
}

/// Converts pyshtools' orthonormal coefficients with `csphase=1`, an array of shape (c, 2, L + 1, L + 1), to canonical
/// coefficients.
///
/// # Errors
///
/// [`NotABasisSize`](HarmonicsError::NotABasisSize) if the array has a different shape.
pub fn from_pyshtools(array: &Array4<f64>) -> Result<Coefficients, HarmonicsError> {
    let (channels, two, degrees, orders) = array.dim();
    if two != 2 || degrees != orders || degrees == 0 {
        return Err(HarmonicsError::NotABasisSize { rows: orders });
    }
    Coefficients::new(Array2::from_shape_fn((degrees * degrees, channels), |(row, channel)| {
        let (l, m) = degree_order(row);
        array[[channel, usize::from(m < 0), l, m.unsigned_abs()]]
    }))
}

/// Converts canonical coefficients, a (K, c) array, to FlowShape's coefficients, or back, by multiplying each
/// coefficient by (-1)^m.
#[must_use]
pub fn with_phase(values: &Array2<f64>) -> Array2<f64> {
    let mut found = values.clone();
    found.indexed_iter_mut().for_each(|((row, _), value)| *value *= phase(degree_order(row).1));
    found
}

/// Returns the matrix of weighted SPHARM for one channel, of shape (L + 1, 2 L + 1). Row l has the coefficients of the
/// cosines of orders 0 to l, then of the sines of orders 1 to l, then zeros.
///
/// The harmonics of weighted SPHARM use the azimuth plus pi, so each coefficient is multiplied by (-1)^m.
#[must_use]
pub fn to_beta(a: &Coefficients, channel: usize) -> Array2<f64> {
    let degree = a.max_degree();
    let mut beta = Array2::zeros((degree + 1, 2 * degree + 1));
    for (row, value) in a.values().column(channel).iter().enumerate() {
        let (l, m) = degree_order(row);
        beta[[l, beta_column(l, m)]] = value * phase(m);
    }
    beta
}

/// Converts the matrix of weighted SPHARM for one channel to canonical coefficients. Returns `None` unless the matrix
/// has L + 1 rows and at least 2 L + 1 columns.
#[must_use]
pub fn from_beta(beta: &Array2<f64>) -> Option<Vec<f64>> {
    let degrees = beta.nrows();
    (degrees > 0 && beta.ncols() >= 2 * degrees - 1).then(|| {
        let value = |row| {
            let (l, m) = degree_order(row);
            beta[[l, beta_column(l, m)]] * phase(m)
        };
        (0..degrees * degrees).map(value).collect()
    })
}

fn beta_column(degree: usize, order: isize) -> usize {
    if order < 0 { degree + order.unsigned_abs() } else { order.unsigned_abs() }
}
