//! Coarsens a mesh to a tetrahedron by half-edge collapses, which can be undone one at a time: the progressive mesh (H.
//! Hoppe, SIGGRAPH 1996).
//!
//! A collapse v -> u removes vertex v: the two triangles on edge vu vanish, and the other triangles around v get u in
//! place of v. A collapse is allowed if u and v have exactly two common neighbours, because the mesh then remains
//! topologically a sphere. A triangulated sphere of more than four vertices always has an edge that can be collapsed
//! (E. Steinitz), so the tetrahedron is always reached.
//!
//! The order of collapses aims at well-shaped coarse meshes, not at similarity to the surface. The next vertex to be
//! removed is the vertex whose removal leaves the smallest and roundest triangles at vertices of low valence. The area
//! around a removed vertex is distributed over the triangles that replace it, so the areas of a coarse mesh sum to that
//! of the entire surface, and each part of the surface roughly keeps its area. A map that equalises areas therefore
//! reserves the area of an arm before the arm's vertices are inserted.
//!
//! Cost: O(n log n). A heap orders the vertices by cost, and a cost is recomputed when its vertex reaches the top.
//! Computing the cost takes time quadratic in the vertex's number of triangles, so vertices with many triangles aren't
//! removed until they have fewer. There is always a vertex that can be removed and has at most five triangles.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::energy::{Shape, least_area};
use crate::geometry::{Vec3, area, dot, sub};
use crate::hubs::{HUB, Hubs, looked_at};

/// Number of collapses between checks of the monitor and reports of progress.
const CHUNK: u64 = 256;

/// A triangulated sphere that can be coarsened and refined. Vertices and triangles keep their indices.
pub(crate) struct Hierarchy {
    positions: Vec<Vec3>,
    /// Corners of each triangle; meaningless for a removed triangle.
    pub(crate) faces: Vec<[u32; 3]>,
    /// Target area and cotangents of each triangle.
    pub(crate) shapes: Vec<Shape>,
    /// The triangles around each vertex, in an arbitrary but reproducible order; empty for a removed vertex.
    pub(crate) around: Vec<Vec<u32>>,
    hubs: Hubs,
    collapses: Vec<Collapse>,
    /// Number of vertices that currently aren't removed.
    pub(crate) present: usize,
}

/// The data needed to undo a collapse.
pub(crate) struct Collapse {
    vertex: u32,
    into: u32,
    /// The triangles around the vertex before the collapse, with corners and shape. The two triangles that vanish come
    /// first.
    faces: Vec<(u32, [u32; 3], Shape)>,
}

/// A vertex's cost of removal (finite) and index. Ordered by cost, then by index.
#[derive(PartialEq)]
struct Entry(f64, u32);

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0).then(self.1.cmp(&other.1))
    }
}

impl Hierarchy {
    /// Creates the finest level: the surface itself. `areas` are the triangles' target areas on the sphere, 4 pi in
    /// total.
    pub(crate) fn new(positions: &[Vec3], faces: &[[u32; 3]], areas: &[f64]) -> Self {
        let least = least_area(faces.len());
        let shape = |(face, &area): (&[u32; 3], &f64)| Shape::new(face.map(|v| positions[v as usize]), area.max(least));
        let mut around = vec![Vec::new(); positions.len()];
        for (face, f) in faces.iter().zip(0..) {
            face.iter().for_each(|&v| around[v as usize].push(f));
        }
        Self {
            positions: positions.to_vec(),
            faces: faces.to_vec(),
            shapes: faces.iter().zip(areas).map(shape).collect(),
            hubs: Hubs::new(&around, faces),
            around,
            collapses: Vec::new(),
            present: positions.len(),
        }
    }

    /// Returns the neighbours of a vertex counter-clockwise, each with the triangle between it and the next neighbour.
    pub(crate) fn ring(&self, v: u32) -> Vec<(u32, u32)> {
        let around = &self.around[v as usize];
        // (from, to, f) for each triangle f = (v, from, to).
        let spokes: Vec<(u32, u32, u32)> = around
            .iter()
            .map(|&f| {
                let [a, b, c] = self.faces[f as usize];
                let (from, to) = if a == v {
                    (b, c)
                } else if b == v {
                    (c, a)
                } else {
                    (a, b)
                };
                (from, to, f)
            })
            .collect();
        let mut ring = Vec::with_capacity(spokes.len());
        let mut next = spokes.first().map_or(0, |spoke| spoke.0);
        for _ in 0..spokes.len() {
            if let Some(&(from, to, f)) = spokes.iter().find(|spoke| spoke.0 == next) {
                ring.push((from, f));
                next = to;
            }
        }
        debug_assert_eq!(ring.len(), around.len(), "the neighbours of a vertex must form one ring");
        ring
    }

    fn is_neighbour(&self, v: u32, w: u32) -> bool {
        let fewer = self.around[v as usize].len() <= self.around[w as usize].len();
        let (v, w) = if fewer { (v, w) } else { (w, v) };
        let look = || {
            looked_at(self.around[v as usize].len());
            self.around[v as usize].iter().any(|&f| self.faces[f as usize].contains(&w))
        };
        self.hubs.is_neighbour(v, w).unwrap_or_else(look)
    }

    /// Collapses vertices until a tetrahedron is left, and reports each collapse to the monitor as a step. Returns the
    /// tetrahedron's vertices: the three corners of one triangle, then the opposite vertex.
    pub(crate) fn coarsen(&mut self, monitor: &dyn Monitor) -> Result<[u32; 4], Interrupted> {
        let entry = |v: u32| self.best(v).map(|(cost, _)| Reverse(Entry(cost, v)));
        let all: Vec<_> = (0..self.positions.len() as u32).into_par_iter().filter_map(entry).collect();
        let mut is_queued = vec![false; self.positions.len()];
        all.iter().for_each(|Reverse(Entry(_, v))| is_queued[*v as usize] = true);
        let mut heap = BinaryHeap::from(all);
        let mut unreported = 0;
        while self.present > 4 {
            let Some(Reverse(Entry(queued, v))) = heap.pop() else { break };
            // Costs grow as neighbours are removed, so it suffices to recompute the cost of the vertex at the top.
            let Some((cost, u)) = self.best(v) else {
                is_queued[v as usize] = false;
                continue;
            };
            if cost > queued {
                heap.push(Reverse(Entry(cost, v)));
                continue;
            }
            let ring: Vec<u32> = self.ring(v).iter().map(|&(w, _)| w).collect();
            self.collapse(v, u);
            unreported += 1;
            if unreported == CHUNK {
                monitor.check()?;
                monitor.step(CHUNK);
                unreported = 0;
            }
            // The removal can make it possible to remove neighbours that couldn't be removed before.
            for w in ring {
                if is_queued[w as usize] {
                    continue;
                }
                if let Some((cost, _)) = self.best(w) {
                    heap.push(Reverse(Entry(cost, w)));
                    is_queued[w as usize] = true;
                }
            }
        }
        monitor.step(unreported);
        Ok(self.corners_of_the_last())
    }

    fn corners_of_the_last(&self) -> [u32; 4] {
        let last = self.around.iter().position(|around| !around.is_empty()).unwrap_or(0) as u32;
        let face = self.around[last as usize].first().map_or([0; 3], |&f| self.faces[f as usize]);
        let apex = self.ring(face[0]).iter().map(|&(w, _)| w).find(|w| !face.contains(w)).unwrap_or(0);
        [face[0], face[1], face[2], apex]
    }

    /// Returns the cost of removing a vertex, and the neighbour to collapse it into. `None` if the vertex can't be
    /// removed, or belongs to more than [`HUB`] triangles.
    fn best(&self, v: u32) -> Option<(f64, u32)> {
        if self.around[v as usize].len() > HUB {
            return None;
        }
        let ring = self.ring(v);
        let k = ring.len();
        looked_at(k);
        let mut best: Option<(f64, u32)> = None;
        for i in 0..k {
            let u = ring[i].0;
            // Rejects u if u and v have a common neighbour other than the two vertices next to u on the ring.
            let beside = [ring[(i + 1) % k].0, ring[(i + k - 1) % k].0];
            if ring.iter().any(|&(w, _)| w != u && !beside.contains(&w) && self.is_neighbour(u, w)) {
                continue;
            }
            let at = |j: usize| self.positions[ring[(i + j) % k].0 as usize];
            let squared = |a: Vec3, b: Vec3| dot(sub(a, b), sub(a, b));
            let cost: f64 =
                (1..k - 1).map(|j| squared(at(0), at(j)) + squared(at(j), at(j + 1)) + squared(at(j + 1), at(0))).sum();
            let valence = (self.around[u as usize].len() + k - 4) as f64;
            let cost = cost * (1.0 + 0.1 * (valence - 7.0).max(0.0).powi(2));
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, u));
            }
        }
        best
    }

    fn collapse(&mut self, vertex: u32, into: u32) {
        let mut star = std::mem::take(&mut self.around[vertex as usize]);
        self.hubs.forget(vertex);
        star.sort_by_key(|&f| !self.faces[f as usize].contains(&into));
        let faces: Vec<_> = star.iter().map(|&f| (f, self.faces[f as usize], self.shapes[f as usize])).collect();
        let total: f64 = faces.iter().map(|(_, _, shape)| shape.area).sum();
        for &(f, corners, _) in &faces[..2] {
            for w in corners.into_iter().filter(|&w| w != vertex) {
                self.hubs.remove(w, &mut self.around[w as usize], f, corners);
            }
        }
        let kept =
            || faces[2..].iter().map(|&(f, corners, _)| (f, corners.map(|w| if w == vertex { into } else { w })));
        let flat = |corners: [u32; 3]| corners.map(|w| self.positions[w as usize]);
        let sum: f64 = kept().map(|(_, corners)| area(flat(corners))).sum();
        // A tenth of the area is distributed evenly over the triangles. Otherwise a triangle that is thin in space
        // would get no area on the sphere.
        let even = 0.1 / (faces.len() - 2) as f64;
        let new: Vec<_> = kept()
            .map(|(f, corners)| {
                let share = if sum > 0.0 { 0.9 * area(flat(corners)) / sum + even } else { 10.0 * even };
                (f, corners, Shape::new(flat(corners), total * share))
            })
            .collect();
        for (f, corners, shape) in new {
            self.faces[f as usize] = corners;
            self.shapes[f as usize] = shape;
            self.hubs.push(into, &mut self.around[into as usize], f, &self.faces);
            corners.into_iter().filter(|&w| w != into).for_each(|w| self.hubs.rename(w, vertex, into));
        }
        self.collapses.push(Collapse { vertex, into, faces });
        self.present -= 1;
    }

    /// Reinserts the vertex that was removed last. Returns this vertex and the vertex into which it had been collapsed.
    pub(crate) fn refine(&mut self) -> Option<(u32, u32)> {
        let collapse = self.collapses.pop()?;
        Some(self.undo(collapse))
    }

    fn undo(&mut self, Collapse { vertex, into, faces }: Collapse) -> (u32, u32) {
        for &(f, corners, shape) in &faces[2..] {
            let merged = self.faces[f as usize];
            self.hubs.remove(into, &mut self.around[into as usize], f, merged);
            merged.into_iter().filter(|&w| w != into).for_each(|w| self.hubs.rename(w, into, vertex));
            (self.faces[f as usize], self.shapes[f as usize]) = (corners, shape);
        }
        for &(f, corners, shape) in &faces[..2] {
            (self.faces[f as usize], self.shapes[f as usize]) = (corners, shape);
            for w in corners.into_iter().filter(|&w| w != vertex) {
                self.hubs.push(w, &mut self.around[w as usize], f, &self.faces);
            }
        }
        self.around[vertex as usize] = faces.iter().map(|&(f, _, _)| f).collect();
        self.present += 1;
        (vertex, into)
    }

    /// Removes the last `count` collapses from the list and returns them in groups, to be undone group by group with
    /// [`refine_group`](Self::refine_group). The collapses in a group have no triangle in common, so their vertices
    /// aren't neighbours.
    pub(crate) fn groups(&mut self, count: usize) -> Vec<Vec<Collapse>> {
        let last = self.collapses.split_off(self.collapses.len() - count.min(self.collapses.len()));
        // For each triangle, the index of the first group to which another collapse that modifies the triangle can be
        // added. This is the group after the last one with such a collapse.
        let mut free = vec![0_u32; self.faces.len()];
        let mut groups: Vec<Vec<Collapse>> = Vec::new();
        for collapse in last.into_iter().rev() {
            let touched = || collapse.faces.iter().map(|&(f, _, _)| f as usize);
            let group = touched().map(|f| free[f]).max().unwrap_or(0);
            touched().for_each(|f| free[f] = group + 1);
            if groups.len() <= group as usize {
                groups.push(Vec::new());
            }
            groups[group as usize].push(collapse);
        }
        groups
    }

    /// Reinserts the vertices of a group. Returns each vertex with the vertex into which it had been collapsed.
    pub(crate) fn refine_group(&mut self, group: Vec<Collapse>) -> Vec<(u32, u32)> {
        group.into_iter().map(|collapse| self.undo(collapse)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hubs::tests::LOOKED_AT;
    use spharm_monitor::Silent;
    use spharm_surface::Mesh;
    use spharm_surface::generate::{bipyramid, icosphere};
    use spharm_surface::topology::Topology;

    fn present(hierarchy: &Hierarchy) -> Mesh {
        let mut faces: Vec<u32> = hierarchy.around.iter().flatten().copied().collect();
        faces.sort_unstable();
        faces.dedup();
        Mesh::new(hierarchy.positions.clone(), faces.iter().map(|&f| hierarchy.faces[f as usize]).collect())
    }

    #[test]
    fn every_level_is_a_sphere_of_the_same_area_and_the_way_back_ends_at_the_start() {
        let mesh = icosphere(3);
        let mut hierarchy = Hierarchy::new(&mesh.vertices, &mesh.faces, &vec![0.01; mesh.faces.len()]);
        let area = |h: &Hierarchy, mesh: &Mesh| -> f64 {
            let kept = |f: &[u32; 3]| h.faces.iter().position(|g| g == f).unwrap();
            mesh.faces.iter().map(|f| h.shapes[kept(f)].area).sum()
        };
        let whole = area(&hierarchy, &mesh);
        let [a, b, c, d] = hierarchy.coarsen(&Silent).unwrap();
        assert_eq!(hierarchy.present, 4);
        let tetrahedron = present(&hierarchy);
        assert_eq!(tetrahedron.faces.len(), 4);
        assert!(tetrahedron.faces.iter().all(|face| face.iter().all(|v| [a, b, c, d].contains(v))));
        assert!((area(&hierarchy, &tetrahedron) - whole).abs() < 1e-12 * whole);
        let mut levels = 0;
        while let Some((v, u)) = hierarchy.refine() {
            levels += 1;
            assert!(hierarchy.is_neighbour(v, u));
            if levels % 97 == 0 {
                let level = present(&hierarchy);
                let topology = Topology::of(&level);
                assert_eq!(topology.genus(), Some(0), "{topology:?}");
                assert_eq!(topology.vertices - topology.unreferenced_vertices, hierarchy.present);
            }
        }
        assert_eq!(levels, mesh.vertices.len() - 4);
        assert_eq!(hierarchy.faces, mesh.faces);
    }

    #[test]
    fn what_a_vertex_costs_doesnt_grow_with_the_degree_of_its_neighbours() {
        let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let cost = |sides: u32| {
            let Mesh { vertices, faces, .. } = bipyramid(sides);
            one_thread.install(|| {
                LOOKED_AT.with(|count| count.set(0));
                let mut hierarchy = Hierarchy::new(&vertices, &faces, &vec![6.0 / f64::from(sides); faces.len()]);
                hierarchy.coarsen(&Silent).unwrap();
                while hierarchy.refine().is_some() {}
                assert_eq!(hierarchy.faces, faces);
                LOOKED_AT.with(|count| count.get()) as f64 / f64::from(sides)
            })
        };
        let (few, many) = (cost(500), cost(8000));
        assert!(many < 1.2 * few && many < 1000.0, "{few} {many}");
    }

    #[test]
    fn hubs_wait_until_they_have_fewer_triangles_and_groups_lead_back_to_the_start() {
        let sides = 300_u32;
        let Mesh { vertices, faces, .. } = bipyramid(sides);
        let mut hierarchy = Hierarchy::new(&vertices, &faces, &vec![0.02; faces.len()]);
        assert!(hierarchy.best(sides).is_none() && hierarchy.best(0).is_some());
        hierarchy.coarsen(&Silent).unwrap();
        assert_eq!(hierarchy.present, 4);
        for count in [50, 1000] {
            for group in hierarchy.groups(count) {
                let back = hierarchy.refine_group(group);
                for &(v, _) in &back {
                    assert!(back.iter().all(|&(w, _)| v == w || !hierarchy.is_neighbour(v, w)));
                }
            }
            assert_eq!(Topology::of(&present(&hierarchy)).genus(), Some(0));
        }
        assert_eq!(hierarchy.present, vertices.len());
        assert_eq!(hierarchy.faces, faces);
    }
}
