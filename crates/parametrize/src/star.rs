//! Moves single vertices of a map: chooses a vertex's position when the vertex is reinserted, and relaxes vertices
//! (moves them to lower the energy) in sweeps.
//!
//! A vertex may only move inside its kernel. The kernel is the set of points from which the entire ring of neighbours
//! is visible in the right order: the intersection of the hemispheres to the left of the ring's edges. A move is made
//! only if it lowers the energy and leaves every triangle around the vertex positive by the exact predicate. If no
//! triangle of a map is flipped, no move flips a triangle, regardless of rounding.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::energy::{Energy, Shape, retract, with_density};
use crate::geometry::{Vec3, add, cross, dot, norm, orientation, scale, sub, unit};
use crate::hierarchy::Hierarchy;
use crate::local::{corner_derivatives, frame, value};

/// The triangles around a vertex. Each triangle is stored as the positions of its two other corners, and its shape,
/// whose cotangents start with that of the angle at the vertex.
pub(crate) struct Star {
    spokes: Vec<([Vec3; 2], Shape)>,
}

impl Star {
    pub(crate) fn of(hierarchy: &Hierarchy, unit: &[Vec3], v: u32) -> Self {
        let mut star = Self { spokes: Vec::new() };
        star.set(hierarchy, unit, v);
        star
    }

    /// Replaces the triangles by those around vertex v, reusing the allocated memory.
    fn set(&mut self, hierarchy: &Hierarchy, unit: &[Vec3], v: u32) {
        let spoke = |&f: &u32| {
            let face = hierarchy.faces[f as usize];
            let shape = hierarchy.shapes[f as usize];
            let at = face.iter().position(|&w| w == v).unwrap_or(0);
            let turn = |k: usize| (at + k) % 3;
            let cotangents = [0, 1, 2].map(|k| shape.cotangents[turn(k)]);
            ([1, 2].map(|k| unit[face[turn(k)] as usize]), Shape { area: shape.area, cotangents })
        };
        self.spokes.clear();
        self.spokes.extend(hierarchy.around[v as usize].iter().map(spoke));
    }

    fn value(&self, energy: Energy, x: Vec3) -> f64 {
        let each = |([a, b], shape): &([Vec3; 2], Shape)| with_density!(energy, density => value(density, [x, *a, *b], shape.cotangents, shape.area));
        self.spokes.iter().map(each).sum()
    }

    /// Returns whether every triangle around the vertex has positive orientation, by the exact predicate, if the vertex
    /// is at x.
    pub(crate) fn is_positive(&self, x: Vec3) -> bool {
        self.spokes.iter().all(|([a, b], _)| orientation([x, *a, *b]) > 0.0)
    }

    /// Returns a position of low energy inside the kernel. `beside` is the position of the vertex into which this
    /// vertex had been collapsed. Returns `None` if no position is found.
    pub(crate) fn place(&self, energy: Energy, beside: Vec3) -> Option<Vec3> {
        let centre = self.spokes.iter().fold([0.0; 3], |sum, ([a, _], _)| add(sum, *a));
        let better = |best: Option<(f64, Vec3)>, x: Vec3| {
            let value = self.value(energy, x);
            let is_better = self.is_positive(x) && best.is_none_or(|(least, _)| value < least);
            if is_better { Some((value, x)) } else { best }
        };
        let mut best = None;
        if norm(centre) > 1e-3 {
            let centre = unit(centre);
            let places = [centre, unit(add(centre, beside)), unit(add(scale(centre, 0.2), beside))];
            best = places.into_iter().fold(None, better);
        }
        if best.is_none() {
            let deepest = self.deepest()?;
            // In a narrow kernel, rounding can put the deepest point outside. Points between the deepest point and
            // `beside` may still be inside, so they are tried as well.
            let shares = [1.0, 0.5, 0.25, 0.125, 0.0625, 1e-2, 1e-3, 1e-4];
            let places = shares.map(|s| unit(add(scale(deepest, s), scale(beside, 1.0 - s))));
            best = places.into_iter().fold(None, better);
        }
        best.map(|(_, x)| x)
    }

    /// Returns the centre of the largest spherical cap inside the vertex's kernel; see the [module](self).
    ///
    /// Let n_i be the unit normals of the planes through the origin and each of the ring's edges. The centre is the
    /// unit vector x for which the smallest of the n_i . x is largest. By duality, x points towards the point nearest
    /// to the origin in the convex hull of the n_i. This point lies in the hull of one, two or three of the n_i. Since
    /// there are few n_i, all combinations are tried.
    fn deepest(&self) -> Option<Vec3> {
        let normals: Vec<Vec3> =
            self.spokes.iter().map(|([a, b], _)| cross(*a, sub(*b, *a))).filter(|n| norm(*n) > 0.0).map(unit).collect();
        let depth = |x: Vec3| normals.iter().map(|n| dot(*n, x)).fold(f64::INFINITY, f64::min);
        let mut best = None;
        let mut deepest = 0.0;
        let mut offer = |x: Vec3| {
            let length = norm(x);
            if length > 0.0 {
                let x = scale(x, 1.0 / length);
                let depth = depth(x);
                if depth > deepest {
                    (best, deepest) = (Some(x), depth);
                }
            }
        };
        let k = normals.len();
        for i in 0..k {
            offer(normals[i]);
            for j in i + 1..k {
                offer(add(normals[i], normals[j]));
                for l in j + 1..k {
                    // x has equal inner products with the three normals, since it is perpendicular to the plane through
                    // them.
                    let x = cross(sub(normals[j], normals[i]), sub(normals[l], normals[i]));
                    offer(x);
                    offer(scale(x, -1.0));
                }
            }
        }
        best
    }

    /// Returns the energy, its gradient and its Hessian (entries 00, 10, 11), summed over the triangles around the
    /// vertex, in the frame of the tangent plane at x.
    fn derivatives(&self, energy: Energy, x: Vec3, frame: [Vec3; 2]) -> [f64; 6] {
        let mut sum = [0.0; 6];
        for ([a, b], shape) in &self.spokes {
            let numbers = with_density!(energy, density => {
                corner_derivatives(density, [x, *a, *b], shape.cotangents, shape.area, frame)
            });
            sum.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
        }
        sum
    }

    /// Takes one Newton step from x, which must be inside the vertex's kernel (see the [module](self)). Returns x
    /// unchanged if the energy can't be lowered.
    pub(crate) fn relax(&self, energy: Energy, x: Vec3) -> Vec3 {
        let [u, v] = frame(x);
        let [value, g0, g1, a, b, c] = self.derivatives(energy, x, [u, v]);
        // The diagonal is shifted slightly in case the Hessian is singular.
        let shift = 1e-3 * (a + c) + f64::MIN_POSITIVE;
        let (a, c) = (a + shift, c + shift);
        let determinant = a * c - b * b;
        let step = [(b * g1 - c * g0) / determinant, (b * g0 - a * g1) / determinant];
        let decrease = step[0] * g0 + step[1] * g1;
        let step = add(scale(u, step[0]), scale(v, step[1]));
        let length = norm(step);
        if !(decrease < 0.0 && length.is_finite()) {
            return x;
        }
        // Steps are limited to the distance to the farthest neighbour, since the quadratic model can't be accurate
        // beyond it.
        let widest = self.spokes.iter().map(|([a, _], _)| norm(sub(*a, x))).fold(0.0, f64::max);
        let mut t = (widest / length).min(1.0);
        for _ in 0..12 {
            let moved = retract(x, scale(step, t));
            if self.value(energy, moved) < value + 1e-4 * t * decrease && self.is_positive(moved) {
                return moved;
            }
            t *= 0.4;
        }
        x
    }
}

/// Sets of vertices that can be relaxed in parallel: no two vertices of a class are neighbours.
pub(crate) struct Classes(Vec<Vec<u32>>);

impl Classes {
    /// Divides vertices into classes such that no two vertices of a class are neighbours, by greedy colouring in the
    /// given order.
    pub(crate) fn new(hierarchy: &Hierarchy, vertices: &[u32]) -> Self {
        const NONE: u32 = u32::MAX;
        let mut colours = vec![NONE; hierarchy.around.len()];
        // For each colour, the last vertex that was found to have a neighbour of that colour.
        let mut seen: Vec<u32> = Vec::new();
        let mut classes: Vec<Vec<u32>> = Vec::new();
        for &v in vertices {
            for &f in &hierarchy.around[v as usize] {
                for w in hierarchy.faces[f as usize] {
                    if colours[w as usize] != NONE {
                        seen[colours[w as usize] as usize] = v;
                    }
                }
            }
            let colour = seen.iter().position(|&last| last != v).unwrap_or(seen.len());
            if colour == seen.len() {
                seen.push(NONE);
                classes.push(Vec::new());
            }
            classes[colour].push(v);
            colours[v as usize] = colour as u32;
        }
        Self(classes)
    }
}

/// Number of vertices that a sweep processes between checks of the monitor.
const CHUNK: usize = 1 << 15;

/// Moves each vertex to lower the energy of the triangles around it. The vertices of a class are moved in parallel, one
/// class after another. Returns the length of the longest move.
pub(crate) fn sweep(
    hierarchy: &Hierarchy,
    unit: &mut [Vec3],
    classes: &Classes,
    energy: Energy,
    monitor: &dyn Monitor,
) -> Result<f64, Interrupted> {
    let mut most: f64 = 0.0;
    for chunk in classes.0.iter().flat_map(|class| class.chunks(CHUNK)) {
        monitor.check()?;
        let relaxed = |star: &mut Star, &v: &u32| {
            star.set(hierarchy, unit, v);
            star.relax(energy, unit[v as usize])
        };
        let start = || Star { spokes: Vec::new() };
        let moved: Vec<Vec3> = chunk.par_iter().with_min_len(128).map_init(start, relaxed).collect();
        for (&v, moved) in chunk.iter().zip(moved) {
            most = most.max(norm(sub(moved, unit[v as usize])));
            unit[v as usize] = moved;
        }
    }
    Ok(most)
}

/// Relaxes a few vertices, one after another.
pub(crate) fn relax_all(hierarchy: &Hierarchy, unit: &mut [Vec3], vertices: &[u32], energy: Energy) {
    for &v in vertices {
        unit[v as usize] = Star::of(hierarchy, unit, v).relax(energy, unit[v as usize]);
    }
}
