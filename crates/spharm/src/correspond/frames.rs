//! Gives members their own sizes or poses again.
//!
//! Corresponding points are found with all members at one size. If the sizes differed, the point nearest to a place
//! wouldn't be the corresponding one even between bodies of one shape, and the registration and the refinement would
//! take part of the difference in size for a difference in shape.

use std::f64::consts::PI;

use spharm_harmonics::Coefficients;
use spharm_shape::transform_object;
use spharm_surface::Similarity;
use spharm_surface::geometry::Vec3;

use super::params::CorrespondParams;
use super::together::{centre, weights};
use crate::Error;

/// Returns the motion of a member from the frame in which its points were found, to which `similarity` maps the
/// surface, to its final frame: at its own size about its centre; for kept poses, where the surface was; with `scale`,
/// where it is. `index` is the member's index in the group.
pub(super) fn to_final(
    index: usize,
    similarity: &Similarity,
    places: &[Vec3],
    (faces, masked): (&[[u32; 3]], &[bool]),
    params: &CorrespondParams,
) -> Similarity {
    if params.keep_poses {
        similarity.inverse().then(&params.reflection(index).unwrap_or_default())
    } else if params.pose.scale {
        Similarity::default()
    } else {
        let areas = weights(std::slice::from_ref(&places.to_vec()), faces, masked);
        Similarity::default().with_scale(1.0 / similarity.scale, centre(places, &areas))
    }
}

/// Returns a member's coefficients at the size of `mean`, about the member's centre. The size is the root of the power
/// of degrees 1 and above.
pub(super) fn at_size_of(mean: &Coefficients, member: &Coefficients) -> Result<Coefficients, Error> {
    let size = |of: &Coefficients| of.values().rows().into_iter().skip(1).flatten().map(|a| a * a).sum::<f64>().sqrt();
    let factor = size(mean) / size(member);
    if !factor.is_normal() {
        return Ok(member.clone());
    }
    let centre = std::array::from_fn(|axis| member.values()[[0, axis]] / (4.0 * PI).sqrt());
    Ok(transform_object(member, &Similarity::default().with_scale(factor, centre))?)
}
