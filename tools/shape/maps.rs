//! Maps of a surface's geometry: one file of values on vertices for each quantity, or a table of all of them.

use std::path::{Path, PathBuf};

use anyhow::Result;
use spharm::shape::LocalGeometry;
use spharm_cli::output::prepare;
use spharm_cli::paths::{model_name, with_ending};
use spharm_surface::Signal;
use spharm_surface::io::{WriteOptions, write_signal};

use super::outputs::{csv, number, write_text};

/// A quantity and how it is found.
type Map = (&'static str, fn(&LocalGeometry) -> f64);

const MAPS: [Map; 5] = [
    ("mean-curvature", LocalGeometry::mean_curvature),
    ("gaussian-curvature", LocalGeometry::gaussian_curvature),
    ("shape-index", LocalGeometry::shape_index),
    ("curvedness", LocalGeometry::curvedness),
    ("area-element", |point| point.area_element),
];

/// The columns of a table.
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

/// The files of a model's maps.
pub(super) struct Maps {
    /// Folder and name of the model.
    stem: PathBuf,
    format: String,
    force: bool,
    double: bool,
}

impl Maps {
    /// The maps of a model in a folder; `options` are whether files are replaced, and whether values have 64 bits.
    pub(super) fn new(folder: &Path, model: &Path, format: &str, (force, double): (bool, bool)) -> Self {
        let format = format.trim_start_matches('.').to_owned();
        Self { stem: folder.join(model_name(model)), format, force, double }
    }

    /// The files that are written.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        if self.format == "csv" {
            return vec![with_ending(&self.stem, "geometry.csv")];
        }
        MAPS.iter().map(|(name, _)| self.file(name)).collect()
    }

    fn file(&self, name: &str) -> PathBuf {
        with_ending(&self.stem, &format!("{name}.{}", self.format))
    }

    /// Writes the maps of the points at directions.
    pub(super) fn write(&self, directions: &[[f64; 3]], points: &[LocalGeometry]) -> Result<()> {
        if self.format == "csv" {
            let rows: Vec<Vec<String>> = directions.iter().zip(points).map(|(u, point)| cells(u, point)).collect();
            let text = csv(&COLUMNS, rows.iter().map(Vec::as_slice));
            return write_text(&with_ending(&self.stem, "geometry.csv"), self.force, &text);
        }
        let options = WriteOptions { overwrite: self.force, double: self.double };
        for (name, value) in MAPS {
            let path = self.file(name);
            prepare(&path)?;
            let values: Vec<f64> = points.iter().map(value).collect();
            write_signal(&path, &Signal::new(values, points.len(), 1), &options)?;
        }
        Ok(())
    }
}

fn cells(u: &[f64; 3], point: &LocalGeometry) -> Vec<String> {
    let [k1, k2] = point.principal;
    let vectors = [*u, point.position, point.normal].into_iter().flatten();
    let (mean, gaussian) = (point.mean_curvature(), point.gaussian_curvature());
    let numbers = [point.area_element, mean, gaussian, k1, k2, point.shape_index(), point.curvedness()];
    vectors.chain(numbers).map(number).collect()
}
