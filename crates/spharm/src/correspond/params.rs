//! Settings of a correspondence.

use derive_setters::Setters;
use spharm_register::RegisterParams;
use spharm_shape::groupwise::GroupwiseParams;
use spharm_surface::pose::PoseParams;
use spharm_surface::{Mesh, Similarity};

use super::guide::GuideLandmarks;
use super::resume::Resume;
use super::signals::Signals;
use crate::Error;

/// Settings of [`correspond`](super::correspond()), created by [`up_to`](Self::up_to). Each setter returns the settings
/// with one field changed.
#[derive(Debug, Clone, Setters)]
#[setters(prefix = "with_")]
#[non_exhaustive]
pub struct CorrespondParams {
    /// Highest degree of the models, L.
    pub max_degree: usize,
    /// The first template. By default it is the most typical subject.
    #[setters(into)]
    pub template: Option<Mesh>,
    /// Landmarks that guide the registration; none by default.
    #[setters(into)]
    pub guide: Option<GuideLandmarks>,
    /// For each surface, whether it is mirrored (x to -x) before its pose is computed, like right hemispheres in a
    /// group of left hemispheres. Empty if no surface is mirrored. The similarities to the group's frame include the
    /// reflection.
    pub mirrored: Vec<bool>,
    /// Signals on the surfaces that the refinement matches in addition to positions; none by default.
    #[setters(into)]
    pub signals: Option<Signals>,
    /// Number of subdivisions of the icosphere at whose directions the template is sampled for its registration. By
    /// default 4 (2,562 directions) for degrees up to 15, 5 (10,242) up to 40, and 6 (40,962) above.
    #[setters(into)]
    pub subdivisions: Option<u32>,
    /// Number of rounds of registration; 2 by default. In each round after the first, the group's mean is the template.
    pub rounds: usize,
    /// Settings of the refinement by the group's statistics; `None` skips the refinement.
    #[setters(into)]
    pub refinement: Option<GroupwiseParams>,
    /// Settings for computing poses.
    pub pose: PoseParams,
    /// Whether the members keep their given poses in the group; `false` by default. If set, the computed poses serve
    /// only to find the corresponding points.
    pub keep_poses: bool,
    /// Settings for registering the template.
    pub register: RegisterParams,
    /// Folder in which registrations are stored, so that an interrupted run can be resumed; none by default.
    #[setters(into)]
    pub resume: Option<Resume>,
    /// Memory budget of the fits in bytes.
    #[setters(into)]
    pub memory: Option<usize>,
}

/// Minimum number of subjects in a group.
const LEAST: usize = 2;

impl CorrespondParams {
    /// Returns the default settings for models of degree `max_degree`.
    #[must_use]
    pub fn up_to(max_degree: usize) -> Self {
        Self {
            max_degree,
            template: None,
            guide: None,
            mirrored: Vec::new(),
            signals: None,
            subdivisions: None,
            rounds: 2,
            refinement: Some(GroupwiseParams::default()),
            pose: PoseParams::default(),
            keep_poses: false,
            register: RegisterParams::default(),
            resume: None,
            memory: None,
        }
    }

    /// Returns the number of subdivisions of the icosphere at whose directions the template is sampled.
    #[must_use]
    pub fn subdivisions(&self) -> u32 {
        self.subdivisions.unwrap_or(match self.max_degree {
            0..=15 => 4,
            16..=40 => 5,
            _ => 6,
        })
    }

    /// Returns the reflection to apply to a surface first, or `None` if the surface isn't mirrored.
    pub(super) fn reflection(&self, index: usize) -> Option<Similarity> {
        (self.mirrored.get(index) == Some(&true)).then(Similarity::reflection)
    }

    /// Checks that the settings don't combine given poses with scaling or mirror images.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] if given poses are kept, and scaling or mirror images are requested.
    pub fn check_poses(&self) -> Result<(), Error> {
        if self.keep_poses && (self.pose.scale || self.pose.mirror) {
            return Err(Error::Setting {
                what: "the pose `given`",
                expected: "settings without scaling or mirror images",
                found: if self.pose.scale { "scaling" } else { "mirror images" }.to_owned(),
            });
        }
        Ok(())
    }

    pub(super) fn check(&self, count: usize) -> Result<(), Error> {
        let refused = |what, expected, found: usize| Err(Error::Setting { what, expected, found: found.to_string() });
        if count < LEAST {
            return refused("a correspondence", "at least 2 surfaces", count);
        }
        if self.rounds == 0 {
            return refused("the number of rounds", "a value of at least 1", 0);
        }
        if self.max_degree == 0 {
            return refused("the degree", "a value of at least 1", 0);
        }
        if !self.mirrored.is_empty() && self.mirrored.len() != count {
            return refused("the list of mirrored surfaces", "one value per surface", self.mirrored.len());
        }
        self.check_poses()?;
        if let Some(guide) = &self.guide {
            guide.check(count, self.template.is_some())?;
        }
        if let Some(signals) = &self.signals {
            if self.refinement.is_none() {
                return Err(Error::Setting {
                    what: "the list of signals",
                    expected: "a refinement (signals have no effect without one)",
                    found: "none".to_owned(),
                });
            }
            signals.check()?;
        }
        if let Some(found) = self.subdivisions.filter(|found| !(2..=8).contains(found)) {
            return refused("the number of subdivisions", "a value from 2 to 8", found as usize);
        }
        Ok(())
    }
}
