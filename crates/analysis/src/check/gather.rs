//! Reads the inputs of the check: models, distances from the mean, scores, warnings, and subjects without a model.

use std::collections::{HashMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use spharm::correspond::IDENTICAL_TO;
use spharm::shape::{ShapeError, Similarity, rmsd};
use spharm::{Model, Monitor, Stage};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::paths::model_name;
use spharm_cohort::check::{Facts, Measure, subject_of};
use spharm_monitor::OnlyCancel;
use spharm_surface::io::bytes_to_read;

use super::super::frames;
use super::super::table::Table;
use super::args::Cli;
use super::evaluated::extent;
use spharm_cli::inputs::read_warnings;
use spharm_cli::models::surface_path;

/// State of a subject. The table lists the subjects by state, in the order of these variants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum State {
    Flagged,
    Failed,
    Accepted,
    Ok,
    Excluded,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Flagged => "flagged",
            Self::Failed => "failed",
            Self::Accepted => "accepted",
            Self::Ok => "ok",
            Self::Excluded => "excluded",
        })
    }
}

/// A subject without a model.
pub(super) struct WithoutModel {
    pub(super) id: String,
    pub(super) state: State,
    /// Reason why there is no model.
    pub(super) reason: String,
}

/// Facts about a subject that has a model.
pub(super) struct Found {
    pub(super) facts: Facts,
    /// Size of the surface's file in bytes; 0 if the file is missing.
    pub(super) surface_bytes: u64,
    /// Lowest and highest coordinates of the model in the frame in which the subjects are drawn.
    pub(super) extent: [[f64; 3]; 2],
}

/// The inputs of the quality control.
pub(super) struct Inputs {
    pub(super) models: Vec<PathBuf>,
    pub(super) names: Vec<String>,
    /// Paths of the aligned models, in the order of `models`.
    aligned: Option<Vec<PathBuf>>,
    mean: Option<Model>,
    scores: Option<Vec<Vec<f64>>>,
    /// Transforms from the surfaces' frames to the aligned models' frames.
    frames: Option<Vec<Similarity>>,
    /// Warnings about each subject, without the name at the beginning of each warning.
    warnings: Vec<Vec<String>>,
    /// Subjects whose flags were accepted, each with the reason, which may be empty.
    pub(super) accepted: HashMap<String, String>,
    pub(super) others: Vec<WithoutModel>,
}

impl Inputs {
    pub(super) fn read(cli: &Cli, models: Vec<PathBuf>, aligned: Option<Vec<PathBuf>>) -> Result<Self> {
        let names: Vec<String> = models.iter().map(|path| model_name(path)).collect();
        let mut places = HashMap::new();
        for (at, name) in names.iter().enumerate() {
            if places.insert(name.as_str(), at).is_some() {
                bail!("{}: another model has the same name, {name}; give only one of the two", models[at].display());
            }
        }
        let aligned = aligned.map(|paths| in_order(&names, paths)).transpose()?;
        let status = cli.status.as_deref().map(Table::read).transpose()?;
        let others = status.as_ref().map_or(Ok(Vec::new()), |table| without_model(table, &places))?;
        let accepted = status.as_ref().map_or(Ok(HashMap::new()), accepted)?;
        let frames = cli.frames.as_deref().map(|path| frames::read(path, &names)).transpose()?;
        let texts = cli.warnings.iter().map(|path| read_warnings(path)).collect::<Result<Vec<_>>>()?.concat();
        let warnings = by_subject(texts, &places, names.len());
        let scores = cli.scores.as_deref().map(|path| scores(&Table::read(path)?, &names)).transpose()?;
        let mean = cli.mean.as_ref().map(Model::read).transpose()?;
        Ok(Self { mean, scores, aligned, frames, warnings, accepted, others, models, names })
    }

    /// Returns the files of all models, including the aligned models.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        self.models.iter().chain(self.aligned.iter().flatten()).cloned().collect()
    }

    /// Collects the facts about each subject.
    pub(super) fn find(&self, monitor: &ConsoleMonitor) -> Result<Vec<Found>> {
        monitor.begin(Stage::counted("check", "models"), self.models.len() as u64);
        let found = self.models.par_iter().enumerate().map(|(index, path)| {
            monitor.check()?;
            let found = self.find_one(index, path, monitor).with_context(|| path.display().to_string());
            monitor.step(1);
            found
        });
        let found = found.collect();
        monitor.end();
        found
    }

    fn find_one(&self, index: usize, path: &Path, monitor: &ConsoleMonitor) -> Result<Found> {
        let model = Model::read(path)?;
        let mut facts = Facts::of(&self.names[index], &model, &OnlyCancel(monitor))?;
        let surface_bytes = surface_path(&model, path).map_or(0, |surface| bytes_to_read(&surface));
        let extent = extent(&model, &self.pose(index))?;
        drop(model);
        if let (Some(mean), Some(aligned)) = (&self.mean, &self.aligned) {
            let aligned = Model::read(&aligned[index])?;
            // A model whose degree differs from the degree of the mean has no distance from the mean.
            facts.measures[Measure::Distance as usize] = match rmsd(&aligned.coefficients, &mean.coefficients) {
                Ok(distance) => Some(distance),
                Err(ShapeError::Differ { .. }) => None,
                Err(error) => return Err(error.into()),
            };
        }
        facts.scores = self.scores.as_ref().map_or(Vec::new(), |scores| scores[index].clone());
        for warning in &self.warnings[index] {
            match warning.strip_prefix(IDENTICAL_TO) {
                Some(other) => facts.identical_to.push(other.to_owned()),
                None => facts.notes.push(warning.clone()),
            }
        }
        Ok(Found { facts, surface_bytes, extent })
    }

    /// Returns the transform from the frame of a subject's surface to the frame in which the subject is drawn: the
    /// aligned models' frame if their transforms are known, otherwise the surface's own frame.
    pub(super) fn pose(&self, index: usize) -> Similarity {
        self.frames.as_ref().map_or_else(Similarity::default, |frames| frames[index])
    }
}

/// Returns the warnings about each subject: the strings that begin with the subject's name and a colon, without this
/// prefix.
fn by_subject(texts: Vec<String>, places: &HashMap<&str, usize>, count: usize) -> Vec<Vec<String>> {
    let mut found = vec![Vec::new(); count];
    for text in texts {
        if let Some((name, text)) = subject_of(&text, |name| places.contains_key(name)) {
            found[places[name]].push(text.to_owned());
        }
    }
    found
}

/// Returns the scores of each subject along the modes.
fn scores(table: &Table, names: &[String]) -> Result<Vec<Vec<f64>>> {
    let rows: HashMap<&str, usize> = table.cells("model")?.into_iter().enumerate().map(|(row, id)| (id, row)).collect();
    let modes = (1..).map(|mode| format!("mode_{mode}")).take_while(|name| table.has(name));
    let modes = modes.map(|name| table.numbers(&name)).collect::<Result<Vec<_>>>()?;
    let row = |name: &String| match rows.get(name.as_str()) {
        Some(row) => Ok(modes.iter().map(|mode| mode[*row]).collect()),
        None => bail!("{}: no scores for {name}", table.path().display()),
    };
    names.iter().map(row).collect()
}

/// Returns the aligned models in the order of the names.
fn in_order(names: &[String], paths: Vec<PathBuf>) -> Result<Vec<PathBuf>> {
    let mut found = HashMap::new();
    for path in paths {
        let name = model_name(&path);
        if let Some(other) = found.insert(name.clone(), path) {
            bail!("--aligned: {}: another model has the same name, {name}", other.display());
        }
    }
    let one = |name: &String| found.remove(name).with_context(|| format!("--aligned: no model named {name}"));
    names.iter().map(one).collect()
}

/// Returns the subjects without a model, as listed in a table of the subjects' states.
fn without_model(table: &Table, places: &HashMap<&str, usize>) -> Result<Vec<WithoutModel>> {
    let (ids, states, errors) = (table.cells("id")?, table.cells("state")?, table.texts("error")?);
    let mut seen = HashSet::new();
    let rows =
        ids.into_iter().zip(states).zip(errors).filter(|((id, _), _)| !places.contains_key(id) && seen.insert(*id));
    let of = |((id, state), reason): ((&str, &str), &str)| {
        let reason = if reason.is_empty() && state != "excluded" { state } else { reason };
        WithoutModel {
            id: id.to_owned(),
            state: if state == "excluded" { State::Excluded } else { State::Failed },
            reason: reason.to_owned(),
        }
    };
    Ok(rows.map(of).collect())
}

/// Returns the subjects whose flags were accepted, with the reasons, as listed in a table of the subjects' states.
fn accepted(table: &Table) -> Result<HashMap<String, String>> {
    if !table.has("accepted") {
        return Ok(HashMap::new());
    }
    let rows = table.cells("id")?.into_iter().zip(table.texts("accepted")?);
    Ok(rows.filter(|(_, reason)| !reason.is_empty()).map(|(id, reason)| (id.to_owned(), reason.to_owned())).collect())
}
