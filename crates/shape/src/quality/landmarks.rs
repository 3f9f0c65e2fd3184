//! Measures landmark errors, which show whether points at equal directions correspond. Each landmark has a direction on
//! each member. A landmark error is the distance between two points on one member's surface: the points at the
//! directions that the landmark has on this member and on another member.
//!
//! A manually placed landmark p of member i is assigned the direction u of the nearest point on the member's surface.
//! The error of the pair of members i and k is the distance between f_k(u) and f_k(u'), where u' is the direction of
//! the same landmark of member k. Both points lie on the surface of member k, so the distances of the landmarks from
//! the surfaces don't matter.

use rayon::prelude::*;
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::{Monitor, Silent};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::{Vec3, add, dot, scale, sub, unit};
use spharm_surface::nearest::TriangleTree;

use super::bands::{draw, quantile};
use super::params::QualityParams;
use super::points::evaluate;
use crate::ShapeError;
use crate::extent::extent;
use crate::geometry::{local_geometry, tangent_frame};

/// Maximum number of Gauss-Newton steps that move a point from a facet to the smooth surface.
const STEPS: usize = 10;

/// Landmark errors of n members with p landmarks each, in the members' unit.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkErrors {
    /// Mean error over all pairs of members and all landmarks.
    pub mean: f64,
    /// Median error over all pairs of members and all landmarks.
    pub median: f64,
    /// 95 % band of the mean error, from a bootstrap over the members; `None` if no bands were requested.
    pub band: Option<[f64; 2]>,
    /// Mean error of each of the p landmarks over all pairs of members.
    pub by_landmark: Vec<f64>,
    /// Distance of each landmark from the surface of its member: n lists of p distances.
    pub off: Vec<Vec<f64>>,
}

/// Measures the landmark errors of all pairs of members. `landmarks` has a list of p points for each of the n members,
/// in the frame of that member, so moving a member together with its landmarks has no effect.
///
/// # Errors
///
/// [`ShapeError::Differ`] if the number of members or of landmarks differs; [`ShapeError::NotFiniteValue`] if a
/// landmark is NaN or infinite; [`ShapeError::Member`] if [`extent`](crate::extent::extent) rejects a member;
/// [`ShapeError::Interrupted`] if the monitor cancels.
pub(super) fn landmark_errors(
    members: &[Coefficients],
    landmarks: &[Vec<Vec3>],
    params: &QualityParams,
    monitor: &dyn Monitor,
) -> Result<LandmarkErrors, ShapeError> {
    let (n, places) = (members.len(), landmarks.first().map_or(0, Vec::len));
    if landmarks.len() != n {
        return Err(ShapeError::Differ { what: "members with landmarks", expected: n, found: landmarks.len() });
    }
    for (row, own) in landmarks.iter().enumerate() {
        if own.len() != places || places == 0 {
            return Err(ShapeError::Differ {
                what: "landmarks of a member",
                expected: places.max(1),
                found: own.len(),
            });
        }
        if let Some(column) = own.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(ShapeError::NotFiniteValue { what: "landmarks", row, column });
        }
    }
    // The icosphere has one subdivision more than for the other measures, because directions are interpolated between
    // vertices.
    let sphere = icosphere((params.subdivisions + 1).min(7));
    let directions = Directions::from_vertices(&sphere.vertices)?;
    let found: Vec<Result<Vec<(Vec3, f64)>, ShapeError>> = members
        .par_iter()
        .zip(landmarks)
        .enumerate()
        .map(|(index, (member, own))| {
            monitor.check()?;
            let surface = extent(member).and_then(|_| evaluate(&directions, member));
            let surface = surface.map_err(|source| ShapeError::Member { index, source: Box::new(source) })?;
            let tree = TriangleTree::new(&Mesh::new(surface, sphere.faces.clone()));
            own.iter().map(|&p| direction(&tree, &sphere, member, p)).collect()
        })
        .collect();
    let found: Vec<Vec<(Vec3, f64)>> = found.into_iter().collect::<Result<_, _>>()?;
    let all: Vec<Vec3> = found.iter().flatten().map(|(u, _)| *u).collect();
    let all = Directions::from_vertices(&all)?;
    // Points on each member's surface at the landmark directions of all members.
    let carried: Vec<Vec<Vec3>> =
        members.par_iter().map(|member| evaluate(&all, member)).collect::<Result<_, ShapeError>>()?;
    let error = |i: usize, k: usize, place: usize| {
        let off = sub(carried[k][i * places + place], carried[k][k * places + place]);
        dot(off, off).sqrt()
    };
    let pairs: Vec<(usize, usize)> =
        (0..n).flat_map(|i| (0..n).filter(move |&k| k != i).map(move |k| (i, k))).collect();
    let mut errors: Vec<f64> = pairs
        .iter()
        .flat_map(|&(i, k)| (0..places).map(move |place| (i, k, place)))
        .map(|(i, k, p)| error(i, k, p))
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    errors.sort_by(f64::total_cmp);
    let by_landmark =
        (0..places).map(|place| pairs.iter().map(|&(i, k)| error(i, k, place)).sum::<f64>() / pairs.len() as f64);
    let of_pair = |i: usize, k: usize| (0..places).map(|place| error(i, k, place)).sum::<f64>() / places as f64;
    Ok(LandmarkErrors {
        mean,
        median: quantile(&errors, 0.5),
        band: band(n, &of_pair, params),
        by_landmark: by_landmark.collect(),
        off: found.iter().map(|own| own.iter().map(|(_, off)| *off).collect()).collect(),
    })
}

/// Returns the direction of the point on the surface nearest to p, and the distance of that point from p.
///
/// The nearest point of the facets is moved to the nearest point of the smooth surface by Gauss-Newton steps in the
/// tangent plane, `(E F; F G) d = (X_1 . r, X_2 . r)`. X is the surface, with the tangents X_1 and X_2 and the
/// coefficients E, F and G of the first fundamental form at u, and r = p - X(u). Without these steps, the facets would
/// bias the direction of a landmark that is off the surface.
fn direction(tree: &TriangleTree, sphere: &Mesh, member: &Coefficients, p: Vec3) -> Result<(Vec3, f64), ShapeError> {
    let Some(found) = tree.nearest(p) else { return Ok(([0.0, 0.0, 1.0], f64::INFINITY)) };
    let face = sphere.faces[found.triangle as usize];
    let mixed = face
        .iter()
        .zip(found.barycentric)
        .fold([0.0; 3], |sum, (&v, weight)| add(sum, scale(sphere.vertices[v as usize], weight)));
    let at = |u: Vec3| -> Result<_, ShapeError> {
        let local = local_geometry(member, &Directions::from_vertices(&[u])?, &Silent)?[0];
        let rest = sub(p, local.position);
        Ok((u, dot(rest, rest).sqrt(), local, rest))
    };
    let mut best = at(unit(mixed))?;
    for _ in 0..STEPS {
        let (u, distance, local, rest) = best;
        let [e, f, g] = local.first_form;
        let [a, b] = local.tangents.map(|tangent| dot(tangent, rest));
        let area = e * g - f * f;
        if local.is_singular() || area <= 0.0 {
            break;
        }
        let frame = tangent_frame(u);
        let step = add(scale(frame[0], (g * a - f * b) / area), scale(frame[1], (e * b - f * a) / area));
        let next = at(unit(add(u, step)))?;
        if next.1 >= distance {
            break;
        }
        best = next;
    }
    Ok((best.0, best.1))
}

/// Returns the 95 % band of the mean error over pairs of different members, from a bootstrap over the members.
fn band(n: usize, of_pair: &impl Fn(usize, usize) -> f64, params: &QualityParams) -> Option<[f64; 2]> {
    let mut means: Vec<f64> = (0..params.bands)
        .map(|index| {
            let rows = draw(n, params.seed, index);
            let pairs = rows.iter().flat_map(|&i| rows.iter().filter(move |&&k| k != i).map(move |&k| (i, k)));
            let (sum, count) = pairs.fold((0.0, 0_usize), |(sum, count), (i, k)| (sum + of_pair(i, k), count + 1));
            sum / count.max(1) as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    (!means.is_empty()).then(|| [quantile(&means, 0.025), quantile(&means, 0.975)])
}
