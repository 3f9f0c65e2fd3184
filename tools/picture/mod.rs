//! `picture`: surfaces side by side as a PNG.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use spharm_cli::Common;
use spharm_cli::inputs::stem;
use spharm_cli::output::print;
use spharm_harmonics::Directions;
use spharm_parametrize::quality::log_area_ratios;
use spharm_surface::Mesh;
use spharm_surface::io::{WriteOptions, read_mesh};
use spharm_surface::metrics::squared_distances;
use spharm_surface::render::{Paint, Panel, Settings, View, render, write_png};

/// Draw surfaces side by side, and the distance between the first and the last in colour
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Surfaces, in the order of the panels
    #[arg(required = true)]
    surfaces: Vec<PathBuf>,
    /// Text beneath each panel, in order [default: the files' names]
    #[arg(long, value_name = "TEXT")]
    caption: Vec<String>,
    /// One more panel: the last surface coloured by each vertex's distance from the first
    #[arg(long)]
    error: bool,
    /// One more panel, after the first surface: its sphere, coloured by the log of how much area the map gives to each
    /// part of the surface
    #[arg(long, value_name = "SPHERE")]
    sphere: Option<PathBuf>,
    /// Where one looks from
    #[arg(long, value_enum, default_value_t = Side::Left)]
    view: Side,
    /// Panels in a row; 0 for all
    #[arg(long, value_name = "N", default_value_t = 0)]
    columns: usize,
    /// Width and height of a panel in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 480, value_parser = clap::value_parser!(u16).range(64..=4096))]
    size: u16,
    /// Picture to write
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Replace an output that exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Side {
    Left,
    Right,
    Front,
    Top,
    Corner,
}

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let meshes: Vec<Mesh> = cli.surfaces.iter().map(read_mesh).collect::<Result<_, _>>()?;
    let names: Vec<String> = cli.surfaces.iter().map(|path| stem(path)).collect();
    let mut panels: Vec<Panel<'_>> = meshes.iter().zip(&names).map(|(mesh, name)| Panel::new(mesh, name)).collect();
    let distances: Vec<f64>;
    if cli.error {
        let (first, last) = (&meshes[0], &meshes[meshes.len() - 1]);
        distances = squared_distances(&first.vertices, &last.vertices)?.iter().map(|square| square.sqrt()).collect();
        let largest = distances.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let paint = Paint::Scalar { values: &distances, range: (0.0, largest), label: "distance" };
        panels.push(Panel { paint, ..Panel::new(last, "") });
    }
    let (sphere, ratios);
    if let Some(path) = &cli.sphere {
        let unit = read_sphere(path, &meshes[0]).with_context(|| path.display().to_string())?;
        ratios = log_area_ratios(&meshes[0], &unit);
        sphere = fitted_into(&unit, &meshes[0]);
        let most = nearly_largest(&ratios);
        let paint = Paint::Scalar { values: &ratios, range: (-most, most), label: "log area ratio" };
        panels.insert(1, Panel { paint, ..Panel::new(&sphere, "sphere") });
    }
    panels.iter_mut().zip(&cli.caption).for_each(|(panel, caption)| panel.caption = caption);
    let view = match cli.view {
        Side::Left => View::LEFT,
        Side::Right => View::RIGHT,
        Side::Front => View::FRONT,
        Side::Top => View::TOP,
        Side::Corner => View::CORNER,
    };
    let size = usize::from(cli.size);
    let settings = Settings { width: size, height: size, columns: cli.columns, view, ..Settings::default() };
    write_png(&cli.output, &render(&panels, &settings)?, &WriteOptions { overwrite: cli.force, double: false })?;
    print(&format!("{}: {} panels", cli.output.display(), panels.len()))
}

/// The sphere of a surface, with radius 1.
fn read_sphere(path: &Path, surface: &Mesh) -> Result<Mesh> {
    let sphere = read_mesh(path)?;
    if sphere.faces != surface.faces || sphere.vertices.len() != surface.vertices.len() {
        bail!("expected the sphere of the first surface, with its triangles; found other triangles");
    }
    let unit = Directions::from_vertices(&sphere.vertices)?;
    Ok(sphere.with_vertices(unit.as_slice().to_vec()))
}

/// A mesh as large as another and in its place: all panels have one scale.
fn fitted_into(mesh: &Mesh, other: &Mesh) -> Mesh {
    let span = |mesh: &Mesh, axis: usize| {
        let values = mesh.vertices.iter().map(|p| p[axis]);
        values.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)))
    };
    let (from, to) = ([0, 1, 2].map(|axis| span(mesh, axis)), [0, 1, 2].map(|axis| span(other, axis)));
    let widest = |spans: [(f64, f64); 3]| spans.iter().map(|(low, high)| high - low).fold(f64::MIN_POSITIVE, f64::max);
    let factor = widest(to) / widest(from);
    let middle = |(low, high): (f64, f64)| 0.5 * (low + high);
    let place = |p: &[f64; 3]| [0, 1, 2].map(|k| middle(to[k]) + factor * (p[k] - middle(from[k])));
    mesh.with_vertices(mesh.vertices.iter().map(place).collect())
}

/// The size that all but a hundredth stay below: the few beyond would leave no colours to the rest.
fn nearly_largest(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    sizes[(sizes.len() - 1) * 99 / 100].max(f64::MIN_POSITIVE)
}
