//! Draws a small picture of each subject's surface in the pose of the group, coloured by the distance from its model.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rayon::prelude::*;
use spharm::shape::outliers::median;
use spharm::{Model, Monitor, Stage};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, prepare};
use spharm_cli::paths::model_file_name;
use spharm_cohort::check::Measure;
use spharm_cohort::equal::first_of;
use spharm_monitor::OnlyCancel;
use spharm_render::{Paint, Panel, Settings, View, render, write_thumbnail};
use spharm_surface::Mesh;
use spharm_surface::geometry::bounds;
use spharm_surface::io::{WriteOptions, read_mesh};
use spharm_surface::metrics::{distances_to_surface, distances_to_surface_bytes};

use super::evaluated::{moved, surface_of};
use super::gather::{Found, Inputs};
use spharm_cli::models::surface_file;

/// Width and height of a picture in pixels.
const SIZE: [usize; 2] = [160, 120];
/// Distance that is drawn in red, as a multiple of the median residual. In a good fit, few residuals are larger.
const RED: f64 = 4.0;
/// Distance that is drawn in red if residuals are unknown, as a fraction of the median size of the surfaces.
const RED_BY_EXTENT: f64 = 0.02;
/// Factor by which the box shown in all pictures exceeds the median bounding box of the surfaces.
const ROOM: f64 = 1.3;
/// Maximum number of subjects named in a warning.
const NAMED: usize = 6;
/// Colours of the distance 0, of half the distance shown in red, and of the distance shown in red.
const COLOURS: [[f64; 3]; 3] = [[222.0, 208.0, 196.0], [240.0, 150.0, 60.0], [190.0, 20.0, 30.0]];

/// Facts about the pictures that were drawn.
pub(super) struct Drawing {
    /// Distance at which the colours reach red, in the surfaces' unit.
    pub(super) red_at: f64,
    /// Scale of each picture: 1, or less for a surface that is larger than the box common to all pictures.
    pub(super) scales: Vec<f64>,
    pub(super) warnings: Vec<String>,
}

/// Returns the path of each subject's picture.
pub(super) fn paths(folder: &Path, models: &[PathBuf]) -> Vec<PathBuf> {
    let one = |model: &PathBuf| {
        let mut name = model_file_name(model);
        name.push(".png");
        folder.join(name)
    };
    models.iter().map(one).collect()
}

/// Returns the memory, in bytes, for drawing the largest surface, without the memory for its model. The memory holds
/// the surface's file, its mesh, a copy of the mesh in the common pose, and the search tree of the model's surface.
pub(super) fn bytes(found: &[Found]) -> u64 {
    let file = found.iter().map(|found| found.surface_bytes).max().unwrap_or(0);
    // A vertex takes at least 12 bytes of the file, and a mesh has twice as many triangles as vertices.
    let vertices = usize::try_from(file / 12).unwrap_or(usize::MAX);
    let pictures = Settings { width: SIZE[0], height: SIZE[1], ..Settings::default() }.bytes(1, vertices);
    file.saturating_mul(3).saturating_add(distances_to_surface_bytes(vertices.saturating_mul(2), vertices)) + pictures
}

/// Draws a picture of each subject's surface.
pub(super) fn draw(
    inputs: &Inputs,
    found: &[Found],
    pictures: &[PathBuf],
    force: bool,
    monitor: &ConsoleMonitor,
) -> Result<Drawing> {
    let frame = common_box(found);
    let residuals: Vec<f64> = found.iter().filter_map(|found| found.facts.measure(Measure::Rms)).collect();
    let red_at = match median(&residuals) {
        residual if residual > 0.0 => RED * residual,
        _ => RED_BY_EXTENT * median(&found.iter().map(|found| found.facts.size.unwrap_or(1.0)).collect::<Vec<_>>()),
    };
    let settings = Settings { width: SIZE[0], height: SIZE[1], view: along_shortest(frame), ..Settings::default() };
    if let Some(first) = pictures.first() {
        prepare(first)?;
    }
    monitor.begin(Stage::counted("pictures", "subjects"), pictures.len() as u64);
    let options = WriteOptions { overwrite: force, ..WriteOptions::default() };
    let drawn = pictures.par_iter().enumerate().map(|(index, picture)| -> Result<(f64, Option<String>)> {
        monitor.check()?;
        let path = &inputs.models[index];
        let (mesh, colours, missing) = coloured(path, red_at, monitor).with_context(|| path.display().to_string())?;
        let mesh = moved(&mesh, &inputs.pose(index));
        let (own_frame, scale) = around(&mesh, frame);
        let panel = Panel { paint: Paint::Vertices(&colours), ..Panel::new(&mesh, "") };
        let image = render(&[panel], &Settings { frame: Some(own_frame), ..settings })?;
        write_thumbnail(picture, &image, &options)?;
        monitor.step(1);
        Ok((scale, missing))
    });
    let drawn = drawn.collect::<Result<Vec<_>>>();
    monitor.end();
    let (scales, missing): (Vec<f64>, Vec<Option<String>>) = drawn?.into_iter().unzip();
    Ok(Drawing { red_at, scales, warnings: without_surface(&inputs.names, &missing).into_iter().collect() })
}

/// Returns a subject's surface and the colour of each vertex. If the surface is missing, returns the model's surface
/// and the reason.
fn coloured(path: &Path, red_at: f64, monitor: &ConsoleMonitor) -> Result<(Mesh, Vec<[u8; 3]>, Option<String>)> {
    let model = Model::read(path)?;
    let modelled = surface_of(&model)?;
    match surface_file(&model, path).and_then(|file| read_mesh(&file).map_err(|error| error.to_string())) {
        Ok(surface) => {
            let distances = distances_to_surface(&modelled, &surface.vertices, &OnlyCancel(monitor))?;
            Ok((surface, distances.iter().map(|distance| colour(distance / red_at)).collect(), None))
        }
        Err(why) => {
            let colours = vec![colour(0.0); modelled.vertices.len()];
            let input = model.provenance.input.map_or_else(String::new, |input| format!("{}: ", input.path));
            Ok((modelled, colours, Some(format!("{input}{why}"))))
        }
    }
}

/// Returns a warning about the subjects whose surfaces are missing.
fn without_surface(names: &[String], missing: &[Option<String>]) -> Option<String> {
    let named = names.iter().zip(missing).filter_map(|(name, why)| Some((name.as_str(), why.as_ref()?)));
    let (names, reasons): (Vec<&str>, Vec<&String>) = named.unzip();
    let first = reasons.first()?;
    let (count, names) = (counted(names.len(), "subject"), first_of(names, NAMED));
    Some(format!(
        "the pictures of {count} ({names}) show the model, because the surface is missing; the reason for the first \
         subject is: {first}"
    ))
}

/// Returns the median bounding box of the subjects, enlarged to leave room for larger surfaces.
fn common_box(found: &[Found]) -> [[f64; 3]; 2] {
    let middle =
        |of: &dyn Fn(&[[f64; 3]; 2]) -> f64| median(&found.iter().map(|found| of(&found.extent)).collect::<Vec<_>>());
    let centre: [f64; 3] = std::array::from_fn(|axis| middle(&|[low, high]| 0.5 * (low[axis] + high[axis])));
    let half: [f64; 3] = std::array::from_fn(|axis| 0.5 * ROOM * middle(&|[low, high]| high[axis] - low[axis]));
    [-1.0, 1.0].map(|side| std::array::from_fn(|axis| centre[axis] + side * half[axis]))
}

/// Returns the common box moved to a surface's centre, and enlarged if the surface is larger than the box. Also
/// returns the scale at which the surface is drawn.
fn around(mesh: &Mesh, [low, high]: [[f64; 3]; 2]) -> ([[f64; 3]; 2], f64) {
    let (own_low, own_high) = bounds(mesh.vertices.iter().copied());
    let grown = (0..3).map(|axis| (own_high[axis] - own_low[axis]) / (high[axis] - low[axis])).fold(1.0, f64::max);
    let frame = [-1.0, 1.0].map(|side| {
        let at = |axis| 0.5 * (own_low[axis] + own_high[axis]) + 0.5 * side * grown * (high[axis] - low[axis]);
        std::array::from_fn(at)
    });
    (frame, 1.0 / grown)
}

/// Returns the view along the axis in which the subjects are thinnest, with the longest axis to the right.
fn along_shortest([low, high]: [[f64; 3]; 2]) -> View {
    let mut axes = [0, 1, 2];
    axes.sort_by(|a, b| (high[*a] - low[*a]).total_cmp(&(high[*b] - low[*b])));
    let unit = |axis: usize| std::array::from_fn(|other| if other == axis { 1.0 } else { 0.0 });
    View::new(unit(axes[0]), unit(axes[1]))
}

/// Returns the colour of a distance: grey for 0, red for 1 and more. `distance` is a fraction of the distance shown in
/// red.
fn colour(distance: f64) -> [u8; 3] {
    let at = 2.0 * distance.clamp(0.0, 1.0);
    let (first, rest) = if at < 1.0 { (0, at) } else { (1, at - 1.0) };
    std::array::from_fn(|k| (COLOURS[first][k] + rest * (COLOURS[first + 1][k] - COLOURS[first][k])).round() as u8)
}
