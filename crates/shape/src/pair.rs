//! Searches the rotations of the parameters and of space jointly for a pair of surfaces.
//!
//! Let f and g be the coefficients of the two surfaces without row 0, R a rotation of the parameters, and Q a rotation
//! of space. Then `|Q R f - g|^2 = |f|^2 + |g|^2 - 2 tr Q^T M(R)` with `M_ij(R) = <g_i, R f_j>`. The best Q for a given
//! R has a closed form ([`kabsch`](spharm_surface::kabsch)), so a search over a [grid](crate::so3_grid) of R alone
//! finds both rotations. The best local maxima of the grid are [refined](mod@crate::refine). The four rotations that
//! align the axes of both surfaces' [first-order ellipsoids](crate::foe) are refined too, because optima that are half
//! turns apart may be nearly equal. If mirror images are allowed, Q may be a reflection, and f(-u) is searched in
//! addition to f(u).

use rayon::prelude::*;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::Monitor;

use crate::foe::common_axes;
use crate::half_turn::Workspace;
use crate::matrix3::determinant;
use crate::refine::{Fit, Space, Target, distance, outer, refine};
use crate::rotate::Rotator;
use crate::rotation::Rotation;
use crate::so3_grid::{Peak, So3Grid};
use spharm_surface::kabsch::svd;

/// Coefficients of a surface without row 0, scaled to norm 1.
#[derive(Debug, Clone)]
pub(crate) struct Unit {
    /// Coefficients (K, 3), with row 0 set to zero.
    pub(crate) rows: Vec<[f64; 3]>,
    /// Norm before scaling; zero for a surface that is a single point.
    pub(crate) norm: f64,
}

impl Unit {
    /// Truncates finite coefficients (K, 3) to the degree `degree`, and centres and scales them.
    pub(crate) fn new(coefficients: &Coefficients, degree: usize) -> Self {
        let rows = coefficients.up_to(degree);
        let mut rows: Vec<[f64; 3]> = rows.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
        rows[0] = [0.0; 3];
        // Rows are first scaled by the largest value, so that squares neither overflow nor underflow.
        let largest = rows.as_flattened().iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
        let total = coefficients.values().iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
        if largest <= 1e-14 * total {
            rows.iter_mut().for_each(|row| *row = [0.0; 3]);
            return Self { rows, norm: 0.0 };
        }
        rows.as_flattened_mut().iter_mut().for_each(|v| *v /= largest);
        let length = rows.as_flattened().iter().map(|v| v * v).sum::<f64>().sqrt();
        rows.as_flattened_mut().iter_mut().for_each(|v| *v /= length);
        Self { rows, norm: largest * length }
    }

    /// Returns the negative of the surface, -f(u).
    pub(crate) fn negative(&self) -> Self {
        let rows = self.rows.iter().map(|row| row.map(|v| -v)).collect();
        Self { rows, norm: self.norm }
    }

    /// Returns the surface over the opposite directions, f(-u).
    pub(crate) fn antipodal(&self) -> Self {
        let mut other = self.clone();
        for (k, row) in other.rows.iter_mut().enumerate() {
            if k.isqrt() % 2 == 1 {
                *row = row.map(|v| -v);
            }
        }
        other
    }
}

/// Result of a search over all rotations.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub(crate) fit: Fit,
    pub(crate) antipodal: bool,
    /// Distance |Q R f - g| reached from each start. Distances for the starts from the grid come first, in order of
    /// decreasing score. Distances for the starts from the ellipsoids follow.
    pub(crate) ends: Vec<f64>,
}

/// Tables shared by all searches at degree L. With a grid of bandwidth B, they take `12 (L+1)^2 + 32/3 B^4` bytes.
pub(crate) struct Plan {
    pub(crate) rotator: Rotator,
    grid: So3Grid,
    starts: usize,
}

impl Plan {
    pub(crate) fn new(max_degree: usize, bandwidth: usize, starts: usize) -> Self {
        Self { rotator: Rotator::new(max_degree), grid: So3Grid::new(bandwidth), starts }
    }

    /// Searches all rotations for the best alignment of the surface `f`, of norm 1, to the target.
    pub(crate) fn search(&self, f: &Unit, target: &Target, space: Space, monitor: &dyn Monitor) -> Found {
        let mut starts = self.starts_of(f, target, space, false);
        // The surface f(-u) is inside out, and only a reflection of space turns it outwards. It is therefore searched
        // only if reflections are allowed.
        let other = (space == Space::Mirrored).then(|| f.antipodal());
        if let Some(other) = &other {
            starts.extend(self.starts_of(other, target, space, true));
            starts.sort_by(|a, b| b.score.total_cmp(&a.score));
            starts.truncate(self.starts);
        }
        let ellipsoids = |f: &Unit, antipodal| {
            let rotations = common_axes(&f.rows, &target.rows).into_iter();
            rotations.map(move |rotation| Start { rotation, score: 0.0, antipodal })
        };
        starts.extend(ellipsoids(f, false));
        starts.extend(other.iter().flat_map(|other| ellipsoids(other, true)));
        let refined = |starts: &[Start], target: &Target| -> Vec<Fit> {
            let fits = starts.par_iter().map_init(Workspace::default, |workspace, start| {
                let f = if start.antipodal { other.as_ref().unwrap_or(f) } else { f };
                let f = &f.rows[..target.rows.len()];
                refine(&self.rotator, f, target, start.rotation, space, workspace, monitor)
            });
            fits.collect()
        };
        if target.rows.len() > basis_size(2 * COARSE) {
            let coarse = refined(&starts, &Target::new(target.rows[..basis_size(COARSE)].to_vec()));
            starts = distinct(&coarse, &starts);
        }
        let fits = refined(&starts, target);
        let ends = fits.iter().map(|fit| fit.distance).collect();
        let best = (0..fits.len()).min_by(|&a, &b| fits[a].distance.total_cmp(&fits[b].distance));
        match best {
            Some(best) => Found { fit: fits[best], antipodal: starts[best].antipodal, ends },
            None => {
                Found { fit: self.continued(f, target, Rotation::IDENTITY, space, monitor), antipodal: false, ends }
            }
        }
    }

    fn starts_of(&self, f: &Unit, target: &Target, space: Space, antipodal: bool) -> Vec<Start> {
        let peaks = self.grid.peaks(&f.rows, &target.rows, space, self.starts).into_iter();
        peaks.map(|Peak { rotation, score }| Start { rotation, score, antipodal }).collect()
    }

    /// Refines an alignment from a single start.
    pub(crate) fn continued(
        &self,
        f: &Unit,
        target: &Target,
        start: Rotation,
        space: Space,
        monitor: &dyn Monitor,
    ) -> Fit {
        refine(&self.rotator, &f.rows, target, start, space, &mut Workspace::default(), monitor)
    }
}

/// Start of a refinement.
#[derive(Debug, Clone, Copy)]
struct Start {
    rotation: Rotation,
    score: f64,
    antipodal: bool,
}

/// Surfaces of more than twice this degree are first refined at this degree. Only the distinct end points are then
/// refined at the full degree, because starts often converge to the same end point.
const COARSE: usize = 20;

/// Returns the distinct end points of the refinements as starts, in the order of the original starts.
fn distinct(fits: &[Fit], starts: &[Start]) -> Vec<Start> {
    let mut kept: Vec<(Start, f64)> = Vec::new();
    for (fit, start) in fits.iter().zip(starts) {
        let same = |(other, distance): &(Start, f64)| {
            other.antipodal == start.antipodal
                && (distance - fit.distance).abs() < 1e-8
                && (other.rotation.inverse() * fit.rotation).angle() < 1e-3
        };
        if !kept.iter().any(same) {
            kept.push((Start { rotation: fit.rotation, ..*start }, fit.distance));
        }
    }
    kept.into_iter().map(|(start, _)| start).collect()
}

/// Returns the fit of `f` to `g` with the best rotation Q of space and with unchanged parameters.
pub(crate) fn object_only(f: &[[f64; 3]], g: &[[f64; 3]], mirror: bool) -> Fit {
    let correlation = outer(g, f);
    let values = svd(&correlation).values;
    let orthogonal = spharm_surface::kabsch::kabsch(&correlation, mirror);
    let sign = if determinant(&correlation) < 0.0 { -1.0 } else { 1.0 };
    Fit {
        rotation: Rotation::IDENTITY,
        orthogonal,
        distance: distance(f, &orthogonal, g),
        // The parameters weren't rotated, so no stiffness is computed, and 1 is returned. The singular values show
        // whether Q is unique.
        stiffness: 1.0,
        singular_values: [values[0], values[1], sign * values[2]],
    }
}
