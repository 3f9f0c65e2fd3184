//! The shape of a filling.
//!
//! Over the unit disc u, whose rim is the seam, two surfaces x(u):
//!
//! - *flat*: Laplace(x) = 0 with the seam as boundary values, a soap film up to the parameterisation. It shows on which side
//!   of the surface the seam is spanned, and how fast x goes inwards from the rim, s = |dx/dn|.
//! - *smooth*: least integral of |Laplace(x)|^2, hence Laplace(Laplace(x)) = 0, with the seam and dx/dn = s c prescribed, where
//!   c is square to the seam in the surface's tangent plane and leads on beyond the rim. So the filling goes on from the
//!   surface without a kink and closes as a dome: half as high as the radius of a round seam.
//!
//! A kink at the seam would cost a model far more than the dome's area: there its error goes down as 1/L only. The domes of the two sides lie within each other's tube, each
//! beyond the seam, and meet in the seam alone.
//!
//! Discretised by cotangents over the disc's own triangles, which are well shaped, not over the surface's: |K x|^2 / area,
//! with a ring of vertices outside of the rim that hold the derivative (L. Kobbelt et al., "Interactive multi-resolution
//! modeling on arbitrary meshes", SIGGRAPH 1998; P. Liepa, "Filling holes in meshes", SGP 2003). Sparse Cholesky,
//! O(n^1.5).

use spharm_monitor::{Interrupted, Monitor};

use super::disc::Disc;
use crate::geometry::{Vec3, add, norm, scale, sub};
use crate::sparse_cholesky::{Factor, Symbolic};

/// The matrices of a disc, for both of its sides.
pub(super) struct Fairing<'a> {
    disc: &'a Disc,
    /// Of each vertex and each vertex of the outer ring, which come last: cotangent weights of the edges.
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
        for v in 0..all {
            let row: Vec<(u32, f64)> = stencil(&weights, v).filter_map(|(to, w)| Some((inner(to)?, w))).collect();
            for &(a, x) in &row {
                plate.extend(row.iter().map(|&(b, y)| (a, b, x * y / areas[v])));
            }
        }
        let plate = factor(all - rim, plate, monitor)?;
        Ok(Self { disc, weights, areas, film, plate })
    }

    /// Positions of all vertices of the flat filling of a rim.
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

    /// Positions of all vertices of the filling that leads on from a rim along unit vectors, one for each of its vertices.
    pub(super) fn smooth(&self, flat: &[Vec3], along: &[Vec3]) -> Vec<Vec3> {
        let (rim, all) = (self.disc.rim, self.disc.points.len());
        let inwards = self.disc.at_ring(flat);
        let outside = (0..rim).map(|i| sub(flat[i], scale(along[i], norm(sub(inwards[i], flat[i])))));
        let outside: Vec<Vec3> = outside.collect();
        let known = |v: u32| {
            let v = v as usize;
            if v < rim { Some(flat[v]) } else { (v >= all).then(|| outside[v - all]) }
        };
        let mut right = vec![[0.0; 3]; all - rim];
        for v in 0..all {
            let fixed = stencil(&self.weights, v).filter_map(|(to, w)| Some(scale(known(to)?, w)));
            let fixed = scale(fixed.fold([0.0; 3], add), -1.0 / self.areas[v]);
            for (to, w) in stencil(&self.weights, v).filter(|&(to, _)| (rim..all).contains(&(to as usize))) {
                let to = &mut right[to as usize - rim];
                *to = add(*to, scale(fixed, w));
            }
        }
        match &self.plate {
            Some(plate) => flat[..rim].iter().copied().chain(solve(plate, &right)).collect(),
            None => flat.to_vec(),
        }
    }
}

/// The Laplacian at a vertex: the weights of its neighbours, and its own.
fn stencil(weights: &[Vec<(u32, f64)>], v: usize) -> impl Iterator<Item = (u32, f64)> + '_ {
    let own: f64 = weights[v].iter().map(|(_, w)| w).sum();
    weights[v].iter().copied().chain(std::iter::once((v as u32, -own)))
}

/// Half the sums of cotangents opposite to each edge, and a third of the triangles around each vertex, with the ring outside
/// of the rim.
fn weights(disc: &Disc) -> (Vec<Vec<(u32, f64)>>, Vec<f64>) {
    let (rim, all) = (disc.rim as u32, disc.points.len() as u32);
    let wide = 1.0 + disc.spacing;
    let outer = disc.points[..disc.rim].iter().map(|[x, y]| [wide * x, wide * y]);
    let points: Vec<[f64; 2]> = disc.points.iter().copied().chain(outer).collect();
    let strip = (0..rim).flat_map(|i| {
        let (a, b) = (i, (i + 1) % rim);
        [[all + a, all + b, a], [all + b, b, a]]
    });
    let mut weights: Vec<Vec<(u32, f64)>> = vec![Vec::new(); points.len()];
    let mut areas = vec![0.0; points.len()];
    for triangle in disc.triangles.iter().copied().chain(strip) {
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

/// Factors a symmetric matrix from its entries, which are added up where they repeat.
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

    /// The end of a tube of radius 1 is closed by rho (3 - rho^2) / 2 and height (1 - rho^2) / 2, the solution in closed form.
    #[test]
    fn a_tube_is_closed_by_the_dome_of_the_plate_equation() {
        let rim: Vec<Vec3> =
            (0..60).map(|i| f64::from(i) * std::f64::consts::TAU / 60.0).map(|t| [t.cos(), t.sin(), 0.0]).collect();
        let disc = Disc::new(60);
        let fairing = Fairing::new(&disc, &Silent).unwrap();
        let flat = fairing.flat(&rim);
        for (found, [x, y]) in flat.iter().zip(&disc.points) {
            assert!(norm(sub(*found, [*x, *y, 0.0])) < 1e-12, "{found:?} {x} {y}");
        }
        let dome = fairing.smooth(&flat, &vec![[0.0, 0.0, 1.0]; 60]);
        for (found, [x, y]) in dome.iter().zip(&disc.points) {
            let square = x * x + y * y;
            let expected = [0.5 * x * (3.0 - square), 0.5 * y * (3.0 - square), 0.5 * (1.0 - square)];
            assert!(norm(sub(*found, expected)) < 0.03, "{found:?} {expected:?}");
        }
    }
}
