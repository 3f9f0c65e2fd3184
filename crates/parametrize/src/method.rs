//! Defines an enum of the mapping methods and their settings, so that programs and bindings can choose a method at run
//! time.

use spharm_monitor::Monitor;
use spharm_surface::Mesh;
use spharm_surface::range::{scale_all, scaled_meshes};

use crate::auto::auto;
use crate::cald::{CaldParams, cald};
use crate::conformal::{ConformalParams, conformal};
use crate::deform::{DeformParams, deform};
use crate::equal_area::{EqualAreaParams, equal_area};
use crate::error::ParametrizeError;
use crate::report::Parametrization;
use crate::stretch::{StretchParams, stretch};
use crate::volume::QuadMesh;

/// A surface to be mapped, made of triangles or of quadrangles.
#[derive(Clone, Copy, Debug)]
pub enum Source<'a> {
    /// Triangles.
    Mesh(&'a Mesh),
    /// The quadrangles around a label of a volume.
    Quads(&'a QuadMesh),
}

impl<'a> From<&'a Mesh> for Source<'a> {
    fn from(mesh: &'a Mesh) -> Self {
        Self::Mesh(mesh)
    }
}

impl<'a> From<&'a QuadMesh> for Source<'a> {
    fn from(quads: &'a QuadMesh) -> Self {
        Self::Quads(quads)
    }
}

/// A method for mapping a surface to the sphere, with its settings.
///
/// ```
/// use spharm_monitor::Silent;
/// use spharm_parametrize::{ConformalParams, Method};
/// use spharm_surface::generate::icosphere;
///
/// let found = Method::Conformal(ConformalParams::default()).run(&icosphere(2), &Silent)?;
/// assert_eq!(found.report.method, "conformal");
/// # Ok::<(), spharm_parametrize::ParametrizeError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Method {
    /// Maps meshes by [`auto`](crate::auto()), and quadrangles by [`equal_area`](crate::equal_area()) with default
    /// settings.
    Auto(CaldParams),
    /// Maps meshes by [`cald`](crate::cald()).
    Cald(CaldParams),
    /// Maps meshes by [`conformal`](crate::conformal()).
    Conformal(ConformalParams),
    /// Maps meshes by [`stretch`](crate::stretch()).
    Stretch(StretchParams),
    /// Maps quadrangles by [`equal_area`](crate::equal_area()); meshes are rejected.
    EqualArea(EqualAreaParams),
    /// Deforms an icosphere by [`deform`](crate::deform()), starting from the map made by [`auto`](crate::auto()).
    Deform {
        /// Settings of the deformation.
        params: DeformParams,
        /// Settings of the initial map.
        map: CaldParams,
    },
}

impl Default for Method {
    fn default() -> Self {
        Self::Auto(CaldParams::default())
    }
}

impl Method {
    /// Maps a surface to the sphere. Methods for meshes cut quadrangles into triangles.
    ///
    /// # Errors
    ///
    /// The errors of the method; [`ParametrizeError::Argument`] if the method is equal-area and the surface is a
    /// mesh.
    pub fn run<'a>(
        &self,
        source: impl Into<Source<'a>>,
        monitor: &dyn Monitor,
    ) -> Result<Parametrization, ParametrizeError> {
        let triangles;
        let mesh = match (source.into(), self) {
            (Source::Quads(quads), Self::Auto(_)) => return equal_area(quads, &EqualAreaParams::default(), monitor),
            (Source::Quads(quads), Self::EqualArea(params)) => return equal_area(quads, params, monitor),
            (Source::Quads(quads), _) => {
                triangles = quads.triangles(|_| false);
                &triangles
            }
            (Source::Mesh(mesh), _) => mesh,
        };
        match self {
            Self::Auto(params) => auto(mesh, params, monitor),
            Self::Cald(params) => cald(mesh, params, monitor),
            Self::Conformal(params) => conformal(mesh, params, monitor),
            Self::Stretch(params) => stretch(mesh, params, monitor),
            Self::EqualArea(_) => Err(ParametrizeError::Argument {
                what: "method equal-area",
                expected: "a label of a volume",
                found: "a mesh; choose another method for meshes".to_owned(),
            }),
            Self::Deform { .. } if let Some(([scaled], exponent)) = scaled_meshes([mesh]) => {
                let mut found = self.run(&scaled, monitor)?;
                scale_all(found.surface.vertices.iter_mut().flatten(), exponent);
                if let Some(resampling) = &mut found.resampling {
                    resampling.distance = resampling.distance.times(exponent);
                }
                Ok(found)
            }
            Self::Deform { params, map } => {
                let first = auto(mesh, map, monitor)?;
                Ok(deform(&first.surface, &first.sphere, params, monitor)?.after(&first.report))
            }
        }
    }
}
