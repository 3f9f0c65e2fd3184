//! Computes short loops that generate the homology of a closed surface (the greedy system of loops), and a number for
//! each half-edge such that the sum along a closed path identifies the path's homology class.
//!
//! The algorithm is by J. Erickson and K. Whittlesey, "Greedy optimal homotopy and homology generators", SODA (2005).
//! In the following, T is the tree of shortest paths from a base point, and d(v) is the distance of vertex v from the
//! base point. The weight of an edge e = ab outside T is d(a) + |e| + d(b), the length of the shortest loop through the
//! base point and e. C is the maximum spanning tree of the dual graph among the edges outside T. On a surface of genus
//! g, 2 g edges belong to neither T nor C. The loops of these edges generate the homology, and are the shortest loops
//! through the base point that generate it. The algorithm takes O(n log n) time.
//!
//! A closed path that visits no vertex twice separates the surface if and only if it is homologous to zero (orientable
//! surfaces, integer coefficients). To test this, each edge i in neither T nor C is assigned a number r_i, and each
//! edge of T the number zero. The edges of C are assigned numbers from the leaves of C to its root, such that the
//! numbers around each face sum to zero. The numbers along a closed path of class (k_1, ..., k_2g) then sum to the sum
//! of the products k_i r_i. The r_i are random 64-bit numbers and sums are modulo 2^64. A sum of zero therefore means
//! class zero, except with a probability of about 2^-64, and a class takes 8 bytes per edge instead of 2 g numbers. A
//! nonzero sum proves that the path doesn't separate the surface, so an unlucky choice of numbers never causes a wrong
//! cut. Such a choice could only cause the search to miss a loop.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use spharm_surface::topology::UnionFind;

use super::complex::{Complex, NONE};

/// The generators of a surface's homology, and the numbers of half-edges from which a path's homology class is
/// computed.
pub(super) struct Homology {
    /// The number assigned to each half-edge; the sum along a path is the path's class. The two half-edges of an edge
    /// have opposite numbers.
    class: Vec<u64>,
    /// The generators: the 2 g edges that belong to neither T nor C, each given by one of its half-edges.
    pub(super) generators: Vec<u32>,
}

/// The set that an edge of the complex belongs to.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    /// The tree of shortest paths, T.
    Path,
    /// The spanning tree of the dual graph, C.
    Dual,
    /// The generators, which belong to neither tree.
    Generator,
}

impl Homology {
    /// Computes the generators of a connected complex, using loops through the vertex `base`, and the number of each
    /// half-edge (see the field `class`).
    pub(super) fn of(complex: &Complex, base: u32) -> Self {
        let (distance, arriving) = shortest_paths(complex, base);
        let mut place = vec![Place::Generator; complex.half_edges() as usize];
        let mut set = |h: u32, as_: Place| {
            place[h as usize] = as_;
            place[complex.twin(h) as usize] = as_;
        };
        for &h in arriving.iter().filter(|&&h| h != NONE) {
            set(h, Place::Path);
        }
        let through =
            |h: u32| distance[complex.from(h) as usize] + complex.length(h) + distance[complex.to(h) as usize];
        // Lengths are stored as bit patterns, because the bit patterns of nonnegative floats have the same order as the
        // floats.
        let mut others: Vec<(u64, u32)> = (0..complex.half_edges())
            .filter(|&h| h < complex.twin(h))
            .filter(|&h| arriving[complex.to(h) as usize] != h && arriving[complex.from(h) as usize] != complex.twin(h))
            .map(|h| (through(h).to_bits(), h))
            .collect();
        others.sort_unstable_by_key(|&(length, h)| (Reverse(length), h));
        let mut joined = UnionFind::new(complex.faces());
        let mut generators = Vec::new();
        for &(_, h) in &others {
            let (left, right) = (complex.face(h), complex.face(complex.twin(h)));
            if joined.root(left) == joined.root(right) {
                generators.push(h);
            } else {
                joined.join(left, right);
                set(h, Place::Dual);
            }
        }
        let class = classes(complex, &place, &generators);
        Self { class, generators }
    }

    /// Returns the number assigned to a half-edge. The sum of these numbers along a path is the path's homology class.
    pub(super) fn class(&self, h: u32) -> u64 {
        self.class[h as usize]
    }
}

/// Runs Dijkstra's algorithm from the vertex `base`. Returns, for each vertex, its distance from `base` and the last
/// half-edge of the shortest path to it.
fn shortest_paths(complex: &Complex, base: u32) -> (Vec<f64>, Vec<u32>) {
    let mut distance = vec![f64::INFINITY; complex.vertices()];
    let mut arriving = vec![NONE; complex.vertices()];
    distance[base as usize] = 0.0;
    let mut queue = BinaryHeap::from([Reverse((0_u64, base))]);
    while let Some(Reverse((bits, vertex))) = queue.pop() {
        let reached = f64::from_bits(bits);
        if reached > distance[vertex as usize] {
            continue;
        }
        for h in complex.around(vertex) {
            let (to, length) = (complex.to(h), reached + complex.length(h));
            if length < distance[to as usize] {
                distance[to as usize] = length;
                arriving[to as usize] = h;
                queue.push(Reverse((length.to_bits(), to)));
            }
        }
    }
    (distance, arriving)
}

/// Returns the numbers assigned to the half-edges: zero on the tree of paths, and random numbers on generators. The
/// numbers on the dual tree are chosen such that the numbers around each face sum to zero.
fn classes(complex: &Complex, place: &[Place], generators: &[u32]) -> Vec<u64> {
    let mut class = vec![0_u64; place.len()];
    for (&h, i) in generators.iter().zip(1_u64..) {
        class[h as usize] = mix(i);
        class[complex.twin(h) as usize] = mix(i).wrapping_neg();
    }
    // Lists each face with its half-edge towards the root of the dual tree, parents before children.
    let mut order = vec![(0, NONE)];
    let mut reached = vec![false; complex.faces()];
    reached[0] = true;
    let mut queue = VecDeque::from([0]);
    while let Some(face) = queue.pop_front() {
        for h in complex.of_face(face).filter(|&h| place[h as usize] == Place::Dual) {
            let twin = complex.twin(h);
            let beyond = complex.face(twin);
            if !std::mem::replace(&mut reached[beyond as usize], true) {
                order.push((beyond, twin));
                queue.push_back(beyond);
            }
        }
    }
    for &(face, towards) in order[1..].iter().rev() {
        let others = complex.of_face(face).filter(|&h| h != towards);
        let sum = others.fold(0_u64, |sum, h| sum.wrapping_add(class[h as usize]));
        class[towards as usize] = sum.wrapping_neg();
        class[complex.twin(towards) as usize] = sum;
    }
    class
}

/// Applies the finaliser of SplitMix64, which gives the same pseudorandom numbers on every machine.
fn mix(i: u64) -> u64 {
    let mut x = i.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}
