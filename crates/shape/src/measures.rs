//! Computes area, volume and centroid of a model by Gauss-Legendre quadrature over the sphere.
//!
//! The grid has n rings of 2n azimuths. Each direction of ring j has the weight `w = w_j pi / n`, where w_j is the
//! ring's Gauss-Legendre weight. With the position X and the area vector `N = X_1 x X_2` (see
//! [`geometry`](crate::geometry)):
//!
//! ```text
//! area = sum w |N|,    volume = 1/3 sum w X . N,    centroid = 1/(4 volume) sum w X (X . N)
//! ```
//!
//! The formulas for volume and centroid follow from the divergence theorem, `div x = 3` and `div (x x_i) = 4 x_i`.
//! Their integrands are polynomials of degree 3L and 4L, and quadrature on n rings is exact up to degree 2n - 1. Volume
//! and centroid are therefore exact, except for rounding errors, if `n` is at least `2L + 1`. |N| isn't a polynomial.
//! The area is therefore computed on L + 1 rings (at least 8), and the number of rings is doubled until the area
//! changes by less than a tolerance. The last change is reported. It estimates the error of the area on the coarser of
//! the last two grids. The reported area is that on the finer grid, whose error is much smaller.
//!
//! Cost: four syntheses of three columns at 2 n^2 directions for each grid. The number of directions evaluated at a
//! time is limited to between 2^18 and 2^21, depending on the degree. Each of these directions takes 96 bytes. Sums are
//! added in the order of the rings, so the result is bitwise the same on any number of threads.

use ndarray::{Array2, Axis};
use rayon::prelude::*;
use spharm_harmonics::{Coefficients, Directions, GaussLegendre, gauss_legendre};
use spharm_monitor::{Monitor, Stage};
use spharm_surface::geometry::{Vec3, add, cross, dot, scale};
use spharm_transform::synthesis;
use std::f64::consts::PI;
use std::fmt;

use crate::derivatives::rotational_derivatives;
use crate::error::ShapeError;
use crate::extent::{Extent, extent};
use crate::geometry::{run_length, side_by_side, tangent_frame};

/// Points whose area element is below this fraction of its mean are regarded as squeezed by the map from the sphere.
pub const SQUEEZED: f64 = 1e-3;

/// Settings of [`measure`], which determine the convergence of the area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasureParams {
    /// The area has converged when its relative change from one grid to the next is at most this value; 1e-7 by
    /// default.
    pub tolerance: f64,
    /// Maximum number of rings of a grid; by default the larger of 1,024 and 2L + 2. A value below 16 or below 2L + 2
    /// is raised to the larger of the two.
    pub most_rings: Option<usize>,
}

impl Default for MeasureParams {
    fn default() -> Self {
        Self { tolerance: 1e-7, most_rings: None }
    }
}

/// Area, volume, centroid and related measures of a surface, in the surface's unit of length.
#[derive(Debug, Clone, PartialEq)]
pub struct Measures {
    /// Area of the surface.
    pub area: f64,
    /// Relative change of the area between the last two grids.
    pub area_change: f64,
    /// Number of rings of the last grid.
    pub rings: usize,
    /// Volume enclosed by the surface, at least 0.
    pub volume: f64,
    /// Centre of mass of the enclosed body; the mean position if the volume is 0.
    pub centroid: Vec3,
    /// `(36 pi volume^2)^(1/3) / area`: 1 for a sphere, less for any other shape.
    pub sphericity: f64,
    /// Whether the normals of the parameterisation point inwards, because the sphere was mirrored.
    pub inwards: bool,
    /// Fraction of the sphere on which the area element is below [`SQUEEZED`] times its mean; curvatures are unreliable
    /// there.
    pub squeezed: f64,
    /// Warnings about the measures.
    pub warnings: Vec<MeasureWarning>,
}

/// Warnings about measures.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum MeasureWarning {
    /// The area still changed by more than the tolerance between the two finest grids.
    NotConverged {
        /// Relative change of the area.
        change: f64,
        /// Requested tolerance.
        tolerance: f64,
        /// Number of rings of the finest grid.
        rings: usize,
    },
    /// The surface lies in a plane and has no inside.
    Flat,
    /// The parameterisation is mirrored, so its normals point inwards.
    Inwards,
    /// The area element is below [`SQUEEZED`] times its mean on part of the sphere.
    Squeezed {
        /// Fraction of the sphere's area on which the map is squeezed.
        part: f64,
    },
}

impl fmt::Display for MeasureWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged { change, tolerance, rings } => write!(
                f,
                "the area did not converge: its relative change was {change:.1e} on the finest grid ({rings} rings), \
                 but the tolerance is {tolerance:.1e}"
            ),
            Self::Flat => f.write_str("the surface lies in a plane and encloses no volume"),
            Self::Inwards => f.write_str(
                "the parameterisation is mirrored, so that its normals point inwards; outward normals are reported and \
                 used for curvatures",
            ),
            Self::Squeezed { part } => {
                let share = if *part < 1e-4 { "less than 0.01".to_owned() } else { format!("{:.2}", 100.0 * part) };
                write!(
                    f,
                    "on {share} % of the sphere, the area element of the map is less than a thousandth of its mean: \
                     curvatures are unreliable there"
                )
            }
        }
    }
}

/// Computes area, volume and centroid of the surface with the canonical coefficients `coefficients` (K, 3).
///
/// # Errors
///
/// The errors of [`extent`]; [`ShapeError::Setting`] if the tolerance isn't finite and positive;
/// [`ShapeError::Transform`] if the transform fails; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn measure(
    coefficients: &Coefficients,
    params: &MeasureParams,
    monitor: &dyn Monitor,
) -> Result<Measures, ShapeError> {
    let MeasureParams { tolerance, most_rings } = *params;
    if !(tolerance > 0.0 && tolerance.is_finite()) {
        let (name, expected) = ("the tolerance of the area", "it must be a finite number above 0");
        return Err(ShapeError::Setting { name, expected, found: tolerance.to_string() });
    }
    let flat = extent(coefficients)? == Extent::Flat;
    let columns = Columns::new(coefficients)?;
    let mut rings = (coefficients.max_degree() + 1).max(8);
    let most = most_rings.unwrap_or(1024).max(2 * rings);
    let mut sums = columns.sums(rings, 0.0, monitor)?;
    let (mut change, mut squeezed) = (f64::INFINITY, 0.0);
    while change > tolerance && 2 * rings <= most {
        rings *= 2;
        let finer = columns.sums(rings, SQUEEZED * sums.area / (4.0 * PI), monitor)?;
        change = (finer.area / sums.area - 1.0).abs();
        squeezed = finer.squeezed / (4.0 * PI);
        sums = finer;
    }
    let Sums { area, .. } = sums;
    // For a flat surface, the terms of the volume cancel each other, and their sum consists of rounding errors.
    let volume = if flat { 0.0 } else { sums.volume / 3.0 };
    let centre = if volume == 0.0 { [0.0; 3] } else { sums.moment.map(|moment| moment / (4.0 * volume)) };
    let inwards = volume < 0.0;
    let mut warnings = Vec::new();
    if change > tolerance {
        warnings.push(MeasureWarning::NotConverged { change, tolerance, rings });
    }
    if flat {
        warnings.push(MeasureWarning::Flat);
    }
    if inwards {
        warnings.push(MeasureWarning::Inwards);
    }
    if squeezed > 0.0 {
        warnings.push(MeasureWarning::Squeezed { part: squeezed });
    }
    Ok(Measures {
        area,
        area_change: change,
        rings,
        volume: volume.abs(),
        centroid: add(centre, columns.mean),
        sphericity: (36.0 * PI * volume * volume).cbrt() / area,
        inwards,
        squeezed,
        warnings,
    })
}

/// Weighted sums over the directions of a grid.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    area: f64,
    /// Three times the volume.
    volume: f64,
    /// Four times the first moment of the volume.
    moment: Vec3,
    /// Solid angle of the directions whose area element is below the threshold.
    squeezed: f64,
}

/// Coefficients of the position X, relative to the mean position, and of its [derivatives](crate::derivatives) `L_k X`,
/// side by side.
pub(crate) struct Columns {
    values: Array2<f64>,
    max_degree: usize,
    mean: Vec3,
}

impl Columns {
    pub(crate) fn new(coefficients: &Coefficients) -> Result<Self, ShapeError> {
        let mut centred = coefficients.values().to_owned();
        let mean = std::array::from_fn(|c| centred[[0, c]] / (4.0 * PI).sqrt());
        // The surface is centred, because the rounding errors of area and volume depend on the mean position.
        centred.row_mut(0).fill(0.0);
        let [x, y, z] = rotational_derivatives(centred.view())?;
        let values = side_by_side(&[centred, x, y, z]);
        Ok(Self { values, max_degree: coefficients.max_degree(), mean })
    }

    /// Returns the position X, relative to the mean position, and the area vector N at each direction.
    pub(crate) fn at(&self, directions: Vec<Vec3>) -> Result<Vec<[Vec3; 2]>, ShapeError> {
        let directions = Directions::from_unit_vectors(directions)?;
        let samples = synthesis(&directions, self.values.view())?;
        let rows = samples.axis_iter(Axis(0)).into_par_iter().zip(directions.as_slice());
        Ok(rows
            .map(|(row, &u)| {
                let vector = |k: usize| -> Vec3 { std::array::from_fn(|c| row[3 * k + c]) };
                let along = |axis: Vec3| {
                    let [x, y, z] = [1, 2, 3].map(|k| scale(vector(k), axis[k - 1]));
                    add(add(x, y), z)
                };
                let [e1, e2] = tangent_frame(u);
                // N = X_1 x X_2, with the tangents X_1 = along(e2) and X_2 = -along(e1).
                [vector(0), cross(along(e1), along(e2))]
            })
            .collect())
    }

    /// Returns the sums over the grid of `rings` rings. The solid angle of directions with an area element below
    /// `small` is added to `squeezed`.
    fn sums(&self, rings: usize, small: f64, monitor: &dyn Monitor) -> Result<Sums, ShapeError> {
        let grid = Grid::new(rings);
        monitor.begin(Stage::counted("quadrature", "rings"), rings as u64);
        let mut total = Sums::default();
        for run in grid.runs(self.max_degree) {
            monitor.check()?;
            let found = self.at(grid.directions(run.clone()))?;
            for (ring, points) in run.clone().zip(found.chunks_exact(grid.around())) {
                let weight = grid.weight(ring);
                let mut sums = Sums::default();
                for [x, n] in points {
                    let (element, height) = (dot(*n, *n).sqrt(), dot(*x, *n));
                    sums.area += element;
                    sums.volume += height;
                    sums.moment = add(sums.moment, scale(*x, height));
                    sums.squeezed += f64::from(u8::from(element < small));
                }
                total.area += weight * sums.area;
                total.volume += weight * sums.volume;
                total.moment = add(total.moment, scale(sums.moment, weight));
                total.squeezed += weight * sums.squeezed;
            }
            monitor.step(run.len() as u64);
        }
        monitor.end();
        Ok(total)
    }
}

/// A Gauss-Legendre grid of n rings and 2n azimuths.
pub(crate) struct Grid {
    rings: GaussLegendre,
}

impl Grid {
    pub(crate) fn new(rings: usize) -> Self {
        Self { rings: gauss_legendre(rings) }
    }

    /// Returns the number of directions of a ring.
    pub(crate) fn around(&self) -> usize {
        2 * self.rings.len()
    }

    /// Returns the weight of each direction of a ring; the weights of all directions of a grid sum to 4 pi.
    pub(crate) fn weight(&self, ring: usize) -> f64 {
        self.rings.weights[ring] * PI / self.rings.len() as f64
    }

    /// Returns ranges of rings to evaluate together, for a model of degree `max_degree`.
    pub(crate) fn runs(&self, max_degree: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
        let (n, run) = (self.rings.len(), (run_length(max_degree) / self.around()).max(1));
        (0..n).step_by(run).map(move |first| first..(first + run).min(n))
    }

    /// Returns the directions of a range of rings, ring by ring.
    pub(crate) fn directions(&self, rings: std::ops::Range<usize>) -> Vec<Vec3> {
        let azimuths: Vec<(f64, f64)> =
            (0..self.around()).map(|k| (2.0 * PI * k as f64 / self.around() as f64).sin_cos()).collect();
        let ring = |j: usize| {
            let (sine, cosine) = (self.rings.sines[j], self.rings.cosines[j]);
            azimuths.iter().map(move |(sin, cos)| [sine * cos, sine * sin, cosine])
        };
        rings.flat_map(ring).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_share_of_the_sphere_is_not_rounded_to_zero() {
        let text = |part: f64| MeasureWarning::Squeezed { part }.to_string();
        assert!(text(2e-5).starts_with("on less than 0.01 % of the sphere, "), "{}", text(2e-5));
        assert!(text(0.0123).starts_with("on 1.23 % of the sphere, "), "{}", text(0.0123));
    }
}
