//! Finds inputs that occur more than once, even if their files have different names.

use std::collections::BTreeMap;
use std::path::PathBuf;

use spharm::FileRecord;

use crate::Row;

/// Groups names that share a key, such as the contents of a file.
#[derive(Debug)]
pub struct EqualSets<Key>(BTreeMap<Key, Vec<String>>);

impl<Key> Default for EqualSets<Key> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<Key: Ord> EqualSets<Key> {
    /// Adds a name under its key.
    pub fn add(&mut self, key: Key, name: String) {
        self.0.entry(key).or_default().push(name);
    }

    /// Returns each set of two or more names with the same key. The sets, and the names of each set, are sorted.
    pub fn sets(&self) -> Vec<Vec<&str>> {
        let several = self.0.values().filter(|names| names.len() > 1);
        let mut sets: Vec<Vec<&str>> = several.map(|names| names.iter().map(String::as_str).collect()).collect();
        sets.iter_mut().for_each(|names| names.sort_unstable());
        sets.sort_unstable();
        sets
    }
}

/// Key that identifies a model's input: the hash of the file's contents, the label, and the path of the weights. The
/// sphere isn't included, because a duplicated subject has its own sphere, with another path.
type Made = (String, Option<i64>, Option<PathBuf>);

/// The inputs of a run, grouped by their contents.
#[derive(Debug, Default)]
pub struct Inputs(EqualSets<Made>);

impl Inputs {
    /// Adds the input of a row. `record` is the record of its file.
    pub fn add_row(&mut self, row: &Row, record: &FileRecord) {
        self.add(record, row.weights.clone(), row.id.clone());
    }

    /// Adds an input under a name, usually the id of a row.
    pub fn add(&mut self, record: &FileRecord, weights: Option<PathBuf>, name: String) {
        self.0.add((record.blake3.clone(), record.label, weights), name);
    }

    /// Returns a warning for each set of equal inputs.
    pub fn warnings(&self) -> Vec<String> {
        self.0.sets().iter().map(|names| same_inputs(names)).collect()
    }
}

/// Returns a list of the first `most` names and the number of further names, such as `a, b and 3 more`.
pub fn first_of<'a>(names: impl IntoIterator<Item = &'a str>, most: usize) -> String {
    let mut names = names.into_iter();
    let shown: Vec<&str> = names.by_ref().take(most).collect();
    match names.count() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Returns a warning that the named inputs are equal.
pub fn same_inputs(names: &[&str]) -> String {
    const NAMED: usize = 12;
    let named = first_of(names.iter().copied(), NAMED);
    format!("{named}: these inputs are equal, byte for byte; does one of the files belong to another subject?")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(blake3: &str, label: Option<i64>) -> FileRecord {
        FileRecord { path: String::new(), bytes: 1, blake3: blake3.to_owned(), label, ..FileRecord::default() }
    }

    #[test]
    fn equal_inputs_are_named_unless_they_are_used_differently() {
        let mut inputs = Inputs::default();
        let weights = |name: &str| Some(PathBuf::from(name));
        inputs.add(&record("x", None), None, "s3".into());
        inputs.add(&record("y", Some(1)), None, "one".into());
        inputs.add(&record("y", Some(2)), None, "two".into());
        inputs.add(&record("x", None), None, "s1".into());
        inputs.add(&record("z", None), weights("a"), "a".into());
        inputs.add(&record("z", None), weights("b"), "b".into());
        let [only] = &inputs.warnings()[..] else { panic!("{:?}", inputs.warnings()) };
        assert!(only.starts_with("s1, s3: these inputs are equal"), "{only}");
        (0..20).for_each(|n| inputs.add(&record("w", None), None, format!("n{n:02}")));
        assert!(inputs.warnings()[0].contains("n11 and 8 more: "), "{:?}", inputs.warnings());
    }
}
