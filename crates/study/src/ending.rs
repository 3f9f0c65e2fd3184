//! Prints the summary at the end of a study: its stages, flagged subjects, warnings and failures, or all of them as
//! JSON.

use anyhow::{Result, bail};
use serde_json::{Value, json};
use spharm_cli::output::{counted, first_of, print, print_line, table};
use spharm_cli::paths::{all_shown, shown};

use super::call::{Call, Compared, Done};
use super::stages::CHECK;
use super::test::Test;
use super::warnings::{Flagged, about, ids_in_state};

/// Maximum number of warnings shown at the end.
const SHOWN: usize = 20;

/// Prints whether the results equal those of an earlier run. If not, returns an error that names the differing
/// results.
pub(super) fn tell(Compared { count, differ }: &Compared) -> Result<()> {
    const NAMED: usize = 5;
    let count = *count;
    if differ.is_empty() {
        return print_line(&format!("{}: identical to the recorded results", counted(count, "result")));
    }
    let names: Vec<String> = differ.iter().map(|path| path.display().to_string()).collect();
    bail!(
        "{} of {} differ from the recorded results: {}; possible causes are a different version, number of threads, \
         memory or processor",
        differ.len(),
        counted(count, "result"),
        first_of(names.iter().map(String::as_str), NAMED)
    )
}

impl Call<'_> {
    /// Returns the report of `--json`; `ended` is the study's result or error.
    pub(super) fn report(&self, ended: &Result<()>) -> Result<Value> {
        let plan = self.plan;
        // If a study ended early, results of an earlier run may exist; don't report these.
        let is_made = |stage: &str| self.rows.iter().any(|done| done.stage == stage);
        let test = |test: &Test| -> Value {
            let folder = plan.test_folder(test);
            let made = is_made(&format!("test.{}", test.name));
            let about = if made { about(plan, test).unwrap_or_default() } else { Value::Null };
            json!({
                "name": test.name,
                "side": test.side,
                "folder": shown(&folder),
                "tested": about["tested"],
                "summary": about["summary"],
                "peak": about["peak"],
            })
        };
        Ok(json!({
            "tool": "study",
            "versions": spharm::versions(),
            "study": shown(&plan.file),
            "output": shown(&plan.output),
            "page": is_made("report").then(|| shown(plan.page())),
            "subjects": plan.subjects_counted(),
            "surfaces": plan.manifest.rows.len(),
            "excluded": plan.excluded.iter().map(|(row, reason)| json!({ "id": row.id, "reason": reason })).collect::<Vec<_>>(),
            "stages": self.rows.iter().map(|Done { stage, state, seconds }| {
                json!({ "stage": stage, "state": state, "seconds": seconds })
            }).collect::<Vec<_>>(),
            "flagged": self.flagged.iter().map(|Flagged { id, flags }| json!({ "id": id, "flags": flags })).collect::<Vec<_>>(),
            "failed": self.failed.iter().map(|(id, error)| json!({ "id": id, "error": error })).collect::<Vec<_>>(),
            "warnings": self.warnings,
            "error": ended.as_ref().err().map(|error| format!("{error:#}")),
            "again": self.compared.as_ref().map(|Compared { count, differ }| {
                json!({ "compared": count, "differ": all_shown(differ) })
            }),
            "tests": plan.study.test.iter().map(test).collect::<Vec<_>>(),
        }))
    }

    /// Lists the flagged subjects on the terminal.
    fn list_flagged(&self) {
        for Flagged { id, flags } in self.flagged.iter().take(SHOWN) {
            self.console.warn(format!("{id}: {}", flags.join("; ")));
        }
        if let Some(more) = self.flagged.len().checked_sub(SHOWN + 1) {
            self.console.warn(format!("and {} flagged", counted(more + 1, "more subject")));
        }
    }

    /// Notes the accepted subjects that the quality control hasn't flagged.
    fn note_unflagged(&self) -> Result<()> {
        let unflagged = ids_in_state(self.plan, "ok")?;
        for of in self.plan.study.subjects.accept.iter().filter(|of| unflagged.contains(&of.id)) {
            self.console.note(format!("{} is accepted but not flagged", of.id));
        }
        Ok(())
    }

    /// Prints the stages, the warnings and the failures; returns an error if subjects failed.
    pub(super) fn finish(&self) -> Result<()> {
        let mut rows = vec![["stage", "", "time"].map(str::to_owned).to_vec()];
        rows.extend(
            self.rows
                .iter()
                .map(|Done { stage, state, seconds }| vec![stage.clone(), state.clone(), format!("{seconds:.1} s")]),
        );
        print(&format!("\n{}", table(&rows)))?;
        if self.rows.iter().any(|done| done.stage == CHECK) {
            let table = self.plan.checked();
            let flagged = match self.flagged.len() {
                0 => "no subject".to_owned(),
                count => counted(count, "subject"),
            };
            let excluded = match self.plan.excluded.len() {
                0 => String::new(),
                count => format!(", {count} excluded"),
            };
            print_line(&format!("quality control: {flagged} flagged{excluded}, see {}", table.display()))?;
            self.list_flagged();
            self.note_unflagged()?;
        }
        self.warnings.iter().take(SHOWN).for_each(|warning| self.console.warn(warning));
        if let Some(more) = self.warnings.len().checked_sub(SHOWN + 1) {
            self.console.warn(format!("and {}, listed at the top of the page", counted(more + 1, "more warning")));
        }
        for (id, error) in self.failed.iter().take(10) {
            self.console.warn(format!("{id}: {error}"));
        }
        match self.failed.len() {
            0 => Ok(()),
            count => bail!(
                "{} of {} failed: the page shows the others; `spharm status {}` lists the failures",
                counted(count, "subject"),
                self.plan.manifest.rows.len(),
                self.plan.status_of_failures().display()
            ),
        }
    }
}
