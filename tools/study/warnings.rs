//! Collects what to look at before trusting a study's results: the flagged subjects, and the warnings of the quality
//! control, the alignment and the tests.

use std::collections::HashSet;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::Value;
use spharm_cli::inputs::{MOST_OWN, read_text};
use spharm_cli::output::counted;

use super::plan::{Plan, Subject};
use crate::report;

/// A flagged subject, with its flags.
pub(super) struct Flagged {
    pub(super) id: String,
    pub(super) flags: Vec<String>,
}

/// Reads the flagged subjects from the report of the quality control, the worst first.
pub(super) fn flagged(plan: &Plan) -> Result<Vec<Flagged>> {
    let report = read(&plan.check_report(), "report")?;
    let subjects = report["subjects"].as_array().into_iter().flatten();
    let of = |subject: &Value| Flagged {
        id: subject["id"].as_str().unwrap_or_default().to_owned(),
        flags: texts(&subject["flags"]),
    };
    Ok(subjects.filter(|subject| subject["state"] == "flagged").map(of).collect())
}

/// Returns the warnings that concern the whole group, from the results of the stages before the page. Warnings about
/// single subjects are among their flags.
pub(super) fn collect(plan: &Plan, subjects: &[Subject<'_>]) -> Result<Vec<String>> {
    let report = read(&plan.check_report(), "report")?;
    let mut warnings = texts(&report["warnings"]);
    if let Some(flagged) = report["flagged"].as_u64().filter(|count| *count > 0) {
        warnings.push(format!(
            "{} flagged in the quality control, and part of the mean, the modes and the tests all the same",
            counted(flagged as usize, "subject")
        ));
    }
    if plan.alignment_warnings().is_file() {
        let ids: HashSet<&str> = subjects.iter().map(|subject| subject.id).collect();
        let of_subject = |text: &String| text.match_indices(": ").any(|(at, _)| ids.contains(&text[..at]));
        warnings.extend(report::warnings(&plan.alignment_warnings())?.into_iter().filter(|text| !of_subject(text)));
    }
    for test in &plan.study.test {
        let about = plan.output.join("tests").join(&test.name).join("test.json");
        let about = read(&about, "description of a test")?;
        warnings.extend(texts(&about["warnings"]).into_iter().map(|text| format!("test {}: {text}", test.name)));
    }
    Ok(warnings)
}

fn read(path: &Path, what: &'static str) -> Result<Value> {
    let text = read_text(path, what, MOST_OWN)?;
    serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))
}

/// Returns the texts of a JSON list.
fn texts(list: &Value) -> Vec<String> {
    list.as_array().into_iter().flatten().filter_map(|text| text.as_str().map(str::to_owned)).collect()
}
