//! Compares motions by their distances over all points, without trimming.

use rayon::prelude::*;

use super::icp;
use super::surface::{Density, PoseSurface};
use crate::similarity::Similarity;

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

/// Returns the untrimmed distance between two surfaces after a motion.
pub(super) fn whole(moving: &PoseSurface, fixed: &PoseSurface, density: Density, motion: &Similarity) -> f64 {
    icp::distance(moving.view(density), fixed.view(density), motion, 0.0)
}
