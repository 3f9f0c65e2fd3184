//! `volumes`: makes a model of every label of many volumes, and one table of all models.

mod args;
mod names;
mod table;
mod warnings;

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result, anyhow, bail};
use serde_json::json;
use spharm::fit_mesh::steps_of;
use spharm::parametrize::volume::{VoxelValues, is_volume, steps_of_labels};
use spharm::shape::{MeasureParams, descriptors, measure};
use spharm::{FileRecord, FitParams, Model, Monitor, Preparation};
use spharm_cli::exit;
use spharm_cli::inputs::{expand_lists, keep_each_once};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::NameTemplate;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print_json, print_line};
use spharm_cli::paths::natural_order;
use spharm_cli::surfaces::Labels;
use spharm_cohort::degree::degree_of_labels;
use spharm_cohort::equal::Inputs;
use spharm_cohort::reader::SurfaceReader;
use spharm_cohort::run::{self, Cohort, Event, Observer, Outcome as RowOutcome, RunError, RunParams};
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;
use self::names::{advice_on_images, same_name};
use self::table::{Outcome, Row};
use crate::rows::if_exists;

/// Relative change of the area at which its quadrature stops; far below the accuracy of a surface made of voxels.
const AREA: f64 = 1e-5;
/// Number of table rows above which the warnings about repairs are repeated at the end.
const LONG: usize = 10;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let monitor = ConsoleMonitor::new(cli.common.console());
    let table = cli.table.clone().unwrap_or_else(|| cli.output.join("volumes.tsv"));
    let replaced = cli.force || cli.skip_existing || table::is_without_models(&table);
    if table.is_file() && !replaced {
        bail!(
            "{}: the file exists; give --skip-existing to resume, --force to replace the file, or another --output or \
             --table{}",
            table.display(),
            advice_on_images(cli.volume.reading().image)
        );
    }
    check_outputs([OutputFile::with_ending(&table, "--table", &[".tsv", ".csv"])], replaced)?;
    let (volumes, image) = (volumes(&cli.volumes)?, cli.volume.reading().image);
    let template = cli.name_template.of(image)?;
    let resumed = cli.skip_existing && table.is_file();
    let earlier = if resumed { Some(table::earlier(&table, image, cli.max_degree)?) } else { None };
    let earlier = earlier.filter(|text| table::has_models(text));
    let (reading, label_surface) = (cli.volume.reading(), cli.label_surface.surface(&cli.volume)?);
    let preparation =
        Preparation { reading, label_surface, fix: cli.fix, cut_handles: cli.cut_handles, ..Preparation::default() };
    let reader = SurfaceReader::new(preparation);
    let max_degree = match (cli.max_degree, &earlier) {
        (Some(degree), _) => degree,
        (None, Some(earlier)) => {
            let degree = table::powers(earlier);
            monitor.console().note(format!("degree {degree}, as in {}", table.display()));
            degree
        }
        (None, None) => suitable_degree(cli, &volumes, &reader, &monitor)?,
    };
    let memory = cli.memory.map(|size| size.0);
    let params = FitParams::lsq(max_degree).with_memory(memory).with_threads(cli.threads.count());
    params.check()?;
    let mut params = RunParams::new(params);
    params.preparation = preparation;
    params.if_exists = if_exists(cli.force, false, cli.skip_existing);
    let found = Mutex::default();
    let mut call = Call {
        cli,
        template,
        params,
        reader: &reader,
        monitor: &monitor,
        found,
        names: HashMap::new(),
        inputs: Inputs::default(),
    };
    let pool = cli.threads.pool()?;
    let done = pool.install(|| volumes.iter().try_for_each(|path| call.volume(path)));
    prepare(&table)?;
    let Found { rows, refused, losses, skipped } = call.found.into_inner().unwrap_or_else(PoisonError::into_inner);
    let text = table::lines(&rows, image, max_degree);
    let text = earlier.map_or(text.clone(), |earlier| table::with_earlier(&earlier, &text, image));
    if refused > 0 && table.is_file() {
        bail!(
            "{}: {} {} fitted with other settings or inputs, so the table was left unchanged; give --force, or choose \
             another --output{}",
            table.display(),
            counted(refused, "model"),
            if refused == 1 { "was" } else { "were" },
            advice_on_images(image)
        );
    }
    let known: HashSet<OsString> = table::models(&text).into_iter().chain(skipped).collect();
    let as_json = cli.json.then(|| table::to_json(&text));
    let written = table::to_file(&table, text)?;
    write_new(&table, replaced, |out| out.write_all(written.as_bytes()))?;
    let steps = rows.iter().filter_map(|row| match &row.outcome {
        Outcome::Model(model) => Some((row.name(), model.steps?)),
        Outcome::Failed(_) | Outcome::Skipped(_) => None,
    });
    let doubts = call.inputs.warnings().into_iter().chain(steps_of_labels(&steps.collect::<Vec<_>>()));
    // A run that was interrupted doesn't warn about models from an earlier run, because it may not have reached their
    // labels yet.
    let whole = done.is_ok() && cli.table.is_none();
    let others = whole.then(|| warnings::of_earlier_runs(&cli.output, &table, &known)).flatten();
    let doubts = doubts.chain(warnings::of_volumes(&rows)).chain(warnings::cut_off(&rows)).chain(reader.warnings());
    doubts.chain(others).for_each(|warning| monitor.console().warn(warning));
    let failed = rows.iter().filter(|row| matches!(row.outcome, Outcome::Failed(_))).count();
    let skipped = rows.iter().filter(|row| matches!(row.outcome, Outcome::Skipped(_))).count();
    let models = counted(rows.len() - failed - skipped, "model");
    let repaired = rows.iter().filter(|row| matches!(&row.outcome, Outcome::Model(model) if !model.repair.is_empty()));
    let repaired = repaired.count();
    let repaired = if repaired > 0 { format!(", {repaired} repaired") } else { String::new() };
    let skipped = if skipped > 0 { format!(", {skipped} skipped") } else { String::new() };
    match as_json {
        Some(rows) => print_json(&json!({
            "tool": "volumes",
            "versions": spharm::versions(),
            "table": table.display().to_string(),
            "max_degree": max_degree,
            "rows": rows,
        }))?,
        None => print_line(&format!("{}: {models}{repaired}{skipped}, {failed} failed", table.display()))?,
    }
    if rows.len() > LONG && !losses.is_empty() {
        monitor.console().note("\nwarnings of this run, repeated:");
        losses.iter().for_each(|warning| monitor.console().warn(warning));
    }
    // If the run was interrupted, return the error only now that the table of the finished rows has been written.
    done?;
    if failed > 0 {
        bail!("{}: {failed} of {} failed; see the column `error`", table.display(), counted(rows.len(), "row"));
    }
    Ok(())
}

/// Returns the degree that suits the chosen labels in the first volume that contains any of them.
fn suitable_degree(cli: &Cli, volumes: &[PathBuf], reader: &SurfaceReader, monitor: &ConsoleMonitor) -> Result<usize> {
    for path in volumes {
        let read = reader.volume(path, monitor);
        monitor.check()?;
        // Skip a volume that can't be read; its failure is reported later, with the reason.
        let Ok(volume) = read else { continue };
        let there = volume.labels();
        let kept = |label: i64| {
            let voxels = *there.get(&label)?;
            // The border is checked only for --skip-border, because with --fix the check is slow for a large label.
            let border = cli.skip_border && volume.touches_border_if(label, cli.fix, monitor).ok()?;
            cli.reason_to_skip(voxels, border).is_none().then_some(voxels)
        };
        let sizes: Vec<usize> = Labels::of(&cli.label, &there).into_iter().filter_map(kept).collect();
        if !sizes.is_empty() {
            let chosen = degree_of_labels(&sizes, volume.voxel_size());
            monitor.console().note(format!("{chosen} in {}; use --max-degree L for another degree", path.display()));
            return Ok(chosen.degree());
        }
    }
    // No label will be fitted, so the degree has no effect.
    Ok(1)
}

/// Returns the given files. Each folder is replaced by the volumes in this folder.
fn volumes(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for path in expand_lists(given)? {
        if !path.is_dir() {
            found.push(path);
            continue;
        }
        let read = || format!("{}: cannot read the folder", path.display());
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&path).with_context(read)? {
            let file = entry.with_context(read)?.path();
            if is_volume(&file) && file.is_file() {
                files.push(file);
            }
        }
        if files.is_empty() {
            bail!("{}: the folder has no label volume (.nii, .mgz, .nrrd, .tif, .npy)", path.display());
        }
        natural_order(&mut files);
        found.extend(files);
    }
    keep_each_once(&mut found);
    Ok(found)
}

impl Cli {
    /// Returns the reason to skip a label of `voxels` voxels; `border` states whether it touches the border of its
    /// volume. Returns `None` if the label isn't skipped.
    fn reason_to_skip(&self, voxels: usize, border: bool) -> Option<String> {
        if voxels < self.min_voxels {
            return Some(format!("{}, fewer than --min-voxels {}", counted(voxels, "voxel"), self.min_voxels));
        }
        (self.skip_border && border).then(|| "at the border of the volume".to_owned())
    }
}

/// State of a call of the verb `volumes`.
struct Call<'a> {
    cli: &'a Cli,
    /// Names of the models.
    template: NameTemplate,
    params: RunParams,
    reader: &'a SurfaceReader,
    monitor: &'a ConsoleMonitor,
    found: Mutex<Found>,
    /// Path of each model of this call, with the path of its volume. A label whose model has the path of another model
    /// is refused.
    names: HashMap<PathBuf, PathBuf>,
    /// Labels processed so far.
    inputs: Inputs,
}

/// The rows of the table so far, and facts about existing models.
#[derive(Default)]
struct Found {
    rows: Vec<Row>,
    /// Number of existing models that were made with other settings or from another input.
    refused: usize,
    /// Warnings about repairs that changed a large part of a label.
    losses: Vec<String>,
    /// File names of existing models whose labels were skipped. Other warnings report these models.
    skipped: Vec<OsString>,
}

/// Observer of the run that fits a volume's labels.
struct OfVolume<'a> {
    call: &'a Call<'a>,
    /// Rows of the table, one for each label that is fitted; their outcomes are filled in when the fits end.
    rows: Vec<Row>,
}

impl Call<'_> {
    /// Makes the models of a volume's labels. Returns an error only if interrupted; failures become table rows.
    fn volume(&mut self, path: &Path) -> Result<()> {
        let read = self.reader.volume(path, self.monitor);
        let read = read.map_err(anyhow::Error::from).and_then(|volume| Ok((FileRecord::of(path)?, volume)));
        let file = path.display().to_string();
        let row = |label, outcome| Row { file: file.clone(), label, voxels: None, border: None, volume: None, outcome };
        let (record, volume) = match read {
            Ok(found) => found,
            Err(error) => return self.failed(row(None, Outcome::default()), &error),
        };
        let there = volume.labels();
        let wanted = Labels::of(&self.cli.label, &there);
        if wanted.is_empty() {
            return self.failed(
                row(None, Outcome::default()),
                &anyhow!("{file}: the volume has only label 0, the background"),
            );
        }
        let (mut fits, mut rows) = (Vec::new(), Vec::new());
        let (before, reading) = (self.lock().rows.len(), self.reader.reading());
        // With grey values or probabilities, the number of voxels doesn't determine the volume.
        let voxel = (reading.values == VoxelValues::Labels).then(|| volume.affine.determinant().abs());
        for &label in &wanted {
            let record = record.clone().with_label(label, [reading.image.channel, reading.image.time]);
            let row = Row {
                voxels: there.get(&label).copied(),
                // `None` if the volume has no such label.
                border: there
                    .contains_key(&label)
                    .then(|| volume.touches_border_if(label, self.cli.fix, self.monitor))
                    .transpose()?,
                volume: there.get(&label).zip(voxel).map(|(&voxels, voxel)| voxels as f64 * voxel),
                ..row(Some(label), Outcome::default())
            };
            let model = self.output(path, label)?;
            let known = row.voxels.zip(row.border);
            if let Some(reason) = known.and_then(|(voxels, border)| self.cli.reason_to_skip(voxels, border)) {
                if model.is_file() {
                    self.lock().skipped.extend(model.file_name().map(ToOwned::to_owned));
                    let model = model.display();
                    self.monitor
                        .console()
                        .warn(format!("{record}: skipped ({reason}), but its model {model} exists; delete this file"));
                }
                self.lock().rows.push(Row { outcome: Outcome::Skipped(reason), ..row });
                continue;
            }
            self.inputs.add(&record, None, record.to_string());
            if let Some(first) = self.names.get(&model) {
                let error = same_name(&record, &model, first, path);
                self.failed(row, &error)?;
                continue;
            }
            self.names.insert(model.clone(), path.to_owned());
            let (id, surface, output) = (record.to_string(), path.to_owned(), Some(model));
            fits.push(spharm_cohort::Row { id, surface, label: Some(label), output, ..Default::default() });
            rows.push(row);
        }
        let observer = OfVolume { call: self, rows };
        let cohort = Cohort::new(fits, PathBuf::new());
        let ended = run::run_reading(&cohort, &self.params, self.reader, &observer, self.monitor);
        // The rows are in the order in which labels finish, with skipped labels first. Sort them in the order of the
        // labels.
        let places: HashMap<i64, usize> = wanted.iter().enumerate().map(|(place, label)| (*label, place)).collect();
        self.lock().rows[before..].sort_by_key(|row| row.label.and_then(|label| places.get(&label).copied()));
        match ended {
            // The failed rows record failures such as a full disk; continue with the next volume.
            Err(error) if !error.is_interrupted() => Ok(()),
            done => Ok(done?),
        }
    }

    /// Returns the path of a label's model.
    fn output(&self, volume: &Path, label: i64) -> Result<PathBuf> {
        let named = [(volume.to_owned(), Some(label))];
        let named = self.template.outputs(&named, &self.cli.output, ".spharm.npz")?;
        Ok(named.into_iter().next().unwrap_or_default())
    }

    fn lock(&self) -> MutexGuard<'_, Found> {
        self.found.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds the row of a label or volume that failed with `error`. Returns an error only if the call is interrupted.
    fn failed(&self, row: Row, error: &anyhow::Error) -> Result<()> {
        self.monitor.check()?;
        let text = exit::line_with_advice(error.as_ref());
        self.monitor.console().warn(&text);
        self.lock().rows.push(Row { outcome: Outcome::Failed(text), ..row });
        Ok(())
    }

    /// Returns the values of a model for its row in the table.
    fn model(&self, path: &Path, name: &str, fitted: Option<f64>) -> Result<table::Model> {
        let model = Model::read(path)?;
        let recorded = || model.provenance.distances.as_ref().map(|distances| distances.rms());
        let measures = MeasureParams { tolerance: AREA, most_rings: None };
        Ok(table::Model {
            file: path.display().to_string(),
            kept: fitted.is_none(),
            repair: table::repair(&model.provenance),
            cut: table::handles_cut(&model.provenance) > 0,
            steps: steps_of(&model.provenance),
            measures: measure(&model.coefficients, &measures, self.monitor).with_context(|| name.to_owned())?,
            residual: fitted.or_else(recorded),
            descriptors: descriptors(&model.coefficients).with_context(|| name.to_owned())?,
        })
    }
}

impl Observer for OfVolume<'_> {
    fn event(&self, event: &Event<'_>) {
        let console = self.call.monitor.console();
        let (number, row, entry, outcome, model) = match event {
            Event::Finished { number, row, entry, outcome, model } => (*number, row, entry, outcome, *model),
            Event::Warning(text) => return console.note(text),
            Event::RowWarning(text) => {
                self.call.lock().losses.push((*text).to_owned());
                return console.warn(text);
            }
            _ => return,
        };
        let of = |fitted: Option<f64>| self.call.model(model, &row.id, fitted);
        let found = match outcome {
            RowOutcome::Done(fit) => {
                console.note(format!("{}: {}", row.id, model.display()));
                of(Some(fit.report.passes.last().map_or(f64::NAN, |distances| distances.rms())))
            }
            RowOutcome::Skipped { .. } => of(None),
            RowOutcome::Failed(error) => {
                let refused = self.call.cli.skip_existing && matches!(error, RunError::Output(_));
                self.call.lock().refused += usize::from(refused);
                Err(anyhow!("{}", entry.error))
            }
            RowOutcome::Interrupted => return,
        };
        let outcome = match found {
            Ok(model) => Outcome::Model(Box::new(model)),
            Err(error) if exit::is_interrupted(&error) => return,
            Err(error) => {
                let text = exit::line_with_advice(error.as_ref());
                console.warn(&text);
                Outcome::Failed(text)
            }
        };
        self.call.lock().rows.push(Row { outcome, ..self.rows[number].clone() });
    }

    fn line(&self, error: &RunError) -> String {
        exit::line_with_advice(error)
    }
}
