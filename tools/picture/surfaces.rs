//! Places and names the surfaces of a picture.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use spharm::Model;
use spharm_analysis::table::{Table, finite, rows_of};
use spharm_cli::console::Console;
use spharm_cli::paths::{expand, model_name};
use spharm_cohort::is_model;
use spharm_render::fit_into;
use spharm_surface::Mesh;
use spharm_surface::geometry::bounds;

/// Returns the paths of the surfaces. Each folder in `given` is replaced by the models in this folder.
pub(super) fn files(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    expand(given, ".spharm.npz")
}

/// Returns the name of a surface, for its caption.
pub(super) fn name(path: &Path) -> String {
    if is_model(path) { model_name(path) } else { spharm_cli::inputs::stem(path) }
}

/// Moves the meshes so that the centre of each bounding box coincides with the centre of the first mesh's box.
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

/// Moves and scales the meshes so that each bounding box has the same centre and the same largest extent as the first
/// mesh's box.
pub(super) fn fit_each(meshes: &mut [Mesh]) {
    let Some((first, others)) = meshes.split_first_mut() else { return };
    others.iter_mut().for_each(|mesh| *mesh = fit_into(mesh, first));
}

/// Returns the number of each surface in a column of a table. The surfaces' paths or names are in the table's column
/// `model` or, if it has no such column, in its first column. Warns if this column has paths of files other than the
/// surfaces.
///
/// # Errors
///
/// If a surface has no row, or its cell isn't a number.
pub(super) fn numbers(path: &Path, column: &str, surfaces: &[PathBuf], console: &Console) -> Result<Vec<f64>> {
    let table = Table::read(path)?;
    let key = if table.has("model") { "model" } else { table.names().next().unwrap_or_default() }.to_owned();
    let named = || format!("{}: column {key:?}", path.display());
    let keys = table.texts(&key)?;
    let rows = rows_of(keys.clone(), surfaces).with_context(named)?;
    let other = |(surface, row): &(&PathBuf, &usize)| is_other_file(path, keys[**row], surface);
    let others: Vec<(&PathBuf, &usize)> = surfaces.iter().zip(&rows).filter(other).collect();
    if let Some((surface, row)) = others.first() {
        let (count, cell, surface) = (others.len(), keys[**row], surface.display());
        console.warn(format!(
            "{}: paths in {count} of {} rows lead to other files of the same names, such as {cell} for {surface}; check \
             that this is the table of these surfaces",
            named(),
            rows.len()
        ));
    }
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

/// Returns whether a cell of a table is the path of an existing file other than the surface. Paths are relative to the
/// current folder or to the table.
fn is_other_file(table: &Path, cell: &str, surface: &Path) -> bool {
    let folder = table.parent().unwrap_or(Path::new(""));
    let paths = [PathBuf::from(cell), folder.join(cell)];
    let found: Vec<PathBuf> =
        paths.iter().filter(|path| path.is_file()).filter_map(|path| path.canonicalize().ok()).collect();
    // A table of the original surfaces may also be used for files made from these surfaces. Reconstructions have other
    // names, and aligned models record the same input, so neither counts as another file.
    let same_name = |path: &PathBuf| path.file_name() == surface.file_name() && !is_copy(path, surface);
    surface.canonicalize().is_ok_and(|own| !found.contains(&own)) && found.iter().any(same_name)
}

/// Returns whether two files are models of the same input.
fn is_copy(a: &Path, b: &Path) -> bool {
    let input = |path: &Path| Model::read(path).ok()?.provenance.input;
    input(a).zip(input(b)).is_some_and(|(a, b)| a == b)
}
