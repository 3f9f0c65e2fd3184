//! `picture`: surfaces side by side as a PNG.

mod args;

use std::path::Path;

use anyhow::{Context, Result, bail};
use spharm_cli::inputs::stem;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print};
use spharm_harmonics::Directions;
use spharm_parametrize::quality::log_area_ratios;
use spharm_render::{Paint, Panel, Settings, render, write_png};
use spharm_surface::Mesh;
use spharm_surface::io::{WriteOptions, read_mesh};
use spharm_surface::metrics::{correspond, distances_to_surface, vertex_distances};

pub(crate) use self::args::Cli;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    check_outputs([OutputFile::with_ending(&cli.output, "--output", &[".png"])], cli.force)?;
    let meshes: Vec<Mesh> = cli.surfaces.iter().map(read_mesh).collect::<Result<_, _>>()?;
    let names: Vec<String> = cli.surfaces.iter().map(|path| stem(path)).collect();
    let mut panels: Vec<Panel<'_>> = meshes.iter().zip(&names).map(|(mesh, name)| Panel::new(mesh, name)).collect();
    let distances: Vec<f64>;
    if cli.error {
        let (first, last) = (&meshes[0], &meshes[meshes.len() - 1]);
        let label;
        (distances, label) = if correspond(first, last) {
            (vertex_distances(&first.vertices, &last.vertices)?, "distance")
        } else {
            (distances_to_surface(first, &last.vertices)?, "distance from the surface")
        };
        let largest = distances.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let paint = Paint::Scalar { values: &distances, range: (0.0, largest), label };
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
    let size = usize::from(cli.size);
    let view = cli.view.view();
    let settings = Settings { width: size, height: size, columns: cli.columns, view, ..Settings::default() };
    prepare(&cli.output)?;
    write_png(&cli.output, &render(&panels, &settings)?, &WriteOptions { overwrite: cli.force, double: false })?;
    print(&format!("{}: {}", cli.output.display(), counted(panels.len(), "panel")))
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
