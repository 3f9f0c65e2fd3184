//! Defines the events that a run reports while it works.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::Serialize;
use spharm::parametrize::volume::Repair;
use spharm::parametrize::{HandlesReport, Report};
use spharm::{FitParams, FitReport, FitWarning, ManyReport, MappedSurface};
use spharm_surface::repair::MeshRepair;

use super::error::RunError;
use super::sync::lock;
use crate::files::ModelFiles;
use crate::{Entry, Row};

/// Receives the events of a run. Several threads may call the methods at the same time.
pub trait Observer: Sync {
    /// Receives an event.
    fn event(&self, event: &Event<'_>) {
        let _ = event;
    }

    /// Formats an error as one line for the table of outcomes.
    fn line(&self, error: &RunError) -> String {
        error.line()
    }
}

/// An observer that ignores all events.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}

/// A row that failed.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Failure {
    /// Id of the row.
    pub id: String,
    /// The error, as one line.
    pub error: String,
}

/// An observer that collects the rows that failed.
#[derive(Debug, Default)]
pub struct Failures(Mutex<Vec<Failure>>);

impl Failures {
    /// Returns the rows that have failed so far, in the order in which they failed.
    pub fn list(&self) -> Vec<Failure> {
        lock(&self.0).clone()
    }
}

impl Observer for Failures {
    fn event(&self, event: &Event<'_>) {
        if let Event::Finished { row, outcome: Outcome::Failed(error), .. } = event {
            lock(&self.0).push(Failure { id: row.id.clone(), error: self.line(error) });
        }
    }
}

/// An event of a run.
#[derive(Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// At least two surfaces are mapped to separate spheres, so their coefficients don't correspond. The value is the
    /// number of these surfaces.
    OwnSpheres(usize),
    /// Work on a row has begun.
    Started {
        /// The row.
        row: &'a Row,
    },
    /// A surface has been mapped to a sphere.
    Mapped {
        /// The row.
        row: &'a Row,
        /// Path of the sphere.
        sphere: &'a Path,
        /// Report on the mapping.
        report: &'a Report,
        /// Whether the sphere was reused from an earlier run.
        reused: bool,
    },
    /// The fit of a row ignores some vertices, because they are outside the mask or have no value.
    LeftOut {
        /// The row.
        row: &'a Row,
        /// Number of ignored vertices.
        vertices: usize,
        /// Number of all vertices.
        all: usize,
    },
    /// The fit of a row has a warning.
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
        /// Index of the row.
        number: usize,
        /// The row.
        row: &'a Row,
        /// The row's line in the table of outcomes.
        entry: &'a Entry,
        /// Outcome of the row.
        outcome: Outcome<'a>,
        /// Path of the model, whether or not the file exists. `entry` has this path only as text, which may be inexact.
        model: &'a Path,
    },
    /// Rows with a common sphere have been fitted together, or a single row has been fitted over its own sphere.
    Fitted {
        /// Report on the fits.
        report: &'a ManyReport,
        /// The rows, in the order of the indices in [`ManyReport::targets`].
        rows: &'a [&'a Row],
    },
    /// A warning about a single row, such as a repair that drops a large part of a label. Other rows may have the same
    /// warning.
    RowWarning(&'a str),
    /// A warning that isn't about a single row.
    Warning(&'a str),
    /// A warning about the cohort, reported at the end of the run: equal inputs, models that reproduce the staircase of
    /// voxels, or voxel sizes that may be wrong.
    CohortWarning(&'a str),
    /// A note that isn't a warning.
    Note(&'a str),
}

/// Outcome of a row.
#[derive(Debug)]
pub enum Outcome<'a> {
    /// The model has been written.
    Done(Box<RowFit>),
    /// The row was skipped because its model exists.
    Skipped {
        /// Label of the surface, if the input is a volume.
        label: Option<i64>,
    },
    /// The row can't be fitted.
    Failed(&'a RunError),
    /// The run ended before the row was finished.
    Interrupted,
}

/// Result of fitting a row.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RowFit {
    /// Paths of the model and the files beside it.
    pub files: ModelFiles,
    /// Distances, settings and warnings of the fit.
    pub report: FitReport,
    /// Number of vertices that the fit ignored.
    pub left_out: usize,
    /// The sphere to which the surface was mapped; `None` if the surface was fitted over a given sphere.
    pub mapped: Option<Mapping>,
}

/// The sphere to which a surface was mapped.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Mapping {
    /// Path of the sphere.
    #[serde(serialize_with = "crate::files::serialize_shown")]
    pub sphere: PathBuf,
    /// Repair of the volume's label, if it was repaired.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repair: Option<Repair>,
    /// Repair of the mesh, if it was repaired.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh_repair: Option<MeshRepair>,
    /// Handles of the surface that were cut, if it had any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handles: Option<HandlesReport>,
    /// Report on the mapping.
    #[serde(flatten)]
    pub report: Report,
}

impl Mapping {
    pub(super) fn new(sphere: PathBuf, surface: &MappedSurface) -> Self {
        Self {
            sphere,
            repair: surface.repair,
            mesh_repair: surface.mesh_repair,
            handles: surface.handles.clone(),
            report: surface.parametrized.map.report.clone(),
        }
    }
}
