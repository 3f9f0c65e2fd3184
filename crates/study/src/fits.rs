//! Describes the fits of a study: fits of the subjects' surfaces and, if the study has signals, fits of the signals.

use std::path::PathBuf;

use anyhow::{Context, Result};
use spharm_cohort::{Entry, Manifest, Merged, Shard, State};

/// Name of the stage that fits the surfaces.
pub(super) const SURFACES: &str = "fit";
/// Name of the stage that fits the signals.
pub(super) const SIGNALS: &str = "fit.signal";

/// Folder of the models of signals.
pub(super) const SIGNALS_FOLDER: &str = "signals";

/// The fits of all subjects' surfaces, or of all subjects' signals.
pub(super) struct Fits<'a> {
    /// Name of the stage.
    pub(super) name: &'static str,
    pub(super) manifest: &'a Manifest,
    /// Folder of the models, ID.spharm.npz.
    pub(super) models: PathBuf,
    /// Folder of the status files (tables of outcomes), one file per shard.
    pub(super) status: PathBuf,
}

impl Fits<'_> {
    /// Returns the sorted paths of the status files (`*.tsv`, one per shard) in the status folder.
    pub(super) fn status_files(&self) -> Result<Vec<PathBuf>> {
        let folder = &self.status;
        let read = || format!("{}: cannot read the folder", folder.display());
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).with_context(read)? {
            let path = entry.with_context(read)?.path();
            files.extend(path.extension().is_some_and(|ending| ending == "tsv").then_some(path));
        }
        files.sort_unstable();
        Ok(files)
    }

    /// Returns the path of the table of outcomes for a shard or, without a shard, for all subjects.
    pub(super) fn status_file(&self, shard: Option<Shard>) -> PathBuf {
        let name =
            shard.map_or("all.tsv".to_owned(), |shard| format!("{}.tsv", shard.to_string().replace('/', "-of-")));
        self.status.join(name)
    }

    /// Reads the outcomes of these fits from all status files.
    pub(super) fn merged(&self) -> Result<Merged> {
        Ok(Merged::read(&self.status_files()?)?)
    }

    /// Returns the ids of the subjects whose fits failed, with the reasons.
    pub(super) fn failed(&self, merged: &Merged) -> Vec<(String, String)> {
        failed(self.manifest, |id| merged.entry(id))
    }

    /// Returns whether surfaces are fitted, rather than signals.
    pub(super) fn is_of_surfaces(&self) -> bool {
        self.name == SURFACES
    }

    /// Returns the path of a subject's model.
    pub(super) fn model(&self, id: &str) -> PathBuf {
        self.models.join(format!("{id}.spharm.npz"))
    }
}

/// Returns the ids of the subjects whose outcome is a failure, with the reasons.
fn failed<'a>(manifest: &'a Manifest, entry: impl Fn(&'a str) -> Option<&'a Entry>) -> Vec<(String, String)> {
    let entries = manifest.rows.iter().filter_map(|row| entry(&row.id));
    let failed = entries.filter(|entry| entry.state == State::Failed);
    failed.map(|entry| (entry.id.clone(), entry.error.clone())).collect()
}

/// The outcomes of all fits of a study.
pub(super) struct Outcomes(Vec<Merged>);

impl Outcomes {
    /// Reads the outcomes of all fits.
    pub(super) fn read(fits: &[Fits<'_>]) -> Result<Self> {
        fits.iter().map(Fits::merged).collect::<Result<_>>().map(Self)
    }

    /// Returns the outcome of a subject's fits: the outcome of the first fit without a finished model or, if all models
    /// are finished, the outcome of the first fit. Returns `None` if a fit has no outcome yet.
    pub(super) fn entry(&self, id: &str) -> Option<&Entry> {
        let entries: Vec<&Entry> = self.0.iter().map(|merged| merged.entry(id)).collect::<Option<_>>()?;
        let unfinished = entries.iter().find(|entry| !entry.state.is_there());
        unfinished.or(entries.first()).copied()
    }

    /// Returns the ids of the subjects with a failed fit, with the reasons.
    pub(super) fn failed(&self, manifest: &Manifest) -> Vec<(String, String)> {
        failed(manifest, |id| self.entry(id))
    }

    /// Returns whether all models of a subject are finished.
    pub(super) fn is_done(&self, id: &str) -> bool {
        self.entry(id).is_some_and(|entry| entry.state.is_there())
    }
}
