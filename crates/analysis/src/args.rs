//! Arguments shared by the subcommands of `shape`, and functions that read the models.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use spharm::shape::Metric;
use spharm::{Coefficients, Monitor, Stage};
use spharm_cli::console::Console;
use spharm_cli::help::{INPUT, METHOD, OUTPUT, RESOURCES};
use spharm_cli::inputs::read_sphere;
use spharm_cli::memory::Memory;
use spharm_cli::paths::expand_to;
use spharm_cli::threads::Threads;
use spharm_model::Model;
use spharm_surface::Sphere;

use super::plan::Plan;

/// The models that a subcommand of `shape` reads.
#[derive(Debug, Args)]
pub(super) struct Models {
    /// Models, as `spharm fit` writes them
    ///
    /// Give files, folders (for all .npz files in them, except the mean of a group written by `shape correspond`), or
    /// @LIST for a file LIST with one path per line.
    #[arg(value_name = "MODEL.spharm.npz", required = true, help_heading = INPUT)]
    pub(super) models: Vec<PathBuf>,
}

impl Models {
    /// Returns the paths of the models.
    pub(super) fn paths(&self) -> Result<Vec<PathBuf>> {
        files(&self.models)
    }

    /// Returns whether the argument is a single file, rather than a folder or list that contains a single file.
    pub(super) fn single(&self, paths: &[PathBuf]) -> bool {
        paths.len() == 1 && paths == self.models
    }
}

/// Returns the paths of the given models, and checks that all of them exist.
pub(super) fn files(models: &[PathBuf]) -> Result<Vec<PathBuf>> {
    // Skip the mean in the folder of a group, because the mean isn't a member. A mean that is given by its own path is
    // kept.
    let files = expand_to(models, ".npz", |file| !is_mean_of_group(file))?;
    match files.iter().find(|file| !file.exists()) {
        Some(missing) => bail!("{}: no such file or folder", missing.display()),
        None => Ok(files),
    }
}

/// Returns whether a file is the mean that `shape correspond` writes next to the members of a group.
fn is_mean_of_group(file: &Path) -> bool {
    file.file_name().is_some_and(|name| name == "mean.spharm.npz") && file.with_file_name("group.json").is_file()
}

/// Argument for the quantity by which models are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum By {
    Distance,
    Standardized,
}

impl By {
    pub(super) fn metric(self) -> Metric {
        match self {
            Self::Distance => Metric::Distance,
            Self::Standardized => Metric::Standardized,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Distance => "distance",
            Self::Standardized => "standardized",
        }
    }
}

/// Arguments for the output of the report, and for replacing existing files.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = OUTPUT)]
pub(super) struct ReportArgs {
    /// Write a report to a JSON file
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON in place of the table
    #[arg(long)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long)]
    pub(super) force: bool,
}

/// Arguments for memory and threads.
#[derive(Debug, Args)]
#[command(next_help_heading = RESOURCES)]
pub(super) struct Resources {
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
}

impl Resources {
    pub(super) fn both(&self) -> (Memory, Threads) {
        (self.memory, self.threads)
    }
}

/// Arguments for the sphere on which models are evaluated; by default each model's own sphere.
#[derive(Debug, Args)]
#[group(multiple = false)]
pub(super) struct Sampling {
    /// Evaluate at the vertices of a sphere mesh [default: the model's own sphere]
    #[arg(long, value_name = "SPHERE", help_heading = METHOD)]
    pub(super) sphere: Option<PathBuf>,
    /// Evaluate at the vertices of an icosphere
    ///
    /// N subdivisions give 10 * 4^N + 2 vertices.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=10), help_heading = METHOD)]
    pub(super) icosphere: Option<u32>,
}

impl Sampling {
    /// Returns the sphere on which all models are evaluated, or `None` if each is evaluated on its own sphere. `needed`
    /// computes the bytes of memory from the sphere's numbers of vertices and triangles. A sphere that needs more than
    /// the budget is refused.
    pub(super) fn within(
        &self,
        plan: &Plan,
        needed: impl Fn([u64; 2]) -> u64,
        console: &Console,
    ) -> Result<Option<Sphere>> {
        let Some(path) = &self.sphere else {
            // Check the memory before the icosphere is created.
            plan.check_sampling(self.icosphere, plan.sampling(self.icosphere, None), needed)?;
            return Ok(self.icosphere.map(Sphere::icosphere));
        };
        plan.budget.check_inputs("shape", [path.as_path()])?;
        let sphere = read_sphere(path, false, console)?;
        plan.check_sampling(None, plan.sampling(None, Some(&sphere)), needed)?;
        Ok(Some(sphere))
    }
}

/// Returns the sphere on which a model is evaluated: the shared sphere, or else the model's own.
pub(super) fn sphere_of<'a>(shared: Option<&'a Sphere>, model: &'a Model, path: &Path) -> Result<&'a Sphere> {
    match shared {
        Some(sphere) => Ok(sphere),
        None => model.own_sphere().with_context(|| path.display().to_string()),
    }
}

/// Returns the coefficients of a model up to a degree, by default up to the model's own degree.
pub(super) fn to_degree(model: &Model, path: &Path, degree: Option<usize>) -> Result<Coefficients> {
    let highest = model.coefficients.max_degree();
    match degree {
        Some(degree) if degree > highest => {
            bail!("{}: --max-degree {degree} exceeds the model's degree {highest}", path.display())
        }
        Some(degree) => Ok(Coefficients::new(model.coefficients.up_to(degree).to_owned())?),
        None => Ok(model.coefficients.clone()),
    }
}

/// Reads models on all threads and calls `take` with each model and its path. Returns the results of `take` in the
/// order of the paths.
pub(super) fn read_all<T: Send>(
    paths: &[PathBuf],
    monitor: &dyn Monitor,
    take: impl Fn(&Model, &Path) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    monitor.begin(Stage::counted("read", "models"), paths.len() as u64);
    let one = |path: &PathBuf| {
        monitor.check()?;
        let taken = take(&Model::read(path)?, path)?;
        monitor.step(1);
        Ok(taken)
    };
    // Collect all results before returning an error, so that the error doesn't depend on the order in which threads
    // finish.
    let results: Vec<Result<T>> = paths.par_iter().map(one).collect();
    monitor.end();
    results.into_iter().collect()
}
