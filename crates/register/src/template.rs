//! Prepares a template: computes the data that the registrations to all subjects of a group share.

use rayon::prelude::*;
use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, dot, face_normal};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::topology::area;
use spharm_surface::{Mesh, SpreadPoints};

use crate::error::RegisterError;
use crate::low_rank::LowRank;
use crate::params::RegisterParams;
use crate::plate::Plate;

/// Largest number of columns of a kernel's factor.
const RANK: usize = 200;
/// The factorisation of a kernel ends when no diagonal entry of the remainder exceeds this value.
const LEFT: f64 = 1e-3;

/// A mesh to be moved onto subjects, with the factors of its kernels and its thin plate.
pub struct Template {
    pub(crate) mesh: Mesh,
    /// Whether each of the n vertices is masked, because it has no counterpart on subjects.
    pub(crate) masked: Vec<bool>,
    /// The square root of the template's area, which is the unit of lengths in [`RegisterParams`].
    pub(crate) scale: f64,
    pub(crate) plate: Plate,
    pub(crate) stages: Vec<Stage>,
}

/// A stage of the drift: a kernel, and the points at which it is used.
pub(crate) struct Stage {
    /// Points on the unmasked triangles of the template.
    pub(crate) spread: SpreadPoints,
    /// The kernel's factor at the points `spread` and at the template's vertices.
    pub(crate) kernel: LowRank,
    pub(crate) stiffness: f64,
}

impl Template {
    /// Prepares a template. `masked` (n) marks vertices without a counterpart on subjects, such as the lids of filled
    /// holes. Subjects don't pull these vertices.
    ///
    /// # Errors
    ///
    /// [`RegisterError::Triangle`] if a triangle is invalid, [`RegisterError::NoArea`] if the area isn't positive and
    /// finite, [`RegisterError::Values`] if `masked` has the wrong length, [`RegisterError::AllMasked`] if every
    /// triangle has a masked vertex, [`RegisterError::Singular`] if the plate's matrix can't be built, and
    /// [`RegisterError::Interrupted`] if `monitor` cancels the registration.
    pub fn new(
        mesh: &Mesh,
        masked: Option<&[bool]>,
        params: &RegisterParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, RegisterError> {
        let n = mesh.vertices.len();
        for (face, found) in mesh.faces.iter().enumerate() {
            let [a, b, c] = *found;
            if found.iter().any(|v| *v as usize >= n) || a == b || b == c || c == a {
                return Err(RegisterError::Triangle { face, found: *found, vertices: n });
            }
        }
        if masked.is_some_and(|masked| masked.len() != n) {
            return Err(RegisterError::Values { expected: n, found: masked.map_or(0, <[bool]>::len) });
        }
        let scale = area(mesh).sqrt();
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(RegisterError::NoArea { what: "the template" });
        }
        let masked = masked.map_or_else(|| vec![false; n], <[bool]>::to_vec);
        let masked_faces: Vec<bool> = mesh.faces.iter().map(|face| face.iter().any(|v| masked[*v as usize])).collect();
        if masked_faces.iter().all(|masked| *masked) {
            return Err(RegisterError::AllMasked);
        }
        let stages = params.drift.par_iter().enumerate().map(|(index, stage)| {
            monitor.check()?;
            let spread = spread_over(mesh, &masked_faces, stage.points.min(n / 2), 7919 * index);
            let kernel = LowRank::new(&spread.points, &mesh.vertices, stage.width * scale, RANK, LEFT);
            Ok::<_, RegisterError>(Stage { spread, kernel, stiffness: stage.stiffness })
        });
        let stages = stages.collect::<Result<_, _>>()?;
        let plate = Plate::new(&mesh.faces, n)?;
        Ok(Self { mesh: mesh.clone(), masked, scale, plate, stages })
    }

    /// Returns the square root of the template's area.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Returns the template's mesh.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }
}

/// Spreads points over the unmasked triangles. The triangles of the points are numbered as in the whole mesh.
fn spread_over(mesh: &Mesh, masked_faces: &[bool], count: usize, seed: usize) -> SpreadPoints {
    let kept: Vec<u32> = (0..mesh.faces.len() as u32).filter(|face| !masked_faces[*face as usize]).collect();
    let faces = kept.iter().map(|face| mesh.faces[*face as usize]).collect();
    let mut spread = SpreadPoints::new(&Mesh::new(mesh.vertices.clone(), faces), count, seed);
    spread.triangles.iter_mut().for_each(|face| *face = kept[*face as usize]);
    spread
}

/// Returns whether each vertex of a template, or one of its neighbours, is farther than `distance` from the original
/// surface from which the template was made. This is the case for the lids of filled holes and of cut handles.
#[must_use]
pub fn without_counterpart(template: &Mesh, original: &Mesh, distance: f64) -> Vec<bool> {
    let tree = TriangleTree::new(original);
    let far = |point: &Vec3| tree.nearest(*point).is_none_or(|found| found.distance > distance);
    let far: Vec<bool> = template.vertices.par_iter().map(far).collect();
    let mut masked = far.clone();
    for face in template.faces.iter().filter(|face| face.iter().any(|v| far[*v as usize])) {
        face.iter().for_each(|v| masked[*v as usize] = true);
    }
    masked
}

/// Returns the cross product of a triangle's edges: a normal whose length is twice the area.
pub(crate) fn doubled_normal(vertices: &[Vec3], face: [u32; 3]) -> Vec3 {
    face_normal(face.map(|v| vertices[v as usize]))
}

pub(crate) fn length(v: Vec3) -> f64 {
    dot(v, v).sqrt()
}
