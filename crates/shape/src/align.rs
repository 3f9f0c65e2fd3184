//! Aligns one surface to another.
//!
//! Rotates the moving surface f in its parameters and in space, translates it, and scales it if requested, so that the
//! root mean square distance over the sphere ([`rmsd`]) between f and the target g is smallest. By default the rotation
//! of the parameters and the rotation of space are searched together. The search uses the grid of P. Kostelec and D.
//! Rockmore (2008), and the method of W. Kabsch (1976) at each grid point:
//!
//! ```text
//! rmsd^2 = (|f|^2 + |g|^2 - 2 tr Q^T M(R)) / 4 pi,   M_ij(R) = <g_i, R f_j>, row 0 left out
//! ```
//!
//! R is the rotation of the parameters, Q is the rotation of space, and f_j and g_i are coordinates of the surfaces.
//! The best Q for a given R has a closed form, so a search over a grid of R finds both rotations. Newton's method then
//! refines two sets of rotations to an accuracy of 1e-13: the best local maxima of the grid, and the four rotations
//! that align the axes of the first-order ellipsoids. No initial alignment is needed and the result doesn't depend on
//! the surfaces' poses. The search on the grid uses only the degrees below the grid's bandwidth; the refinement uses
//! all degrees. With bandwidth 8 and 6 starts, the search found the best known optimum for all of 30 random pairs of
//! hippocampi at degree 12; for these pairs, bandwidth 5 and 3 starts were enough.
//!
//! Mirror images are matched only if `mirror` is set.
//!
//! Aligning a pair takes 2 ms of CPU time at degree 12 and 10 ms at degree 60.
//!
//! Memory: in addition to the coefficients, `12 (L+1)^2 + 32/3 B^4` bytes for a grid of bandwidth B, and `240 (L+1)^2`
//! bytes for each start that is being refined.
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::Coefficients;
//! use spharm_monitor::Silent;
//! use spharm_shape::{AlignParams, Rotation, Similarity, Transform, align};
//!
//! // An ellipsoid with a bump, and the same surface in another pose.
//! let mut values = Array2::zeros((9, 3));
//! (values[[3, 0]], values[[1, 1]], values[[2, 2]], values[[5, 0]]) = (9.0, 6.0, 4.0, 1.0);
//! let surface = Coefficients::new(values)?;
//! let pose = Transform {
//!     rotation: Rotation::from_euler(0.3, 1.2, -0.5)?,
//!     similarity: Similarity::rotation(&Rotation::from_axis_angle([1.0, 2.0, 0.0], 2.0)?),
//!     ..Transform::default()
//! };
//! let moving = pose.apply(&surface, &Silent)?;
//!
//! let aligned = align(&moving, &surface, &AlignParams::default(), &Silent)?;
//! assert!(aligned.report.rmsd_before > 1.0 && aligned.report.rmsd_after < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod by_surfaces;
mod params;

use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::{Monitor, OnlyCancel, Stage};

use self::by_surfaces::by_surfaces;
pub use self::params::{AlignParams, AlignWarning, Method};
use crate::error::ShapeError;
use crate::extent::surface;
use crate::foe::{EllipsoidFrame, LEAST_RATIO, half_turns};
use crate::matrix3::determinant;
use crate::pair::{Unit, object_only};
use crate::refine::{Fit, Space, Target, distance};
use crate::rotation::Rotation;
use crate::transform::{SQRT_4_PI, Similarity, Transform, rmsd};

/// Maximum ratio of two distances for which a joint search of both rotations is tried: the distance between points at
/// equal directions, divided by the distance between the surfaces. Above this ratio, the same direction denotes
/// different places on the two surfaces. The joint search uses the coefficients instead of sampled points, and
/// determines the pose to rounding error.
const NEAR: f64 = 2.0;

/// Transform, distances and warnings of an alignment.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignReport {
    /// Transform applied to the moving surface.
    pub transform: Transform,
    /// Highest degree up to which the surfaces were compared.
    pub degree: usize,
    /// Root mean square distance before the alignment, in the surfaces' unit.
    pub rmsd_before: f64,
    /// Root mean square distance after the alignment, in the surfaces' unit.
    pub rmsd_after: f64,
    /// Root mean square distance reached from each start of the refinement, without scaling. Distances for the starts
    /// from the grid come first, in order of decreasing score. Distances for the four rotations that align the axes of
    /// the ellipsoids follow. Above degree 40, starts that reach the same pose at degree 20 are listed once. The list
    /// has a single value for methods without a search.
    pub ends: Vec<f64>,
    /// Whether the moving surface was mirrored in space.
    pub mirrored: bool,
    /// Distance between the surfaces in the final pose, excluding the farthest tenth of the points; `None` for methods
    /// other than [`Method::Surfaces`].
    pub surface_distance: Option<f64>,
    /// Warnings about the alignment.
    pub warnings: Vec<AlignWarning>,
}

/// An aligned surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// Coefficients of the moving surface after the transform, up to its own highest degree.
    pub coefficients: Coefficients,
    /// Transform, distances and warnings of the alignment.
    pub report: AlignReport,
}

/// Aligns one surface to another; see the [module](self). The coefficients of both surfaces are (K, 3).
///
/// # Errors
///
/// [`ShapeError::NotASurface`] if one of the models doesn't have three columns; [`ShapeError::NotFinite`] if a
/// coefficient is NaN or infinite; [`ShapeError::Setting`] if a setting is out of range; [`ShapeError::Interrupted`] if
/// the monitor cancels.
pub fn align(
    moving: &Coefficients,
    target: &Coefficients,
    params: &AlignParams,
    monitor: &dyn Monitor,
) -> Result<Alignment, ShapeError> {
    surface(moving)?;
    surface(target)?;
    let lower = moving.max_degree().min(target.max_degree());
    let degree = params.max_degree.map_or(lower, |degree| degree.min(lower));
    let mut warnings = Vec::new();
    if moving.max_degree() != target.max_degree() && params.max_degree.is_none_or(|degree| degree > lower) {
        let (moving, target) = (moving.max_degree(), target.max_degree());
        warnings.push(AlignWarning::DegreesDiffer { moving, target, used: degree });
    }
    monitor.begin(Stage::counted("align", "surfaces"), 1);
    monitor.check()?;
    if params.method == Method::Surfaces
        && let Some(found) = by_surfaces(moving, target, degree, params, monitor)?
    {
        warnings.extend(found.warnings);
        if found.rmsd < NEAR * found.bound {
            let joint = AlignParams { method: Method::Joint, max_degree: Some(degree), ..params.clone() };
            let mut exact = align(moving, target, &joint, &OnlyCancel(monitor))?;
            if exact.report.rmsd_after <= found.bound {
                warnings.append(&mut exact.report.warnings);
                exact.report = AlignReport { warnings, surface_distance: Some(found.distance), ..exact.report };
                monitor.step(1);
                monitor.end();
                return Ok(exact);
            }
        }
        let coefficients = found.transform.apply(moving, &OnlyCancel(monitor))?;
        let (ends, distance) = (found.ends, Some(found.distance));
        let report = reported(moving, target, &coefficients, found.transform, degree, ends, distance, warnings)?;
        monitor.step(1);
        monitor.end();
        return Ok(Alignment { coefficients, report });
    }
    let (f, g) = (Unit::new(moving, degree), Unit::new(target, degree));
    // [`Method::Surfaces`] reaches this point only if a surface has no area; the joint search aligns such surfaces.
    let plan = match params.method {
        Method::Joint | Method::Surfaces => Some(params.plan(degree)?),
        _ => None,
    };
    let (fit, antipodal, ends) = if f.norm == 0.0 || g.norm == 0.0 {
        (nothing_to_turn(), false, Vec::new())
    } else {
        match &plan {
            Some(plan) => {
                let found = plan.search(&f, &Target::new(g.rows.clone()), Space::free(params.mirror), monitor);
                monitor.check()?;
                (found.fit, found.antipodal, found.ends)
            }
            None if params.method == Method::FixedParameters => {
                let fit = object_only(&f.rows, &g.rows, params.mirror);
                (fit, false, vec![fit.distance])
            }
            None => {
                let (fit, ratio) = by_ellipsoids(moving, target, degree, [&f, &g])?;
                if ratio < LEAST_RATIO {
                    warnings.push(AlignWarning::NearlyRound { ratio });
                }
                (fit, false, vec![fit.distance])
            }
        }
    };
    warnings.extend(undetermined(&fit, f.norm.min(g.norm), params));
    // Without scaling, 4 pi times the squared distance between the aligned surface Q f and the target g is
    // (|f| - |g|)^2 + |f| |g| |Qf/|f| - g/|g||^2.
    let left = |end: f64| (f.norm - g.norm).hypot((f.norm * g.norm).sqrt() * end) / SQRT_4_PI;
    // The best scale is |g|/|f| times the cosine of the angle between f and g.
    let cosine = 1.0 - fit.distance * fit.distance / 2.0;
    let scale = if params.scale && f.norm > 0.0 && g.norm > 0.0 { g.norm / f.norm * cosine } else { 1.0 };
    let similarity = Similarity { orthogonal: fit.orthogonal, scale, translation: [0.0; 3] };
    let centre = |of: &Coefficients| std::array::from_fn(|c| of.values()[[0, c]] / SQRT_4_PI);
    let (from, to): ([f64; 3], [f64; 3]) = (similarity.apply(centre(moving)), centre(target));
    let similarity = Similarity { translation: std::array::from_fn(|c| to[c] - from[c]), ..similarity };
    let transform = Transform { rotation: fit.rotation, antipodal, similarity };
    let coefficients = transform.apply(moving, &OnlyCancel(monitor))?;
    monitor.step(1);
    monitor.end();
    let ends = ends.into_iter().map(left).collect();
    let report = reported(moving, target, &coefficients, transform, degree, ends, None, warnings)?;
    Ok(Alignment { coefficients, report })
}

#[expect(clippy::too_many_arguments)]
fn reported(
    moving: &Coefficients,
    target: &Coefficients,
    moved: &Coefficients,
    transform: Transform,
    degree: usize,
    ends: Vec<f64>,
    surface_distance: Option<f64>,
    warnings: Vec<AlignWarning>,
) -> Result<AlignReport, ShapeError> {
    let up_to = |of: &Coefficients| Coefficients::new(of.up_to(degree).to_owned());
    Ok(AlignReport {
        transform,
        degree,
        rmsd_before: rmsd(&up_to(moving)?, &up_to(target)?)?,
        rmsd_after: rmsd(&up_to(moved)?, &up_to(target)?)?,
        ends,
        mirrored: transform.similarity.mirrors(),
        surface_distance,
        warnings,
    })
}

/// Returns the fit in which both rotations are the identity, for surfaces without extent (single points).
pub(crate) fn nothing_to_turn() -> Fit {
    let (rotation, orthogonal) = (Rotation::IDENTITY, Rotation::IDENTITY.matrix());
    Fit { rotation, orthogonal, distance: 0.0, stiffness: 0.0, singular_values: [0.0; 3] }
}

/// Returns a warning if a rotation is undetermined, judged by the singular values and second derivatives at the
/// optimum.
pub(crate) fn undetermined(fit: &Fit, norm: f64, params: &AlignParams) -> Option<AlignWarning> {
    /// Threshold below which singular values and second derivatives are treated as zero, for coefficients of norm 1.
    const NONE: f64 = 1e-7;
    let [_, second, third] = fit.singular_values;
    let third = if params.mirror { third.abs() } else { third };
    if norm == 0.0 {
        Some(AlignWarning::Point)
    } else if second + third < NONE {
        Some(AlignWarning::ObjectUndetermined)
    } else if fit.stiffness < NONE && params.method == Method::Joint {
        Some(AlignWarning::BothUndetermined)
    } else if params.mirror && third < NONE {
        Some(AlignWarning::MirrorUndetermined)
    } else {
        None
    }
}

/// Aligns the frames of the two first-order ellipsoids by the best pair of half turns. Returns the fit, and the smaller
/// of the two ellipsoids' axis ratios ([`EllipsoidFrame::ratio`]).
fn by_ellipsoids(
    moving: &Coefficients,
    target: &Coefficients,
    degree: usize,
    [f, g]: [&Unit; 2],
) -> Result<(Fit, f64), ShapeError> {
    let cut = |of: &Coefficients| Coefficients::new(of.up_to(degree).to_owned());
    let (own, other) = (EllipsoidFrame::of(&cut(moving)?)?, EllipsoidFrame::of(&cut(target)?)?);
    let rotator = crate::rotate::Rotator::new(degree);
    let mut workspace = crate::half_turn::Workspace::default();
    let mut best: Option<Fit> = None;
    for of_parameters in half_turns() {
        let rotation = other.rotation.inverse() * of_parameters * own.rotation;
        let mut rows = vec![[0.0; 3]; basis_size(degree)];
        rotator.rotate(&f.rows, &rotation, &mut rows, &mut workspace);
        for of_space in half_turns() {
            let orthogonal = (other.object.inverse() * of_space * own.object).matrix();
            let distance = distance(&rows, &orthogonal, &g.rows);
            if best.as_ref().is_none_or(|best| distance < best.distance) {
                let correlation = crate::refine::outer(&g.rows, &rows);
                let values = spharm_surface::kabsch::svd(&correlation).values;
                let sign = if determinant(&correlation) < 0.0 { -1.0 } else { 1.0 };
                let singular_values = [values[0], values[1], sign * values[2]];
                best = Some(Fit { rotation, orthogonal, distance, stiffness: 1.0, singular_values });
            }
        }
    }
    Ok((best.unwrap_or_else(nothing_to_turn), own.ratio().min(other.ratio())))
}

#[cfg(test)]
mod tests;
