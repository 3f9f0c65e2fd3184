//! Evaluates a group at corresponding points, which are weighted by area.

use ndarray::Array2;
use rayon::prelude::*;
use spharm_harmonics::{Coefficients, Directions};
use spharm_linalg::{MatRef, SymmetricEigen};
use spharm_monitor::{Monitor, Stage};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::{Vec3, add, cross, dot, scale, sub};
use spharm_transform::synthesis;

use super::params::QualityParams;
use crate::ShapeError;
use crate::extent::extent;
use spharm_surface::kabsch::kabsch;

/// Maximum number of rounds of rotating members to the mean and recomputing the mean. In practice two rounds are
/// enough.
const ROUNDS: usize = 5;

const STAGE: Stage = Stage::counted("evaluate", "models");

/// Points on the members of a group at the directions of an icosphere.
pub(super) struct Points {
    /// Triangles of the icosphere.
    pub(super) faces: Vec<[u32; 3]>,
    /// Positions of the V vertices of each member, with the member's centre of area at the origin.
    pub(super) members: Vec<Vec<Vec3>>,
    /// Weight of each of the V vertices: its fraction of the area, averaged over the members. Weights sum to 1, and are
    /// 0 for masked vertices.
    pub(super) weights: Vec<f64>,
    /// Mask (V) of the vertices to compare; all vertices if `None`.
    mask: Option<Vec<bool>>,
}

impl Points {
    /// Evaluates members at the directions of an icosphere, and moves their centres of area to the origin.
    pub(super) fn of(
        members: &[Coefficients],
        params: &QualityParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, ShapeError> {
        let sphere = icosphere(params.subdivisions);
        if let Some(mask) = params.mask.as_ref().filter(|mask| mask.len() != sphere.vertices.len()) {
            let (what, expected) = ("directions of a mask", sphere.vertices.len());
            return Err(ShapeError::Differ { what, expected, found: mask.len() });
        }
        let directions = Directions::from_vertices(&sphere.vertices)?;
        monitor.begin(STAGE, members.len() as u64);
        let one = |(index, member): (usize, &Coefficients)| {
            monitor.check()?;
            let found = extent(member).and_then(|_| evaluate(&directions, member));
            monitor.step(1);
            found.map_err(|source| ShapeError::Member { index, source: Box::new(source) })
        };
        let found: Vec<Result<Vec<Vec3>, ShapeError>> = members.par_iter().enumerate().map(one).collect();
        monitor.end();
        let members: Vec<Vec<Vec3>> = found.into_iter().collect::<Result<_, _>>()?;
        let mut weights = vec![0.0; sphere.vertices.len()];
        let mut points = Self { faces: sphere.faces, members, weights: Vec::new(), mask: params.mask.clone() };
        for member in &points.members {
            let share = points.shares(member);
            weights.iter_mut().zip(share).for_each(|(weight, share)| *weight += share / points.members.len() as f64);
        }
        if !weights.iter().all(|weight| weight.is_finite()) {
            let expected = "the mask must keep some area of every surface";
            return Err(ShapeError::Setting { name: "the compared area", found: "0".to_owned(), expected });
        }
        points.weights = weights;
        points.centre();
        Ok(points)
    }

    /// Returns the fraction of a surface's unmasked area that belongs to each vertex. A third of the area of each
    /// triangle belongs to each of its vertices.
    pub(super) fn shares(&self, vertices: &[Vec3]) -> Vec<f64> {
        let mut shares = vec![0.0; vertices.len()];
        for face in &self.faces {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            let normal = cross(sub(b, a), sub(c, a));
            let area = dot(normal, normal).sqrt();
            face.iter().for_each(|&v| shares[v as usize] += area);
        }
        if let Some(mask) = &self.mask {
            shares.iter_mut().zip(mask).filter(|(_, kept)| !**kept).for_each(|(share, _)| *share = 0.0);
        }
        let sum: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= sum);
        shares
    }

    fn centre(&mut self) {
        for member in &mut self.members {
            let centre =
                member.iter().zip(&self.weights).fold([0.0; 3], |sum, (&p, &weight)| add(sum, scale(p, weight)));
            member.iter_mut().for_each(|p| *p = sub(*p, centre));
        }
    }

    /// Rotates each member to the mean of all members, minimising the area-weighted sum of the squared distances
    /// between points at equal directions.
    pub(super) fn bring_together(&mut self) {
        for _ in 0..ROUNDS {
            let mean = self.mean();
            for member in &mut self.members {
                let mut matrix = [[0.0; 3]; 3];
                for ((p, q), weight) in member.iter().zip(&mean).zip(&self.weights) {
                    (0..3).for_each(|i| (0..3).for_each(|j| matrix[i][j] += weight * q[i] * p[j]));
                }
                let turn = kabsch(&matrix, false);
                member.iter_mut().for_each(|p| *p = turn.map(|row| dot(row, *p)));
            }
        }
    }

    pub(super) fn mean(&self) -> Vec<Vec3> {
        let share = 1.0 / self.members.len() as f64;
        self.combined(&vec![share; self.members.len()])
    }

    /// Returns a weighted sum of the members' positions, with one weight per member.
    pub(super) fn combined(&self, factors: &[f64]) -> Vec<Vec3> {
        let mut sum = vec![[0.0; 3]; self.weights.len()];
        for (member, &factor) in self.members.iter().zip(factors).filter(|(_, factor)| **factor != 0.0) {
            sum.iter_mut().zip(member).for_each(|(sum, p)| *sum = add(*sum, scale(*p, factor)));
        }
        sum
    }

    /// Returns coordinates (n, d) of the members that have mean 0 and preserve the distances between members: `V
    /// S^(1/2)`, where `V S V^T` is the eigendecomposition of the Gram matrix of the members' deviations from the mean.
    pub(super) fn scores(&self) -> Result<Array2<f64>, ShapeError> {
        let (n, mean) = (self.members.len(), self.mean());
        let off: Vec<Vec<Vec3>> = self
            .members
            .par_iter()
            .map(|member| {
                let off = |((p, m), weight): ((&Vec3, &Vec3), &f64)| scale(sub(*p, *m), weight.sqrt());
                member.iter().zip(&mean).zip(&self.weights).map(off).collect()
            })
            .collect();
        let inner = |i: usize, j: usize| -> f64 { off[i].iter().zip(&off[j]).map(|(a, b)| dot(*a, *b)).sum() };
        let rows: Vec<Vec<f64>> = (0..n).into_par_iter().map(|i| (0..=i).map(|j| inner(i, j)).collect()).collect();
        let gram: Vec<f64> = (0..n * n).map(|k| rows[(k / n).max(k % n)][(k / n).min(k % n)]).collect();
        let decomposed = SymmetricEigen::new(MatRef::from_column_major_slice(&gram, n, n))
            .map_err(|_| ShapeError::NoDecomposition)?;
        // Eigenvalues are in ascending order. The smallest one belongs to the mean and is omitted.
        let values: Vec<f64> = decomposed.values().into_iter().map(|value| value.max(0.0)).collect();
        let vectors = decomposed.vectors();
        Ok(Array2::from_shape_fn((n, n - 1), |(i, k)| vectors[(i, n - 1 - k)] * values[n - 1 - k].sqrt()))
    }

    pub(super) fn mesh(&self, vertices: Vec<Vec3>) -> Mesh {
        Mesh::new(vertices, self.faces.clone())
    }
}

pub(super) fn evaluate(directions: &Directions, member: &Coefficients) -> Result<Vec<Vec3>, ShapeError> {
    let values = synthesis(directions, member.values().view())?;
    Ok(values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}
