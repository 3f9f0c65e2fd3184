//! Handles the lists of subjects that are excluded from a study, or whose flags are accepted, with the reasons.

use std::collections::HashSet;
use std::path::Path;

use anyhow::{Result, bail};
use serde::Deserialize;
use spharm_cohort::{Manifest, Row};
use toml::Value;

/// An entry of a list of subjects in the study's file, with a reason.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(from = "IdOrReason")]
pub(super) struct Named {
    pub(super) id: String,
    /// Reason; empty if none is given.
    pub(super) reason: String,
}

/// A subject as written in the file: an id, or an id with the reason.
#[derive(Deserialize)]
#[serde(untagged)]
enum IdOrReason {
    Id(String),
    WithReason { id: String, reason: String },
}

impl From<IdOrReason> for Named {
    fn from(written: IdOrReason) -> Self {
        match written {
            IdOrReason::Id(id) => Self { id, reason: String::new() },
            IdOrReason::WithReason { id, reason } => Self { id, reason },
        }
    }
}

/// Checks a list of subjects as written in the study's file: ids, or tables of an id and a reason.
pub(super) fn check_list(key: &str, list: &Value) -> Result<()> {
    let expected =
        format!("`{key}` in [subjects]: expected a list, such as [\"s12\", {{ id = \"s07\", reason = \"...\" }}]");
    let Some(items) = list.as_array() else { bail!("{expected}; found a value of type {}", list.type_str()) };
    for item in items {
        match item {
            Value::String(_) => {}
            Value::Table(table) => {
                let unknown = table.keys().find(|key| !["id", "reason"].contains(&key.as_str()));
                match (unknown, table.get("id"), table.get("reason")) {
                    (Some(unknown), ..) => bail!("{expected}; found a table with the unknown key `{unknown}`"),
                    (_, Some(Value::String(_)), Some(Value::String(reason))) if !reason.trim().is_empty() => {}
                    _ => bail!("{expected}; found a table that lacks the id or the reason"),
                }
            }
            other => bail!("{expected}; found a value of type {} in the list", other.type_str()),
        }
    }
    Ok(())
}

/// Checks that all subjects of a list are in the study, and that no subject is listed twice.
pub(super) fn check_ids(listed: &[Named], manifest: &Manifest) -> Result<()> {
    let ids: HashSet<&str> = manifest.rows.iter().map(|row| row.id.as_str()).collect();
    let mut seen = HashSet::new();
    for Named { id, .. } in listed {
        if !seen.insert(id) {
            bail!("{id:?} is listed twice");
        }
        if !ids.contains(id.as_str()) {
            let near = ids.iter().map(|known| (strsim::damerau_levenshtein(known, id), *known)).min();
            let near = near.filter(|(distance, _)| *distance <= 2.max(id.len() / 3));
            let hint = near.map_or(String::new(), |(_, known)| format!("; did you mean {known:?}?"));
            bail!("no subject {id:?}{hint}");
        }
    }
    Ok(())
}

/// Removes the excluded subjects from a manifest and from its text, which is later written to the path `made`. Creates
/// the text if the manifest has no text yet. Returns the rows of the excluded subjects, with the reasons.
///
/// # Errors
///
/// If an excluded subject isn't in the manifest, or is excluded twice.
pub(super) fn exclude(
    exclusions: &[Named],
    manifest: &mut Manifest,
    made_text: &mut Option<Vec<u8>>,
    made: &Path,
) -> Result<Vec<(Row, String)>> {
    check_ids(exclusions, manifest)?;
    if exclusions.is_empty() {
        return Ok(Vec::new());
    }
    let left_out: HashSet<&str> = exclusions.iter().map(|of| of.id.as_str()).collect();
    let is_kept = |row: &Row| !left_out.contains(row.id.as_str());
    *made_text = Some(match made_text {
        Some(text) => without(text, &left_out)?,
        None => manifest.rest(made, is_kept)?,
    });
    let (kept, excluded): (_, Vec<Row>) = std::mem::take(&mut manifest.rows).into_iter().partition(is_kept);
    (manifest.rows, manifest.path) = (kept, made.to_owned());
    let with_reason = |row: Row| {
        let reason = exclusions.iter().find(|of| of.id == row.id).map_or(String::new(), |of| of.reason.clone());
        (row, reason)
    };
    Ok(excluded.into_iter().map(with_reason).collect())
}

/// Removes the excluded subjects from the text of a manifest, whose first column is the id.
fn without(text: &[u8], left_out: &HashSet<&str>) -> Result<Vec<u8>> {
    let mut reader = csv::ReaderBuilder::new().delimiter(b'\t').has_headers(false).from_reader(text);
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
    for record in reader.records() {
        let record = record?;
        if !record.get(0).is_some_and(|id| left_out.contains(id)) {
            writer.write_record(&record)?;
        }
    }
    Ok(writer.into_inner()?)
}
