//! The bytes of a store depend on the scheme, the scalar type and the codec alone: not on threads, memory, or how often
//! a build was interrupted.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use spharm_store::{BuildEvent, BuildParams, Codec, Scalar, StoreError, build};

use super::{Random, build_here, directions, leftovers, only_scheme, verified};
use crate::common::times;

const N: usize = 700;
const MAX_DEGREE: usize = 24;

/// The least memory that a build works in, which its refusal names.
fn least_memory(store: &Path, params: &BuildParams) -> usize {
    let params = BuildParams { memory: 1, ..params.clone() };
    match build(store, &directions(N), &params, &AtomicBool::new(false), &|_| {}) {
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
            // Several runs on the way, each with other settings, to another degree, and stopped at another chunk.
            for _ in 0..3 {
                let stop_after = random.below(200) as usize;
                let params = BuildParams {
                    threads: 1 + random.below(4) as usize,
                    memory: least + random.below(3 * least as u64) as usize,
                    max_degree: random.below(MAX_DEGREE as u64 + 1) as usize,
                    ..params.clone()
                };
                let (cancel, seen) = (AtomicBool::new(false), AtomicUsize::new(0));
                let count = |event: BuildEvent<'_>| {
                    if matches!(event, BuildEvent::Progress(_))
                        && seen.fetch_add(1, Ordering::Relaxed) + 1 == stop_after
                    {
                        cancel.store(true, Ordering::Relaxed);
                    }
                };
                match pool.install(|| build(&store, &directions(N), &params, &cancel, &count)) {
                    Ok(_) | Err(StoreError::Interrupted) => {}
                    Err(error) => panic!("{error}"),
                }
                assert_eq!(leftovers(&store), [""; 0]);
                // A degree goes missing in the middle.
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

/// Of many degrees, the groups that were finished before an interruption stay.
#[test]
fn an_interrupted_build_keeps_what_is_finished() {
    const ROWS: usize = 8;
    // 256 files at most are written at a time, so these are several groups.
    const HIGH: usize = 1100;
    let folder = tempfile::tempdir().expect("a folder");
    let params = BuildParams { max_degree: HIGH, codec: Codec::Raw, ..BuildParams::default() };
    let (store, cancel) = (folder.path().join("store"), AtomicBool::new(false));
    let first = store.join(spharm_store::SchemeKey::of(&directions(ROWS), Scalar::F64).to_string()).join("A_0");
    let stop = |event: BuildEvent<'_>| {
        if matches!(event, BuildEvent::Progress(_)) && first.exists() {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    let error = build(&store, &directions(ROWS), &params, &cancel, &stop).expect_err("an interruption");
    assert!(matches!(error, StoreError::Interrupted));
    assert_eq!(only_scheme(&store), spharm_store::SchemeKey::of(&directions(ROWS), Scalar::F64));
    let kept = verified(&store);
    assert!((256..=HIGH).contains(&kept.len()), "{}", kept.len());
    assert_eq!(leftovers(&store), [""; 0]);
    let never = AtomicBool::new(false);
    let report = build(&store, &directions(ROWS), &params, &never, &|_| {}).expect("the rest");
    assert_eq!((report.built, report.present), (HIGH + 1 - kept.len(), kept.len()));
    let all: BTreeMap<usize, Vec<u8>> = verified(&store);
    assert!(kept.iter().all(|(degree, bytes)| all[degree] == *bytes));
    assert_eq!(all.len(), HIGH + 1);
}
