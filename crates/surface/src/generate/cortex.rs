//! Generates a folded, brain-like closed surface whose parameterisation over the sphere is known exactly.
//!
//! Vertex i is the image of vertex i of the icosphere under a smooth one-to-one map of space. The map has two parts:
//!
//! 1. *Folds.* A point of the sphere moves along its radius to the distance 1 - d / (1 + (w / s)^2) from the centre,
//!    where d is the depth of the furrows, s their width, and w a sum of plane waves cos(k_j . x + p_j) of nearly the
//!    same wavelength, with wave vectors k_j and phases p_j. The zeros of w are winding lines about half a wavelength
//!    apart. These lines become furrows, with broad ridges between them. Since the radius is a positive function on the
//!    sphere, the surface is embedded.
//! 2. *Shears* x -> x + a sin(k . x + p) e, with amplitude a, wave vector k, phase p, and a unit vector e perpendicular
//!    to k, are applied from long to short wavelengths. A shear is a smooth map of space that preserves volume and has
//!    a smooth inverse (the shear with -a instead of a), so the surface stays embedded. The shears tilt the furrows
//!    until walls overhang and the surface is no longer star-shaped about any point.
//!
//! Finally the surface is scaled along each axis to the extents of an adult's cerebrum.
//!
//! The constants were chosen by measurements over the icosphere of 40,962 vertices, and such that pictures of the
//! surface resemble gyri and sulci. 1.4 % of the triangles of variant 0 face its centre. Least-squares fits to variant
//! 0, computed with NumPy, have a mean squared distance (msd) of 7.7e-4 at degree 10, which corresponds to errors of
//! about 3 mm. The msd is 1.2e-5 at degree 60, and 7.4e-7 (0.1 mm) at degree 100.

use super::icosphere;
use super::random::SplitMix64;
use crate::geometry::{Vec3, add, bounds, dot, scale};
use crate::mesh::{Mesh, Meta};

/// Parameters of a folded surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cortex {
    /// Number of subdivisions of the icosahedron, see [`icosphere`]; 6 gives 40,962 vertices.
    pub subdivisions: u32,
    /// Index of the subject. All subjects share the course of the main folds and differ in detail. Corresponding
    /// vertices of two subjects are a few mm apart.
    pub variant: u64,
}

impl Default for Cortex {
    fn default() -> Self {
        Self { subdivisions: 6, variant: 0 }
    }
}

/// Extents along the RAS axes (left to right, back to front, bottom to top), in mm.
const EXTENT: Vec3 = [110.0, 140.0, 90.0];

/// A plane wave: its wave vector and phase.
struct Wave {
    k: Vec3,
    phase: f64,
}

impl Wave {
    fn argument(&self, x: Vec3) -> f64 {
        dot(self.k, x) + self.phase
    }
}

/// A shear: its wave, and the displacement at the wave's crest, which is perpendicular to the wave vector.
struct Shear {
    wave: Wave,
    crest: Vec3,
}

/// The map from the unit sphere to the folded surface, before the surface is scaled to its extents.
struct Folding {
    waves: Vec<Wave>,
    shears: Vec<Shear>,
}

const WAVES: usize = 40;
/// Range of the folds' wave numbers, in radians per radius of the sphere. The furrows are about pi / 14.5 radii apart,
/// which corresponds to 13 mm on a brain.
const WAVE_NUMBERS: (f64, f64) = (13.0, 16.0);
/// The depth d of the furrows, relative to the sphere's radius.
const DEPTH: f64 = 0.2;
/// The width s of the furrows, in standard deviations of w, the sum of the waves.
const WIDTH: f64 = 0.75;
/// Wave number, amplitude and count of each group of shears, in the order in which the groups are applied.
const SHEARS: [(f64, f64, usize); 2] = [(2.0, 0.06, 4), (9.0, 0.026, 10)];

impl Folding {
    fn new(variant: u64) -> Self {
        // `study` generates the numbers that all subjects share, and `subject` generates this subject's deviations from
        // those numbers.
        let mut study = SplitMix64::new(0x5350_4841_524d);
        let mut subject = SplitMix64::new(variant.wrapping_mul(0x2545_f491_4f6c_dd1d));
        let mut deviation = |size: f64| {
            if variant == 0 { 0.0 } else { subject.between(-size, size) }
        };
        let mut wave = |number: f64| {
            let direction = study.direction();
            Wave { k: scale(direction, number), phase: study.between(0.0, std::f64::consts::TAU) + deviation(0.5) }
        };
        let (low, high) = WAVE_NUMBERS;
        let waves = (0..WAVES).map(|j| wave(low + (high - low) * j as f64 / (WAVES - 1) as f64)).collect();
        let mut shears = Vec::new();
        for (number, amplitude, count) in SHEARS {
            for _ in 0..count {
                shears.push((wave(number), amplitude));
            }
        }
        let shears = shears
            .into_iter()
            .map(|(wave, amplitude)| {
                let e = study.square_to(wave.k);
                Shear { crest: scale(e, amplitude * (1.0 + deviation(0.3))), wave }
            })
            .collect();
        Self { waves, shears }
    }

    fn apply(&self, direction: Vec3) -> Vec3 {
        let sum: f64 = self.waves.iter().map(|wave| wave.argument(direction).cos()).sum();
        // The sum w is scaled to variance 1 for any number of waves.
        let w = sum * (2.0 / WAVES as f64).sqrt();
        let furrow = 1.0 / (1.0 + (w / WIDTH).powi(2));
        let radius = 1.0 - DEPTH * furrow;
        self.shears
            .iter()
            .fold(scale(direction, radius), |x, shear| add(x, scale(shear.crest, shear.wave.argument(x).sin())))
    }
}

/// Returns the number of bytes that [`cortex`] needs, including both meshes: the bytes for
/// [`icosphere`](super::icosphere), plus 48 per vertex for the surface.
///
/// # Panics
///
/// Panics in the same cases as [`icosphere_counts`](super::icosphere_counts).
#[must_use]
pub fn cortex_bytes(subdivisions: u32) -> u64 {
    super::icosphere_bytes(subdivisions) + 48 * super::icosphere_counts(subdivisions)[0]
}

/// Returns a folded surface in mm (RAS) and the unit sphere that parameterises it, with the same triangles.
///
/// Results are reproducible on one machine. Results of different machines may differ in the last bits, because the sine
/// function comes from the C library.
///
/// # Panics
///
/// Panics in the same cases as [`icosphere`].
#[must_use]
pub fn cortex(parameters: &Cortex) -> (Mesh, Mesh) {
    let sphere = icosphere(parameters.subdivisions);
    let folding = Folding::new(parameters.variant);
    let mut vertices: Vec<Vec3> = sphere.vertices.iter().map(|&x| folding.apply(x)).collect();
    let (low, high) = bounds(vertices.iter().copied());
    for vertex in &mut vertices {
        for axis in 0..3 {
            let middle = 0.5 * (low[axis] + high[axis]);
            vertex[axis] = (vertex[axis] - middle) * EXTENT[axis] / (high[axis] - low[axis]);
        }
    }
    let mut surface = Mesh::new(vertices, sphere.faces.clone());
    surface.meta = Meta {
        anatomical_structure_primary: Some("Cortex".to_owned()),
        surface_metadata: vec![("GeometricType".to_owned(), "Anatomical".to_owned())],
        ..Meta::default()
    };
    (surface, sphere)
}
