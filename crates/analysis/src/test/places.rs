//! Describes the places of tested vertices: direction, position on the mean surface, and region in an annotation.

use serde_json::{Value, json};
use spharm::Sphere;
use spharm_surface::Mesh;
use spharm_surface::geometry::Vec3;
use spharm_surface::io::Annotation;

/// Places of the tested vertices of a sampling.
pub(super) struct Places<'a> {
    sphere: &'a Sphere,
    mean: Option<&'a Mesh>,
    annotation: Option<&'a Annotation>,
    /// For each tested vertex, its index among the vertices of the sphere.
    tested: Vec<usize>,
}

impl<'a> Places<'a> {
    pub(super) fn new(
        sphere: &'a Sphere,
        mean: Option<&'a Mesh>,
        mask: Option<&[bool]>,
        annotation: Option<&'a Annotation>,
    ) -> Self {
        let tested = (0..sphere.directions.len()).filter(|v| mask.is_none_or(|mask| mask[*v])).collect();
        Self { sphere, mean, annotation, tested }
    }

    /// Returns the index, among all vertices of the sampling, of the tested vertex number `at`.
    pub(super) fn vertex(&self, at: usize) -> usize {
        self.tested[at]
    }

    pub(super) fn direction(&self, at: usize) -> Vec3 {
        self.sphere.directions.as_slice()[self.tested[at]]
    }

    /// Returns whether results are shown on a mean surface.
    pub(super) fn has_positions(&self) -> bool {
        self.mean.is_some()
    }

    pub(super) fn position(&self, at: usize) -> Option<Vec3> {
        self.mean.map(|mean| mean.vertices[self.tested[at]])
    }

    /// Returns the name of a vertex's region, empty for a vertex without a region; `None` without an annotation.
    pub(super) fn region(&self, at: usize) -> Option<&str> {
        self.annotation.map(|annotation| annotation.name_at(self.tested[at]).unwrap_or_default())
    }

    /// Returns whether an annotation with regions was given.
    pub(super) fn has_regions(&self) -> bool {
        self.annotation.is_some()
    }

    /// Returns, as JSON, the place of the vertex with the largest absolute statistic.
    pub(super) fn peak(&self, statistic: &[f64]) -> Value {
        let largest = (0..statistic.len()).max_by(|a, b| statistic[*a].abs().total_cmp(&statistic[*b].abs()));
        largest.map_or(Value::Null, |at| {
            json!({
                "vertex": self.vertex(at),
                "direction": self.direction(at),
                "position": self.position(at),
                "region": self.region(at),
                "statistic": statistic[at],
            })
        })
    }
}
