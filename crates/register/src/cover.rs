//! Measures how well a registered template and a subject's surface cover each other.

use rayon::prelude::*;
use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;

use crate::subject::Subject;
use crate::template::Template;

/// Number of points on the subject's surface whose distances from the template are measured.
const POINTS: usize = 5000;

/// Distances of a subject's surface from the registered template, in the unit of the coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cover {
    /// Root mean square of the distances over the subject's area.
    pub rms: f64,
    /// 99th percentile of the distances over the subject's area.
    pub most: f64,
    /// The largest distance measured.
    pub farthest: f64,
    /// Fraction of the subject's area whose distance from the template exceeds `RegisterParams::reach`.
    pub unreached: f64,
}

impl Cover {
    /// Measures the distances from points spread over the subject's area to the template, whose vertices are moved to
    /// `vertices`. Points whose distance is above `reach` are counted as unreached.
    #[must_use]
    pub fn measure(template: &Template, vertices: &[Vec3], subject: &Subject, reach: f64) -> Self {
        let tree = TriangleTree::new(&template.mesh.with_vertices(vertices.to_vec()));
        let points = subject.spread(POINTS, 9).points;
        let distance = |point: &Vec3| tree.nearest(*point).map_or(f64::INFINITY, |found| found.distance);
        let mut distances: Vec<f64> = points.par_iter().map(distance).collect();
        distances.sort_unstable_by(f64::total_cmp);
        let count = distances.len().max(1) as f64;
        let at = |share: f64| distances.get(((count - 1.0) * share) as usize).copied().unwrap_or(0.0);
        Self {
            rms: (distances.iter().map(|distance| distance * distance).sum::<f64>() / count).sqrt(),
            most: at(0.99),
            farthest: at(1.0),
            unreached: distances.iter().filter(|distance| **distance > reach).count() as f64 / count,
        }
    }
}

/// Returns the root mean square and the maximum of the distances between template and subject, measured in both
/// directions: from unmasked vertices to the subject, and from the subject to the template.
pub(crate) fn apart(template: &Template, vertices: &[Vec3], subject: &Subject) -> (f64, f64) {
    let kept = (0..vertices.len()).into_par_iter().filter(|v| !template.masked[*v]);
    let distances = kept.map(|v| subject.tree.nearest(vertices[v]).map_or(0.0, |found| found.distance));
    let distances: Vec<f64> = distances.collect();
    let there = distances.iter().map(|distance| distance * distance).sum::<f64>() / distances.len().max(1) as f64;
    let back = Cover::measure(template, vertices, subject, 0.0);
    let farthest = distances.iter().fold(back.farthest, |farthest, distance| farthest.max(*distance));
    ((0.5 * (there + back.rms * back.rms)).sqrt(), farthest)
}

/// Returns whether each of the n vertices is free, that is, not pulled by the subject. A masked vertex is free. A
/// vertex is also free if its nearest point is farther than `reach` and on the border of an open surface, because the
/// subject then lacks the corresponding part.
pub(crate) fn free(template: &Template, vertices: &[Vec3], subject: &Subject, reach: f64) -> Vec<bool> {
    let lacks = |point: &Vec3| {
        let found = subject.tree.nearest(*point);
        found.is_some_and(|found| found.distance > reach && on_border(subject, found.triangle, found.barycentric))
    };
    vertices.par_iter().zip(&template.masked).map(|(point, masked)| *masked || lacks(point)).collect()
}

/// Returns whether each vertex, before its projection, has a counterpart on the subject. A vertex has a counterpart if
/// it isn't free, and if its nearest point is within `reach` and not on the border of an open surface.
pub(crate) fn reached(free: &[bool], vertices: &[Vec3], subject: &Subject, reach: f64) -> Vec<bool> {
    let reached = |(point, free): (&Vec3, &bool)| {
        let found = subject.tree.nearest(*point);
        let found =
            found.filter(|found| found.distance <= reach && !on_border(subject, found.triangle, found.barycentric));
        !free && found.is_some()
    };
    vertices.par_iter().zip(free).map(reached).collect()
}

fn on_border(subject: &Subject, triangle: u32, barycentric: [f64; 3]) -> bool {
    let open = subject.open[triangle as usize];
    (0..3).any(|corner| open[corner] && barycentric[corner] < 1e-9)
}
