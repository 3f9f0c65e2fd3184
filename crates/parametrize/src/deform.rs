//! A sphere's mesh deformed onto the surface (the way of M. Chung and S. Robbins).
//!
//! The result is a surface with the icosphere's vertices and triangles; what corresponds to a direction is the vertex with
//! the same number. Studies get a shared sampling out of it, with springs that keep the triangles alike.
//!
//! # The way taken
//!
//! In the original a mesh is pulled towards the surface through space (D. MacDonald, N. Kabani, D. Avis, A. Evans,
//! NeuroImage 12, 2000; S. Robbins, MSc thesis, McGill, 2003). Where a surface is far from convex, as an arm or a fold is,
//! the nearest point is on the wrong side and the mesh gets stuck or pierces itself; the original starts close, which a
//! general tool can't. So this one begins with a map of the surface onto the sphere that is one to one (any of this crate's
//! methods), which says where each vertex of the icosphere belongs, and moves the vertices *on* the surface, coarse to fine:
//!
//! 1. a coarse icosphere's vertices take the places that the map gives them;
//! 2. in sweeps, each vertex goes with its forces, then to the surface's nearest point, which the map takes back to the
//!    sphere; it goes only where all triangles around it stay positively oriented there, by an exact predicate, and well
//!    shaped on the surface. So the mesh winds around the surface once, always, and no vertex jumps over a fold to a sheet
//!    that is near in space only;
//! 3. each triangle is split in four, at its edges' midpoints on the sphere, and 2 is repeated.
//!
//! Forces on vertex i with neighbours j, l_ij the length of the path on the surface that the map makes of the arc from i
//! to j (a chord would see nothing of a fold that a coarse triangle spans), t_ij the direction in which it leaves i:
//!
//! - *stretch*: mean over j of (l_ij - L_ij) t_ij, springs of rest length L_ij, which is the icosphere's own edge scaled by
//!   the square root of the areas' ratio;
//! - *bending*: U_i - mean of U_j, U_i = mean of l_ij t_ij, which smooths how the spacing changes. The surface alone
//!   decides the shape: what of the forces leaves the surface is lost in the projection.
//!
//! Last, triangles that cut through each other (chords that cross where a fold is narrower than the triangles) are looked
//! for with a bounding-volume hierarchy, and the vertices around are smoothed until there are none, which takes them off
//! the surface a little. What is left is reported; more subdivisions help, where the given surface doesn't cut itself.
//!
//! # Cost
//!
//! O(vertices log triangles) a sweep; 40,962 vertices take some ten seconds on two cores. Memory is linear.

use std::time::Instant;

use rayon::prelude::*;
use spharm_surface::Mesh;
use spharm_surface::generate::{icosphere, subdivide_sphere};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::sphere_locator::SphereLocator;

use crate::crossings::crossings;
use crate::geometry::{Vec3, add, area, norm, orientation, scale, sub, unit};
use crate::resample::{Resampled, locator, positions, unit_vectors};
use crate::{Event, ParametrizeError, Progress};

/// How to deform.
#[derive(Clone, Debug, PartialEq)]
pub struct DeformParams {
    /// The icosphere's subdivisions; `None` for the fewest with at least as many vertices as the surface, at most 7.
    pub subdivisions: Option<u32>,
    /// Weight of the stretch.
    pub stretch: f64,
    /// Weight of the bending.
    pub bending: f64,
    /// Sweeps over the vertices at each level.
    pub sweeps: usize,
}

impl Default for DeformParams {
    fn default() -> Self {
        Self { subdivisions: None, stretch: 0.5, bending: 0.1, sweeps: 15 }
    }
}

/// Most subdivisions: 10 million vertices.
const MOST: u32 = 10;
/// The coarsest level.
const COARSEST: u32 = 3;
/// The shape below which no triangle may fall, nor get worse: springs under pressure would flatten them.
const SHAPE: f64 = 0.4;
/// Rounds of smoothing where triangles cut each other.
const ROUNDS: usize = 30;

/// Deforms an icosphere onto a surface, from a map of it onto the sphere that is one to one.
///
/// # Errors
///
/// [`NotBijective`](ParametrizeError::NotBijective) where `sphere` has folds;
/// [`Argument`](ParametrizeError::Argument) for more than 10 subdivisions.
///
/// # Panics
///
/// When the sphere doesn't have the surface's number of vertices.
pub fn deform(
    surface: &Mesh,
    sphere: &Mesh,
    params: &DeformParams,
    progress: Progress<'_>,
) -> Result<Resampled, ParametrizeError> {
    let started = Instant::now();
    assert_eq!(surface.vertices.len(), sphere.vertices.len(), "vertices of the surface and of its sphere");
    let enough = |s: &u32| 10 * 4_usize.pow(*s) + 2 >= surface.vertices.len();
    let finest = params.subdivisions.unwrap_or_else(|| (0..7).find(enough).unwrap_or(7));
    if finest > MOST {
        let found = finest.to_string();
        return Err(ParametrizeError::Argument { what: "subdivisions", expected: "at most 10", found });
    }
    let total: f64 = surface.faces.iter().map(|face| area(face.map(|v| surface.vertices[v as usize]))).sum();
    let ground = Ground {
        tree: TriangleTree::new(surface),
        surface,
        sphere: unit_vectors(sphere)?,
        locator: locator(sphere)?,
        scale: (total / (4.0 * std::f64::consts::PI)).sqrt(),
    };
    let coarsest = finest.min(COARSEST);
    let levels = u64::from(finest - coarsest + 1);
    progress(Event::Begin { stage: "coarse to fine", steps: levels * params.sweeps as u64 });

    let mut reference = icosphere(coarsest);
    let mut on_sphere = reference.clone();
    let mut mesh = Deformed::new(&reference, &on_sphere.vertices, &ground, pieces(finest - coarsest))?;
    let mut sweeps = 0;
    for level in coarsest..=finest {
        if level > coarsest {
            // The icosphere's own order: its vertices are the first of the next one's.
            on_sphere = subdivide_sphere(&on_sphere);
            reference = icosphere(level);
            mesh = Deformed::new(&reference, &on_sphere.vertices, &ground, pieces(finest - level))?;
        }
        for _ in 0..params.sweeps {
            mesh.sweep(&ground, params);
            sweeps += 1;
            progress(Event::Step(1));
        }
        on_sphere.vertices.clone_from(&mesh.on_sphere);
    }
    let mut deformed = Mesh::new(mesh.positions, reference.faces.clone());
    deformed.meta.clone_from(&surface.meta);
    let (left, smoothed) = part(&mut deformed, &mesh.rings);
    let mut result = Resampled::new("deform", surface, deformed, reference, started)?;
    let report = &mut result.map.report;
    report.iterations = sweeps;
    if smoothed > 0 {
        report.notes.push(format!("{smoothed} vertices were smoothed where triangles cut through each other"));
    }
    if left > 0 {
        report.notes.push(format!(
            "{left} pairs of triangles still cut through each other: take more subdivisions, if the given surface doesn't \
             cut itself"
        ));
    }
    report.seconds = started.elapsed().as_secs_f64();
    result.self_intersections = Some(left);
    Ok(result)
}

/// In how many pieces to measure an edge that will be split so many times.
fn pieces(splits: u32) -> u32 {
    2 << splits.min(6)
}

/// What is deformed onto: the surface and its map.
struct Ground<'a> {
    tree: TriangleTree,
    surface: &'a Mesh,
    sphere: Vec<Vec3>,
    locator: SphereLocator,
    /// Length on the surface of one radian on the sphere, on average.
    scale: f64,
}

impl Ground<'_> {
    /// The surface's point under a direction.
    fn point(&self, direction: Vec3) -> Option<Vec3> {
        let place = self.locator.locate(direction)?;
        let corners = self.locator.corners(&place).into_iter().zip(place.barycentric);
        Some(corners.fold([0.0; 3], |at, (v, w)| add(at, scale(self.surface.vertices[v as usize], w))))
    }

    /// The path that the map makes of the arc from one direction to another, in so many pieces: its length times the
    /// direction in which it begins. `from` and `to` are where the ends lie.
    fn path(&self, ends: [Vec3; 2], [from, to]: [Vec3; 2], pieces: u32) -> Vec3 {
        let (mut last, mut length, mut first) = (from, 0.0, None);
        for k in 1..=pieces {
            let t = f64::from(k) / f64::from(pieces);
            let between = || self.point(unit(add(scale(ends[0], 1.0 - t), scale(ends[1], t))));
            let Some(next) = (if k == pieces { Some(to) } else { between() }) else { continue };
            let step = sub(next, last);
            let long = norm(step);
            if long > 0.0 {
                first.get_or_insert(scale(step, 1.0 / long));
            }
            length += long;
            last = next;
        }
        scale(first.unwrap_or([0.0; 3]), length)
    }

    /// The surface's point nearest to a point, and where the map takes it.
    fn nearest(&self, point: Vec3) -> Option<(Vec3, Vec3)> {
        let found = self.tree.nearest(point)?;
        let corners = self.surface.faces[found.triangle as usize];
        let weighed = |points: &[Vec3]| {
            let sum = |at: Vec3, (v, w): (u32, f64)| add(at, scale(points[v as usize], w));
            corners.into_iter().zip(found.barycentric).fold([0.0; 3], sum)
        };
        Some((weighed(&self.surface.vertices), unit(weighed(&self.sphere))))
    }
}

/// The mesh at one level.
struct Deformed {
    positions: Vec<Vec3>,
    /// Where the map takes them: triangles positively oriented.
    on_sphere: Vec<Vec3>,
    rings: Rings,
    /// Rest lengths, in the order of the rings.
    rest: Vec<f64>,
    /// Pieces in which an edge's path is measured.
    pieces: u32,
}

impl Deformed {
    fn new(reference: &Mesh, on_sphere: &[Vec3], ground: &Ground<'_>, pieces: u32) -> Result<Self, ParametrizeError> {
        let rings = Rings::new(reference);
        let length = |v: usize, w: u32| norm(sub(reference.vertices[w as usize], reference.vertices[v]));
        let rest = (0..on_sphere.len()).flat_map(|v| rings.of(v).iter().map(move |&w| ground.scale * length(v, w)));
        let rest = rest.collect();
        let positions = positions(&ground.locator, ground.surface, on_sphere)?;
        Ok(Self { positions, on_sphere: on_sphere.to_vec(), rings, rest, pieces })
    }

    /// Each vertex once: all forces from where the vertices are, then the moves in order.
    fn sweep(&mut self, ground: &Ground<'_>, params: &DeformParams) {
        let n = self.positions.len();
        let paths: Vec<Vec<Vec3>> = (0..n).into_par_iter().map(|v| self.paths(v, ground)).collect();
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
        let targets: Vec<_> = (0..n).into_par_iter().map(target).collect();
        for (v, target) in targets.into_iter().enumerate() {
            let Some((place, direction)) = target else { continue };
            let shape = self.shape(v);
            let before = std::mem::replace(&mut self.on_sphere[v], direction);
            let stood = std::mem::replace(&mut self.positions[v], place);
            if !self.turns_well(v) || self.shape(v) < shape.min(SHAPE) {
                (self.on_sphere[v], self.positions[v]) = (before, stood);
            }
        }
    }

    /// The paths to a vertex's neighbours.
    fn paths(&self, v: usize, ground: &Ground<'_>) -> Vec<Vec3> {
        let to = |&w: &u32| {
            let pair = |points: &[Vec3]| [points[v], points[w as usize]];
            ground.path(pair(&self.on_sphere), pair(&self.positions), self.pieces)
        };
        self.rings.of(v).iter().map(to).collect()
    }

    /// The worst of the triangles around a vertex: 4 sqrt3 area over the sum of squared edges, 1 for equal edges.
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

    /// Whether the triangles around a vertex are positively oriented on the sphere.
    fn turns_well(&self, v: usize) -> bool {
        let ring = self.rings.of(v);
        (0..ring.len()).all(|k| {
            let (a, b) = (ring[k] as usize, ring[(k + 1) % ring.len()] as usize);
            orientation([self.on_sphere[v], self.on_sphere[a], self.on_sphere[b]]) > 0.0
        })
    }
}

/// Each vertex's neighbours, counter-clockwise seen from outside.
struct Rings {
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Rings {
    /// Of a closed mesh, wound consistently.
    fn new(mesh: &Mesh) -> Self {
        // In triangle (v, a, b), b follows a around v.
        let mut pairs: Vec<[u32; 3]> =
            mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b, c], [b, c, a], [c, a, b]]).collect();
        pairs.sort_unstable();
        let mut starts = vec![0];
        let mut neighbours = Vec::with_capacity(pairs.len());
        for fan in pairs.chunk_by(|x, y| x[0] == y[0]) {
            let mut next = fan[0][1];
            for _ in fan {
                neighbours.push(next);
                next = fan.binary_search_by_key(&next, |pair| pair[1]).map_or(next, |at| fan[at][2]);
            }
            starts.push(neighbours.len() as u32);
        }
        Self { starts, neighbours }
    }

    fn of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

/// Smooths around triangles that cut each other until none do: how many pairs are left, and how many vertices were moved.
fn part(mesh: &mut Mesh, rings: &Rings) -> (usize, usize) {
    let mut moved = vec![false; mesh.vertices.len()];
    let mut found = crossings(mesh);
    let mut round = 0;
    while !found.is_empty() && round < ROUNDS {
        let mut touched: Vec<u32> = found.iter().flatten().flat_map(|&face| mesh.faces[face as usize]).collect();
        touched.sort_unstable();
        touched.dedup();
        let towards = |&v: &u32| {
            let ring = rings.of(v as usize);
            let sum = ring.iter().fold([0.0; 3], |sum, &w| add(sum, mesh.vertices[w as usize]));
            scale(add(scale(sum, 1.0 / ring.len() as f64), mesh.vertices[v as usize]), 0.5)
        };
        let places: Vec<Vec3> = touched.iter().map(towards).collect();
        for (&v, place) in touched.iter().zip(places) {
            mesh.vertices[v as usize] = place;
            moved[v as usize] = true;
        }
        found = crossings(mesh);
        round += 1;
    }
    (found.len(), moved.iter().filter(|&&moved| moved).count())
}
