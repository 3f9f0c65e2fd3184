//! Refines the correspondence of a group: finds a map of each member's sphere to itself, such that the group becomes as
//! compact as its shapes allow.
//!
//! Members are surfaces f_i over the same sphere and in the same pose. They needn't be registered. The refinement finds
//! diffeomorphisms phi_i of the sphere, one per member, that minimise
//!
//! ```text
//! sum_k log(lambda_k(G) + delta) + mu sum_i E(phi_i),    x_i(u) = f_i(phi_i(u))
//! ```
//!
//! G is the covariance of the x_i over the surfaces' mean area, and lambda_k are its eigenvalues. delta is a positive
//! constant, E the elastic energy of a map, and mu its weight. The first term is the description length of the group
//! (Davies et al. 2002), or the entropy of its distribution (Cates et al. 2007). It decreases if the variance is
//! concentrated in fewer modes. Points stay exactly on their surfaces, and no triangle of the sphere is inverted. Unit
//! normals, multiplied by a length, are channels in addition to the positions. Without normals, points slide along the
//! surfaces to regions in which members differ least. The group then becomes compact, but the correspondence is wrong.
//! The refinement proceeds in stages, from low to high degrees of models and fields.
//!
//! | module | contents |
//! |---|---|
//! | `params`, `report` | settings of a refinement; costs and distortions of each stage |
//! | [`flow`] | a map of the sphere as a sequence of steps; its application and inverse |
//! | `field` | tangent fields from potentials, the adjoint of this map, steps along fields |
//! | `member` | channels, normals and derivatives of one member |
//! | `objective` | the description length and its derivatives with respect to the values |
//! | `elastic`, `held` | the cost of stretching the sphere; the cost of moving fixed points |
//! | `together` | alignment of members to their mean in every step |
//! | `state` | the values, cost and gradient of a group whose members are mapped by given maps |
//! | `reference`, `joining` | a finished group; correspondence of a new member, which leaves the group unchanged |
//! | `descent`, `lbfgs` | one stage; directions of descent |
//!
//! Cost: with C channels, models of degree L and fields of degree D, a step evaluates `4 C` functions of degree L and
//! 12 functions of degree D at n directions for each member. This takes 2 ms per member at L = 15 and 2,562 directions,
//! and 15 ms at L = 40 and 10,242 directions. Memory: 3 values per channel, direction and member.

mod descent;
mod elastic;
mod field;
pub mod flow;
mod held;
mod joining;
mod lbfgs;
mod member;
mod objective;
mod params;
mod reference;
mod report;
mod state;
#[cfg(test)]
mod tests;
mod together;

use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::max_degree_of;
use spharm_monitor::{Monitor, OnlyCancel, Stage};
use spharm_surface::Sphere;
use spharm_surface::geometry::{Vec3, dot, orientation};

use self::descent::descend;
use self::elastic::Elastic;
pub use self::flow::Flow;
use self::held::Held;
pub use self::joining::FinishedGroup;
use self::member::{Member, normals};
use self::objective::Objective;
pub use self::params::{GroupwiseParams, StageParams};
pub use self::report::{Distortion, GroupwiseReport, StageReport};
use self::state::Group;
use crate::error::ShapeError;
use crate::extent::extent;
use crate::geometry::side_by_side;

/// Minimum number of members of a group.
const LEAST: usize = 2;

/// Maps found by a refinement.
#[derive(Debug, Clone, PartialEq)]
pub struct Groupwise {
    /// The map of each member: the point of member i that corresponds to direction u is `f_i(flows[i](u))`.
    pub flows: Vec<Flow>,
    /// Costs, steps and distortions of the stages.
    pub report: GroupwiseReport,
}

/// Refines the correspondence of a group; see the [module](self).
///
/// `members` are canonical coefficients (K, 3 + c) of each member, for the position and c further channels. Scale the
/// further channels so that a difference of 1 has the same weight as a distance of 1. All members are over the same
/// sphere and in the same pose. `sphere` has the triangles and the directions at which members are compared. 2,562
/// directions suffice up to degree 15, and 10,242 directions above degree 15. `mask` (n) holds a non-negative weight
/// for each direction; a weight of 0 excludes the direction. Without a mask all weights are 1.
///
/// Runs on the current rayon pool; the result is bitwise the same on any number of threads.
///
/// # Errors
///
/// - [`ShapeError::TooFewMembers`] if there are fewer than two members.
/// - [`ShapeError::Differ`] if the mask's length isn't the number of directions.
/// - [`ShapeError::Member`] with the index and the error of a member, if its array shape differs from the first
///   member's, it has fewer than three columns, a coefficient isn't finite, [`extent`] fails, or it has no area where
///   the mask is above 0.
/// - [`ShapeError::Setting`] if a setting is out of its range, the sphere has no triangles or clockwise ones, or a
///   weight of the mask is negative or not finite.
/// - [`ShapeError::Interrupted`] if the monitor cancels the refinement.
pub fn groupwise(
    members: &[ArrayView2<'_, f64>],
    sphere: &Sphere,
    mask: Option<&[f64]>,
    params: &GroupwiseParams,
    monitor: &dyn Monitor,
) -> Result<Groupwise, ShapeError> {
    params.check()?;
    let max_degree = check(members, sphere, mask)?;
    let directions = sphere.directions.as_slice();
    let ones = vec![1.0; directions.len()];
    let mask = mask.unwrap_or(&ones);
    let (channels, _) = with_normals(members, params.normals, None, monitor)?;
    let turning = params.together.then(|| {
        let width = channels[0].ncols();
        if params.normals > 0.0 { vec![0, width - 3] } else { vec![0] }
    });
    if let Some(place) = params.held.iter().find(|place| !place.is_within(directions.len())) {
        let found = format!("{:?}", place.corners);
        let expected = "its corners must be indices of the sphere's directions";
        return Err(ShapeError::Setting { name: "the triangle of a fixed point", found, expected });
    }
    let stages = params.stages.clone().unwrap_or_else(|| StageParams::up_to(max_degree));
    let mut flows = vec![Flow::default(); members.len()];
    let mut at = vec![directions.to_vec(); members.len()];
    let mut report = GroupwiseReport::default();
    let total: usize = stages.iter().map(|stage| stage.rounds).sum();
    monitor.begin(Stage::counted("groupwise refinement", "steps"), total as u64);
    for stage in stages {
        let max_degree = stage.max_degree.min(max_degree);
        let group = Group {
            members: channels
                .iter()
                .map(|channels| Member::new(channels.view(), max_degree))
                .collect::<Result<_, _>>()?,
            channels: channels[0].ncols(),
            objective: Objective { faces: &sphere.faces, mask },
            reference: None,
            elastic: Elastic::new(&sphere.faces, directions),
            elasticity: params.elasticity,
            held: Held::new(&params.held, directions, params.hold),
            turning: turning.clone(),
            max_degree,
            field_degree: stage.field_degree,
        };
        let found = descend(&group, stage, params, &mut at, &mut flows, monitor)?;
        monitor.step((stage.rounds - found.steps) as u64);
        report.stages.push(found);
    }
    monitor.end();
    report.moved = at.iter().map(|at| moved(directions, at)).collect();
    Ok(Groupwise { flows, report })
}

/// Rejects invalid input, and returns the highest degree of the members.
fn check(members: &[ArrayView2<'_, f64>], sphere: &Sphere, mask: Option<&[f64]>) -> Result<usize, ShapeError> {
    let Some(first) = members.first().filter(|_| members.len() >= LEAST) else {
        return Err(ShapeError::TooFewMembers { found: members.len(), least: LEAST });
    };
    for (index, member) in members.iter().enumerate() {
        let of_member = |source: ShapeError| ShapeError::Member { index, source: Box::new(source) };
        for (what, expected, found) in [
            ("rows of coefficients", first.nrows(), member.nrows()),
            ("columns of coefficients", first.ncols(), member.ncols()),
        ] {
            if expected != found {
                return Err(of_member(ShapeError::Differ { what, expected, found }));
            }
        }
        if member.ncols() < 3 {
            return Err(of_member(ShapeError::NotASurface { channels: member.ncols() }));
        }
        if let Some(((row, channel), &value)) = member.indexed_iter().find(|(_, value)| !value.is_finite()) {
            return Err(of_member(ShapeError::NotFinite { row, channel, value }));
        }
        let surface = Coefficients::new(member.slice(s![.., ..3]).to_owned())?;
        extent(&surface).map_err(of_member)?;
    }
    let directions = sphere.directions.as_slice();
    let turned = |face: &&[u32; 3]| orientation(face.map(|v| directions[v as usize])) <= 0.0;
    let found = sphere.faces.iter().filter(turned).count();
    if sphere.faces.is_empty() || found > 0 {
        let (name, found) = match found {
            0 => ("the list of the sphere's triangles", "empty".to_owned()),
            found => ("the number of clockwise triangles of the sphere", found.to_string()),
        };
        let expected = "at least one triangle is needed, and all must be counter-clockwise when seen from outside";
        return Err(ShapeError::Setting { name, found, expected });
    }
    if let Some(mask) = mask {
        if mask.len() != directions.len() {
            let (expected, found) = (directions.len(), mask.len());
            return Err(ShapeError::Differ { what: "weights of directions", expected, found });
        }
        if let Some(weight) = mask.iter().find(|weight| !(**weight >= 0.0 && weight.is_finite())) {
            let expected = "it must be finite and at least 0";
            return Err(ShapeError::Setting { name: "the weight of a direction", found: weight.to_string(), expected });
        }
    }
    Ok(max_degree_of(first.nrows()).unwrap_or(0))
}

/// Adds three channels to each member: the unit normals multiplied by a length. If `weight` is 0, adds no channels. The
/// length is `length` if given, otherwise `weight` times the square root of the members' mean area. Returns the
/// extended members and the length.
fn with_normals(
    members: &[ArrayView2<'_, f64>],
    weight: f64,
    length: Option<f64>,
    monitor: &dyn Monitor,
) -> Result<(Vec<Array2<f64>>, f64), ShapeError> {
    if weight == 0.0 {
        return Ok((members.iter().map(|member| member.to_owned()).collect(), 0.0));
    }
    let cancel = OnlyCancel(monitor);
    let found: Result<Vec<(Array2<f64>, f64)>, ShapeError> = members
        .par_iter()
        .map(|member| normals(&Coefficients::new(member.slice(s![.., ..3]).to_owned())?, &cancel))
        .collect();
    let found = found?;
    let area = found.iter().map(|(_, area)| area).sum::<f64>() / members.len() as f64;
    let length = length.unwrap_or(weight * area.sqrt());
    let pairs = members.iter().zip(found);
    let channels = pairs.map(|(member, (normals, _))| side_by_side(&[member.to_owned(), normals * length]));
    Ok((channels.collect(), length))
}

/// Returns the root mean square angle between directions before and after a map, in radians.
fn moved(from: &[Vec3], to: &[Vec3]) -> f64 {
    let squares = from.iter().zip(to).map(|(a, b)| dot(*a, *b).clamp(-1.0, 1.0).acos().powi(2));
    (squares.sum::<f64>() / from.len() as f64).sqrt()
}
