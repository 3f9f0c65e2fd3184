//! Reads surfaces from files, and the samplings of the sphere on which surfaces are resampled.

use std::path::PathBuf;
use std::str::FromStr;

use spharm_monitor::Monitor;
use spharm_surface::Mesh;
use spharm_surface::generate::{icosphere, icosphere_counts};
use spharm_surface::io::{bytes_to_read, read_mesh};
use spharm_surface::range::scale_all;
use spharm_surface::repair::MeshRepair;

use crate::error::ParametrizeError;
use crate::handles::{CutSurface, HandlesReport, cut_handles};
use crate::method::Source;
use crate::trial::{Repaired, repaired, with_mending};
use crate::volume::{Repair, VolumeSurface};
use crate::wrap::wrap;

/// A surface from a file, with the changes that were made to it.
#[derive(Clone, Debug)]
pub enum Input {
    /// A mesh.
    Mesh(Mesh),
    /// A repaired mesh, with the changes made.
    Fixed(Mesh, MeshRepair),
    /// A surface whose handles were cut, and the kind of surface that it was made from.
    Cut(CutSurface, Given),
    /// The surface around a label of a volume.
    Label(VolumeSurface),
}

/// The kind of surface from which a surface with cut handles was made.
#[derive(Clone, Debug)]
pub enum Given {
    /// A mesh.
    Mesh,
    /// A mesh that was repaired.
    Fixed(MeshRepair),
    /// The surface around a label of a volume.
    Label(Box<VolumeSurface>),
}

impl<'a> From<&'a Input> for Source<'a> {
    fn from(input: &'a Input) -> Self {
        match input {
            Input::Mesh(mesh) | Input::Fixed(mesh, _) => Self::Mesh(mesh),
            Input::Cut(cut, _) => Self::Mesh(&cut.surface),
            Input::Label(found) => Self::Quads(&found.quads),
        }
    }
}

impl Input {
    /// Cuts the handles of the surface, if it has any. If the surface around a label has handles, it is first converted
    /// to triangles.
    ///
    /// # Errors
    ///
    /// The errors of [`cut_handles`].
    pub fn without_handles(self, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        let triangles;
        let mesh = match &self {
            Self::Mesh(mesh) | Self::Fixed(mesh, _) => mesh,
            Self::Label(found) if found.quads.euler_characteristic() < 2 => {
                triangles = found.quads.triangles(|_| false);
                &triangles
            }
            Self::Label(_) | Self::Cut(..) => return Ok(self),
        };
        let found = cut_handles(mesh, monitor).map_err(|error| with_mending(error, mesh, monitor))?;
        if found.seam.is_none() {
            return Ok(self);
        }
        Ok(match self {
            Self::Mesh(_) => Self::Cut(found, Given::Mesh),
            Self::Fixed(_, repair) => Self::Cut(found, Given::Fixed(repair)),
            Self::Label(label) => Self::Cut(found, Given::Label(Box::new(label))),
            Self::Cut(..) => self,
        })
    }

    /// Repairs a mesh if necessary, see [`repair`](spharm_surface::repair) and
    /// [`fill_holes`](crate::handles::fill_holes). The surface around a label is returned unchanged.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::OneSided`] or [`ParametrizeError::OpenSheet`] if the mesh can't enclose a body;
    /// [`ParametrizeError::BadSurface`] if the repair makes a two-sided mesh one-sided, or the pieces of the mesh
    /// aren't connected; [`ParametrizeError::Interrupted`].
    pub fn mended(self, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        let Self::Mesh(mesh) = &self else { return Ok(self) };
        let Repaired { mesh: mut mended, exponent, repair, two_sided } = repaired(mesh, monitor)?;
        if !two_sided {
            return Err(joined_with_a_twist(&repair));
        }
        scale_all(mended.vertices.iter_mut().flatten(), exponent);
        Ok(if repair.is_any() { Self::Fixed(mended, repair) } else { self })
    }

    /// Replaces a mesh by the closed surface around it, see [`wrap()`](crate::wrap()). The surface around a label is
    /// returned unchanged.
    ///
    /// # Errors
    ///
    /// The errors of [`wrap()`](crate::wrap()).
    pub fn wrapped(self, voxels: usize, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        let Self::Mesh(mesh) = &self else { return Ok(self) };
        let (outer, repair) = wrap(mesh, voxels, monitor)?;
        Ok(Self::Fixed(outer, repair))
    }

    /// Returns the changes that a repair made to a mesh; `None` if no mesh was repaired.
    #[must_use]
    pub fn mesh_repair(&self) -> Option<&MeshRepair> {
        if let Self::Fixed(_, repair) | Self::Cut(_, Given::Fixed(repair)) = self { Some(repair) } else { None }
    }

    /// Returns the surface around a label, before any cuts; `None` for a mesh.
    #[must_use]
    pub fn label(&self) -> Option<&VolumeSurface> {
        match self {
            Self::Label(label) => Some(label),
            Self::Cut(_, Given::Label(label)) => Some(label),
            _ => None,
        }
    }

    /// Returns the surface as a mesh; `None` for the surface around a label whose handles weren't cut.
    #[must_use]
    pub fn mesh(&self) -> Option<&Mesh> {
        match self {
            Self::Mesh(mesh) | Self::Fixed(mesh, _) => Some(mesh),
            Self::Cut(cut, _) => Some(&cut.surface),
            Self::Label(_) => None,
        }
    }

    /// Returns the cut surface, if handles were cut.
    #[must_use]
    pub fn cut(&self) -> Option<&CutSurface> {
        if let Self::Cut(cut, _) = self { Some(cut) } else { None }
    }

    /// Describes the repairs and cuts made to the given surface, for warnings. If `to_be_cut` is true but a repair has
    /// already removed all handles, one description states that the repair removed them.
    #[must_use]
    pub fn changes(&self, to_be_cut: bool) -> Vec<String> {
        let repair = self.label().and_then(|label| label.repair.as_ref());
        let lost = repair.filter(|_| to_be_cut).and_then(Repair::no_handle_left);
        let repairs = [repair.map(ToString::to_string), lost, self.mesh_repair().map(ToString::to_string)];
        repairs.into_iter().flatten().chain(self.handles().map(ToString::to_string)).collect()
    }

    /// Returns the report on the cut handles, if any.
    #[must_use]
    pub fn handles(&self) -> Option<&HandlesReport> {
        self.cut().map(|cut| &cut.report)
    }
}

/// Returns the error for a repair that makes a two-sided mesh one-sided.
fn joined_with_a_twist(repair: &MeshRepair) -> ParametrizeError {
    let changes = repair.changes();
    ParametrizeError::BadSurface {
        problems: format!("after the repair ({changes}), the surface has one side only, like a Möbius strip"),
        handles: 0,
        remedy: "separate the parts of the surface that touch each other",
        mending: None,
    }
}

/// A sampling of the sphere for [`resample`](crate::resample()). A sampling is parsed from `icosphere:N` or from the
/// path of a sphere's file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// An icosphere with this number of subdivisions, 0 to 10.
    Icosphere(u32),
    /// The vertices of a sphere in a file.
    File(PathBuf),
}

impl FromStr for Sampling {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(number) = text.strip_prefix("icosphere:") else { return Ok(Self::File(text.into())) };
        match number.parse() {
            Ok(subdivisions @ 0..=10) => Ok(Self::Icosphere(subdivisions)),
            _ => Err(format!("expected icosphere:0 to icosphere:10, found {text}")),
        }
    }
}

impl Sampling {
    /// Number of bytes per vertex of the sampling that are needed to resample a surface.
    pub const BYTES_PER_VERTEX: u64 = 700;

    /// Estimates the number of bytes needed to resample a surface on this sampling, including the sphere, its search
    /// tree and the resampled meshes. For a file, the number of vertices is estimated from the file's size.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        /// Smallest number of bytes per vertex in a sphere's file: 12 for the vertex and 24 for its triangles.
        const FILE: u64 = 36;
        match self {
            Self::Icosphere(subdivisions) => Self::BYTES_PER_VERTEX * icosphere_counts(*subdivisions)[0],
            Self::File(path) => bytes_to_read(path).saturating_mul(Self::BYTES_PER_VERTEX / FILE),
        }
    }

    /// Returns the sphere, which is generated or read from its file.
    ///
    /// # Errors
    ///
    /// The errors of `spharm_surface::io::read_mesh` if the sphere's file can't be read.
    pub fn sphere(&self) -> Result<Mesh, ParametrizeError> {
        match self {
            Self::Icosphere(subdivisions) => Ok(icosphere(*subdivisions)),
            Self::File(path) => Ok(read_mesh(path)?),
        }
    }
}
