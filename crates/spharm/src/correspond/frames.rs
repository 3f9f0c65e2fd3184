//! Moves members from the frames in which their corresponding points are found to their final frames.
//!
//! If size explains the differences in a group, each member is scaled to the template's size before its corresponding
//! points are found ([`GroupPoses::at_one_size`](spharm_surface::pose::GroupPoses::at_one_size)). If two bodies have
//! the same shape but different sizes, the nearest point on the other body isn't the corresponding point. The
//! registration and the refinement would therefore treat part of a difference in size as a difference in shape.

use spharm_surface::Similarity;
use spharm_surface::geometry::Vec3;

use super::params::CorrespondParams;
use super::together::{centre, weights};

/// Scales each member back to its own size, about its centre. If given poses are kept, moves each member back to its
/// given pose instead, or to the mirror image of this pose if the member is mirrored. `similarities` map the surfaces
/// to the frames in which the members' points `places` were found. Returns the motions.
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
