//! Computes generalisation and specificity by the distance between surfaces: the area-weighted mean of the distances
//! from the points of each surface to the nearest points of the other.

use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};
use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;

use super::curves::{Left, Model, Near};
use super::points::Points;
use crate::ShapeError;

/// Number of random shapes that are compared by their surfaces.
const SHAPES: usize = 100;

const STAGE: Stage = Stage::counted("surfaces", "shapes");

/// Distances of members or shapes by the number of modes, (rows) of (m).
type Rows = Vec<Vec<f64>>;

/// A surface with its search tree and area weights, prepared for distances in both directions.
struct Side {
    vertices: Vec<Vec3>,
    shares: Vec<f64>,
    tree: TriangleTree,
}

impl Side {
    fn new(points: &Points, vertices: Vec<Vec3>) -> Self {
        let mesh = points.mesh(vertices);
        let (shares, tree) = (points.shares(&mesh.vertices), TriangleTree::new(&mesh));
        Self { vertices: mesh.vertices, shares, tree }
    }

    fn mean_to(&self, other: &Self) -> f64 {
        let distance = |p: &Vec3| other.tree.nearest(*p).map_or(0.0, |found| found.distance);
        self.vertices.iter().zip(&self.shares).map(|(p, share)| share * distance(p)).sum()
    }

    /// Returns the mean of the two mean distances from one surface to the other.
    fn distance(&self, other: &Self) -> f64 {
        0.5 * (self.mean_to(other) + other.mean_to(self))
    }
}

/// Returns the distances of excluded members from their nearest shapes, (members, m), and of random shapes from the
/// nearest members, (shapes, m), by the number of modes.
pub(super) fn distances(
    points: &Points,
    model: &Model,
    left: &[Left],
    near: &[Near],
    most: usize,
    monitor: &dyn Monitor,
) -> Result<(Rows, Rows), ShapeError> {
    let near = &near[..near.len().min(SHAPES)];
    monitor.begin(STAGE, (left.len() + near.len()) as u64);
    let one = |left: &Left| -> Result<Vec<f64>, ShapeError> {
        let own = Side::new(points, points.members[left.member].clone());
        let mut distances: Vec<f64> = Vec::with_capacity(most);
        for k in 0..most {
            monitor.check()?;
            // The other members have no further modes, so the nearest shape and its distance are unchanged.
            if k > 0 && left.factors[k] == left.factors[k - 1] {
                distances.push(distances[k - 1]);
                continue;
            }
            distances.push(own.distance(&Side::new(points, points.combined(&left.factors[k]))));
        }
        monitor.step(1);
        Ok(distances)
    };
    let general = left.par_iter().map(one).collect::<Result<_, _>>()?;
    let members: Vec<Side> = points.members.par_iter().map(|member| Side::new(points, member.clone())).collect();
    let n = points.members.len();
    let one = |near: &Near| -> Result<Vec<f64>, ShapeError> {
        let mut factors = vec![1.0 / n as f64; n];
        let mut distances = Vec::with_capacity(most);
        for k in 0..most {
            monitor.check()?;
            if let Some(along) = near.along.get(k) {
                factors.iter_mut().zip(model.loadings.row(k)).for_each(|(factor, loading)| *factor += along * loading);
            }
            let shape = Side::new(points, points.combined(&factors));
            distances
                .push(near.rows[k].map(|row| shape.distance(&members[row])).into_iter().fold(f64::INFINITY, f64::min));
        }
        monitor.step(1);
        Ok(distances)
    };
    let specific = near.par_iter().map(one).collect::<Result<_, _>>()?;
    monitor.end();
    Ok((general, specific))
}
