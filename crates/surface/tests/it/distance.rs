//! Tests distances between surfaces with different triangles.

use std::sync::atomic::{AtomicU64, Ordering};

use spharm_monitor::{Monitor, Silent};
use spharm_surface::generate::{Cortex, cortex, icosphere, subdivide};
use spharm_surface::metrics::{
    Directed, SurfaceDistance, SurfaceDistanceParams, distances_to_surface, distances_to_surface_bytes,
    surface_distance, surface_distance_bytes,
};
use spharm_surface::{Mesh, SurfaceError};

fn params() -> SurfaceDistanceParams {
    SurfaceDistanceParams { samples: 20_000 }
}

fn scaled(mesh: &Mesh, by: f64) -> Mesh {
    mesh.with_vertices(mesh.vertices.iter().map(|v| v.map(|x| by * x)).collect())
}

#[test]
fn concentric_spheres_are_apart_by_the_difference_of_their_radii() {
    let (inner, outer) = (icosphere(5), scaled(&icosphere(4), 1.25));
    let d = surface_distance(&inner, &outer, &params(), &Silent).unwrap();
    // Facets of icosphere(4), scaled to radius 1.25, lie up to 1.25 * 0.0016 below the sphere.
    assert!((d.mean - 0.25).abs() < 2e-3 && (d.rms - 0.25).abs() < 2e-3, "{d:?}");
    assert!((d.percentile95 - 0.25).abs() < 3e-3 && (d.hausdorff - 0.25).abs() < 1e-3, "{d:?}");
    assert!((d.scale - 2.0).abs() < 1e-2);
    assert!(d.forward.samples >= 20_000 && d.bound > 0.0 && d.bound < 0.05, "{d:?}");
}

#[test]
fn a_mesh_and_its_subdivision_are_one_surface() {
    let (surface, _) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    let d = surface_distance(&surface, &subdivide(&surface), &params(), &Silent).unwrap();
    assert!(d.hausdorff < 1e-13 * d.scale, "{d:?}");
    let same = surface_distance(&surface, &surface, &params(), &Silent).unwrap();
    assert!(same.mean < 1e-14 * d.scale && same.hausdorff < 1e-13 * d.scale);
}

#[test]
fn one_vertex_pulled_out_is_the_hausdorff_distance() {
    let round = icosphere(4);
    let mut pulled = round.clone();
    pulled.vertices[100] = pulled.vertices[100].map(|x| 1.5 * x);
    let d = surface_distance(&round, &pulled, &params(), &Silent).unwrap();
    assert!((d.hausdorff - 0.5).abs() < 1e-12 && d.backward.worst == pulled.vertices[100], "{d:?}");
    assert!(d.forward.max < 0.2, "the round one's points find the spike's flanks: {d:?}");
    assert!(d.mean < 5e-3 && d.percentile95 < 1e-3);
}

#[test]
fn swapping_the_surfaces_changes_nothing_but_the_names() {
    let (a, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let (b, _) = cortex(&Cortex { subdivisions: 4, variant: 1 });
    let (there, back) =
        (surface_distance(&a, &b, &params(), &Silent).unwrap(), surface_distance(&b, &a, &params(), &Silent).unwrap());
    assert_eq!((there.mean, there.rms, there.percentile95), (back.mean, back.rms, back.percentile95));
    assert_eq!((there.hausdorff, there.bound, there.forward), (back.hausdorff, back.bound, back.backward));
}

#[test]
fn slivers_do_not_swell_the_work() {
    // Two triangles, 1e4 long and 1e-4 wide.
    let sliver = Mesh::new(vec![[0.0, 0.0, 0.0], [1e4, 0.0, 0.0], [1e4, 1e-4, 1.0]], vec![[0, 1, 2], [0, 2, 1]]);
    let d = surface_distance(&sliver, &sliver, &params(), &Silent).unwrap();
    assert!(d.forward.samples <= 160_000, "{d:?}");
}

/// If squared distances leave the range of f64, the distances are still those of ordinary surfaces times a power of
/// two.
#[test]
fn every_figure_grows_with_the_surfaces() {
    let (first, second) = (icosphere(2), scaled(&icosphere(3), 1.25));
    let d = surface_distance(&first, &second, &params(), &Silent).unwrap();
    let figures = |d: &SurfaceDistance| {
        let of = |d: &Directed| [&[d.mean, d.rms, d.percentile95, d.max, d.spacing][..], &d.worst].concat();
        let both = [d.mean, d.rms, d.percentile95, d.hausdorff, d.bound, d.scale];
        [&both[..], &of(&d.forward), &of(&d.backward)].concat()
    };
    for exponent in [600, -600] {
        let by = 2f64.powi(exponent);
        let far = surface_distance(&scaled(&first, by), &scaled(&second, by), &params(), &Silent).unwrap();
        for (found, ordinary) in figures(&far).into_iter().zip(figures(&d)) {
            assert!((found - by * ordinary).abs() <= 1e-12 * by, "{far:?}");
        }
        assert_eq!((far.forward.samples, far.backward.samples), (d.forward.samples, d.backward.samples));
    }
}

/// The number of points is predicted exactly. The memory is 370 bytes per triangle and 136 per point, for the larger
/// number of triangles and the larger number of points of the two surfaces.
#[test]
fn what_a_distance_takes_is_known_before() {
    for (first, second) in [(icosphere(3), icosphere(2)), (icosphere(1), scaled(&icosphere(4), 3.0))] {
        let d = surface_distance(&first, &second, &params(), &Silent).unwrap();
        let faces = first.faces.len().max(second.faces.len());
        let points = (d.forward.samples + first.vertices.len()).max(d.backward.samples + second.vertices.len());
        let bytes = (370 * faces + 136 * points) as u64;
        assert_eq!(surface_distance_bytes(&first, &second, &params()), bytes);
        assert_eq!(surface_distance_bytes(&second, &first, &params()), bytes);
    }
    assert_eq!(distances_to_surface_bytes(1000, 10), 250_080);
}

#[test]
fn what_has_no_area_has_no_distance() {
    let round = icosphere(1);
    let mut broken = round.clone();
    broken.vertices[3][1] = f64::NAN;
    let point = Mesh::new(vec![[1.0; 3]; 3], vec![[0, 1, 2]]);
    for bad in [&broken, &point, &Mesh::default()] {
        let error = surface_distance(&round, bad, &params(), &Silent).unwrap_err();
        assert!(matches!(error, SurfaceError::Argument { .. }), "{error}");
        assert!(surface_distance(bad, &round, &params(), &Silent).is_err());
    }
}

/// A monitor that asks to stop at the n-th check.
struct StopAt {
    n: u64,
    asked: AtomicU64,
}

impl Monitor for StopAt {
    fn cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) + 1 >= self.n
    }
}

#[test]
fn distances_stop_when_asked_to() {
    let (round, other) = (icosphere(4), icosphere(5));
    let asked = |run: &dyn Fn(&dyn Monitor) -> Option<SurfaceError>| {
        let counted = StopAt { n: u64::MAX, asked: AtomicU64::new(0) };
        assert!(run(&counted).is_none());
        let all = counted.asked.into_inner();
        for n in [1, all / 2, all] {
            let monitor = StopAt { n, asked: AtomicU64::new(0) };
            assert!(matches!(run(&monitor), Some(SurfaceError::Interrupted(_))), "question {n} of {all}");
            let asked = monitor.asked.into_inner();
            assert!(asked <= n + rayon::current_num_threads() as u64, "went on from question {n} to {asked}");
        }
        all
    };
    // The monitor is checked every 16 points, which take less than a millisecond, even if one triangle has most of the
    // points.
    assert!(asked(&|monitor| surface_distance(&round, &other, &params(), monitor).err()) > 40_000 / 16);
    let sliver = Mesh::new(vec![[0.0, 0.0, 0.0], [1e4, 0.0, 0.0], [1e4, 1e-4, 1.0]], vec![[0, 1, 2], [0, 2, 1]]);
    assert!(asked(&|monitor| surface_distance(&sliver, &round, &params(), monitor).err()) > 40_000 / 16);
    assert!(asked(&|monitor| distances_to_surface(&round, &other.vertices, monitor).err()) > 10_242 / 16);
}
