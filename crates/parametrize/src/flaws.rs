//! Finds the reasons, other than handles, why a mesh can't be mapped to the sphere.

use spharm_surface::Mesh;
use spharm_surface::topology::Topology;

use crate::error::ParametrizeError;
use crate::geometry::{Vec3, area, norm, sub};

/// Defects of a mesh.
pub(crate) struct Flaws {
    /// Phrases that describe the problems, except for handles.
    pub(crate) problems: Vec<String>,
    /// Advice to the user on the problems.
    pub(crate) remedy: &'static str,
    genus: Option<i64>,
}

impl Flaws {
    /// Checks a mesh's coordinates, indices, topology and areas.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::InvalidMesh`] if coordinates aren't finite or indices are out of range.
    pub(crate) fn of(mesh: &Mesh) -> Result<Self, ParametrizeError> {
        let infinite = mesh.vertices.iter().filter(|p| p.iter().any(|x| !x.is_finite())).count();
        let outside = mesh.faces.iter().filter(|face| face.iter().any(|&v| v as usize >= mesh.vertices.len())).count();
        let bad = |problems, remedy| Err(ParametrizeError::InvalidMesh { problems, remedy });
        if infinite > 0 {
            let problem = counted(infinite, "vertex has", "vertices have", "NaN or infinite coordinates");
            return bad(problem, "repair the coordinates and export the mesh again");
        }
        if outside > 0 {
            let problem = counted(outside, "triangle has", "triangles have", "vertex numbers out of range");
            return bad(problem, "export the mesh again");
        }
        let topology = Topology::of(mesh);
        let genus = topology.genus();
        let mut without_handles = topology.clone();
        without_handles.euler_characteristic = 2;
        let mut problems = without_handles.problems();
        let flat = mesh.faces.iter().filter(|face| !has_area(face.map(|v| mesh.vertices[v as usize]))).count();
        let flat = flat.saturating_sub(topology.degenerate_faces);
        // Two sheets may touch at a vertex, as along the seam of a surface that was cut. Such duplicates are a defect
        // only if they make a triangle flat. On open meshes, `Topology` reports duplicate vertices itself.
        if flat > 0 && topology.duplicate_vertices > 0 && topology.boundary_edges == 0 {
            problems.push(counted(topology.duplicate_vertices, "vertex lies", "vertices lie", "exactly on others"));
        }
        if flat > 0 {
            problems.push(counted(flat, "triangle has", "triangles have", "no area"));
        }
        let remedy = match genus {
            Some(_) => "collapse or remesh these triangles",
            None if topology.one_sided => "use a surface that has an inside and an outside",
            None if topology.components > 1 => "keep one piece, usually the largest, and close its holes",
            None => {
                "weld duplicate vertices, fill holes and orient the triangles consistently (for example with MeshLab or \
                 pymeshfix)"
            }
        };
        Ok(Self { problems, remedy, genus })
    }

    /// Returns the number of handles of a mesh; 0 if it isn't a closed surface.
    pub(crate) fn handles(&self) -> usize {
        self.genus.and_then(|genus| usize::try_from(genus).ok()).unwrap_or(0)
    }
}

/// Returns `count` followed by `one` or `many`, such as "1 vertex has" or "2 vertices have", and by `rest`.
fn counted(count: usize, one: &str, many: &str, rest: &str) -> String {
    format!("{count} {} {rest}", if count == 1 { one } else { many })
}

/// Returns whether a triangle's area is distinguishable from 0 in f64.
fn has_area(corners: [Vec3; 3]) -> bool {
    let longest = (0..3).map(|i| norm(sub(corners[i], corners[(i + 1) % 3]))).fold(0.0, f64::max);
    // The area is measured relative to the triangle's own size: a tiny triangle is valid, three points on a line are
    // not.
    area(corners) > 1e-12 * longest * longest
}
