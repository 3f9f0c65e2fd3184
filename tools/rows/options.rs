//! What a verb asks for all of its rows.

use std::path::PathBuf;

use anyhow::Result;
use serde_json::{Map, Value};
use spharm::cohort::Row;
use spharm::rerun::IfExists;
use spharm::{FitParams, Preparation, Sphere, Target};
use spharm_cli::surfaces::{SurfaceReader, VoxelSize};
use spharm_cli::threads::Threads;

use super::args::CohortArgs;
use super::evaluate::Evaluate;

/// Surfaces to fit.
pub(crate) struct Rows {
    /// Those of this call's shard.
    pub(crate) rows: Vec<Row>,
    /// The folder that models are relative to.
    pub(crate) folder: PathBuf,
    /// The sphere of all rows, where it has been read.
    pub(crate) sphere: Option<Sphere>,
    /// Whether outputs are looked at before any work, so that a call which can't end well doesn't begin.
    pub(crate) check_first: bool,
}

/// Takes or refuses a surface that was read over its sphere.
pub(crate) type Check = Box<dyn Fn(&Row, &Sphere, Result<Target>) -> Result<Target> + Send + Sync>;

/// What a verb asks for all of its rows.
pub(crate) struct Options {
    pub(crate) params: FitParams,
    pub(crate) cohort: CohortArgs,
    /// Repair labels and meshes.
    pub(crate) fix: bool,
    /// Size of volumes' voxels, where their files don't say it.
    pub(crate) voxel_size: Option<VoxelSize>,
    /// Vertices that aren't read: those with 0 in this file.
    pub(crate) mask: Option<PathBuf>,
    /// Cut the handles of meshes.
    pub(crate) cut_handles: bool,
    pub(crate) coefficients_csv: bool,
    pub(crate) if_exists: IfExists,
    pub(crate) report: Option<PathBuf>,
    /// Print the report in place of the table.
    pub(crate) json: bool,
    pub(crate) threads: Threads,
    /// What the report says of the call beside what is fitted.
    pub(crate) about: Map<String, Value>,
    /// Whether models that don't correspond are brought together by what comes after.
    pub(crate) aligned_later: bool,
    /// What a verb knows of a surface and its sphere, or of why they don't go together.
    pub(crate) check: Option<Check>,
    /// A sphere on which every model is evaluated.
    pub(crate) evaluate: Option<Evaluate>,
}

impl Options {
    /// Whether a report that exists is replaced: it is that of an earlier call which this one goes on with.
    pub(crate) fn replaces_report(&self) -> bool {
        self.if_exists != IfExists::Refuse
    }

    /// What is done to a surface before its fit.
    pub(super) fn preparation(&self, on_sphere: bool, label: Option<i64>) -> Preparation {
        let voxel_size = self.voxel_size.map(|size| size.0);
        Preparation { voxel_size, fix: self.fix, cut_handles: self.cut_handles }.of(on_sphere, label)
    }

    pub(super) fn reader(&self) -> SurfaceReader {
        SurfaceReader::new(self.fix, self.cut_handles, self.voxel_size)
    }
}
