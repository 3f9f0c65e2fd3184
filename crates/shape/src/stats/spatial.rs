//! Computes statistics of regions: threshold-free cluster enhancement (TFCE), and clusters above a threshold.
//!
//! TFCE is from S. M. Smith and T. E. Nichols, "Threshold-free cluster enhancement", NeuroImage 44 (2009). The enhanced
//! statistic of a vertex with statistic t is
//!
//! ```text
//! integral from 0 to t of e(h)^E h^H dh,   E = 1, H = 2,
//! ```
//!
//! where e(h) is the area of the connected region around the vertex in which statistics are at least h. E and H have
//! the values that FSL uses for surfaces (`randomise --T2`). The integral is computed exactly, not approximated by a
//! sum over steps of h. A cluster consists of connected vertices above a threshold, and its statistic is its area (K.
//! J. Friston et al., "Assessing the significance of focal activations using their spatial extent", Human Brain Mapping
//! 1 (1994)). Vertices with positive statistics and vertices with negative statistics belong to separate regions.
//!
//! # Computation
//!
//! Vertices are added in decreasing order of their statistic to a forest of regions (union by area, with path halving
//! of offsets). The root of a region stores its own integral, down to the current height. Every other vertex stores the
//! difference between its integral and its parent's integral. Cost: a sort and about 12 operations on the forest per
//! vertex, 1 ms for 10,242 vertices. Memory: 40 bytes per vertex.

use std::collections::HashMap;

use spharm_surface::geometry::{cross, dot, sub};

use crate::ShapeError;

/// Graph of the tested vertices on the surface, with the neighbours and the area of each vertex.
#[derive(Debug, Clone)]
pub struct SurfaceGraph {
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    areas: Vec<f64>,
}

impl SurfaceGraph {
    /// Creates the graph of a mesh with V vertices. The area of a vertex is a third of the area of its triangles.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Differ`] if a triangle has a corner that isn't a vertex of the mesh.
    pub fn new(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> Result<Self, ShapeError> {
        let count = vertices.len();
        let mut ends = Vec::with_capacity(6 * faces.len());
        let mut areas = vec![0.0; count];
        for face in faces {
            if let Some(far) = face.iter().find(|v| **v as usize >= count) {
                let (expected, found) = (count, *far as usize + 1);
                return Err(ShapeError::Differ { what: "number of vertices that triangles refer to", expected, found });
            }
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            let normal = cross(sub(b, a), sub(c, a));
            let third = dot(normal, normal).sqrt() / 6.0;
            for k in 0..3 {
                areas[face[k] as usize] += third;
                ends.extend([[face[k], face[(k + 1) % 3]], [face[(k + 1) % 3], face[k]]]);
            }
        }
        Ok(Self::of(ends, areas))
    }

    fn of(mut ends: Vec<[u32; 2]>, areas: Vec<f64>) -> Self {
        ends.sort_unstable();
        ends.dedup();
        let mut starts = vec![0; areas.len() + 1];
        ends.iter().for_each(|[v, _]| starts[*v as usize + 1] += 1);
        (1..starts.len()).for_each(|v| starts[v] += starts[v - 1]);
        Self { starts, neighbours: ends.into_iter().map(|[_, w]| w).collect(), areas }
    }

    /// Returns the number of vertices of the graph, V.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.areas.len()
    }

    /// Returns the subgraph of the vertices that the mask `kept` (V) selects.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Differ`] if the length of the mask isn't V.
    pub fn at(&self, kept: &[bool]) -> Result<Self, ShapeError> {
        if kept.len() != self.vertices() {
            let (expected, found) = (self.vertices(), kept.len());
            return Err(ShapeError::Differ { what: "number of vertices of the mask", expected, found });
        }
        let mut number = vec![None; kept.len()];
        (0..).zip((0..kept.len()).filter(|v| kept[*v])).for_each(|(new, v): (u32, usize)| number[v] = Some(new));
        let edges = (0..kept.len()).flat_map(|v| self.near(v).iter().map(move |w| (v, *w as usize)));
        let ends = edges.filter_map(|(v, w)| Some([number[v]?, number[w]?])).collect();
        let areas = (0..kept.len()).filter(|v| kept[*v]).map(|v| self.areas[v]).collect();
        Ok(Self::of(ends, areas))
    }

    fn near(&self, v: usize) -> &[u32] {
        &self.neighbours[self.starts[v] as usize..self.starts[v + 1] as usize]
    }
}

/// Settings of the statistics of regions: TFCE and clusters.
#[derive(Debug, Clone)]
pub struct SpatialParams {
    /// Graph of the tested vertices on the surface.
    pub surface: SurfaceGraph,
    /// Whether to compute TFCE.
    pub tfce: bool,
    /// Uncorrected p value, in (0, 1), below which vertices belong to clusters; usually 0.001. `None` omits clusters.
    pub cluster: Option<f64>,
}

/// Threshold-free cluster enhancement (TFCE) at each of V vertices.
#[derive(Debug, Clone)]
pub struct Tfce {
    /// Enhanced statistics (V), with the signs of the original statistics.
    pub statistic: Vec<f64>,
    /// Family-wise p values (V): the fraction of relabelled studies whose largest enhanced statistic reaches the
    /// enhanced statistic at the vertex.
    pub p: Vec<f64>,
}

/// Clusters of connected vertices with statistics above a threshold.
#[derive(Debug, Clone)]
pub struct Clusters {
    /// Smallest absolute statistic of a vertex in a cluster.
    pub threshold: f64,
    /// Number of each vertex's cluster (V), counted from 1; 0 for vertices outside all clusters.
    pub of: Vec<u32>,
    /// Clusters, in order of decreasing area.
    pub clusters: Vec<Cluster>,
}

/// Connected vertices whose absolute statistics reach the threshold and whose signs are equal.
#[derive(Debug, Clone, PartialEq)]
pub struct Cluster {
    /// Number of vertices.
    pub vertices: usize,
    /// Area on the surface, in the square of the surface's unit.
    pub area: f64,
    /// Vertex with the largest absolute statistic.
    pub peak: usize,
    /// Signed statistic at the peak.
    pub statistic: f64,
    /// Family-wise p value: the fraction of relabelled studies whose largest cluster has at least this area.
    pub p: f64,
}

/// Largest statistics of regions in one study.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Largest {
    pub(crate) tfce: f64,
    pub(crate) area: f64,
}

/// Forest of the connected regions of the vertices added so far, with working memory for all vertices.
pub(crate) struct Regions<'a> {
    surface: &'a SurfaceGraph,
    order: Vec<(f64, u32)>,
    /// Parent of each vertex in the forest. A root is its own parent. Vertices that haven't been added yet have the
    /// value `OUTSIDE`.
    above: Vec<u32>,
    /// TFCE integral of each vertex minus its parent's integral; for a root, the integral itself.
    integral: Vec<f64>,
    /// For each root of the forest, the area of the connected region that the root represents. `height` is the height
    /// down to which the region's integrals are computed, and `best` is the largest of these integrals.
    area: Vec<f64>,
    height: Vec<f64>,
    best: Vec<f64>,
}

const OUTSIDE: u32 = u32::MAX;

impl<'a> Regions<'a> {
    pub(crate) fn new(surface: &'a SurfaceGraph) -> Self {
        let n = surface.vertices();
        Self {
            surface,
            order: Vec::with_capacity(n),
            above: vec![OUTSIDE; n],
            integral: vec![0.0; n],
            area: vec![0.0; n],
            height: vec![0.0; n],
            best: vec![0.0; n],
        }
    }

    /// Returns the largest TFCE and the largest area of a cluster above `threshold`, among positive and negative
    /// statistics.
    pub(crate) fn largest(&mut self, statistics: &[f64], tfce: bool, threshold: Option<f64>) -> Largest {
        let mut largest = Largest::default();
        for sign in [1.0, -1.0] {
            let lowest = if tfce { 0.0 } else { threshold.unwrap_or(0.0) };
            self.fill(statistics, sign, lowest, |height, area| {
                if threshold.is_some_and(|threshold| height >= threshold) {
                    largest.area = largest.area.max(area);
                }
            });
            if tfce {
                largest.tfce = largest.tfce.max(self.finish());
            }
        }
        largest
    }

    /// Returns the enhanced statistic (TFCE) at each vertex, with the sign of the original statistic.
    pub(crate) fn tfce(&mut self, statistics: &[f64]) -> Vec<f64> {
        let mut found = vec![0.0; statistics.len()];
        for sign in [1.0, -1.0] {
            self.fill(statistics, sign, 0.0, |_, _| {});
            self.finish();
            for at in 0..self.order.len() {
                let v = self.order[at].1;
                found[v as usize] = sign * self.integral_of(v);
            }
        }
        found
    }

    /// Returns the clusters of vertices with an absolute statistic of at least `threshold`, and the cluster of each
    /// vertex. The p values are set to 1.
    pub(crate) fn clusters(&mut self, statistics: &[f64], threshold: f64) -> Clusters {
        let mut found: Vec<(Cluster, Vec<u32>)> = Vec::new();
        for sign in [1.0, -1.0] {
            self.fill(statistics, sign, threshold, |_, _| {});
            let mut of_root = HashMap::new();
            for at in 0..self.order.len() {
                let v = self.order[at].1;
                let root = self.root(v);
                let number = *of_root.entry(root).or_insert_with(|| {
                    // Vertices are in decreasing order of their statistic, so the first one is the peak.
                    let (peak, area) = (v as usize, self.area[root as usize]);
                    let cluster = Cluster { vertices: 0, area, peak, statistic: statistics[peak], p: 1.0 };
                    found.push((cluster, Vec::new()));
                    found.len() - 1
                });
                found[number].0.vertices += 1;
                found[number].1.push(v);
            }
        }
        found.sort_by(|(a, _), (b, _)| b.area.total_cmp(&a.area).then(a.peak.cmp(&b.peak)));
        let mut of = vec![0; statistics.len()];
        for (number, (_, members)) in (1..).zip(&found) {
            members.iter().for_each(|v| of[*v as usize] = number);
        }
        Clusters { threshold, of, clusters: found.into_iter().map(|(cluster, _)| cluster).collect() }
    }

    /// Builds the forest of the vertices whose height is above 0 and at least `lowest`. The height of a vertex is its
    /// statistic times `sign`. After adding a vertex, calls `joined` with the vertex's height and the area of its
    /// region.
    fn fill(&mut self, statistics: &[f64], sign: f64, lowest: f64, mut joined: impl FnMut(f64, f64)) {
        self.order.clear();
        let heights = statistics.iter().map(|value| sign * value).zip(0..);
        self.order.extend(heights.filter(|(height, _)| *height > 0.0 && *height >= lowest));
        self.order.sort_unstable_by(|(a, v), (b, w)| b.total_cmp(a).then(v.cmp(w)));
        self.above.fill(OUTSIDE);
        for at in 0..self.order.len() {
            let (height, v) = self.order[at];
            let root = self.add(v, height);
            joined(height, self.area[root as usize]);
        }
    }

    /// Continues the TFCE integrals of all connected regions of vertices down to height 0, and returns the largest
    /// integral.
    fn finish(&mut self) -> f64 {
        let mut largest = 0.0_f64;
        for at in 0..self.order.len() {
            let v = self.order[at].1;
            if self.above[v as usize] == v {
                self.grow(v, 0.0);
                largest = largest.max(self.best[v as usize]);
            }
        }
        largest
    }

    /// Adds a vertex and returns the root of its region. Vertices must be added in descending order of their heights.
    fn add(&mut self, v: u32, height: f64) -> u32 {
        let at = v as usize;
        self.above[at] = v;
        (self.integral[at], self.best[at]) = (0.0, 0.0);
        (self.area[at], self.height[at]) = (self.surface.areas[at], height);
        let surface = self.surface;
        let mut root = v;
        for w in surface.near(at) {
            if self.above[*w as usize] == OUTSIDE {
                continue;
            }
            let other = self.root(*w);
            if other != root {
                root = self.join(root, other, height);
            }
        }
        root
    }

    /// Extends a region's integrals from the height reached so far down to `height`.
    fn grow(&mut self, root: u32, height: f64) {
        let at = root as usize;
        let from = self.height[at];
        let more = self.area[at] * (from * from * from - height * height * height) / 3.0;
        self.integral[at] += more;
        self.best[at] += more;
        self.height[at] = height;
    }

    /// Joins two regions at a height, and returns the root of the joint region.
    fn join(&mut self, a: u32, b: u32, height: f64) -> u32 {
        self.grow(a, height);
        self.grow(b, height);
        let (keep, other) = if self.area[a as usize] >= self.area[b as usize] { (a, b) } else { (b, a) };
        let (k, o) = (keep as usize, other as usize);
        self.above[o] = keep;
        self.integral[o] -= self.integral[k];
        self.area[k] += self.area[o];
        self.best[k] = self.best[k].max(self.best[o]);
        keep
    }

    /// Returns the root of a vertex's region, and shortens the path to it.
    fn root(&mut self, mut v: u32) -> u32 {
        loop {
            let above = self.above[v as usize];
            let next = self.above[above as usize];
            if above == v || next == above {
                return above;
            }
            self.integral[v as usize] += self.integral[above as usize];
            self.above[v as usize] = next;
            v = next;
        }
    }

    fn integral_of(&self, mut v: u32) -> f64 {
        let mut sum = self.integral[v as usize];
        while self.above[v as usize] != v {
            v = self.above[v as usize];
            sum += self.integral[v as usize];
        }
        sum
    }
}
