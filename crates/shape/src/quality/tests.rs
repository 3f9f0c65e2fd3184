use ndarray::{Array2, Axis};
use spharm_monitor::Silent;
use spharm_surface::geometry::{dot, sub};
use spharm_surface::metrics::{SurfaceDistanceParams, surface_distance};

use super::points::Points;
use super::*;
use crate::pca::quality::normal;
use crate::rotation::Rotation;
use crate::samples::{blob, ellipsoid, posed};
use crate::transform::{Similarity, Transform};

/// Returns members that differ in all directions, so that they have n - 1 modes.
fn group(n: u64) -> Vec<Coefficients> {
    let member = |seed: u64| {
        let mut values = blob(3, 0).values().clone();
        values.iter_mut().zip(normal(9, seed, 48)).for_each(|(value, noise)| *value += 0.4 * noise);
        Coefficients::new(values).unwrap()
    };
    (0..n).map(member).collect()
}

fn params() -> QualityParams {
    QualityParams { subdivisions: 3, samples: 200, bands: 0, surfaces: false, ..QualityParams::default() }
}

/// Returns a matrix (n, 3 V) with a row `sqrt(w) x` for each member, so that the unweighted distances between rows
/// equal the weighted distances between the members' points.
fn rows(points: &Points) -> Array2<f64> {
    let value = |(i, k): (usize, usize)| points.members[i][k / 3][k % 3] * points.weights[k / 3].sqrt();
    Array2::from_shape_fn((points.members.len(), 3 * points.weights.len()), value)
}

fn norm(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// Returns the distance of a member from the span of the first modes of the other members. The modes are found by power
/// iteration on the members' points.
fn left_out(y: &Array2<f64>, member: usize, modes: usize) -> f64 {
    let others: Vec<usize> = (0..y.nrows()).filter(|i| *i != member).collect();
    let there = y.select(Axis(0), &others);
    let mean = there.mean_axis(Axis(0)).unwrap();
    let mut centred = &there - &mean;
    let mut rest = &y.row(member) - &mean;
    for k in 0..modes {
        let mut mode = centred.row(k % centred.nrows()).to_owned() + centred.row(0);
        for _ in 0..3000 {
            mode = times(&centred.t().to_owned(), &times(&centred, &mode));
            mode /= norm(mode.iter().copied());
        }
        let along = inner(&rest, &mode);
        rest.scaled_add(-along, &mode);
        for mut row in centred.rows_mut() {
            let along = inner(&row.to_owned(), &mode);
            row.scaled_add(-along, &mode);
        }
    }
    norm(rest)
}

fn at_level(subdivisions: u32) -> QualityParams {
    QualityParams { subdivisions, ..QualityParams::default() }
}

#[test]
fn what_is_masked_counts_for_nothing() {
    let group: Vec<Coefficients> = (0..5).map(|k| ellipsoid([9.0 + f64::from(k), 6.0, 5.0])).collect();
    let params = QualityParams { modes: 1, samples: 50, bands: 0, ..at_level(3) };
    let directions = spharm_surface::generate::icosphere(3).vertices;
    let with = |kept: &dyn Fn(&Vec3) -> bool| {
        let mask = Some(directions.iter().map(kept).collect());
        group_quality(&group, None, &QualityParams { mask, ..params.clone() }, &Silent).unwrap()
    };
    let (whole, all, belt) =
        (group_quality(&group, None, &params, &Silent).unwrap(), with(&|_| true), with(&|u| u[0].abs() < 0.3));
    assert_eq!(whole, all);
    // The members differ only at their ends, outside the belt that the mask keeps.
    let less = |of: &dyn Fn(&GroupQuality) -> f64| of(&belt) < 0.6 * of(&whole);
    assert!(less(&|of| of.variance) && less(&|of| of.specificity.values[0]), "{belt:?}");
    assert!(less(&|of| of.surface_specificity.as_ref().unwrap().values[0]), "{belt:?}");
    for mask in [vec![true; 3], vec![false; directions.len()]] {
        let wrong = QualityParams { mask: Some(mask), ..params.clone() };
        assert!(group_quality(&group, None, &wrong, &Silent).is_err());
    }
}

#[test]
fn measures_are_what_they_are_defined_as() {
    let (group, params) = (group(6), params());
    let found = group_quality(&group, None, &params, &Silent).unwrap();
    let points = Points::of(&group, &at_level(3), &Silent).unwrap();
    let y = rows(&points);
    for k in [1, 2, 3] {
        let mean = (0..6).map(|member| left_out(&y, member, k)).sum::<f64>() / 6.0;
        assert!(
            (found.generalisation.values[k - 1] / mean - 1.0).abs() < 1e-6,
            "{k}: {:?} {mean}",
            found.generalisation
        );
    }
    assert_eq!(found.generalisation.values[4], found.generalisation.values[3]);
    let mean = y.mean_axis(Axis(0)).unwrap();
    let variance = (&y - &mean).iter().map(|value| value * value).sum::<f64>() / 5.0;
    assert!((found.variance / variance - 1.0).abs() < 1e-12);
    assert!((found.variances.iter().sum::<f64>() / variance - 1.0).abs() < 1e-12);
    assert!((found.compactness.values[0] - found.variances[0] / variance).abs() < 1e-12);

    // The modes of the points are orthonormal, and random shapes are combinations of these modes.
    let model = curves::Model::of(&points.scores().unwrap(), &[0, 1, 2, 3, 4, 5]).unwrap();
    let modes = crate::product::product(model.loadings.view(), (&y - &mean).view());
    let gram = crate::product::product(modes.view(), modes.t());
    assert!(gram.indexed_iter().all(|((i, j), value)| (value - f64::from(u8::from(i == j))).abs() < 1e-9));
    for k in [1, 3] {
        let mut sum = 0.0;
        for sample in 0..200 {
            let mut shape = mean.clone();
            for (mode, z) in normal(0, sample, 5).into_iter().enumerate().take(k) {
                shape.scaled_add(z * found.variances[mode].sqrt(), &modes.row(mode));
            }
            sum += y.rows().into_iter().map(|row| norm(&row - &shape)).fold(f64::INFINITY, f64::min);
        }
        assert!((found.specificity.values[k - 1] / (sum / 200.0) - 1.0).abs() < 1e-9, "{k}");
    }
}

#[test]
fn weights_are_shares_of_the_area() {
    // The surface is a needle. Nearly all of its area is along its length, but a third of the directions are at its
    // ends.
    let points = Points::of(&[ellipsoid([40.0, 1.0, 1.0])], &at_level(4), &Silent).unwrap();
    let middle: f64 =
        points.weights.iter().zip(&points.members[0]).filter(|(_, p)| p[0].abs() < 20.0).map(|(w, _)| w).sum();
    // In the limit of a needle, the fraction of an ellipsoid's area within x times the long semi-axis is (asin x + x
    // sqrt(1 - x^2)) / asin 1, here with x = 1/2.
    let exact = (0.5_f64.asin() + 0.5 * 0.75_f64.sqrt()) / 1.0_f64.asin();
    assert!((middle - exact).abs() < 0.02, "{middle} {exact}");
    assert!((points.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
}

#[test]
fn a_family_of_one_parameter_is_one_mode_and_places_do_not_count() {
    let group: Vec<Coefficients> = (0..7)
        .map(|i| {
            let mut values = ellipsoid([8.0 + f64::from(i), 5.0, 4.0]).values().clone();
            values[[0, 1]] = 100.0 * f64::from(i * i % 5);
            Coefficients::new(values).unwrap()
        })
        .collect();
    let found = group_quality(&group, None, &QualityParams { surfaces: true, bands: 20, ..params() }, &Silent).unwrap();
    assert!(found.compactness.values[0] > 1.0 - 1e-12 && found.compactness.low[0] > 1.0 - 1e-9);
    assert!(found.generalisation.values.iter().all(|distance| *distance < 1e-6), "{:?}", found.generalisation);
    assert!(found.surface_generalisation.unwrap().values.iter().all(|distance| *distance < 1e-6));
}

#[test]
fn poses_count_unless_members_are_brought_together() {
    let group = group(6);
    let turned: Vec<Coefficients> = group
        .iter()
        .enumerate()
        .map(|(i, member)| {
            let turn = Rotation::uniform([0.3, 0.1 * i as f64, 0.37 * i as f64 % 1.0]);
            let similarity = Similarity { translation: [i as f64, 2.0, -3.0], ..Similarity::rotation(&turn) };
            posed(member, &Transform { rotation: Rotation::default(), antipodal: false, similarity })
        })
        .collect();
    let rigid = QualityParams { rigid: true, ..params() };
    let plain = group_quality(&group, None, &rigid, &Silent).unwrap();
    let found = group_quality(&turned, None, &rigid, &Silent).unwrap();
    for (a, b) in plain.generalisation.values.iter().zip(&found.generalisation.values) {
        assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
    }
    let apart = group_quality(&turned, None, &params(), &Silent).unwrap();
    assert!(apart.variance > 2.0 * found.variance);
}

#[test]
fn distances_between_surfaces_are_those_of_the_surfaces() {
    let group = group(5);
    let points = Points::of(&group, &at_level(3), &Silent).unwrap();
    let model = curves::Model::of(&points.scores().unwrap(), &[0, 1, 2, 3, 4]).unwrap();
    let left = curves::leave_out(&model, 2, 200, &Silent).unwrap();
    let (general, _) = surfaces::distances(&points, &model, &left, &[], 2, &Silent).unwrap();
    for (left, found) in left.iter().zip(&general) {
        for k in 0..2 {
            let shape = points.combined(&left.factors[k]);
            // The factors reproduce the shape whose distance from the member, between corresponding points, was
            // returned.
            let square: f64 = shape
                .iter()
                .zip(&points.members[left.member])
                .zip(&points.weights)
                .map(|((p, q), weight)| weight * dot(sub(*p, *q), sub(*p, *q)))
                .sum();
            assert!((square.sqrt() / left.distances[k] - 1.0).abs() < 1e-6);
            let (a, b) = (points.mesh(points.members[left.member].clone()), points.mesh(shape));
            let all = surface_distance(&a, &b, &SurfaceDistanceParams { samples: 20_000 }, &Silent).unwrap();
            assert!(
                (found[k] / (0.5 * (all.forward.mean + all.backward.mean)) - 1.0).abs() < 0.05,
                "{found:?} {all:?}"
            );
            assert!(found[k] <= left.distances[k]);
        }
    }
}

/// The members are unit spheres whose directions are rotated about the pole, so the distance between the points of a
/// landmark is a chord of a circle.
#[test]
fn landmarks_tell_how_far_directions_slide() {
    let sphere = ellipsoid([1.0, 1.0, 1.0]);
    let angles = [0.0, 0.1, 0.3];
    let members: Vec<Coefficients> = angles
        .iter()
        .map(|&angle| {
            let rotation = Rotation::from_axis_angle([0.0, 0.0, 1.0], angle).unwrap();
            posed(
                &sphere,
                &Transform { rotation, antipodal: false, similarity: Similarity::rotation(&Rotation::default()) },
            )
        })
        .collect();
    let landmarks = vec![vec![[1.2, 0.0, 0.0], [0.0, 0.0, 1.0]]; 3];
    let found = landmark_errors(&members, &landmarks, &QualityParams { bands: 50, ..params() }, &Silent).unwrap();
    let chord = |a: f64, b: f64| 2.0 * (0.5 * (a - b).abs()).sin();
    let mean = (chord(0.0, 0.1) + chord(0.0, 0.3) + chord(0.1, 0.3)) / 3.0;
    assert!((found.by_landmark[0] - mean).abs() < 1e-3, "{found:?} {mean}");
    assert!(found.by_landmark[1] < 1e-3);
    assert!((found.mean - 0.5 * found.by_landmark.iter().sum::<f64>()).abs() < 1e-12);
    assert!((found.off[0][0] - 0.2).abs() < 0.01 && found.off[1][1] < 0.01);
    let [low, high] = found.band.unwrap();
    assert!(low <= found.mean && found.mean <= high);
}

#[test]
fn bands_hold_the_measures_and_are_the_same_on_any_threads() {
    let (group, params) = (group(8), QualityParams { bands: 40, surfaces: true, ..params() });
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| group_quality(&group, None, &params, &Silent).unwrap())
    };
    let found = on(1);
    assert_eq!(found, on(2));
    for curve in [&found.compactness, &found.generalisation, &found.specificity] {
        assert_eq!((curve.low.len(), curve.high.len()), (7, 7));
        for ((value, low), high) in curve.values.iter().zip(&curve.low).zip(&curve.high) {
            assert!(*low <= *value && value <= high && *low >= 0.0, "{low} {value} {high}");
        }
    }
    assert!(found.generalisation.high[0] > found.generalisation.low[0]);
}

#[test]
fn what_is_no_group_is_refused() {
    let (group, params) = (group(3), params());
    let error = |members: &[Coefficients], landmarks: Option<&[Vec<Vec3>]>, params: &QualityParams| {
        group_quality(members, landmarks, params, &Silent).unwrap_err().to_string()
    };
    assert!(error(&group[..2], None, &params).contains("at least 3"));
    assert!(error(&group, None, &QualityParams { modes: 0, ..params.clone() }).contains("modes"));
    let point = Coefficients::new(Array2::zeros((4, 3))).unwrap();
    assert!(error(&[group[0].clone(), point, group[1].clone()], None, &params).contains("member 1"));
    let marks = vec![vec![[0.0; 3]], vec![[0.0; 3]], vec![[0.0; 3]; 2]];
    assert!(error(&group, Some(&marks), &params).contains("landmarks of a member"));
    assert!(error(&group, Some(&marks[..2]), &params).contains("members with landmarks"));
    let nan = vec![vec![[f64::NAN, 0.0, 0.0]]; 3];
    assert!(error(&group, Some(&nan), &params).contains("landmarks"));
}

fn inner(a: &ndarray::Array1<f64>, b: &ndarray::Array1<f64>) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn times(matrix: &ndarray::Array2<f64>, vector: &ndarray::Array1<f64>) -> ndarray::Array1<f64> {
    matrix.rows().into_iter().map(|row| inner(&row.to_owned(), vector)).collect()
}
