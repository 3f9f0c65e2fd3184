//! Estimates the memory that the creation of a page needs.

use spharm_model::Model;

use crate::contents::{Contents, Params};
use crate::grid::vertices_for;

/// Number of bytes per vertex of a mesh in the page: evaluated positions and triangles, their binary form, and their
/// text. While the text is being written, its buffer may be twice as large as the text. The measured memory was 270
/// bytes per vertex for a model of 40,962 vertices, and another 270 bytes per vertex for its surface.
const BYTES_PER_VERTEX: u64 = 320;
/// Number of bytes per vertex of the search tree of a surface. A tree is built if the model is compared with a surface
/// whose triangles differ from the model's. Only one tree exists at a time.
const TREE: u64 = 520;
/// Number of bytes that every page needs, including those for drawing a picture.
const FIXED: u64 = 12 << 20;

impl Contents {
    /// Returns the approximate maximum number of bytes for creating the page. The number includes the bytes of the
    /// page, but not those of `self`.
    #[must_use]
    pub fn bytes(&self, params: Params) -> u64 {
        let most = params.max_vertices;
        let (mut all, mut largest) = (0_u64, 0_u64);
        let mut add = |vertices: usize| {
            all = all.saturating_add(vertices as u64);
            largest = largest.max(vertices as u64);
        };
        for shown in &self.models {
            add(vertices_of(&shown.model, most));
            add(shown.surface.as_ref().map_or(0, |(_, mesh)| mesh.vertices.len()));
        }
        for (_, group) in &self.modes {
            // The page evaluates a model of the modes' degree, and contains the modes' coefficients as text.
            add(vertices_for(group.modes.mean.nrows().isqrt(), most));
            add(group.modes.modes.len() / 16);
        }
        self.tests.iter().for_each(|test| add(test.mesh.vertices.len() * (1 + test.maps.len() / 8)));
        let pictures =
            self.check.iter().flat_map(|check| &check.subjects).filter_map(|subject| subject.picture.as_ref());
        // While its section is created, a picture exists as up to three copies in base64. Each copy takes 4/3 of the
        // picture's size, in a string whose capacity is up to twice its length.
        let pictures = 8 * pictures.map(|png| png.len() as u64).sum::<u64>();
        let meshes = BYTES_PER_VERTEX.saturating_mul(all).saturating_add(TREE.saturating_mul(largest));
        meshes.saturating_add(pictures).saturating_add(FIXED)
    }
}

/// Returns the number of vertices at which a model is evaluated in a page.
fn vertices_of(model: &Model, most: usize) -> usize {
    match &model.sphere {
        Some(sphere) if sphere.directions.len() <= most => sphere.directions.len(),
        _ => vertices_for(model.coefficients.max_degree(), most),
    }
}
