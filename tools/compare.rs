//! `compare`: how far apart two meshes of the same topology are, vertex by vertex.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::output::{print, print_json, table};
use spharm_surface::io::{PlyAttributes, WriteOptions, read_mesh, write_ply};
use spharm_surface::metrics::{colors, compare, squared_distances};

/// Compare a reconstruction with its surface: mean and maximal squared distance between corresponding vertices
///
/// msd and xsd are those after scaling both so that the original's bounding box has volume 1 (Shen and Chung 2006,
/// section 4.2); raw ones are in the input's own unit.
#[derive(Debug, Parser)]
#[command(name = "compare", version)]
struct Cli {
    /// The surface
    original: PathBuf,
    /// Its reconstruction: the same triangles over other positions
    reconstruction: PathBuf,
    /// Write the reconstruction as PLY with each vertex's distance, as a scalar and as a colour
    #[arg(short, long, value_name = "OUT.ply")]
    output: Option<PathBuf>,
    /// Distance, in the input's unit, that gets the last colour [default: the largest]
    #[arg(long, value_name = "DISTANCE")]
    range: Option<f64>,
    /// Print JSON in place of the table
    #[arg(long)]
    json: bool,
    /// Replace an output that exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Serialize)]
struct Report {
    vertices: usize,
    msd: f64,
    xsd: f64,
    msd_raw: f64,
    xsd_raw: f64,
    scale: f64,
    worst_vertex: usize,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    spharm_cli::exit::run(|| work(&cli))
}

fn work(cli: &Cli) -> Result<()> {
    let original = read_mesh(&cli.original)?;
    let reconstruction = read_mesh(&cli.reconstruction)?;
    let pair = || format!("{} and {}", cli.original.display(), cli.reconstruction.display());
    let found = compare(&original, &reconstruction).with_context(pair)?;
    if let Some(output) = &cli.output {
        let squares = squared_distances(&original.vertices, &reconstruction.vertices)?;
        let distances: Vec<f64> = squares.iter().map(|square| square.sqrt()).collect();
        let painted = colors(&distances, 0.0, cli.range.unwrap_or(found.xsd_raw.sqrt()));
        let attributes = PlyAttributes { scalar: Some(("distance", &distances)), colors: Some(&painted) };
        let options = WriteOptions { overwrite: cli.force, ..WriteOptions::default() };
        write_ply(output, &reconstruction, &attributes, &options)?;
    }
    let report = Report {
        vertices: original.vertices.len(),
        msd: found.msd,
        xsd: found.xsd,
        msd_raw: found.msd_raw,
        xsd_raw: found.xsd_raw,
        scale: found.scale,
        worst_vertex: found.worst_vertex,
    };
    if cli.json {
        return print_json(&report);
    }
    let row = |name: &str, scaled: f64, raw: f64| vec![name.to_owned(), format!("{scaled:.4e}"), format!("{raw:.4e}")];
    print(&table(&[
        ["", "box volume 1", "input's unit"].map(str::to_owned).to_vec(),
        row("mean squared distance (msd)", report.msd, report.msd_raw),
        row("maximal squared distance (xsd)", report.xsd, report.xsd_raw),
        row("root mean square", report.msd.sqrt(), report.msd_raw.sqrt()),
        row("maximum", report.xsd.sqrt(), report.xsd_raw.sqrt()),
    ]))
}
