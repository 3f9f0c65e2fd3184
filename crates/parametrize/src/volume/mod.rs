//! From a label volume to the closed surface around a label.
//!
//! | module | what |
//! |---|---|
//! | `nifti` | NIfTI-1 files: the values, and where the voxels are in space |
//! | `mask` | the voxels of one label, with a rim of background around them |
//! | `pieces` | the pieces that hang together, and the cavities inside |
//! | `boundary` | the quadrangles between inside and outside, as a closed surface |
//! | `simple` | whether a voxel may change sides without the topology changing |
//! | `repair` | `--fix`: one piece without cavities, handles and bare contacts |
//!
//! # Connectivity
//!
//! Voxels belong together when they share a face (6-connectivity), and the background when it shares a face, an edge or
//! a corner (26). Where two voxels touch in an edge or a corner only, the surface passes between them, and its vertices
//! there are doubled. This is the choice under which the boundary is a closed surface that doesn't touch itself but in
//! such places. What `--fix` makes has none of them and is the same in every connectivity, (18,6) among them.
//!
//! # Units
//!
//! Voxels are counted from 0; voxel (i, j, k) is the unit cube around (i, j, k). The file's sform, else its qform, else
//! its voxel sizes, takes that to RAS+ mm.

mod boundary;
mod mask;
mod nifti;
mod pieces;
mod repair;
mod simple;

pub use boundary::QuadMesh;
pub use mask::Mask;
pub use nifti::{Affine, LabelVolume};
pub use pieces::{Pieces, pieces};
pub use repair::{Repair, Way, repair};

use crate::ParametrizeError;
use pieces::cavities;

/// How to take a surface from a volume.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VolumeParams {
    /// The label whose surface it is; `None` for the only one there is.
    pub label: Option<i64>,
    /// Repair what isn't a ball in place of refusing it.
    pub fix: bool,
}

/// A label's surface.
#[derive(Clone, Debug)]
pub struct VolumeSurface {
    /// Closed, of genus 0, wound outward; vertices in mm.
    pub quads: QuadMesh,
    /// The label.
    pub label: i64,
    /// Its voxels in the file.
    pub voxels: usize,
    /// What was changed; `None` where nothing had to be.
    pub repair: Option<Repair>,
}

/// The surface around a label.
///
/// # Errors
///
/// [`NoLabel`](ParametrizeError::NoLabel); [`BadVolume`](ParametrizeError::BadVolume) where the label isn't one ball (how
/// many pieces, cavities, handles, bare contacts it has) and `fix` isn't set.
pub fn surface_of(volume: &LabelVolume, params: &VolumeParams) -> Result<VolumeSurface, ParametrizeError> {
    let label = volume.choose(params.label)?;
    let mask = volume.mask(label)?;
    let voxels = mask.count();
    let problems = problems(&mask);
    let (quads, repair) = match (problems.is_empty(), params.fix) {
        (true, _) => (QuadMesh::around(&mask), None),
        (false, true) => {
            let (mended, repair) = repair(&mask);
            let quads = QuadMesh::around(&mended);
            // The repair keeps to simple points, so this can't happen; a surface of another kind must not go on.
            let left = self::problems(&mended);
            if !left.is_empty() {
                return Err(ParametrizeError::BadVolume { problems: left.join("; "), remedy: "edit the label" });
            }
            (quads, Some(repair))
        }
        (false, false) => {
            let remedy = "repair it with --fix, or edit the label";
            return Err(ParametrizeError::BadVolume { problems: problems.join("; "), remedy });
        }
    };
    Ok(VolumeSurface { quads: quads.to_world(&volume.affine), label, voxels, repair })
}

/// What keeps the voxels from being one ball, a phrase each.
fn problems(mask: &Mask) -> Vec<String> {
    let mut problems = Vec::new();
    let found = pieces(mask);
    if found.sizes.len() > 1 {
        let sizes: Vec<String> = found.sizes.iter().take(5).map(ToString::to_string).collect();
        let more = if found.sizes.len() > 5 { ", ..." } else { "" };
        let count = found.sizes.len();
        problems.push(format!("{count} pieces that share no voxel's face (of {}{more} voxels)", sizes.join(", ")));
    }
    let hollow = cavities(mask).sizes;
    if !hollow.is_empty() {
        let voxels: usize = hollow.iter().sum();
        let word = if hollow.len() == 1 { "cavity" } else { "cavities" };
        problems.push(format!("{} {word} inside (of {voxels} voxels in all)", hollow.len()));
    }
    let quads = QuadMesh::around(mask);
    // Each piece and each cavity has a surface of its own, of characteristic 2 - 2 genus.
    let surfaces = quads.components() as i64;
    let genus = surfaces - quads.euler_characteristic() / 2;
    if genus > 0 {
        let word = if genus == 1 { "1 handle" } else { &format!("{genus} handles") };
        problems.push(format!("{word} (genus {genus})"));
    }
    let pinched = quads.pinched_edges();
    if problems.is_empty() && pinched > 0 {
        problems.push(format!("{pinched} edges in which two sheets of the surface touch between the same vertices"));
    }
    problems
}
