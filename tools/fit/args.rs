//! The arguments of `fit`, and the settings that they ask for.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::ValueEnum;
use spharm::{FitParams, Method, Preconditioner, Smoothness, Weights, defaults};
use spharm_cli::names::NameTemplate;
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_cli::{Common, Usage};
use spharm_harmonics::MAX_DEGREE;
use spharm_store::Scalar;
use spharm_surface::io::read_signal;

/// Fit surfaces, or any signals on the sphere, with spherical harmonics
///
/// Without --store: the full least squares, by fast transforms. With --store: iterative residual fitting over a basis that
/// basis-build has made for the same sphere, in bounded memory. All surfaces of one call are fitted together, in as few
/// sweeps as the memory allows.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Folder of the basis store
    #[arg(long, value_name = "DIR", env = "SPHARM_STORE")]
    pub(super) store: Option<PathBuf>,
    /// The sphere: a mesh around the origin, or a CSV of theta,phi. If omitted, each surface is first mapped to the sphere
    /// (see parametrize); the sphere is written next to the model
    #[arg(long, value_name = "SPHERE")]
    pub(super) sphere: Option<PathBuf>,
    /// Surfaces, or signals (GIfTI, FreeSurfer curv, CSV with a row a vertex), on the sphere's vertices; @LIST takes the
    /// paths from a file, one a line, relative to it, # for comments
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    pub(super) surface: Vec<PathBuf>,
    /// Highest degree, inclusive
    #[arg(long, value_name = "L")]
    pub(super) max_degree: usize,
    /// Full least squares by transforms, iterative residual fitting and the paper's special cases of it over a store, the
    /// full least squares over a store, or quadrature on a resampled grid [default: irf with --store, else lsq]
    #[arg(long, value_enum)]
    method: Option<MethodName>,
    /// Number of passes, p (irf, mirf) [default: 1; with --accelerate 16]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u32).range(1..))]
    passes: Option<u32>,
    /// Most basis functions solved together, g (irf) [default: 100]
    #[arg(long, value_name = "G", value_parser = at_least_one)]
    granularity: Option<usize>,
    /// Conjugate gradients over pairs of passes, one forward and one backward (irf, mirf): the least squares in far fewer
    /// passes where the sampling is irregular; --passes bounds them, and they end early when nothing is left to gain
    #[arg(long)]
    accelerate: bool,
    /// Last degree of the first block, s (sirf, mirf) [default: 0]
    #[arg(long, value_name = "S")]
    start_degree: Option<usize>,
    /// Weights of the vertices: uniform, area (their share of the sphere), or a file with one value for each
    #[arg(long, value_name = "uniform|area|FILE", default_value = "uniform")]
    pub(super) weights: String,
    /// Smoothness penalty (lsq): adds LAMBDA sum (l (l + 1))^2 a^2 to the squared distances; auto chooses it for each
    /// surface by generalised cross-validation [default: 0 with --sphere; without, a hundredth of the weight of the vertices
    /// at the highest degree, which keeps the model from oscillating between them]
    #[arg(long, value_name = "LAMBDA|auto", value_parser = smoothness)]
    smoothness: Option<Smoothness>,
    /// Also write each coefficient's standard error, NAME.spharm.stderr.npy (lsq)
    #[arg(long)]
    pub(super) stderr: bool,
    /// Leave this fraction of the vertices out of the fit, and report the distances there
    #[arg(long, value_name = "FRACTION", value_parser = fraction)]
    pub(super) hold_out: Option<f64>,
    /// Optimality to reach (lsq): the gradient relative to that of no fit at all
    #[arg(long, value_name = "T", default_value = "1e-10", value_parser = tolerance)]
    tolerance: f64,
    /// Most iterations (lsq)
    #[arg(long, value_name = "N", default_value_t = defaults::MAX_ITERATIONS)]
    max_iterations: usize,
    /// Preconditioner of the iterations (lsq); auto makes a factor where they are slow
    #[arg(long, value_enum, default_value_t = PreconditionerName::Auto)]
    preconditioner: PreconditionerName,
    /// Highest degree of --preconditioner low-degrees [default: 20]
    #[arg(long, value_name = "L0")]
    low_degrees: Option<usize>,
    /// Scalar type of the basis to use [default: what the store holds, f64 first]
    #[arg(long, value_enum)]
    dtype: Option<Dtype>,
    /// Memory to keep to, mapped files included [default: 256MiB over a store, else half of what is free]
    #[arg(long, value_name = "SIZE")]
    memory: Option<Size>,
    #[command(flatten)]
    pub(super) threads: Threads,
    /// Folder for the models, NAME.spharm.npz; for one surface also a file, whose name ends in .npz [default: here]
    #[arg(short, long, value_name = "OUT")]
    pub(super) output: Option<PathBuf>,
    /// Names of the models, from each input's path alone: {stem} is its name without folder and format, {parent} the folder
    /// that it is in, {parent2} the one above
    #[arg(long, value_name = "TEMPLATE", default_value = "{stem}")]
    pub(super) name_template: NameTemplate,
    /// Also write the paper's complex coefficients, NAME.spharm.csv, beside each model
    #[arg(long)]
    pub(super) coefficients_csv: bool,
    /// Write a report to FILE
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON in place of the table
    #[arg(long)]
    pub(super) json: bool,
    /// Check every byte of the basis against its hash first
    #[arg(long)]
    verify: bool,
    /// Refuse surfaces that aren't closed and of genus zero, and fits that don't reach the tolerance
    #[arg(long)]
    pub(super) strict: bool,
    /// Replace outputs that exist
    #[arg(long)]
    pub(super) force: bool,
    /// Leave surfaces out whose model exists, if it was fitted to the same input with the same settings
    #[arg(long, conflicts_with = "force")]
    pub(super) skip_existing: bool,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MethodName {
    Lsq,
    Irf,
    Sirf,
    Mirf,
    Nlsf,
    Quadrature,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PreconditionerName {
    Auto,
    None,
    Density,
    LowDegrees,
    Factor,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Dtype {
    F64,
    F32,
}

fn smoothness(text: &str) -> Result<Smoothness, String> {
    if text == "auto" {
        return Ok(Smoothness::Auto);
    }
    let lambda = text.parse().ok().filter(|lambda: &f64| *lambda >= 0.0 && lambda.is_finite());
    lambda.map(Smoothness::Fixed).ok_or_else(|| "expected a number from 0, or auto".to_owned())
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text {
        "inf" => Ok(usize::MAX),
        _ => text.parse().ok().filter(|&n| n > 0).ok_or_else(|| "expected a whole number from 1, or inf".to_owned()),
    }
}

fn fraction(text: &str) -> Result<f64, String> {
    let fraction = text.parse().ok().filter(|fraction: &f64| *fraction > 0.0 && *fraction < 1.0);
    fraction.ok_or_else(|| "expected a fraction between 0 and 1".to_owned())
}

fn tolerance(text: &str) -> Result<f64, String> {
    let tolerance = text.parse().ok().filter(|tolerance: &f64| *tolerance > 0.0 && *tolerance < 1.0);
    tolerance.ok_or_else(|| "expected a number between 0 and 1".to_owned())
}

impl Cli {
    /// The settings that the arguments ask for.
    pub(super) fn params(&self) -> Result<FitParams> {
        let method = self.method()?;
        if self.max_degree > MAX_DEGREE {
            bail!("--max-degree {}: the highest degree is {MAX_DEGREE}", self.max_degree);
        }
        let preconditioner = match self.preconditioner {
            PreconditionerName::Auto => Preconditioner::Auto,
            PreconditionerName::None => Preconditioner::None,
            PreconditionerName::Density => Preconditioner::Density,
            PreconditionerName::LowDegrees => Preconditioner::LowDegrees(self.low_degrees.unwrap_or(20)),
            PreconditionerName::Factor => Preconditioner::Factor,
        };
        let scalar = self.dtype.map(|dtype| match dtype {
            Dtype::F64 => Scalar::F64,
            Dtype::F32 => Scalar::F32,
        });
        Ok(FitParams {
            max_degree: self.max_degree,
            method,
            smoothness: self.smoothness.unwrap_or_default(),
            weights: self.weights()?,
            hold_out: self.hold_out,
            standard_errors: self.stderr,
            tolerance: self.tolerance,
            max_iterations: self.max_iterations,
            preconditioner,
            strict: self.strict,
            store: self.store.clone(),
            scalar,
            verify: self.verify,
            memory: self.memory.map(|size| size.0),
            threads: Some(self.threads.count()),
        })
    }

    /// The method that the arguments name; arguments that don't belong to it are usage errors.
    fn method(&self) -> Result<Method, Usage> {
        let method = self.method.unwrap_or(if self.store.is_some() { MethodName::Irf } else { MethodName::Lsq });
        let name = method.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
        let streamed = !matches!(method, MethodName::Lsq | MethodName::Quadrature);
        if streamed && self.store.is_none() {
            let needs = "needs --store DIR, with a basis that basis-build has made";
            return Err(Usage::missing(format!("--method {name} {needs}")));
        }
        if streamed && self.sphere.is_none() {
            let needs = "needs --sphere SPHERE, the one that the basis was built for";
            return Err(Usage::missing(format!("--method {name} {needs}")));
        }
        use MethodName::{Irf, Lsq, Mirf, Quadrature, Sirf};
        let conflicts = [
            (self.start_degree.is_some() && !matches!(method, Sirf | Mirf), "--start-degree", ""),
            (self.granularity.is_some() && method != Irf, "--granularity", ""),
            (
                self.passes.is_some_and(|p| p > 1) && !matches!(method, Irf | Mirf),
                "--passes",
                "; several passes of sirf are mirf",
            ),
            (self.accelerate && !matches!(method, Irf | Mirf), "--accelerate", "; use --method irf or mirf"),
            (self.smoothness.is_some() && method != Lsq, "--smoothness", "; use --method lsq"),
            (self.stderr && method != Lsq, "--stderr", "; use --method lsq"),
            (
                self.preconditioner != PreconditionerName::Auto && method != Lsq,
                "--preconditioner",
                "; use --method lsq",
            ),
            (
                method == Quadrature && (self.weights != "uniform" || self.hold_out.is_some()),
                "--weights or --hold-out",
                "",
            ),
            (!streamed && (self.dtype.is_some() || self.verify), "--dtype or --verify", ", which doesn't read a basis"),
            (
                self.low_degrees.is_some() && self.preconditioner != PreconditionerName::LowDegrees,
                "--low-degrees",
                " without --preconditioner low-degrees",
            ),
        ];
        if let Some((_, flag, hint)) = conflicts.into_iter().find(|(conflict, ..)| *conflict) {
            return Err(Usage::conflict(format!("{flag} doesn't go with --method {name}{hint}")));
        }
        let default_passes = if self.accelerate { defaults::ACCELERATED_PASSES } else { 1 };
        let passes = self.passes.map_or(default_passes, |passes| passes as usize);
        let (start_degree, accelerate) = (self.start_degree.unwrap_or(0), self.accelerate);
        Ok(match method {
            MethodName::Lsq => Method::Lsq,
            MethodName::Quadrature => Method::Quadrature,
            MethodName::Irf => {
                Method::Irf { passes, granularity: self.granularity.unwrap_or(defaults::GRANULARITY), accelerate }
            }
            MethodName::Sirf => Method::Sirf { start_degree },
            MethodName::Mirf => Method::Mirf { passes, start_degree, accelerate },
            MethodName::Nlsf => Method::Nlsf,
        })
    }

    fn weights(&self) -> Result<Weights> {
        Ok(match self.weights.as_str() {
            "uniform" => Weights::Uniform,
            "area" => Weights::Area,
            file => {
                let signal = read_signal(file)?;
                if signal.channels != 1 {
                    bail!("{file}: expected one weight for each vertex, found {} columns", signal.channels);
                }
                Weights::Values { name: file.to_owned(), values: signal.values }
            }
        })
    }
}
