//! Defines landmarks that guide a registration: points of the template that are pulled to points of the subject.

use spharm_surface::Place;
use spharm_surface::geometry::Vec3;

/// A point on the template, and the point of the subject that corresponds to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guide {
    /// Position on the template.
    pub place: Place,
    /// Corresponding point of the subject, which must be in the template's pose.
    pub point: Vec3,
}
