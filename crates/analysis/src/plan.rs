//! Plans the memory of a subcommand of `shape` before it reads its models.

use std::path::{Path, PathBuf};

use anyhow::Result;
use spharm::shape::memory::GroupSizes;
use spharm_cli::console::Console;
use spharm_cli::memory::{Budget, Memory};
use spharm_cli::output::counted;
use spharm_cli::threads::Threads;
use spharm_model::Model;
use spharm_surface::Sphere;
use spharm_surface::generate::icosphere_counts;
use spharm_surface::io::bytes_to_read;

/// The models that a subcommand is about to read, and its memory budget.
pub(super) struct Plan {
    subcommand: &'static str,
    pub(super) budget: Budget,
    pub(super) threads: usize,
    /// Sizes of the group, taken from its largest file.
    pub(super) group: GroupSizes,
    /// Numbers of vertices and triangles of the sphere in the largest file.
    own: [u64; 2],
    /// Total size of the files in bytes.
    files: u64,
    /// Memory for reading the largest file, in bytes.
    largest: u64,
}

impl Plan {
    /// Creates a plan from the sizes of the files and the contents of the largest one.
    pub(super) fn new(
        subcommand: &'static str,
        paths: &[PathBuf],
        (memory, threads): (Memory, Threads),
    ) -> Result<Self> {
        let threads = threads.count();
        let budget = memory.budget(threads);
        let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |found| found.len());
        let files = paths.iter().map(size).fold(0_u64, u64::saturating_add);
        let (mut largest, mut group) = (0, GroupSizes { models: paths.len(), max_degree: 0, channels: 1 });
        let mut own = [0; 2];
        if let Some(path) = paths.iter().max_by_key(|path| size(path)) {
            budget.check_inputs(&format!("shape {subcommand}"), [path.as_path()])?;
            largest = bytes_to_read(path);
            // If this file isn't a model, the subcommand reports it (or an earlier malformed file) when it reads the
            // models.
            if let Ok(model) = Model::read(path) {
                group.max_degree = model.coefficients.max_degree();
                group.channels = model.coefficients.channels();
                own = model.sphere.as_ref().map_or(own, counts);
            }
        }
        Ok(Self { subcommand, budget, threads, group, own, files, largest })
    }

    /// Returns the numbers of vertices and triangles of the icosphere, or else of the shared sphere, or else of the
    /// largest model's own sphere.
    pub(super) fn sampling(&self, icosphere: Option<u32>, shared: Option<&Sphere>) -> [u64; 2] {
        icosphere.map(icosphere_counts).or(shared.map(counts)).unwrap_or(self.own)
    }

    /// Returns the memory, in bytes, needed to read models one after another with only one in memory at a time.
    pub(super) fn one(&self) -> u64 {
        self.largest
    }

    /// Returns the memory, in bytes, needed to read the whole group on all threads and keep only the coefficients.
    pub(super) fn coefficients(&self) -> u64 {
        let readers = self.threads.min(self.group.models) as u64;
        self.group.coefficients().saturating_add(self.largest.saturating_mul(readers))
    }

    /// Returns the memory, in bytes, needed to read the whole group on all threads and keep the complete models.
    pub(super) fn whole(&self) -> u64 {
        let readers = self.threads.min(self.group.models) as u64;
        self.files.saturating_add(self.largest.saturating_mul(readers))
    }

    /// Refuses a plan that doesn't fit into memory. The error names the first of the alternatives in `others` that
    /// fits.
    pub(super) fn check(&self, needed: u64, others: impl IntoIterator<Item = (String, u64)>) -> Result<()> {
        let GroupSizes { models, max_degree, .. } = self.group;
        let what = format!("shape {} with {} of degree {max_degree}", self.subcommand, counted(models, "model"));
        self.budget.check_or(what, needed, others)
    }

    /// Prints the plan before the work begins.
    pub(super) fn note(&self, needed: u64, console: &Console) {
        let GroupSizes { models, max_degree, .. } = self.group;
        let (needed, budget) = (needed.div_ceil(1 << 20), self.budget.work() >> 20);
        let models = counted(models, "model");
        console.note(format!("{models} of degree {max_degree}: {needed} MiB planned of a budget of {budget} MiB"));
    }

    /// Checks a plan as [`check`](Self::check) does, with coarser icospheres as alternatives.
    pub(super) fn check_sampling(
        &self,
        icosphere: Option<u32>,
        sampling: [u64; 2],
        needed: impl Fn([u64; 2]) -> u64,
    ) -> Result<()> {
        let coarser = (0..icosphere.unwrap_or(8)).rev().map(|n| (n, icosphere_counts(n)));
        let coarser = coarser.filter(|(_, [vertices, _])| *vertices < sampling[0]);
        self.check(needed(sampling), coarser.map(|(n, counts)| (format!("--icosphere {n}"), needed(counts))))
    }
}

fn counts(sphere: &Sphere) -> [u64; 2] {
    [sphere.directions.len() as u64, sphere.faces.len() as u64]
}

/// Refuses files that are read one after another if one of them doesn't fit into memory.
pub(super) fn check_each(subcommand: &str, paths: &[PathBuf], budget: Budget) -> Result<()> {
    paths.iter().try_for_each(|path| budget.check_inputs(&format!("shape {subcommand}"), [Path::new(path)]))
}
