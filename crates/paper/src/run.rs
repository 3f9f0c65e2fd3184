//! Runs all experiments and returns the resulting documents.

use std::cell::RefCell;
use std::path::Path;

use anyhow::Result;
use spharm_monitor::Monitor;
use spharm_solver::DiskOperator;
use spharm_store::Scheme;

use crate::bench::Bench;
use crate::experiments::{self, Results};
use crate::extent::Settings;
use crate::published::Reference;
use crate::store::Store;
use crate::summary::{Circumstances, summary};
use crate::surfaces::{Surface, among, generated};
use crate::{families, figures, tables};

/// A document that the caller writes to a file.
#[derive(Debug, Clone)]
pub struct Document {
    /// Name of the file.
    pub name: String,
    /// Contents of the file.
    pub text: String,
}

const SUMMARY: &str = "paper.md";

/// The experiments: their settings and surfaces, and the expected results of the fits.
pub struct Experiments {
    settings: Settings,
    surfaces: Vec<Surface>,
    reference: Reference,
}

impl Experiments {
    /// Generates a cortex, and reads the known surfaces in the folder `data`. Surfaces whose files are missing are
    /// skipped, with a note to the monitor.
    ///
    /// # Errors
    ///
    /// Returns an error if the folder or a file in it can't be read.
    pub fn new(settings: Settings, data: Option<&Path>, monitor: &dyn Monitor) -> Result<Self> {
        let mut surfaces = vec![generated(settings.extent().subdivisions)?];
        let mut reference = Reference::default();
        if let Some(data) = data {
            surfaces.extend(among(data, monitor)?);
            reference = Reference::beside(data)?;
        }
        Ok(Self { settings, surfaces, reference })
    }

    /// Returns the file names of all documents, which are known before the experiments are run.
    pub fn document_names(&self) -> Vec<String> {
        let empty = Results::default();
        let tables = tables::all_csv(&empty).into_iter().map(|(name, _)| name.to_owned());
        tables.chain(figures::names(&self.names())).chain([SUMMARY.to_owned()]).collect()
    }

    /// Runs all experiments. Bases are stored in the folder `store`. If `store` is `None`, they are stored in a
    /// temporary folder within `beside`.
    ///
    /// # Errors
    ///
    /// Returns an error if a basis can't be built, a fit fails, or the monitor cancels the run.
    pub fn run(&self, store: Option<&Path>, beside: &Path, monitor: &dyn Monitor) -> Result<Measurements> {
        /// Memory of the program, its stacks and its allocator, in bytes; the command `spharm fit` uses the same
        /// estimate.
        const BASE: usize = 12 << 20;
        let Settings { memory, threads, .. } = self.settings;
        let store = Store::new(store, beside)?;
        let held = BASE + self.surfaces.iter().map(Surface::bytes).sum::<usize>();
        let warnings = RefCell::default();
        let bench = Bench { monitor, warnings: &warnings, memory, threads, held };
        let results = self.measure(&bench, &store)?;
        Ok(Measurements { results, warnings: warnings.into_inner() })
    }

    fn measure(&self, bench: &Bench<'_>, store: &Store) -> Result<Results> {
        let (extent, reference) = (self.settings.extent(), &self.reference);
        let mut results = Results::default();
        for (index, surface) in self.surfaces.iter().enumerate() {
            let n = surface.directions.len();
            bench.note(format_args!(
                "{}: computing the basis at {n} vertices up to degree {}",
                surface.name, extent.max_degree
            ));
            let (built, _) = bench.build(&store.folder, &surface.directions, extent.max_degree)?;
            let operator = DiskOperator::new(Scheme::open(&store.folder, built.key, n, extent.max_degree)?);
            results.sirf.extend(experiments::sirf(bench, extent, &operator, surface, reference)?);
            let (grid, between) = experiments::grid(bench, extent, &operator, surface, reference)?;
            results.grid.extend(grid);
            results.between.extend(between);
            if index == 0 {
                results.nlsf = experiments::nlsf(bench, extent, &operator, surface)?;
            }
            drop(operator);
            store.done_with(&built.folder)?;
            results.families.extend(families::families(bench, extent, surface)?);
        }
        results.basis = experiments::basis(bench, extent, &store.folder)?;
        Ok(results)
    }

    /// Returns all documents: tables, figures and the summary, in this order.
    pub fn documents(&self, measured: &Measurements, circumstances: &Circumstances) -> Vec<Document> {
        let (results, extent) = (&measured.results, self.settings.extent());
        let tables = tables::all_csv(results).into_iter().map(|(name, text)| Document { name: name.to_owned(), text });
        let figures = figures::all(results, extent, &self.names()).into_iter();
        let figures = figures.map(|(name, text)| Document { name, text });
        let text = summary(results, extent, &self.surfaces, &self.settings, circumstances);
        tables.chain(figures).chain([Document { name: SUMMARY.to_owned(), text }]).collect()
    }

    fn names(&self) -> Vec<String> {
        self.surfaces.iter().map(|surface| surface.name.clone()).collect()
    }
}

/// Results of all experiments.
#[derive(Debug)]
pub struct Measurements {
    results: Results,
    /// Warnings about the results.
    pub warnings: Vec<String>,
}
