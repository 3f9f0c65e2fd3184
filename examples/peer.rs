//! Times the library on arrays that other programs also use; `benches/peer.py` runs it.
//!
//! Arrays are `.npy` files of f64: directions (n, 3), targets (n, c), coefficients (K, c). Each command prints the
//! seconds of its repetitions as JSON. It also writes the computed arrays, so that another program can check them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use ndarray::Array2;
use ndarray_npy::{read_npy, write_npy};
use spharm::{FitParams, Kind, Signal, Sphere, Target, fit};
use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_solver::lsq::moments_pay;
use spharm_solver::{
    CholeskyFactor, DeferredOperator, GramMatrix, LsqParams, LsqSolver, MatrixFreeOperator, Operator, StoredFactor,
    Strategy, moment_gram, moment_normal,
};
use spharm_store::factor::open_factor;
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};
use spharm_transform::{Transform, TransformParams};

// Use the allocator and the kernels of the program `spharm`, so that the measured rates are also those of the program.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[global_allocator]
static ALLOCATOR: spharm_tools::allocator::LargePages = spharm_tools::allocator::LargePages;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
#[path = "../tools/kernels.rs"]
mod kernels;

#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Times making the plan, synthesis and adjoint synthesis.
    Transforms {
        directions: PathBuf,
        coefficients: PathBuf,
        max_degree: usize,
        accuracy: f64,
        repeats: usize,
        out: PathBuf,
    },
    /// Times least squares from arrays to coefficients, including the plan.
    Lsq {
        directions: PathBuf,
        targets: PathBuf,
        max_degree: usize,
        accuracy: f64,
        tolerance: f64,
        repeats: usize,
        out: PathBuf,
        /// A store that contains the factor of the sampling scheme.
        #[arg(long)]
        store: Option<PathBuf>,
        #[arg(long)]
        factor: bool,
        /// Iterates with the samples only, without their moments.
        #[arg(long)]
        samples: bool,
    },
    /// Times a fit by the crate `spharm` of positions on directions without triangles, starting from arrays.
    Fit { directions: PathBuf, targets: PathBuf, max_degree: usize, repeats: usize },
    /// Writes the vertices of an icosphere.
    Sphere { subdivisions: u32, out: PathBuf },
    /// Times the Gram matrix, including the moments from which it is computed.
    Gram { directions: PathBuf, max_degree: usize, repeats: usize },
}

fn directions(path: &Path) -> Result<Directions> {
    let vectors: Array2<f64> = read_npy(path).with_context(|| path.display().to_string())?;
    let vectors: Vec<[f64; 3]> = vectors.rows().into_iter().map(|v| [v[0], v[1], v[2]]).collect();
    Ok(Directions::from_vertices(&vectors)?)
}

fn repeat<T>(repeats: usize, mut work: impl FnMut() -> Result<T>) -> Result<(Vec<f64>, T)> {
    let mut seconds = Vec::new();
    loop {
        let start = Instant::now();
        let done = work()?;
        seconds.push(start.elapsed().as_secs_f64());
        if seconds.len() >= repeats {
            return Ok((seconds, done));
        }
    }
}

fn main() -> Result<()> {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    spharm_tools::allocator::keep_freed(std::env::args_os());
    rayon::ThreadPoolBuilder::new().num_threads(2).build_global()?;
    match Cli::parse().command {
        Command::Transforms { directions: path, coefficients, max_degree, accuracy, repeats, out } => {
            let (directions, x): (_, Array2<f64>) = (directions(&path)?, read_npy(coefficients)?);
            let params = TransformParams { max_degree, accuracy, ..Default::default() };
            let (plan, transform) = repeat(repeats, || Ok(Transform::new(&directions, &params)?))?;
            let (synthesis, samples) = repeat(repeats, || Ok(transform.synthesis(x.view())?))?;
            let (adjoint, back) = repeat(repeats, || Ok(transform.adjoint_synthesis(samples.view())?))?;
            write_npy(out.with_extension("samples.npy"), &samples)?;
            write_npy(out.with_extension("adjoint.npy"), &back)?;
            println!("{}", serde_json::json!({ "plan": plan, "synthesis": synthesis, "adjoint": adjoint }));
        }
        Command::Lsq {
            directions: path,
            targets,
            max_degree,
            accuracy,
            tolerance,
            repeats,
            out,
            store,
            factor,
            samples,
        } => {
            let (directions, targets): (_, Array2<f64>) = (directions(&path)?, read_npy(targets)?);
            let make_gram = || Ok(Box::new(moment_gram(&directions, None, max_degree)?) as Box<dyn GramMatrix>);
            let key = SchemeKey::of(&directions, Scalar::F64);
            let (seconds, fit) = repeat(repeats, || {
                let params = TransformParams { max_degree, accuracy, ..Default::default() };
                let shared = !samples && moments_pay(directions.len(), max_degree, targets.ncols(), tolerance);
                let with_moments = || MatrixFreeOperator::with_moments(&directions, &params);
                let with_moments = shared.then(with_moments).transpose()?;
                let deferred = DeferredOperator::new(&directions, &params);
                let operator: &dyn Operator = with_moments.as_ref().map_or(&deferred, |operator| operator);
                let make_moments = |accuracy: f64, targets: Option<&Array2<f64>>| {
                    let (moments, right_sides) = match &with_moments {
                        Some(operator) => operator.moments(&directions, None, accuracy, targets)?,
                        None => (moment_normal(&directions, None, max_degree, accuracy)?, None),
                    };
                    Ok((Arc::new(moments), right_sides))
                };
                let strategy = if factor { Strategy::Cholesky } else { Strategy::Auto };
                let params = LsqParams { tolerance, threads: 2, strategy, ..Default::default() };
                let stored = match &store {
                    Some(store) => {
                        let spec = FactorSpec {
                            key,
                            rows: directions.len(),
                            max_degree,
                            weights: WeightsHash::of(None),
                            smoothness: 0.0,
                        };
                        Some(StoredFactor::new(open_factor(store, &spec, None)?, 1 << 30, 2))
                    }
                    None => None,
                };
                let mut solver = LsqSolver::new(operator, Some(&make_gram), params)?;
                if !samples {
                    solver = solver.with_moments(&make_moments);
                }
                if let Some(stored) = &stored {
                    solver = solver.with_factor(stored as &dyn CholeskyFactor);
                }
                Ok(solver.fit(&targets, std::slice::from_ref(&(0..targets.ncols())), &Silent)?)
            })?;
            write_npy(out.with_extension("coefficients.npy"), fit.coefficients.values())?;
            println!(
                "{}",
                serde_json::json!({ "seconds": seconds, "report": fit.report, "peak": spharm_cli::machine::memory().peak_resident })
            );
        }
        Command::Fit { directions, targets, max_degree, repeats } => {
            let rows = |path: &Path| -> Result<Vec<[f64; 3]>> {
                let array: Array2<f64> = read_npy(path)?;
                Ok(array.into_raw_vec_and_offset().0.as_chunks().0.to_vec())
            };
            let (directions, targets) = (rows(&directions)?, rows(&targets)?);
            let before = spharm::machine::process_status("VmRSS:");
            let (seconds, _) = repeat(repeats, || {
                let sphere = Sphere::from_directions(Directions::from_vertices(&directions)?);
                let signal = Signal::new(targets.as_flattened().to_vec(), targets.len(), 3);
                let target = Target { kind: Kind::Surface, ..Target::from_signal(signal, &sphere)? };
                Ok(fit(&sphere, &target, &FitParams::lsq(max_degree))?)
            })?;
            let peak = spharm_cli::machine::memory().peak_resident;
            println!("{}", serde_json::json!({ "seconds": seconds, "before": before, "peak": peak }));
        }
        Command::Sphere { subdivisions, out } => {
            let sphere = spharm_surface::generate::icosphere(subdivisions);
            let vertices = Array2::from_shape_fn((sphere.vertices.len(), 3), |(i, c)| sphere.vertices[i][c]);
            write_npy(out, &vertices)?;
        }
        Command::Gram { directions: path, max_degree, repeats } => {
            let directions = directions(&path)?;
            let size = spharm_harmonics::basis_size(max_degree);
            let mut gram = vec![0.0; size * size];
            let (seconds, ()) = repeat(repeats, || {
                moment_gram(&directions, None, max_degree)?.write_lower(&mut gram, size);
                Ok(())
            })?;
            println!("{}", serde_json::json!({ "seconds": seconds }));
        }
    }
    Ok(())
}
