//! Cuts surfaces with handles along short loops and fills the cuts, so that the surfaces have genus zero.
//!
//! A surface of genus g > 0 has no one-to-one map to the sphere. If such a surface is cut along g loops that together
//! don't separate it, it becomes a sphere with 2 g holes. Filling the holes gives a closed surface of genus zero. The
//! vertices and triangles of the given surface are kept, in the same order. The given surface can therefore be
//! recovered from a model of the cut surface: by dropping the fillings and welding the copies of vertices along the
//! seam ([`Seam`]).
//!
//! - `rounds`, using `homology` and `search`: chooses the loops to cut. Each handle has loops around it and loops
//!   through it; the shortest of these loops is cut.
//! - `complex`: makes the cuts.
//! - `disc`, `fair`, `filling`: make the fillings, which continue the surface smoothly across the seam.
//! - `holes`, `strip`: fill holes of a mesh in the same way, and slits by strips of triangles.
//!
//! Cost: O(n log n) for a single handle; with many handles, O(n log n) for each round. Each of the two fillings of a
//! loop with m vertices has 0.09 m^2 vertices.

mod complex;
mod disc;
mod fair;
mod filling;
mod holes;
mod homology;
mod report;
mod rounds;
mod search;
mod strip;

pub use holes::{LARGEST_HOLE, fill_holes};
pub use report::{CutLoop, CutSurface, HandlesReport, Kind};

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor, Silent};
use spharm_surface::geometry::{unit, vertex_normals};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::topology::{Topology, is_outward};
use spharm_surface::{Mesh, Seam};

use self::complex::{Complex, Rims};
use self::filling::{Filling, Rim};
use self::rounds::Cut;
use crate::error::ParametrizeError;
use crate::flaws::Flaws;
use crate::geometry::{Vec3, add, area, scale};

/// Cuts a closed surface along short loops, one for each handle, and fills both sides of each cut. A surface of genus
/// zero is returned unchanged.
///
/// The result has the same bits for any number of threads.
///
/// # Errors
///
/// [`InvalidMesh`](ParametrizeError::InvalidMesh) if coordinates aren't finite or indices are out of range;
/// [`BadSurface`](ParametrizeError::BadSurface) if the mesh isn't a single closed surface without defects, or if
/// handles remain; [`Interrupted`](ParametrizeError::Interrupted).
pub fn cut_handles(surface: &Mesh, monitor: &dyn Monitor) -> Result<CutSurface, ParametrizeError> {
    let flaws = Flaws::of(surface)?;
    let genus = flaws.handles();
    if !flaws.problems.is_empty() {
        let problems = flaws.problems.join("; ");
        return Err(ParametrizeError::BadSurface { problems, handles: genus, remedy: flaws.remedy, mending: None });
    }
    let corners = |face: &[u32; 3]| face.map(|v| surface.vertices[v as usize]);
    let mut report = HandlesReport {
        genus_before: genus,
        area: surface.faces.iter().map(|face| area(corners(face))).sum(),
        ..HandlesReport::default()
    };
    if genus == 0 {
        return Ok(CutSurface { surface: surface.clone(), seam: None, report });
    }
    let mut complex = Complex::new(surface);
    let cuts = rounds::cut_all(&mut complex, genus, monitor)?;
    let cuts = cuts.ok_or_else(|| {
        let which = if genus == 1 { "the handle" } else { &format!("at least one of the {genus} handles") };
        left_over(format!("no loop was found around {which}"))
    })?;
    let mut cut = Mesh::new(complex.positions.clone(), complex.own_triangles().collect());
    cut.meta.clone_from(&surface.meta);
    let normals = vertex_normals(&surface.vertices, &surface.faces);
    let outward = is_outward(surface);
    for (found, filling) in cuts.iter().zip(fillings(&complex, surface, &normals, &cuts, monitor)?) {
        let (rim, first) = (right_rim(&complex, &found.rims), cut.vertices.len() as u32);
        let sum = rim.iter().fold([0.0; 3], |sum, &v| add(sum, complex.positions[v as usize]));
        report.loops.push(CutLoop {
            kind: if outward { filling.kind } else { filling.kind.other() },
            length: found.length,
            vertices: rim.len(),
            area_added: filling.area,
            centre: scale(sum, 1.0 / rim.len() as f64),
        });
        report.area_added += filling.area;
        report.vertices_added += filling.vertices.len();
        let vertices = complex.vertices() as u32;
        let renumber = |v: u32| if v < vertices { v } else { v - vertices + first };
        cut.faces.extend(filling.faces.iter().map(|face| face.map(renumber)));
        cut.vertices.extend(filling.vertices);
    }
    // The topology of the result is checked, because a surface with a wrong topology would lead to a wrong model
    // without any error message.
    let topology = Topology::of(&cut);
    if !topology.is_sphere() {
        return Err(left_over(topology.problems().join("; ")));
    }
    let copies = complex.own[surface.vertices.len()..].to_vec();
    let seam = Seam { vertices: surface.vertices.len(), faces: surface.faces.len(), copies };
    Ok(CutSurface { surface: cut, seam: Some(seam), report })
}

/// Returns the lengths of the loops found by the first round of cuts: short loops that don't separate the surface, at
/// most one for each handle.
pub(crate) fn shortest_loops(surface: &Mesh, genus: usize) -> Vec<f64> {
    let found = rounds::round(&Complex::new(surface), &Silent).unwrap_or_default();
    found.into_iter().take(genus).map(|found| found.length).collect()
}

fn left_over(problems: String) -> ParametrizeError {
    let remedy = "remesh the surface, or cut its handles by hand";
    ParametrizeError::BadSurface { problems, handles: 0, remedy, mending: None }
}

/// Returns the fillings of all cuts. In each filling, the new vertices are numbered from the complex's number of
/// vertices.
fn fillings(
    complex: &Complex,
    surface: &Mesh,
    normals: &[Vec3],
    cuts: &[Cut],
    monitor: &dyn Monitor,
) -> Result<Vec<Filling>, Interrupted> {
    let tree = TriangleTree::new(surface);
    let filled = cuts.par_iter().map(|cut| {
        monitor.check()?;
        let (right, left) = (right_rim(complex, &cut.rims), left_rim(complex, &cut.rims));
        let places: Vec<Vec3> = right.iter().map(|&v| complex.positions[v as usize]).collect();
        let normals: Vec<Vec3> = right.iter().map(|&v| unit(normals[complex.own[v as usize] as usize])).collect();
        let rim = Rim { right: &right, left: &left, places: &places, normals: &normals, surface: &tree };
        rim.fill(complex.vertices() as u32, monitor)
    });
    filled.collect()
}

/// Returns the vertices on the right of a cut, in the loop's order. The vertices may include copies made by later cuts.
fn right_rim(complex: &Complex, rims: &Rims) -> Vec<u32> {
    rims.right.iter().map(|&h| complex.from(h)).collect()
}

/// Returns the vertices on the left of a cut, in the loop's order.
fn left_rim(complex: &Complex, rims: &Rims) -> Vec<u32> {
    rims.left.iter().map(|&h| complex.to(h)).collect()
}
