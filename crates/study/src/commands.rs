//! Runs the commands of a study, and records their results.

use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::output::{Muted, counted, print, print_line};
use spharm_cohort::run::concerns_all;

use super::call::{Call, Compared, Done, LEAST, PreviewFit};
use super::config::Method;
use super::fits::{Fits, Outcomes};
use super::provenance::Provenance;
use super::stage::Stage;
use super::{check, ending, fits, hemispheres, methods, plan, provenance, stages, tidy, warnings};

impl Call<'_> {
    /// Prints the commands that would run if all subjects were fitted, then a preview of the fits. Returns an error if
    /// some fits would fail.
    pub(super) fn show(&self, preview: &PreviewFit) -> Result<()> {
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

    pub(super) fn run(&mut self) -> Result<()> {
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
        // Subjects that fail don't by themselves make the results differ, because they may have failed in the recorded
        // run, too. If they succeeded in that run, the comparison reports their results as missing.
        if let Err(error) = finished {
            self.console.warn(error);
        }
        let compared = self.compared.insert(Compared::new(recorded, &made));
        ending::tell(compared)
    }

    /// Writes the methods paragraph and the record of the study.
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
    pub(super) fn arguments(&self, stage: &Stage) -> Vec<String> {
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
        self.rows.push(Done { stage: stage.to_owned(), state: state.to_owned(), seconds });
    }
}
