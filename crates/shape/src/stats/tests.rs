//! Compares statistics and relabellings with direct computations.

use ndarray::{Array2, Axis, array, s};
use spharm_monitor::Silent;

use super::*;
use crate::product::product;

mod blocks;
mod means;
mod regions;
mod unequal;

/// Returns pseudorandom numbers in (-1, 1).
fn noise(rows: usize, columns: usize, seed: u64) -> Array2<f64> {
    Array2::from_shape_fn((rows, columns), |(i, j)| {
        let mut x = (i * columns + j) as u64 ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        for _ in 0..3 {
            x = (x ^ (x >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        }
        (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    })
}

fn without_permutations() -> TestParams {
    TestParams { permutations: None, ..TestParams::default() }
}

/// Returns the pooled t statistic of two groups, computed from its definition.
fn pooled_t(y: &[f64], first: &[bool]) -> f64 {
    let of =
        |group: bool| -> Vec<f64> { y.iter().zip(first).filter(|(_, of)| **of == group).map(|(y, _)| *y).collect() };
    let (a, b) = (of(true), of(false));
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let square = |x: &[f64]| x.iter().map(|value| (value - mean(x)).powi(2)).sum::<f64>();
    let variance = (square(&a) + square(&b)) / (a.len() + b.len() - 2) as f64;
    (mean(&a) - mean(&b)) / (variance * (1.0 / a.len() as f64 + 1.0 / b.len() as f64)).sqrt()
}

#[test]
fn two_groups_are_the_pooled_t_test() {
    let y = noise(11, 30, 1) * 4.0 + 100.0;
    let design = Design::groups(&[5, 6]).unwrap();
    let contrast = Contrast::difference(2, 0, 1);
    let found = test(y.view(), 1, &design, &contrast, &without_permutations(), &Silent).unwrap();
    let first: Vec<bool> = (0..11).map(|i| i < 5).collect();
    for v in 0..30 {
        let t = pooled_t(&y.column(v).to_vec(), &first);
        assert!((found.statistic[v] - t).abs() < 1e-12 * t.abs().max(1.0));
        assert_eq!(found.p[v], distributions::p_of_t(found.statistic[v], 9.0));
    }
    let effect = found.effect.unwrap();
    let difference = y.slice(s![..5, 3]).mean().unwrap() - y.slice(s![5.., 3]).mean().unwrap();
    assert!((effect.estimate[[3, 0]] - difference).abs() < 1e-12);
    assert!((effect.estimate[[3, 0]] / effect.standard_error[[3, 0]] - found.statistic[3]).abs() < 1e-11);
    // 2.262... is the 97.5 % quantile of t on 9 degrees of freedom.
    assert!((effect.margin[[3, 0]] / effect.standard_error[[3, 0]] - 2.262157162740992).abs() < 1e-9);
}

#[test]
fn three_components_are_hotellings_test() {
    let y = noise(12, 3, 5);
    let design = Design::groups(&[7, 5]).unwrap();
    let found = test(y.view(), 3, &design, &Contrast::difference(2, 0, 1), &without_permutations(), &Silent).unwrap();
    let (a, b) = (y.slice(s![..7, ..]), y.slice(s![7.., ..]));
    let mean = |x: ndarray::ArrayView2<f64>| x.mean_axis(Axis(0)).unwrap();
    let centred = |x: ndarray::ArrayView2<f64>| &x - &mean(x);
    let scatter = |x: &Array2<f64>| product(x.t(), x.view());
    let s = (scatter(&centred(a)) + scatter(&centred(b))) / 10.0;
    let d = mean(a) - mean(b);
    // S^-1 d is computed by Cramer's rule.
    let determinant = |m: &Array2<f64>| {
        m[[0, 0]] * (m[[1, 1]] * m[[2, 2]] - m[[1, 2]] * m[[2, 1]])
            - m[[0, 1]] * (m[[1, 0]] * m[[2, 2]] - m[[1, 2]] * m[[2, 0]])
            + m[[0, 2]] * (m[[1, 0]] * m[[2, 1]] - m[[1, 1]] * m[[2, 0]])
    };
    let solved: f64 = (0..3)
        .map(|k| {
            let mut other = s.clone();
            other.column_mut(k).assign(&d);
            d[k] * determinant(&other) / determinant(&s)
        })
        .sum();
    let t2 = 35.0 / 12.0 * solved;
    assert!((found.statistic[0] / t2 - 1.0).abs() < 1e-11, "{} {t2}", found.statistic[0]);
    assert_eq!(found.p[0], distributions::p_of_f(found.statistic[0] * 8.0 / 30.0, 3.0, 8.0));
    assert_eq!(found.kind, Statistic::TSquared { components: 3, freedom: 10.0 });
}

#[test]
fn all_relabellings_are_a_brute_force() {
    let y = noise(10, 25, 3);
    let design = Design::groups(&[5, 5]).unwrap();
    let found = test(y.view(), 1, &design, &Contrast::difference(2, 0, 1), &TestParams::default(), &Silent).unwrap();
    let mut largest = Vec::new();
    for labels in (0u32..1 << 10).filter(|labels| labels.count_ones() == 5) {
        let first: Vec<bool> = (0..10).map(|i| labels >> i & 1 == 1).collect();
        largest.push((0..25).map(|v| pooled_t(&y.column(v).to_vec(), &first).abs()).fold(0.0, f64::max));
    }
    let family_wise = found.family_wise.unwrap();
    assert!(family_wise.exact && family_wise.relabellings == 252);
    assert!((family_wise.floor - 2.0 / 252.0).abs() < 1e-15);
    for v in 0..25 {
        let reached = largest.iter().filter(|most| **most >= found.statistic[v].abs() * (1.0 - 1e-9)).count();
        assert_eq!(family_wise.p[v], reached as f64 / 252.0, "vertex {v}");
    }
}

/// Returns the squared partial statistic of the last column of X, `b^2 / var(b)`, computed from an orthonormal basis of
/// X.
fn partial(x: &Array2<f64>, y: &Array2<f64>) -> f64 {
    let (q, _) = design::orthonormalise(x.view());
    let last = q.ncols() - 1;
    let along = product(q.t(), y.view());
    let errors = y - &product(q.view(), along.view());
    let freedom = (x.nrows() - x.ncols()) as f64;
    along[[last, 0]].powi(2) / (errors.iter().map(|e| e * e).sum::<f64>() / freedom)
}

#[test]
fn covariates_are_freedman_and_lanes() {
    let (n, vertices) = (7, 6);
    let y = noise(n, vertices, 11);
    let covariates = noise(n, 2, 12);
    let design = Design::groups(&[n]).unwrap().with_covariates(covariates.view(), &[]).unwrap();
    let found = test(y.view(), 1, &design, &Contrast::column(3, 2), &TestParams::default(), &Silent).unwrap();
    let family_wise = found.family_wise.unwrap();
    // For each of 7! relabellings the full model is fitted to the relabelled residuals of the reduced model.
    assert!(family_wise.exact && family_wise.relabellings == 5040);
    let x = design.matrix().to_owned();
    let (reduced, _) = design::orthonormalise(x.slice(s![.., ..2]));
    let fitted = product(reduced.view(), product(reduced.t(), y.view()).view());
    let residual = &y - &fitted;
    let rows = Array2::from_shape_fn((n, 1), |(i, _)| i as f64);
    let all = arrangements::Arrangements::new(
        rows.view(),
        super::blocks::free(rows.nrows()),
        Resampling::Permutations,
        1,
        20_000,
        0,
    );
    let largest: Vec<f64> = all
        .range(0, all.count)
        .iter()
        .map(|relabelling| {
            let order: Vec<usize> = relabelling.iter().map(|(i, _)| *i as usize).collect();
            let moved = &residual.select(Axis(0), &order) + &fitted;
            (0..vertices).map(|v| partial(&x, &moved.slice(s![.., v..=v]).to_owned())).fold(0.0, f64::max)
        })
        .collect();
    for v in 0..vertices {
        let own = found.statistic[v].powi(2);
        assert!((own / partial(&x, &y.slice(s![.., v..=v]).to_owned()) - 1.0).abs() < 1e-10);
        let reached = largest.iter().filter(|most| **most >= own * (1.0 - 1e-8)).count();
        assert_eq!(family_wise.p[v], reached as f64 / 5040.0, "vertex {v}");
    }
}

#[test]
fn vectors_with_covariates_agree_with_the_statistic() {
    // Relabelled studies are compared by a monotonic function of T^2. For the original labels, both this function and
    // T^2 are available.
    let y = noise(15, 9, 21);
    let covariates = noise(15, 1, 22);
    let design = Design::groups(&[8, 7]).unwrap().with_covariates(covariates.view(), &[]).unwrap();
    let contrast = Contrast::row(&[1.0, -1.0, 0.0]);
    let permutations = PermutationParams { count: 400, ..PermutationParams::default() };
    let params = TestParams { permutations: Some(permutations), ..TestParams::default() };
    let found = test(y.view(), 3, &design, &contrast, &params, &Silent).unwrap();
    let family_wise = found.family_wise.unwrap();
    let mut order: Vec<usize> = vec![0, 1, 2];
    order.sort_by(|a, b| found.statistic[*b].total_cmp(&found.statistic[*a]));
    assert!(family_wise.p[order[0]] <= family_wise.p[order[1]] && family_wise.p[order[1]] <= family_wise.p[order[2]]);
    assert!(family_wise.p.iter().zip(&family_wise.pointwise).all(|(family, own)| family >= own));
    // With normal errors the two p values would agree. With the errors in this test they are close.
    for v in 0..3 {
        assert!((family_wise.pointwise[v] - found.p[v]).abs() < 0.1, "{} {}", family_wise.pointwise[v], found.p[v]);
    }
}

#[test]
fn swapped_groups_and_numbers_of_threads_change_nothing() {
    let y = noise(24, 50, 31);
    let permutations = PermutationParams { count: 300, ..PermutationParams::default() };
    let params = TestParams { permutations: Some(permutations), ..TestParams::default() };
    let design = Design::groups(&[11, 13]).unwrap();
    let run = |threads: usize, sign: f64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let contrast = Contrast::row(&[sign, -sign]);
        pool.install(|| test(y.view(), 1, &design, &contrast, &params, &Silent).unwrap())
    };
    let (one, three, swapped) = (run(1, 1.0), run(3, 1.0), run(2, -1.0));
    assert_eq!(one.statistic, three.statistic);
    let p = |test: &Test| test.family_wise.clone().unwrap().p;
    assert_eq!(p(&one), p(&three));
    assert_eq!(p(&one), p(&swapped));
    assert!(one.statistic.iter().zip(&swapped.statistic).all(|(a, b)| (a + b).abs() < 1e-13));
}

#[test]
fn a_mean_is_tested_by_signs() {
    let y = noise(8, 4, 41) + 0.6;
    let design = Design::groups(&[8]).unwrap();
    let found = test(y.view(), 1, &design, &Contrast::row(&[1.0]), &TestParams::default(), &Silent).unwrap();
    let family_wise = found.family_wise.unwrap();
    assert!(family_wise.exact && family_wise.relabellings == 256 && family_wise.floor == 2.0 / 256.0);
    let t = |v: usize, signs: u32| {
        let x: Vec<f64> = (0..8).map(|i| if signs >> i & 1 == 1 { -y[[i, v]] } else { y[[i, v]] }).collect();
        let mean = x.iter().sum::<f64>() / 8.0;
        let square: f64 = x.iter().map(|x| (x - mean).powi(2)).sum();
        mean / (square / 7.0 / 8.0).sqrt()
    };
    for v in 0..4 {
        let own = t(v, 0);
        assert!((found.statistic[v] - own).abs() < 1e-12 * own.abs());
        let reached = (0..256).filter(|signs| (0..4).any(|w| t(w, *signs).abs() >= own.abs() * (1.0 - 1e-9))).count();
        assert_eq!(family_wise.p[v], reached as f64 / 256.0);
    }
}

#[test]
fn vertices_without_variance_are_reported() {
    let mut y = noise(10, 3, 51);
    y.column_mut(1).fill(1e7);
    let design = Design::groups(&[5, 5]).unwrap();
    let found = test(y.view(), 1, &design, &Contrast::difference(2, 0, 1), &TestParams::default(), &Silent).unwrap();
    assert_eq!((found.statistic[1], found.p[1], found.family_wise.unwrap().p[1]), (0.0, 1.0, 1.0));
    assert_eq!(found.warnings, [TestWarning::NoVariance { vertices: 1, of: 3 }]);
}

#[test]
fn few_subjects_are_warned_of_and_bad_input_is_refused() {
    let y = noise(6, 3, 61);
    let design = Design::groups(&[3, 3]).unwrap();
    let contrast = Contrast::difference(2, 0, 1);
    let found = test(y.view(), 1, &design, &contrast, &TestParams::default(), &Silent).unwrap();
    assert!(matches!(found.warnings[..], [TestWarning::Floor { relabellings: 20, exact: true, .. }]));
    let refused = |values: &Array2<f64>, components, contrast: &Contrast, params: &TestParams| {
        test(values.view(), components, &design, contrast, params, &Silent).unwrap_err()
    };
    let params = TestParams::default();
    assert!(matches!(
        refused(&noise(5, 3, 1), 1, &contrast, &params),
        ShapeError::Subjects { expected: 6, found: 5, .. }
    ));
    assert!(matches!(refused(&y, 2, &contrast, &params), ShapeError::Components { .. }));
    assert!(matches!(refused(&y, 1, &Contrast::column(3, 0), &params), ShapeError::Contrast { .. }));
    let mut bad = y.clone();
    bad[[4, 2]] = f64::NAN;
    assert!(matches!(refused(&bad, 1, &contrast, &params), ShapeError::NotFiniteValue { row: 4, column: 2, .. }));
    let wide = noise(6, 5, 1);
    assert!(matches!(refused(&wide, 5, &contrast, &params), ShapeError::Subjects { expected: 7, .. }));
    let welch = TestParams { welch: true, ..TestParams::default() };
    assert!(matches!(refused(&y, 1, &Contrast::row(&[1.0, 1.0]), &welch), ShapeError::NotTwoGroups));
    // T^2 of three components needs the covariance of each group, and therefore four subjects in each group.
    let found = refused(&y, 3, &contrast, &welch);
    assert!(matches!(found, ShapeError::Subjects { what: "a group", expected: 4, found: 3 }), "{found}");
    for count in [MAX_RELABELLINGS + 1, usize::MAX] {
        let many = PermutationParams { count, ..PermutationParams::default() };
        let many = TestParams { permutations: Some(many), ..TestParams::default() };
        assert!(matches!(refused(&y, 1, &contrast, &many), ShapeError::Setting { .. }));
    }
    let none = PermutationParams { count: 0, ..PermutationParams::default() };
    let none = TestParams { permutations: Some(none), ..TestParams::default() };
    assert!(matches!(refused(&y, 1, &contrast, &none), ShapeError::Setting { name: "relabellings", .. }));
}
