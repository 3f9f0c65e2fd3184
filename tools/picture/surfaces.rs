//! Reads the surfaces of a picture: meshes, and models as meshes.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm::{Kind, Model, Sphere};
use spharm_cli::paths::{expand, model_name};
use spharm_cohort::is_model;
use spharm_render::fit_into;
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere_counts;
use spharm_surface::geometry::bounds;
use spharm_surface::io::read_mesh;

use crate::shape::table::{Table, finite, rows_of};

/// Number of vertices of a model's mesh for each basis function up to the model's degree.
const VERTICES: u64 = 4;

/// Returns the files of surfaces, with folders replaced by the models in them.
pub(super) fn files(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    expand(given, ".spharm.npz")
}

/// A surface as it was read.
pub(super) enum Surface {
    Mesh(Box<Mesh>),
    /// A model, and the subdivisions of the icosphere that suits its degree.
    Model(Box<Model>, u32),
}

impl Surface {
    /// Reads a mesh or a model.
    pub(super) fn read(path: &Path) -> Result<Self> {
        if !is_model(path) {
            return Ok(Self::Mesh(Box::new(read_mesh(path)?)));
        }
        let model = Model::read(path)?;
        if model.kind() != Kind::Surface {
            bail!("{}: expected a model of a surface, found one of a signal", path.display());
        }
        let functions = (model.coefficients.max_degree() + 1).pow(2);
        let suits = |level: &u32| icosphere_counts(*level)[0] >= VERTICES * functions as u64;
        Ok(Self::Model(Box::new(model), (4..7).find(suits).unwrap_or(7)))
    }

    /// Returns the numbers of vertices and triangles of the mesh.
    pub(super) fn counts(&self) -> [u64; 2] {
        match self {
            Self::Mesh(mesh) => [mesh.vertices.len() as u64, mesh.faces.len() as u64],
            Self::Model(_, level) => icosphere_counts(*level),
        }
    }

    /// Returns the memory in bytes that [`meshes`] takes for this surface, besides the surface's mesh.
    pub(super) fn bytes_to_evaluate(&self) -> u64 {
        match self {
            Self::Mesh(_) => 0,
            Self::Model(model, level) => {
                let [vertices, faces] = icosphere_counts(*level);
                Model::bytes_to_evaluate(vertices, faces, 3, model.coefficients.max_degree())
            }
        }
    }
}

/// Returns the meshes of surfaces.
pub(super) fn meshes(surfaces: Vec<Surface>) -> Result<Vec<Mesh>> {
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

/// Returns the name of a surface, for its caption.
pub(super) fn name(path: &Path) -> String {
    if is_model(path) { model_name(path) } else { spharm_cli::inputs::stem(path) }
}

/// Moves the meshes so that the centres of all bounding boxes coincide with that of the first mesh.
pub(super) fn centre(meshes: &mut [Mesh]) {
    let middle = |mesh: &Mesh| {
        let (low, high) = bounds(mesh.vertices.iter().copied());
        [0, 1, 2].map(|k| 0.5 * (low[k] + high[k]))
    };
    let Some(to) = meshes.first().map(middle) else { return };
    for mesh in meshes.iter_mut() {
        let from = middle(mesh);
        mesh.vertices.iter_mut().for_each(|x| *x = [0, 1, 2].map(|k| x[k] - from[k] + to[k]));
    }
}

/// Moves and scales the meshes so that their bounding boxes have the centre and the largest extent of the first
/// mesh's.
pub(super) fn fit_each(meshes: &mut [Mesh]) {
    let Some((first, others)) = meshes.split_first_mut() else { return };
    others.iter_mut().for_each(|mesh| *mesh = fit_into(mesh, first));
}

/// Returns a number for each surface from a column of a table. The surfaces' paths or names are in the table's column
/// `model` or, without one, in its first column.
///
/// # Errors
///
/// If a surface has no row, or its cell isn't a number.
pub(super) fn numbers(path: &Path, column: &str, surfaces: &[PathBuf]) -> Result<Vec<f64>> {
    let table = Table::read(path)?;
    let key = if table.has("model") { "model" } else { table.names().next().unwrap_or_default() }.to_owned();
    let named = || format!("{}: column {key:?}", path.display());
    let rows = rows_of(table.texts(&key)?, surfaces).with_context(named)?;
    let cells = table.texts(column)?;
    let number = |(surface, row): (&PathBuf, usize)| {
        let found = finite(cells[row]);
        found.with_context(|| {
            let (table, surface) = (path.display(), surface.display());
            format!("{table}: column {column:?}: expected a number for {surface}, found {:?}", cells[row])
        })
    };
    surfaces.iter().zip(rows).map(number).collect()
}
