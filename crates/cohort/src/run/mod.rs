//! Runs many fits, one per surface: groups rows by sphere, applies masks, handles existing outputs and failures, and
//! writes models and the table of outcomes.
//!
//! Rows are grouped by sphere, and each group is processed by [`fit_each`](spharm::fit_each), which reads a row's file
//! and checks its outputs just before the row is fitted. Therefore the memory doesn't grow with the number of rows. The
//! model, the sphere and the outcome of a row don't depend on the other rows.
//!
//! | module | contents |
//! |---|---|
//! | `params` | [`Cohort`], [`RunParams`]: rows and settings |
//! | `event` | [`Observer`], [`Event`]: progress by row |
//! | `groups` | rows that share a sphere |
//! | `item` | decisions about existing outputs |
//! | `work` | processing of each row: read, fit, write |
//! | `own_sphere` | fits of surfaces without a sphere |
//! | `mask` | weights, masks and missing values |
//! | `ledger` | outcomes |
//! | `preview` | previews of runs |

mod error;
mod event;
mod groups;
mod item;
mod ledger;
mod mask;
mod own_sphere;
mod params;
mod preview;
pub(crate) mod quiet;
mod sphere;
mod sync;
mod work;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use spharm::Monitor;
use spharm::io::remove_leftovers;
use spharm::parametrize::volume::steps_of_labels;

pub use error::{RunError, chained, concerns_all};
pub use event::{Event, Failure, Failures, Mapping, Observer, Outcome, RowFit, Unobserved};
pub use params::{Check, Cohort, RunParams};
pub use preview::{Preview, PreviewedSphere, preview};
pub use sphere::read_sphere;

use crate::reader::SurfaceReader;
use crate::rerun::IfExists;
use ledger::Ledger;
use sync::lock;
use work::Work;

/// Fits all rows of a cohort, writes their models, and reports each outcome to an observer.
///
/// A row that fails is reported as [`Event::Finished`]. The run then continues with further rows if
/// [`RunParams::keep_going`] is set and the error doesn't concern all rows (see [`RunError::concerns_all`]). Otherwise
/// the run ends.
///
/// ```
/// use spharm::{FitParams, Model, Silent};
/// use spharm_cohort::rows_of_folder;
/// use spharm_cohort::run::{Cohort, Failures, RunParams, run};
/// # use spharm::generate::{Cortex, cortex};
/// # use spharm::prelude::write_mesh;
/// # let folder = tempfile::tempdir()?;
/// # let (meshes, models) = (folder.path().join("meshes"), folder.path().join("models"));
/// # std::fs::create_dir(&meshes)?;
/// # write_mesh(meshes.join("a.ply"), &cortex(&Cortex { subdivisions: 2, variant: 0 }).0)?;
///
/// let failures = Failures::default();
/// let cohort = Cohort::new(rows_of_folder(&meshes)?, &models);
/// run(&cohort, &RunParams::new(FitParams::lsq(4)), &failures, &Silent)?;
/// for failure in failures.list() {
///     eprintln!("{}: {}", failure.id, failure.error);
/// }
/// assert_eq!(Model::read(models.join("a.spharm.npz"))?.coefficients.max_degree(), 4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// [`RunError`] if the failure of a row ends the run, if the table of outcomes can't be written, or if the run is
/// cancelled.
pub fn run(
    cohort: &Cohort,
    params: &RunParams,
    observer: &dyn Observer,
    monitor: &dyn Monitor,
) -> Result<(), RunError> {
    run_reading(cohort, params, &SurfaceReader::new(params.preparation), observer, monitor)
}

/// Fits all rows like [`run`], with the caller's reader, which may already hold the volume of the first rows.
///
/// # Errors
///
/// The errors of [`run`].
pub fn run_reading(
    cohort: &Cohort,
    params: &RunParams,
    reader: &SurfaceReader,
    observer: &dyn Observer,
    monitor: &dyn Monitor,
) -> Result<(), RunError> {
    if params.if_exists != IfExists::Refuse {
        // Remove temporary files of killed processes from the folders of the models. Failures are ignored, because the
        // files do no harm.
        let models = cohort.rows.iter().map(|row| row.model(&cohort.folder));
        let folders: BTreeSet<PathBuf> = models.filter_map(|model| model.parent().map(Path::to_owned)).collect();
        folders.iter().filter(|folder| folder.is_dir()).for_each(|folder| drop(remove_leftovers(folder)));
    }
    let ledger = Ledger::new(observer, cohort.rows.len(), params.status.as_deref())?;
    let work = Work::new(cohort, params, reader, monitor, &ledger);
    let result = work.all();
    if let Err(error) = &result {
        ledger.ended(cohort, error);
    }
    let doubts = lock(&work.inputs).warnings().into_iter().chain(steps_of_labels(&lock(&work.steps)));
    doubts.chain(reader.warnings()).for_each(|warning| observer.event(&Event::CohortWarning(&warning)));
    result
}
