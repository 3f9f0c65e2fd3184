//! Computes the generalisation and specificity measured by the distance between surfaces: the area-weighted mean of the
//! distances from the points of each surface to the nearest points of the other surface.

use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};
use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;

use super::curves::{Left, Model, Near};
use super::points::Points;
use crate::ShapeError;

/// Number of random shapes whose surfaces are compared with members' surfaces.
const SHAPES: usize = 100;

const STAGE: Stage = Stage::counted("surfaces", "shapes");

/// One row for each member (generalisation) or each random shape (specificity). The row has the distances of the member
/// or shape for 1 mode, 2 modes, and so on.
type Rows = Vec<Vec<f64>>;

/// A surface with its search tree and area weights, prepared for measuring distances to and from other surfaces.
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

    /// Returns the mean distance to the other surface, or infinity if `before` plus this distance exceeds `most`. For
    /// each vertex, `near` (V) has the triangle of the other surface at which the search for the nearest point starts,
    /// and receives the nearest triangle.
    fn mean_to(&self, other: &Self, near: &mut [u32], before: f64, most: f64) -> f64 {
        let mut sum = 0.0;
        for ((p, share), near) in self.vertices.iter().zip(&self.shares).zip(near) {
            if let Some((triangle, distance)) = other.tree.distance(*p, Some(*near)) {
                *near = triangle;
                sum += share * distance;
            }
            if before + sum > most {
                return f64::INFINITY;
            }
        }
        sum
    }

    /// Returns the average of the mean distances from each surface to the other, or infinity if the average is above
    /// `most`.
    fn distance(&self, other: &Self, nearby: &mut Nearby, most: f64) -> f64 {
        let there = self.mean_to(other, &mut nearby.there, 0.0, 2.0 * most);
        if there.is_infinite() {
            return there;
        }
        0.5 * (there + other.mean_to(self, &mut nearby.back, there, 2.0 * most))
    }
}

/// Nearest triangles of two surfaces: for each of the V vertices of one surface, the nearest triangle of the other
/// surface. The search for the next shape, which has one more mode, starts from these triangles.
#[derive(Clone)]
struct Nearby {
    there: Vec<u32>,
    back: Vec<u32>,
}

impl Nearby {
    /// Returns the triangles from which the first searches start. For each vertex, this is one of the vertex's own
    /// triangles, because the surfaces correspond vertex by vertex.
    fn at_vertices(points: &Points) -> Self {
        let mut at = vec![0; points.weights.len()];
        for (triangle, face) in (0..).zip(&points.faces) {
            face.iter().for_each(|&v| at[v as usize] = triangle);
        }
        Self { there: at.clone(), back: at }
    }
}

/// Returns two tables of distances between surfaces, each with a column for every number of modes from 1 to m. The
/// first table (members, m) has the distances of the excluded members `left` from the shapes that approximate them by
/// modes of the other members. The second table (shapes, m) has the distances of random shapes from the members nearest
/// to them.
pub(super) fn distances(
    points: &Points,
    model: &Model,
    left: &[Left],
    near: &[Near],
    most: usize,
    monitor: &dyn Monitor,
) -> Result<(Rows, Rows), ShapeError> {
    let near = &near[..near.len().min(SHAPES)];
    let start = Nearby::at_vertices(points);
    monitor.begin(STAGE, (left.len() + near.len()) as u64);
    let one = |left: &Left| -> Result<Vec<f64>, ShapeError> {
        let own = Side::new(points, points.members[left.member].clone());
        let (mut distances, mut nearby) = (Vec::with_capacity(most), start.clone());
        for k in 0..most {
            monitor.check()?;
            // If the other members have no further mode, the nearest shape and its distance are the same as with one
            // mode fewer.
            if k > 0 && left.factors[k] == left.factors[k - 1] {
                distances.push(distances[k - 1]);
                continue;
            }
            distances.push(own.distance(
                &Side::new(points, points.combined(&left.factors[k])),
                &mut nearby,
                f64::INFINITY,
            ));
        }
        monitor.step(1);
        Ok(distances)
    };
    let general = left.par_iter().map(one).collect::<Result<_, _>>()?;
    let members: Vec<Side> = points.members.par_iter().map(|member| Side::new(points, member.clone())).collect();
    let n = points.members.len();
    let one = |near: &Near| -> Result<Vec<f64>, ShapeError> {
        let mut factors = vec![1.0 / n as f64; n];
        let (mut distances, mut nearby) = (Vec::with_capacity(most), [start.clone(), start.clone()]);
        for k in 0..most {
            monitor.check()?;
            if let Some(along) = near.along.get(k) {
                factors.iter_mut().zip(model.loadings.row(k)).for_each(|(factor, loading)| *factor += along * loading);
            }
            let shape = Side::new(points, points.combined(&factors));
            let both = near.rows[k].into_iter().zip(&mut nearby);
            let least = |least: f64, (row, nearby)| shape.distance(&members[row], nearby, least).min(least);
            distances.push(both.fold(f64::INFINITY, least));
        }
        monitor.step(1);
        Ok(distances)
    };
    let specific = near.par_iter().map(one).collect::<Result<_, _>>()?;
    monitor.end();
    Ok((general, specific))
}
