//! Groups rows with the same sphere and weights, so that these rows share plans, transforms and factors.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use spharm::FileRecord;

use crate::Row;

/// Rows that are fitted over the same sphere with the same weights.
pub(super) struct Group {
    /// Path of the sphere, or `None` for rows whose surfaces are mapped to separate spheres.
    pub(super) sphere: Option<PathBuf>,
    /// Indices of the rows, at least one.
    pub(super) rows: Vec<usize>,
}

/// Groups the rows with the indices `numbers` by their spheres and weights. Groups are in the order of their first
/// rows. Two spheres are the same if their paths are equal, or if their files have equal size and contents.
pub(super) fn groups(rows: &[Row], numbers: &[usize]) -> Vec<Group> {
    let same = same_spheres(numbers.iter().map(|&number| &rows[number]));
    let (mut groups, mut places): (Vec<Group>, HashMap<_, usize>) = (Vec::new(), HashMap::new());
    for &number in numbers {
        let row = &rows[number];
        let sphere = row.sphere.as_deref().map(|path| same.get(path).copied().unwrap_or(path));
        let place = *places.entry((sphere, row.weights.as_deref())).or_insert_with(|| {
            groups.push(Group { sphere: sphere.map(Path::to_owned), rows: Vec::new() });
            groups.len() - 1
        });
        groups[place].rows.push(number);
    }
    groups
}

/// Maps the path of each sphere to the path of the first sphere with equal contents. Unreadable files are skipped here,
/// because the fit refuses them.
fn same_spheres<'a>(rows: impl Iterator<Item = &'a Row>) -> HashMap<&'a Path, &'a Path> {
    let (mut seen, mut paths) = (HashSet::new(), Vec::new());
    for path in rows.filter_map(|row| row.sphere.as_deref()) {
        if seen.insert(path) {
            paths.push(path);
        }
    }
    let mut same = HashMap::new();
    if paths.len() < 2 {
        return same;
    }
    let mut by_size: HashMap<u64, Vec<&Path>> = HashMap::new();
    for path in paths {
        if let Ok(metadata) = std::fs::metadata(path) {
            by_size.entry(metadata.len()).or_default().push(path);
        }
    }
    for paths in by_size.into_values().filter(|paths| paths.len() > 1) {
        let mut firsts: HashMap<String, &Path> = HashMap::new();
        for path in paths {
            if let Ok(record) = FileRecord::of(path) {
                same.insert(path, *firsts.entry(record.blake3).or_insert(path));
            }
        }
    }
    same
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_grouped_by_what_their_spheres_hold() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, contents) in [("a", "one"), ("b", "two"), ("copy", "one"), ("longer", "three")] {
            std::fs::write(path(name), contents).unwrap();
        }
        let row = |sphere: &str| Row { sphere: Some(path(sphere)), ..Row::default() };
        let mut rows = ["a", "b", "copy", "missing", "a", "longer"].map(row).to_vec();
        rows.push(Row::default());
        rows.push(Row { weights: Some("w".into()), ..row("a") });
        let found: Vec<Vec<usize>> =
            groups(&rows, &[0, 1, 2, 3, 4, 5, 6, 7]).into_iter().map(|group| group.rows).collect();
        assert_eq!(found, [vec![0, 2, 4], vec![1], vec![3], vec![5], vec![6], vec![7]]);
    }
}
