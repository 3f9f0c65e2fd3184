//! `picture`: draws surfaces side by side, as PNG or SVG.

mod args;
mod maps;
mod surfaces;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cli::Usage;
use spharm_cli::memory::Budget;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print_line};
use spharm_harmonics::Directions;
use spharm_parametrize::quality::log_area_ratios;
use spharm_render::{
    Paint, Panel, Settings, color_of, fit_into, render, symmetric_range, with_bar, with_note, write_png, write_svg,
};
use spharm_surface::Mesh;
use spharm_surface::io::{WriteOptions, read_mesh};
use spharm_surface::metrics::{correspond, distances_to_surface, distances_to_surface_bytes, vertex_distances};

pub(crate) use self::args::Cli;
use self::args::Side;
use self::maps::{Coloured, Content, ContourMap, range_of};
use crate::surfaces::{Surface, meshes};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    check_outputs([OutputFile::with_ending(&cli.output, "--output", &[".png", ".svg"])], cli.force)?;
    if cli.range.is_some() && cli.map.is_empty() && cli.colour_by.is_none() {
        let problem = "--range can only be used with --map or --colour-by, to set the range of their colours";
        return Err(Usage::missing(problem).into());
    }
    let budget = cli.memory.budget(1);
    let content = Content::of(cli)?;
    let files = surfaces::files(&content.surfaces)?;
    let panels = files.len() + usize::from(cli.error) + usize::from(cli.sphere.is_some()) + content.maps.len();
    check_memory(cli, &[], panels, budget)?;
    let maps = content.maps.iter().chain(&content.contour).map(|map| &map.path);
    budget.check_inputs("picture", files.iter().chain(&cli.sphere).chain(maps).map(PathBuf::as_path))?;
    let by_column = cli.colour_by.as_ref();
    let console = cli.common.console();
    let numbers = by_column.map(|(table, column)| surfaces::numbers(table, column, &files, &console)).transpose()?;
    let numbers = numbers.unwrap_or_default();
    let read: Vec<Surface> = files.iter().map(|path| Surface::read(path)).collect::<Result<_>>()?;
    check_memory(cli, &read, panels, budget)?;
    let mut meshes = meshes(read)?;
    if cli.centre {
        surfaces::centre(&mut meshes);
    }
    if cli.fit_each {
        surfaces::fit_each(&mut meshes);
    }
    let names: Vec<String> = files.iter().map(|path| surfaces::name(path)).collect();
    let mut panels: Vec<Panel<'_>> = meshes.iter().zip(&names).map(|(mesh, name)| Panel::new(mesh, name)).collect();
    let colours = cli.range.unwrap_or_else(|| colours_of(&numbers));
    for (panel, number) in panels.iter_mut().zip(&numbers) {
        panel.paint = Paint::Plain(color_of(*number, colours));
    }
    let distances: Vec<f64>;
    if cli.error {
        let (first, last) = (&meshes[0], &meshes[meshes.len() - 1]);
        let label;
        (distances, label) = if correspond(first, last) {
            (vertex_distances(&first.vertices, &last.vertices)?, "distance")
        } else {
            let monitor = ConsoleMonitor::new(cli.common.console());
            (distances_to_surface(first, &last.vertices, &monitor)?, "distance from the surface")
        };
        let largest = distances.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let paint = Paint::Scalar { values: &distances, range: (0.0, largest), label };
        panels.push(Panel { paint, ..Panel::new(last, "") });
    }
    let (sphere, ratios);
    if let Some(path) = &cli.sphere {
        let unit = read_sphere(path, &meshes[0]).with_context(|| path.display().to_string())?;
        ratios = log_area_ratios(&meshes[0], &unit);
        sphere = fit_into(&unit, &meshes[0]);
        let paint = Paint::Scalar { values: &ratios, range: symmetric_range(&ratios), label: "log area ratio" };
        panels.insert(1, Panel { paint, ..Panel::new(&sphere, "sphere") });
    }
    let read = content.maps.into_iter().map(|map| map.read(&meshes[0], cli.range));
    let maps = read.collect::<Result<Vec<_>>>()?;
    for Coloured { values, range, label, caption } in &maps {
        let paint = Paint::Scalar { values, range: *range, label };
        panels.push(Panel { paint, ..Panel::new(&meshes[0], caption) });
    }
    let contour = content.contour.map(|map| ContourMap::read(map, content.level, &meshes[0], &console));
    let contour = contour.transpose()?;
    if let Some(contour) = &contour {
        let of_first = |panel: &&mut Panel<'_>| std::ptr::eq(panel.mesh, &raw const meshes[0]);
        panels.iter_mut().filter(of_first).for_each(|panel| panel.contour = contour.line());
    }
    panels.iter_mut().zip(&cli.caption).for_each(|(panel, caption)| panel.caption = caption);
    let captions: Vec<String> = match &cli.view[..] {
        [_] => Vec::new(),
        views => panels.iter().flat_map(|panel| views.iter().map(|view| caption(panel.caption, *view))).collect(),
    };
    if !captions.is_empty() {
        let views = panels.iter().flat_map(|panel| cli.view.iter().map(|side| (*panel, *side)));
        let mut rows: Vec<Panel<'_>> = views.map(|(panel, side)| Panel { view: Some(side.view()), ..panel }).collect();
        rows.iter_mut().zip(&captions).for_each(|(panel, caption)| panel.caption = caption);
        panels = rows;
    }
    let settings = settings(cli, panels.len(), cli.size);
    prepare(&cli.output)?;
    let picture = render(&panels, &settings)?;
    let picture = match by_column {
        Some((_, column)) => with_bar(picture, colours, column),
        None => picture,
    };
    let picture = match &contour {
        Some(contour) => with_note(picture, &contour.note()),
        None => picture,
    };
    let options = WriteOptions { overwrite: cli.force, double: false };
    if is_svg(&cli.output) {
        write_svg(&cli.output, &picture, &options)?;
    } else {
        write_png(&cli.output, &picture, &options)?;
    }
    print_line(&format!("{}: {}", cli.output.display(), counted(panels.len(), "panel")))
}

fn is_svg(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("svg"))
}

/// Returns the text beneath one panel of a surface that is shown from several sides.
fn caption(name: &str, view: Side) -> String {
    if name.is_empty() { view.axis().to_owned() } else { format!("{name}, {}", view.axis()) }
}

/// Largest number of panels that are in one row by default.
const ROW: usize = 6;

/// Returns the settings for a picture of `panels` panels, each `size` pixels wide and high.
fn settings(cli: &Cli, panels: usize, size: u16) -> Settings {
    let size = usize::from(size);
    let columns = match (cli.columns, cli.view.len()) {
        (None | Some(0), views) if views > 1 => views,
        (Some(columns), _) => columns,
        (None, _) if panels > ROW => panels.isqrt() + usize::from(panels.isqrt().pow(2) < panels),
        (None, _) => 0,
    };
    let view = cli.view.first().copied().unwrap_or(Side::Left).view();
    Settings {
        width: size,
        height: size,
        columns,
        view,
        keep_text: is_svg(&cli.output),
        dpi: cli.dpi,
        ..Settings::default()
    }
}

/// Refuses a picture that doesn't fit into memory. This is checked before and after the surfaces are read; `surfaces`
/// is empty before.
fn check_memory(cli: &Cli, surfaces: &[Surface], panels: usize, budget: Budget) -> Result<()> {
    let [vertices, faces] = surfaces.iter().map(Surface::counts).max().unwrap_or_default().map(|count| count as usize);
    let held = surfaces.iter().map(Surface::counts).map(|[vertices, faces]| 24 * vertices + 12 * faces).sum::<u64>();
    let evaluating = surfaces.iter().map(Surface::bytes_to_evaluate).max().unwrap_or_default();
    // Bytes for the sphere, once as read and once scaled, and for the values of each panel.
    let spheres = if cli.sphere.is_some() { 2 * (24 * vertices + 12 * faces) } else { 0 };
    let values = 8
        * vertices
        * (panels.saturating_sub(surfaces.len()) + 2 * usize::from(cli.contour.is_some() || cli.test.is_some()));
    let painting = match surfaces {
        [Surface::Mesh(first), .., Surface::Mesh(last)] if cli.error && correspond(first, last) => 0,
        [first, .., last] if cli.error => {
            distances_to_surface_bytes(first.counts()[1] as usize, last.counts()[0] as usize)
        }
        _ => 0,
    };
    let needed = |size: u16| {
        let drawing = settings(cli, panels, size).bytes(panels * cli.view.len(), vertices);
        held + (spheres + values) as u64 + drawing.max(painting).max(evaluating)
    };
    let smaller = [2048, 1024, 512, 256, 128, 64].into_iter().filter(|size| *size < cli.size);
    let smaller = smaller.map(|size| (format!("--size {size}"), needed(size)));
    let what = format!("picture --size {} of {}", cli.size, counted(panels, "panel"));
    budget.check_or(what, needed(cli.size), smaller)
}

/// Returns the range of the colours for `numbers`, which has one number per surface: the range of these numbers,
/// widened if all numbers are equal.
fn colours_of(numbers: &[f64]) -> (f64, f64) {
    match numbers.first() {
        Some(&one) if numbers.iter().all(|number| *number == one) => {
            let around = if one == 0.0 { 1.0 } else { 0.1 * one.abs() };
            (one - around, one + around)
        }
        _ => range_of(numbers),
    }
}

/// Reads the sphere of a surface and scales it to radius 1.
fn read_sphere(path: &Path, surface: &Mesh) -> Result<Mesh> {
    let sphere = read_mesh(path)?;
    if sphere.faces != surface.faces || sphere.vertices.len() != surface.vertices.len() {
        bail!("expected the sphere of the first surface, with the same triangles; found other triangles");
    }
    let unit = Directions::from_vertices(&sphere.vertices)?;
    Ok(sphere.with_vertices(unit.as_slice().to_vec()))
}
