//! Pulls a template onto a surface by nearest points in both directions. The bending energy of a thin plate, whose
//! stiffness decreases from round to round, keeps the displacements smooth.
//!
//! The method is from B. Amberg, S. Romdhani and T. Vetter, "Optimal step nonrigid ICP algorithms for surface
//! registration", CVPR 2007. Each point of the template is paired with the nearest point of the subject, by position
//! and normal, and each point of the subject with the nearest point of the template. The pairs that start at the
//! subject's points pull the template into tips of the subject, which aren't nearest to any point of the template.
//! Distances along the subject's normal have full weight, and distances within the surface have a small weight. Each
//! round solves
//!
//! ```text
//! (S^T W S + stiffness / N L^T L) v = S^T W r,   W = w (m m^T + tangential I) for each pair
//! ```
//!
//! for the displacement v of the N vertices, where L is the Laplacian of the [plate](crate::plate), S interpolates
//! within triangles, and r has the vector from the template's point to the subject's point for each pair. w is the
//! weight of a pair, and m the subject's unit normal. The equations are solved by conjugate gradients. The
//! preconditioner is the Cholesky factor of the matrix with `W = w (1/3 + tangential) I`. A round costs this
//! factorisation, and about 200 flops per pair and 2,000 per vertex for each iteration.

use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, add, dot, scale as times, sub, unit};
use spharm_surface::{Place, SpreadPoints};

use crate::error::RegisterError;
use crate::guide::Guide;
use crate::params::RegisterParams;
use crate::plate::{PlateFactor, PlateMatrix};
use crate::subject::{PointTree, Subject};
use crate::template::{Template, doubled_normal, length};

/// The iteration ends when the residual's norm is at most this fraction of the right-hand side's norm.
const ACCURACY: f64 = 1e-2;
const MOST_ITERATIONS: usize = 40;
/// Number of points spread over the subject, per vertex of the template, among which each vertex's nearest point is
/// found.
const SOUGHT: usize = 4;
/// Number of points on the subject, per vertex of the template, for which the nearest point of the template is found.
const SEEKING: f64 = 1.5;
/// Barycentric coordinates of the four points in each triangle of the template that can be paired with points of the
/// subject: the centres of the triangle's quarters.
const QUARTERS: [[f64; 3]; 4] = [
    [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0],
    [2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0],
    [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0],
    [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0],
];

/// A point of the template, the point of the subject to which it is pulled, and the normal along which the pull is
/// strongest.
struct Pair {
    vertices: [u32; 3],
    weights: [f64; 3],
    /// Vector from the template's point to the subject's point.
    off: Vec3,
    normal: Vec3,
    weight: f64,
}

/// Pulls the template's vertices from `start` onto the subject, and returns them. `free` (n) marks vertices that aren't
/// pulled.
///
/// # Errors
///
/// [`RegisterError::Singular`] if the equations have no finite solution, and [`RegisterError::Interrupted`] if
/// `monitor` cancels the registration.
pub fn snap(
    template: &Template,
    start: &[Vec3],
    free: &[bool],
    subject: &Subject,
    guides: &[Guide],
    params: &RegisterParams,
    monitor: &dyn Monitor,
) -> Result<Vec<Vec3>, RegisterError> {
    let n = start.len();
    let normal = params.normal * template.scale;
    let sought = subject.spread(SOUGHT * n, 1);
    let seeking = subject.spread((SEEKING * n as f64) as usize, 2);
    let tree = PointTree::new(&sought, normal)?;
    let mut vertices = start.to_vec();
    for stiffness in &params.stiffness {
        monitor.check()?;
        let mut pairs = to_subject(template, &vertices, free, subject, &sought, &tree);
        pairs.extend(to_template(template, &vertices, free, &seeking, normal, params.back)?);
        for pair in &mut pairs {
            let far = length(pair.off) / (params.robust * template.scale);
            pair.weight /= (1.0 + far * far).sqrt();
        }
        // A landmark set by a person is never an outlier, however far away it is.
        pairs.extend(guides.iter().flat_map(|guide| of_guide(guide, &vertices, params.landmark / n as f64)));
        let displacement = step(template, &pairs, stiffness / n as f64, params.tangential)?;
        vertices.iter_mut().zip(displacement).for_each(|(y, v)| *y = add(*y, v));
        if vertices.iter().flatten().any(|value| !value.is_finite()) {
            return Err(RegisterError::Singular);
        }
    }
    Ok(vertices)
}

/// Returns three pairs, one per coordinate axis, that together pull the template's landmark to the guide's point. A
/// single pair pulls only along its normal.
fn of_guide(guide: &Guide, vertices: &[Vec3], weight: f64) -> [Pair; 3] {
    let off = sub(guide.point, guide.place.of(vertices));
    let Place { corners, shares } = guide.place;
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|normal| Pair {
        vertices: corners,
        weights: shares,
        off,
        normal,
        weight,
    })
}

/// Pairs each vertex with its nearest point of the subject, weighted by its share of the area. A vertex whose nearest
/// point is on the border of an open surface gets no pair. Otherwise the vertices of a part that the subject lacks
/// would all be pulled to the border.
fn to_subject(
    template: &Template,
    vertices: &[Vec3],
    free: &[bool],
    subject: &Subject,
    sought: &SpreadPoints,
    tree: &PointTree,
) -> Vec<Pair> {
    let (normals, areas) = normals_and_areas(vertices, &template.mesh.faces);
    let total: f64 = areas.iter().sum();
    let kept = (0..vertices.len()).filter(|v| !free[*v]);
    kept.filter_map(|v| {
        let found = tree.nearest(vertices[v], normals[v]);
        let v32 = v as u32;
        let on_border = subject.open[sought.triangles[found] as usize].contains(&true);
        (!on_border).then_some(Pair {
            vertices: [v32, v32, v32],
            weights: [1.0, 0.0, 0.0],
            off: sub(sought.points[found], vertices[v]),
            normal: sought.normals[found],
            weight: areas[v] / total,
        })
    })
    .collect()
}

/// Pairs each of the given points on the subject with the nearest point of the template.
fn to_template(
    template: &Template,
    vertices: &[Vec3],
    free: &[bool],
    seeking: &SpreadPoints,
    normal: f64,
    back: f64,
) -> Result<Vec<Pair>, RegisterError> {
    let mut places = SpreadPoints::default();
    let drawn = |face: &[u32; 3]| !face.iter().any(|v| free[*v as usize]);
    for (index, face) in template.mesh.faces.iter().enumerate().filter(|(_, face)| drawn(face)) {
        let own = unit(doubled_normal(vertices, *face));
        for weights in QUARTERS {
            places.points.push(inside(vertices, *face, weights));
            places.normals.push(own);
            places.triangles.push(index as u32);
            places.barycentric.push(weights);
        }
    }
    if places.points.is_empty() {
        return Ok(Vec::new());
    }
    let tree = PointTree::new(&places, normal)?;
    let weight = back / seeking.points.len() as f64;
    let pairs = seeking.points.iter().zip(&seeking.normals).map(|(point, of)| {
        let found = tree.nearest(*point, *of);
        Pair {
            vertices: template.mesh.faces[places.triangles[found] as usize],
            weights: places.barycentric[found],
            off: sub(*point, places.points[found]),
            normal: *of,
            weight,
        }
    });
    Ok(pairs.collect())
}

fn inside(vertices: &[Vec3], face: [u32; 3], weights: [f64; 3]) -> Vec3 {
    let [a, b, c] = face.map(|v| vertices[v as usize]);
    std::array::from_fn(|k| weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k])
}

/// Returns the unit normal of each vertex, and a third of the area of its triangles.
pub(crate) fn normals_and_areas(vertices: &[Vec3], faces: &[[u32; 3]]) -> (Vec<Vec3>, Vec<f64>) {
    let (mut normals, mut areas) = (vec![[0.0; 3]; vertices.len()], vec![0.0; vertices.len()]);
    for face in faces {
        let doubled = doubled_normal(vertices, *face);
        let area = length(doubled) / 6.0;
        for v in face.map(|v| v as usize) {
            normals[v] = add(normals[v], doubled);
            areas[v] += area;
        }
    }
    normals.iter_mut().for_each(|normal| *normal = unit(*normal));
    (normals, areas)
}

/// Solves the equations of one round, and returns the displacement of each vertex.
fn step(template: &Template, pairs: &[Pair], stiffness: f64, tangential: f64) -> Result<Vec<Vec3>, RegisterError> {
    let plate = template.plate.times(stiffness);
    let mut middle = template.plate.times(stiffness);
    let mut right = vec![[0.0; 3]; template.mesh.vertices.len()];
    for pair in pairs {
        let weight = pair.weight * (1.0 / 3.0 + tangential);
        for (v, a) in pair.vertices.iter().zip(pair.weights).filter(|(_, a)| *a != 0.0) {
            for (w, b) in pair.vertices.iter().zip(pair.weights).filter(|(_, b)| *b != 0.0) {
                middle.add(*v, *w, weight * a * b);
            }
        }
        pair.spread(pair.weighted(pair.off, tangential), &mut right);
    }
    let factor = middle.factor()?;
    Ok(conjugate_gradients(&plate, pairs, tangential, &right, &factor))
}

impl Pair {
    /// Returns `W x`, with W the pair's 3 x 3 matrix of weights.
    fn weighted(&self, x: Vec3, tangential: f64) -> Vec3 {
        let along = dot(self.normal, x);
        std::array::from_fn(|k| self.weight * (self.normal[k] * along + tangential * x[k]))
    }

    /// Adds `S^T x` to `out`, with S the interpolation at the pair's point of the template.
    fn spread(&self, x: Vec3, out: &mut [Vec3]) {
        for (v, weight) in self.vertices.iter().zip(self.weights).filter(|(_, weight)| *weight != 0.0) {
            let out = &mut out[*v as usize];
            *out = add(*out, times(x, weight));
        }
    }

    /// Returns `S x`: the vertices' vectors x, interpolated at the pair's point of the template.
    fn gather(&self, x: &[Vec3]) -> Vec3 {
        let [a, b, c] = self.vertices.map(|v| x[v as usize]);
        std::array::from_fn(|k| self.weights[0] * a[k] + self.weights[1] * b[k] + self.weights[2] * c[k])
    }
}

fn conjugate_gradients(
    plate: &PlateMatrix<'_>,
    pairs: &[Pair],
    tangential: f64,
    right: &[Vec3],
    factor: &PlateFactor,
) -> Vec<Vec3> {
    let inner = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| dot(*a, *b)).sum::<f64>();
    let mut found = vec![[0.0; 3]; right.len()];
    let mut residual = right.to_vec();
    let enough = ACCURACY * ACCURACY * inner(right, right);
    let mut ahead = factor.solve(&residual);
    let mut direction = ahead.clone();
    let mut along = inner(&residual, &ahead);
    for _ in 0..MOST_ITERATIONS {
        let goes_on = inner(&residual, &residual) > enough && along > 0.0;
        if !goes_on {
            break;
        }
        let mut product = vec![[0.0; 3]; right.len()];
        plate.add_product(&direction, &mut product);
        for pair in pairs {
            pair.spread(pair.weighted(pair.gather(&direction), tangential), &mut product);
        }
        let step = along / inner(&direction, &product);
        for v in 0..found.len() {
            found[v] = add(found[v], times(direction[v], step));
            residual[v] = sub(residual[v], times(product[v], step));
        }
        ahead = factor.solve(&residual);
        let next = inner(&residual, &ahead);
        for (direction, ahead) in direction.iter_mut().zip(&ahead) {
            *direction = add(*ahead, times(*direction, next / along));
        }
        along = next;
    }
    found
}
