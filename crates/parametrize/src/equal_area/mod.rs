//! Maps a label's surface to the sphere with equal areas (Brechbuehler, Gerig, Kuebler 1995).
//!
//! The surface of a voxel object consists of squares. On the sphere, each square should have the area 4 pi / (number of
//! squares) and a shape as close to a square as possible. There are two steps, each in its own file:
//!
//! - `initial`: colatitude and azimuth, harmonic on the graph of the edges, from two sparse linear systems (section 3.1
//!   of the paper);
//! - `optimise`: edges as short as possible, and therefore quadrangles as square as possible, under constraints on
//!   areas and angles (section 3.2 of the paper).
//!
//! If voxels aren't cubes, this method goes beyond the paper. Each quadrangle's share of the sphere's area is then its
//! share of the surface's area in mm^2, and the ratio of its side lengths is taken into account (`targets`). If the
//! label's surface was smoothed, the shares and side lengths of the smooth quadrangles are used. Where a label is only
//! one voxel thick, some smooth quadrangles are so narrow that the optimisation finds no one-to-one map. In this case
//! the shares and side lengths of the voxels' faces are used.
//!
//! In the result each quadrangle is cut along one diagonal into two triangles, which are positively oriented on the
//! sphere. Surface and sphere have the same triangles.
//!
//! C. Brechbuehler, G. Gerig, O. Kuebler, "Parametrization of closed surfaces for 3-D shape description", Computer
//! Vision and Image Understanding 61 (1995), 154-170.

mod initial;
mod optimise;
mod targets;

pub use optimise::EqualAreaParams;

use std::time::Instant;

use spharm_monitor::Monitor;
use spharm_surface::Mesh;

use crate::error::ParametrizeError;
use crate::geometry::{Vec3, norm, orientation, solid_angle, sub};
use crate::report::{Note, Parametrization};
use crate::volume::QuadMesh;
use targets::Targets;

/// Maps a surface of quadrangles to the sphere with equal areas.
///
/// # Errors
///
/// [`InvalidMesh`](ParametrizeError::InvalidMesh) if the surface isn't a single closed surface of genus 0;
/// [`NotBijective`](ParametrizeError::NotBijective) if folds remain; [`Argument`](ParametrizeError::Argument) if memory
/// doesn't suffice for the linear systems; [`Interrupted`](ParametrizeError::Interrupted).
pub fn equal_area(
    quads: &QuadMesh,
    params: &EqualAreaParams,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    if quads.components() != 1 || quads.euler_characteristic() != 2 || quads.pinched_edges() > 0 {
        let (count, chi) = (quads.components(), quads.euler_characteristic());
        let problems = format!(
            "expected 1 surface of Euler characteristic 2 without pinched edges, found {count} (Euler characteristic \
             {chi} in total, {} pinched edges)",
            quads.pinched_edges()
        );
        let remedy = "repair the label";
        return Err(ParametrizeError::InvalidMesh { problems, remedy });
    }
    monitor.check()?;
    let start = initial::positions(quads)?;
    if let Some(smooth) = &quads.smooth {
        let targets = Targets::of(quads, smooth);
        match mapped(quads, &targets, start.clone(), params, started, monitor) {
            Err(ParametrizeError::NotBijective { .. }) => {}
            found => return found,
        }
    }
    mapped(quads, &Targets::of(quads, &quads.vertices), start, params, started, monitor)
}

/// Optimises a map for the given targets, starting from the vertex positions `start`.
fn mapped(
    quads: &QuadMesh,
    targets: &Targets,
    start: Vec<Vec3>,
    params: &EqualAreaParams,
    started: Instant,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    const REMEDY: &str = "smooth the label, or map its surface by another method";
    let found = optimise::optimise(&quads.quads, targets, start, params, monitor)?;
    let from_second: Vec<bool> = quads.quads.iter().map(|quad| cut_from_second(&found.positions, quad)).collect();
    let surface = quads.triangles(|q| from_second[q]);
    let sphere = Mesh::new(found.positions, surface.faces.clone());
    let deviation = deviation(quads, targets, &sphere.vertices);
    let mut map = Parametrization::checked("equal-area", surface, sphere, started, REMEDY)?;
    map.report.iterations = found.steps;
    map.report.converged = found.converged;
    map.report.quad_area_deviation = Some(deviation);
    map.report.notes.push(Note::QuadAreas { deviation });
    Ok(map)
}

/// Returns the largest relative deviation of a quadrangle's area on the sphere from its share of the surface's area.
/// For a smooth surface, the deviation from the shares of the smooth quadrangles and the deviation from the shares of
/// the voxels' faces are computed. The smaller deviation is returned, since the map was optimised for one of the two.
///
/// # Panics
///
/// When `sphere` has fewer points than the surface has vertices.
#[must_use]
pub fn area_deviation(quads: &QuadMesh, sphere: &[[f64; 3]]) -> f64 {
    let of = |positions: &Vec<[f64; 3]>| deviation(quads, &Targets::of(quads, positions), sphere);
    quads.smooth.as_ref().map_or(f64::INFINITY, of).min(of(&quads.vertices))
}

fn deviation(quads: &QuadMesh, targets: &Targets, sphere: &[[f64; 3]]) -> f64 {
    let off = |(quad, target): (&[u32; 4], &f64)| (quad_area(quad.map(|v| sphere[v as usize])) / target - 1.0).abs();
    quads.quads.iter().zip(&targets.areas).map(off).fold(0.0, f64::max)
}

fn quad_area([a, b, c, d]: [Vec3; 4]) -> f64 {
    solid_angle([a, b, c]) + solid_angle([a, c, d])
}

/// Returns whether to cut a quadrangle along the diagonal from corner 1 to 3 rather than from 0 to 2. The diagonal that
/// leaves both triangles positively oriented is preferred. If both diagonals do, or neither does, the shorter diagonal
/// is chosen.
fn cut_from_second(positions: &[Vec3], quad: &[u32; 4]) -> bool {
    let [a, b, c, d] = quad.map(|v| positions[v as usize]);
    let good = |triangles: [[Vec3; 3]; 2]| triangles.into_iter().all(|t| orientation(t) > 0.0);
    let (first, second) = (good([[a, b, c], [a, c, d]]), good([[a, b, d], [b, c, d]]));
    if first == second { norm(sub(b, d)) < norm(sub(a, c)) } else { second }
}
