//! `compare`: how far apart two meshes are: vertex by vertex where they share their triangles, and as surfaces.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::output::{print, print_json, table};
use spharm_cli::threads::Threads;
use spharm_surface::Mesh;
use spharm_surface::io::{PlyAttributes, WriteOptions, read_mesh, write_ply};
use spharm_surface::metrics::{
    Directed, Distances, SurfaceDistance, SurfaceDistanceParams, colors, compare, squared_distances, surface_distance,
};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::topology::different_triangles;

/// Compare a reconstruction with its surface: mean and maximal squared distance between corresponding vertices
///
/// msd and xsd are those after scaling both so that the original's bounding box has volume 1 (Shen and Chung 2006,
/// section 4.2); raw ones are in the input's own unit. With --surface-distance also, or for meshes of different
/// triangles only, how far the surfaces are from each other between the vertices.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// The surface
    original: PathBuf,
    /// Its reconstruction: the same triangles over other positions, or with --surface-distance any surface
    reconstruction: PathBuf,
    /// The distance of the surfaces, from points all over both: mean, root mean square, 95th percentile, Hausdorff
    #[arg(long)]
    surface_distance: bool,
    /// With --surface-distance: about how many points on each surface, beside its vertices
    #[arg(long, value_name = "COUNT", default_value_t = SurfaceDistanceParams::default().samples)]
    samples: usize,
    /// Write the reconstruction as PLY with each vertex's distance, as a scalar and as a colour: the distance to the
    /// corresponding vertex, with --surface-distance to the surface
    #[arg(short, long, value_name = "OUT.ply")]
    output: Option<PathBuf>,
    /// Distance, in the input's unit, that gets the last colour [default: the largest]
    #[arg(long, value_name = "DISTANCE")]
    range: Option<f64>,
    #[command(flatten)]
    threads: Threads,
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
    /// Where the meshes share their triangles.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    vertexwise: Option<Vertexwise>,
    scale: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    surface_distance: Option<Surfaces>,
}

#[derive(Debug, Serialize)]
struct Vertexwise {
    msd: f64,
    xsd: f64,
    msd_raw: f64,
    xsd_raw: f64,
    worst_vertex: usize,
}

/// In the input's unit.
#[derive(Debug, Serialize)]
struct Surfaces {
    mean: f64,
    rms: f64,
    percentile95: f64,
    hausdorff: f64,
    /// By how much the Hausdorff distance may be more than was found between the points.
    bound: f64,
    forward: OneWay,
    backward: OneWay,
}

#[derive(Debug, Serialize)]
struct OneWay {
    mean: f64,
    rms: f64,
    percentile95: f64,
    max: f64,
    worst: [f64; 3],
    samples: usize,
}

impl From<Distances> for Vertexwise {
    fn from(d: Distances) -> Self {
        Self { msd: d.msd, xsd: d.xsd, msd_raw: d.msd_raw, xsd_raw: d.xsd_raw, worst_vertex: d.worst_vertex }
    }
}

impl From<SurfaceDistance> for Surfaces {
    fn from(d: SurfaceDistance) -> Self {
        let SurfaceDistance { mean, rms, percentile95, hausdorff, bound, .. } = d;
        Self { mean, rms, percentile95, hausdorff, bound, forward: d.forward.into(), backward: d.backward.into() }
    }
}

impl From<Directed> for OneWay {
    fn from(d: Directed) -> Self {
        let Directed { mean, rms, percentile95, max, worst, samples, .. } = d;
        Self { mean, rms, percentile95, max, worst, samples }
    }
}

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    cli.threads.pool()?.install(|| work(cli))
}

fn work(cli: &Cli) -> Result<()> {
    let original = read_mesh(&cli.original)?;
    let reconstruction = read_mesh(&cli.reconstruction)?;
    let pair = || format!("{} and {}", cli.original.display(), cli.reconstruction.display());
    let surfaces = if cli.surface_distance {
        let params = SurfaceDistanceParams { samples: cli.samples };
        Some(surface_distance(&original, &reconstruction, &params).with_context(pair)?)
    } else {
        None
    };
    // Without --surface-distance it is an error that the meshes don't correspond, which `compare` tells.
    let vertexwise = if surfaces.is_none() || correspond(&original, &reconstruction) {
        Some(compare(&original, &reconstruction).with_context(pair)?)
    } else {
        None
    };
    if let Some(output) = &cli.output {
        let distances = distances(&original, &reconstruction, surfaces.is_some())?;
        let largest = distances.iter().copied().fold(0.0, f64::max);
        let painted = colors(&distances, 0.0, cli.range.unwrap_or(largest));
        let attributes = PlyAttributes { scalar: Some(("distance", &distances)), colors: Some(&painted) };
        let options = WriteOptions { overwrite: cli.force, ..WriteOptions::default() };
        write_ply(output, &reconstruction, &attributes, &options)?;
    }
    let scale = vertexwise.map(|d| d.scale).or(surfaces.map(|d| d.scale)).unwrap_or(f64::NAN);
    let report = Report {
        vertices: original.vertices.len(),
        vertexwise: vertexwise.map(Vertexwise::from),
        scale,
        surface_distance: surfaces.map(Surfaces::from),
    };
    if cli.json { print_json(&report) } else { print(&table(&rows(&report))) }
}

fn correspond(a: &Mesh, b: &Mesh) -> bool {
    a.vertices.len() == b.vertices.len() && different_triangles(&a.faces, &b.faces) == 0
}

/// For each vertex of the reconstruction: how far from the surface, or from the vertex that corresponds.
fn distances(original: &Mesh, reconstruction: &Mesh, to_surface: bool) -> Result<Vec<f64>> {
    if to_surface {
        let tree = TriangleTree::new(original);
        let to = |&v| tree.nearest(v).map(|found| found.distance).context("a vertex that is near to nothing");
        return reconstruction.vertices.iter().map(to).collect();
    }
    let squares = squared_distances(&original.vertices, &reconstruction.vertices)?;
    Ok(squares.iter().map(|square| square.sqrt()).collect())
}

fn rows(report: &Report) -> Vec<Vec<String>> {
    let row = |name: &str, scaled: f64, raw: f64| vec![name.to_owned(), format!("{scaled:.4e}"), format!("{raw:.4e}")];
    let mut rows = vec![["", "box volume 1", "input's unit"].map(str::to_owned).to_vec()];
    if let Some(d) = &report.vertexwise {
        rows.extend([
            row("mean squared distance (msd)", d.msd, d.msd_raw),
            row("maximal squared distance (xsd)", d.xsd, d.xsd_raw),
            row("root mean square", d.msd.sqrt(), d.msd_raw.sqrt()),
            row("maximum", d.xsd.sqrt(), d.xsd_raw.sqrt()),
        ]);
    }
    if let Some(d) = &report.surface_distance {
        let row = |name: &str, raw: f64| row(name, raw / report.scale, raw);
        rows.extend([
            row("between surfaces: mean", d.mean),
            row("between surfaces: root mean square", d.rms),
            row("between surfaces: 95th percentile", d.percentile95),
            row("between surfaces: Hausdorff", d.hausdorff),
            row("Hausdorff may be more by at most", d.bound),
        ]);
    }
    rows
}
