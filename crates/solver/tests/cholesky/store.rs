//! Tests factors in a store: damaged and mismatched factors are refused, and interrupted computations leave no files.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor, Silent};
use spharm_solver::cholesky::{build_factor, plan_factor};
use spharm_solver::{CholeskyFactor, FactorParams, GramMatrix, SolverError};
use spharm_store::factor::{factors, open_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, StoreError, StoreWarning, WeightsHash};

use crate::matrices::{filled, gram, scattered, spec, stored};

#[test]
fn a_factor_of_something_else_is_refused_by_name() {
    let source = gram(&scattered(200), 5);
    let folder = tempfile::tempdir().unwrap();
    let spec = spec(5, 200);
    let params = FactorParams { tile: 8, ..FactorParams::default() };
    let built = build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap();
    assert!(!built.present);
    assert!(build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap().present);
    let others = [
        ("scheme", FactorSpec { key: SchemeKey([4; 32]), ..spec }),
        ("number of directions", FactorSpec { rows: 201, ..spec }),
        ("degree", FactorSpec { max_degree: 4, ..spec }),
        ("weights", FactorSpec { weights: WeightsHash::of(Some(&[2.0; 200])), ..spec }),
        ("smoothness", FactorSpec { smoothness: 1e-6, ..spec }),
    ];
    for (what, other) in others {
        let error = built.file.expect(&other).unwrap_err();
        assert!(matches!(error, StoreError::FactorDiffers { .. }), "{error}");
        let line = error.to_string();
        assert!(line.contains(what) && line.contains(&built.file.path().display().to_string()), "{line}");
        if what == "number of directions" {
            continue;
        }
        let error = open_factor(folder.path(), &other, None).unwrap_err();
        assert!(matches!(error, StoreError::FactorMissing { .. }), "{error}");
        // Store the factor under the name of another specification.
        let place = folder.path().join(other.key.to_string());
        std::fs::create_dir_all(&place).unwrap();
        let place = place.join(other.file_name(Scalar::F64));
        std::fs::copy(built.file.path(), &place).unwrap();
        let error = open_factor(folder.path(), &other, None).unwrap_err();
        assert!(matches!(error, StoreError::FactorDiffers { .. }) && error.to_string().contains(what), "{error}");
        std::fs::remove_file(&place).unwrap();
    }
    assert!(open_factor(folder.path(), &spec, Some(Scalar::F32)).is_err());
    assert_eq!(factors(folder.path(), spec.key).unwrap().len(), 1);
}

/// A monitor that cancels after a number of steps or statuses.
struct StopAfter {
    left: AtomicU64,
}

impl StopAfter {
    fn new(events: u64) -> Self {
        Self { left: AtomicU64::new(events) }
    }

    fn count(&self) {
        let _ = self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
    }
}

impl Monitor for StopAfter {
    fn step(&self, _: u64) {
        self.count();
    }

    fn note(&self, level: Level, _: std::fmt::Arguments<'_>) {
        if level == Level::Status {
            self.count();
        }
    }

    fn cancelled(&self) -> bool {
        self.left.load(Ordering::Relaxed) == 0
    }
}

/// A build that is interrupted at any moment leaves no files, and the next build succeeds.
#[test]
fn an_interrupted_build_leaves_nothing() {
    let source = gram(&scattered(400), 12);
    let spec = spec(12, 400);
    let folder = tempfile::tempdir().unwrap();
    for scalar in [Scalar::F64, Scalar::F32] {
        let params = FactorParams { scalar, tile: 16, ..FactorParams::default() };
        for stop_after in [1, 2, 5, 9] {
            let least = plan_factor(source.size(), &FactorParams { memory: 0, ..params.clone() }, true);
            let Err(SolverError::Store(StoreError::Budget { needed, .. })) = least else { panic!("{least:?}") };
            let params = FactorParams { memory: needed, ..params.clone() };
            let error = build_factor(folder.path(), &spec, &source, &params, &StopAfter::new(stop_after)).unwrap_err();
            assert!(matches!(error, SolverError::Interrupted(_)), "{error}");
            let names: Vec<_> = std::fs::read_dir(folder.path().join(spec.key.to_string()))
                .unwrap()
                .map(|item| item.unwrap().file_name().into_string().unwrap())
                .filter(|name| name.starts_with('.') && name != ".lock")
                .collect();
            assert_eq!(names, [""; 0]);
        }
        assert!(!build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap().present);
    }
}

/// A damaged tile causes an error of the solve that names the file, in whichever thread it occurs. A damaged header
/// makes the next build replace the file.
#[test]
fn damage_is_an_error_and_no_wrong_number() {
    let source = gram(&scattered(400), 12);
    let spec = spec(12, 400);
    let folder = tempfile::tempdir().unwrap();
    let params = FactorParams { tile: 16, ..FactorParams::default() };
    let path = build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap().file.path().to_owned();
    let sound = std::fs::read(&path).unwrap();
    let end = sound.len() - 128 - 64 * 66;
    for at in (4096..end).step_by(9973) {
        let mut damaged = sound.clone();
        damaged[at] ^= 1;
        std::fs::write(&path, damaged).unwrap();
        let file = open_factor(folder.path(), &spec, None).unwrap();
        for threads in [1, 3] {
            let mut x = filled(source.size(), 3);
            let error = stored(&file, 1 << 30, threads).solve(&mut x).unwrap_err();
            assert!(matches!(error, SolverError::Store(StoreError::TileDamaged { .. })), "{error}");
            assert!(error.to_string().contains(&path.display().to_string()), "{error}");
            assert_eq!(x, filled(source.size(), 3), "right-hand sides as they were");
        }
        assert!(file.verify(&Silent).is_err());
    }
    std::fs::write(&path, &sound).unwrap();
    let file = open_factor(folder.path(), &spec, None).unwrap();
    let factor = stored(&file, 1 << 30, 2);
    factor.solve(&mut filled(source.size(), 3)).unwrap();
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(5000).unwrap();
    for _ in 0..2 {
        let error = factor.solve(&mut filled(source.size(), 3)).unwrap_err();
        assert!(matches!(error, SolverError::Store(StoreError::ChangedWhileRead { .. })), "{error}");
    }
    let report = build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap();
    assert!(!report.present);
    assert!(matches!(report.warnings[..], [StoreWarning::Replaced(_)]));
    assert!(std::fs::read(&path).unwrap() == sound, "the same bytes");
}

#[test]
fn too_little_memory_or_disk_is_said_before_any_work() {
    struct Unasked;
    impl GramMatrix for Unasked {
        fn size(&self) -> usize {
            basis_size(600)
        }
        fn bytes(&self) -> usize {
            0
        }
        fn tile(&self, _: Range<usize>, _: Range<usize>, _: &mut [f64], _: usize) -> Result<(), SolverError> {
            panic!("work has started")
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let build = |params: &FactorParams| {
        build_factor(&store, &spec(600, 10), &Unasked, params, &Silent).unwrap_err().to_string()
    };
    let params = FactorParams { memory: 64 << 20, ..FactorParams::default() };
    assert!(build(&params).contains("is too small; at least"));
    // The factor would take 522 GB.
    let line = build(&FactorParams { memory: 4 << 30, ..params });
    assert!(line.contains("the factor needs") && line.contains(&store.display().to_string()), "{line}");
    assert!(!store.exists());
}
