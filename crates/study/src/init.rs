//! Writes a study file for a table of subjects: finds the column of ids, the subjects' surfaces and a column to test.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Result;
use spharm::parametrize::volume::is_volume;
use spharm_cli::output::counted;
use spharm_cohort::{Manifest, is_named_sphere};
use spharm_surface::io::{is_named_mesh, is_named_signal};

use super::config::{escaped, template};
use spharm_analysis::table::Table;

/// Names that columns of ids usually have, the most likely first; BIDS uses the first name.
const IDS: [&str; 6] = ["participant_id", "id", "subject_id", "subject", "participant", "name"];
/// Names of columns that studies usually test, the most likely first.
const EFFECTS: [&str; 9] =
    ["group", "diagnosis", "dx", "condition", "treatment", "arm", "case_control", "sex", "gender"];
/// Maximum depth, below the study file's folder, of the folders that are searched for surfaces.
const DEPTH: usize = 8;
/// Maximum number of files found before the search ends.
const FILES: usize = 200_000;
/// Maximum number of patterns that the study file lists.
const LISTED: usize = 5;
/// Parts of the names of images that aren't label volumes.
const IMAGES: [&str; 10] = ["t1", "t2", "flair", "bold", "dwi", "orig", "brain", "norm", "nu.", "rawavg"];

/// A study file, and a summary of the keys that were filled in.
pub(super) struct Filled {
    pub(super) text: String,
    pub(super) notes: Vec<String>,
}

/// A pattern of paths, with the number of subjects for which a matching file exists.
struct Pattern {
    pattern: String,
    subjects: usize,
}

/// Fills in the template of a study file in `folder`. `given` is the path of the table, relative to `folder`.
///
/// # Errors
///
/// If the table can't be read.
pub(super) fn filled(folder: &Path, given: &str) -> Result<Filled> {
    let table = Table::read(&folder.join(given))?;
    let (mut text, mut notes) = (template(Some(given)), Vec::new());
    let mut replace = |line: &str, with: &str| text = text.replacen(line, with, 1);
    let names: Vec<&str> = table.names().collect();
    let id = id_column(&table, &names);
    if table.has("id") && table.has("surface") {
        // Fail here if a study of this table would be refused.
        Manifest::read(folder.join(given))?;
    } else {
        replace("# id = \"participant_id\"", &format!("id = \"{}\"", escaped(names[id])));
        let ids = table.texts(names[id])?;
        let (surfaces, sphere) = patterns(folder, &ids);
        match surfaces.split_first() {
            Some((first, others)) => {
                let mut lines = format!("surface = \"{}\"", escaped(&first.pattern));
                for Pattern { pattern, subjects } in others.iter().take(LISTED) {
                    lines +=
                        &format!("\n# or, for {}: surface = \"{}\"", counted(*subjects, "subject"), escaped(pattern));
                }
                replace("# surface = \"subjects/{id}/surf/lh.pial\"", &lines);
                let (found, all) = (first.subjects, ids.len());
                notes.push(format!("surfaces: {} ({found} of {all} subjects have such a file)", first.pattern));
            }
            None => notes.push(format!(
                "below the folder of the study file, found no surface or label volume whose path contains an id such \
                 as {:?}; fill in `surface`",
                ids[0]
            )),
        }
        if let Some(sphere) = sphere {
            replace("# sphere = \"subjects/{id}/surf/lh.sphere.reg\"", &format!("sphere = \"{}\"", escaped(&sphere)));
            notes.push(format!("spheres: {sphere}"));
        }
    }
    let others: Vec<&str> = names.iter().enumerate().filter(|(at, _)| *at != id).map(|(_, name)| *name).collect();
    match effect(&table, &others) {
        Some((name, levels)) => {
            replace("effect = \"group\"", &format!("effect = \"{}\"", escaped(name)));
            replace("name = \"group\"", &format!("name = \"{}\"", escaped(name)));
            replace("title = \"Study\"", &format!("title = \"Shape by {}\"", escaped(name)));
            if let [a, b] = &levels[..] {
                let both = format!("# levels = [\"{}\", \"{}\"]", escaped(a), escaped(b));
                replace("# levels = [\"patient\", \"control\"]", &both);
                notes.push(format!("tested: {name}, {a} minus {b}"));
            } else {
                notes.push(format!("tested: {name}"));
            }
        }
        None => notes.push("found no column to test; fill in `effect`".to_owned()),
    }
    Ok(Filled { text, notes })
}

/// Returns the index of the column of ids: one with a usual name, or else the first column whose cells all differ.
fn id_column(table: &Table, names: &[&str]) -> usize {
    let usual = IDS.iter().find_map(|id| names.iter().position(|name| name.eq_ignore_ascii_case(id)));
    let different = || names.iter().position(|name| table.different(name).is_ok());
    usual.or_else(different).unwrap_or(0)
}

/// Returns the column to test and its distinct cells, sorted. Prefers a column with a usual name and 2 to 20 distinct
/// cells, then a column of two levels, then a column of numbers.
fn effect<'a>(table: &Table, names: &[&'a str]) -> Option<(&'a str, Vec<String>)> {
    let levels = |name: &str| -> Vec<String> {
        let cells: BTreeSet<&str> = table.cells(name).unwrap_or_default().into_iter().collect();
        cells.into_iter().map(str::to_owned).collect()
    };
    let usual = EFFECTS.iter().filter_map(|effect| names.iter().find(|name| name.eq_ignore_ascii_case(effect)));
    let found = usual.copied().find(|name| (2..=20).contains(&levels(name).len()));
    let found = found.or_else(|| names.iter().copied().find(|name| levels(name).len() == 2));
    let numbers = || names.iter().copied().find(|name| table.numbers(name).is_ok() && levels(name).len() > 2);
    found.or_else(numbers).map(|name| (name, levels(name)))
}

/// Finds the subjects' files below a folder. Returns patterns of surfaces, the best first. Also returns the pattern of
/// the spheres that belong to the best pattern, if every subject with such a surface has a sphere.
fn patterns(folder: &Path, ids: &[&str]) -> (Vec<Pattern>, Option<String>) {
    let (mut files, ids) = (BTreeSet::new(), ids.iter().copied().collect::<BTreeSet<_>>());
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    list(here, "", DEPTH, &mut files);
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for file in files.iter().filter(|file| is_surface(file)) {
        // If one id begins with another id, as a-b begins with a, the longer id is later in the sorted set and is
        // therefore tried first.
        if let Some(pattern) = ids.iter().rev().find_map(|id| pattern_of(file, id)) {
            *counts.entry(pattern).or_default() += 1;
        }
    }
    let mut found: Vec<Pattern> =
        counts.into_iter().map(|(pattern, subjects)| Pattern { pattern, subjects: subjects.min(ids.len()) }).collect();
    found.sort_by_key(|of| (usize::MAX - of.subjects, is_volume(Path::new(&of.pattern)), of.pattern.len()));
    let sphere = found.first().and_then(|best| {
        let (folder, name) = best.pattern.rsplit_once('/')?;
        let hemi = name.split_once('.').map(|(hemi, _)| hemi).filter(|hemi| ["lh", "rh"].contains(hemi))?;
        let sphere = format!("{folder}/{hemi}.sphere.reg");
        let has = |pattern: &str, id: &str| files.contains(&pattern.replace("{id}", id));
        ids.iter().all(|id| has(&sphere, id) || !has(&best.pattern, id)).then_some(sphere)
    });
    (found, sphere)
}

/// Collects the relative paths of the files below a folder, without hidden files.
fn list(folder: &Path, relative: &str, depth: usize, files: &mut BTreeSet<String>) {
    // Folders that can't be read are skipped, because the study couldn't read surfaces in them either.
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let Ok(name) = entry.file_name().into_string() else { continue };
        if name.starts_with('.') || files.len() >= FILES {
            continue;
        }
        let relative = if relative.is_empty() { name } else { format!("{relative}/{name}") };
        let path = entry.path();
        if path.is_dir() && depth > 0 {
            list(&path, &relative, depth - 1, files);
        } else if path.is_file() {
            files.insert(relative);
        }
    }
}

/// Returns a path with an id replaced by `{id}`, if the path contains it as a whole word.
fn pattern_of(path: &str, id: &str) -> Option<String> {
    let is_word = |at: usize| {
        let (before, after) = (path[..at].chars().next_back(), path[at + id.len()..].chars().next());
        [before, after].into_iter().flatten().all(|next| !next.is_alphanumeric())
    };
    let found = !id.is_empty() && path.match_indices(id).any(|(at, _)| is_word(at));
    found.then(|| path.replace(id, "{id}"))
}

/// Returns whether a file has the name of a surface, or of a volume that may contain labels.
fn is_surface(path: &str) -> bool {
    let name = path.rsplit('/').next().unwrap_or(path).to_ascii_lowercase();
    if is_named_sphere(&name) {
        return false;
    }
    let unpacked = name.strip_suffix(".gz").unwrap_or(&name);
    let path = Path::new(path);
    let mesh = is_named_mesh(path) && !is_named_signal(path);
    let freesurfer = ["lh.pial", "lh.white", "rh.pial", "rh.white"].contains(&unpacked);
    mesh || freesurfer || (is_volume(path) && !IMAGES.iter().any(|image| name.contains(image)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_whole_words_of_paths() {
        assert_eq!(pattern_of("d/sub-1/sub-1_hemi-L.ply", "sub-1").as_deref(), Some("d/{id}/{id}_hemi-L.ply"));
        assert_eq!(pattern_of("d/sub-10/a.ply", "sub-1"), None);
        assert_eq!(pattern_of("xsub-1.ply", "sub-1"), None);
        assert_eq!(pattern_of("a.ply", ""), None);
    }

    #[test]
    fn surfaces_and_labels_are_told_from_other_files() {
        for surface in ["a/lh.pial", "x.surf.gii", "b.obj.gz", "sub-1_dseg.nii.gz", "aseg.mgz"] {
            assert!(is_surface(surface), "{surface}");
        }
        for other in ["lh.sphere.reg", "sub-1_T1w.nii.gz", "lh.thickness", "x.func.gii", "notes.txt", "orig.mgz"] {
            assert!(!is_surface(other), "{other}");
        }
    }
}
