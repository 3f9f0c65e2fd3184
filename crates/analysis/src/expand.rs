//! `shape expand`: restores models from compressed models.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::{Value, json};
use spharm::ModelError;
use spharm::shape::codec::{ExpandParams, expand};
use spharm_cli::Usage;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::{shown, with_ending};

use super::args::ReportArgs;
use super::outputs::{check, finish};

/// Maximum size of a compressed model in bytes. Each channel of degree 2,000 has at most 96 MB of coefficients.
const MOST_BYTES: u64 = 1 << 30;

/// First bytes of a gzipped file.
const GZIP: &[u8] = b"\x1f\x8b";

/// Restore models from compressed files
///
/// The models have no sphere: evaluate them with `spharm reconstruct --icosphere N`, or on any other sphere.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape expand bunny.sphz -o bunny.spharm.npz",
        "spharm shape expand compressed --max-degree 20 -o coarse",
        "head -c 800 bunny.sphz > beginning.sphz; spharm shape expand beginning.sphz --prefix -o coarse.spharm.npz",
    ],
    &[],
))]
pub(super) struct Cli {
    /// Compressed models, as `spharm shape compress` writes them
    ///
    /// Give files, folders (for all .sphz files in them), or @LIST for a file LIST with one path per line.
    #[arg(value_name = "FILE.sphz", required = true, help_heading = INPUT)]
    files: Vec<PathBuf>,
    /// Highest degree to expand [default: the model's degree]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Accept the beginning of a file, which holds a coarser model
    #[arg(long, help_heading = METHOD)]
    prefix: bool,
    /// Model to write; for several files, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    memory: Memory,
}

/// Maximum memory in bytes for each byte of a compressed file: a coefficient takes at least one bit in the file, and
/// 16 bytes in the model.
const EXPANSION: u64 = 160;

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let paths = spharm_cli::paths::expand(&cli.files, ".sphz")?;
    let targets = targets(cli, &paths)?;
    check(targets.iter().map(|path| OutputFile::with_ending(path, "--output", &[".npz"])), &cli.report)?;
    let budget = cli.memory.budget(1);
    for path in &paths {
        // A short file may hold many coefficients; `expand` bounds their number by the number of bytes.
        let bytes = std::fs::metadata(path).map_or(0, |found| found.len());
        budget.check(format_args!("shape expand: {}", path.display()), bytes.saturating_mul(EXPANSION))?;
    }
    let mut reports = Vec::new();
    let mut rows = vec![["model", "degree", "channels", "bytes used"].map(str::to_owned).to_vec()];
    for (path, target) in paths.iter().zip(&targets) {
        spharm::Monitor::check(monitor)?;
        let report = one(cli, path, target)?;
        let cell = |field: &str| report[field].to_string();
        rows.push(vec![target.display().to_string(), cell("degree"), cell("channels"), cell("bytes")]);
        reports.push(report);
    }
    finish("expand", &json!({ "models": reports }), &rows, &cli.report)
}

fn one(cli: &Cli, path: &Path, target: &Path) -> Result<Value> {
    let named = || path.display().to_string();
    let bytes = read(path)?;
    let params = ExpandParams { max_degree: cli.max_degree, prefix: cli.prefix };
    let expanded = expand(&bytes, &params).with_context(named)?;
    let degree = expanded.model.coefficients.max_degree();
    if let Some(wanted) = cli.max_degree
        && degree < wanted
    {
        bail!("{}: --max-degree {wanted} exceeds the model's degree {degree}", path.display());
    }
    prepare(target)?;
    expanded.model.write_with(target, cli.report.force)?;
    let channels = expanded.model.coefficients.channels();
    Ok(
        json!({ "file": shown(path), "output": shown(target), "degree": degree, "channels": channels, "bytes": expanded.bytes }),
    )
}

/// Reads the bytes of a regular file.
fn read(path: &Path) -> Result<Vec<u8>> {
    let open = |source| ModelError::Open { path: path.to_owned(), source };
    let bytes = spharm_files::read(path, MOST_BYTES).map_err(open)?;
    if bytes.starts_with(GZIP) {
        bail!("{}: expected a compressed model, found a gzipped file; unpack the file with gunzip", path.display());
    }
    Ok(bytes)
}

/// Returns the output of each file: the named output for a single file, otherwise `NAME.spharm.npz` in the output
/// folder.
fn targets(cli: &Cli, paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let output = &cli.output;
    if paths.len() == 1 && paths == cli.files && !output.is_dir() {
        return Ok(vec![output.clone()]);
    }
    if !output.is_dir() && output.to_string_lossy().ends_with(".npz") {
        return Err(Usage::conflict("--output must name a folder if several files are written").into());
    }
    let name = |path: &PathBuf| {
        let name = Path::new(path.file_name().unwrap_or_default());
        let is_compressed = name.extension().is_some_and(|ending| ending == "sphz");
        let stem = if is_compressed { name.with_extension("") } else { name.to_owned() };
        with_ending(&output.join(stem), "spharm.npz")
    };
    Ok(paths.iter().map(name).collect())
}
