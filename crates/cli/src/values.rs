//! Parses and checks values of arguments.

use clap::ValueEnum;
use spharm_parametrize::wrap::VOXELS;
use spharm_store::Scalar;

/// Scalar type in which a basis or a factor is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Dtype {
    /// 64-bit floating point.
    F64,
    /// 32-bit floating point.
    F32,
}

impl Dtype {
    /// Returns the store's scalar type.
    pub fn scalar(self) -> Scalar {
        match self {
            Self::F64 => Scalar::F64,
            Self::F32 => Scalar::F32,
        }
    }
}

/// Parses an integer of at least 1, or `inf`.
///
/// # Errors
///
/// Returns a message that states the expected value.
pub fn at_least_one(text: &str) -> Result<usize, String> {
    match text {
        "inf" => Ok(usize::MAX),
        _ => text.parse().ok().filter(|&n| n > 0).ok_or_else(|| "expected a positive whole number, or inf".to_owned()),
    }
}

/// Parses a number between 0 and 1, both excluded.
///
/// # Errors
///
/// Returns a message that states the expected value.
pub fn fraction(text: &str) -> Result<f64, String> {
    let fraction = text.parse().ok().filter(|fraction: &f64| *fraction > 0.0 && *fraction < 1.0);
    fraction.ok_or_else(|| "expected a number between 0 and 1".to_owned())
}

/// Parses a percentage from 0 to 100, with or without a percent sign, and returns it as a fraction.
///
/// # Errors
///
/// Returns a message that states the expected value.
pub fn percent(text: &str) -> Result<f64, String> {
    let percent = text.trim_end_matches('%').parse().ok().filter(|percent: &f64| (0.0..=100.0).contains(percent));
    percent.map(|percent| 0.01 * percent).ok_or_else(|| "expected a percentage from 0 to 100".to_owned())
}

/// Parses the resolution of a wrap: the number of voxels along the mesh's longest side.
///
/// # Errors
///
/// Returns a message that states the expected value.
pub fn voxels(text: &str) -> Result<usize, String> {
    let voxels = text.parse().ok().filter(|voxels| VOXELS.contains(voxels));
    voxels.ok_or_else(|| format!("expected a number of voxels from {} to {}", VOXELS.start(), VOXELS.end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_kept() {
        assert_eq!((at_least_one("inf"), at_least_one("3")), (Ok(usize::MAX), Ok(3)));
        assert_eq!(fraction("0.5"), Ok(0.5));
        for text in ["0", "1", "-1", "nan", "x", ""] {
            assert!(fraction(text).is_err(), "{text}");
        }
        assert!(at_least_one("0").is_err() && at_least_one("1.5").is_err());
    }
}
