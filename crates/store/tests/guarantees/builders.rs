//! Tests the behaviour of builds: they plan memory and disk space, wait for other builds, and remove the leftovers of
//! killed builds.

use std::fs::File;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use spharm_monitor::{Level, Monitor, Silent, Stage};
use spharm_store::catalog::{leftovers, remove_leftovers};
use spharm_store::factor::start_factor;
use spharm_store::{BuildParams, Codec, Scalar, StoreError, TileGrid, build};

use crate::{MAX_DEGREE, directions, params, path_of, spec, store};

/// A monitor that records notes and progress, and cancels at the first note that contains a given word.
#[derive(Default)]
struct Listening {
    cancel_with: Option<&'static str>,
    cancelled: AtomicBool,
    notes: Mutex<Vec<String>>,
    total: AtomicU64,
    steps: AtomicU64,
}

impl Monitor for Listening {
    fn begin(&self, _: Stage, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    fn step(&self, steps: u64) {
        self.steps.fetch_add(steps, Ordering::Relaxed);
    }

    fn note(&self, _: Level, text: std::fmt::Arguments<'_>) {
        let text = text.to_string();
        if self.cancel_with.is_some_and(|word| text.contains(word)) {
            self.cancelled.store(true, Ordering::Relaxed);
        }
        self.notes.lock().expect("a lock").push(text);
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

fn len(path: &Path) -> u64 {
    std::fs::metadata(path).expect("a file").len()
}

#[test]
fn a_report_counts_what_was_built_and_what_was_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let built = |max_degree| {
        let listening = Listening::default();
        // The store was created with 8 rows per chunk; a build that asks for 16 keeps 8.
        let chunk_rows = if max_degree == 2 { 8 } else { 16 };
        let params = BuildParams { max_degree, chunk_rows, ..params() };
        let report = build(folder.path(), &directions(), &params, &listening).expect("a build");
        assert_eq!((report.chunk_rows, &report.folder), (8, &folder.path().join(report.key.to_string())));
        let lens: Vec<u64> = (0..=max_degree).map(|degree| len(&report.folder.join(format!("A_{degree}")))).collect();
        assert_eq!(report.bytes, lens.iter().sum::<u64>());
        assert_eq!(report.bytes_written, lens[lens.len() - report.built..].iter().sum::<u64>());
        let (total, steps) = (listening.total.into_inner(), listening.steps.into_inner());
        // Steps count the bytes of values only. The announced total also includes table, header and footer, but not the
        // padding.
        let values: u64 = (0..=max_degree as u64).rev().take(report.built).map(|l| 18 * (2 * l + 1) * 8).sum();
        assert_eq!(steps, values);
        let padding = 3 * 64 * report.built as u64;
        assert!(total <= report.bytes_written && report.bytes_written <= total + padding, "{total} {report:?}");
        let notes = listening.notes.into_inner().expect("a lock");
        assert_eq!(notes.iter().any(|note| note.contains("already exist")), report.present > 0, "{notes:?}");
        (report.built, report.present)
    };
    assert_eq!(built(2), (3, 0));
    assert_eq!(built(4), (2, 3));
    assert_eq!(built(4), (0, 5));
}

#[test]
fn what_the_format_or_the_budget_has_no_room_for_is_refused_before_anything_is_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let refused = |params: &BuildParams| {
        let error = build(folder.path(), &directions(), params, &Silent).expect_err("a refusal");
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "{error}");
        error
    };
    for chunk_rows in [0, 7, (1 << 20) + 8] {
        let error = refused(&BuildParams { chunk_rows, ..params() });
        assert!(matches!(error, StoreError::ChunkRows { found } if found == chunk_rows), "{error}");
    }
    // Degree 256 has 513 columns: a chunk of 2^20 rows exceeds the limit of 2^32 bytes.
    let wide = BuildParams { chunk_rows: 1 << 20, max_degree: 256, ..params() };
    assert!(matches!(refused(&wide), StoreError::Layout { rows: 18, degree: 256, chunk_rows: 1_048_576 }));
    assert!(matches!(refused(&BuildParams { max_degree: 2001, ..params() }), StoreError::Harmonics(_)));
    let StoreError::Budget { budget: 1, needed } = refused(&BuildParams { memory: 1, ..params() }) else {
        panic!("a byte is enough")
    };
    let below = refused(&BuildParams { memory: needed - 1, ..params() });
    assert!(below.to_string().contains(&format!("at least {} MiB", needed.div_ceil(1 << 20))), "{below}");
    let report = build(folder.path(), &directions(), &BuildParams { memory: needed, ..params() }, &Silent);
    let report = report.expect("what the refusal named");
    assert_eq!((report.threads, report.memory), (1, needed));
    // The largest chunk that the format allows: 2^20 rows of degree 255, which has 511 columns of doubles.
    let most = BuildParams { chunk_rows: 1 << 20, max_degree: 255, memory: usize::MAX, ..params() };
    let other = tempfile::tempdir().expect("a folder");
    assert!(
        build(other.path(), &directions(), &most, &AtomicBool::new(true))
            .is_err_and(|error| { matches!(error, StoreError::Interrupted(_)) })
    );
}

#[test]
fn the_bytes_of_files_depend_on_no_threads() {
    for codec in [Codec::Raw, Codec::Zstd] {
        let folder = |threads: usize| {
            let folder = tempfile::tempdir().expect("a folder");
            let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().expect("threads");
            let params = BuildParams { codec, threads, max_degree: 9, ..params() };
            let report = pool.install(|| build(folder.path(), &directions(), &params, &Silent)).expect("a build");
            assert_eq!(report.threads, if threads == 0 { 4 } else { threads });
            (0..=9).map(|l| std::fs::read(report.folder.join(format!("A_{l}"))).expect("a file")).collect::<Vec<_>>()
        };
        let alone = folder(1);
        assert!(alone == folder(3) && alone == folder(0), "{codec:?}");
    }
}

#[test]
fn a_build_waits_for_another_and_says_so_once() {
    let (folder, key) = store(&params());
    let path = path_of(folder.path(), key, ".lock");
    let other = File::options().write(true).create(true).truncate(false).open(&path).expect("a file");
    other.lock().expect("a lock");
    let more = BuildParams { max_degree: MAX_DEGREE + 1, ..params() };
    let listening = Listening { cancel_with: Some("another build"), ..Listening::default() };
    let error = build(folder.path(), &directions(), &more, &listening).expect_err("an interruption");
    assert!(matches!(error, StoreError::Interrupted(_)), "{error}");
    let start = |monitor: &dyn Monitor| {
        let grid = TileGrid::new(spec(key).size(), 8).expect("a grid");
        start_factor(folder.path(), &spec(key), Scalar::F64, grid, false, monitor)
    };
    let listening = Listening { cancel_with: Some("another build"), ..Listening::default() };
    assert!(matches!(start(&listening), Err(StoreError::Interrupted(_))));
    // A build with no missing files doesn't take the lock, so it doesn't wait.
    build(folder.path(), &directions(), &params(), &Silent).expect("a build of nothing");
    let listening = Listening::default();
    std::thread::scope(|scope| {
        let build = scope.spawn(|| build(folder.path(), &directions(), &more, &listening));
        while listening.notes.lock().expect("a lock").is_empty() {
            std::thread::yield_now();
        }
        // Wait long enough for two of the lock's polling intervals of 100 ms.
        std::thread::sleep(std::time::Duration::from_millis(250));
        assert!(!build.is_finished());
        other.unlock().expect("an unlocking");
        assert_eq!(build.join().expect("no panic").expect("a build").built, 1);
    });
    let notes = listening.notes.into_inner().expect("a lock");
    assert_eq!(notes.iter().filter(|note| note.contains("another build")).count(), 1, "{notes:?}");
    start(&Silent).expect("a factor");
}

#[test]
fn a_lock_that_is_a_link_is_not_followed() {
    let (folder, key) = store(&params());
    let victim = folder.path().join("victim");
    let lock = path_of(folder.path(), key, ".lock");
    let _ = std::fs::remove_file(&lock);
    std::os::unix::fs::symlink(&victim, &lock).expect("a link");
    let more = BuildParams { max_degree: MAX_DEGREE + 1, ..params() };
    build(folder.path(), &directions(), &more, &Silent).expect("a build without a lock");
    assert!(!victim.exists());
}

#[test]
fn what_killed_builds_left_is_listed_and_removed_and_nothing_else() {
    let (folder, key) = store(&params());
    let at = |name: &str| path_of(folder.path(), key, name);
    let left = [at(".A_1.abc.tmp"), at(".factor_2.abc.tmp")];
    let kept = [at(".A_1.used.tmp"), at(".B_1.abc.tmp"), at(".A_1.abc"), at("A_1.tmp"), at("notes.tmp")];
    for path in left.iter().chain(&kept) {
        std::fs::write(path, "half of a file").expect("a file");
    }
    std::fs::create_dir(at(".A_2.folder.tmp")).expect("a folder");
    let used = File::open(&kept[0]).expect("a file");
    used.lock().expect("a lock");
    let sorted = |mut paths: Vec<_>| {
        paths.sort();
        paths
    };
    assert_eq!(sorted(leftovers(folder.path(), key).expect("a folder")), left);
    assert!(left.iter().all(|path| path.exists()));
    assert_eq!(sorted(remove_leftovers(folder.path(), key).expect("a folder")), left);
    assert!(left.iter().all(|path| !path.exists()) && kept.iter().all(|path| path.exists()));
    assert!(at(".A_2.folder.tmp").is_dir());
    // A build also removes leftovers, even if no files are missing, and so does starting a factor.
    std::fs::write(&left[0], "half of a file").expect("a file");
    build(folder.path(), &directions(), &params(), &Silent).expect("a build");
    assert!(!left[0].exists() && kept[0].exists());
    std::fs::write(&left[1], "half of a file").expect("a file");
    crate::write_factor(folder.path(), key, Scalar::F64);
    assert!(!left[1].exists() && kept[0].exists());
}
