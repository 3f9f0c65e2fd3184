//! Compares the derivatives of a triangle's energy with finite differences.

use super::*;
use crate::energy::{Energy, Shape, retract, with_density};
use crate::geometry::{solid_angle, unit};

const ENERGIES: [Energy; 3] = [Energy::bounded(1.0, 0.3, 0.1), Energy::CONFORMAL, Energy::STRETCH];

fn value_of(energy: Energy, p: [Vec3; 3], shape: &Shape) -> f64 {
    with_density!(energy, density => value(density, p, shape.cotangents, shape.area))
}

fn numbers_of(energy: Energy, p: [Vec3; 3], shape: &Shape) -> [f64; NUMBERS] {
    with_density!(energy, density => derivatives(density, p, shape.cotangents, shape.area))
}

/// Returns a triangle on the sphere with unknown i increased by h.
fn moved(mut p: [Vec3; 3], i: usize, h: f64) -> [Vec3; 3] {
    let corner = p[i / 2];
    p[i / 2] = retract(corner, scale(frame(corner)[i % 2], h));
    p
}

/// Returns a triangle of the given size, and a stretched, sheared and rotated image of this triangle on the sphere.
fn pair(size: f64) -> (Shape, [Vec3; 3]) {
    let corners = [[0.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.3, 1.1, 0.2]].map(|p| scale(p, size));
    let shape = Shape::new(corners, crate::geometry::area(corners));
    let p = [[0.3, 0.4, -0.8], [0.3 + 0.5 * size, 0.4 + size, -0.8], [0.3 + 1.3 * size, 0.4, -0.8 + 0.4 * size]];
    let mut p = p.map(unit);
    if solid_angle(p) < 0.0 {
        p.swap(1, 2);
    }
    (shape, p)
}

#[test]
fn frames_span_the_tangent_plane() {
    for p in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], unit([1.0, 2.0, -1e-9]), unit([-0.3, 0.1, -0.9])] {
        let [u, w] = frame(p);
        let products = [dot(u, p), dot(w, p), dot(u, w), dot(u, u) - 1.0, dot(w, w) - 1.0];
        assert!(products.iter().all(|x| x.abs() < 1e-14), "{p:?}");
    }
}

#[test]
fn values_are_those_of_singular_values_and_solid_angle() {
    let (shape, p) = pair(1e-4);
    // r is computed from the solid angle, and q from the lengths of the edges and the cotangents.
    let r = solid_angle(p) / shape.area;
    let lengths = [sub(p[2], p[1]), sub(p[0], p[2]), sub(p[1], p[0])].map(|e| dot(e, e));
    let q: f64 = lengths.iter().zip(shape.cotangents).map(|(l, c)| l * c / (4.0 * shape.area)).sum();
    let expected = [0.5 * (r + 1.0 / r) + 0.3 * q / r + 0.1 * (q / r).powi(3), q / r, q / (r * r) + 1e-3 * q];
    for (energy, expected) in ENERGIES.into_iter().zip(expected) {
        let found = value_of(energy, p, &shape) / shape.area;
        assert!((found / expected - 1.0).abs() < 1e-12, "{energy:?}: {found} {expected}");
        assert_eq!(value_of(energy, [p[1], p[0], p[2]], &shape), f64::INFINITY);
    }
}

#[test]
fn gradients_are_those_of_the_values() {
    let (shape, p) = pair(0.3);
    for energy in ENERGIES {
        let numbers = numbers_of(energy, p, &shape);
        assert_eq!(numbers[0], value_of(energy, p, &shape));
        for i in 0..6 {
            let h = 1e-6;
            let at = |h: f64| value_of(energy, moved(p, i, h), &shape);
            let slope = (at(h) - at(-h)) / (2.0 * h);
            assert!((slope - numbers[1 + i]).abs() < 1e-7 * (1.0 + slope.abs()), "{energy:?} {i}");
        }
    }
}

#[test]
fn hessians_are_those_of_the_gradients_where_they_are_definite() {
    // The triangle is far from a minimum, where twist and flip have positive coefficients, so no eigenvalue is raised
    // to zero.
    let energy = Energy::Stretch { shrink: 50.0 };
    let (shape, p) = pair(1e-4);
    let numbers = numbers_of(energy, p, &shape);
    let largest = numbers[7..].iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    let mut at = 7;
    for i in 0..6 {
        for j in 0..=i {
            let h = 1e-9;
            let by = |h: f64| numbers_of(energy, moved(p, j, h), &shape)[1 + i];
            let entry = (by(h) - by(-h)) / (2.0 * h);
            assert!((entry - numbers[at]).abs() < 1e-3 * largest, "{i} {j}: {entry} {}", numbers[at]);
            at += 1;
        }
    }
}

#[test]
fn hessians_have_no_negative_directions_and_a_corner_s_is_a_part() {
    for size in [1e-3, 0.5] {
        let (shape, p) = pair(size);
        for energy in ENERGIES {
            let numbers = numbers_of(energy, p, &shape);
            let entry = |i: usize, j: usize| numbers[7 + i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
            let trace: f64 = (0..6).map(|i| entry(i, i)).sum();
            for seed in 0..50 {
                let x: Vec<f64> = (0..6).map(|i| f64::from((seed * 7 + i * i * 3 + i) % 11 - 5)).collect();
                let form: f64 = (0..36).map(|k| entry(k / 6, k % 6) * x[k / 6] * x[k % 6]).sum();
                assert!(form >= -1e-12 * trace, "{energy:?} {form}");
            }
            let corner = with_density!(energy, density => {
                corner_derivatives(density, p, shape.cotangents, shape.area, frame(p[0]))
            });
            let whole = [numbers[0], numbers[1], numbers[2], entry(0, 0), entry(1, 0), entry(1, 1)];
            for (a, b) in corner.iter().zip(whole) {
                assert!((a - b).abs() < 1e-12 * (trace + b.abs()));
            }
        }
    }
}

#[test]
fn an_isometry_of_a_small_triangle_costs_least() {
    let size = 1e-3;
    let p = [unit([1.0, 0.0, 0.0]), unit([1.0, size, 0.0]), unit([1.0, 0.3 * size, size])];
    let shape = Shape::new(p, solid_angle(p));
    let energy = Energy::balanced(1.0, 1.0);
    assert!((value_of(energy, p, &shape) / shape.area - energy.least()).abs() < 1e-5);
}
