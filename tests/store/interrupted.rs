//! The bytes of a store depend only on the scheme, the scalar type and the codec: not on threads, memory, or the number
//! of interruptions of a build.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use spharm_monitor::{Monitor, Silent};
use spharm_store::{BuildParams, Codec, Scalar, StoreError, build};

use super::{Random, build_here, directions, leftovers, only_scheme, verified};
use crate::common::times;

const N: usize = 700;
const MAX_DEGREE: usize = 24;

/// Monitor that stops a build at the first step at which the condition holds.
struct StopWhen<F> {
    condition: F,
    stopped: AtomicBool,
}

impl<F: Fn() -> bool + Sync> StopWhen<F> {
    fn new(condition: F) -> Self {
        Self { condition, stopped: AtomicBool::new(false) }
    }
}

impl<F: Fn() -> bool + Sync> Monitor for StopWhen<F> {
    fn step(&self, _: u64) {
        if (self.condition)() {
            self.stopped.store(true, Ordering::Relaxed);
        }
    }

    fn cancelled(&self) -> bool {
        self.stopped.cancelled()
    }
}

/// Returns the smallest memory budget of a build, as stated by its refusal of a smaller one.
fn least_memory(store: &Path, params: &BuildParams) -> usize {
    let params = BuildParams { memory: 1, ..params.clone() };
    match build(store, &directions(N), &params, &Silent) {
        Err(StoreError::Budget { needed, .. }) => needed,
        other => panic!("{other:?}"),
    }
}

#[test]
fn threads_memory_and_interruptions_do_not_show_in_the_bytes() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().expect("threads");
    for (codec, scalar) in
        [(Codec::Raw, Scalar::F64), (Codec::Raw, Scalar::F32), (Codec::Zstd, Scalar::F64), (Codec::Zstd, Scalar::F32)]
    {
        let folder = tempfile::tempdir().expect("a folder");
        let params =
            BuildParams { max_degree: MAX_DEGREE, codec, scalar, chunk_rows: 64, threads: 1, ..BuildParams::default() };
        let reference = folder.path().join("reference");
        let key = build_here(&reference, N, &params);
        let expected = verified(&reference);
        let least = least_memory(&folder.path().join("nothing"), &params);
        let mut random = Random(4);
        for round in 0..times(40) {
            let store = folder.path().join(format!("store{round}"));
            // Several runs have different settings and degrees, and each is stopped at another chunk.
            for _ in 0..3 {
                let stop_after = random.below(200) as usize;
                let params = BuildParams {
                    threads: 1 + random.below(4) as usize,
                    memory: least + random.below(3 * least as u64) as usize,
                    max_degree: random.below(MAX_DEGREE as u64 + 1) as usize,
                    ..params.clone()
                };
                let seen = AtomicUsize::new(0);
                let count = StopWhen::new(|| seen.fetch_add(1, Ordering::Relaxed) + 1 == stop_after);
                match pool.install(|| build(&store, &directions(N), &params, &count)) {
                    Ok(_) | Err(StoreError::Interrupted(_)) => {}
                    Err(error) => panic!("{error}"),
                }
                assert_eq!(leftovers(&store), [""; 0]);
                // Delete the file of a degree in the middle.
                let lost = store.join(key.to_string()).join(format!("A_{}", random.below(MAX_DEGREE as u64)));
                let _ = std::fs::remove_file(lost);
            }
            let threads = 1 + round % 4;
            let params = BuildParams { threads, memory: least + round % 2 * (64 << 20), ..params.clone() };
            pool.install(|| build_here(&store, N, &params));
            assert!(verified(&store) == expected, "{codec:?} {scalar:?} round {round}");
            assert_eq!(leftovers(&store), [""; 0]);
            std::fs::remove_dir_all(&store).expect("a removal");
        }
    }
}

/// After an interruption, the groups of degrees that were finished are kept.
#[test]
fn an_interrupted_build_keeps_what_is_finished() {
    const ROWS: usize = 8;
    // At most 256 files are written at a time, so this degree gives several groups.
    const HIGH: usize = 1100;
    let folder = tempfile::tempdir().expect("a folder");
    let params = BuildParams { max_degree: HIGH, codec: Codec::Raw, ..BuildParams::default() };
    let store = folder.path().join("store");
    let first = store.join(spharm_store::SchemeKey::of(&directions(ROWS), Scalar::F64).to_string()).join("A_0");
    let stop = StopWhen::new(|| first.exists());
    let error = build(&store, &directions(ROWS), &params, &stop).expect_err("an interruption");
    assert!(matches!(error, StoreError::Interrupted(_)));
    assert_eq!(only_scheme(&store), spharm_store::SchemeKey::of(&directions(ROWS), Scalar::F64));
    let kept = verified(&store);
    assert!((256..=HIGH).contains(&kept.len()), "{}", kept.len());
    assert_eq!(leftovers(&store), [""; 0]);
    let report = build(&store, &directions(ROWS), &params, &Silent).expect("the rest");
    assert_eq!((report.built, report.present), (HIGH + 1 - kept.len(), kept.len()));
    let all: BTreeMap<usize, Vec<u8>> = verified(&store);
    assert!(kept.iter().all(|(degree, bytes)| all[degree] == *bytes));
    assert_eq!(all.len(), HIGH + 1);
}
