//! Checks a surface, and brings it into the form that the mapping methods expect: triangles wound outwards, and a total
//! area of 4 pi.

use spharm_monitor::{Monitor, number};
use spharm_surface::Mesh;
use spharm_surface::range::{scaled_meshes, times};
use spharm_surface::topology::is_outward;

use crate::error::ParametrizeError;
use crate::flaws::Flaws;
use crate::geometry::{Vec3, area, scale};
use crate::handles::shortest_loops;
use crate::trial::mending;

/// Largest number of handles for which an error message lists the lengths of the loops.
const MOST_LOOPS: usize = 5;

/// Largest number of vertices of a mesh whose loops are computed for an error message. For a mesh of this size,
/// computing the loops takes a second.
const MOST_VERTICES: usize = 50_000;

/// A closed surface of genus zero without defects.
pub(crate) struct Domain {
    /// Positions, scaled so that the triangles' areas sum to 4 pi.
    pub(crate) positions: Vec<Vec3>,
    /// Triangles, counter-clockwise seen from outside.
    pub(crate) faces: Vec<[u32; 3]>,
    /// Areas of the triangles; they sum to 4 pi.
    pub(crate) areas: Vec<f64>,
    /// Whether the given mesh winds inwards. If so, `faces` are reversed relative to the mesh.
    inward: bool,
}

impl Domain {
    /// Checks and scales a mesh.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::InvalidMesh`] if coordinates aren't finite or indices are out of range;
    /// [`ParametrizeError::BadSurface`] if the mesh has handles or defects (the error lists all problems found and, if
    /// a repair would succeed, the changes that the repair would make); [`ParametrizeError::Interrupted`].
    pub(crate) fn new(mesh: &Mesh, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        let scaled = scaled_meshes([mesh]);
        let (mesh, exponent) = scaled.as_ref().map_or((mesh, 0), |([mesh], exponent)| (mesh, *exponent));
        check(mesh, exponent, monitor)?;
        let corners = |face: &[u32; 3]| face.map(|v| mesh.vertices[v as usize]);
        let total: f64 = mesh.faces.iter().map(|face| area(corners(face))).sum();
        let factor = (4.0 * std::f64::consts::PI / total).sqrt();
        // Positions are relative to a vertex of the surface, so that no digits are lost if the surface is far from the
        // origin.
        let [x, y, z] = mesh.vertices[0];
        let positions: Vec<Vec3> =
            mesh.vertices.iter().map(|&[a, b, c]| scale([a - x, b - y, c - z], factor)).collect();
        let areas = mesh.faces.iter().map(|face| area(face.map(|v| positions[v as usize]))).collect();
        let inward = !is_outward(mesh);
        let turned = |&[a, b, c]: &[u32; 3]| if inward { [a, c, b] } else { [a, b, c] };
        Ok(Self { positions, faces: mesh.faces.iter().map(turned).collect(), areas, inward })
    }

    /// Returns the sphere of the given mesh: the mesh's triangles, with the vectors `unit` as vertices.
    ///
    /// If the mesh winds inwards, its sphere winds inwards, too: the sphere isn't a mirror image of the mesh.
    pub(crate) fn sphere(&self, mesh: &Mesh, unit: Vec<Vec3>) -> Mesh {
        let mut sphere = Mesh::new(unit, mesh.faces.clone());
        sphere.meta.anatomical_structure_primary = mesh.meta.anatomical_structure_primary.clone();
        debug_assert_eq!(self.inward, self.faces[0] != mesh.faces[0]);
        sphere
    }
}

/// Rejects meshes that have handles or defects. The coordinates of `mesh` were divided by 2^exponent.
fn check(mesh: &Mesh, exponent: i32, monitor: &dyn Monitor) -> Result<(), ParametrizeError> {
    let found = Flaws::of(mesh)?;
    let handles = found.handles();
    let mut problems = found.problems;
    if problems.is_empty() && handles == 0 {
        return Ok(());
    }
    let mending = if problems.is_empty() { None } else { mending(mesh, monitor)? };
    if handles > 0 {
        problems.push(with_lengths(mesh, handles, problems.is_empty(), exponent));
    }
    let remedy =
        if handles > 0 { "cut or fill the handles first; handles are often segmentation errors" } else { found.remedy };
    Err(ParametrizeError::BadSurface { problems: problems.join("; "), handles, remedy, mending })
}

/// Describes the number of handles. If the mesh is small and has no other defects, includes the lengths of the loops
/// along which the handles could be cut.
fn with_lengths(mesh: &Mesh, handles: usize, clean: bool, exponent: i32) -> String {
    let text = match handles {
        1 => "the surface has a handle (genus 1)".to_owned(),
        handles => format!("the surface has {handles} handles (genus {handles})"),
    };
    if !clean || handles > MOST_LOOPS || mesh.vertices.len() > MOST_VERTICES {
        return text;
    }
    let lengths = shortest_loops(mesh, handles);
    let lengths: Vec<String> = lengths.iter().map(|length| number(times(*length, exponent))).collect();
    let loops = if lengths.len() == 1 { "a loop" } else { "loops" };
    format!("{text}; handles can be cut along {loops} of length {}", lengths.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;

    fn message(mesh: &Mesh) -> String {
        Domain::new(mesh, &Silent).err().map(|error| error.to_string()).unwrap_or_default()
    }

    #[test]
    fn problems_are_named_with_counts() {
        let good = icosphere(2);
        assert!(Domain::new(&good, &Silent).is_ok());

        let mut open = good.clone();
        open.faces.pop();
        assert!(message(&open).contains("3 edges belong to one triangle only"), "{}", message(&open));

        let mut two = good.clone();
        two.vertices.extend(good.vertices.iter().map(|&[x, y, z]| [x + 5.0, y, z]));
        two.faces.extend(good.faces.iter().map(|face| face.map(|v| v + good.vertices.len() as u32)));
        assert!(message(&two).contains("2 separate pieces"), "{}", message(&two));

        let mut nan = good.clone();
        nan.vertices[3][1] = f64::NAN;
        assert!(message(&nan).contains("1 vertex has NaN"), "{}", message(&nan));

        let mut turned = good.clone();
        turned.faces[0].swap(0, 1);
        assert!(message(&turned).contains("of opposite orientation"), "{}", message(&turned));

        let mut welded = good.clone();
        let [a, b, _] = welded.faces[0];
        welded.vertices[a as usize] = welded.vertices[b as usize];
        let text = message(&welded);
        assert!(
            text.contains("1 vertex lies exactly on others") && text.contains("2 triangles have no area"),
            "{text}"
        );

        let mut loose = good.clone();
        loose.vertices.push([9.0, 9.0, 9.0]);
        assert!(message(&loose).contains("1 vertex belongs to no triangle"), "{}", message(&loose));
    }

    #[test]
    fn the_genus_of_a_torus_is_named() {
        let (rings, segments) = (12_u32, 8_u32);
        let mut torus = Mesh::default();
        for i in 0..rings {
            for j in 0..segments {
                let (u, v) = (f64::from(i) * std::f64::consts::TAU / 12.0, f64::from(j) * std::f64::consts::TAU / 8.0);
                torus.vertices.push([(2.0 + v.cos()) * u.cos(), (2.0 + v.cos()) * u.sin(), v.sin()]);
                let at = |i: u32, j: u32| (i % rings) * segments + j % segments;
                torus.faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                torus.faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        assert!(message(&torus).contains("genus 1"), "{}", message(&torus));
    }
}
