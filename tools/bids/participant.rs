//! Runs the participant level of the BIDS app: fits models and writes the derivatives of each model.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::json;
use spharm::shape::descriptors;
use spharm::{FitParams, Model, Sphere};
use spharm_cli::console::Console;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, print_line};
use spharm_cli::paths::shown;
use spharm_cohort::rerun::IfExists;
use spharm_cohort::run::{Cohort, RunParams, concerns_all};
use spharm_cohort::{Entry, Manifest, Merged, State, StatusFile};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh, write_signal_of};
use spharm_surface::metrics::vertex_distances;
use spharm_surface::{Hemisphere, Signal};

use super::args::{Cli, Hemi};
use super::dataset::{prepare, text};
use super::discover::{Dataset, Found, discover};
use crate::rows::{self, Options, icosphere_within};

/// Fits the surfaces of the subjects and writes their derivatives.
pub(super) fn run(cli: &Cli, spharm: &dyn Fn(&[String]) -> Result<()>) -> Result<()> {
    let (started, monitor) = (Instant::now(), ConsoleMonitor::new(cli.common.console()));
    let console = monitor.console();
    // Check the memory before the fits, because the fits take a long time.
    let budget = cli.memory.budget(cli.threads.count());
    let sphere = icosphere_within(budget, "bids --icosphere ", cli.icosphere, cli.max_degree)?;
    let Dataset { found, missing } = discover(cli)?;
    missing.iter().for_each(|(_, why)| console.warn(why));
    let mut subjects: Vec<&str> = found.iter().map(|found| found.subject.as_str()).collect();
    subjects.dedup();
    prepare(&cli.output, &cli.dataset, &subjects)?;
    check_earlier(cli, &found)?;
    let Logs { manifest, status } = Logs::new(cli, &found)?;
    let cohort =
        Cohort::of_manifest(Manifest::read(&manifest)?, Some(cli.output.clone()), cli.shard.unwrap_or_default());
    let memory = cli.memory.memory.map(|size| size.0);
    let params = FitParams::lsq(cli.max_degree).with_memory(memory).with_threads(cli.threads.count());
    let mut params = RunParams::new(params);
    (params.if_exists, params.status) = (IfExists::Update, Some(status.clone()));
    let fitted = rows::run(&cohort, &Options::new(params, cli.threads), &monitor, started);
    let noted = || -> Result<Merged> {
        if !missing.is_empty() {
            // Record missing surfaces as failed, because the group level reads only the status tables.
            let mut file = StatusFile::open(&status)?;
            for (id, why) in &missing {
                file.append(&Entry { error: why.clone(), ..Entry::new(id, State::Failed) })?;
            }
        }
        Ok(Merged::read(std::slice::from_ref(&status))?)
    };
    let merged = match noted() {
        Ok(merged) => merged,
        // If the fits ended for a reason that concerns all fits, such as a full disk, report this reason instead of the
        // error from reading the outcomes.
        Err(error) => return fitted.and(Err(error)),
    };
    let failed = found.iter().filter(|found| is(&merged, found, &[State::Failed])).count();
    let ends = |error: &anyhow::Error| spharm_cli::exit::is_interrupted(error) || concerns_all(error.as_ref());
    if failed == 0 || fitted.as_ref().is_err_and(ends) {
        fitted?;
    }
    let done: Vec<&Found> = found.iter().filter(|found| is(&merged, found, &[State::Done, State::Skipped])).collect();
    let pool = cli.threads.pool()?;
    for found in &done {
        if spharm_cli::exit::cancel().load(std::sync::atomic::Ordering::Relaxed) {
            return Err(spharm_monitor::Interrupted.into());
        }
        pool.install(|| derive(cli, found, &sphere)).with_context(|| found.id())?;
    }
    if !cli.no_pages {
        pages(cli, &done, console, spharm)?;
    }
    print_line(&format!(
        "{}: {} of {}",
        cli.output.display(),
        counted(done.len(), "model"),
        counted(subjects.len(), "subject")
    ))?;
    match failed + missing.len() {
        0 => Ok(()),
        lost => bail!("{} could not be fitted; see {} for the reasons", counted(lost, "surface"), status.display()),
    }
}

/// Refuses to replace models of another degree or surfaces on another icosphere, unless `--force` is given.
fn check_earlier(cli: &Cli, found: &[Found]) -> Result<()> {
    let sampled = format!("_space-icosphere{}_", cli.icosphere);
    for found in found.iter().filter(|_| !cli.force) {
        let (model, sidecar) = (cli.output.join(found.model()), cli.output.join(found.sidecar()));
        let described = spharm_files::read_text(&sidecar, 1 << 20).ok().filter(|_| model.is_file());
        let described = described.and_then(|text| serde_json::from_str::<serde_json::Value>(&text).ok());
        let degree = described.as_ref().and_then(|described| described["MaximalDegree"].as_u64());
        if let Some(degree) = degree.filter(|degree| *degree != cli.max_degree as u64) {
            bail!(
                "{}: the model exists with degree {degree} (requested: {}); give --force to replace the model, or \
                 choose another OUT",
                model.display(),
                cli.max_degree
            );
        }
        let name = |path: &PathBuf| path.file_name().is_some_and(|name| !name.to_string_lossy().contains(&sampled));
        if let Some(other) = found.evaluations(&cli.output).iter().find(|path| name(path)) {
            bail!(
                "{}: the existing file is a surface on another icosphere (requested: {}); give --force to replace the \
                 file, or choose another OUT",
                other.display(),
                cli.icosphere
            );
        }
    }
    Ok(())
}

fn is(merged: &Merged, found: &Found, states: &[State]) -> bool {
    merged.entry(&found.id()).is_some_and(|entry| states.contains(&entry.state))
}

/// Paths of two tables that one call writes: the table of its surfaces, and the table of their outcomes.
struct Logs {
    manifest: PathBuf,
    status: PathBuf,
}

impl Logs {
    /// Writes the table of surfaces, and returns the paths of both tables. The names of both files depend on the
    /// contents of the table of surfaces, so that calls for different subjects write different files.
    fn new(cli: &Cli, found: &[Found]) -> Result<Self> {
        let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
        writer.write_record(["id", "surface", "sphere", "output"])?;
        for found in found {
            let absolute = |path: &Path| std::path::absolute(path).with_context(|| path.display().to_string());
            let (mesh, sphere) = (absolute(&found.mesh)?, absolute(&found.sphere)?);
            writer.write_record([&found.id(), &shown(&mesh), &shown(&sphere), &shown(found.model())])?;
        }
        let table = String::from_utf8(writer.into_inner()?)?;
        let key = blake3::hash(table.as_bytes()).to_hex();
        let at = |name: &str| cli.output.join("logs").join(format!("participant-{}{name}.tsv", &key[..8]));
        let shard =
            cli.shard.as_ref().map_or(String::new(), |shard| format!("-{}", shard.to_string().replace('/', "-of-")));
        let (manifest, status) = (at(""), at(&format!("{shard}_status")));
        text(&manifest, &table)?;
        Ok(Self { manifest, status })
    }
}

/// Writes the derivatives of a model: the sidecar with the provenance, the spectrum, the surface evaluated on the
/// icosphere, and the distances between model and surface at the vertices.
fn derive(cli: &Cli, found: &Found, sphere: &Sphere) -> Result<()> {
    let at = |path: PathBuf| cli.output.join(path);
    let model = Model::read(at(found.model()))?;
    let degree = model.coefficients.max_degree();
    let sidecar = json!({
        "Description": "Spherical-harmonic model of a surface",
        "MaximalDegree": degree,
        "Convention": spharm::model::CONVENTION,
        "Sources": [shown(&found.mesh), shown(&found.sphere)],
        "Provenance": model.provenance,
    });
    text(&at(found.sidecar()), &(serde_json::to_string_pretty(&sidecar)? + "\n"))?;
    let mut spectrum = "degree\tpower\n".to_owned();
    for (index, power) in descriptors(&model.coefficients)?.power.iter().enumerate() {
        spectrum += &format!("{}\t{power:?}\n", index + 1);
    }
    text(&at(found.spectrum()), &spectrum)?;
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    let cortex = match found.hemi {
        Hemi::L => Hemisphere::Left.cortex(),
        Hemi::R => Hemisphere::Right.cortex(),
    };
    let mut evaluated = model.reconstruct(sphere, degree)?;
    evaluated.meta.anatomical_structure_primary.get_or_insert(cortex.to_owned());
    let path = at(found.evaluated(cli.icosphere, evaluated.vertices.len()));
    write_mesh(&path, &evaluated, &options)?;
    // At this point, files on other icospheres exist only if `--force` was given. Remove these files.
    for other in found.evaluations(&cli.output).into_iter().filter(|other| *other != path) {
        std::fs::remove_file(&other).with_context(|| other.display().to_string())?;
    }
    let surface = read_mesh(&found.mesh)?;
    let fitted = model.reconstruct_original(degree)?.mesh;
    let distances = vertex_distances(&surface.vertices, &fitted.vertices)?;
    let signal = Signal { vertices: distances.len(), values: distances, channels: 1 };
    write_signal_of(at(found.error()), &signal, Some(cortex), &options)?;
    Ok(())
}

/// Writes a page for each subject with all of its models.
fn pages(cli: &Cli, done: &[&Found], console: &Console, spharm: &dyn Fn(&[String]) -> Result<()>) -> Result<()> {
    for group in done.chunk_by(|a, b| a.subject == b.subject) {
        let subject = format!("sub-{}", group[0].subject);
        let page = cli.output.join(format!("{subject}.html"));
        console.detail(format!("{}", page.display()));
        let mut arguments = vec!["report".to_owned()];
        arguments.extend(group.iter().map(|found| shown(cli.output.join(found.model()))));
        arguments.push("--surface".to_owned());
        arguments.extend(group.iter().map(|found| shown(&found.mesh)));
        arguments.extend(["--title", &subject, "--force", "--output", &shown(&page)].map(str::to_owned));
        spharm(&super::command(cli, arguments))?;
    }
    Ok(())
}
