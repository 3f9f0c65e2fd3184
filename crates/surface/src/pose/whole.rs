//! Compares motions by their distances over all points, without trimming.

use rayon::prelude::*;

use super::icp;
use super::surface::{Density, PoseSurface};
use crate::similarity::Similarity;

/// Largest number of rounds, with few points, that improve a motion without trimming.
const SETTLING: usize = 4;
/// Weight of the point-to-point terms in these rounds, as in the first stage of a search.
const TANGENTIAL: f64 = 0.2;

/// Sorts motions by their untrimmed distances. Two poses may differ only in a part as small as the trimmed share, such
/// as the knob at one end of a rod.
pub(super) fn in_whole_order(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    density: Density,
    found: Vec<(Similarity, f64)>,
) -> Vec<(Similarity, f64)> {
    if found.len() < 2 {
        return found;
    }
    let ranked = found.into_par_iter().map(|end| (end, whole(moving, fixed, density, &end.0)));
    let mut ranked: Vec<((Similarity, f64), f64)> = ranked.collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    ranked.into_iter().map(|(end, _)| end).collect()
}

/// Returns the smaller of two untrimmed distances: after the motion, and after a few more rounds without trimming that
/// start at one size. With trimming, a motion fits a part of the surfaces and may be off for the whole, more so for one
/// candidate than for another.
pub(super) fn whole(moving: &PoseSurface, fixed: &PoseSurface, density: Density, motion: &Similarity) -> f64 {
    let (a, b) = (moving.view(density), fixed.view(density));
    let [as_it_is, settled] = [*motion, settled(motion, moving, fixed)].map(|motion| icp::distance(a, b, &motion, 0.0));
    as_it_is.min(settled)
}

/// Returns a motion improved by a few rounds without trimming, from the start at one size.
fn settled(motion: &Similarity, moving: &PoseSurface, fixed: &PoseSurface) -> Similarity {
    let start = motion.with_scale(fixed.size() / moving.size(), moving.centre);
    let rounds = icp::Rounds {
        most: SETTLING,
        rest: 1e-3 * fixed.size(),
        gain: icp::GAIN,
        trimmed: 0.0,
        tangential: TANGENTIAL,
        scale: true,
    };
    icp::improved(moving.view(Density::Few), fixed.view(Density::Few), start, &rounds)
}
