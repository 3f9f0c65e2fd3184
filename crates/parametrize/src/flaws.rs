//! Finds the reasons, other than handles, why a mesh can't be mapped to the sphere.

use spharm_monitor::number;
use spharm_surface::Mesh;
use spharm_surface::topology::Topology;

use crate::error::ParametrizeError;
use crate::geometry::{Vec3, area, norm, sub};

/// Largest distance of a vertex from the middle of a mesh, as a multiple of the median distance. If a vertex lies
/// farther away, the other triangles are too small, relative to the whole mesh, for the map.
const FARTHEST: f64 = 1e12;

/// Defects of a mesh.
pub(crate) struct Flaws {
    /// Phrases that describe the problems, one each; handles aren't included.
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
    /// [`ParametrizeError::InvalidMesh`] if coordinates aren't finite, a vertex lies farther away than [`FARTHEST`], or
    /// indices are out of range.
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
        if let Some((vertex, times)) = too_far(mesh) {
            let problem = format!(
                "vertex {vertex} (counted from 0) lies {} times the median distance of the vertices from the middle of \
                 the mesh, expected at most {FARTHEST:e} times",
                number(times)
            );
            return bad(problem, "correct the coordinates of this vertex, or remove it with its triangles");
        }
        let topology = Topology::of(mesh);
        let genus = topology.genus();
        let mut without_handles = topology.clone();
        without_handles.euler_characteristic = 2;
        let mut problems = without_handles.problems();
        let flat = mesh.faces.iter().filter(|face| !has_area(face.map(|v| mesh.vertices[v as usize]))).count();
        let flat = flat.saturating_sub(topology.degenerate_faces);
        // Two sheets may touch at a vertex, as they do along the seam of a cut surface. Duplicate vertices are
        // therefore a defect only if they make a triangle flat. On open meshes, `Topology` reports duplicate vertices
        // itself.
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

    /// Returns the number of handles of a mesh; 0 if the mesh isn't a closed surface.
    pub(crate) fn handles(&self) -> usize {
        self.genus.and_then(|genus| usize::try_from(genus).ok()).unwrap_or(0)
    }
}

/// Returns the indices and positions of the vertices that triangles use, in ascending order of index.
pub(crate) fn used_vertices(mesh: &Mesh) -> Vec<(usize, Vec3)> {
    let mut used = vec![false; mesh.vertices.len()];
    mesh.faces.as_flattened().iter().for_each(|&v| used[v as usize] = true);
    mesh.vertices.iter().copied().enumerate().filter(|&(v, _)| used[v]).collect()
}

/// Returns the vertex farthest from the middle of a mesh, and its distance as a multiple of the median distance; `None`
/// if the multiple is at most [`FARTHEST`]. The middle is the point whose coordinates are the medians of the vertices'
/// coordinates. Vertices that no triangle uses are ignored.
fn too_far(mesh: &Mesh) -> Option<(usize, f64)> {
    let used = used_vertices(mesh);
    let median = |mut values: Vec<f64>| {
        let half = values.len() / 2;
        (!values.is_empty()).then(|| *values.select_nth_unstable_by(half, f64::total_cmp).1)
    };
    let middle = [0, 1, 2].map(|k| median(used.iter().map(|(_, v)| 0.5 * v[k]).collect()).unwrap_or_default());
    // Coordinates are halved, since the difference of two large numbers may overflow.
    let off = |v: Vec3| (0..3).map(|k| (0.5 * v[k] - middle[k]).abs()).fold(0.0, f64::max);
    let typical = median(used.iter().map(|&(_, v)| off(v)).collect())?;
    let (vertex, most) = used.iter().map(|&(i, v)| (i, off(v))).max_by(|a, b| a.1.total_cmp(&b.1))?;
    (typical > 0.0 && most / typical > FARTHEST).then(|| (vertex, most / typical))
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

#[cfg(test)]
mod tests {
    use spharm_surface::generate::icosphere;
    use spharm_surface::range::times;

    use super::*;

    #[test]
    fn a_vertex_far_from_the_others_is_named() {
        let mut ball = icosphere(2);
        for exponent in [-990, 0, 100, 990] {
            let vertices = ball.vertices.iter().map(|v| v.map(|x| times(x, exponent))).collect();
            assert!(Flaws::of(&ball.with_vertices(vertices)).is_ok(), "2^{exponent}");
        }
        for far in [1e30, -1e200] {
            ball.vertices[7][1] = far;
            let error = Flaws::of(&ball).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(error.contains("vertex 7 (counted from 0)") && error.contains("at most 1e12 times"), "{error}");
        }
        ball.vertices[7][1] = 1e6;
        assert!(Flaws::of(&ball).is_ok());
        ball.vertices.push([1e20, 0.0, 0.0]);
        assert!(Flaws::of(&ball).is_ok(), "no triangle uses the vertex");
    }
}
