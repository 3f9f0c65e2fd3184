//! `shape rotate`: rotates the parameters or the surface of models, and scales and translates surfaces.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::json;
use spharm::model::signed;
use spharm::shape::{Rotation, Similarity, Transform};
use spharm::{Kind, Model};
use spharm_cli::Usage;
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::all_shown;

use super::args::{Models, ReportArgs, Resources};
use super::outputs::{check_beside, finish, outputs};
use super::plan::Plan;

/// Rotate or mirror models: their parameters, or the surface in space
///
/// --parameters rotates the sphere by a rotation R, without moving the surface: the vertex at direction u gets the
/// direction R u, and the model's own sphere is rotated as well. --object rotates the surface by a rotation Q. With
/// --scale and --translate, a point x moves to scale Q x + translation. --mirror exchanges left and right before any
/// rotation: on the sphere, on the surface and in the name of the anatomical structure.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape rotate bunny.spharm.npz --object 0,90,0 -o turned.spharm.npz",
        "spharm shape rotate bunny.spharm.npz --parameters 30,45,60 -o other.spharm.npz",
        "spharm shape rotate models --object 0,-1,0,1,0,0,0,0,1 --scale 0.1 --translate 10,0,0 -o moved",
    ],
    &[
        "A rotation is given by 3 numbers (Euler angles alpha, beta, gamma in degrees, of Rz(alpha) Ry(beta) \
         Rz(gamma)), 4 numbers (a quaternion w,x,y,z) or 9 numbers (a matrix by rows).",
    ],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Mirror first: x to -x, on the sphere and, for surfaces, in space
    #[arg(long, help_heading = METHOD)]
    mirror: bool,
    /// Rotation of the parameters
    #[arg(long, value_name = "NUMBERS", allow_hyphen_values = true, value_delimiter = ',', help_heading = METHOD)]
    parameters: Option<Vec<f64>>,
    /// Rotation of the surface in space
    #[arg(long, value_name = "NUMBERS", allow_hyphen_values = true, value_delimiter = ',', help_heading = METHOD)]
    object: Option<Vec<f64>>,
    /// Scale of the surface
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, help_heading = METHOD)]
    scale: f64,
    /// Translation of the surface, after rotation and scale
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_delimiter = ',', help_heading = METHOD)]
    translate: Option<Vec<f64>>,
    /// Model to write; for several models, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

fn rotation(numbers: Option<&Vec<f64>>, option: &'static str) -> Result<Rotation> {
    let Some(numbers) = numbers else { return Ok(Rotation::IDENTITY) };
    let found = match numbers[..] {
        [alpha, beta, gamma] => {
            let [alpha, beta, gamma] = [alpha, beta, gamma].map(f64::to_radians);
            Rotation::from_euler(alpha, beta, gamma)
        }
        [w, x, y, z] => Rotation::from_quaternion([w, x, y, z]),
        [a, b, c, d, e, f, g, h, i] => Rotation::from_matrix([[a, b, c], [d, e, f], [g, h, i]]),
        _ => {
            let message = format!("{option}: expected 3, 4 or 9 numbers, found {}", numbers.len());
            return Err(Usage::invalid(message).into());
        }
    };
    found.context(option)
}

/// Returns the reflection for a kind of model; a signal is mirrored only on its sphere.
fn mirror(kind: Kind) -> Transform {
    let similarity = Similarity::default();
    if kind == Kind::Surface { Transform::reflection() } else { Transform { similarity, ..Transform::reflection() } }
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    let translation = match cli.translate.as_deref() {
        None => [0.0; 3],
        Some(&[x, y, z]) if [x, y, z].iter().all(|value| value.is_finite()) => [x, y, z],
        Some(_) => return Err(Usage::invalid("--translate: expected three finite numbers").into()),
    };
    if !(cli.scale > 0.0 && cli.scale.is_finite()) {
        return Err(Usage::invalid("--scale must be a number above zero").into());
    }
    let turned = rotation(cli.object.as_ref(), "--object")?;
    let transform = Transform {
        rotation: rotation(cli.parameters.as_ref(), "--parameters")?,
        antipodal: false,
        similarity: Similarity { orthogonal: turned.matrix(), scale: cli.scale, translation },
    };
    if transform == Transform::default() && !cli.mirror {
        let options = "--parameters, --object, --scale, --translate or --mirror";
        return Err(Usage::missing(format!("nothing to do: give {options}")).into());
    }
    let targets = outputs(&cli.models, &paths, &cli.output, "spharm.npz")?;
    check_beside(&paths, targets.iter().map(|path| OutputFile::with_ending(path, "--output", &[".npz"])), &cli.report)?;
    let plan = Plan::new("rotate", &paths, cli.resources.both())?;
    plan.check(plan.one().saturating_mul(2), [])?;
    let pool = cli.resources.threads.pool()?;
    for (path, target) in paths.iter().zip(&targets) {
        spharm::Monitor::check(monitor)?;
        let model = Model::read(path)?;
        let whole = if cli.mirror { mirror(model.kind()).then(&transform) } else { transform };
        let moved = pool.install(|| whole.apply_model(&model, monitor));
        let moved = signed(moved.with_context(|| path.display().to_string())?, "shape rotate");
        prepare(target)?;
        moved.write_with(target, cli.report.force)?;
    }
    let report = json!({
        "models": all_shown(&paths),
        "outputs": all_shown(&targets),
        "mirror": cli.mirror,
        "parameters": transform.rotation.matrix(),
        "object": transform.similarity.orthogonal,
        "scale": transform.similarity.scale,
        "translation": transform.similarity.translation,
        "seconds": started.elapsed().as_secs_f64(),
    });
    let rows: Vec<Vec<String>> = targets.iter().map(|target| vec![target.display().to_string()]).collect();
    finish("rotate", &report, &rows, &cli.report)
}
