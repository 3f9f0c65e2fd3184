//! `volumes`: a model of every label of many volumes, and one table.

mod args;
mod table;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use spharm::files::{MadeOf, ModelFiles, Replace};
use spharm::fit_mesh::steps_of;
use spharm::parametrize::Input;
use spharm::parametrize::volume::{LabelVolume, VolumeParams, is_volume, steps_of_labels};
use spharm::rerun::{Decision, IfExists, Refusal, Request};
use spharm::shape::{MeasureParams, descriptors, measure};
use spharm::{FileRecord, FitParams, Monitor, Preparation};
use spharm_cli::exit;
use spharm_cli::inputs::{expand_lists, read_text};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print_line};
use spharm_cli::surfaces::Labels;
use spharm_model::Model;
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;
use self::table::{Outcome, Row};
use crate::rows::equal::Inputs;

/// Relative change of the area that ends its quadrature: far below what voxels tell.
const AREA: f64 = 1e-5;
/// Most bytes of a table of an earlier call.
const LARGEST: u64 = 1 << 30;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let monitor = ConsoleMonitor::new(cli.common.console());
    let table = cli.table.clone().unwrap_or_else(|| cli.output.join("volumes.tsv"));
    let replaced = cli.force || cli.skip_existing || is_without_models(&table);
    if table.is_file() && !replaced {
        bail!(
            "{}: the file exists; --skip-existing goes on with it, --force replaces it, --output or --table names another",
            table.display()
        );
    }
    check_outputs([OutputFile::with_ending(&table, "--table", &[".tsv"])], replaced)?;
    let earlier = if cli.skip_existing && table.is_file() { Some(earlier(&table, cli.max_degree)?) } else { None };
    let volumes = volumes(&cli.volumes)?;
    let memory = cli.memory.map(|size| size.0);
    let params = FitParams { memory, threads: Some(cli.threads.count()), ..FitParams::lsq(cli.max_degree) };
    params.check()?;
    let (rows, names, inputs) = (Vec::new(), HashSet::new(), Inputs::default());
    let mut call = Call { cli, params, monitor: &monitor, rows, refused: 0, names, inputs };
    let pool = cli.threads.pool()?;
    let done = pool.install(|| volumes.iter().try_for_each(|path| call.volume(path)));
    prepare(&table)?;
    let text = table::lines(&call.rows, cli.max_degree);
    let text = earlier.map_or(text.clone(), |earlier| table::with_earlier(&earlier, &text));
    if call.refused > 0 && table.is_file() {
        bail!(
            "{}: {} fitted otherwise, and the table stays as it was; give --force, or another --output",
            table.display(),
            counted_were(call.refused)
        );
    }
    write_new(&table, replaced, |out| out.write_all(text.as_bytes()))?;
    let steps = call.rows.iter().filter_map(|row| match &row.outcome {
        Outcome::Model(model) => Some((row.label.map_or(String::new(), |label| label.to_string()), model.steps?)),
        Outcome::Failed(_) => None,
    });
    let doubts = call.inputs.warnings().into_iter().chain(steps_of_labels(&steps.collect::<Vec<_>>()));
    doubts.for_each(|warning| monitor.console().warn(warning));
    let failed = call.rows.iter().filter(|row| matches!(row.outcome, Outcome::Failed(_))).count();
    let models = call.rows.len() - failed;
    print_line(&format!("{}: {}, {failed} failed", table.display(), counted(models, "model")))?;
    // What interrupted it, after the table of what is finished.
    done?;
    if failed > 0 {
        bail!("{}: {failed} of {} failed, see column error", table.display(), counted(call.rows.len(), "row"));
    }
    Ok(())
}

fn counted_were(models: usize) -> String {
    format!("{} {}", counted(models, "model"), if models == 1 { "was" } else { "were" })
}

/// Whether a table is that of a call whose labels have all failed: nothing is lost with it.
fn is_without_models(table: &Path) -> bool {
    let text = if table.is_file() { read_text(table, "table", LARGEST).unwrap_or_default() } else { String::new() };
    text.starts_with("file\tlabel\tstate\t") && !table::has_models(&text)
}

/// The table that an earlier call has written, of the same columns.
fn earlier(table: &Path, max_degree: usize) -> Result<String> {
    let text = read_text(table, "table", LARGEST)?;
    let (found, expected) = (text.lines().next().unwrap_or_default(), table::head(max_degree));
    if found != expected {
        let powers = found.split('\t').filter(|name| name.starts_with("power_")).count();
        if powers == max_degree {
            let table = table.display();
            bail!("{table}: expected the columns of this version, found others; give --force, or another --output");
        }
        bail!(
            "{}: expected the columns of degree {max_degree}, found those of degree {powers}; give --force, or another --output",
            table.display()
        );
    }
    Ok(text)
}

/// The files that are meant: of a folder the volumes in it.
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
            bail!("{}: a folder without a label volume (.nii, .mgz, .nrrd, .tif, .npy)", path.display());
        }
        files.sort_unstable();
        found.extend(files);
    }
    let mut seen = HashSet::new();
    found.retain(|path| seen.insert(path.clone()));
    Ok(found)
}

/// A call of `volumes`.
struct Call<'a> {
    cli: &'a Cli,
    params: FitParams,
    monitor: &'a ConsoleMonitor,
    rows: Vec<Row>,
    /// Models that are there and were made with other settings or of another input.
    refused: usize,
    /// Models of this call, which two labels mustn't share.
    names: HashSet<PathBuf>,
    /// The labels that were looked at.
    inputs: Inputs,
}

impl Call<'_> {
    /// Makes the models of a volume's labels. Only an interruption is an error.
    fn volume(&mut self, path: &Path) -> Result<()> {
        let voxel_size = self.cli.voxel_size.map(|size| size.0);
        let read = LabelVolume::read_with(path, voxel_size, self.monitor).map_err(anyhow::Error::from);
        let read = read.and_then(|volume| Ok((FileRecord::of(path)?, volume)));
        let (record, volume) = match read {
            Ok(found) => found,
            Err(error) => return self.push(path, None, None, Err(error)),
        };
        let there = volume.labels();
        let every = self.cli.label.contains(&Labels::All);
        let one = |label: &Labels| if let Labels::One(label) = label { Some(*label) } else { None };
        let wanted =
            if every { there.keys().copied().collect() } else { self.cli.label.iter().filter_map(one).collect() };
        let mut wanted: Vec<i64> = wanted;
        let mut seen = HashSet::new();
        wanted.retain(|label| seen.insert(*label));
        if wanted.is_empty() {
            return self.push(path, None, None, Err(anyhow!("{}: no label but 0", path.display())));
        }
        for label in wanted {
            self.monitor.check()?;
            let record = FileRecord { label: Some(label), ..record.clone() };
            self.inputs.add(&record, None, record.to_string());
            let found = self.label(path, &volume, record);
            self.push(path, Some(&volume), Some(label), found)?;
        }
        Ok(())
    }

    /// Adds a row; an interruption is handed on.
    fn push(
        &mut self,
        path: &Path,
        volume: Option<&LabelVolume>,
        label: Option<i64>,
        found: Result<table::Model>,
    ) -> Result<()> {
        let outcome = match found {
            Ok(model) => Outcome::Model(Box::new(model)),
            Err(error) if exit::is_interrupted(&error) => return Err(error),
            Err(error) => {
                self.refused += usize::from(self.cli.skip_existing && error.is::<Refusal>());
                let text = exit::line_with_advice(&error);
                self.monitor.console().warn(&text);
                Outcome::Failed(text)
            }
        };
        let here = volume.zip(label);
        self.rows.push(Row {
            file: path.display().to_string(),
            label,
            voxels: here.and_then(|(volume, label)| volume.labels().get(&label).copied()),
            // Of a label that isn't there nothing is known.
            border: here
                .filter(|(volume, label)| volume.labels().contains_key(label))
                .map(|(volume, label)| volume.touches_border(label)),
            outcome,
        });
        Ok(())
    }

    fn label(&mut self, path: &Path, volume: &LabelVolume, record: FileRecord) -> Result<table::Model> {
        let label = record.label;
        let named = self.cli.name_template.outputs(&[(path.to_owned(), label)], &self.cli.output, ".spharm.npz")?;
        let model = named.into_iter().next().unwrap_or_default();
        if !self.names.insert(model.clone()) {
            bail!("{record}: {} is another label's model; give --name-template", model.display());
        }
        let files = ModelFiles { model };
        let if_exists = match (self.cli.force, self.cli.skip_existing) {
            (true, _) => IfExists::Replace,
            (_, true) => IfExists::Skip,
            _ => IfExists::Refuse,
        };
        // A label without handles has no cut surface, and is finished all the same.
        let cut = (self.cli.cut_handles && !if_exists.keeps()).then(|| files.cut_surface());
        let beside: Vec<PathBuf> = [files.sphere(), files.surface()].into_iter().chain(cut).collect();
        let (params, output) = (&self.params, files.model.as_path());
        let preparation = self.preparation(record.label);
        let request = Request {
            id: None,
            input: &record,
            region: None,
            sphere: None,
            params,
            preparation,
            output,
            beside: &beside,
            if_exists,
        };
        let (kept, residual) = match request.decide()? {
            Decision::Skip => (true, None),
            Decision::Fit { replace, .. } => (false, Some(self.fit(volume, &record, &files, replace)?)),
        };
        let model = Model::read(&files.model)?;
        let recorded = || model.provenance.distances.as_ref().map(|distances| distances.rms());
        let named = || record.to_string();
        let measures = MeasureParams { tolerance: AREA, most_rings: None };
        Ok(table::Model {
            file: files.model.display().to_string(),
            kept,
            repair: table::repair(&model.provenance),
            steps: steps_of(&model.provenance),
            measures: measure(&model.coefficients, &measures, self.monitor).with_context(named)?,
            residual: residual.or_else(recorded),
            descriptors: descriptors(&model.coefficients).with_context(named)?,
        })
    }

    /// What is done to a label before its fit.
    fn preparation(&self, label: Option<i64>) -> Preparation {
        let voxel_size = self.cli.voxel_size.map(|size| size.0);
        Preparation { voxel_size, fix: self.cli.fix, cut_handles: self.cli.cut_handles }.of(false, label)
    }

    /// Maps and fits a label, and returns the root mean square distance at the vertices.
    fn fit(&self, volume: &LabelVolume, record: &FileRecord, files: &ModelFiles, replace: Replace) -> Result<f64> {
        let console = self.monitor.console();
        let handles = self.cli.cut_handles;
        let params = VolumeParams { label: record.label, fix: self.cli.fix, handles };
        let named = || record.to_string();
        let mut input = Input::Label(volume.surface(&params, self.monitor)?);
        if handles {
            input = input.without_handles(self.monitor).with_context(named)?;
        }
        input.changes(handles).iter().for_each(|change| console.note(format!("{record}: {change}")));
        let found = files.map(&input, record, &self.params, false, replace, self.monitor).with_context(named)?;
        let fitted = || -> Result<f64> {
            let (fit, _) = found.surface.fit(&self.params, self.monitor)?;
            let (preparation, surface) = (self.preparation(record.label), Some(&found.surface));
            let made_of = MadeOf { input: Some(record), preparation, surface, ..MadeOf::default() };
            files.write(&found.surface.parametrized.sphere, &fit, &made_of, false, replace)?;
            console.note(format!("{record}: {}", files.model.display()));
            Ok(fit.report.passes.last().map_or(f64::NAN, |distances| distances.rms()))
        };
        fitted().inspect_err(|_| found.remove()).with_context(named)
    }
}
