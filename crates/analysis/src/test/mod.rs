//! `shape test`: tests groups, covariates and means at every vertex of a common sampling.

mod args;
mod hemispheres;
mod measures;
mod pairs;
mod places;
mod question;
mod regions;
mod results;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm::shape::memory::regions_bytes;
use spharm::shape::stats::{PermutationParams, Remedy, SpatialParams, SurfaceGraph, TestParams, TestWarning, test};
use spharm::shape::{Measurement, measure_group};
use spharm::{Kind, Model, Sphere};
use spharm_cli::Usage;
use spharm_cli::inputs::read_sphere;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::check_outputs;
use spharm_cli::output::{OutputFile, prepare};
use spharm_surface::Signal;
use spharm_surface::io::{Output, WriteOptions, read_annotation, write_mesh, write_signal_of};

pub(super) use self::args::Cli;
pub use self::args::SUBDIVISIONS;
use self::args::What;
use self::measures::{Measures, Tested};
use self::places::Places;
use self::results::MAPS;
use super::groups::read_group;
use super::masks::{self, Masks};
use super::outputs::{finish, write_text};
use super::plan::Plan;

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let console = monitor.console();
    let study = cli.study()?;
    let (kind, measurement) = match cli.signal {
        What::Normal => (Kind::Surface, Measurement::Normal),
        What::Position => (Kind::Surface, Measurement::Position),
        What::Value => (Kind::Signal, Measurement::Value),
    };
    let about_file = cli.file("test.json");
    let map_files = MAPS.map(|name| cli.map_files(name).0);
    let mean_file = cli.file("mean.surf.gii");
    let table_file = cli.file("test.csv");
    let maps_out = map_files.iter().map(|path| OutputFile::holding(path, "--output", Output::Signal));
    let (clusters_file, summary_file) = (cli.file("clusters.csv"), cli.file("summary.csv"));
    let more = [
        OutputFile::new(&summary_file, "--output"),
        OutputFile::new(&clusters_file, "--output"),
        OutputFile::new(&mean_file, "--output"),
        OutputFile::new(&table_file, "--output"),
        OutputFile::new(&about_file, "--output"),
    ];
    let of_report = cli.report.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    check_outputs(maps_out.chain(more).chain(of_report), cli.report.force)?;
    let plan = Plan::new("test", &study.paths, cli.resources.both())?;
    let sphere = match &cli.sphere {
        Some(path) => {
            plan.budget.check_inputs("shape test", [path.as_path()])?;
            Some(read_sphere(path, false, console)?)
        }
        None => None,
    };
    let spatial = cli.tfce || cli.cluster.is_some();
    if cli.permutations == 0 && (spatial || cli.blocks.is_some() || cli.errors.is_some()) {
        let text = "--blocks, --errors, --tfce and --cluster need relabellings: give --permutations 1 or more";
        return Err(Usage::conflict(text).into());
    }
    if cli.variance_groups.is_some() && cli.signal == What::Position {
        let text = "--variance-groups needs `--signal normal` or `--signal value`, found `--signal position`";
        return Err(Usage::conflict(text).into());
    }
    if cli.surface.is_some() && cli.signal != What::Value {
        return Err(Usage::conflict(
            "--surface can be given only with `--signal value`; results of surfaces are drawn on the mean of the tested surfaces",
        )
        .into());
    }
    let shown_on = match &cli.surface {
        Some(path) => {
            plan.budget.check_inputs("shape test", [path.as_path()])?;
            let model = Model::read(path)?;
            if model.kind() != Kind::Surface {
                bail!("{}: expected a model of a surface for --surface, found a model of a signal", path.display());
            }
            Some(model)
        }
        None => None,
    };
    let components = if cli.signal == What::Position { 3 } else { 1 };
    let of = |vertices: u64| plan.group.test(vertices, components, cli.permutations, plan.threads);
    let needed = |[vertices, faces]: [u64; 2]| {
        let regions = if spatial { regions_bytes(vertices, plan.threads) } else { 0 };
        let squares = if cli.variance_groups.is_some() { 16 * study.paths.len() as u64 } else { 0 };
        let maps = of(vertices).saturating_add(regions).saturating_add(squares.saturating_mul(vertices));
        plan.coefficients().saturating_add(maps).saturating_add(24 * (vertices + faces))
    };
    let icosphere = sphere.is_none().then_some(cli.icosphere);
    plan.check_sampling(icosphere, plan.sampling(icosphere, sphere.as_ref()), needed)?;
    let sphere = match sphere {
        Some(sphere) => sphere,
        None => Sphere::icosphere(cli.icosphere),
    };
    let read = |path: &PathBuf| read_annotation(path, sphere.directions.len());
    let annotation = cli.annotation.as_ref().map(read).transpose()?;
    let measures = (!cli.measures.is_empty())
        .then(|| Measures::of(&study, &cli.measures, &|text| console.warn(text)))
        .transpose()?;
    let sampling = masks::sampling(cli.sphere.as_deref(), cli.icosphere);
    let masks = Masks::read(&cli.mask, &sphere, &sampling, "give the mask's own sphere with --sphere")?;
    let mask = &masks.kept;
    let permutations = PermutationParams { count: cli.permutations, seed: cli.seed, ..PermutationParams::default() };
    let mut params = TestParams {
        permutations: (cli.permutations > 0).then_some(permutations),
        welch: cli.welch,
        variance_groups: study.variance_groups.clone(),
        errors: cli.errors,
        blocks: study.blocks.clone(),
        level: cli.level,
        ..TestParams::default()
    };
    if spatial && sphere.faces.is_empty() {
        let text = "--tfce and --cluster need a sphere with triangles: give a sphere mesh with --sphere";
        return Err(Usage::conflict(text).into());
    }
    let (group, mut mean, found, measured) = cli.resources.threads.pool()?.install(|| -> Result<_> {
        let group = read_group(&study.paths, kind, cli.max_degree, monitor, console)?;
        let field = measure_group(&group.members, &sphere.directions, measurement, monitor)?;
        let field = if study.pairs { field.differences()? } else { field };
        let field = match mask {
            Some(kept) => field.at(kept)?,
            None => field,
        };
        let mean = match kind {
            Kind::Surface => Some((Model::without_sphere(field.mean.clone(), Kind::Surface), group.degree)),
            _ => shown_on.as_ref().map(|model| (model.clone(), model.coefficients.max_degree())),
        };
        let mean = mean.filter(|_| !sphere.faces.is_empty());
        let mean = mean.map(|(model, degree)| model.reconstruct(&sphere, degree)).transpose()?;
        if spatial {
            // For a signal without a surface to show it on, the areas of the sphere are used.
            let vertices = mean.as_ref().map_or(sphere.directions.as_slice(), |mean| &mean.vertices);
            let surface = SurfaceGraph::new(vertices, &sphere.faces)?;
            let surface = match mask {
                Some(kept) => surface.at(kept)?,
                None => surface,
            };
            params.spatial = Some(SpatialParams { surface, tfce: cli.tfce, cluster: cli.cluster });
        }
        let (design, contrast) = (&study.question.design, &study.question.contrast);
        let found = test(field.values.view(), field.components, design, contrast, &params, monitor)?;
        let measured = measures.map(|measures| measures.test(&study, &params, monitor)).transpose()?;
        Ok((group, mean, found, measured))
    })?;
    let hemispheres = if study.pairs { &group.sides } else { &group.hemispheres };
    let sides = hemispheres::warnings(cli, &sphere, &study.paths, hemispheres);
    study.notes().iter().for_each(|note| console.note(note));
    let of_test = study.question.warnings.iter().chain(&found.warnings).map(advised);
    let tested: Vec<String> = study.warnings.iter().cloned().chain(sides).chain(of_test).collect();
    tested.iter().for_each(|warning| console.warn(warning));
    let options = WriteOptions { overwrite: cli.report.force, double: false };
    let maps = results::maps(&found, mask.as_deref());
    prepare(&table_file)?;
    let structure = structure(&sphere, &study.paths);
    // Collect the files from an earlier test that this test doesn't replace; --force allows their removal.
    let mut stale: Vec<PathBuf> = Vec::new();
    for name in MAPS {
        let (file, others) = cli.map_files(name);
        stale.extend(others);
        match maps.iter().find(|(written, _)| *written == name) {
            Some((_, values)) => {
                write_signal_of(&file, &Signal::new(values.clone(), values.len(), 1), structure.as_deref(), &options)?
            }
            None => stale.push(file),
        }
    }
    if let Some(mean) = &mut mean {
        mean.meta.anatomical_structure_primary = structure;
        write_mesh(&mean_file, mean, &options)?;
    } else {
        stale.push(mean_file);
    }
    let places = Places::new(&sphere, mean.as_ref(), mask.as_deref(), annotation.as_ref());
    match regions::clusters(&found, &places) {
        Some(table) => write_text(&clusters_file, cli.report.force, &table)?,
        None => stale.push(clusters_file),
    }
    match &measured {
        Some(measured) => write_text(&summary_file, cli.report.force, &measured.table())?,
        None => stale.push(summary_file),
    }
    for file in stale.iter().filter(|file| cli.report.force && file.exists()) {
        std::fs::remove_file(file).with_context(|| file.display().to_string())?;
    }
    write_text(&table_file, cli.report.force, &results::table(&sphere, &maps, mask.as_deref()))?;
    let mut about = results::about(&found, &study, cli, &places, &tested);
    about["without_counterpart"] = masks.without_counterpart.into();
    write_text(&about_file, cli.report.force, &(serde_json::to_string_pretty(&about)? + "\n"))?;
    let warnings: Vec<String> = group.warnings.iter().cloned().chain(tested).collect();
    let mut report = results::report(&found, &study, cli, group.degree, &warnings);
    report["measures"] = measured.as_ref().map(Tested::report).into();
    report["seconds"] = started.elapsed().as_secs_f64().into();
    let mut lines = results::lines(&found, &study, cli);
    lines.extend(measured.iter().flat_map(Tested::lines));
    finish("test", &report, &lines, &cli.report)
}

/// Returns the anatomical structure of the vertices, such as `CortexLeft`, as recorded by the sampling, or else by the
/// first model.
fn structure(sphere: &Sphere, models: &[PathBuf]) -> Option<String> {
    let of_model = || Model::read(models.first()?).ok()?.anatomical_structure();
    sphere.hemisphere().map(|of| of.cortex().to_owned()).or_else(of_model)
}

/// Returns the text of a warning, with the option that remedies the problem, if such an option exists.
fn advised(warning: &TestWarning) -> String {
    match warning {
        TestWarning::UnequalVariances { remedy: Some(Remedy::Welch), .. } => {
            format!("{warning} (give --welch, or welch = true in a study)")
        }
        TestWarning::UnequalVariances { remedy: Some(Remedy::VarianceGroups), .. } => {
            format!("{warning} (give --variance-groups COLUMN, or variance_groups in a study)")
        }
        _ => warning.to_string(),
    }
}
