//! Maps any closed surface of genus zero to the sphere without flipped triangles, coarse to fine (E. Praun and H.
//! Hoppe, SIGGRAPH 2003).
//!
//! The [`Hierarchy`] is coarsened to a tetrahedron, which is placed on the sphere as a regular tetrahedron. Then the
//! vertices are reinserted in reverse order, each inside the kernel of the ring of its neighbours: the region from
//! which the entire ring is visible. The kernel is never empty, since the entire ring is visible from the neighbour
//! that the vertex was collapsed into. Then the vertex and its neighbours are relaxed, that is, moved to lower the
//! energy. Whenever the number of vertices has doubled, sweeps and Newton steps optimise the entire map. Large features
//! of the surface therefore reach their final areas early, when only few vertices have to be moved.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor, Stage};

use crate::energy::Energy;
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, orientation, unit};
use crate::hierarchy::Hierarchy;
use crate::newton::Newton;
use crate::star::{Classes, Star, relax_all, sweep};

/// Settings of the optimisation that runs while the map is built.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Growth {
    /// The energy to minimise.
    pub(crate) energy: Energy,
    /// Largest number of Newton steps that are taken each time the number of vertices has doubled.
    pub(crate) steps: usize,
    /// Seed of the sphere's initial rotation.
    pub(crate) seed: u64,
}

/// Newton steps are taken on meshes with at least this number of vertices. On smaller meshes, sweeps suffice.
const NEWTON_FROM: usize = 100;

/// Once the mesh has this number of vertices, further vertices are reinserted in groups, in parallel.
const GROUPS_FROM: usize = 1000;

/// Number of vertices between checks of the monitor.
const CHUNK: usize = 64;

/// Maps a closed surface of area 4 pi to the sphere. Returns the map, the number of Newton steps, and the fully refined
/// hierarchy.
pub(crate) fn embed(
    positions: &[Vec3],
    faces: &[[u32; 3]],
    areas: &[f64],
    growth: Growth,
    monitor: &dyn Monitor,
) -> Result<(Vec<Vec3>, usize, Hierarchy), ParametrizeError> {
    let n = positions.len();
    let vertices = n as u64 - 4;
    let mut hierarchy = Hierarchy::new(positions, faces, areas);
    monitor.begin(Stage::counted("coarsening", "vertices"), vertices);
    let corners = hierarchy.coarsen(monitor)?;
    debug_assert_eq!(hierarchy.present, 4);

    let mut map = vec![[0.0; 3]; n];
    for (&v, p) in corners.iter().zip(tetrahedron(growth.seed)) {
        map[v as usize] = p;
    }
    debug_assert!(orientation([0, 1, 2].map(|i| map[corners[i] as usize])) > 0.0);

    monitor.begin(Stage::counted("coarse to fine", "vertices"), vertices);
    let mut present: Vec<u32> = corners.to_vec();
    let mut iterations = 0;
    while hierarchy.present < n {
        let count = hierarchy.present.min(n - hierarchy.present);
        if hierarchy.present < GROUPS_FROM {
            one_by_one(&mut hierarchy, &mut map, &mut present, count, growth.energy, monitor)?;
        } else {
            by_groups(&mut hierarchy, &mut map, &mut present, count, growth.energy, monitor)?;
        }
        if hierarchy.present < n {
            iterations += settle(&hierarchy, &mut map, &present, growth, monitor)?;
        }
    }
    monitor.end();
    Ok((map, iterations, hierarchy))
}

/// Reinserts vertices one at a time, relaxing each vertex and its neighbours before the next one.
fn one_by_one(
    hierarchy: &mut Hierarchy,
    map: &mut [Vec3],
    present: &mut Vec<u32>,
    count: usize,
    energy: Energy,
    monitor: &dyn Monitor,
) -> Result<(), ParametrizeError> {
    for k in 0..count {
        let Some((v, into)) = hierarchy.refine() else { break };
        insert(hierarchy, map, v, into, energy)?;
        present.push(v);
        if k % CHUNK == 0 {
            monitor.check()?;
        }
        monitor.step(1);
    }
    Ok(())
}

/// Reinserts groups of vertices that have no triangle in common. Only the reinserted vertices are relaxed; the sweeps
/// that follow move all vertices.
fn by_groups(
    hierarchy: &mut Hierarchy,
    map: &mut [Vec3],
    present: &mut Vec<u32>,
    count: usize,
    energy: Energy,
    monitor: &dyn Monitor,
) -> Result<(), ParametrizeError> {
    for group in hierarchy.groups(count) {
        monitor.check()?;
        let group = hierarchy.refine_group(group);
        let place = |&(v, into): &(u32, u32)| {
            let star = Star::of(hierarchy, map, v);
            let place = star.place(energy, map[into as usize]);
            place.map(|x| star.relax(energy, x)).ok_or(ParametrizeError::NoPlace { vertex: v as usize })
        };
        let places: Vec<Result<Vec3, ParametrizeError>> = group.par_iter().with_min_len(64).map(place).collect();
        for (&(v, _), place) in group.iter().zip(places) {
            map[v as usize] = place?;
        }
        present.extend(group.iter().map(|&(v, _)| v));
        monitor.step(group.len() as u64);
    }
    Ok(())
}

/// Places a vertex in the kernel of the polygon of its neighbours, then relaxes the vertex and its neighbours.
fn insert(hierarchy: &Hierarchy, map: &mut [Vec3], v: u32, into: u32, energy: Energy) -> Result<(), ParametrizeError> {
    let ring: Vec<u32> = hierarchy.ring(v).iter().map(|&(w, _)| w).collect();
    let place = Star::of(hierarchy, map, v).place(energy, map[into as usize]);
    let Some(place) = place else { return Err(ParametrizeError::NoPlace { vertex: v as usize }) };
    map[v as usize] = place;
    for _ in 0..2 {
        relax_all(hierarchy, map, &[v], energy);
    }
    relax_all(hierarchy, map, &ring, energy);
    relax_all(hierarchy, map, &[v], energy);
    Ok(())
}

/// Approximately optimises the map at one level of the hierarchy. Returns the number of Newton steps.
fn settle(
    hierarchy: &Hierarchy,
    map: &mut [Vec3],
    present: &[u32],
    growth: Growth,
    monitor: &dyn Monitor,
) -> Result<usize, Interrupted> {
    let mut order = present.to_vec();
    order.sort_unstable();
    let classes = Classes::new(hierarchy, &order);
    let rounds = if order.len() < NEWTON_FROM { 20 } else { 2 };
    for _ in 0..rounds {
        if sweep(hierarchy, map, &classes, growth.energy, monitor)? < 1e-4 {
            break;
        }
    }
    if order.len() < NEWTON_FROM {
        return Ok(0);
    }
    let mut index = vec![u32::MAX; hierarchy.around.len()];
    for (i, &v) in order.iter().enumerate() {
        index[v as usize] = i as u32;
    }
    let mut faces: Vec<u32> = order.iter().flat_map(|&v| hierarchy.around[v as usize].iter().copied()).collect();
    faces.sort_unstable();
    faces.dedup();
    let corners = faces.iter().map(|&f| hierarchy.faces[f as usize].map(|v| index[v as usize])).collect();
    let shapes = faces.iter().map(|&f| hierarchy.shapes[f as usize]).collect();
    let Some(mut newton) = Newton::new(order.len(), corners, shapes, monitor)? else { return Ok(0) };
    let mut level: Vec<Vec3> = order.iter().map(|&v| map[v as usize]).collect();
    let mut taken = 0;
    for _ in 0..growth.steps {
        let step = newton.step(growth.energy, &mut level, monitor)?;
        taken += 1;
        if step.left(step.before - step.after) < 1e-3 * step.before {
            break;
        }
    }
    for (&v, p) in order.iter().zip(level) {
        map[v as usize] = p;
    }
    Ok(taken)
}

/// Returns the vertices of a regular tetrahedron, rotated according to the seed. Triangle 0 1 2 is counter-clockwise
/// seen from outside, and vertex 3 is opposite it.
fn tetrahedron(seed: u64) -> [Vec3; 4] {
    let corners = [[-1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]];
    // A unit quaternion from four random numbers; seed 0 gives no rotation.
    let mut state = seed;
    let mut draw = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = state;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let q = if seed == 0 { [1.0, 0.0, 0.0, 0.0] } else { [(); 4].map(|()| draw()) };
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|c| c / length);
    corners.map(|[a, b, c]| {
        unit([
            (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c,
            2.0 * (x * y + w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z - w * x) * c,
            2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c,
        ])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tetrahedron_is_positive_whatever_the_seed() {
        for seed in 0..50 {
            let t = tetrahedron(seed);
            for face in [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]] {
                assert!(orientation(face.map(|i: usize| t[i])) > 0.0, "seed {seed}");
            }
        }
    }
}
