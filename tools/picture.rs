//! `picture`: surfaces side by side as a PNG.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, ValueEnum};
use spharm_cli::Common;
use spharm_cli::inputs::stem;
use spharm_cli::output::print;
use spharm_surface::Mesh;
use spharm_surface::io::{WriteOptions, read_mesh};
use spharm_surface::metrics::squared_distances;
use spharm_surface::render::{Paint, Panel, Settings, View, render, write_png};

/// Draw surfaces side by side, and the distance between the first and the last in colour
#[derive(Debug, Parser)]
#[command(name = "picture", version)]
struct Cli {
    /// Surfaces, in the order of the panels
    #[arg(required = true)]
    surfaces: Vec<PathBuf>,
    /// Text beneath each panel, in order [default: the files' names]
    #[arg(long, value_name = "TEXT")]
    caption: Vec<String>,
    /// One more panel: the last surface coloured by each vertex's distance from the first
    #[arg(long)]
    error: bool,
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

fn main() -> ExitCode {
    let cli = Cli::parse();
    spharm_cli::exit::run(|| work(&cli))
}

fn work(cli: &Cli) -> Result<()> {
    let meshes: Vec<Mesh> = cli.surfaces.iter().map(read_mesh).collect::<Result<_, _>>()?;
    let names: Vec<String> = cli.surfaces.iter().map(|path| stem(path)).collect();
    let caption = |at: usize| cli.caption.get(at).or(names.get(at)).map_or("", String::as_str);
    let mut panels: Vec<Panel<'_>> =
        meshes.iter().enumerate().map(|(at, mesh)| Panel::new(mesh, caption(at))).collect();
    let distances: Vec<f64>;
    if cli.error {
        let (first, last) = (&meshes[0], &meshes[meshes.len() - 1]);
        distances = squared_distances(&first.vertices, &last.vertices)?.iter().map(|square| square.sqrt()).collect();
        let largest = distances.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let paint = Paint::Scalar { values: &distances, range: (0.0, largest), label: "distance" };
        panels.push(Panel { paint, ..Panel::new(last, caption(meshes.len())) });
    }
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
