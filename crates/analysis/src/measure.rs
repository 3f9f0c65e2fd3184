//! `shape measure`: measures area and volume, and writes maps of curvature.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Value, json};
use spharm::shape::memory::{local_geometry_bytes, measure_bytes};
use spharm::shape::{MeasureParams, Measures, local_geometry, measure};
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::OutputFile;
use spharm_cli::paths::{all_shown, distinct_names, shown};
use spharm_model::Model;
use spharm_monitor::number;
use spharm_surface::io::{Output, PAINTED};

use super::args::{Models, ReportArgs, Resources, Sampling, sphere_of, to_degree};
use super::maps::Maps;
use super::outputs::{TABLES, check, exact, finish, table_for, write_text};
use super::plan::Plan;
use spharm_cli::models::cut_handles;

/// Measure models: area, volume, centroid and maps of curvature
///
/// All measures are computed from the coefficients: volume and centroid are exact up to rounding, and the area is
/// accurate to --tolerance. --maps writes mean and Gaussian curvature, shape index, curvedness and area element at the
/// vertices of a sphere. Curvatures are positive on a sphere.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape measure models -o measures.csv",
        "spharm shape measure bunny.spharm.npz --maps maps",
        "spharm shape measure @group.txt --maps maps --icosphere 5 --format csv",
    ],
    &[
        "The maps are the files NAME.mean-curvature.shape.gii, NAME.gaussian-curvature..., NAME.shape-index..., \
         NAME.curvedness... and NAME.area-element... With --format csv, one table, NAME.geometry.csv, has all maps, \
         and also directions, positions and normals. With --format glb, ply, vtk or vtp, each file is the surface with \
         the map's values, and with colours that range from the 2nd to the 98th percentile.",
        help::SIGNALS,
    ],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Highest degree to use [default: the model's degree]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Relative change of the area at which the refinement of the grid stops
    #[arg(long, value_name = "T", default_value_t = 1e-7, help_heading = METHOD)]
    tolerance: f64,
    #[command(flatten)]
    sampling: Sampling,
    /// File for the table of measures
    #[arg(short, long, value_name = "OUT.csv|tsv", help_heading = OUTPUT)]
    output: Option<PathBuf>,
    /// Name models in the table by file name, such as a01, instead of by path
    #[arg(long, help_heading = OUTPUT)]
    names: bool,
    /// Folder for the maps
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    maps: Option<PathBuf>,
    /// Format of the maps
    #[arg(long, value_name = "ENDING", default_value = "shape.gii", requires = "maps", help_heading = OUTPUT)]
    format: String,
    /// Write 64-bit values if the maps' format supports them
    #[arg(long, requires = "maps", help_heading = OUTPUT)]
    double: bool,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

/// Maximum size in bytes of the text for a vertex in a table of maps.
const TABLE: u64 = 600;

/// Columns of the table.
pub(super) const COLUMNS: [&str; 10] = [
    "model",
    "degree",
    "area",
    "volume",
    "sphericity",
    "centroid_x",
    "centroid_y",
    "centroid_z",
    "area_change",
    "squeezed",
];

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let paths = cli.models.paths()?;
    let names = if cli.names { Some(distinct_names(&paths, "--names")?) } else { None };
    let maps: Option<Vec<Maps>> = cli.maps.as_deref().map(|folder| {
        let options = (cli.report.force, cli.double);
        paths.iter().map(|path| Maps::new(folder, path, &cli.format, options)).collect()
    });
    let files: Vec<PathBuf> = maps.iter().flatten().flat_map(Maps::files).collect();
    let table = cli.output.iter().map(|path| OutputFile::with_ending(path, "--output", &TABLES));
    let painted = maps.iter().flatten().any(Maps::painted);
    let holds = if painted { Output::Ending(PAINTED) } else { Output::Signal };
    let of_maps = files.iter().map(|path| OutputFile::holding(path, "--maps", holds));
    check(table.chain(of_maps), &cli.report)?;
    let console = monitor.console();
    let plan = Plan::new("measure", &paths, cli.resources.both())?;
    let degree = plan.group.max_degree;
    // Memory for the maps in either form: as files that are written one after another, or as one table.
    let needed = |[vertices, faces]: [u64; 2]| {
        let maps = local_geometry_bytes(vertices, degree).saturating_add(TABLE * vertices + 24 * (vertices + faces));
        plan.one().saturating_add(measure_bytes(degree).max(if cli.maps.is_some() { maps } else { 0 }))
    };
    let shared = cli.sampling.within(&plan, needed, console)?;
    let params = MeasureParams { tolerance: cli.tolerance, most_rings: None };
    let pool = cli.resources.threads.pool()?;
    let mut reports = Vec::new();
    let mut rows = vec![["model", "degree", "area", "volume", "sphericity"].map(str::to_owned).to_vec()];
    let mut cells = Vec::new();
    for (number, path) in paths.iter().enumerate() {
        let started = Instant::now();
        let named = || path.display().to_string();
        let model = Model::read(path)?;
        let coefficients = to_degree(&model, path, cli.max_degree)?;
        let found = pool.install(|| measure(&coefficients, &params, monitor)).with_context(named)?;
        let mut warnings: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
        warnings.extend(cut_handles(&model).map(str::to_owned));
        let mut singular = None;
        if let Some(maps) = maps.as_ref().and_then(|maps| maps.get(number)) {
            let sphere = sphere_of(shared.as_ref(), &model, path)?;
            let geometry = || local_geometry(&coefficients, &sphere.directions, monitor);
            let mut points = pool.install(geometry).with_context(named)?;
            if found.inwards {
                points.iter_mut().for_each(|point| *point = point.flipped());
            }
            let count = points.iter().filter(|point| point.is_singular()).count();
            if count > 0 {
                warnings
                    .push(format!("{count} vertices have no tangent plane; curvatures at these vertices are set to 0"));
            }
            singular = Some(count);
            maps.write(sphere, &points)?;
        }
        for warning in &warnings {
            console.warn(format!("{}: {warning}", path.display()));
        }
        let degree = coefficients.max_degree();
        let key = names.as_ref().map_or_else(named, |names| names[number].clone());
        rows.push(row(&key, degree, &found));
        cells.push(cells_of(key, degree, &found));
        let mut report = of(&found);
        report["model"] = json!(shown(path));
        report["degree"] = json!(degree);
        report["singular_vertices"] = json!(singular);
        report["maps"] = json!(maps.as_ref().and_then(|maps| maps.get(number)).map(|maps| all_shown(maps.files())));
        report["warnings"] = json!(warnings);
        report["seconds"] = json!(started.elapsed().as_secs_f64());
        reports.push(report);
    }
    if let Some(path) = &cli.output {
        write_text(path, cli.report.force, &table_for(Some(path), &COLUMNS, cells.iter().map(Vec::as_slice)))?;
    }
    finish("measure", &json!({ "tolerance": cli.tolerance, "models": reports }), &rows, &cli.report)
}

fn row(name: &str, degree: usize, found: &Measures) -> Vec<String> {
    let numbers = [found.area, found.volume, found.sphericity].map(number);
    [name.to_owned(), degree.to_string()].into_iter().chain(numbers).collect()
}

/// Returns the row of a model, in the order of [`COLUMNS`].
fn cells_of(name: String, degree: usize, found: &Measures) -> Vec<String> {
    let Measures { area, volume, sphericity, centroid: [x, y, z], area_change, squeezed, .. } = *found;
    let numbers = [area, volume, sphericity, x, y, z, area_change, squeezed].map(exact);
    [name, degree.to_string()].into_iter().chain(numbers).collect()
}

fn of(found: &Measures) -> Value {
    json!({
        "area": found.area,
        "area_change": found.area_change,
        "rings": found.rings,
        "volume": found.volume,
        "centroid": found.centroid,
        "sphericity": found.sphericity,
        "inwards": found.inwards,
        "squeezed": found.squeezed,
    })
}
