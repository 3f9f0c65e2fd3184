//! Deforms an icosphere onto a surface (after M. Chung and S. Robbins).
//!
//! The result has the shape of the given surface and the triangulation of the icosphere. Vertices with the same index
//! correspond across surfaces, so the subjects of a study share a sampling. Springs keep the triangles close to
//! equilateral.
//!
//! # Method
//!
//! In the original method a mesh is pulled towards the surface through space (D. MacDonald, N. Kabani, D. Avis, A.
//! Evans, NeuroImage 12, 2000; S. Robbins, MSc thesis, McGill, 2003). If a surface is far from convex, for example at
//! an arm or a fold, the point of the surface nearest to a vertex can lie on the wrong side. The mesh then gets stuck
//! or intersects itself. The original method avoids this by starting close to the surface, which isn't possible for
//! arbitrary surfaces. Therefore this method starts from a one-to-one map of the surface onto the sphere, made by any
//! of this crate's methods. The map determines the initial position of each vertex of the icosphere. The vertices are
//! then moved *on* the surface, coarse to fine:
//!
//! 1. The vertices of a coarse icosphere take the positions that the map gives them.
//! 2. In sweeps, each vertex is displaced by its forces and projected to the nearest point of the surface. The map
//!    gives the vertex's new position on the sphere. The move is made only if all triangles around the vertex stay
//!    positively oriented on the sphere, as verified by an exact predicate, and well shaped on the surface. The mesh
//!    therefore winds around the surface exactly once, and no vertex jumps to another sheet of a fold that is near in
//!    space but far along the surface.
//! 3. Each triangle is split in four at the midpoints of its edges on the sphere, and step 2 is repeated.
//!
//! The forces on vertex i with neighbours j are as follows. l_ij is the length of a path on the surface: the image of
//! the arc from i to j. (A straight chord would miss a fold that a coarse triangle spans.) t_ij is the direction in
//! which the path leaves i.
//!
//! - *stretch*: mean over j of (l_ij - L_ij) t_ij, springs of rest length L_ij. L_ij is the icosphere's own edge
//!   length, scaled by the square root of the ratio of the surface's area to the unit sphere's.
//! - *bending*: U_i - mean of U_j, with U_i = mean over j of l_ij t_ij. This force smooths changes of the spacing. It
//!   doesn't change the shape: vertices are projected back onto the surface, so only the tangential part of a force
//!   moves them.
//!
//! Finally, triangles that intersect each other are searched for with a bounding-volume hierarchy. Intersections occur
//! where a fold is narrower than the triangles. The vertices around intersecting triangles are smoothed until no
//! intersection is left, which moves these vertices slightly off the surface. Remaining intersections are reported;
//! more subdivisions help, unless the given surface intersects itself.
//!
//! # Cost
//!
//! O(vertices log triangles) per sweep; 40,962 vertices take about ten seconds on two cores. Memory is linear in the
//! number of vertices.

mod ground;
mod rings;

use std::time::Instant;

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor, Stage};
use spharm_surface::Mesh;
use spharm_surface::generate::{icosphere, subdivide_sphere};

use crate::error::ParametrizeError;
use crate::geometry::{Vec3, add, area, norm, orientation, scale, sub};
use crate::report::{Parametrization, Resampling, Warning};
use crate::resample::measured;
use crate::self_intersections::self_intersections;
use ground::Ground;
use rings::Rings;

/// Settings of [`deform`].
#[derive(Clone, Debug, PartialEq)]
pub struct DeformParams {
    /// Number of subdivisions of the icosphere, 0 to 10. `None` (default) chooses the smallest number, at most 7, that
    /// gives at least as many vertices as the surface has.
    pub subdivisions: Option<u32>,
    /// Weight of the stretch force. Default 0.5.
    pub stretch: f64,
    /// Weight of the bending force. Default 0.1.
    pub bending: f64,
    /// Number of sweeps over the vertices at each level. Default 15.
    pub sweeps: usize,
}

impl Default for DeformParams {
    fn default() -> Self {
        Self { subdivisions: None, stretch: 0.5, bending: 0.1, sweeps: 15 }
    }
}

/// Largest number of subdivisions. An icosphere with this number has 10 million vertices.
const MOST: u32 = 10;
/// Number of subdivisions of the icosphere at the coarsest level.
const COARSEST: u32 = 3;
/// Smallest shape measure (see [`Level::shape`]) that a triangle may have after a move. A triangle whose shape measure
/// is already smaller must not get worse. Without this limit, springs under pressure would flatten triangles.
const SHAPE: f64 = 0.4;
/// Largest number of rounds that smooth the mesh around intersecting triangles.
const ROUNDS: usize = 30;

/// Number of vertices that a sweep processes between checks of the monitor.
const CHUNK: usize = 2048;

/// Deforms an icosphere onto a surface, given a one-to-one map of the surface onto the sphere.
///
/// # Errors
///
/// [`NotBijective`](ParametrizeError::NotBijective) if `sphere` has folds; [`Argument`](ParametrizeError::Argument) for
/// more than 10 subdivisions, or a sphere with a vertex at the origin; [`Interrupted`](ParametrizeError::Interrupted).
///
/// # Panics
///
/// When the sphere doesn't have the surface's number of vertices.
pub fn deform(
    surface: &Mesh,
    sphere: &Mesh,
    params: &DeformParams,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    assert_eq!(
        surface.vertices.len(),
        sphere.vertices.len(),
        "the surface and its sphere must have equally many vertices"
    );
    let enough = |s: &u32| 10 * 4_usize.pow(*s) + 2 >= surface.vertices.len();
    let finest = params.subdivisions.unwrap_or_else(|| (0..7).find(enough).unwrap_or(7));
    if finest > MOST {
        let found = finest.to_string();
        return Err(ParametrizeError::Argument { what: "subdivisions", expected: "at most 10", found });
    }
    let ground = Ground::new(surface, sphere)?;
    let coarsest = finest.min(COARSEST);
    let vertices = |level: u32| 10 * 4_u64.pow(level) + 2;
    let total = (coarsest..=finest).map(|level| vertices(level) * params.sweeps as u64).sum();
    monitor.begin(Stage::counted("coarse to fine", "vertices"), total);

    let mut reference = icosphere(coarsest);
    let mut on_sphere = reference.clone();
    let mut mesh = Level::new(&reference, &on_sphere.vertices, &ground, pieces(finest - coarsest), monitor)?;
    let mut sweeps = 0;
    for level in coarsest..=finest {
        if level > coarsest {
            // The vertices of an icosphere are the first vertices of the next finer icosphere, in the same order.
            on_sphere = subdivide_sphere(&on_sphere);
            reference = icosphere(level);
            mesh = Level::new(&reference, &on_sphere.vertices, &ground, pieces(finest - level), monitor)?;
        }
        for _ in 0..params.sweeps {
            mesh.sweep(&ground, params, monitor)?;
            sweeps += 1;
            monitor.step(vertices(level));
        }
        on_sphere.vertices.clone_from(&mesh.on_sphere);
    }
    monitor.end();
    let mut deformed = Mesh::new(mesh.positions, reference.faces.clone());
    deformed.meta.clone_from(&surface.meta);
    let (left, smoothed) = separate(&mut deformed, &mesh.rings, monitor)?;
    let mut found = measured("deform", surface, deformed, reference, started, monitor)?;
    let report = &mut found.report;
    report.iterations = sweeps;
    report.warnings.extend((smoothed > 0).then_some(Warning::Smoothed { vertices: smoothed }));
    report.warnings.extend((left > 0).then_some(Warning::SelfIntersections { pairs: left }));
    report.seconds = started.elapsed().as_secs_f64();
    found.resampling = found.resampling.map(|found| Resampling { self_intersections: Some(left), ..found });
    Ok(found)
}

/// Returns the number of pieces into which an edge's path is divided to measure its length, if the edge will be split
/// `splits` times.
fn pieces(splits: u32) -> u32 {
    2 << splits.min(6)
}

/// The mesh at one level of subdivision.
struct Level {
    positions: Vec<Vec3>,
    /// The vertices' positions on the sphere, as given by the map. All triangles are positively oriented there.
    on_sphere: Vec<Vec3>,
    rings: Rings,
    /// Rest lengths of the springs, in the order of the neighbours in `rings`.
    rest: Vec<f64>,
    /// Number of pieces into which an edge's path is divided to measure its length.
    pieces: u32,
}

impl Level {
    fn new(
        reference: &Mesh,
        on_sphere: &[Vec3],
        ground: &Ground<'_>,
        pieces: u32,
        monitor: &dyn Monitor,
    ) -> Result<Self, ParametrizeError> {
        let rings = Rings::new(reference);
        let length = |v: usize, w: u32| norm(sub(reference.vertices[w as usize], reference.vertices[v]));
        let rest = (0..on_sphere.len()).flat_map(|v| rings.of(v).iter().map(move |&w| ground.scale * length(v, w)));
        let rest = rest.collect();
        let positions = ground.points(on_sphere, monitor)?;
        Ok(Self { positions, on_sphere: on_sphere.to_vec(), rings, rest, pieces })
    }

    /// Moves each vertex at most once. All forces are computed from the positions before the sweep; then the moves are
    /// made in the order of the vertices.
    fn sweep(&mut self, ground: &Ground<'_>, params: &DeformParams, monitor: &dyn Monitor) -> Result<(), Interrupted> {
        let n = self.positions.len();
        let paths: Vec<Vec<Vec3>> = in_chunks(n, monitor, |v| self.paths(v, ground))?;
        let mean = |v: usize| scale(paths[v].iter().copied().fold([0.0; 3], add), 1.0 / paths[v].len() as f64);
        let umbrella: Vec<Vec3> = (0..n).into_par_iter().map(mean).collect();
        let target = |v: usize| {
            let ring = self.rings.of(v);
            let share = 1.0 / ring.len() as f64;
            let rest = &self.rest[self.rings.starts[v] as usize..];
            let mut force = [0.0; 3];
            for ((&w, &rest), &path) in ring.iter().zip(rest).zip(&paths[v]) {
                let length = norm(path);
                if length > 0.0 {
                    force = add(force, scale(path, params.stretch * share * (1.0 - rest / length)));
                }
                force = add(force, scale(sub(umbrella[v], umbrella[w as usize]), params.bending * share));
            }
            ground.nearest(add(self.positions[v], force))
        };
        let targets = in_chunks(n, monitor, target)?;
        for (v, target) in targets.into_iter().enumerate() {
            let Some((position, direction)) = target else { continue };
            let shape = self.shape(v);
            let old_direction = std::mem::replace(&mut self.on_sphere[v], direction);
            let old_position = std::mem::replace(&mut self.positions[v], position);
            if !self.is_positive(v) || self.shape(v) < shape.min(SHAPE) {
                (self.on_sphere[v], self.positions[v]) = (old_direction, old_position);
            }
        }
        Ok(())
    }

    /// Returns, for each neighbour of a vertex, the length of the path to the neighbour times the path's initial
    /// direction.
    fn paths(&self, v: usize, ground: &Ground<'_>) -> Vec<Vec3> {
        let to = |&w: &u32| {
            let pair = |points: &[Vec3]| [points[v], points[w as usize]];
            ground.path(pair(&self.on_sphere), pair(&self.positions), self.pieces)
        };
        self.rings.of(v).iter().map(to).collect()
    }

    /// Returns the smallest shape measure of the triangles around a vertex: 4 sqrt(3) area / (sum of squared edge
    /// lengths), which is 1 for an equilateral triangle.
    fn shape(&self, v: usize) -> f64 {
        let ring = self.rings.of(v);
        let of = |k: usize| {
            let [a, b] = [ring[k], ring[(k + 1) % ring.len()]].map(|w| self.positions[w as usize]);
            let at = self.positions[v];
            let square = |u: Vec3, w: Vec3| norm(sub(u, w)).powi(2);
            4.0 * 3.0_f64.sqrt() * area([at, a, b]) / (square(at, a) + square(a, b) + square(b, at))
        };
        (0..ring.len()).map(of).fold(1.0, f64::min)
    }

    /// Returns whether all triangles around a vertex are positively oriented on the sphere.
    fn is_positive(&self, v: usize) -> bool {
        let ring = self.rings.of(v);
        (0..ring.len()).all(|k| {
            let (a, b) = (ring[k] as usize, ring[(k + 1) % ring.len()] as usize);
            orientation([self.on_sphere[v], self.on_sphere[a], self.on_sphere[b]]) > 0.0
        })
    }
}

/// Computes a value for each of n vertices in parallel; the monitor is checked between chunks.
fn in_chunks<T: Send>(n: usize, monitor: &dyn Monitor, f: impl Fn(usize) -> T + Sync) -> Result<Vec<T>, Interrupted> {
    let mut values = Vec::with_capacity(n);
    for start in (0..n).step_by(CHUNK) {
        monitor.check()?;
        values.par_extend((start..(start + CHUNK).min(n)).into_par_iter().map(&f));
    }
    Ok(values)
}

/// Smooths the mesh around self-intersections until none remain, or for [`ROUNDS`] rounds. Returns the number of
/// intersecting pairs of triangles that remain, and the number of vertices moved.
fn separate(mesh: &mut Mesh, rings: &Rings, monitor: &dyn Monitor) -> Result<(usize, usize), Interrupted> {
    monitor.begin(Stage::counted("self-intersections", "rounds"), 0);
    let mut moved = vec![false; mesh.vertices.len()];
    let mut pairs = self_intersections(mesh, monitor)?;
    for _ in 0..ROUNDS {
        if pairs.is_empty() {
            break;
        }
        let mut touched: Vec<u32> = pairs.iter().flatten().flat_map(|&face| mesh.faces[face as usize]).collect();
        touched.sort_unstable();
        touched.dedup();
        let smoothed = |&v: &u32| {
            let ring = rings.of(v as usize);
            let sum = ring.iter().fold([0.0; 3], |sum, &w| add(sum, mesh.vertices[w as usize]));
            scale(add(scale(sum, 1.0 / ring.len() as f64), mesh.vertices[v as usize]), 0.5)
        };
        let positions: Vec<Vec3> = touched.iter().map(smoothed).collect();
        for (&v, position) in touched.iter().zip(positions) {
            mesh.vertices[v as usize] = position;
            moved[v as usize] = true;
        }
        monitor.step(1);
        pairs = self_intersections(mesh, monitor)?;
    }
    monitor.end();
    Ok((pairs.len(), moved.iter().filter(|&&moved| moved).count()))
}
