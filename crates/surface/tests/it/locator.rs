//! Tests the interpolation of values from one sphere to another.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Directions;
use spharm_surface::generate::{Cortex, cortex, icosphere, subdivide_sphere};
use spharm_surface::locator::SphereLocator;
use spharm_surface::{Mesh, SurfaceError};

fn array(vertices: &[[f64; 3]]) -> ArrayView2<'_, f64> {
    ArrayView2::from_shape((vertices.len(), 3), vertices.as_flattened()).unwrap()
}

/// Returns directions spread over the whole sphere (a Fibonacci spiral). None of them is a vertex.
fn spiral(n: usize) -> Vec<[f64; 3]> {
    Directions::fibonacci(n).unwrap().as_slice().to_vec()
}

#[test]
fn every_direction_is_found_and_the_ray_meets_the_triangle_there() {
    let sphere = icosphere(4);
    let locator = SphereLocator::new(&sphere).unwrap();
    assert_eq!(locator.flipped(), 0);
    for d in spiral(5000) {
        let place = locator.locate(d).unwrap();
        let corners = locator.corners(&place).map(|v| sphere.vertices[v as usize]);
        let p: [f64; 3] = std::array::from_fn(|k| (0..3).map(|i| place.barycentric[i] * corners[i][k]).sum());
        let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((0..3).all(|k| (p[k] / length - d[k]).abs() < 1e-14), "{d:?} {place:?}");
        assert!(place.barycentric.iter().all(|w| *w >= 0.0));
    }
}

#[test]
fn vertices_keep_their_values_to_the_last_bit() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 5, variant: 0 });
    for radius in [1.0, 100.0, -1.0] {
        // A radius of -1 also turns the sphere inside out, which is allowed.
        let sphere = sphere.with_vertices(sphere.vertices.iter().map(|v| v.map(|x| radius * x)).collect());
        let locator = SphereLocator::new(&sphere).unwrap();
        assert_eq!(locator.flipped(), 0);
        let directions = Directions::from_vertices(&sphere.vertices).unwrap();
        let found = locator.interpolate(array(&surface.vertices), directions.as_slice()).unwrap();
        assert_eq!(found, array(&surface.vertices));
    }
}

#[test]
fn midpoints_of_edges_take_the_mean() {
    let sphere = icosphere(3);
    let fine = subdivide_sphere(&sphere);
    let locator = SphereLocator::new(&sphere).unwrap();
    let n = sphere.vertices.len();
    let values = Array2::from_shape_fn((n, 1), |(i, _)| i as f64);
    for (i, d) in fine.vertices.iter().enumerate().skip(n) {
        let place = locator.locate(*d).unwrap();
        let mut weights = place.barycentric;
        weights.sort_by(f64::total_cmp);
        assert!(weights[0] < 1e-14 && (weights[1] - 0.5).abs() < 1e-12, "{i}: {weights:?}");
    }
    assert_eq!(locator.interpolate(values.view(), &fine.vertices).unwrap().nrows(), fine.vertices.len());
}

#[test]
fn an_uneven_sphere_is_as_good() {
    // All vertices except a few are moved to within a few millionths of a radian of the north pole.
    let squeezed = icosphere(5);
    let squeeze = |v: &[f64; 3]| {
        let (s, c) = (1e-6 * v[0].hypot(v[1]).atan2(v[2])).sin_cos();
        let r = v[0].hypot(v[1]).max(f64::MIN_POSITIVE);
        if v[2] > -0.9 { [s * v[0] / r, s * v[1] / r, c] } else { *v }
    };
    let squeezed = squeezed.with_vertices(squeezed.vertices.iter().map(squeeze).collect());
    let locator = SphereLocator::new(&squeezed).unwrap();
    assert_eq!(locator.flipped(), 0);
    let directions = Directions::from_vertices(&squeezed.vertices).unwrap();
    let found = locator.interpolate(array(&squeezed.vertices), directions.as_slice()).unwrap();
    assert_eq!(found, array(&squeezed.vertices));
    assert_eq!(locator.locate_all(&spiral(2000)).unwrap().len(), 2000);
}

#[test]
fn a_hole_is_told_and_its_rim_tolerated() {
    let mut open = icosphere(2);
    let gone = open.faces.pop().unwrap();
    let locator = SphereLocator::new(&open).unwrap();
    let middle: [f64; 3] = std::array::from_fn(|k| gone.iter().map(|&v| open.vertices[v as usize][k]).sum());
    let directions = Directions::from_vertices(&[open.vertices[0], middle]).unwrap();
    let error = locator.locate_all(directions.as_slice()).unwrap_err();
    assert!(matches!(error, SurfaceError::NotCovered { missed: 1, directions: 2, first: 1, .. }), "{error}");
    let [a, b] = [gone[0], gone[1]].map(|v| open.vertices[v as usize]);
    let rim: [f64; 3] = std::array::from_fn(|k| a[k] + b[k] + 1e-12 * middle[k]);
    let rim = Directions::from_vertices(&[rim]).unwrap();
    assert!(locator.locate(rim.as_slice()[0]).is_some());
}

#[test]
fn flips_are_counted_and_covered_by_others() {
    let mut folded = icosphere(3);
    folded.vertices[50] = folded.vertices[300];
    let locator = SphereLocator::new(&folded).unwrap();
    assert!(locator.flipped() > 0);
    assert!(locator.locate_all(&spiral(3000)).is_ok());
}

#[test]
fn what_is_no_sphere_is_refused() {
    let bad = [
        Mesh::default(),
        Mesh::new(vec![[1.0, 0.0, 0.0]], vec![]),
        Mesh::new(vec![[1.0, 0.0, 0.0]], vec![[0, 0, 1]]),
        Mesh::new(vec![[0.0; 3]; 3], vec![[0, 1, 2]]),
    ];
    for mesh in bad {
        assert!(matches!(SphereLocator::new(&mesh), Err(SurfaceError::Argument { .. })));
    }
    let locator = SphereLocator::new(&icosphere(1)).unwrap();
    assert!(locator.interpolate(Array2::zeros((3, 1)).view(), &[[1.0, 0.0, 0.0]]).is_err());
}
