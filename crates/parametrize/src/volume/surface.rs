//! Computes a label's surface, which is checked and, on request, repaired.

use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::Mesh;

use super::boundary::QuadMesh;
use super::labels::LabelVolume;
use super::mask::Mask;
use super::pieces::{cavities, pieces};
use super::relax::{Bounds, HALF_A_VOXEL};
use super::repair::{Repair, largest_piece, repair};
use crate::error::ParametrizeError;

/// Range of the radius of smooth surfaces, in voxels. The radius is half the width of the boxes in which vertices may
/// move. With a smaller radius the voxels' steps would remain. With a larger radius the boxes would contain most of a
/// small body.
const RADII: std::ops::RangeInclusive<f64> = 0.25..=4.0;

/// The kind of surface by which a label is represented.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LabelSurface {
    /// The surface of least bending near the voxels' faces. It encloses the volume of the voxels, or the volume given
    /// by grey values. For a label with too few voxels for such a surface, the voxels' faces are used.
    Smooth {
        /// Largest distance along each axis between a vertex and its position on the voxels' faces, in voxels.
        /// Default 0.5, the uncertainty of a label with exact edges; larger values suit labels with inexact edges.
        radius: f64,
    },
    /// The faces of the voxels, with their steps.
    Voxels,
}

impl Default for LabelSurface {
    fn default() -> Self {
        Self::Smooth { radius: HALF_A_VOXEL }
    }
}

impl LabelSurface {
    /// Returns the kind of surface for a name, as used in arguments and reports, and a radius, which only smooth
    /// surfaces have.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::Argument`] if the name is neither `smooth` nor `voxels`, if the radius isn't from 0.25 to 4,
    /// or if `voxels` is given with a radius.
    pub fn named(name: &str, radius: Option<f64>) -> Result<Self, ParametrizeError> {
        let refused = |what, expected, found| Err(ParametrizeError::Argument { what, expected, found });
        match (name, radius) {
            ("smooth", Some(radius)) if !RADII.contains(&radius) => {
                refused("smooth_radius", "0.25 to 4 voxels", radius.to_string())
            }
            ("smooth", radius) => Ok(Self::Smooth { radius: radius.unwrap_or(HALF_A_VOXEL) }),
            ("voxels", None) => Ok(Self::Voxels),
            ("voxels", Some(radius)) => {
                refused("smooth_radius", "no radius with label_surface = voxels", radius.to_string())
            }
            (other, _) => refused("label_surface", "smooth or voxels", other.to_owned()),
        }
    }

    /// Returns the name used in arguments and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Smooth { .. } => "smooth",
            Self::Voxels => "voxels",
        }
    }

    /// Returns the radius of a smooth surface in voxels; `None` if it is the default.
    #[must_use]
    pub fn radius(self) -> Option<f64> {
        match self {
            Self::Smooth { radius } => Some(radius).filter(|radius| *radius != HALF_A_VOXEL),
            Self::Voxels => None,
        }
    }
}

/// Settings of [`LabelVolume::surface`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeParams {
    /// The label; `None` (default) for the volume's only label.
    pub label: Option<i64>,
    /// Kind of surface that represents the label. Default: smooth.
    pub surface: LabelSurface,
    /// Whether to repair a label that isn't a ball, instead of rejecting it. Default false.
    pub fix: bool,
    /// Whether the surface may have handles, which [`without_handles`](crate::Input::without_handles) can cut. Default
    /// false. The setting has no effect together with `fix`, since a repair removes handles.
    pub handles: bool,
}

/// The surface around a label.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct VolumeSurface {
    /// Closed surface, wound outwards, with vertices in mm; of genus 0 unless handles were allowed. The quadrangles are
    /// the voxels' faces. If the surface was smoothed, [`triangles`](QuadMesh::triangles) returns the smooth surface.
    pub quads: QuadMesh,
    /// Value of the label.
    pub label: i64,
    /// Number of the label's voxels in the file.
    pub voxels: usize,
    /// Lengths of a voxel's edges, in mm.
    pub voxel_size: [f64; 3],
    /// Whether the label touches the border of the volume, and so may be cut off. If the label was repaired, this
    /// refers to the repaired label.
    pub at_border: bool,
    /// The requested kind of surface.
    pub surface: LabelSurface,
    /// The changes made by the repair; `None` if no repair was needed.
    pub repair: Option<Repair>,
}

impl LabelVolume {
    /// Returns the surface around a label in mm, without voxel steps: the surface of least bending within `radius`
    /// voxels of the voxels' faces, with the label's volume. The surface can have any topology. It is intended for uses
    /// that need no sphere, such as registration. For grey values and probabilities, the surface is that of the largest
    /// piece, with its cavities filled.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel) if the volume lacks the label, or has several labels and none is chosen;
    /// [`NotAVolume`](ParametrizeError::NotAVolume) if the volume has no label;
    /// [`Interrupted`](ParametrizeError::Interrupted).
    pub fn smooth_surface(
        &self,
        label: Option<i64>,
        radius: Option<f64>,
        monitor: &dyn Monitor,
    ) -> Result<Mesh, ParametrizeError> {
        let mask = self.mask(self.choose(label)?)?;
        let mask = if self.grey.is_some() { largest_piece(&mask, monitor)?.0 } else { mask };
        let steps = QuadMesh::around(&mask);
        let bounds = self.bounds(&steps, &mask, radius.unwrap_or(HALF_A_VOXEL));
        let smooth = Some(steps.relaxed(&bounds, monitor)?);
        Ok(QuadMesh { smooth, ..steps }.to_world(&self.affine).triangles(|_| false))
    }

    /// Returns the constraints on the smooth surface of a mask, given the mask's quadrangles.
    fn bounds(&self, quads: &QuadMesh, mask: &Mask, radius: f64) -> Bounds {
        Bounds { radius, located: self.grey.as_ref().map(|grey| grey.locate(quads, mask)) }
    }

    /// Returns the closed surface around a label.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel) if the volume lacks the label, or has several labels and none is chosen;
    /// [`NotAVolume`](ParametrizeError::NotAVolume) if the volume has no label;
    /// [`BadVolume`](ParametrizeError::BadVolume), with the numbers of pieces, cavities, handles and pinched edges, if
    /// the label isn't a single ball and `fix` isn't set; [`Interrupted`](ParametrizeError::Interrupted).
    pub fn surface(&self, params: &VolumeParams, monitor: &dyn Monitor) -> Result<VolumeSurface, ParametrizeError> {
        let label = self.choose(params.label)?;
        let mask = self.mask(label)?;
        let voxels = mask.count();
        let refuse = |Problems { phrases, handles }: Problems, repairable| {
            let path = self.path().to_owned();
            Err(ParametrizeError::BadVolume { path, label, problems: phrases.join("; "), handles, repairable })
        };
        let problems = problems(&mask, params.handles && !params.fix, monitor)?;
        let (mask, repair) = match (problems.phrases.is_empty(), params.fix) {
            (true, _) => (mask, None),
            (false, false) => return refuse(problems, true),
            (false, true) => {
                let (repaired, repair) = repair(&mask, monitor)?;
                // The repair only changes simple voxels, so no problem should be left. If a problem is left, the
                // surface must be rejected.
                let left = self::problems(&repaired, false, monitor)?;
                if !left.phrases.is_empty() {
                    return refuse(left, false);
                }
                (repaired, Some(repair))
            }
        };
        let (quads, surface) = (QuadMesh::around(&mask), params.surface);
        let quads = match surface {
            LabelSurface::Smooth { radius } => {
                let bounds = self.bounds(&quads, &mask, radius);
                quads.smoothed(&bounds, monitor)?
            }
            LabelSurface::Voxels => quads,
        };
        let at_border = self.touches_border(label) && (repair.is_none() || self.is_at_border(&mask));
        let (quads, voxel_size) = (quads.to_world(&self.affine), self.affine.voxel_size());
        Ok(VolumeSurface { quads, label, voxels, voxel_size, at_border, surface, repair })
    }
}

/// The reasons why a set of voxels isn't a single ball.
struct Problems {
    /// Phrases that describe the reasons, one each.
    phrases: Vec<String>,
    /// Number of handles. If this number isn't 0, one of `phrases` describes the handles.
    handles: usize,
}

/// Returns the reasons why the voxels aren't a single ball. If `allowed` is true, handles aren't a reason.
fn problems(mask: &Mask, allowed: bool, monitor: &dyn Monitor) -> Result<Problems, Interrupted> {
    let mut problems = Vec::new();
    let found = pieces(mask, monitor)?;
    if found.sizes.len() > 1 {
        let sizes: Vec<String> = found.sizes.iter().take(5).map(ToString::to_string).collect();
        let more = if found.sizes.len() > 5 { ", ..." } else { "" };
        let count = found.sizes.len();
        problems.push(format!("{count} pieces not connected by voxel faces (of {}{more} voxels)", sizes.join(", ")));
    }
    let hollow = cavities(mask, monitor)?.sizes;
    if !hollow.is_empty() {
        let voxels: usize = hollow.iter().sum();
        let word = if hollow.len() == 1 { "cavity" } else { "cavities" };
        let of = if voxels == 1 { "of 1 voxel".to_owned() } else { format!("of {voxels} voxels in total") };
        problems.push(format!("{} {word} inside ({of})", hollow.len()));
    }
    let quads = QuadMesh::around(mask);
    let handles = if allowed { 0 } else { quads.handles() };
    if handles > 0 {
        let word = if handles == 1 { "1 handle" } else { &format!("{handles} handles") };
        problems.push(format!("{word} (genus {handles})"));
    }
    let pinched = quads.pinched_edges();
    if problems.is_empty() && pinched > 0 {
        let edges = if pinched == 1 { "1 edge" } else { &format!("{pinched} edges") };
        problems.push(format!("{edges} at which two sheets of the surface touch"));
    }
    Ok(Problems { phrases: problems, handles })
}
