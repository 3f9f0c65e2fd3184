//! Reads tables of samples in chunks: selects the columns for positions, weights and values, and checks that the values
//! are in their ranges.

#[cfg(feature = "tables")]
mod arrow;
#[cfg(feature = "tables")]
mod batches;
mod csv;
#[cfg(feature = "tables")]
mod ipc;
#[cfg(feature = "tables")]
mod las;
mod npy;
mod npz;
mod open;
#[cfg(feature = "tables")]
mod pages;
#[cfg(feature = "tables")]
mod parquet;
mod ply;
mod records;
mod signal;
mod table;

use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;
use spharm_harmonics::Directions;
use spharm_harmonics::directions::normalise;

use crate::MomentsError;
pub use crate::samples::open::ENDINGS;
pub(crate) use crate::samples::open::{Opened, STDIN, is_table, open, open_over_scheme};
use crate::samples::table::NULL;

/// Name of the channel that holds a sample's distance from the centre, if positions are given as vectors.
pub const RADIUS: &str = "radius";

/// Source of the samples' positions: columns of the table, or a sampling scheme.
#[derive(Debug, Clone, PartialEq)]
pub enum Positions {
    /// Columns of colatitude and azimuth, in radians.
    Angles([String; 2]),
    /// Columns of longitude and latitude, in degrees.
    LonLat([String; 2]),
    /// Columns of x, y and z. The vectors must have unit length, unless [`RADIUS`] is one of the values or a centre is
    /// given.
    Vectors([String; 3]),
    /// The directions of a sampling scheme, such as the vertices of a sphere: row i of each table has direction i.
    Scheme(Arc<Directions>),
}

impl Positions {
    /// Returns positions from columns with the usual names, in upper or lower case: x, y, z; lon, lat; or theta, phi.
    /// Returns `None` if no such columns exist.
    pub(crate) fn guess(columns: &[String]) -> Option<Self> {
        let found = |name: &str| columns.iter().find(|column| column.eq_ignore_ascii_case(name)).cloned();
        let first = |names: &[&str]| names.iter().find_map(|name| found(name));
        if let (Some(x), Some(y), Some(z)) = (found("x"), found("y"), found("z")) {
            return Some(Self::Vectors([x, y, z]));
        }
        if let (Some(lon), Some(lat)) = (first(&["lon", "longitude"]), first(&["lat", "latitude"])) {
            return Some(Self::LonLat([lon, lat]));
        }
        Some(Self::Angles([found("theta")?, found("phi")?]))
    }

    fn names(&self) -> &[String] {
        match self {
            Self::Angles(names) | Self::LonLat(names) => names,
            Self::Vectors(names) => names,
            Self::Scheme(_) => &[],
        }
    }
}

/// Names of a table's columns for positions, values and weights.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Columns {
    /// Positions of the samples; by default the columns x, y, z, or lon, lat, or theta, phi, whichever exist.
    pub positions: Option<Positions>,
    /// Columns of values, one channel each. The name [`RADIUS`] denotes the distance from the centre.
    pub values: Vec<String>,
    /// Column of weights; by default all weights are 1.
    pub weight: Option<String>,
    /// Centre that is subtracted from positions given as vectors; by default the origin.
    pub centre: [f64; 3],
}

/// Indices of the position, values and weight in the rows that a table returns.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    positions: Positions,
    /// For each channel, the index of its value in the row; `None` for the radius.
    values: Vec<Option<usize>>,
    weight: Option<usize>,
    centre: [f64; 3],
    /// Names of the columns that are read, in the order of the values in a row.
    names: Vec<String>,
}

/// A chunk of converted samples.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    pub(crate) directions: Vec<[f64; 3]>,
    pub(crate) weights: Option<Vec<f64>>,
    pub(crate) values: Array2<f64>,
    /// Largest absolute longitude and largest absolute latitude, in degrees.
    pub(crate) largest: [f64; 2],
}

/// An invalid row, given by its index within its chunk, from 0.
#[derive(Debug)]
pub(crate) struct BadRow {
    pub(crate) row: usize,
    pub(crate) column: String,
    pub(crate) expected: &'static str,
    pub(crate) found: String,
}

impl Columns {
    /// Determines which columns of a table to read. Returns the plan, and the indices of these columns in the order in
    /// which their values appear in a row.
    pub(crate) fn plan(&self, path: &std::path::Path, there: &[String]) -> Result<(Plan, Vec<usize>), MomentsError> {
        let unclear = |problem| MomentsError::Columns { path: path.to_owned(), problem, there: there.to_vec() };
        let positions = match &self.positions {
            Some(positions) => positions.clone(),
            None => Positions::guess(there).ok_or_else(|| {
                unclear("name the columns of the positions: there are no columns x, y, z or lon, lat or theta, phi")
            })?,
        };
        if self.values.is_empty() {
            return Err(unclear("no column is given for the values; name at least one"));
        }
        let vectors = matches!(positions, Positions::Vectors(_));
        if !vectors
            && (self.values.iter().any(|name| name == RADIUS && !there.contains(name)) || self.centre != [0.0; 3])
        {
            return Err(unclear("the value `radius` and a centre require positions as vectors (x, y, z)"));
        }
        let (mut names, mut numbers) = (Vec::new(), Vec::new());
        let mut place = |name: &String| -> Result<usize, MomentsError> {
            if let Some(place) = names.iter().position(|known| known == name) {
                return Ok(place);
            }
            let missing =
                || MomentsError::NoColumn { path: path.to_owned(), wanted: name.clone(), there: there.to_vec() };
            let mut found = (0..there.len()).filter(|&column| there[column] == *name);
            let first = found.next().ok_or_else(missing)?;
            if let Some(second) = found.next() {
                return Err(MomentsError::ColumnTwice {
                    path: path.to_owned(),
                    column: name.clone(),
                    places: [first + 1, second + 1],
                });
            }
            numbers.push(first);
            names.push(name.clone());
            Ok(names.len() - 1)
        };
        let named = positions.names();
        if (1..named.len()).any(|i| named[..i].contains(&named[i])) {
            return Err(unclear("one column is given twice for the positions; give each coordinate its own column"));
        }
        // The columns of the position are added first, because a row begins with its position.
        for name in positions.names() {
            place(name)?;
        }
        let is_radius = |name: &String| vectors && name == RADIUS && !there.contains(name);
        let values = self.values.iter().map(|name| if is_radius(name) { Ok(None) } else { place(name).map(Some) });
        let values = values.collect::<Result<_, _>>()?;
        let weight = self.weight.as_ref().map(&mut place).transpose()?;
        Ok((Plan { positions, values, weight, centre: self.centre, names }, numbers))
    }
}

/// Number of samples that one thread converts at a time.
const PIECE: usize = 1 << 13;

impl Plan {
    /// Returns the number of values in a row.
    pub(crate) fn columns(&self) -> usize {
        self.names.len()
    }

    /// Converts rows to samples, and checks them. `start` is the index, from 0, of the first row within its table. If
    /// positions are given by a sampling scheme, the scheme must have a direction for each row.
    pub(crate) fn samples(&self, rows: &[f64], start: usize, chunk: &mut Chunk) -> Result<(), BadRow> {
        let (columns, channels) = (self.columns(), self.values.len());
        let n = rows.len() / columns;
        chunk.directions.resize(n, [0.0; 3]);
        let mut values = std::mem::take(&mut chunk.values).into_raw_vec_and_offset().0;
        values.resize(n * channels, 0.0);
        let mut weights = chunk.weights.take().unwrap_or_default();
        weights.resize(if self.weight.is_some() { n } else { 0 }, 0.0);
        // If the samples have no weights, each piece of samples is paired with an empty piece of weights.
        let piece_of_weights = if self.weight.is_some() { PIECE } else { 0 };
        let mut rest = &mut weights[..];
        let mut weight_pieces = Vec::new();
        for _ in 0..n.div_ceil(PIECE) {
            let (piece, tail) = rest.split_at_mut(piece_of_weights.min(rest.len()));
            weight_pieces.push(piece);
            rest = tail;
        }
        let found: Vec<Result<[f64; 2], BadRow>> = chunk
            .directions
            .par_chunks_mut(PIECE)
            .zip(values.par_chunks_mut(PIECE * channels))
            .zip(weight_pieces)
            .enumerate()
            .map(|(piece, ((directions, values), weights))| {
                let first = piece * PIECE;
                let rows = &rows[first * columns..(first + directions.len()) * columns];
                let piece = self.piece(rows, start + first, directions, values, weights);
                piece.map_err(|bad| BadRow { row: bad.row + first, ..bad })
            })
            .collect();
        chunk.values = Array2::from_shape_vec((n, channels), values).unwrap_or_default();
        chunk.weights = self.weight.map(|_| weights);
        for largest in found {
            let largest = largest?;
            chunk.largest = [chunk.largest[0].max(largest[0]), chunk.largest[1].max(largest[1])];
        }
        Ok(())
    }

    fn piece(
        &self,
        rows: &[f64],
        start: usize,
        directions: &mut [[f64; 3]],
        values: &mut [f64],
        weights: &mut [f64],
    ) -> Result<[f64; 2], BadRow> {
        let channels = self.values.len();
        let needs_unit = !self.values.contains(&None) && self.centre == [0.0; 3];
        let mut largest = [0.0f64; 2];
        for (row, (cells, direction)) in rows.chunks_exact(self.columns()).zip(directions).enumerate() {
            let bad = |column: usize, expected| BadRow {
                row,
                column: self.names[column].clone(),
                expected,
                found: shown(cells[column]),
            };
            if let Some(column) = cells.iter().position(|cell| !cell.is_finite()) {
                return Err(bad(column, "a finite number"));
            }
            let mut radius = 1.0;
            *direction = match &self.positions {
                Positions::Scheme(directions) => directions.as_slice()[start + row],
                Positions::Angles(_) => {
                    if !(0.0..=MOST_THETA).contains(&cells[0]) {
                        return Err(bad(0, "a colatitude from 0 to pi, in radians"));
                    }
                    if cells[1].abs() > MOST_PHI {
                        return Err(bad(1, "an azimuth from -2 pi to 2 pi, in radians"));
                    }
                    let ((s, c), (sine, cosine)) = (cells[0].sin_cos(), cells[1].sin_cos());
                    [s * cosine, s * sine, c]
                }
                Positions::LonLat(_) => {
                    if cells[0].abs() > 360.0 {
                        return Err(bad(0, "a longitude from -360 to 360, in degrees"));
                    }
                    if cells[1].abs() > 90.0 {
                        return Err(bad(1, "a latitude from -90 to 90, in degrees"));
                    }
                    largest = [largest[0].max(cells[0].abs()), largest[1].max(cells[1].abs())];
                    let ((s, c), (sine, cosine)) = (cells[1].to_radians().sin_cos(), cells[0].to_radians().sin_cos());
                    [c * cosine, c * sine, s]
                }
                Positions::Vectors(_) => {
                    let vector = [0, 1, 2].map(|i| cells[i] - self.centre[i]);
                    let Some((unit, length)) = unit(vector) else {
                        return Err(bad(0, "a vector that isn't zero"));
                    };
                    if needs_unit && (length - 1.0).abs() > UNIT {
                        let found = format!("length {length}");
                        // A column called `radius` takes precedence over the lengths.
                        let expected = if self.names.iter().any(|name| name == RADIUS) {
                            "a unit vector (the value `radius` is the table's own column; rename it to use the lengths \
                             of the vectors)"
                        } else {
                            "a unit vector (give the value `radius` to use the lengths of the vectors)"
                        };
                        return Err(BadRow { found, ..bad(0, expected) });
                    }
                    radius = length;
                    unit
                }
            };
            for (value, place) in values[row * channels..(row + 1) * channels].iter_mut().zip(&self.values) {
                *value = place.map_or(radius, |place| cells[place]);
            }
            if let Some(place) = self.weight {
                if cells[place] < 0.0 {
                    return Err(bad(place, "a weight of at least 0"));
                }
                weights[row] = cells[place];
            }
        }
        Ok(largest)
    }
}

fn shown(value: f64) -> String {
    if value.to_bits() == NULL.to_bits() { "null".to_owned() } else { value.to_string() }
}

/// Returns the direction and the length of a vector; `None` if the vector is zero or not finite. The result has the
/// same bits as the result of [`normalise`], which scales every vector to prevent overflow and underflow of its
/// squares.
#[inline]
fn unit(vector: [f64; 3]) -> Option<([f64; 3], f64)> {
    let [x, y, z] = vector;
    let square = x * x + y * y + z * z;
    if (1e-200..1e200).contains(&square) {
        let length = square.sqrt();
        return Some((vector.map(|c| c / length + 0.0), length));
    }
    normalise(vector, 0).ok()
}

/// Largest accepted colatitude: pi, with a margin for values rounded to single precision.
const MOST_THETA: f64 = std::f64::consts::PI + 1e-6;
/// Largest accepted absolute azimuth: 2 pi, with the same margin.
const MOST_PHI: f64 = std::f64::consts::TAU + 1e-6;
/// Largest accepted deviation of a unit vector's length from 1. This tolerance allows for values that have single
/// precision or few digits.
const UNIT: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_vector_has_the_same_bits_whatever_the_length() {
        for i in 0..1000 {
            let vector = [0.1, 0.7, 1.3].map(|step| (f64::from(i) * step).sin());
            let expected = normalise(vector, 0).map(|(unit, _)| unit.map(f64::to_bits)).ok();
            for exponent in [-900, -300, -1, 0, 3, 300, 900] {
                let scaled = vector.map(|c| c * 2f64.powi(exponent));
                assert_eq!(unit(scaled).map(|(unit, _)| unit.map(f64::to_bits)), expected, "{vector:?} 2^{exponent}");
            }
        }
    }
}
