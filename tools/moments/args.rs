//! Arguments of `moments`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use spharm::Directions;
use spharm::moments::{Columns, Positions, Shard};
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;

/// Formats of tables, for `--help`.
const TABLES: &str = "Tables: .npy and .npz (columns of plain arrays are numbered from 0), .csv, .tsv and .txt (with \
                      or without names in the first line), .parquet, .arrow, point clouds in .ply and .las; - reads \
                      .npy or text from standard input.";

/// Formats that are also read with --sphere or --icosphere, for `--help`.
const OVER_A_SPHERE: &str = "With --sphere or --icosphere, files of values at vertices are also accepted: GIfTI (.func.gii, .shape.gii), \
                             FreeSurfer curv files, and .mgh and .mgz maps. Each map in such a file is a column, numbered from 0.";

/// Compute the moments of samples for fits, in bounded memory and in parts that can be added
///
/// A fit needs only the moments of its samples. The size of the moments depends on the degree, not on the number of
/// samples. This verb reads tables of samples once, in chunks. From the moments, `spharm fit --moments` makes models of
/// any degree up to --max-degree. With --shard, parts of the data can be read separately. `spharm moments merge` adds
/// the moments of the parts.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_long_help = help::examples(
    &[
        "spharm moments --samples topography.npy --vectors 0 1 2 --values 3 --max-degree 1000 -o topography.moments",
        "spharm moments --sphere lh.sphere.surf.gii --samples lh.thickness.npy --values 0 --max-degree 80 -o thickness.moments",
        "spharm moments --samples scan-*.csv --lonlat lon lat --values height --max-degree 200 --shard 3/16 -o part3.moments",
        "spharm moments merge part*.moments -o all.moments",
        "spharm fit --moments all.moments --max-degree 150",
    ],
    &[TABLES, OVER_A_SPHERE],
))]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(super) command: Option<Command>,
    #[command(flatten)]
    pub(super) form: Form,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Add the moments of parts
    ///
    /// Parts must have the same degree and the same channels, and no samples in common. All shards of the same tables
    /// must be present. Parts over different spheres can be added, but their sum doesn't record a sphere.
    Merge(Merge),
}

#[derive(Debug, Args)]
pub(super) struct Merge {
    /// Parts, as `spharm moments` writes them
    #[arg(value_name = "PART.moments", required = true)]
    pub(super) parts: Vec<PathBuf>,
    /// Add the available parts even if shards are missing
    #[arg(long)]
    pub(super) partial: bool,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    #[command(flatten)]
    pub(super) memory: Memory,
}

/// Arguments of `moments` itself; required unless a subcommand is given.
#[derive(Debug, Args)]
pub(super) struct Form {
    /// Tables with one sample per row; - is standard input
    #[arg(long, value_name = "FILE", num_args = 1.., required = true, help_heading = INPUT)]
    pub(super) samples: Vec<PathBuf>,
    #[command(flatten)]
    pub(super) positions: PositionArgs,
    /// Columns of the values, one per channel
    ///
    /// With --vectors, the column `radius` is the length of the vectors.
    #[arg(long, value_name = "COLUMN", num_args = 1.., required = true, help_heading = INPUT)]
    values: Vec<String>,
    /// Column of the weights [default: all are 1]
    #[arg(long, value_name = "COLUMN", help_heading = INPUT)]
    weight: Option<String>,
    /// Part of each table to read: part I of N, with I counted from 0
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "0/1", help_heading = INPUT)]
    pub(super) shard: Shard,
    /// Highest degree of later fits, inclusive
    #[arg(short = 'L', long, alias = "degree", value_name = "L", required = true, help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
}

/// Arguments for the positions of the samples.
#[derive(Debug, Args)]
pub(super) struct PositionArgs {
    /// Columns of colatitude and azimuth, in radians
    #[arg(long, value_names = ["THETA", "PHI"], num_args = 2, group = "positions", help_heading = INPUT)]
    angles: Option<Vec<String>>,
    /// Columns of longitude and latitude, in degrees
    #[arg(long, value_names = ["LON", "LAT"], num_args = 2, group = "positions", help_heading = INPUT)]
    lonlat: Option<Vec<String>>,
    /// Columns of x, y and z [default: x y z, or lon lat, or theta phi, as available]
    ///
    /// The vectors must be unit vectors. With --values radius, they may have any length.
    #[arg(long, value_names = ["X", "Y", "Z"], num_args = 3, group = "positions", help_heading = INPUT)]
    vectors: Option<Vec<String>>,
    /// Sphere with the samples at its vertices, one row per vertex
    ///
    /// Each table has one row for each vertex, in the order of the vertices. The sphere is a mesh of any radius,
    /// centred at the origin, or a CSV of theta,phi in radians.
    #[arg(long, value_name = "SPHERE", group = "positions", help_heading = INPUT)]
    pub(super) sphere: Option<PathBuf>,
    /// Icosphere with the samples at its vertices, one row per vertex
    ///
    /// N subdivisions give 10 * 4^N + 2 vertices.
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(0..=12),
        group = "positions",
        help_heading = INPUT
    )]
    pub(super) icosphere: Option<u32>,
    /// Centre from which vectors start [default: 0 0 0]
    #[arg(
        long,
        value_names = ["X", "Y", "Z"],
        num_args = 3,
        allow_negative_numbers = true,
        conflicts_with_all = ["sphere", "icosphere"],
        help_heading = INPUT
    )]
    centre: Option<Vec<f64>>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = OUTPUT)]
pub(super) struct OutputArgs {
    /// File of moments to write
    #[arg(short, long, value_name = "OUT.moments", required = true)]
    pub(super) output: Option<PathBuf>,
    /// Write a report to a JSON file
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON instead of a line
    #[arg(long)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long)]
    pub(super) force: bool,
}

impl Form {
    /// Returns the requested columns. `vertices` are the directions of the sphere's vertices, if the samples are at
    /// these vertices.
    pub(super) fn columns(&self, vertices: Option<Directions>) -> Columns {
        let PositionArgs { angles, lonlat, vectors, centre, .. } = &self.positions;
        // clap has already checked the number of values of each option.
        let positions = match (angles.as_deref(), lonlat.as_deref(), vectors.as_deref()) {
            (Some([theta, phi]), ..) => Some(Positions::Angles([theta.clone(), phi.clone()])),
            (_, Some([lon, lat]), _) => Some(Positions::LonLat([lon.clone(), lat.clone()])),
            (.., Some([x, y, z])) => Some(Positions::Vectors([x.clone(), y.clone(), z.clone()])),
            _ => vertices.map(|vertices| Positions::Scheme(vertices.into())),
        };
        let centre = match centre.as_deref() {
            Some(&[x, y, z]) => [x, y, z],
            _ => [0.0; 3],
        };
        Columns { positions, values: self.values.clone(), weight: self.weight.clone(), centre }
    }
}

fn shard(text: &str) -> Result<Shard, String> {
    let parsed = text.split_once('/').and_then(|(index, of)| Some((index.parse().ok()?, of.parse().ok()?)));
    let shard = parsed.map(|(index, of)| Shard { index, of }).filter(|shard| shard.index < shard.of);
    shard.ok_or_else(|| "expected I/N with I from 0 to N - 1, such as 0/16".to_owned())
}
