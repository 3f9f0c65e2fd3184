//! Searches for the shortest loop that passes through a given vertex and doesn't separate the surface.
//!
//! The search runs Dijkstra's algorithm from the vertex v, which gives the distance d(w) of each vertex w from v. The
//! shortest loop through v in a homology class consists of two shortest paths from v and an edge ab that joins their
//! ends. The loop's length d(a) + |ab| + d(b) is at least twice the larger of d(a) and d(b). The search therefore ends
//! when twice the distance reaches the length of the shortest loop found, and visits only the vertices within half that
//! length.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::complex::{Complex, Loop, NONE};
use super::homology::Homology;

/// Number of vertices, spread evenly along a loop, from which shorter loops are searched for.
const POINTS: usize = 8;

/// Working memory, 21 bytes per vertex. Before a new search, only the entries that the last search changed are cleared.
pub(super) struct Search {
    distance: Vec<f64>,
    /// For each vertex, the sum of the half-edges' numbers (see `homology`) along the shortest path to it.
    class: Vec<u64>,
    arriving: Vec<u32>,
    settled: Vec<bool>,
    touched: Vec<u32>,
    queue: BinaryHeap<Reverse<(u64, u32)>>,
}

impl Search {
    pub(super) fn new(vertices: usize) -> Self {
        Self {
            distance: vec![f64::INFINITY; vertices],
            class: vec![0; vertices],
            arriving: vec![NONE; vertices],
            settled: vec![false; vertices],
            touched: Vec::new(),
            queue: BinaryHeap::new(),
        }
    }

    /// Returns a loop near a vertex that doesn't separate the surface; `None` if no such loop passes through the
    /// vertex. No shorter loop of this kind passes through any of [`POINTS`] vertices spread evenly along the returned
    /// loop.
    pub(super) fn near(&mut self, complex: &Complex, homology: &Homology, vertex: u32) -> Option<Loop> {
        let mut found = self.through(complex, homology, vertex, f64::INFINITY)?;
        loop {
            let count = found.edges.len();
            let points = POINTS.min(count);
            let bases: Vec<u32> = (0..points).map(|k| complex.from(found.edges[k * count / points])).collect();
            let shorter = bases.into_iter().find_map(|base| self.through(complex, homology, base, found.length));
            match shorter {
                Some(shorter) => found = shorter,
                None => return Some(found),
            }
        }
    }

    /// Returns the shortest loop through a vertex, among those that are shorter than `limit` and don't separate the
    /// surface. If the two paths of the loop begin with the same edges, these edges are removed, which shortens the
    /// loop further.
    fn through(&mut self, complex: &Complex, homology: &Homology, base: u32, limit: f64) -> Option<Loop> {
        self.clear();
        self.reach(base, 0.0, 0, NONE);
        // The tolerance prevents the same loop from being found again with a length that is smaller only because of
        // rounding.
        let mut best = limit * (1.0 - 1e-12);
        let mut closing = NONE;
        while let Some(Reverse((bits, vertex))) = self.queue.pop() {
            let reached = f64::from_bits(bits);
            if 2.0 * reached >= best {
                break;
            }
            if std::mem::replace(&mut self.settled[vertex as usize], true) {
                continue;
            }
            let class = self.class[vertex as usize];
            for h in complex.around(vertex) {
                let to = complex.to(h);
                let (length, along) = (reached + complex.length(h), class.wrapping_add(homology.class(h)));
                let there = self.distance[to as usize];
                if self.settled[to as usize] {
                    if length + there < best && along != self.class[to as usize] {
                        (best, closing) = (length + there, h);
                    }
                } else if length < there {
                    self.reach(to, length, along, h);
                }
            }
        }
        (closing != NONE).then(|| self.loop_over(complex, closing))
    }

    fn reach(&mut self, vertex: u32, distance: f64, class: u64, arriving: u32) {
        let v = vertex as usize;
        if self.distance[v] == f64::INFINITY {
            self.touched.push(vertex);
        }
        (self.distance[v], self.class[v], self.arriving[v]) = (distance, class, arriving);
        self.queue.push(Reverse((distance.to_bits(), vertex)));
    }

    fn clear(&mut self) {
        for v in self.touched.drain(..).map(|v| v as usize) {
            (self.distance[v], self.arriving[v], self.settled[v]) = (f64::INFINITY, NONE, false);
        }
        self.queue.clear();
    }

    /// Returns the loop formed by an edge and the paths to its two ends, without the part that the paths have in
    /// common.
    fn loop_over(&self, complex: &Complex, closing: u32) -> Loop {
        let path = |mut vertex: u32| {
            let mut edges = Vec::new();
            while self.arriving[vertex as usize] != NONE {
                let h = self.arriving[vertex as usize];
                edges.push(h);
                vertex = complex.from(h);
            }
            edges.reverse();
            edges
        };
        let (to, back) = (path(complex.from(closing)), path(complex.to(closing)));
        let common = to.iter().zip(&back).take_while(|(a, b)| a == b).count();
        let mut edges = to[common..].to_vec();
        edges.push(closing);
        edges.extend(back[common..].iter().rev().map(|&h| complex.twin(h)));
        let length = edges.iter().map(|&h| complex.length(h)).sum();
        Loop { edges, length }
    }
}
