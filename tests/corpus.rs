//! Runs every reader on `tests/data/hostile`: inputs found by the fuzzer of `./run attack`, and inputs that reach each
//! branch of the readers. The readers and the checked properties are the same as in the fuzzer.

use crate::common::root;

#[path = "../fuzz/src/readers/mod.rs"]
mod readers;

#[test]
fn readers_keep_their_promises_for_hostile_files() {
    let scratch = tempfile::tempdir().expect("a folder");
    for (name, _) in readers::READERS {
        let folder = root().join("tests/data/hostile").join(name);
        let mut count = 0;
        for entry in std::fs::read_dir(&folder).expect("the inputs of each reader") {
            let path = entry.expect("an entry").path();
            eprintln!("{}", path.display());
            readers::run(name, scratch.path(), &std::fs::read(&path).expect("an input"));
            count += 1;
        }
        assert!(count > 0, "{} is empty", folder.display());
    }
}
