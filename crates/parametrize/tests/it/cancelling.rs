//! Tests that every method stops soon after the monitor asks it to, at any point.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::shapes::surface;
use spharm_monitor::{Monitor, Silent};
use spharm_parametrize::volume::{Affine, LabelVolume, VolumeParams};
use spharm_parametrize::{CaldParams, DeformParams, Method, ParametrizeError, StretchParams, resample};
use spharm_surface::generate::icosphere;

/// A monitor that asks to stop at the n-th check, and counts all checks.
struct StopAt {
    n: u64,
    asked: AtomicU64,
}

impl Monitor for StopAt {
    fn cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) + 1 >= self.n
    }
}

/// Runs a computation several times, stopped at a different check each time. Returns the number of checks of a full
/// run.
fn stop_everywhere<T>(name: &str, run: impl Fn(&dyn Monitor) -> Result<T, ParametrizeError>) -> u64 {
    let counted = StopAt { n: u64::MAX, asked: AtomicU64::new(0) };
    assert!(run(&counted).is_ok(), "{name}");
    let all = counted.asked.into_inner();
    for n in (1..=all).step_by((all as usize / 7).max(1)) {
        let monitor = StopAt { n, asked: AtomicU64::new(0) };
        assert!(matches!(run(&monitor), Err(ParametrizeError::Interrupted(_))), "{name}: question {n} of {all}");
        // The fit may check again before it returns.
        let asked = monitor.asked.into_inner();
        assert!(asked <= n + 2, "{name}: went on from question {n} to {asked}");
    }
    all
}

#[test]
fn methods_stop_wherever_they_are() {
    let (_, mesh) = surface(0);
    let map = CaldParams { degree: Some(6), ..CaldParams::default() };
    let deform = DeformParams { sweeps: 3, subdivisions: Some(2), ..DeformParams::default() };
    for method in [
        Method::Auto(map.clone()),
        Method::Conformal(Default::default()),
        Method::Stretch(StretchParams::default()),
        Method::Deform { params: deform, map },
    ] {
        let asked = stop_everywhere(&format!("{method:?}"), |monitor| method.run(&mesh, monitor));
        assert!(asked > 20, "{method:?} asks {asked} times");
    }
    let found = Method::default().run(&mesh, &Silent).unwrap();
    let shared = icosphere(3);
    stop_everywhere("resample", |monitor| resample(&found.surface, &found.sphere, &shared, monitor));
}

#[test]
fn volumes_stop_wherever_they_are() {
    let inside = |i: usize| {
        let [x, y, z] = [i % 20, i / 20 % 20, i / 400].map(|x| x as f64 - 9.5);
        x * x + y * y + z * z < 60.0 && !(x == 0.5 && y == 0.5)
    };
    let volume = LabelVolume::new([20; 3], (0..8000).map(|i| i32::from(inside(i))).collect(), Affine::IDENTITY);
    let params = VolumeParams { fix: true, ..VolumeParams::default() };
    stop_everywhere("surface", |monitor| volume.surface(&params, monitor));
    let quads = volume.surface(&params, &Silent).unwrap().quads;
    stop_everywhere("equal-area", |monitor| Method::default().run(&quads, monitor));
}
