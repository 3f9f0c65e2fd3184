//! Smooths models by the heat kernel.
//!
//! Diffusion on the sphere over a time s multiplies the coefficients of degree l by
//!
//! ```text
//! h_l = exp(-l (l + 1) s),    FWHM = 4 sqrt(s ln 2) rad,    s = FWHM^2 / (16 ln 2)
//! ```
//!
//! The kernel is from M. K. Chung et al., "Weighted Fourier series representation and its application to quantifying
//! the amount of gray matter", IEEE Trans. Med. Imaging 26 (2007). The formula for the full width at half maximum
//! (FWHM) is exact for a Gaussian in the plane. On the sphere, the width is larger than the formula by a factor of
//! 1.0002 at s = 1e-3, 1.0017 at s = 1e-2, and 1.017 at s = 0.1. The coefficients of degree 0, and therefore the mean
//! position, don't change. The width refers to the sphere of directions. Measured on the surface, in its unit, the
//! width varies with the area element, and is about `FWHM sqrt(area / (4 pi))`.

use ndarray::Array2;
use spharm_harmonics::index::degree_order;
use spharm_harmonics::{Coefficients, HarmonicsError};
use std::f64::consts::{LN_2, PI};

use crate::error::ShapeError;

/// A heat kernel on the sphere, with a given diffusion time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeatKernel {
    time: f64,
}

impl HeatKernel {
    /// Returns the kernel with the given diffusion time s, at least 0.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Setting`] if s is negative or not finite.
    pub fn after(time: f64) -> Result<Self, ShapeError> {
        if !(time >= 0.0 && time.is_finite()) {
            let (name, expected) = ("the diffusion time", "it must be finite and not negative");
            return Err(ShapeError::Setting { name, expected, found: time.to_string() });
        }
        Ok(Self { time })
    }

    /// Returns the kernel with the given full width at half maximum in radians, from 0 to pi.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Setting`] if the width is outside this range.
    pub fn of_width(fwhm: f64) -> Result<Self, ShapeError> {
        if !(0.0..=PI).contains(&fwhm) {
            let (name, expected) = ("the full width at half maximum", "it must be from 0 to pi (180 degrees)");
            return Err(ShapeError::Setting { name, expected, found: fwhm.to_string() });
        }
        Ok(Self { time: fwhm * fwhm / (16.0 * LN_2) })
    }

    /// Returns the diffusion time s of the kernel.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Returns the full width at half maximum in radians, by the formula for the plane: `4 sqrt(s ln 2)`.
    #[must_use]
    pub fn width(&self) -> f64 {
        4.0 * (self.time * LN_2).sqrt()
    }

    /// Returns the factor by which the kernel multiplies the coefficients of a degree.
    #[must_use]
    pub fn factor(&self, degree: usize) -> f64 {
        let l = degree as f64;
        (-l * (l + 1.0) * self.time).exp()
    }

    /// Returns the coefficients (K, c) of the functions after smoothing by this kernel.
    ///
    /// # Errors
    ///
    /// Never fails for `Coefficients`, whose number of rows is valid by construction.
    pub fn smooth(&self, coefficients: &Coefficients) -> Result<Coefficients, HarmonicsError> {
        let values = coefficients.values();
        let factors: Vec<f64> = (0..=coefficients.max_degree()).map(|degree| self.factor(degree)).collect();
        let smoothed = |(row, channel)| factors[degree_order(row).0] * values[[row, channel]];
        Coefficients::new(Array2::from_shape_fn(values.dim(), smoothed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_harmonics::index::basis_size;

    /// Returns the value of the kernel at an angle from its centre, `sum (2l + 1) / (4 pi) h_l P_l(cos angle)`, up to
    /// degree 400.
    fn kernel(heat: HeatKernel, angle: f64) -> f64 {
        let (x, mut older, mut old) = (angle.cos(), 0.0, 1.0);
        (0..=400)
            .map(|l| {
                let n = l as f64;
                let term = (2.0 * n + 1.0) / (4.0 * PI) * heat.factor(l) * old;
                (older, old) = (old, ((2.0 * n + 1.0) * x * old - n * older) / (n + 1.0));
                term
            })
            .sum()
    }

    #[test]
    fn the_width_is_the_kernels() {
        for (time, ratio) in [(1e-3, 1.0002), (1e-2, 1.0017), (0.1, 1.017)] {
            let heat = HeatKernel::after(time).unwrap();
            let half = 0.5 * kernel(heat, 0.0);
            let (mut low, mut high) = (0.0, PI);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if kernel(heat, middle) > half { low = middle } else { high = middle }
            }
            let found = 2.0 * low / heat.width();
            assert!((found - ratio).abs() < 6e-4, "{time}: {found}");
            assert!((HeatKernel::of_width(heat.width()).unwrap().time() / time - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn smoothing_twice_is_smoothing_longer_and_keeps_the_mean() {
        let values = Array2::from_shape_fn((basis_size(9), 2), |(k, c)| ((k * 7 + c) as f64 * 0.37).sin());
        let rough = Coefficients::new(values).unwrap();
        let heat = |time| HeatKernel::after(time).unwrap();
        let twice = heat(0.02).smooth(&heat(0.01).smooth(&rough).unwrap()).unwrap();
        let once = heat(0.03).smooth(&rough).unwrap();
        let off = (twice.values() - once.values()).iter().fold(0.0f64, |most, d| most.max(d.abs()));
        assert!(off < 1e-15, "{off:e}");
        assert_eq!(once.values().row(0), rough.values().row(0));
        assert_eq!(heat(0.0).smooth(&rough).unwrap(), rough);
        let long = heat(1e4).smooth(&rough).unwrap();
        assert!(long.values().iter().skip(2).all(|value| *value == 0.0));
    }

    #[test]
    fn widths_that_are_none_are_refused() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(HeatKernel::after(bad), Err(ShapeError::Setting { .. })));
            assert!(matches!(HeatKernel::of_width(bad), Err(ShapeError::Setting { .. })));
        }
        for wide in [181f64.to_radians(), 1e300] {
            assert!(matches!(HeatKernel::of_width(wide), Err(ShapeError::Setting { .. })));
        }
        assert!(HeatKernel::of_width(180f64.to_radians()).is_ok());
    }
}
