//! Tests status files after kills and full disks, and among unrelated files.

use std::path::Path;

use proptest::prelude::*;
use spharm_cohort::{CohortError, Entry, Merged, State, StatusFile};

fn entry(id: &str, state: State) -> Entry {
    Entry::new(id, state)
}

fn write(path: &Path, entries: &[Entry]) {
    let mut file = StatusFile::open(path).expect("a file");
    entries.iter().for_each(|entry| file.append(entry).expect("a line"));
}

fn states(merged: &Merged) -> Vec<(&str, State)> {
    merged.entries().iter().map(|entry| (entry.id.as_str(), entry.state)).collect()
}

#[test]
fn lines_come_back_as_they_were_and_are_lines() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("deep/0.tsv");
    let full = Entry {
        msd: Some(1.0 / 3.0),
        xsd: Some(2.5e-300),
        seconds: Some(0.125),
        output: "out/a \"b\".spharm.npz".to_owned(),
        ..entry("#a", State::Done)
    };
    let failed = Entry { error: "x.ply: line 3:\n\"no\"\tnumber".to_owned(), ..entry("b", State::Failed) };
    write(&path, &[full.clone(), failed]);
    let text = std::fs::read_to_string(&path).expect("a table");
    assert_eq!(text.lines().next(), Some("id\tstate\tmsd\txsd\tseconds\terror\toutput"));
    assert_eq!(text.lines().count(), 3);
    let merged = Merged::read([path]).expect("a status");
    assert_eq!(merged.entry("#a"), Some(&full));
    assert_eq!(merged.entry("b").map(|entry| entry.error.as_str()), Some("x.ply: line 3: \"no\" number"));
}

/// Ids and paths may come from the names of files.
#[test]
fn ids_and_paths_with_unusual_characters_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("0.tsv");
    let named = |id: &str| Entry { output: format!("out/{id}.npz"), ..entry(id, State::Done) };
    let entries = ["a\tb", "-dash", "@list", "=1+1", "'-x", "\"q\""].map(named);
    write(&path, &entries);
    let ended = named("c\nd");
    write(&path, std::slice::from_ref(&ended));
    let merged = Merged::read([&path]).expect("a status");
    let ended = Entry { id: "c d".to_owned(), output: String::new(), ..ended };
    assert_eq!(merged.entries(), [&entries[..], &[ended]].concat());
    assert_eq!(std::fs::read_to_string(&path).expect("a table").lines().count(), 8);
}

#[test]
fn the_last_line_of_a_row_counts_but_that_it_was_there_hides_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let done = Entry { msd: Some(1.0), ..entry("a", State::Done) };
    write(&path("0.tsv"), &[entry("b", State::Interrupted), done.clone(), entry("c", State::Failed)]);
    // Append a resumed run to the first file. The second file is written by a process with another number of shards.
    write(&path("0.tsv"), &[entry("a", State::Skipped), entry("b", State::Done)]);
    write(&path("1.tsv"), &[entry("b", State::Failed), entry("c", State::Skipped), entry("d", State::Failed)]);
    let merged = Merged::read([path("0.tsv"), path("1.tsv")]).expect("a status");
    let expected = [("b", State::Done), ("a", State::Done), ("c", State::Skipped), ("d", State::Failed)];
    assert_eq!(states(&merged), expected);
    assert_eq!(merged.entry("a"), Some(&done));
    assert_eq!((merged.count(State::Done), merged.count(State::Failed), merged.damaged), (2, 1, 0));
    // Within a file, a later failure replaces an earlier success.
    write(&path("0.tsv"), &[entry("b", State::Failed)]);
    assert_eq!(
        Merged::read([path("0.tsv")]).expect("a status").entry("b").map(|entry| entry.state),
        Some(State::Failed)
    );
}

#[test]
fn what_is_no_status_file_is_not_written_to() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("subjects.tsv");
    std::fs::write(&path, "id\tsurface\na\tb\n").expect("written");
    for error in [StatusFile::open(&path).expect_err("refused"), Merged::read([&path]).expect_err("refused")] {
        assert!(matches!(error, CohortError::NotStatus { .. }), "{error}");
    }
    assert_eq!(std::fs::read(&path).expect("there"), b"id\tsurface\na\tb\n");
    let missing = Merged::read(["no/such.tsv"]).expect_err("refused").to_string();
    assert!(missing.starts_with("no/such.tsv: cannot read"), "{missing}");
}

#[test]
fn two_processes_do_not_share_a_status_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("0.tsv");
    let first = StatusFile::open(&path).expect("a file");
    let error = StatusFile::open(&path).expect_err("it is open");
    assert!(matches!(error, CohortError::Locked { .. }), "{error}");
    drop(first);
    StatusFile::open(&path).expect("it is free again");
}

proptest! {
    /// A full disk, or a kill during writing, leaves an incomplete last line. The complete lines before it are valid,
    /// and the next run appends after them.
    #[test]
    fn a_part_of_a_line_is_cut_off(cut in 0usize..400) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("0.tsv");
        let all: Vec<Entry> = (0..6).map(|row| Entry { output: format!("out/{row}"), ..entry(&format!("r{row}"), State::Done) }).collect();
        write(&path, &all);
        let bytes = std::fs::read(&path).expect("a table");
        let cut = cut.min(bytes.len());
        std::fs::write(&path, &bytes[..cut]).expect("cut");
        let whole = bytes[..cut].iter().filter(|&&byte| byte == b'\n').count().saturating_sub(1);
        let before = Merged::read([&path]).expect("a status");
        prop_assert_eq!(before.entries(), &all[..whole]);
        write(&path, &all[whole..]);
        let after = Merged::read([&path]).expect("a status");
        prop_assert_eq!(after.entries(), &all[..]);
        prop_assert_eq!(after.damaged, 0);
        prop_assert_eq!(std::fs::read(&path).expect("a table"), bytes);
    }
}
