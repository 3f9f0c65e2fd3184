//! Triangulates a disc whose rim has a given number of vertices.
//!
//! The disc consists of rings around a centre; each ring has fewer vertices than the next larger ring. Triangles are
//! nearly equilateral if the rim's edges have nearly equal lengths. For a rim of m vertices, the disc has 0.18 m rings
//! and 0.09 m^2 interior vertices. The rim and all rings are regular polygons in the plane, so no triangle of the disc
//! is flat, however different the lengths of the surface's edges along the rim are. Neighbouring rings are joined in
//! the order of their angles. No edge inside the disc joins two vertices of the rim.

use std::f64::consts::{PI, TAU};

/// A triangulation of the unit disc.
pub(super) struct Disc {
    /// Number of vertices on the rim. These vertices are the first entries of `points`.
    pub(super) rim: usize,
    /// Number of vertices of the ring next to the rim; 1 if this ring is only the centre. These vertices follow the
    /// rim's vertices in `points`.
    pub(super) ring: usize,
    /// Distance between consecutive rings; the rim has radius 1.
    pub(super) spacing: f64,
    /// Positions of all vertices.
    pub(super) points: Vec<[f64; 2]>,
    /// Triangles, counter-clockwise.
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Disc {
    /// Builds the disc for a rim with `rim` vertices, at least three.
    pub(super) fn new(rim: usize) -> Self {
        let regular = |count: usize| (0..count).map(|k| TAU * k as f64 / count as f64).collect::<Vec<f64>>();
        let mut outer = regular(rim);
        let rings = ((rim as f64 / (PI * 3.0_f64.sqrt())).round() as usize).max(1);
        let mut points: Vec<[f64; 2]> = outer.iter().map(|angle| [angle.cos(), angle.sin()]).collect();
        let (mut triangles, mut start, mut ring) = (Vec::new(), 0, 1);
        for number in 1..=rings {
            let radius = 1.0 - number as f64 / rings as f64;
            let count = if number == rings { 1 } else { ((rim as f64 * radius).round() as usize).max(3) };
            let inner = regular(count);
            let next = points.len();
            points.extend(inner.iter().map(|angle| [radius * angle.cos(), radius * angle.sin()]));
            join(&outer, start, &inner, next, &mut triangles);
            if number == 1 {
                ring = count;
            }
            (outer, start) = (inner, next);
        }
        Self { rim, ring, spacing: 1.0 / rings as f64, points, triangles }
    }

    /// Given values at all vertices, returns for each vertex of the rim the linearly interpolated value at the same
    /// angle on the next ring.
    pub(super) fn at_ring(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let ring = &values[self.rim..self.rim + self.ring];
        let at = |&[x, y]: &[f64; 2]| {
            let place = y.atan2(x).rem_euclid(TAU) / TAU * self.ring as f64;
            let (k, part) = (place.floor() as usize % self.ring, place.fract());
            let (a, b) = (ring[k], ring[(k + 1) % self.ring]);
            std::array::from_fn(|axis| (1.0 - part) * a[axis] + part * b[axis])
        };
        self.points[..self.rim].iter().map(at).collect()
    }
}

/// Adds the triangles between two rings. Each ring is given by the angles of its vertices, in ascending order from
/// zero. The inner ring may be a single vertex.
fn join(outer: &[f64], outer_start: usize, inner: &[f64], inner_start: usize, triangles: &mut Vec<[u32; 3]>) {
    let after = |ring: &[f64], i: usize| if i + 1 < ring.len() { ring[i + 1] } else { TAU };
    let vertex = |start: usize, ring: &[f64], i: usize| (start + i % ring.len()) as u32;
    let inner_steps = if inner.len() == 1 { 0 } else { inner.len() };
    let (mut i, mut j) = (0, 0);
    while i < outer.len() || j < inner_steps {
        let (a, b) = (vertex(outer_start, outer, i), vertex(inner_start, inner, j));
        let outwards = j >= inner_steps || (i < outer.len() && after(outer, i) <= after(inner, j));
        if outwards {
            triangles.push([a, vertex(outer_start, outer, i + 1), b]);
            i += 1;
        } else {
            triangles.push([a, vertex(inner_start, inner, j + 1), b]);
            j += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that every rim gets a disc: Euler characteristic 1, all triangles wound the same way, and the rim as
    /// its boundary.
    #[test]
    fn rims_of_all_sizes_get_discs() {
        for rim in 3..80 {
            let disc = Disc::new(rim);
            let mut edges: Vec<(u32, u32)> = Vec::new();
            for &[a, b, c] in &disc.triangles {
                edges.extend([(a, b), (b, c), (c, a)]);
            }
            edges.sort_unstable();
            assert!(edges.windows(2).all(|pair| pair[0] != pair[1]), "{rim}: an edge runs the same way twice");
            let open: Vec<_> = edges.iter().filter(|&&(a, b)| edges.binary_search(&(b, a)).is_err()).collect();
            assert_eq!(open.len(), rim);
            assert!(open.iter().all(|&&(a, b)| b == (a + 1) % rim as u32));
            let count = (edges.len() + open.len()) / 2;
            assert_eq!(disc.points.len() + disc.triangles.len(), count + 1, "{rim}");
            let area = |&[a, b, c]: &[u32; 3]| {
                let [a, b, c] = [a, b, c].map(|v| disc.points[v as usize]);
                (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            };
            assert!(disc.triangles.iter().all(|triangle| area(triangle) > 0.0), "{rim}");
        }
    }
}
