//! Moves members from the frames in which their corresponding points are found to their final frames.
//!
//! If size explains the differences in a group, the members' points are found at the template's size
//! ([`GroupPoses::at_one_size`](spharm_surface::pose::GroupPoses::at_one_size)). At its own size, the point nearest to
//! a place wouldn't be the corresponding one even on a body of the same shape, and the registration and the refinement
//! would take part of the difference in size for a difference in shape.

use spharm_surface::Similarity;
use spharm_surface::geometry::Vec3;

use super::params::CorrespondParams;
use super::together::{centre, weights};

/// Moves each member to its own size, about its centre, or back to its given pose if this is kept; mirrored members
/// then to the mirror images of these. `similarities` map the surfaces to the frames in which the members' points
/// `places` were found. Returns the motions.
pub(super) fn to_final(
    similarities: &[Similarity],
    places: &mut [Vec<Vec3>],
    (faces, masked): (&[[u32; 3]], &[bool]),
    params: &CorrespondParams,
) -> Vec<Similarity> {
    let motion = |(index, own): (usize, &Similarity), places: &Vec<Vec3>| {
        if params.keep_poses {
            own.inverse().then(&params.reflection(index).unwrap_or_default())
        } else if params.pose.scale || own.scale == 1.0 {
            Similarity::default()
        } else {
            let areas = weights(std::slice::from_ref(places), faces, masked);
            Similarity::default().with_scale(1.0 / own.scale, centre(places, &areas))
        }
    };
    let found = similarities.iter().enumerate().zip(places.iter());
    let motions: Vec<Similarity> = found.map(|(own, places)| motion(own, places)).collect();
    for (motion, places) in motions.iter().zip(places) {
        if *motion != Similarity::default() {
            places.iter_mut().for_each(|place| *place = motion.apply(*place));
        }
    }
    motions
}
