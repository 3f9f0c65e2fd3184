//! Events that a run reports while it works.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use spharm::parametrize::volume::Repair;
use spharm::parametrize::{HandlesReport, Report};
use spharm::{FitParams, FitReport, FitWarning, ManyReport, MappedSurface};

use super::error::RunError;
use crate::files::ModelFiles;
use crate::{Entry, Row};

/// Receives the events of a run, from several threads.
pub trait Observer: Sync {
    /// Takes an event.
    fn event(&self, event: &Event<'_>) {
        let _ = event;
    }

    /// Returns an error as one line, for the table of outcomes.
    fn line(&self, error: &RunError) -> String {
        error.line()
    }
}

/// Ignores all events.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}

/// An event of a run.
#[derive(Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// Number of surfaces that are mapped to spheres of their own, so that their coefficients don't correspond.
    OwnSpheres(usize),
    /// Work on a row has begun.
    Started {
        /// The row.
        row: &'a Row,
    },
    /// A surface was mapped to a sphere of its own.
    Mapped {
        /// The row.
        row: &'a Row,
        /// The sphere's file.
        sphere: &'a Path,
        /// Report on the map.
        report: &'a Report,
        /// Whether the sphere is that of an earlier run.
        reused: bool,
    },
    /// Some vertices of a row aren't read.
    LeftOut {
        /// The row.
        row: &'a Row,
        /// Their number.
        vertices: usize,
        /// The number of all vertices.
        all: usize,
    },
    /// A row's fit has a warning.
    FitWarning {
        /// The row.
        row: &'a Row,
        /// The warning.
        warning: &'a FitWarning,
        /// Settings of the fit.
        params: &'a FitParams,
    },
    /// A row is finished.
    Finished {
        /// The row's index.
        number: usize,
        /// The row.
        row: &'a Row,
        /// Its line in the table of outcomes.
        entry: &'a Entry,
        /// Its outcome.
        outcome: Outcome<'a>,
        /// The model's file, which may not exist. The line of the table has it as text.
        model: &'a Path,
    },
    /// Rows over one sphere have been fitted together.
    Fitted(&'a ManyReport),
    /// A warning of a row that others may repeat.
    RowWarning(&'a str),
    /// A warning.
    Warning(&'a str),
    /// A warning of the cohort, at the end of the run: inputs that occur twice, models that reproduce the voxels'
    /// steps.
    CohortWarning(&'a str),
    /// A note.
    Note(&'a str),
}

/// Outcome of a row.
#[derive(Debug)]
pub enum Outcome<'a> {
    /// Its model was made.
    Done(Box<RowFit>),
    /// Its model exists.
    Skipped {
        /// Of a volume, the label.
        label: Option<i64>,
    },
    /// It can't be fitted.
    Failed(&'a RunError),
    /// The run ended before it was finished.
    Interrupted,
}

/// The fit of a row.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RowFit {
    /// The model and the files beside it.
    pub files: ModelFiles,
    /// Distances, settings and warnings of the fit.
    pub report: FitReport,
    /// Number of vertices that weren't read.
    pub left_out: usize,
    /// The sphere that the surface was mapped to, if it came without one.
    pub mapped: Option<Mapping>,
}

/// The sphere that a surface was mapped to.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Mapping {
    /// The file.
    #[serde(serialize_with = "crate::files::serialize_shown")]
    pub sphere: PathBuf,
    /// Repair of a volume's label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repair: Option<Repair>,
    /// Repair of a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh_repair: Option<BTreeMap<&'static str, usize>>,
    /// Handles that were cut.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handles: Option<HandlesReport>,
    /// Report on the map.
    #[serde(flatten)]
    pub report: Report,
}

impl Mapping {
    pub(super) fn new(sphere: PathBuf, surface: &MappedSurface) -> Self {
        Self {
            sphere,
            repair: surface.repair,
            mesh_repair: surface.mesh_repair.map(|repair| repair.counts().into_iter().collect()),
            handles: surface.handles.clone(),
            report: surface.parametrized.map.report.clone(),
        }
    }
}
