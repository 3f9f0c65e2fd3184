//! Unit vectors, at which harmonics are evaluated.
//!
//! Angles are always derived from the vector, with `atan2(hypot(x, y), z)` and `atan2(y, x)`, never with `acos`, which
//! loses half of the digits near the poles.

use rayon::prelude::*;

use crate::{HarmonicsError, duplicates};

/// An ordered list of unit vectors (n, 3).
///
/// Vectors are normalised once, when the list is created. If a sphere is scaled by a power of two, its vertices give
/// bit-identical directions. If the sphere is scaled by another factor, the directions change by rounding errors at
/// most.
#[derive(Debug, Clone, PartialEq)]
pub struct Directions {
    vectors: Vec<[f64; 3]>,
    radii: Radii,
}

/// Smallest and largest distance of the original vertices from the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radii {
    /// Smallest radius, in the unit of the vertices.
    pub min: f64,
    /// Largest radius, in the unit of the vertices.
    pub max: f64,
}

/// Number of vertices per parallel task.
const PART: usize = 1 << 13;

impl Radii {
    /// The empty range, the neutral element of `and`.
    const NONE: Self = Self { min: f64::INFINITY, max: 0.0 };

    /// Returns the smallest range that contains both ranges.
    fn and(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Returns `(max - min) / max`, which is 0 for a perfect sphere around the origin.
    pub fn spread(&self) -> f64 {
        (self.max - self.min) / self.max
    }
}

impl Directions {
    /// Computes the directions of `vertices` (n, 3), seen from the origin. The vertices may have any radii.
    ///
    /// # Errors
    ///
    /// - [`HarmonicsError::Empty`] if there are no vertices.
    /// - [`HarmonicsError::NotFinite`] if a coordinate is NaN or infinite.
    /// - [`HarmonicsError::AtOrigin`] if a vertex lies at the origin.
    pub fn from_vertices(vertices: &[[f64; 3]]) -> Result<Self, HarmonicsError> {
        if vertices.is_empty() {
            return Err(HarmonicsError::Empty);
        }
        let mut vectors = vec![[0.0; 3]; vertices.len()];
        let parts = vectors.chunks_mut(PART).zip(vertices.chunks(PART)).enumerate();
        let parts = parts.map(|(part, (units, vertices))| (part * PART, units, vertices));
        // Outside of a rayon pool, rayon would use its global pool, whose threads don't exist in a forked process.
        let radii: Result<Vec<Radii>, HarmonicsError> = if rayon::current_thread_index().is_some() {
            // Results are collected in the order of the vertices, so that the first error is the one reported.
            let parts: Vec<_> = parts.collect();
            let radii: Vec<_> =
                parts.into_par_iter().map(|(first, units, of)| normalise_all(first, units, of)).collect();
            radii.into_iter().collect()
        } else {
            parts.map(|(first, units, of)| normalise_all(first, units, of)).collect()
        };
        let radii = radii?.into_iter().fold(Radii::NONE, Radii::and);
        Ok(Self { vectors, radii })
    }

    /// Wraps unit vectors (n, 3) without changing a bit. Use this for directions that have been stored, for example in
    /// a model.
    ///
    /// # Errors
    ///
    /// The errors of [`from_vertices`](Self::from_vertices), and [`HarmonicsError::NotUnit`] if a squared length
    /// differs from 1 by more than 1e-9.
    pub fn from_unit_vectors(vectors: Vec<[f64; 3]>) -> Result<Self, HarmonicsError> {
        let checked = Self::from_vertices(&vectors)?;
        let off = |v: &[f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0).abs() > 1e-9;
        if let Some(index) = vectors.iter().position(off) {
            return Err(HarmonicsError::NotUnit { index, found: vectors[index] });
        }
        Ok(Self { vectors, radii: checked.radii })
    }

    /// Computes the directions of n pairs (colatitude, azimuth) in radians.
    ///
    /// # Errors
    ///
    /// - [`HarmonicsError::Empty`] if there are no angles.
    /// - [`HarmonicsError::NotFinite`] if an angle is NaN or infinite.
    pub fn from_angles(angles: &[[f64; 2]]) -> Result<Self, HarmonicsError> {
        let vertices: Vec<_> = angles
            .iter()
            .map(|&[theta, phi]| [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()])
            .collect();
        Self::from_vertices(&vertices)
    }

    /// Creates n directions spread evenly over the sphere, on a Fibonacci spiral.
    ///
    /// Direction i has `cos theta = 1 - (2 i + 1) / n` and azimuth `i pi (3 - sqrt 5)`, the golden angle times i. Each
    /// direction is at the middle of one of n bands of equal area, and no direction is at a pole. R. Swinbank and R. J.
    /// Purser, "Fibonacci grids: a novel approach to global modelling", Q. J. R. Meteorol. Soc. 132 (2006).
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::Empty`] if n is 0.
    ///
    /// ```
    /// use spharm_harmonics::Directions;
    ///
    /// let directions = Directions::fibonacci(1_000)?;
    /// let z: f64 = directions.as_slice().iter().map(|direction| direction[2]).sum();
    /// assert!(directions.len() == 1_000 && z.abs() < 1e-12);
    /// # Ok::<(), spharm_harmonics::HarmonicsError>(())
    /// ```
    pub fn fibonacci(n: usize) -> Result<Self, HarmonicsError> {
        let golden_angle = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let vertices: Vec<_> = (0..n)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / n as f64;
                let (u, phi) = ((1.0 - z * z).sqrt(), i as f64 * golden_angle);
                [u * phi.cos(), u * phi.sin(), z]
            })
            .collect();
        Self::from_vertices(&vertices)
    }

    /// Returns the number of directions, n.
    pub fn len(&self) -> usize {
        self.vectors.len()
    }

    /// Returns whether the list is empty, which is never the case.
    pub fn is_empty(&self) -> bool {
        self.vectors.is_empty()
    }

    /// Returns the unit vectors (n, 3).
    pub fn as_slice(&self) -> &[[f64; 3]] {
        &self.vectors
    }

    /// Returns the smallest and largest radius of the original vertices.
    pub fn radii(&self) -> Radii {
        self.radii
    }

    /// Returns the number of directions that repeat an earlier one, bit for bit. Cost: one pass over the directions
    /// by all threads of the caller's pool, and 9 bytes per direction.
    pub fn duplicates(&self) -> usize {
        duplicates::count(&self.vectors)
    }
}

/// Range of squared lengths of the vectors that are normalised without scaling. In this range, the squares of the
/// coordinates don't overflow, and squares that underflow are too small to change the sum.
const SAFE_SQUARES: std::ops::RangeInclusive<f64> = 1e-200..=1e200;

/// Normalises `vertices` into `units` and returns the range of their radii. `first` is the index of the first vertex,
/// which errors report.
fn normalise_all(first: usize, units: &mut [[f64; 3]], vertices: &[[f64; 3]]) -> Result<Radii, HarmonicsError> {
    let mut radii = Radii::NONE;
    for (offset, (unit, &vertex)) in units.iter_mut().zip(vertices).enumerate() {
        let (direction, radius) = normalise(vertex, first + offset)?;
        (*unit, radii) = (direction, radii.and(Radii { min: radius, max: radius }));
    }
    Ok(radii)
}

/// Returns the colatitude in `[0, pi]` and the azimuth in `[0, 2 pi)` of a vector of any length, in radians.
pub fn angles(direction: [f64; 3]) -> [f64; 2] {
    let [x, y, z] = direction;
    let phi = y.atan2(x);
    [x.hypot(y).atan2(z), if phi < 0.0 { phi + std::f64::consts::TAU } else { phi }]
}

/// Returns the direction of a vector, as a unit vector, and its length. `index` is the vector's position, which errors
/// report.
///
/// # Errors
///
/// - [`HarmonicsError::NotFinite`] if a coordinate is NaN or infinite.
/// - [`HarmonicsError::AtOrigin`] if the vector is zero.
pub fn normalise(vector: [f64; 3], index: usize) -> Result<([f64; 3], f64), HarmonicsError> {
    let squared = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
    // Adding 0.0 turns -0 into +0, so that equal points have equal bits.
    let divided = |vector: [f64; 3], norm: f64| vector.map(|c| c / norm + 0.0);
    let square = squared(vector);
    if SAFE_SQUARES.contains(&square) {
        let norm = square.sqrt();
        return Ok((divided(vector, norm), norm));
    }
    if vector.iter().any(|c| !c.is_finite()) {
        return Err(HarmonicsError::NotFinite { index, found: vector });
    }
    let largest = vector.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if largest == 0.0 {
        return Err(HarmonicsError::AtOrigin { index });
    }
    // The vector is scaled by a power of two, which is exact, so that the squares neither overflow nor underflow.
    let scale = power_of_two_near(largest);
    let scaled = vector.map(|c| c / scale);
    let norm = squared(scaled).sqrt();
    Ok((divided(scaled, norm), norm * scale))
}

fn power_of_two_near(value: f64) -> f64 {
    let exponent_bits = value.to_bits() & (0x7ff << 52);
    if exponent_bits == 0 { f64::MIN_POSITIVE } else { f64::from_bits(exponent_bits) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_radius_gives_the_unit_vector() {
        for radius in [1e-320, 1e-200, 1.0, 100.0, 1e200, 1.7e308] {
            let d = Directions::from_vertices(&[[0.0, -0.0, -radius], [radius / 2.0, 0.0, radius / 2.0]]).unwrap();
            assert_eq!(d.as_slice()[0].map(f64::to_bits), [0.0, 0.0, -1.0].map(f64::to_bits));
            let half = std::f64::consts::FRAC_1_SQRT_2;
            assert!((d.as_slice()[1][0] - half).abs() < 1e-15, "{radius}");
        }
    }

    #[test]
    fn scaling_by_powers_of_two_changes_no_bit() {
        for vector in [[0.3, -1.7e-3, 0.9], [1.0, 1e-20, -1e-17]] {
            let bits = |scale: f64| normalise(vector.map(|c| c * scale), 0).unwrap();
            let (unit, length) = bits(1.0);
            for exponent in [-900, -340, -330, 330, 340, 900] {
                let scale = 2f64.powi(exponent);
                assert_eq!(bits(scale), (unit, length * scale), "2^{exponent}");
            }
        }
    }

    #[test]
    fn what_has_no_direction_is_refused() {
        assert_eq!(Directions::from_vertices(&[]), Err(HarmonicsError::Empty));
        let origin = Directions::from_vertices(&[[1.0, 0.0, 0.0], [0.0, -0.0, 0.0]]);
        assert_eq!(origin, Err(HarmonicsError::AtOrigin { index: 1 }));
        for bad in [f64::NAN, f64::INFINITY] {
            let found = Directions::from_vertices(&[[1.0, bad, 0.0]]);
            assert!(matches!(found, Err(HarmonicsError::NotFinite { index: 0, .. })));
        }
    }

    #[test]
    fn duplicates_are_counted_and_the_sign_of_zero_does_not_matter() {
        let d = Directions::from_vertices(&[[1.0, 0.0, 0.0], [2.0, -0.0, 0.0], [0.0, 1.0, 0.0], [5.0, 0.0, 0.0]]);
        assert_eq!(d.unwrap().duplicates(), 2);
    }

    #[test]
    fn duplicates_are_counted_among_many_directions_and_by_any_number_of_threads() {
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let point = |i: usize| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / 30_000.0;
            let (sine, phi) = ((1.0 - z * z).sqrt(), golden * i as f64);
            [3.0 * sine * phi.cos(), 3.0 * sine * phi.sin(), 3.0 * z]
        };
        // Every seventh direction occurs twice, and one direction three times.
        let mut vertices: Vec<[f64; 3]> = (0..30_000).map(point).collect();
        vertices.extend((0..30_000).step_by(7).map(point));
        vertices.push(point(7));
        let alone = Directions::from_vertices(&vertices).unwrap();
        assert_eq!(alone.duplicates(), 30_000_usize.div_ceil(7) + 1);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let together = pool.install(|| Directions::from_vertices(&vertices)).unwrap();
        assert_eq!(alone, together);
        // The first of several errors is reported.
        (vertices[20_000], vertices[9_000]) = ([0.0; 3], [f64::NAN, 0.0, 0.0]);
        let error = pool.install(|| Directions::from_vertices(&vertices)).unwrap_err();
        assert!(matches!(error, HarmonicsError::NotFinite { index: 9_000, .. }));
    }

    /// Checks that each of ten slices of equal thickness along x contains a tenth of the directions, to within 8, and
    /// that no two directions are close. The counts of a random sample would be off by 13 or more.
    #[test]
    fn a_fibonacci_spiral_is_even() {
        let n = 2_000;
        let directions = Directions::fibonacci(n).unwrap();
        let mut bands = [0usize; 10];
        for direction in directions.as_slice() {
            bands[((direction[0] + 1.0) * 5.0).min(9.0) as usize] += 1;
        }
        assert!(bands.iter().all(|count| count.abs_diff(n / 10) <= 8), "{bands:?}");
        let spacing = (4.0 * std::f64::consts::PI / n as f64).sqrt();
        let distance = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        let vectors = directions.as_slice();
        for (i, a) in vectors.iter().enumerate() {
            let nearest = vectors[..i].iter().map(|b| distance(a, b)).fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.7 * spacing, "{i}: {nearest} of {spacing}");
        }
        assert_eq!(Directions::fibonacci(0), Err(HarmonicsError::Empty));
        assert_eq!(Directions::fibonacci(1).unwrap().as_slice(), [[1.0, 0.0, 0.0]]);
    }

    #[test]
    fn angles_keep_their_digits_at_the_pole() {
        let [theta, phi] = angles([3e-9, -4e-9, 1.0]);
        assert!((theta - 5e-9).abs() < 1e-23);
        assert!((phi - (std::f64::consts::TAU - (4.0f64 / 3.0).atan())).abs() < 1e-15);
    }
}
