//! Reads surfaces that are given as meshes or as models, which are evaluated as meshes.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Result, bail};
use spharm::{Kind, Model, Sphere};
use spharm_cli::models::cut_handles;
use spharm_cohort::is_model;
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere_counts;
use spharm_surface::io::read_mesh;

/// Minimum number of icosphere vertices per basis function of a model, for the icosphere on which the model is
/// evaluated.
const VERTICES: u64 = 4;

/// Number of subdivisions of the finest icosphere on which models are evaluated.
const FINEST: u32 = 7;

/// A surface as read from a file: a mesh, or a model that isn't evaluated yet.
pub(crate) enum Surface {
    Mesh(Box<Mesh>),
    /// A model, and the subdivisions of the icosphere that suits its degree.
    Model(Box<Model>, u32),
}

impl Surface {
    /// Reads a mesh or a model.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        if !is_model(path) {
            return Ok(Self::Mesh(Box::new(read_mesh(path)?)));
        }
        let model = Model::read(path)?;
        if model.kind() != Kind::Surface {
            bail!("{}: expected a model of a surface, found a model of a signal", path.display());
        }
        let functions = (model.coefficients.max_degree() + 1).pow(2);
        let suits = |level: &u32| icosphere_counts(*level)[0] >= VERTICES * functions as u64;
        Ok(Self::Model(Box::new(model), (4..FINEST).find(suits).unwrap_or(FINEST)))
    }

    /// Selects the finest icosphere, of 163,842 vertices, if the surface is a model. The mesh is then much nearer to
    /// the model than the model is to the fitted surface. For a model of a sphere, the triangles of this mesh are
    /// inside the sphere by at most 3e-5 of its radius.
    pub(crate) fn finest(self) -> Self {
        match self {
            Self::Mesh(mesh) => Self::Mesh(mesh),
            Self::Model(model, _) => Self::Model(model, FINEST),
        }
    }

    /// Returns whether the surface is a model.
    pub(crate) fn is_model(&self) -> bool {
        matches!(self, Self::Model(..))
    }

    /// Returns a warning if the surface is a model whose handles were cut.
    pub(crate) fn cut_handles(&self) -> Option<&'static str> {
        match self {
            Self::Mesh(_) => None,
            Self::Model(model, _) => cut_handles(model),
        }
    }

    /// Returns whether both surfaces are models whose surfaces were mapped to the sphere separately, so that equal
    /// directions don't correspond.
    pub(crate) fn mapped_apart(&self, other: &Self) -> bool {
        matches!((self, other), (Self::Model(own, _), Self::Model(other, _)) if own.mapped_apart(other))
    }

    /// Returns the numbers of vertices and triangles of the mesh.
    pub(crate) fn counts(&self) -> [u64; 2] {
        match self {
            Self::Mesh(mesh) => [mesh.vertices.len() as u64, mesh.faces.len() as u64],
            Self::Model(_, level) => icosphere_counts(*level),
        }
    }

    /// Returns the memory in bytes that [`meshes`] needs for this surface, in addition to the surface's mesh.
    pub(crate) fn bytes_to_evaluate(&self) -> u64 {
        match self {
            Self::Mesh(_) => 0,
            Self::Model(model, level) => {
                let [vertices, faces] = icosphere_counts(*level);
                Model::bytes_to_evaluate(vertices, faces, 3, model.coefficients.max_degree())
            }
        }
    }

    /// Returns the surface's mesh.
    pub(crate) fn into_mesh(self) -> Result<Mesh> {
        match self {
            Self::Mesh(mesh) => Ok(*mesh),
            Self::Model(model, level) => {
                Ok(model.reconstruct(&Sphere::icosphere(level), model.coefficients.max_degree())?)
            }
        }
    }
}

/// Returns the mesh of each surface. Models of similar degrees are evaluated on the same icosphere, which is made only
/// once.
pub(crate) fn meshes(surfaces: Vec<Surface>) -> Result<Vec<Mesh>> {
    let mut spheres: HashMap<u32, Sphere> = HashMap::new();
    let mesh = |surface| match surface {
        Surface::Mesh(mesh) => Ok(*mesh),
        Surface::Model(model, level) => {
            let sphere = spheres.entry(level).or_insert_with(|| Sphere::icosphere(level));
            Ok(model.reconstruct(sphere, model.coefficients.max_degree())?)
        }
    };
    surfaces.into_iter().map(mesh).collect()
}
