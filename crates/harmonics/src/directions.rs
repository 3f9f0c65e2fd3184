//! Unit vectors, the points at which harmonics are evaluated.
//!
//! Angles are always derived from the vector, with `atan2(hypot(x, y), z)` and `atan2(y, x)`, never by `acos`, which
//! loses half of the digits near the poles.

use crate::HarmonicsError;

/// An ordered list of unit vectors, (n, 3).
///
/// Each is normalised once, on the way in, so that equal lists have equal bits whatever the radius they came from was
/// (a power of two apart; other radii agree to rounding).
#[derive(Debug, Clone, PartialEq)]
pub struct Directions {
    vectors: Vec<[f64; 3]>,
    radii: Radii,
}

/// Smallest and largest distance from the origin of the vertices that directions were made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radii {
    /// Smallest radius, in the input's unit.
    pub min: f64,
    /// Largest radius, in the input's unit.
    pub max: f64,
}

impl Radii {
    /// `(max - min) / max`.
    pub fn spread(&self) -> f64 {
        (self.max - self.min) / self.max
    }
}

impl Directions {
    /// Directions of vertices seen from the origin; any radius.
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::Empty`], [`HarmonicsError::NotFinite`], [`HarmonicsError::AtOrigin`].
    pub fn from_vertices(vertices: &[[f64; 3]]) -> Result<Self, HarmonicsError> {
        if vertices.is_empty() {
            return Err(HarmonicsError::Empty);
        }
        let mut radii = Radii { min: f64::INFINITY, max: 0.0 };
        let mut vectors = Vec::with_capacity(vertices.len());
        for (index, &vertex) in vertices.iter().enumerate() {
            let (unit, radius) = normalise(vertex, index)?;
            radii.min = radii.min.min(radius);
            radii.max = radii.max.max(radius);
            vectors.push(unit);
        }
        Ok(Self { vectors, radii })
    }

    /// Takes vectors that are directions already, bit for bit: what a model or a cache has kept.
    ///
    /// # Errors
    ///
    /// As for [`from_vertices`](Self::from_vertices); [`HarmonicsError::NotUnit`] for a length that isn't 1 to 1e-9.
    pub fn from_unit_vectors(vectors: Vec<[f64; 3]>) -> Result<Self, HarmonicsError> {
        let checked = Self::from_vertices(&vectors)?;
        let off = |v: &[f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0).abs() > 1e-9;
        if let Some(index) = vectors.iter().position(off) {
            return Err(HarmonicsError::NotUnit { index, found: vectors[index] });
        }
        Ok(Self { vectors, radii: checked.radii })
    }

    /// Directions of (colatitude, azimuth) pairs, in radians.
    ///
    /// # Errors
    ///
    /// [`HarmonicsError::Empty`], [`HarmonicsError::NotFinite`].
    pub fn from_angles(angles: &[[f64; 2]]) -> Result<Self, HarmonicsError> {
        let vertices: Vec<_> = angles
            .iter()
            .map(|&[theta, phi]| [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()])
            .collect();
        Self::from_vertices(&vertices)
    }

    /// Number of directions, n.
    pub fn len(&self) -> usize {
        self.vectors.len()
    }

    /// Never true: a list has at least one direction.
    pub fn is_empty(&self) -> bool {
        self.vectors.is_empty()
    }

    /// The unit vectors, (n, 3).
    pub fn as_slice(&self) -> &[[f64; 3]] {
        &self.vectors
    }

    /// Radii of the vertices that the directions were made from.
    pub fn radii(&self) -> Radii {
        self.radii
    }

    /// How many directions repeat an earlier one, bit for bit.
    pub fn duplicates(&self) -> usize {
        let mut keys: Vec<[u64; 3]> = self.vectors.iter().map(|v| v.map(|c| (c + 0.0).to_bits())).collect();
        keys.sort_unstable();
        keys.windows(2).filter(|pair| pair[0] == pair[1]).count()
    }
}

/// Colatitude and azimuth in radians of a vector; azimuth in `[0, 2 pi)`.
pub fn angles(direction: [f64; 3]) -> [f64; 2] {
    let [x, y, z] = direction;
    let phi = y.atan2(x);
    [x.hypot(y).atan2(z), if phi < 0.0 { phi + std::f64::consts::TAU } else { phi }]
}

fn normalise(vector: [f64; 3], index: usize) -> Result<([f64; 3], f64), HarmonicsError> {
    if vector.iter().any(|c| !c.is_finite()) {
        return Err(HarmonicsError::NotFinite { index, found: vector });
    }
    let largest = vector.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if largest == 0.0 {
        return Err(HarmonicsError::AtOrigin { index });
    }
    // Scaling by a power of two first: exact, and the squares neither overflow nor underflow.
    let scale = power_of_two_near(largest);
    let scaled = vector.map(|c| c / scale);
    let norm = (scaled[0] * scaled[0] + scaled[1] * scaled[1] + scaled[2] * scaled[2]).sqrt();
    // + 0.0 makes -0 into +0, so that equal points have equal bits.
    Ok((scaled.map(|c| c / norm + 0.0), norm * scale))
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
    fn angles_keep_their_digits_at_the_pole() {
        let [theta, phi] = angles([3e-9, -4e-9, 1.0]);
        assert!((theta - 5e-9).abs() < 1e-23);
        assert!((phi - (std::f64::consts::TAU - (4.0f64 / 3.0).atan())).abs() < 1e-15);
    }
}
