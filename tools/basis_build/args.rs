//! Arguments of `basis-build`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT, RESOURCES, SOLVER};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_cli::values::Dtype;
use spharm_store::Codec;
use spharm_store::basis::DEFAULT_CHUNK_ROWS;

/// Compute the basis of a sampling scheme once, and keep it in a store for all fits over this scheme
///
/// Writes one immutable file per degree into the store. Existing files are kept. Therefore, the same command resumes an
/// interrupted build, and a higher --max-degree extends a finished build. Many degrees are written at once, so a build
/// that is interrupted early has no finished files. In existing files, only the header and the table of chunks are
/// checked. `spharm store verify` checks every byte. Several builds may run at once.
///
/// With --factor, the Cholesky factor of the normal equations to degree L is also computed, and stored next to the
/// basis. With this factor, a full least-squares fit over the scheme needs only two triangular solves. The factor takes
/// 4 (L + 1)^4 bytes of disk in f64, whatever the number of vertices. An interrupted computation of the factor starts
/// again from the beginning.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm basis-build --sphere lh.sphere.surf.gii --max-degree 100 --store basis",
        "spharm basis-build --sphere lh.sphere.surf.gii --factor 100 --factor-only --store basis --memory 4GiB",
    ],
    &[help::MESHES],
))]
pub(crate) struct Cli {
    /// Sphere of the sampling scheme
    ///
    /// The sphere is a mesh of any radius, centred at the origin, or a CSV of theta,phi in radians.
    #[arg(long, value_name = "SPHERE", help_heading = INPUT)]
    pub(super) sphere: PathBuf,
    /// Folder of the store; created if it doesn't exist
    #[arg(long, value_name = "DIR", env = "SPHARM_STORE", help_heading = OUTPUT)]
    pub(super) store: PathBuf,
    /// Write a report to a JSON file
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON in place of the table
    #[arg(long, help_heading = OUTPUT)]
    pub(super) json: bool,
    /// Former spelling of `--report FILE`: `--json FILE`.
    #[arg(hide = true, requires = "json", conflicts_with = "report", value_name = "FILE")]
    pub(super) json_file: Option<PathBuf>,
    /// Replace an existing report
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    /// Build even if the files are larger than 64 GiB or than the free disk space
    #[arg(long, help_heading = OUTPUT)]
    pub(super) yes: bool,
    /// Highest degree, inclusive
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    #[arg(required_unless_present = "factor_only")]
    pub(super) max_degree: Option<usize>,
    /// Scalar type of the basis
    ///
    /// f32 takes half the space of f64, with half as many digits.
    #[arg(long, value_enum, default_value_t = Dtype::F64, help_heading = METHOD)]
    pub(super) dtype: Dtype,
    /// Codec of the chunks
    ///
    /// zstd saves a few per cent of the space and makes fits several times slower.
    #[arg(long, value_enum, default_value_t = CodecName::None, help_heading = METHOD)]
    pub(super) codec: CodecName,
    /// Number of rows in each chunk, a multiple of 8
    ///
    /// A scheme that is already in the store keeps its number of rows per chunk.
    #[arg(long, value_name = "ROWS", default_value_t = DEFAULT_CHUNK_ROWS, hide_short_help = true, help_heading = METHOD)]
    pub(super) chunk_rows: usize,
    /// Also compute the factor of the normal equations to degree L
    #[arg(long, value_name = "L", help_heading = SOLVER)]
    pub(super) factor: Option<usize>,
    /// Compute the factor without building a basis
    #[arg(long, requires = "factor", conflicts_with = "max_degree", help_heading = SOLVER)]
    pub(super) factor_only: bool,
    /// Scalar type of the factor
    ///
    /// With f32, the factor takes half of the space, and the relative error of solutions is about 6e-8 times the
    /// condition number.
    #[arg(long, value_enum, default_value_t = Dtype::F64, requires = "factor", help_heading = SOLVER)]
    pub(super) factor_dtype: Dtype,
    /// Smoothness penalty of the factor
    ///
    /// Adds LAMBDA sum (l (l + 1))^2 |c|^2, over all coefficients c of degree l, to the sum of squared distances.
    #[arg(
        long,
        value_name = "LAMBDA",
        default_value_t = 0.0,
        value_parser = penalty,
        requires = "factor",
        help_heading = SOLVER
    )]
    pub(super) smoothness: f64,
    /// Memory budget
    #[arg(long, value_name = "SIZE", default_value = "512MiB", help_heading = RESOURCES)]
    pub(super) memory: Size,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum CodecName {
    None,
    Zstd,
}

impl CodecName {
    pub(super) fn codec(self) -> Codec {
        match self {
            Self::None => Codec::Raw,
            Self::Zstd => Codec::Zstd,
        }
    }
}

/// Parses a finite number that isn't negative.
fn penalty(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err("expected 0 or more".to_owned()) }
}
