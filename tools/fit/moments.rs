//! Fits models to moments of samples instead of surfaces.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use serde_json::json;
use spharm::{FileRecord, FitParams, Method, Moments, MomentsFit, fit_moments};
use spharm_cli::Usage;
use spharm_cli::machine::memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::model_files;
use spharm_cli::output::{OutputFile, check_outputs, is_stdout, prepare, print, print_json, table, write_json};
use spharm_cli::paths::shown;
use spharm_cohort::files::ModelFiles;
use spharm_model::csv::write_complex_csv;
use spharm_monitor::number;
use spharm_surface::io::write_new;

use super::args::Cli;

/// Fits a model to the samples whose moments are in the file at `path`.
pub(super) fn run(cli: &Cli, path: &Path, params: &FitParams, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    if cli.input.weights != "uniform" {
        return Err(Usage::conflict(
            "--weights cannot be used with --moments, because moments already include weights",
        )
        .into());
    }
    let params = params.clone().with_store(None).with_method(Method::Lsq);
    let inputs = [(path.to_owned(), None)];
    let mut models = model_files(cli.output.output.as_deref(), &cli.output.name_template, &inputs)?;
    let files = ModelFiles { model: models.remove(0) };
    let beside = [cli.output.coefficients_csv.then(|| files.csv()), cli.output.stderr.then(|| files.standard_errors())];
    let beside: Vec<PathBuf> = beside.into_iter().flatten().collect();
    let outputs = std::iter::once(&files.model).chain(&beside).map(|path| OutputFile::new(path, "--output"));
    let report = cli.output.report.iter().map(|path| OutputFile::new(path, "--report"));
    check_outputs(outputs.chain(report), cli.output.force)?;
    let moments = Moments::read(path)?;
    let fit = cli.resources.threads.pool()?.install(|| fit_moments(&moments, &params, monitor))?;
    fit.report.warnings.iter().for_each(|warning| monitor.console().warn(format!("{}: {warning}", path.display())));
    write(cli, path, &files, &fit)?;
    let seconds = started.elapsed().as_secs_f64();
    let report = json!({
        "tool": "fit",
        "versions": spharm::versions(),
        "method": "lsq",
        "moments": shown(path),
        "scheme_key": fit.report.scheme.map(|key| key.to_string()),
        "output": shown(&files.model),
        "fit": fit.report,
        "seconds": { "total": seconds },
        "memory": memory(),
    });
    if let Some(path) = &cli.output.report {
        write_json(path, cli.output.force, &report)?;
    }
    if cli.output.report.as_deref().is_some_and(is_stdout) {
        return Ok(());
    }
    if cli.output.json {
        return print_json(&report);
    }
    let mut rows = vec![["channel", "rms", "explained"].map(str::to_owned).to_vec()];
    let removed = &fit.report.denoise;
    if !removed.is_empty() {
        rows[0].extend(["sigma", "freedom"].map(str::to_owned));
    }
    let channels = fit.report.channels.iter().zip(&fit.report.rms).zip(&fit.report.explained);
    rows.extend(channels.map(|((name, rms), share)| {
        let cells = [rms.map(number), share.map(|share| format!("{share:.4}"))];
        std::iter::once(name.clone()).chain(cells.map(|cell| cell.unwrap_or_else(|| "-".to_owned()))).collect()
    }));
    for (channel, row) in rows.iter_mut().skip(1).enumerate() {
        // The three channels of a surface share one noise estimate; a signal has one estimate for each channel.
        if let Some(of) = removed.get(channel.min(removed.len().saturating_sub(1))) {
            row.extend([number(of.sigma), format!("{:.0}", of.degrees_of_freedom)]);
        }
    }
    print(&format!("{}\n{}: {} samples, {seconds:.2} s", table(&rows), files.model.display(), moments.sums.count))
}

/// Writes the model and its companion files. The model is written last, so that its existence implies that the
/// companion files exist.
fn write(cli: &Cli, path: &Path, files: &ModelFiles, fit: &MomentsFit) -> Result<()> {
    let force = cli.output.force;
    prepare(&files.model)?;
    if cli.output.coefficients_csv {
        write_new(files.csv(), force, |out| write_complex_csv(&fit.coefficients, out))?;
    }
    let mut model = fit.model();
    if let Some(errors) = &fit.standard_errors {
        files.write_standard_errors(errors, force)?;
    }
    model.provenance.input = Some(FileRecord::of(path)?);
    Ok(model.write_with(&files.model, force)?)
}
