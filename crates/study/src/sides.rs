//! Handles studies in which each subject has two sides, such as hemispheres. Each side of a subject has its own row;
//! the second side is mirrored, so that equal directions on the two sides correspond.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, bail};
use spharm_cohort::{Manifest, Row};

use super::config::{Study, Subjects};
use super::exclusion::Named;
use super::test::{ASYMMETRY, Test};

/// Value of the key `mask` that disables the mask.
pub(super) const NO_MASK: &str = "none";
/// Placeholder of the side in a pattern.
pub(super) const SIDE: &str = "{side}";
/// Names of the columns for the subject and the side of a row.
pub(super) const COLUMNS: [&str; 2] = ["subject", "side"];

/// Checks the keys of a study file that concern sides.
pub(super) fn check(study: &Study) -> Result<()> {
    check_placeholders(study)?;
    check_names(study)?;
    let of = |test: &Test| check_test(&study.subjects, test).with_context(|| format!("test {:?}", test.name));
    study.test.iter().try_for_each(of)
}

/// Refuses placeholders other than `{id}` and `{side}`.
fn check_placeholders(study: &Study) -> Result<()> {
    for (key, pattern) in files(study) {
        let named = pattern.split('{').skip(1).filter_map(|rest| rest.split_once('}')).map(|(name, _)| name);
        if let Some(unknown) = named.into_iter().find(|name| !["id", "side"].contains(name)) {
            bail!("{key}: expected {{id}} or {SIDE}, found {{{unknown}}}");
        }
    }
    Ok(())
}

/// Checks the names of the sides, and that the patterns distinguish the sides.
fn check_names(study: &Study) -> Result<()> {
    let Subjects { sides, labels, surface, .. } = &study.subjects;
    let [first, second] = match &sides[..] {
        [] if !labels.is_empty() => {
            bail!("`labels` in [subjects] needs `sides`, found none; for a single label, give `label`")
        }
        [] => match files(study).into_iter().find(|(_, pattern)| pattern.contains(SIDE)) {
            Some((key, _)) => bail!("{key}: {SIDE} needs `sides` in [subjects], such as [\"lh\", \"rh\"]"),
            None => return Ok(()),
        },
        [first, second] => [first, second],
        _ => bail!("`sides` in [subjects]: expected two names, such as [\"lh\", \"rh\"], found {}", sides.len()),
    };
    let plain = |c: char| c.is_alphanumeric() || c == '-';
    if let Some(name) = sides.iter().find(|name| name.is_empty() || !name.chars().all(plain) || *name == ASYMMETRY) {
        bail!(
            "`sides` in [subjects]: expected names made up of letters, digits and hyphens, and not {ASYMMETRY:?}; found {name:?}"
        );
    }
    if first == second {
        bail!("`sides` in [subjects]: expected two different names, found {first:?} twice");
    }
    if surface.is_none() {
        bail!(
            "`sides` in [subjects] needs a `surface` pattern with {SIDE}, or a `surface` pattern and `labels`; found \
             no `surface`"
        );
    }
    match labels[..] {
        [] => {}
        [left, right] if left == right => {
            bail!("`labels` in [subjects]: expected two different labels, found {left} twice")
        }
        [_, _] => {}
        _ => bail!("`labels` in [subjects]: expected two labels, one for each side, found {}", labels.len()),
    }
    if study.subjects.label.is_some() {
        bail!("`label` in [subjects]: expected `labels` instead, with one label for each of the `sides`");
    }
    // Each file belongs to a single side, so its pattern needs `{side}`. Only a label volume may contain both sides.
    for (key, pattern) in files(study) {
        let of_both = key == SURFACE && !labels.is_empty();
        if !pattern.contains(SIDE) && !of_both {
            let or = if key == SURFACE { ", or a label for each side in `labels`" } else { "" };
            bail!("{key}: expected a pattern with {SIDE}{or}, to distinguish the two sides; found {pattern:?}");
        }
    }
    if study.fit.sphere().is_some() {
        bail!(
            "`arguments` in [fit]: --sphere applies to all surfaces, but each side needs its own sphere; give `sphere` \
             in [subjects], with {SIDE}"
        );
    }
    if study.align.mirror {
        bail!("`mirror` in [align]: the second of the `sides` is mirrored already; omit `mirror`");
    }
    Ok(())
}

/// Name of the key for the surfaces, as messages state it.
const SURFACE: &str = "`surface` in [subjects]";

/// Returns the patterns and columns that name the files of each subject, with the names of their keys.
fn files(study: &Study) -> Vec<(&'static str, &str)> {
    let Subjects { surface, sphere, landmarks, signal, mask, .. } = &study.subjects;
    let mask = mask.as_ref().filter(|mask| *mask != NO_MASK);
    let keys = [
        (SURFACE, surface.as_ref()),
        ("`sphere` in [subjects]", sphere.as_ref()),
        ("`landmarks` in [subjects]", landmarks.as_ref()),
        ("`signal` in [subjects]", signal.as_ref()),
        ("`mask` in [subjects]", mask),
    ];
    let given = keys.into_iter().filter_map(|(key, pattern)| Some((key, pattern?.as_str())));
    given.chain(study.align.signals.iter().map(|with| ("`signals` in [align]", with.name.as_str()))).collect()
}

/// Checks the key `side` of a test.
fn check_test(subjects: &Subjects, test: &Test) -> Result<()> {
    let choices = || {
        let names: Vec<String> = subjects.sides.iter().map(|name| format!("{name:?}")).collect();
        format!("{} or {ASYMMETRY:?}", names.join(", "))
    };
    match &test.side {
        None if subjects.sides.is_empty() => {}
        None => bail!("give `side` ({}), because the study defines `sides`", choices()),
        Some(_) if subjects.sides.is_empty() => bail!("`side` needs `sides` in [subjects], found none"),
        Some(side) if side != ASYMMETRY && !subjects.sides.contains(side) => {
            bail!("side: expected {}, found {side:?}", choices())
        }
        Some(_) => {}
    }
    if test.mean && !test.is_of_differences() && !test.is_of_values() {
        bail!(
            "mean: displacements are measured from the mean of the group, so their mean is always zero; expected the \
             mean of an asymmetry (side = {ASYMMETRY:?}) or of the values of a signal (signal = \"value\")"
        );
    }
    Ok(())
}

/// Returns the id of a subject's row for a side.
pub(super) fn id_of(subject: &str, side: &str) -> String {
    format!("{subject}_{side}")
}

/// Returns whether a row belongs to the second side.
pub(super) fn is_mirrored(subjects: &Subjects, manifest: &Manifest, row: &Row) -> bool {
    let [_, side] = cells(manifest, row);
    subjects.sides.get(1).is_some_and(|second| Some(second.as_str()) == side)
}

/// Returns the subject and the side of a row; `None` in a study without sides.
fn cells<'a>(manifest: &Manifest, row: &'a Row) -> [Option<&'a str>; 2] {
    COLUMNS.map(|name| {
        let at = manifest.columns.iter().position(|column| column == name)?;
        row.extra.get(at).map(String::as_str)
    })
}

/// Returns the names of the subjects of a study with sides; `None` without sides.
pub(super) fn subjects(manifest: &Manifest) -> Option<BTreeSet<&str>> {
    manifest.rows.iter().map(|row| cells(manifest, row)[0]).collect()
}

/// Returns the subjects of which only one side is among the given rows. Each row is given by its cells.
pub(super) fn alone<'a>(manifest: &Manifest, rows: impl Iterator<Item = &'a [String]>) -> Vec<String> {
    let Some(at) = manifest.columns.iter().position(|column| column == COLUMNS[0]) else { return Vec::new() };
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    rows.for_each(|cells| *counts.entry(cells[at].as_str()).or_default() += 1);
    counts.into_iter().filter(|(_, count)| *count == 1).map(|(subject, _)| subject.to_owned()).collect()
}

/// Replaces `{id}` and `{side}` in a pattern.
pub(super) fn filled(pattern: &str, subjects: &Subjects, manifest: &Manifest, row: &Row) -> String {
    match cells(manifest, row) {
        [Some(subject), Some(side)] if !subjects.sides.is_empty() => {
            pattern.replace(super::subjects::ID, subject).replace(SIDE, side)
        }
        _ => pattern.replace(super::subjects::ID, &row.id),
    }
}

/// Replaces each subject in a list by its two rows, one for each side. An entry that is the id of a single row is kept.
pub(super) fn rows_of(listed: &[Named], subjects: &Subjects, manifest: &Manifest) -> Vec<Named> {
    let has = |id: &str| manifest.rows.iter().any(|row| row.id == id);
    let rows = |named: &Named| -> Vec<Named> {
        let ids: Vec<String> = subjects.sides.iter().map(|side| id_of(&named.id, side)).collect();
        match !ids.is_empty() && ids.iter().all(|id| has(id)) {
            true => ids.into_iter().map(|id| Named { id, reason: named.reason.clone() }).collect(),
            false => vec![named.clone()],
        }
    };
    listed.iter().flat_map(rows).collect()
}

/// Returns the indices of a test's rows: all rows, the rows of one side, or a pair of rows for each subject with both
/// sides. In a pair, the second row is subtracted.
pub(super) fn tested<'a>(
    test: &Test,
    subjects: &Subjects,
    rows: impl Iterator<Item = &'a [String]>,
    columns: &[String],
) -> Vec<(usize, Option<usize>)> {
    let at = COLUMNS.map(|name| columns.iter().position(|column| column == name));
    let ([Some(subject_at), Some(side_at)], Some(side)) = (at, &test.side) else {
        return rows.enumerate().map(|(row, _)| (row, None)).collect();
    };
    let rows: Vec<[&str; 2]> = rows.map(|cells| [cells[subject_at].as_str(), cells[side_at].as_str()]).collect();
    if side != ASYMMETRY {
        let of_side = rows.iter().enumerate().filter(|(_, [_, found])| found == side);
        return of_side.map(|(row, _)| (row, None)).collect();
    }
    pairs_of(subjects, &rows).into_iter().map(|(first, second)| (first, Some(second))).collect()
}

/// Returns whether a test uses the side of a row.
pub(super) fn uses(test: &Test, manifest: &Manifest, row: &Row) -> bool {
    test.side.is_none() || test.is_of_differences() || cells(manifest, row)[1] == test.side.as_deref()
}

/// Returns, for each subject with both sides, the row indices of the first side and of the second side.
pub(super) fn pairs<'a>(
    subjects: &Subjects,
    rows: impl Iterator<Item = &'a [String]>,
    columns: &[String],
) -> Vec<(usize, usize)> {
    let [Some(subject_at), Some(side_at)] = COLUMNS.map(|name| columns.iter().position(|column| column == name)) else {
        return Vec::new();
    };
    let rows: Vec<[&str; 2]> = rows.map(|cells| [cells[subject_at].as_str(), cells[side_at].as_str()]).collect();
    pairs_of(subjects, &rows)
}

/// Returns the pairs of rows that belong to the same subject; each row is given by its subject and side.
fn pairs_of(subjects: &Subjects, rows: &[[&str; 2]]) -> Vec<(usize, usize)> {
    let of = |side: &str| -> BTreeMap<&str, usize> {
        let of_side = rows.iter().enumerate().filter(|(_, [_, found])| *found == side);
        of_side.map(|(row, [subject, _])| (*subject, row)).collect()
    };
    let (first, second) = (of(&subjects.sides[0]), of(&subjects.sides[1]));
    let firsts: BTreeSet<usize> = first.values().copied().collect();
    firsts.into_iter().filter_map(|row| Some((row, *second.get(rows[row][0])?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_are_of_a_side_or_of_pairs() {
        let subjects = Subjects { sides: vec!["lh".to_owned(), "rh".to_owned()], ..Subjects::default() };
        let columns = ["group", "subject", "side"].map(str::to_owned);
        let rows = [["a", "s1", "lh"], ["a", "s1", "rh"], ["b", "s2", "rh"], ["b", "s3", "rh"], ["b", "s3", "lh"]];
        let rows: Vec<Vec<String>> = rows.iter().map(|row| row.map(str::to_owned).to_vec()).collect();
        let of = |side: &str| {
            let test = Test { side: Some(side.to_owned()), ..Test::default() };
            tested(&test, &subjects, rows.iter().map(Vec::as_slice), &columns)
        };
        assert_eq!(of("rh"), [(1, None), (2, None), (3, None)]);
        assert_eq!(of(ASYMMETRY), [(0, Some(1)), (4, Some(3))]);
    }
}
