//! Registers a template to one subject.

use spharm_monitor::Monitor;
use spharm_surface::geometry::Vec3;

use crate::cover::{Cover, apart, free, reached};
use crate::drift::drift;
use crate::error::RegisterError;
use crate::guide::Guide;
use crate::params::RegisterParams;
use crate::snap::snap;
use crate::subject::Subject;
use crate::template::Template;
use crate::untangle::untangle;

/// A template moved onto a subject.
#[derive(Debug, Clone, PartialEq)]
pub struct Registered {
    /// The template's vertices (n), on the subject's surface.
    pub vertices: Vec<Vec3>,
    /// Whether each of the n vertices has a counterpart on the subject. The position of a vertex without a counterpart
    /// is a guess.
    pub reached: Vec<bool>,
    /// Distances of the subject's surface from the template.
    pub cover: Cover,
    /// Number of triangles that are turned over. Their vertices aren't marked as reached.
    pub turned: usize,
}

/// Moves a template onto a subject in the same pose. `guides` are pairs of corresponding points known in advance.
///
/// # Errors
///
/// [`RegisterError::Guide`] if a landmark isn't finite or isn't on the template, [`RegisterError::Singular`] if the
/// equations have no finite solution, and [`RegisterError::Interrupted`] if `monitor` cancels the registration.
pub fn register(
    template: &Template,
    subject: &Subject,
    guides: &[Guide],
    params: &RegisterParams,
    monitor: &dyn Monitor,
) -> Result<Registered, RegisterError> {
    let n = template.mesh.vertices.len();
    let there = |guide: &Guide| guide.place.is_within(n) && guide.point.iter().all(|value| value.is_finite());
    if let Some(index) = guides.iter().position(|guide| !there(guide)) {
        return Err(RegisterError::Guide { index, vertices: n });
    }
    let reach = params.reach * template.scale;
    let vertices = &template.mesh.vertices;
    let free = free(template, vertices, subject, reach);
    let (rms, farthest) = apart(template, vertices, subject);
    let near = guides.is_empty() && rms < params.near * template.scale && farthest < reach;
    let drawn = if near {
        vertices.clone()
    } else {
        let moved = drift(template, &free, subject, guides, params, monitor)?;
        snap(template, &moved, &free, subject, guides, params, monitor)?
    };
    let mut reached = reached(&free, &drawn, subject, reach);
    let (vertices, turned) = untangle(template, &drawn, &free, subject, params.untangle_rounds, monitor)?;
    for face in &turned {
        template.mesh.faces[*face as usize].iter().for_each(|v| reached[*v as usize] = false);
    }
    let cover = Cover::measure(template, &vertices, subject, reach);
    Ok(Registered { vertices, reached, cover, turned: turned.len() })
}
