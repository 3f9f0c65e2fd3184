//! Collects reasons to doubt a study's results: the flagged subjects, and the warnings from the quality control, the
//! alignment and the tests.

use std::collections::HashSet;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::Value;
use spharm::pose::IN_DOUBT;
use spharm_cli::inputs::{MOST_OWN, read_text};
use spharm_cli::output::{counted, first_of};
use spharm_cohort::check::subject_of;

use super::plan::{Plan, Subject};
use super::test::Test;
use spharm_cli::inputs::read_warnings;

/// Maximum number of subjects that a warning about poses names.
const NAMED: usize = 10;

/// A flagged subject, with its flags.
pub(super) struct Flagged {
    pub(super) id: String,
    pub(super) flags: Vec<String>,
}

/// Reads the flagged subjects (worst first) and the warnings about the whole group from the quality-control report.
pub(super) fn of_check(plan: &Plan) -> Result<(Vec<Flagged>, Vec<String>)> {
    let report = read(&plan.check_report(), "report")?;
    let subjects = report["subjects"].as_array().map_or(&[][..], Vec::as_slice);
    let of = |subject: &Value| Flagged {
        id: subject["id"].as_str().unwrap_or_default().to_owned(),
        flags: texts(&subject["flags"]),
    };
    let flagged: Vec<Flagged> = subjects.iter().filter(|subject| subject["state"] == "flagged").map(of).collect();
    let mut warnings = texts(&report["warnings"]);
    let is_in_doubt = |subject: &&Value| subject["remarks"].as_str().is_some_and(|text| text.contains(IN_DOUBT));
    let in_doubt: Vec<&str> =
        subjects.iter().filter(is_in_doubt).filter_map(|subject| subject["id"].as_str()).collect();
    if !in_doubt.is_empty() {
        warnings.push(format!(
            "two poses fit nearly equally well for {}: {}; some of these subjects may be in a wrong pose, such as \
             turned end to end, so an effect at one end may also appear at the other end",
            counted(in_doubt.len(), "subject"),
            first_of(in_doubt.iter().copied(), NAMED)
        ));
    }
    if !flagged.is_empty() {
        warnings.push(format!(
            "{} flagged by the quality control but still included in the mean, the modes and the tests; exclude or \
             accept them in [subjects]",
            counted(flagged.len(), "subject")
        ));
    }
    Ok((flagged, warnings))
}

/// Returns the ids of the subjects in a state, such as `accepted`, from the quality-control report.
pub(super) fn ids_in_state(plan: &Plan, state: &str) -> Result<HashSet<String>> {
    let report = read(&plan.check_report(), "report")?;
    let subjects = report["subjects"].as_array().into_iter().flatten();
    let ids = subjects.filter(|subject| subject["state"] == state).filter_map(|subject| subject["id"].as_str());
    Ok(ids.map(str::to_owned).collect())
}

/// Returns the warnings from the alignment and the tests about the whole group. Warnings about single subjects become
/// flags of these subjects instead.
pub(super) fn of_group(plan: &Plan, subjects: &[Subject<'_>]) -> Result<Vec<String>> {
    let mut warnings = Vec::new();
    if plan.alignment_warnings().is_file() {
        let ids: HashSet<&str> = subjects.iter().map(|subject| subject.id).collect();
        let of_group = |text: &String| subject_of(text, |id| ids.contains(id)).is_none();
        warnings.extend(read_warnings(&plan.alignment_warnings())?.into_iter().filter(of_group));
    }
    for test in &plan.study.test {
        let about = about(plan, test)?;
        warnings.extend(texts(&about["warnings"]).into_iter().map(|text| format!("test {}: {text}", test.name)));
    }
    Ok(warnings)
}

/// Reads the description of a test that has been run.
pub(super) fn about(plan: &Plan, test: &Test) -> Result<Value> {
    read(&plan.test_folder(test).join("test.json"), "description of a test")
}

fn read(path: &Path, what: &'static str) -> Result<Value> {
    let text = read_text(path, what, MOST_OWN)?;
    serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))
}

/// Returns the strings of a JSON list.
fn texts(list: &Value) -> Vec<String> {
    list.as_array().into_iter().flatten().filter_map(|text| text.as_str().map(str::to_owned)).collect()
}
