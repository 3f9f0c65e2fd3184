//! Computes the shape of a filling: a surface over a disc that closes one side of a cut.
//!
//! Two surfaces x(u) are computed, with u a point of the unit disc. The rim of the disc is mapped to the seam, the loop
//! along which the surface was cut.
//!
//! - *flat*: Laplace(x) = 0 with the seam as boundary values: a soap film, up to its parameterisation. The flat surface
//!   determines on which side of the surface the film over the seam lies, and the lengths s = |dx/dn| along the rim,
//!   with n the inward normal of the rim in the disc.
//! - *smooth*: least integral of |grad Laplace(x)|^2, hence Laplace^3(x) = 0. x and its first two derivatives are
//!   prescribed along the rim, by two rings of points that lie on the surface beyond the seam, at distances from the
//!   rim that are given by s. The filling therefore continues the surface with its tangents and curvatures, and closes
//!   as a dome. For a tube of radius 1 the dome has radius rho (15 - 10 rho^2 + 3 rho^4) / 8 and height (5 - 6 rho^2 +
//!   rho^4) / 8, with rho = |u|.
//!
//! The error of a model of degree L decreases only as 1/L at a kink. A kink at the seam would therefore increase the
//! error far more than the dome's additional area does. The dome of each side of the cut lies inside the tube of the
//! other side, and the two domes meet only at the seam.
//!
//! The discretisation uses the cotangents of the disc's own triangles, since these triangles are well shaped, unlike
//! those of the surface (L. Kobbelt et al., "Interactive multi-resolution modeling on arbitrary meshes", SIGGRAPH 1998;
//! M. Botsch and L. Kobbelt, "An intuitive framework for real-time freeform modeling", SIGGRAPH 2004). The linear
//! systems are solved by sparse Cholesky factorisation in O(n^1.5) flops for n vertices.

use spharm_monitor::{Interrupted, Monitor};

use super::disc::Disc;
use crate::geometry::{Vec3, add, norm, scale, sub};
use crate::sparse_cholesky::{Factor, Symbolic};

/// The matrices for fillings over a disc, which both sides of a cut share.
pub(super) struct Fairing<'a> {
    disc: &'a Disc,
    /// For each vertex, its neighbours and the cotangent weights of the edges to them. The vertices of the disc come
    /// first, then the vertices of the two rings outside the rim.
    weights: Vec<Vec<(u32, f64)>>,
    areas: Vec<f64>,
    film: Option<Factor>,
    plate: Option<Factor>,
}

impl<'a> Fairing<'a> {
    pub(super) fn new(disc: &'a Disc, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        let (weights, areas) = weights(disc);
        let (rim, all) = (disc.rim, disc.points.len());
        let inner = |v: u32| (rim..all).contains(&(v as usize)).then(|| v - rim as u32);
        let film = (rim..all).flat_map(|v| {
            let row = (v - rim) as u32;
            let own = (row, row, weights[v].iter().map(|(_, w)| w).sum());
            let others = weights[v].iter().filter_map(move |&(to, w)| Some((row, inner(to)?, -w)));
            std::iter::once(own).chain(others)
        });
        let film = factor(all - rim, film.collect(), monitor)?;
        let mut plate = Vec::new();
        for (weight, row) in gradients(&weights, &areas, all + rim) {
            let row: Vec<(u32, f64)> = row.into_iter().filter_map(|(to, w)| Some((inner(to)?, w))).collect();
            for &(a, x) in &row {
                plate.extend(row.iter().map(|&(b, y)| (a, b, weight * x * y)));
            }
        }
        let plate = factor(all - rim, plate, monitor)?;
        Ok(Self { disc, weights, areas, film, plate })
    }

    /// Returns the positions of all of the disc's vertices on the flat filling of a rim.
    pub(super) fn flat(&self, rim: &[Vec3]) -> Vec<Vec3> {
        let middle = scale(rim.iter().fold([0.0; 3], |sum, &p| add(sum, p)), 1.0 / rim.len() as f64);
        let all = self.disc.points.len();
        let known = |v: u32| rim.get(v as usize).copied();
        let right = (rim.len()..all).map(|v| {
            let from = self.weights[v].iter().filter_map(|&(to, w)| Some(scale(known(to)?, w)));
            from.fold([0.0; 3], add)
        });
        let inner = self.film.as_ref().map(|film| solve(film, &right.collect::<Vec<_>>()));
        let inner = inner.unwrap_or_else(|| vec![middle; all - rim.len()]);
        rim.iter().copied().chain(inner).collect()
    }

    /// Returns the positions of all of the disc's vertices on the smooth filling. `outside` contains the two rings of
    /// surface points that the filling continues, the ring nearer to the rim first. The distances of the rings from the
    /// rim are given by [`steps`](Self::steps).
    pub(super) fn smooth(&self, flat: &[Vec3], outside: &[Vec3]) -> Vec<Vec3> {
        let (rim, all) = (self.disc.rim, self.disc.points.len());
        let known = |v: u32| {
            let v = v as usize;
            if v < rim { Some(flat[v]) } else { (v >= all).then(|| outside[v - all]) }
        };
        let mut right = vec![[0.0; 3]; all - rim];
        for (weight, row) in gradients(&self.weights, &self.areas, all + rim) {
            let fixed = row.iter().filter_map(|&(to, w)| Some(scale(known(to)?, w)));
            let fixed = scale(fixed.fold([0.0; 3], add), -weight);
            for &(to, w) in row.iter().filter(|&&(to, _)| (rim..all).contains(&(to as usize))) {
                let to = &mut right[to as usize - rim];
                *to = add(*to, scale(fixed, w));
            }
        }
        match &self.plate {
            Some(plate) => flat[..rim].iter().copied().chain(solve(plate, &right)).collect(),
            None => flat.to_vec(),
        }
    }

    /// Returns, for each vertex of the rim, the distance on the flat filling from the rim to the next ring.
    pub(super) fn steps(&self, flat: &[Vec3]) -> Vec<f64> {
        self.disc.at_ring(flat).iter().zip(flat).map(|(inwards, rim)| norm(sub(*inwards, *rim))).collect()
    }
}

/// Returns, for each edge that joins two of the first `count` vertices, its weight, and the difference of the
/// Laplacians at its ends as a list of (vertex, coefficient).
fn gradients(weights: &[Vec<(u32, f64)>], areas: &[f64], count: usize) -> impl Iterator<Item = (f64, Vec<(u32, f64)>)> {
    let edges = (0..count).flat_map(move |v| {
        let others = weights[v].iter().copied();
        others.filter(move |&(to, _)| (v + 1..count).contains(&(to as usize))).map(move |(to, w)| (v, to as usize, w))
    });
    edges.map(|(v, to, weight)| {
        let mut row: Vec<(u32, f64)> = stencil(weights, v).map(|(u, w)| (u, w / areas[v])).collect();
        for (u, w) in stencil(weights, to) {
            match row.iter_mut().find(|(known, _)| *known == u) {
                Some((_, sum)) => *sum -= w / areas[to],
                None => row.push((u, -w / areas[to])),
            }
        }
        (weight, row)
    })
}

/// Returns the coefficients of the Laplacian at a vertex: those of the neighbours, then the vertex's own.
fn stencil(weights: &[Vec<(u32, f64)>], v: usize) -> impl Iterator<Item = (u32, f64)> + '_ {
    let own: f64 = weights[v].iter().map(|(_, w)| w).sum();
    weights[v].iter().copied().chain(std::iter::once((v as u32, -own)))
}

/// Returns, for each edge, half the sum of the cotangents of the angles opposite it, and for each vertex a third of the
/// area of the triangles around it. The two rings outside the rim are included.
fn weights(disc: &Disc) -> (Vec<Vec<(u32, f64)>>, Vec<f64>) {
    let (rim, all) = (disc.rim as u32, disc.points.len() as u32);
    let ring = |number: f64| {
        let wide = 1.0 + number * disc.spacing;
        disc.points[..disc.rim].iter().map(move |[x, y]| [wide * x, wide * y])
    };
    let points: Vec<[f64; 2]> = disc.points.iter().copied().chain(ring(1.0)).chain(ring(2.0)).collect();
    let strip = |outer: u32, inner: u32| {
        (0..rim).flat_map(move |i| {
            let (a, b) = (i, (i + 1) % rim);
            [[outer + a, outer + b, inner + a], [outer + b, inner + b, inner + a]]
        })
    };
    let mut weights: Vec<Vec<(u32, f64)>> = vec![Vec::new(); points.len()];
    let mut areas = vec![0.0; points.len()];
    let strips = strip(all, 0).chain(strip(all + rim, all));
    for triangle in disc.triangles.iter().copied().chain(strips) {
        let at = triangle.map(|v| points[v as usize]);
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let (u, v) = ([at[i][0] - at[k][0], at[i][1] - at[k][1]], [at[j][0] - at[k][0], at[j][1] - at[k][1]]);
            let twice = u[0] * v[1] - u[1] * v[0];
            areas[triangle[k] as usize] += twice / 6.0;
            let half = 0.5 * (u[0] * v[0] + u[1] * v[1]) / twice;
            for (from, to) in [(triangle[i], triangle[j]), (triangle[j], triangle[i])] {
                let row = &mut weights[from as usize];
                match row.iter_mut().find(|(known, _)| *known == to) {
                    Some((_, weight)) => *weight += half,
                    None => row.push((to, half)),
                }
            }
        }
    }
    (weights, areas)
}

/// Factors a symmetric matrix given as a list of (row, column, value), in which repeated entries are summed. Returns
/// `None` if the matrix can't be factored.
fn factor(n: usize, mut entries: Vec<(u32, u32, f64)>, monitor: &dyn Monitor) -> Result<Option<Factor>, Interrupted> {
    entries.sort_by_key(|&(row, column, _)| (row, column));
    let (mut starts, mut columns, mut values) = (vec![0; n + 1], Vec::new(), Vec::new());
    for same in entries.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        starts[same[0].0 as usize + 1] += 1;
        columns.push(same[0].1);
        values.push([same.iter().map(|(.., value)| value).sum::<f64>()]);
    }
    for row in 0..n {
        starts[row + 1] += starts[row];
    }
    let Some(symbolic) = Symbolic::new(1, &starts, &columns, monitor)? else { return Ok(None) };
    symbolic.factor(&starts, &columns, values, monitor)
}

fn solve(factor: &Factor, right: &[Vec3]) -> Vec<Vec3> {
    let mut found = vec![[0.0; 3]; right.len()];
    for axis in 0..3 {
        let mut column: Vec<f64> = right.iter().map(|values| values[axis]).collect();
        factor.solve(&mut column);
        for (found, value) in found.iter_mut().zip(column) {
            found[axis] = value;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;

    /// Checks that the smooth filling at the end of a tube of radius 1 is the dome given in the module's
    /// documentation.
    #[test]
    fn a_tube_is_closed_by_the_dome_in_closed_form() {
        let rim: Vec<Vec3> =
            (0..120).map(|i| f64::from(i) * std::f64::consts::TAU / 120.0).map(|t| [t.cos(), t.sin(), 0.0]).collect();
        let disc = Disc::new(120);
        let fairing = Fairing::new(&disc, &Silent).unwrap();
        let flat = fairing.flat(&rim);
        for (found, [x, y]) in flat.iter().zip(&disc.points) {
            assert!(norm(sub(*found, [*x, *y, 0.0])) < 1e-12, "{found:?} {x} {y}");
        }
        let steps = fairing.steps(&flat);
        let outside =
            [1.0, 2.0].map(|ring| rim.iter().zip(&steps).map(move |([x, y, _], step)| [*x, *y, -ring * step]));
        let dome = fairing.smooth(&flat, &outside.into_iter().flatten().collect::<Vec<_>>());
        for (found, [x, y]) in dome.iter().zip(&disc.points) {
            let square = x * x + y * y;
            let wide = (15.0 - 10.0 * square + 3.0 * square * square) / 8.0;
            let expected = [x * wide, y * wide, (5.0 - 6.0 * square + square * square) / 8.0];
            assert!(norm(sub(*found, expected)) < 0.03, "{found:?} {expected:?}");
        }
    }
}
