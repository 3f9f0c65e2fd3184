//! Collects warnings to check before trusting a study's results: subjects that are far from the others, duplicate files
//! and models, models that follow the steps of voxels, and the warnings of the alignment and of the tests.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::Value;
use spharm::Model;
use spharm::fit_mesh::steps_of;
use spharm::parametrize::volume::{VoxelSteps, steps_of_labels};
use spharm::shape::{outliers, rmsd};
use spharm_cli::inputs::{MOST_OWN, read_text};
use spharm_cohort::equal::{EqualSets, same_inputs};

use super::plan::{Plan, Subject};
use crate::report;

/// Returns the warnings, from the results of the stages before the page. Warnings about single subjects come first.
pub(super) fn collect(plan: &Plan, subjects: &[Subject<'_>]) -> Result<Vec<String>> {
    let group = Group::read(plan, subjects)?;
    let mut warnings = far_subjects(plan, subjects, &group.distances)?;
    warnings.extend(group.inputs.sets().iter().map(|names| same_inputs(names)));
    // Equal input files give equal models; warn only about the files.
    let known = group.inputs.sets();
    for names in group.models.sets().iter().filter(|names| !known.contains(names)) {
        warnings.push(format!(
            "{}: these models are equal; does one of the inputs belong to another subject?",
            names.join(", ")
        ));
    }
    warnings.extend(steps_of_labels(&group.steps));
    if plan.alignment_warnings().is_file() {
        warnings.extend(report::warnings(&plan.alignment_warnings())?);
    }
    for test in &plan.study.test {
        let about = plan.output.join("tests").join(&test.name).join("test.json");
        warnings.extend(of_test(&about)?.into_iter().map(|warning| format!("test {}: {warning}", test.name)));
    }
    Ok(warnings)
}

/// Data collected from the models.
#[derive(Default)]
struct Group {
    /// Distance of each aligned model from the mean; models whose degree differs from the mean's have none.
    distances: Vec<f64>,
    inputs: EqualSets<(String, Option<i64>)>,
    models: EqualSets<String>,
    steps: Vec<(String, VoxelSteps)>,
}

impl Group {
    /// Collects the data, holding one model in memory at a time.
    fn read(plan: &Plan, subjects: &[Subject<'_>]) -> Result<Self> {
        let mean = Model::read(plan.mean())?;
        let mut group = Self::default();
        for (subject, aligned) in subjects.iter().zip(plan.aligned(subjects)) {
            let model = Model::read(&subject.model)?;
            let name = || subject.id.to_owned();
            let record = &model.provenance;
            if let Some(input) = &record.input {
                group.inputs.add((input.blake3.clone(), input.label), name());
            }
            let mut hasher = blake3::Hasher::new();
            for value in model.coefficients.values() {
                hasher.update(&value.to_le_bytes());
            }
            group.models.add(hasher.finalize().to_hex().to_string(), name());
            group.steps.extend(steps_of(record).map(|steps| (name(), steps)));
            let model = if aligned == subject.model { model } else { Model::read(&aligned)? };
            group.distances.extend(rmsd(&model.coefficients, &mean.coefficients).ok());
        }
        Ok(group)
    }
}

/// Returns a warning for each subject whose volume, area or distance from the mean is far from the others'.
fn far_subjects(plan: &Plan, subjects: &[Subject<'_>], distances: &[f64]) -> Result<Vec<String>> {
    let table = plan.output.join("measures.csv");
    let mut found: BTreeMap<usize, Vec<String>> = BTreeMap::new();
    let measures = [("volume", column(&table, "volume")?), ("area", column(&table, "area")?)];
    for (what, values) in
        measures.iter().map(|(what, values)| (*what, values.as_slice())).chain([("distance from the mean", distances)])
    {
        // If a subject has no distance, indices into the distances no longer match the subjects, so the distances are
        // skipped.
        for far in outliers(values).into_iter().filter(|_| values.len() == subjects.len()) {
            // A small distance from the mean isn't suspicious.
            if what == "distance from the mean" && far.z < 0.0 {
                continue;
            }
            found.entry(far.index).or_default().push(format!(
                "{what} {} (median {}, robust z {:.1})",
                number(far.value),
                number(far.median),
                far.z
            ));
        }
    }
    let warning = |(index, what): (usize, Vec<String>)| {
        format!(
            "{}: far from the other subjects: {}; check its surface, its units and its label",
            subjects[index].id,
            what.join(", ")
        )
    };
    Ok(found.into_iter().map(warning).collect())
}

/// Formats a number with four significant digits, or with all digits before the decimal point if there are more.
fn number(value: f64) -> String {
    let magnitude = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    if (-3.0..6.0).contains(&magnitude) {
        format!("{value:.*}", (3.0 - magnitude).max(0.0) as usize)
    } else {
        format!("{value:.3e}")
    }
}

/// Reads a column of numbers from a table made by a stage.
fn column(table: &Path, name: &str) -> Result<Vec<f64>> {
    let text = read_text(table, "table of measures", MOST_OWN)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let named = || table.display().to_string();
    let at = reader.headers().with_context(named)?.iter().position(|column| column == name);
    let at = at.with_context(|| format!("{}: expected a column {name:?}", table.display()))?;
    let cell = |record: csv::StringRecord| record.get(at).unwrap_or_default().parse::<f64>().with_context(named);
    reader.records().map(|record| cell(record.with_context(named)?)).collect()
}

/// Reads the warnings in the description of a test.
fn of_test(path: &Path) -> Result<Vec<String>> {
    let text = read_text(path, "description of a test", MOST_OWN)?;
    let about: Value = serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))?;
    let texts = about["warnings"].as_array().into_iter().flatten();
    Ok(texts.filter_map(|warning| warning.as_str().map(str::to_owned)).collect())
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_have_four_digits() {
        for (value, text) in
            [(238_319.4, "238319"), (2045.27, "2045"), (0.0, "0.000"), (1.5, "1.500"), (0.012_346, "0.01235")]
        {
            assert_eq!(number(value), text);
        }
        assert_eq!((number(1.23e-9), number(2.5e9)), ("1.230e-9".to_owned(), "2.500e9".to_owned()));
    }
}
