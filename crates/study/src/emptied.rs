//! Refuses a test if no subject of a group is left, because all of its subjects are excluded or couldn't be fitted.

use std::collections::BTreeSet;

use anyhow::{Result, bail};
use spharm::shape::stats::Column;
use spharm_cli::output::{counted, first_of};
use spharm_cohort::Row;

use super::plan::Plan;
use super::sides;
use super::test::Test;
use spharm_analysis::design::parts;
use spharm_analysis::table::{column_of, is_missing};

/// Maximum number of subjects that a message lists with their reasons.
const LISTED: usize = 3;
/// Maximum number of characters of a reason in a message; longer reasons are cut off.
const SHORT: usize = 80;

/// Checks that each level of a test's effect has a subject among the rows that are `left`. A level may be missing if
/// all of its subjects are excluded, the test still has two levels, and the test doesn't name the missing level.
/// `failed` lists the subjects that couldn't be fitted, with the reasons.
///
/// # Errors
///
/// If no subject of a level is left. The error names the level and lists its subjects with the reasons.
pub(super) fn check(plan: &Plan, test: &Test, left: &[&Row], failed: &[(String, String)]) -> Result<()> {
    // A test of differences uses only subjects that have both sides. A subject may therefore be missing for a reason
    // that isn't in `failed` or the exclusions, so skip the check.
    if test.is_of_differences() {
        return Ok(());
    }
    let manifest = &plan.manifest;
    let rows = manifest.rows.iter().chain(plan.excluded.iter().map(|(row, _)| row));
    let rows: Vec<&Row> = rows.filter(|row| sides::uses(test, manifest, row)).collect();
    // A column's name may look like an interaction of columns, so check whether the effect is a column.
    let is_column = manifest.columns.contains(&test.effect);
    for name in parts(&test.effect).into_iter().filter(|name| !is_column || *name == test.effect) {
        let Some(at) = manifest.columns.iter().position(|column| column == name) else { continue };
        let cells: Vec<&str> = rows.iter().filter_map(|row| cell(row, at)).collect();
        if !is_of_levels(test, name, &cells) {
            continue;
        }
        let there: BTreeSet<&str> = left.iter().filter_map(|row| cell(row, at)).collect();
        for level in cells.into_iter().collect::<BTreeSet<_>>().difference(&there) {
            let ids: BTreeSet<&str> =
                rows.iter().filter(|row| cell(row, at) == Some(*level)).map(|row| row.id.as_str()).collect();
            let excluded = plan.excluded.iter().map(|(row, reason)| (row.id.as_str(), reason.as_str()));
            let excluded: Vec<(&str, &str)> = excluded.filter(|(id, _)| ids.contains(id)).collect();
            let is_meant = excluded.len() == ids.len() && there.len() > 1;
            if is_meant && !is_named(test, level) {
                continue;
            }
            let failed = failed.iter().map(|(id, reason)| (id.as_str(), reason.as_str()));
            let failed: Vec<(&str, &str)> = failed.filter(|(id, _)| ids.contains(id)).collect();
            if excluded.is_empty() && failed.is_empty() {
                continue;
            }
            bail!(
                "no subject with {name} {level:?} is left of the {} in the table{}{}; keep or repair some of them, or \
                 change the test",
                counted(ids.len(), plan.row_noun()),
                listed("excluded", &excluded),
                listed("failed", &failed)
            );
        }
    }
    Ok(())
}

/// Returns the value of a row in the column with the index `at`; `None` for a missing value.
fn cell(row: &Row, at: usize) -> Option<&str> {
    row.extra.get(at).map(|cell| cell.trim()).filter(|cell| !cell.is_empty() && !is_missing(cell))
}

/// Returns whether a column of the effect has levels rather than numbers.
fn is_of_levels(test: &Test, name: &str, cells: &[&str]) -> bool {
    let is_ordered = || name == test.effect && !test.levels.is_empty();
    test.categorical.iter().any(|of| of == name) || is_ordered() || matches!(column_of(cells), Ok(Column::Levels(_)))
}

/// Returns whether a test names a level, either in its list `levels` or in a contrast. In a contrast, the level is a
/// word that isn't a number, or is in quotes. The quotes may contain an interaction, such as `"a - b:male"`.
fn is_named(test: &Test, level: &str) -> bool {
    let words = test.contrast.iter().flat_map(|text| text.split(|c: char| c.is_whitespace() || c == ':'));
    let words = words.filter(|word| word.parse::<f64>().is_err());
    let quoted = test.contrast.iter().flat_map(|text| text.split('"').skip(1).step_by(2));
    let quoted = quoted.flat_map(|name| std::iter::once(name).chain(name.split(':')));
    test.levels.iter().map(String::as_str).chain(words).chain(quoted).any(|name| name == level)
}

/// Lists subjects with their reasons, as a part of a message; empty without subjects.
fn listed(how: &str, subjects: &[(&str, &str)]) -> String {
    let one = |(id, reason): &(&str, &str)| match reason.char_indices().nth(SHORT) {
        _ if reason.is_empty() => (*id).to_owned(),
        Some((end, _)) => format!("{id} ({}...)", &reason[..end]),
        None => format!("{id} ({reason})"),
    };
    let subjects: Vec<String> = subjects.iter().map(one).collect();
    match subjects.is_empty() {
        true => String::new(),
        false => format!("; {how}: {}", first_of(subjects.iter().map(String::as_str), LISTED)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_in_contrasts_are_recognised() {
        let test = |contrast: &str| Test { contrast: vec![contrast.to_owned()], ..Test::default() };
        for (contrast, level) in [
            ("patient - 0.5 control", "patient"),
            ("patient:male", "male"),
            ("\"a - b\" - c", "a - b"),
            ("\"a - b:male\" - 0.5 c", "a - b"),
            ("\"a - b:male\" - 0.5 c", "male"),
            ("\"a:b\" - c", "a:b"),
        ] {
            assert!(is_named(&test(contrast), level), "{contrast}: {level}");
        }
        assert!(!is_named(&test("\"a - b:male\" - 0.5 c"), "female"));
        assert!(!is_named(&test("patient - 0.5 control"), "0.5"));
    }
}
