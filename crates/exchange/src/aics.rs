//! Writes the coefficients of a body's radius under aics-shparam's names: `shcoeffs_L2M1C` is the coefficient of the
//! cosine of degree 2, order 1.
//!
//! aics-shparam expands the distance of the surface from its centre in pyshtools' default harmonics, normalised to 4
//! pi. The azimuth in these harmonics is phi plus pi, so each coefficient is multiplied by (-1)^m. aics-shparam's
//! function `get_even_reconstruction_from_coeffs` takes these coefficients as an array (2, L + 1, L + 1).

use std::io::{self, Write};

use spharm_harmonics::Coefficients;
use spharm_harmonics::index::column;

use crate::convert::phase;
use crate::format::Normalization;

/// Returns the names and values of the coefficients in aics-shparam's order: all cosines, then all sines. The cosines
/// and the sines are each sorted by degree, then by order from 0 to L. Coefficients of orders above the degree, and of
/// sines of order 0, are zero.
fn named(a: &Coefficients) -> Vec<(String, f64)> {
    let (factor, orders) = (Normalization::FourPi.factor(0, 0), 0..=a.max_degree());
    let value = |l: usize, m: usize, sine: bool| match m {
        m if m > l || (sine && m == 0) => 0.0,
        m => {
            let order = if sine { -m.cast_signed() } else { m.cast_signed() };
            factor * phase(order) * a.values()[[column(l, order), 0]]
        }
    };
    let place = |(sine, l)| orders.clone().map(move |m| (sine, l, m));
    let places = [false, true].into_iter().flat_map(|sine| orders.clone().map(move |l| (sine, l))).flat_map(place);
    let name = |sine, l, m| format!("shcoeffs_L{l}M{m}{}", if sine { 'S' } else { 'C' });
    places.map(|(sine, l, m)| (name(sine, l, m), value(l, m, sine))).collect()
}

/// Writes a JSON object with all names and values, in aics-shparam's order.
pub(crate) fn write_json(out: &mut dyn Write, a: &Coefficients) -> io::Result<()> {
    let named = named(a);
    writeln!(out, "{{")?;
    for (i, (name, value)) in named.iter().enumerate() {
        let comma = if i + 1 < named.len() { "," } else { "" };
        writeln!(out, "  \"{name}\": {value:?}{comma}")?;
    }
    writeln!(out, "}}")
}

/// Writes a line of names and a line of values, as CSV that pandas can read.
pub(crate) fn write_csv(out: &mut dyn Write, a: &Coefficients) -> io::Result<()> {
    let (names, values): (Vec<_>, Vec<_>) = named(a).into_iter().map(|(name, x)| (name, format!("{x:?}"))).unzip();
    writeln!(out, "{}\n{}", names.join(","), values.join(","))
}
