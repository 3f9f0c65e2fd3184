//! Computes the initial map: the colatitude and azimuth of each vertex, as harmonic functions on the graph of the
//! mesh's edges.
//!
//! Two distant vertices become the poles. The colatitude theta is 0 at the north pole and pi at the south pole. At
//! every other vertex theta is the mean of the neighbours' colatitudes. The azimuth phi at a vertex other than the
//! poles is the mean of its neighbours' azimuths. The date line is a path from pole to pole, across which phi jumps by
//! 2 pi: 2 pi is added to or subtracted from the azimuth of a neighbour across the line. Theta and phi are solutions of
//! sparse positive definite systems with an unknown for each vertex.
//!
//! Then an increasing function is applied to theta so that the share of vertices in each zone equals the zone's share
//! of the sphere's area. Without this function, vertices would crowd around the equator, since each pole is a single
//! vertex.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use spharm_linalg::{MatMut, SparseSum};

use crate::error::ParametrizeError;
use crate::geometry::Vec3;
use crate::volume::QuadMesh;

/// Returns a position on the unit sphere for each vertex.
pub(super) fn positions(quads: &QuadMesh) -> Result<Vec<Vec3>, ParametrizeError> {
    let rings = Rings::new(quads);
    let south = rings.furthest(0);
    let north = rings.furthest(south);
    let theta = colatitude(&rings, north, south)?;
    let phi = azimuth(&rings, &theta, north, south)?;
    let zone = even_zones(&theta);
    let place = |(&theta, phi): (&f64, f64)| {
        let z = zone(theta);
        let r = (1.0 - z * z).max(0.0).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    };
    Ok(theta.iter().zip(phi).map(place).collect())
}

/// Each vertex's neighbours, counter-clockwise seen from outside.
struct Rings {
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Rings {
    fn new(quads: &QuadMesh) -> Self {
        let mut first = vec![u32::MAX; quads.vertices.len()];
        for (q, quad) in (0..).zip(&quads.quads) {
            for (k, &v) in (0..).zip(quad) {
                first[v as usize] = first[v as usize].min(4 * q + k);
            }
        }
        let mut starts = vec![0];
        let mut neighbours = Vec::with_capacity(quads.twins.len());
        for start in first {
            let mut corner = start;
            loop {
                let (quad, k) = (quads.quads[corner as usize / 4], corner as usize % 4);
                neighbours.push(quad[(k + 1) % 4]);
                // Continues across the quadrangle's edge that ends at the vertex. This edge lies to the left of the
                // edge that starts at the vertex.
                corner = quads.twins[corner as usize / 4 * 4 + (k + 3) % 4];
                if corner == start {
                    break;
                }
            }
            starts.push(neighbours.len() as u32);
        }
        Self { starts, neighbours }
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    fn of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }

    /// Returns the vertex that is the largest number of edges away from `from`; if several vertices are equally far
    /// away, the first of them.
    fn furthest(&self, from: usize) -> usize {
        let mut distance = vec![usize::MAX; self.len()];
        distance[from] = 0;
        let mut queue = VecDeque::from([from]);
        while let Some(v) = queue.pop_front() {
            for &w in self.of(v) {
                if distance[w as usize] == usize::MAX {
                    distance[w as usize] = distance[v] + 1;
                    queue.push_back(w as usize);
                }
            }
        }
        (0..self.len()).max_by_key(|&v| (distance[v], std::cmp::Reverse(v))).unwrap_or(from)
    }
}

fn colatitude(rings: &Rings, north: usize, south: usize) -> Result<Vec<f64>, ParametrizeError> {
    let fixed = |v: usize| if v == north { Some(0.0) } else { (v == south).then_some(PI) };
    let mut matrix = Vec::new();
    let mut right = vec![0.0; rings.len()];
    for (v, right) in right.iter_mut().enumerate() {
        if let Some(value) = fixed(v) {
            matrix.push(([v, v], 1.0));
            *right = value;
            continue;
        }
        matrix.push(([v, v], rings.of(v).len() as f64));
        for w in rings.of(v).iter().map(|&w| w as usize) {
            match fixed(w) {
                Some(value) => *right += value,
                None => matrix.push(([v, w], -1.0)),
            }
        }
    }
    solve(&matrix, right)
}

fn azimuth(rings: &Rings, theta: &[f64], north: usize, south: usize) -> Result<Vec<f64>, ParametrizeError> {
    let pole = |v: usize| v == north || v == south;
    let mut matrix = Vec::new();
    let mut right = vec![0.0; rings.len()];
    for v in 0..rings.len() {
        let within = rings.of(v).iter().filter(|&&w| !pole(w as usize));
        let degree = if pole(v) { 1.0 } else { within.clone().count() as f64 };
        matrix.push(([v, v], degree));
        if !pole(v) {
            matrix.extend(within.map(|&w| ([v, w as usize], -1.0)));
        }
    }
    let line = date_line(rings, theta, north, south);
    // The azimuth is determined only up to a constant, so the date line's first vertex after the pole gets azimuth 0.
    matrix.push(([line[1], line[1]], 1.0));
    for window in line.windows(3) {
        let [before, v, after] = [window[0], window[1], window[2]];
        // The neighbours west of the line (seen from outside, with north up) lie counter-clockwise between the previous
        // vertex of the line and the next one.
        let ring = rings.of(v);
        let start = ring.iter().position(|&w| w as usize == before).unwrap_or(0);
        let around = (1..ring.len()).map(|k| ring[(start + k) % ring.len()] as usize);
        for west in around.take_while(|&w| w != after).filter(|&w| !pole(w)) {
            right[v] -= TAU;
            right[west] += TAU;
        }
    }
    solve(&matrix, right)
}

/// Returns a path from the north pole to the south pole that always continues to the neighbour of largest theta. The
/// path reaches the south pole, since a harmonic theta has no other maximum. Among the vertices of the path, each
/// vertex is adjacent only to the previous and the next vertex.
fn date_line(rings: &Rings, theta: &[f64], north: usize, south: usize) -> Vec<usize> {
    let mut line = vec![north];
    let mut at = north;
    while at != south && line.len() < rings.len() {
        let next = rings.of(at).iter().copied().max_by(|&a, &b| theta[a as usize].total_cmp(&theta[b as usize]));
        at = next.unwrap_or(south as u32) as usize;
        line.push(at);
    }
    line
}

/// Returns a function from theta to z on the unit sphere, piecewise linear and decreasing, such that the share of
/// vertices above z equals the share of the sphere's area above z.
fn even_zones(theta: &[f64]) -> impl Fn(f64) -> f64 {
    const ZONES: usize = 64;
    let mut sorted = theta.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len() - 1;
    let mut knots: Vec<(f64, f64)> =
        (0..=ZONES).map(|k| (sorted[k * last / ZONES], 1.0 - 2.0 * (k * last / ZONES) as f64 / last as f64)).collect();
    knots.dedup_by(|next, kept| next.0 <= kept.0);
    move |theta| {
        let above = knots.partition_point(|knot| knot.0 <= theta).clamp(1, knots.len() - 1);
        let ((t0, z0), (t1, z1)) = (knots[above - 1], knots[above]);
        z0 + (z1 - z0) * (theta - t0) / (t1 - t0)
    }
}

/// Solves a symmetric linear system. The matrix is a list of entries `([row, column], value)`; entries with the same
/// row and column are summed.
fn solve(matrix: &[([usize; 2], f64)], mut right: Vec<f64>) -> Result<Vec<f64>, ParametrizeError> {
    // These systems are always solvable, so an error here is a bug in this program.
    let failed = |found: &str| ParametrizeError::Argument {
        what: "linear system of the equal-area method",
        expected: "a positive definite matrix that fits in memory",
        found: found.to_owned(),
    };
    let n = right.len();
    let (places, values): (Vec<[usize; 2]>, Vec<f64>) = matrix.iter().copied().unzip();
    let pattern = SparseSum::new(n, &places).ok_or_else(|| failed("a matrix that is too large for memory"))?;
    let factor = pattern.factor(&values).ok_or_else(|| failed("a matrix that isn't positive definite"))?;
    factor.solve(MatMut::from_column_major_slice_mut(&mut right, n, 1));
    Ok(right)
}
