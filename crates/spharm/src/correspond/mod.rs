//! Establishes correspondence within a group: all subjects are fitted over one template's sphere with one basis.
//!
//! If each surface is mapped to the sphere separately, the same direction belongs to different parts of the surfaces,
//! and most of a group's variance is caused by the maps. The function [`correspond()`] maps only one template to the
//! sphere. The template is then moved in space onto every subject's surface, whatever the surface's topology. All
//! subjects are fitted over the template's sphere. The group's own statistics correct the correspondence in places that
//! the registration leaves undetermined.
//!
//! 1. Poses are found from the surfaces alone ([`spharm_surface::pose`]).
//! 2. The most typical subject, or a given surface, is the template. The template is repaired, mapped and fitted
//!    ([`template`]).
//! 3. The template is registered to every subject ([`spharm_register`]); the group's mean is then the next round's
//!    template.
//! 4. All subjects are fitted over the template's sphere in one call.
//! 5. The corresponding points are refined by the group ([`mod@spharm_shape::groupwise`]), projected onto the surfaces
//!    and fitted again.
//!
//! ```no_run
//! use spharm::correspond::{CorrespondParams, correspond};
//! use spharm::{Silent, io::read_mesh};
//!
//! let paths = ["s01.ply", "s02.ply", "s03.ply"];
//! let read = |index: usize| Ok(read_mesh(paths[index])?);
//! let group = correspond(paths.len(), &read, &CorrespondParams::up_to(15), &Silent)?;
//! // The position on s03 that corresponds to vertex 10 of s01, each in the coordinates of its own file.
//! let place = group.carry(&[read(0)?.vertices[10]], 0, 2)?;
//! # Ok::<(), spharm::Error>(())
//! ```

mod carry;
pub mod files;
mod fits;
mod frames;
mod guide;
mod member;
mod misplaced;
mod params;
mod report;
mod resume;
mod rounds;
mod signals;
mod subjects;
pub mod template;
mod together;

use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_monitor::Monitor;
use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;
use spharm_surface::{Mesh, Similarity, Sphere};

use crate::Error;

pub use carry::Carried;
pub use files::{GroupFiles, MemberOrigin};
pub use guide::{GuideLandmarks, GuideReport};
pub use member::{Joining, NewMember};
pub use misplaced::{LandmarkCause, MisplacedLandmarks};
pub use params::CorrespondParams;
pub use report::{CorrespondReport, CorrespondWarning, IDENTICAL_TO, MemberReport};
pub use resume::Resume;
pub use signals::Signals;

/// A group of corresponding members in one frame.
#[derive(Debug, Clone)]
pub struct Group {
    /// A model of each member, in the group's frame and over the group's sphere.
    pub models: Vec<Model>,
    /// Similarity from each member's own frame to the group's frame.
    pub similarities: Vec<Similarity>,
    /// Corresponding points of each member, one for each of the sphere's n directions. The points are on the member's
    /// surface and in the group's frame.
    pub places: Vec<Vec<Vec3>>,
    /// For each member and each of the n directions, whether the template's point in this direction has a counterpart
    /// on the member. Without a counterpart, the corresponding point is a guess.
    pub reached: Vec<Vec<bool>>,
    /// Data needed to add new members to the group.
    pub template: GroupTemplate,
    /// Report on the correspondence.
    pub report: CorrespondReport,
}

/// Data needed to add new members to a group.
#[derive(Debug, Clone)]
pub struct GroupTemplate {
    /// The sphere of all members' models, with triangles.
    pub sphere: Sphere,
    /// The group's mean, in the group's frame.
    pub mean: Coefficients,
    /// For each of the n directions, whether it has no counterpart on the members, as in the filled holes of the first
    /// template.
    pub masked: Vec<bool>,
    /// Root mean square distance of the members from the mean, weighted by area.
    pub spread: f64,
    /// Whether the members' corresponding points were refined by the group.
    pub refined: bool,
}

impl GroupTemplate {
    /// Returns, for each of the given unit vectors, whether the nearest of the group's directions has a counterpart on
    /// the members.
    #[must_use]
    pub fn kept_at(&self, directions: &[Vec3]) -> Vec<bool> {
        if !self.masked.contains(&true) {
            return vec![true; directions.len()];
        }
        let tree = TriangleTree::new(&self.sphere.to_mesh());
        let kept = |direction: &Vec3| {
            let Some(found) = tree.nearest(*direction) else { return false };
            let corners = self.sphere.faces[found.triangle as usize];
            let nearest = (0..3).max_by(|a, b| found.barycentric[*a].total_cmp(&found.barycentric[*b])).unwrap_or(0);
            !self.masked[corners[nearest] as usize]
        };
        directions.iter().map(kept).collect()
    }
}

/// Establishes correspondence between surfaces. `read` returns the surface with an index in `0..count`, in the
/// surface's own frame. `read` is called several times for each surface, from several threads.
///
/// # Errors
///
/// [`Error::Setting`] if there are fewer than two surfaces or a setting is invalid; [`Error::Member`] if one surface
/// can't be read or registered; [`Error::Parametrize`] if the template can't be mapped; the errors of
/// [`fit_many`](crate::fit_many); [`Error::is_interrupted`] if the monitor stopped the call.
pub fn correspond(
    count: usize,
    read: &(dyn Fn(usize) -> Result<Mesh, Error> + Sync),
    params: &CorrespondParams,
    monitor: &dyn Monitor,
) -> Result<Group, Error> {
    params.check(count)?;
    rounds::run(&subjects::Subjects { count, read }, params, monitor)
}
