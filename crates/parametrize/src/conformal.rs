//! Maps a surface to the sphere with the least possible angle distortion. Among the maps with this angle distortion,
//! selects the one with the least area distortion.
//!
//! The energy is the harmonic energy of X. Gu et al. (IEEE Trans. Med. Imaging 23, 2004) divided, in each triangle, by
//! the ratio of the triangle's area on the sphere to its area on the surface (K. Hormann and G. Greiner, MIPS, 2000).
//! On a smooth surface both energies have the same minimum. Unlike the harmonic energy, the energy used here is
//! infinite if a triangle flips. The energy is invariant under Moebius transformations of the sphere. Each Moebius
//! transformation is a rotation followed by a boost (see [`boost`]). The boost is chosen to minimise the mean squared
//! log area ratio.
//!
//! A conformal map shrinks the end of an arm exponentially with the arm's length. The optimisation therefore adds a
//! term that keeps areas equal, lowers the weight of this term from stage to stage, and stops before triangles become
//! too small for 64-bit numbers.

use std::time::Instant;

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::Mesh;

use crate::descend::{Descent, SMOOTHING};
use crate::domain::Domain;
use crate::embed::Growth;
use crate::energy::Energy;
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, dot, orientation, scale, solid_angle, sub, unit};
use crate::report::{Parametrization, Warning};

/// Weight of the energy's equal-area term, for each stage.
const STAGES: [f64; 6] = [0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4];

/// Number of final rounds. Each round applies the best boost and then minimises the conformal energy.
const ROUNDS: usize = 2;

/// Settings of [`conformal`].
#[derive(Clone, Debug, PartialEq)]
pub struct ConformalParams {
    /// Largest number of Newton steps in each stage. Default 20.
    pub steps: usize,
    /// Seed of the sphere's initial rotation. Default 0.
    pub seed: u64,
}

impl Default for ConformalParams {
    fn default() -> Self {
        Self { steps: 20, seed: 0 }
    }
}

/// Maps a closed surface to the sphere with little angle distortion.
///
/// # Errors
///
/// The errors of [`cald`](crate::cald()), except for `Argument` and `Solver`.
pub fn conformal(
    surface: &Mesh,
    params: &ConformalParams,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    let domain = Domain::new(surface, monitor)?;
    let growth = Growth { energy: Energy::balanced(0.3, 1.0), steps: 6, seed: params.seed };
    let mut descent = Descent::start(&domain, growth, monitor)?;
    monitor.begin(SMOOTHING, 0);
    for weight in STAGES {
        descent.descend(Energy::balanced(weight, 1.0), 1e-3, params.steps, monitor)?;
    }
    for _ in 0..ROUNDS {
        centre(&domain, &mut descent.map, monitor)?;
        descent.descend(Energy::CONFORMAL, 3e-4, params.steps, monitor)?;
    }
    let centred = centre(&domain, &mut descent.map, monitor)?;
    monitor.end();
    let mut found = descent.finish("conformal", surface, &domain, started)?;
    found.report.warnings.extend((!centred).then_some(Warning::CentringStopped));
    Ok(found)
}

/// Applies a boost to the point x of the unit sphere. A boost is the Moebius transformation given by a vector c with
/// |c| < 1: it expands areas in the direction of c, and contracts areas on the opposite side.
fn boost(c: Vec3, x: Vec3) -> Vec3 {
    let d = sub(x, c);
    unit(sub(scale(d, (1.0 - dot(c, c)) / dot(d, d)), c))
}

/// Returns the mean squared log area ratio after a boost; infinite if the boost flips a triangle. A boost can flip
/// triangles because it doesn't map great circles to great circles.
fn distortion(domain: &Domain, map: &[Vec3], c: Vec3) -> f64 {
    const CHUNK: usize = 4096;
    let moved: Vec<Vec3> = map.par_iter().map(|&x| boost(c, x)).collect();
    let sums: Vec<f64> = domain
        .faces
        .par_chunks(CHUNK)
        .zip(domain.areas.par_chunks(CHUNK))
        .map(|(faces, areas)| {
            let each = faces.iter().zip(areas).map(|(face, &area)| {
                let corners = face.map(|v| moved[v as usize]);
                let angle = solid_angle(corners);
                if angle <= 0.0 || orientation(corners) <= 0.0 {
                    return f64::INFINITY;
                }
                area * (angle / area).ln().powi(2)
            });
            each.sum::<f64>()
        })
        .collect();
    sums.iter().sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// Applies the [`boost`] of least area distortion among the boosts that flip no triangle. Returns `false` if a boost
/// with even less distortion exists but would flip triangles.
fn centre(domain: &Domain, map: &mut [Vec3], monitor: &dyn Monitor) -> Result<bool, Interrupted> {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut blocked = false;
    for _ in 0..30 {
        let at = |c: Vec3| distortion(domain, map, c);
        let here = at([0.0; 3]);
        let h = 1e-3;
        let mut probes = [(0.0, 0.0); 3];
        for (probe, e) in probes.iter_mut().zip(axes) {
            monitor.check()?;
            *probe = (at(scale(e, h)), at(scale(e, -h)));
        }
        if probes.iter().any(|(a, b)| !(a + b).is_finite()) {
            return Ok(false);
        }
        let slope = probes.map(|(a, b)| (a - b) / (2.0 * h));
        // Newton's step needs only the curvatures along the three axes, since the function is nearly isotropic.
        let curvature = probes.map(|(a, b)| ((a + b - 2.0 * here) / (h * h)).max(0.1));
        let mut c = [0, 1, 2].map(|i| -slope[i] / curvature[i]);
        let length = dot(c, c).sqrt();
        if length < 1e-5 {
            break;
        }
        c = scale(c, (0.5 / length).min(1.0));
        let mut found = None;
        blocked = false;
        for _ in 0..12 {
            monitor.check()?;
            let there = at(c);
            if there < here {
                found = Some(c);
                break;
            }
            blocked |= !there.is_finite();
            c = scale(c, 0.5);
        }
        let Some(c) = found else { break };
        map.par_iter_mut().for_each(|x| *x = boost(c, *x));
    }
    Ok(!blocked)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quality::Quality;
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;

    #[test]
    fn a_boost_is_conformal_and_centring_takes_it_back() {
        let sphere = icosphere(4);
        let c = [0.3, -0.2, 0.4];
        let moved: Vec<Vec3> = sphere.vertices.iter().map(|&x| boost(c, x)).collect();
        let quality = Quality::measure(&sphere.vertices, &moved, &sphere.faces);
        assert!(quality.is_bijective() && quality.area_rms > 0.5, "{quality:?}");
        assert!(quality.angle_rms_degrees < 2.0, "{quality:?}");
        let domain = Domain::new(&sphere, &Silent).unwrap();
        let mut map = moved;
        assert!(centre(&domain, &mut map, &Silent).unwrap());
        let quality = Quality::measure(&sphere.vertices, &map, &sphere.faces);
        assert!(quality.area_rms < 0.02, "{quality:?}");
        assert!(map.iter().all(|x| (dot(*x, *x) - 1.0).abs() < 1e-14));
    }
}
