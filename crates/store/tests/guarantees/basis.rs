//! Tests that a basis file returns the values that were built, for every codec and scalar type, and that a build stops
//! when its monitor is cancelled.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use spharm_harmonics::textbook::harmonic;
use spharm_monitor::{Monitor, Silent, Stage};
use spharm_store::{BuildParams, Codec, Scalar, Scheme, StoreError, StoreWarning, build};

use crate::{MAX_DEGREE, ROWS, directions, params, path_of, store};

#[test]
fn what_is_built_is_what_is_read() {
    for (scalar, tolerance) in [(Scalar::F64, 8.0 * f64::EPSILON), (Scalar::F32, f64::from(f32::EPSILON))] {
        for codec in [Codec::Raw, Codec::Zstd] {
            let (folder, key) = store(&BuildParams { scalar, codec, ..params() });
            let scheme = Scheme::open(folder.path(), key, ROWS, MAX_DEGREE).expect("a scheme");
            assert_eq!(scheme.scalar(), scalar);
            scheme.verify(&Silent).expect("sound files");
            let mut scratch = Vec::new();
            for (degree, file) in scheme.files().iter().enumerate() {
                let header = file.header();
                let window = file.window(0..header.chunk_count()).expect("a window");
                for chunk in 0..header.chunk_count() {
                    let rows = header.chunk_range(chunk);
                    let values = window.values(chunk, &mut scratch).expect("values");
                    assert_eq!(values.len(), rows.len() * header.columns());
                    for (at, &value) in values.iter().enumerate() {
                        let (row, order) = (rows.start + at % rows.len(), (at / rows.len()) as i64 - degree as i64);
                        let expected = harmonic(degree, order as _, directions().as_slice()[row]);
                        assert!((value - expected).abs() <= tolerance, "{scalar:?} {codec:?} {degree} {order} {row}");
                    }
                }
                window.check().expect("an unchanged file");
            }
        }
    }
}

#[test]
fn double_precision_is_opened_before_single() {
    let (folder, double) = store(&params());
    let open = |scalar| Scheme::open_at(folder.path(), &directions(), scalar, MAX_DEGREE);
    assert!(matches!(open(Some(Scalar::F32)), Err(StoreError::OtherScalar { found: Scalar::F64, .. })));
    let single = BuildParams { scalar: Scalar::F32, ..params() };
    let single = build(folder.path(), &directions(), &single, &Silent).expect("a build").key;
    assert_eq!(open(None).expect("a scheme").key(), double);
    assert_eq!(open(Some(Scalar::F32)).expect("a scheme").key(), single);
    std::fs::remove_dir_all(folder.path().join(double.to_string())).expect("a removal");
    assert_eq!(open(None).expect("a scheme").key(), single);
    std::fs::remove_dir_all(folder.path().join(single.to_string())).expect("a removal");
    // The error names the double-precision key of the directions, which is looked up first.
    assert!(matches!(open(None), Err(StoreError::NoSuchScheme { key, .. }) if key == double));
}

#[test]
fn a_damaged_file_is_replaced_with_a_warning() {
    let (folder, key) = store(&params());
    let path = path_of(folder.path(), key, "A_1");
    let sound = std::fs::read(&path).expect("a file");
    std::fs::write(&path, &sound[..sound.len() - 1]).expect("a shorter file");
    let report = build(folder.path(), &directions(), &params(), &Silent).expect("a build");
    assert_eq!((report.built, report.present), (1, MAX_DEGREE));
    let [StoreWarning::Replaced(error)] = &report.warnings[..] else { panic!("{:?}", report.warnings) };
    assert!(error.to_string().contains(&path.display().to_string()), "{error}");
    assert!(std::fs::read(&path).expect("a file") == sound);
}

/// A monitor that records the announced total and adds up the steps.
#[derive(Default)]
struct Count {
    total: AtomicU64,
    steps: AtomicU64,
}

impl Monitor for Count {
    fn begin(&self, _: Stage, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    fn step(&self, steps: u64) {
        self.steps.fetch_add(steps, Ordering::Relaxed);
    }
}

#[test]
fn the_steps_of_a_verification_add_up() {
    let (folder, key) = store(&params());
    let scheme = Scheme::open(folder.path(), key, ROWS, MAX_DEGREE).expect("a scheme");
    let count = Count::default();
    scheme.verify(&count).expect("sound files");
    let bytes: u64 = scheme.files().iter().map(|file| file.file_len()).sum();
    assert_eq!((count.total.into_inner(), count.steps.into_inner()), (bytes, bytes));
}

#[test]
fn a_cancelled_monitor_stops_builds_and_verification() {
    let (folder, key) = store(&params());
    let cancelled = AtomicBool::new(true);
    let more = BuildParams { max_degree: MAX_DEGREE + 1, ..params() };
    let error = build(folder.path(), &directions(), &more, &cancelled).expect_err("an interruption");
    assert!(matches!(error, StoreError::Interrupted(_)), "{error}");
    assert!(spharm_store::catalog::leftovers(folder.path(), key).expect("a folder").is_empty());
    let scheme = Scheme::open(folder.path(), key, ROWS, MAX_DEGREE).expect("a scheme");
    assert!(matches!(scheme.verify(&cancelled), Err(StoreError::Interrupted(_))));
    let found = spharm_store::catalog::verify(folder.path(), &[key], &cancelled);
    assert!(matches!(found, Err(StoreError::Interrupted(_))));
}
