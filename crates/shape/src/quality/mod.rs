//! Measures the quality of a group's correspondence. The measures are the compactness, generalisation and specificity
//! of the group's modes, with points weighted by surface area, and the errors of landmarks. Generalisation and
//! specificity are also measured by the distance between surfaces.
//!
//! Members are evaluated at the directions u of an icosphere, which gives points x_i(u). The weight w(u) of a direction
//! is the fraction of a member's area that belongs to the vertex at u, averaged over the members, so that
//!
//! ```text
//! <x, y> = sum_u w(u) x(u) . y(u),    sum_u w(u) = 1,    G_ij = <x_i - c, x_j - c>,    c = mean of the x_i
//! ```
//!
//! With these weights, distances are root mean squares over the surface. Root mean squares over the sphere would be
//! less suitable, because a thin process of the surface may occupy most of the directions. The members' centres of area
//! are moved to the origin. The measures of the first k modes, k = 1 to m, are:
//!
//! - *compactness*: the fraction of the total variance that lies along the modes;
//! - *generalisation*: the mean distance of a member from the nearest shape that the modes of all other members can
//!   form;
//! - *specificity*: the mean distance of a random combination of the modes from the nearest member.
//!
//! These measures are from M. A. Styner et al., "Evaluation of 3D correspondence methods for model building", IPMI
//! (2003). All three measures improve if directions slide to regions in which members differ least, so none of them
//! proves correspondence. A proof needs external knowledge, such as [`landmarks`].
//!
//! *Distances between surfaces* give a second version of generalisation and specificity. The distance between two
//! surfaces is the area-weighted mean of the distances from points of each surface to the nearest points of the other
//! surface. Sliding points along a surface can't reduce this distance.
//!
//! *Bands* are computed by a bootstrap over the members; see `bands`.
//!
//! Cost, for n members, V directions and m modes: `V n (n + m)` operations for the products, and a decomposition of
//! an (n, n) matrix for each of up to 200 members. Distances between surfaces take about 10 ms for each member and
//! mode at V = 2,562.

mod bands;
mod curves;
pub mod landmarks;
mod params;
mod points;
mod surfaces;

use spharm_harmonics::Coefficients;
use spharm_monitor::{Monitor, Stage};
use spharm_surface::geometry::Vec3;

use crate::ShapeError;
use landmarks::{LandmarkErrors, landmark_errors};
use points::Points;

pub use params::{Curve, QualityParams};

/// Quality of a group of n members; lengths are in the members' unit.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupQuality {
    /// Total variance of the group along all modes, area-weighted, in the squared unit of the members' lengths.
    pub variance: f64,
    /// Variance along each of the m modes.
    pub variances: Vec<f64>,
    /// Fraction of the total variance that lies along the first k modes.
    pub compactness: Curve,
    /// Mean distance of a member from the nearest shape that the first k modes of the other members can form.
    pub generalisation: Curve,
    /// Mean distance of a random combination of the first k modes from the nearest member.
    pub specificity: Curve,
    /// Generalisation measured by the distance between surfaces, if requested. Its band is from a bootstrap over the
    /// members' distances. The modes aren't recomputed for each draw.
    pub surface_generalisation: Option<Curve>,
    /// Specificity measured by the distance between surfaces, without a band, if requested. It is computed for the
    /// first 100 random shapes. Each shape is compared with the two members that are nearest at corresponding points,
    /// and the smaller distance is used.
    pub surface_specificity: Option<Curve>,
    /// Errors of the landmarks, if landmarks were given.
    pub landmarks: Option<LandmarkErrors>,
}

const STAGE: Stage = Stage::counted("quality", "members");

/// Measures the quality of the correspondence between at least 3 surfaces, whose degrees may differ. `landmarks` has a
/// list of points for each member, in the member's frame, with the same landmarks in the same order.
///
/// Runs on the current rayon pool; the result is bitwise the same on any number of threads.
///
/// # Errors
///
/// [`ShapeError::TooFewMembers`] if there are fewer than 3 members; [`ShapeError::Setting`] if the number of modes or
/// samples is 0, or the mask keeps no area of a surface; [`ShapeError::Member`] if [`extent`](crate::extent::extent)
/// rejects a member; [`ShapeError::Differ`] if the number of landmarks differs between members, the number of lists of
/// landmarks isn't the number of members, or the mask's length isn't the icosphere's number of directions;
/// [`ShapeError::NotFiniteValue`] if a landmark isn't finite; [`ShapeError::NoDecomposition`] if a decomposition
/// doesn't converge; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn group_quality(
    members: &[Coefficients],
    landmarks: Option<&[Vec<Vec3>]>,
    params: &QualityParams,
    monitor: &dyn Monitor,
) -> Result<GroupQuality, ShapeError> {
    let n = members.len();
    if n < 3 {
        return Err(ShapeError::TooFewMembers { found: n, least: 3 });
    }
    for (name, found) in [("modes", params.modes), ("samples", params.samples)] {
        if found == 0 {
            return Err(ShapeError::Setting { name, found: "0".to_owned(), expected: "at least 1 is needed" });
        }
    }
    let landmarks = landmarks.map(|points| landmark_errors(members, points, params, monitor)).transpose()?;
    let mut points = Points::of(members, params, monitor)?;
    if params.rigid {
        points.bring_together();
    }
    let scores = points.scores()?;
    let most = params.modes.min(n - 1);
    let rows: Vec<usize> = (0..n).collect();
    monitor.begin(STAGE, curves::left_out(n, curves::LEFT_OUT).count() as u64);
    let model = curves::Model::of(&scores, &rows)?;
    let left = curves::leave_out(&model, most, curves::LEFT_OUT, monitor)?;
    let near = curves::nearest(&model, most, params.samples, params.seed);
    monitor.end();
    let found = curves::Curves {
        compactness: model.compactness(most),
        generalisation: curves::mean_of(left.iter().map(|left| left.distances.as_slice()), most),
        specificity: curves::mean_of(near.iter().map(|near| near.distances.as_slice()), most),
    };
    let bands = bands::bands(&scores, &found, most, params, monitor)?;
    let [compactness, generalisation, specificity] = bands;
    let (mut surface_generalisation, mut surface_specificity) = (None, None);
    if params.surfaces {
        let (general, specific) = surfaces::distances(&points, &model, &left, &near, most, monitor)?;
        surface_generalisation = Some(bands::of_rows(&general, most, params));
        let values = curves::mean_of(specific.iter().map(Vec::as_slice), most);
        surface_specificity = Some(Curve { values, ..Curve::default() });
    }
    Ok(GroupQuality {
        variance: model.total(),
        variances: model.variances[..most].to_vec(),
        compactness,
        generalisation,
        specificity,
        surface_generalisation,
        surface_specificity,
        landmarks,
    })
}

#[cfg(test)]
mod tests;
