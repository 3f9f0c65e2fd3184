//! Implements the verb `study`, which makes a page from a table of subjects. Each stage is a command of spharm.
//!
//! | module | contents |
//! |---|---|
//! | `config`, `keys`, `subjects` | the study's file, its keys and its table of subjects |
//! | `sides` | both sides of each subject, such as hemispheres |
//! | `surfaces` | the table of meshes that are made to correspond |
//! | `fits` | the fits of the subjects' surfaces and signals |
//! | `plan`, `lists` | the study's files and their locations, and the lists that stages read |
//! | `paths` | paths that don't depend on the current folder |
//! | `provenance`, `methods` | the record of the study, and the paragraph for a paper |
//! | `stages` | the commands of the study |
//! | `check`, `emptied` | checks before any command is run, and after the fits |
//! | `ending` | the output of a study at its end |
//! | `stage` | one command, and the decision whether it must run |
//! | `foreign` | refusal to replace files that the study hasn't written |
//! | `tidy` | removal of files that no longer belong to the study |
//! | `hemispheres` | warning about fits with a sphere or mask of the other hemisphere |
//! | `voxels` | warning about groups with voxels of different sizes |
//! | `warnings` | the warnings at the head of the page |

mod args;
mod check;
mod config;
mod emptied;
mod ending;
mod exclusion;
mod fits;
mod foreign;
mod hemispheres;
mod init;
mod keys;
mod lists;
mod methods;
mod paths;
mod plan;
mod provenance;
mod sides;
mod stage;
mod stages;
mod subjects;
mod surfaces;
mod test;
mod tidy;
mod voxels;
mod warnings;

use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::console::Console;
use spharm_cli::output::{Muted, counted, print, print_json, print_line};
use spharm_cli::paths::utf8;
use spharm_cohort::Manifest;
use spharm_cohort::run::concerns_all;
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;
use self::args::Command;
use self::config::Method;
use self::fits::{Fits, Outcomes};
use self::plan::Plan;
use self::provenance::Provenance;
use self::stage::Stage;
use self::warnings::Flagged;

/// Minimum number of subjects in a group.
const LEAST: usize = 3;

/// Function that previews the fits of the subjects of a manifest.
type Preview = dyn Fn(&[String], Manifest) -> Result<crate::rows::Previewed>;

/// Writes a study file. Keys are filled in from the table and from the files below the study file's folder.
fn init(file: &Path, table: Option<&str>, force: bool, console: &Console) -> Result<()> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let text = match table {
        None => config::template(None),
        Some(table) => {
            let found = init::filled(folder, table)?;
            found.notes.iter().for_each(|note| console.note(note));
            found.text
        }
    };
    write_new(file, force, |out| out.write_all(text.as_bytes()))?;
    let file = file.display();
    print_line(&format!("{file}: check this file, then run: spharm study {file}"))
}

/// Runs the verb. `spharm` runs another verb, `parse` only checks another verb's arguments, and `preview` previews a
/// fit.
pub(crate) fn run(
    cli: &Cli,
    spharm: &dyn Fn(&[String]) -> Result<()>,
    parse: &dyn Fn(&[String]) -> Result<()>,
    preview: &Preview,
) -> Result<()> {
    if let Some(Command::Init { file, table, force }) = &cli.command {
        return init(file, table.as_deref(), *force, &cli.common.console());
    }
    let (plan, recorded) = match (&cli.again, &cli.study) {
        (Some(path), _) => {
            utf8(path)?;
            let recorded = Provenance::read(path)?;
            let common = if common(cli).is_empty() { recorded.arguments() } else { common(cli) };
            (recorded.plan(path, cli.output.as_deref(), common)?, Some(recorded))
        }
        (None, Some(study)) => {
            // The path must be UTF-8, because the other verbs get their arguments as text.
            utf8(study)?;
            (Plan::read(study, cli.output.clone(), common(cli))?, None)
        }
        (None, None) => bail!("give the path of a study file; `spharm study init` writes a template"),
    };
    let study = &plan.file;
    check::check(&plan)?;
    let mut call = Call {
        cli,
        plan: &plan,
        recorded: recorded.as_ref(),
        spharm,
        console: cli.common.console(),
        rows: Vec::new(),
        flagged: Vec::new(),
        failed: Vec::new(),
        warnings: Vec::new(),
        compared: None,
    };
    let (count, table) = (plan.manifest.rows.len(), plan.table.display());
    let subjects = match plan.excluded.len() {
        0 => counted(count, plan.row_noun()),
        excluded => format!("{count} of {} ({excluded} excluded)", counted(count + excluded, plan.row_noun())),
    };
    call.console.note(format!("{}: {subjects} in {table}", plan.study.title));
    for fits in plan.fits() {
        let fit = plan.fit(&fits, cli.shard, cli.force);
        parse(&call.arguments(&fit)).with_context(|| format!("{}: `arguments` in [fit]", study.display()))?;
    }
    // Wrong values in the study's file are found before the fits, which take long.
    let planned = plan.stages(&plan.subjects_planned());
    for stage in &planned {
        parse(&call.arguments(stage)).with_context(|| format!("{}: {}", study.display(), stage.name))?;
    }
    if !cli.force {
        foreign::check(&plan, &planned)?;
    }
    if cli.dry_run {
        return call.show(preview);
    }
    let folders = [plan.records().join("warnings"), plan.records().join("reports")];
    for folder in folders.into_iter().chain(plan.fits().into_iter().map(|fits| fits.status)) {
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let lock = lock(&plan, cli.shard.is_some())?;
    tidy::leftovers(&plan);
    plan.write_manifests()?;
    let muted = cli.json.then(Muted::begin);
    let done = call.run();
    drop((muted, lock));
    if cli.json {
        print_json(&call.report(&done)?)?;
    }
    done
}

/// Locks the study for this process; jobs that fit shards share the lock. If the file system doesn't support locks, the
/// study runs without one.
fn lock(plan: &Plan, shared: bool) -> Result<File> {
    let path = plan.records().join(".lock");
    let options = File::options().create(true).append(true).clone();
    let file = spharm_files::open_with(&path, &options).with_context(|| path.display().to_string())?;
    if let Err(TryLockError::WouldBlock) = if shared { file.try_lock_shared() } else { file.try_lock() } {
        bail!(
            "{}: the study is already running; wait until the other run ends, or stop the other run",
            plan.file.display()
        );
    }
    Ok(file)
}

/// Returns the arguments of the study that are passed to all of its commands.
fn common(cli: &Cli) -> Vec<String> {
    let threads = cli.resources.threads.threads.iter().flat_map(|count| ["--threads".to_owned(), count.to_string()]);
    threads.chain(cli.resources.memory.arguments()).collect()
}

/// State of a call of the verb `study`.
struct Call<'a> {
    cli: &'a Cli,
    plan: &'a Plan,
    /// Record of an earlier run, with which the results are compared.
    recorded: Option<&'a Provenance>,
    spharm: &'a dyn Fn(&[String]) -> Result<()>,
    console: Console,
    /// Stages that have ended.
    rows: Vec<ending::Done>,
    /// Subjects flagged by the quality control, the worst first.
    flagged: Vec<Flagged>,
    /// Subjects that couldn't be fitted, with the reasons.
    failed: Vec<(String, String)>,
    /// Warnings about the whole group.
    warnings: Vec<String>,
    /// Comparison with the results of an earlier run, if one is made.
    compared: Option<ending::Compared>,
}

impl Call<'_> {
    /// Prints the commands as if all subjects had been fitted, then the preview of the fits. Returns an error if some
    /// fits would fail.
    fn show(&self, preview: &Preview) -> Result<()> {
        let subjects = self.plan.subjects_planned();
        for fits in self.plan.fits() {
            print(&self.plan.fit(&fits, self.cli.shard, self.cli.force).command())?;
        }
        if self.cli.shard.is_none() {
            self.plan.stages(&subjects).iter().try_for_each(|stage| print(&stage.command()))?;
        }
        let mut failing = Ok(());
        for fits in self.plan.fits() {
            let fit = self.plan.fit(&fits, self.cli.shard, self.cli.force);
            let found = preview(&self.arguments(&fit), fits.manifest.clone())?;
            self.console.note("");
            found.text.lines().for_each(|line| self.console.note(line));
            failing = failing.and(found.error.map_or(Ok(()), Err));
        }
        failing
    }

    fn run(&mut self) -> Result<()> {
        for fits in self.plan.fits() {
            self.fit(&fits)?;
        }
        let outcomes = Outcomes::read(&self.plan.fits())?;
        self.failed = outcomes.failed(&self.plan.manifest);
        if self.cli.shard.is_some() {
            return self.finish();
        }
        let subjects = self.plan.subjects(&outcomes);
        if subjects.len() < LEAST {
            bail!(
                "{}: expected {LEAST} subjects or more that can be fitted, found {}; \
                 `spharm status {}` shows why the others failed",
                self.plan.table.display(),
                subjects.len(),
                self.plan.status_of_failures().display()
            );
        }
        let signals = tidy::signals(self.plan)?;
        if signals > 0 {
            let removed = counted(signals, "model");
            self.console.note(format!("removed {removed} of signals, because the study no longer has a signal"));
        }
        let removed: usize = self.plan.fits().iter().map(tidy::models).sum::<Result<_>>()?;
        if removed > 0 {
            let removed = counted(removed, "model");
            self.console.note(format!(
                "removed {removed} of subjects that are excluded, could not be fitted or are no longer in the table"
            ));
        }
        let (plan, failed, pool) = (self.plan, &self.failed, self.cli.resources.threads.pool()?);
        self.warnings.extend(pool.install(|| hemispheres::differ(plan, &subjects))?);
        self.warnings.extend(pool.install(|| check::fitted(plan, &subjects, failed))?);
        self.plan.write_lists(&subjects)?;
        self.plan.write_status(&outcomes)?;
        let stages = self.plan.stages(&subjects);
        tidy::stages(self.plan, &stages)?;
        let Some((page, stages)) = stages.split_last() else { return self.finish() };
        for (index, stage) in stages.iter().enumerate() {
            self.stage(stage)?;
            if stage.name == stages::CHECK {
                let (flagged, warnings) = warnings::of_check(self.plan)?;
                self.flagged = flagged;
                self.warnings.extend(warnings);
                if self.cli.strict && !self.flagged.is_empty() {
                    return self.stop(stages[index + 1..].iter().chain([page]));
                }
            }
        }
        self.warnings.extend(warnings::of_group(self.plan, &subjects)?);
        self.plan.write_warnings(&self.warnings)?;
        let made = self.record(subjects.len(), &stages.iter().chain([page]).collect::<Vec<_>>())?;
        self.stage(page)?;
        let finished = self.finish();
        print_line(&format!("page: {}", self.plan.page().display()))?;
        let Some(recorded) = self.recorded else { return finished };
        // If subjects failed, this alone isn't a difference, because they may have failed in the recorded run, too. If
        // they succeeded in the recorded run, the comparison reports their results as missing.
        if let Err(error) = finished {
            self.console.warn(error);
        }
        let compared = self.compared.insert(ending::Compared::new(recorded, &made));
        ending::tell(compared)
    }

    /// Writes the paragraph on methods and the record of the study.
    fn record(&self, subjects: usize, stages: &[&Stage]) -> Result<Provenance> {
        let (plan, output) = (self.plan, &self.plan.output);
        let made = Provenance::of(plan, self.cli.resources.threads.count(), stages)?;
        let failed: Vec<&str> = self.failed.iter().map(|(id, _)| id.as_str()).collect();
        let flagged: Vec<&str> = self.flagged.iter().map(|flagged| flagged.id.as_str()).collect();
        let methods = methods::text(plan, subjects, &failed, &flagged)?;
        for (name, text) in [(methods::FILE, methods), (provenance::FILE, made.text()?)] {
            plan::write_changed(&output.join(name), &text)?;
        }
        Ok(made)
    }

    /// Ends a study with `--strict` before the tests, because a subject is flagged. Removes an earlier run's outputs of
    /// the stages in `later`.
    fn stop<'s>(&mut self, later: impl IntoIterator<Item = &'s Stage>) -> Result<()> {
        later.into_iter().try_for_each(|stage| stage.clear(&self.plan.records()))?;
        for name in [methods::FILE, provenance::FILE] {
            tidy::file(&self.plan.output.join(name))?;
        }
        self.warnings.clear();
        let ended = self.finish();
        let (flagged, table) = (counted(self.flagged.len(), "subject"), self.plan.checked());
        let text = format!(
            "{}: {flagged} flagged by the quality control, so no tests were run and no page was written; repair the \
             surfaces of these subjects, list the subjects in `exclude` or `accept` in [subjects], or run without \
             --strict; for pictures of the subjects, see {}",
            table.display(),
            self.plan.thumbnails().display()
        );
        match ended {
            Ok(()) => bail!(text),
            Err(error) => Err(error.context(text)),
        }
    }

    /// Fits the subjects. Subjects that fail are listed at the end; any other error ends the study.
    fn fit(&mut self, fits: &Fits<'_>) -> Result<()> {
        let stage = self.plan.fit(fits, self.cli.shard, self.cli.force);
        let started = Instant::now();
        let shard = self.cli.shard.unwrap_or_default();
        for id in tidy::damaged(fits, shard.of(&fits.manifest.rows), &fits.merged()?)? {
            self.console.warn(format!("{id}: the model was damaged; fitting the subject again"));
        }
        self.console.note(format!("\n{}", stage.command()));
        let muted = (!self.prints(&stage)).then(Muted::begin);
        let ran = (self.spharm)(&self.arguments(&stage));
        drop(muted);
        if ran.as_ref().is_err_and(spharm_cli::exit::is_interrupted) {
            let again = format!("interrupted; resume with: spharm study {}", self.plan.file.display());
            return Err(anyhow::Error::from(spharm_monitor::Interrupted).context(again));
        }
        // If an error concerns all fits, such as a full disk, the study ends with this error.
        if ran.as_ref().is_err_and(|error| concerns_all(error.as_ref())) || fits.failed(&fits.merged()?).is_empty() {
            ran?;
        }
        self.row(fits.name, "done", started);
        Ok(())
    }

    /// Runs a stage, unless its outputs are up to date.
    fn stage(&mut self, stage: &Stage) -> Result<()> {
        let (records, started) = (self.plan.records(), Instant::now());
        self.console.note(format!("\n{}", stage.command()));
        if !self.cli.force && stage.is_done(&records)? {
            self.row(&stage.name, "up to date", started);
            return Ok(());
        }
        stage.clear(&records)?;
        let muted = (!self.prints(stage)).then(Muted::begin);
        (self.spharm)(&self.arguments(stage)).with_context(|| format!("{} ({})", stage.name, stage.command()))?;
        drop(muted);
        stage.finish(&records)?;
        self.row(&stage.name, "done", started);
        Ok(())
    }

    /// Returns whether a stage prints its tables. The quality control, the tests and the fits of a shard print tables,
    /// and with `--verbose` all stages. Other tables are only in the study's files.
    fn prints(&self, stage: &Stage) -> bool {
        let is_result = stage.name == stages::CHECK || stage.name.starts_with("test.");
        is_result || self.cli.shard.is_some() || self.cli.common.verbose
    }

    /// Returns the complete command, including the arguments that the study passes on.
    fn arguments(&self, stage: &Stage) -> Vec<String> {
        let mut arguments = vec!["spharm".to_owned()];
        arguments.extend(stage.arguments.iter().cloned());
        let later = stage.name == fits::SURFACES && matches!(self.plan.method, Method::Correspond | Method::Joint);
        arguments.extend(later.then(|| "--aligned-later".to_owned()));
        let threaded = !matches!(stage.arguments[0].as_str(), "picture" | "report");
        arguments.extend(self.plan.common.iter().filter(|_| threaded).cloned());
        arguments.extend(self.cli.common.quiet.then(|| "--quiet".to_owned()));
        arguments.extend(self.cli.common.verbose.then(|| "--verbose".to_owned()));
        arguments
    }

    fn row(&mut self, stage: &str, state: &str, started: Instant) {
        let seconds = started.elapsed().as_secs_f64();
        self.rows.push(ending::Done { stage: stage.to_owned(), state: state.to_owned(), seconds });
    }
}
