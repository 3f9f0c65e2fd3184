//! `shape smooth`: smooths models with the heat kernel.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::json;
use spharm::model::transformed;
use spharm::shape::HeatKernel;
use spharm::shape::extent::finite;
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::shown;
use spharm_model::Model;
use spharm_monitor::number;

use super::args::{Models, ReportArgs};
use super::outputs::{check_beside, finish, outputs};
use super::plan::check_each;

/// Smooth models by the heat kernel
///
/// Coefficients of degree l are multiplied by exp(-l (l + 1) s). The width is an angle on the sphere, FWHM = 4 sqrt(s
/// ln 2) rad. On the surface, the width is about FWHM sqrt(area / 4 pi), and larger in regions that the map to the
/// sphere compresses. For a width of w mm on a sphere of radius R mm, give 57.3 w / R degrees. Both surfaces and
/// signals can be smoothed.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape smooth bunny.spharm.npz --fwhm 5 -o smooth.spharm.npz",
        "spharm shape smooth thickness --s 0.001 -o smoothed",
    ],
    &[],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    #[command(flatten)]
    width: Width,
    /// Model to write; for several models, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    memory: Memory,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct Width {
    /// Full width at half maximum, from 0 to 180 degrees of arc, not in the surface's unit
    #[arg(long, value_name = "DEG", value_parser = degrees, allow_negative_numbers = true, help_heading = METHOD)]
    fwhm: Option<f64>,
    /// Diffusion time s of the heat kernel, in place of the width
    #[arg(long = "s", value_name = "S", allow_negative_numbers = true, help_heading = METHOD)]
    time: Option<f64>,
}

impl Width {
    fn kernel(&self) -> Result<HeatKernel> {
        match self.fwhm {
            // State the width in degrees, the unit of the argument, because the kernel's own error states it in
            // radians.
            Some(degrees) if !(0.0..=WIDEST).contains(&degrees) => {
                bail!("--fwhm: expected a width from 0 to {WIDEST} degrees of arc, found {degrees} degrees")
            }
            Some(degrees) => HeatKernel::of_width(degrees.to_radians()).context("--fwhm"),
            None => HeatKernel::after(self.time.unwrap_or(0.0)).context("--s"),
        }
    }
}

/// Largest width in degrees: half of the sphere's circumference.
const WIDEST: f64 = 180.0;

/// Parses a width in degrees.
fn degrees(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| {
        "expected degrees of arc, without a unit; on a sphere of radius R, a length w is 57.3 w / R degrees".to_owned()
    })
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    let kernel = cli.width.kernel()?;
    let targets = outputs(&cli.models, &paths, &cli.output, "spharm.npz")?;
    check_beside(&paths, targets.iter().map(|path| OutputFile::with_ending(path, "--output", &[".npz"])), &cli.report)?;
    let fwhm = kernel.width().to_degrees();
    let transform = json!({ "heat_kernel": { "s": kernel.time(), "fwhm_degrees": fwhm } });
    check_each("smooth", &paths, cli.memory.budget(1))?;
    let mut models = Vec::new();
    let mut rows = vec![["model", "degree", "factor at the highest degree"].map(str::to_owned).to_vec()];
    for (path, target) in paths.iter().zip(&targets) {
        spharm::Monitor::check(monitor)?;
        let model = Model::read(path)?;
        finite(&model.coefficients).with_context(|| path.display().to_string())?;
        let coefficients = kernel.smooth(&model.coefficients)?;
        let degree = coefficients.max_degree();
        prepare(target)?;
        transformed(&model, coefficients, "shape smooth", transform.clone()).write_with(target, cli.report.force)?;
        let left = kernel.factor(degree);
        rows.push(vec![target.display().to_string(), degree.to_string(), number(left)]);
        models.push(json!({ "model": shown(path), "output": shown(target), "degree": degree, "left": left }));
    }
    let seconds = started.elapsed().as_secs_f64();
    let report = json!({ "s": kernel.time(), "fwhm_degrees": fwhm, "models": models, "seconds": seconds });
    finish("smooth", &report, &rows, &cli.report)
}
