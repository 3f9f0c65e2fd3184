//! Defines the identity of a factor (scheme, degree, weights and smoothness) and its file name.

use std::fmt;

use crate::scheme::{Scalar, SchemeKey};

const WEIGHTS_CONTEXT: &str = "spharm-rs 2026-11 factor weights v1";
const NAME_CONTEXT: &str = "spharm-rs 2026-11 factor name v1";

/// Hash of the weights of the directions; 32 zero bytes if all weights are 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct WeightsHash(pub [u8; 32]);

impl WeightsHash {
    /// Hash of weights that are all 1.
    pub const ONES: Self = Self([0; 32]);

    /// Computes the hash of weights (n); `None` means that all weights are 1.
    pub fn of(weights: Option<&[f64]>) -> Self {
        let Some(weights) = weights.filter(|weights| weights.iter().any(|&weight| weight != 1.0)) else {
            return Self::ONES;
        };
        let mut hasher = blake3::Hasher::new_derive_key(WEIGHTS_CONTEXT);
        hasher.update(&(weights.len() as u64).to_le_bytes());
        for weight in weights {
            // Adding 0 turns -0 into +0.
            hasher.update(&(weight + 0.0).to_bits().to_le_bytes());
        }
        Self(*hasher.finalize().as_bytes())
    }
}

impl fmt::Display for WeightsHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::ONES {
            return f.write_str("ones");
        }
        self.0[..6].iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Identity of a factor: all data on which the factor's values depend, except the scalar type.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FactorSpec {
    /// Key of the sampling scheme. The factor's file is in the scheme's folder.
    pub key: SchemeKey,
    /// Number of directions, n.
    pub rows: usize,
    /// Highest degree, L.
    pub max_degree: usize,
    /// Hash of the weights of the directions.
    pub weights: WeightsHash,
    /// Smoothness lambda, the weight of the penalty `lambda sum (l (l + 1))^2 c^2`; 0 for no penalty.
    pub smoothness: f64,
}

impl FactorSpec {
    /// Returns the number of columns, K = (L + 1)^2.
    pub fn size(&self) -> usize {
        spharm_harmonics::basis_size(self.max_degree)
    }

    /// Returns the file name of the factor, such as `factor_100_f64_1f0e5a77`.
    pub fn file_name(&self, scalar: Scalar) -> String {
        let mut hasher = blake3::Hasher::new_derive_key(NAME_CONTEXT);
        hasher.update(&self.weights.0);
        hasher.update(&(self.smoothness + 0.0).to_bits().to_le_bytes());
        let hash = hasher.finalize().to_hex();
        format!("factor_{}_{}_{}", self.max_degree, scalar.name(), &hash[..8])
    }
}

impl fmt::Display for FactorSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "degree {}, weights {}, smoothness {}", self.max_degree, self.weights, self.smoothness)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ones_are_ones_however_they_are_given() {
        assert_eq!(WeightsHash::of(None), WeightsHash::ONES);
        assert_eq!(WeightsHash::of(Some(&[1.0; 9])), WeightsHash::ONES);
        let half = WeightsHash::of(Some(&[1.0, 0.5]));
        assert_ne!(half, WeightsHash::ONES);
        assert_ne!(half, WeightsHash::of(Some(&[0.5, 1.0])));
        assert_eq!(WeightsHash::of(Some(&[0.0, 1.0])), WeightsHash::of(Some(&[-0.0, 1.0])));
    }

    #[test]
    fn weights_are_shown_by_their_first_digits() {
        assert_eq!(WeightsHash::ONES.to_string(), "ones");
        assert_eq!(WeightsHash([0xab; 32]).to_string(), "abababababab");
    }

    #[test]
    fn names_tell_factors_apart() {
        let spec = FactorSpec {
            key: SchemeKey([7; 32]),
            rows: 100,
            max_degree: 4,
            weights: WeightsHash::ONES,
            smoothness: 0.0,
        };
        let name = spec.file_name(Scalar::F64);
        assert!(name.starts_with("factor_4_f64_") && name.len() == "factor_4_f64_".len() + 8, "{name}");
        assert_eq!(FactorSpec { smoothness: -0.0, ..spec }.file_name(Scalar::F64), name);
        let others = [
            spec.file_name(Scalar::F32),
            FactorSpec { smoothness: 1e-9, ..spec }.file_name(Scalar::F64),
            FactorSpec { max_degree: 5, ..spec }.file_name(Scalar::F64),
            FactorSpec { weights: WeightsHash([1; 32]), ..spec }.file_name(Scalar::F64),
        ];
        assert!(others.iter().all(|other| *other != name), "{name} {others:?}");
    }
}
