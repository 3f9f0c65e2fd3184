//! Writes maps of a surface's geometry: a per-vertex file for each quantity, or one table of all quantities.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm::shape::LocalGeometry;
use spharm_cli::output::prepare;
use spharm_cli::paths::{model_file_name, with_ending};
use spharm_surface::io::{PlyAttributes, WriteOptions, write_painted, write_signal};
use spharm_surface::metrics::colors;
use spharm_surface::{Mesh, Signal, Sphere};

use super::outputs::{csv, exact, write_text};

/// Name of a quantity, and the function that computes it.
type Map = (&'static str, fn(&LocalGeometry) -> f64);

const MAPS: [Map; 5] = [
    ("mean-curvature", LocalGeometry::mean_curvature),
    ("gaussian-curvature", LocalGeometry::gaussian_curvature),
    ("shape-index", LocalGeometry::shape_index),
    ("curvedness", LocalGeometry::curvedness),
    ("area-element", |point| point.area_element),
];

/// Columns of the table that has all quantities.
const COLUMNS: [&str; 16] = [
    "ux",
    "uy",
    "uz",
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "area_element",
    "mean_curvature",
    "gaussian_curvature",
    "k1",
    "k2",
    "shape_index",
    "curvedness",
];

/// Files of a model's maps.
pub(super) struct Maps {
    /// Path of the model's maps without extension: the output folder, then the model's name.
    stem: PathBuf,
    format: String,
    force: bool,
    double: bool,
}

impl Maps {
    /// Describes the files of a model's maps in a folder. `force` allows replacing existing files; `double` requests
    /// values of 64 bits.
    pub(super) fn new(folder: &Path, model: &Path, format: &str, (force, double): (bool, bool)) -> Self {
        let format = format.trim_start_matches('.').to_owned();
        Self { stem: folder.join(model_file_name(model)), format, force, double }
    }

    /// Returns the paths of the files to write.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        if self.format == "csv" {
            return vec![with_ending(&self.stem, "geometry.csv")];
        }
        MAPS.iter().map(|(name, _)| self.file(name)).collect()
    }

    fn file(&self, name: &str) -> PathBuf {
        with_ending(&self.stem, &format!("{name}.{}", self.format))
    }

    /// Returns whether the format is a mesh with values and colours, rather than values alone.
    pub(super) fn painted(&self) -> bool {
        ["ply", "glb", "vtk", "vtp"].iter().any(|ending| self.format.eq_ignore_ascii_case(ending))
    }

    /// Writes the maps from the geometry at the sphere's vertices.
    pub(super) fn write(&self, sphere: &Sphere, points: &[LocalGeometry]) -> Result<()> {
        let directions = sphere.directions.as_slice();
        if self.format == "csv" {
            let rows: Vec<Vec<String>> = directions.iter().zip(points).map(|(u, point)| cells(u, point)).collect();
            let text = csv(&COLUMNS, rows.iter().map(Vec::as_slice));
            return write_text(&with_ending(&self.stem, "geometry.csv"), self.force, &text);
        }
        let options = WriteOptions { overwrite: self.force, double: self.double };
        if self.painted() && sphere.faces.is_empty() {
            bail!("{}: the sphere has no triangles to colour; give --icosphere N", self.stem.display());
        }
        let positions = points.iter().map(|point| point.position).collect();
        let mesh = Mesh::new(positions, if self.painted() { sphere.faces.clone() } else { Vec::new() });
        for (name, value) in MAPS {
            let path = self.file(name);
            prepare(&path)?;
            let values: Vec<f64> = points.iter().map(value).collect();
            if self.painted() {
                let (low, high) = range(&values);
                let (name, painted) = (name.replace('-', "_"), colors(&values, low, high));
                let attributes = PlyAttributes { scalar: Some((&name, &values)), colors: Some(&painted) };
                write_painted(&path, &mesh, &attributes, &options)?;
            } else {
                write_signal(&path, &Signal::new(values, points.len(), 1), &options)?;
            }
        }
        Ok(())
    }
}

/// Returns the values shown in the first and the last colour: the 2nd and the 98th percentile, so that a few extreme
/// values don't compress all other values into a few colours.
fn range(values: &[f64]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let at = |part: f64| sorted.get((part * sorted.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(0.0);
    (at(0.02), at(0.98))
}

fn cells(u: &[f64; 3], point: &LocalGeometry) -> Vec<String> {
    let [k1, k2] = point.principal;
    let vectors = [*u, point.position, point.normal].into_iter().flatten();
    let (mean, gaussian) = (point.mean_curvature(), point.gaussian_curvature());
    let numbers = [point.area_element, mean, gaussian, k1, k2, point.shape_index(), point.curvedness()];
    vectors.chain(numbers).map(exact).collect()
}
