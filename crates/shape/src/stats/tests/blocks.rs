//! Tests exchangeability blocks and variance groups by comparing them with brute-force computations and with the
//! simpler tests that they generalise.

use super::*;

fn pairs(n: usize, exchange: Exchange) -> Blocks {
    Blocks::new((0..2 * n).map(|i| i / 2), exchange)
}

/// Returns the design of a paired t test: a column for the effect, and a column for each of the n pairs.
fn paired(n: usize) -> Design {
    let x = Array2::from_shape_fn((2 * n, n + 1), |(i, k)| match k {
        0 => 0.5 - (i % 2) as f64,
        _ => f64::from(i / 2 == k - 1),
    });
    Design::new(x, Vec::new()).unwrap()
}

#[test]
fn exchanges_within_pairs_are_sign_flips_of_differences() {
    let (n, y) = (7, noise(14, 9, 5));
    let differences = Array2::from_shape_fn((n, 9), |(i, v)| y[[2 * i, v]] - y[[2 * i + 1, v]]);
    let mean = Design::groups(&[n]).unwrap();
    let flips = test(differences.view(), 1, &mean, &Contrast::row(&[1.0]), &TestParams::default(), &Silent).unwrap();
    let params = TestParams { blocks: Some(pairs(n, Exchange::Within)), ..TestParams::default() };
    let found = test(y.view(), 1, &paired(n), &Contrast::column(n + 1, 0), &params, &Silent).unwrap();
    for (a, b) in found.statistic.iter().zip(&flips.statistic) {
        assert!((a - b).abs() < 1e-11, "{a} {b}");
    }
    let (found, flips) = (found.family_wise.unwrap(), flips.family_wise.unwrap());
    assert_eq!((found.relabellings, found.exact, found.resampling), (128, true, Resampling::Permutations));
    assert_eq!((found.p, found.pointwise, found.floor), (flips.p, flips.pointwise, flips.floor));
}

#[test]
fn whole_blocks_of_equal_members_are_their_means() {
    // Both members of a block have equal values and equal rows of the design, so only whole blocks are relabelled.
    let means = noise(8, 5, 17);
    let y = Array2::from_shape_fn((16, 5), |(i, v)| means[[i / 2, v]]);
    let design = |each: usize| {
        let x = Array2::from_shape_fn((8 * each, 2), |(i, group)| f64::from((i / each < 3) == (group == 0)));
        Design::new(x, Vec::new()).unwrap()
    };
    let contrast = Contrast::difference(2, 0, 1);
    let single = test(means.view(), 1, &design(1), &contrast, &TestParams::default(), &Silent).unwrap();
    let params = TestParams { blocks: Some(pairs(8, Exchange::Whole)), ..TestParams::default() };
    let found = test(y.view(), 1, &design(2), &contrast, &params, &Silent).unwrap();
    let (found, single) = (found.family_wise.unwrap(), single.family_wise.unwrap());
    assert_eq!((found.relabellings, found.exact), (56, true));
    assert_eq!((found.p, found.pointwise), (single.p, single.pointwise));
}

#[test]
fn relabellings_that_change_nothing_are_refused() {
    let y = noise(14, 3, 5);
    // In a design of groups of pairs, both members of a pair have equal rows.
    let groups = Design::groups(&[6, 8]).unwrap();
    let contrast = Contrast::difference(2, 0, 1);
    let params = TestParams { blocks: Some(pairs(7, Exchange::Within)), ..TestParams::default() };
    let error = test(y.view(), 1, &groups, &contrast, &params, &Silent).unwrap_err();
    assert!(error.to_string().contains("in these blocks"), "{error}");
    let mean = Design::groups(&[14]).unwrap();
    let params = TestParams { errors: Some(Resampling::Permutations), ..TestParams::default() };
    let error = test(y.view(), 1, &mean, &Contrast::row(&[1.0]), &params, &Silent).unwrap_err();
    assert!(matches!(error, ShapeError::NoRelabelling { blocks: false, .. }), "{error}");
    let params = TestParams { blocks: Some(pairs(6, Exchange::Within)), ..TestParams::default() };
    let error = test(y.view(), 1, &groups, &contrast, &params, &Silent).unwrap_err();
    assert!(matches!(error, ShapeError::Subjects { what: "blocks", expected: 14, found: 12 }), "{error}");
    // A group of one subject has no variance.
    let of = (0..14).map(|i| usize::from(i > 0)).collect();
    let alone = Design::groups(&[1, 13]).unwrap();
    let params = TestParams { variance_groups: Some(of), ..TestParams::default() };
    let error = test(y.view(), 1, &alone, &contrast, &params, &Silent).unwrap_err();
    assert!(matches!(error, ShapeError::VarianceGroup { group: 1, subjects: 1 }), "{error}");
}

#[test]
fn variance_groups_generalise_welchs_t_and_the_pooled_statistics() {
    let mut y = noise(13, 6, 23);
    y.slice_mut(s![..5, ..]).mapv_inplace(|value| 4.0 * value + 1.0);
    let design = Design::groups(&[5, 8]).unwrap();
    let contrast = Contrast::difference(2, 0, 1);
    let run = |params: &TestParams| test(y.view(), 1, &design, &contrast, params, &Silent).unwrap();
    let of = Some((0..13).map(|i| usize::from(i >= 5)).collect());
    let v = run(&TestParams { variance_groups: of.clone(), permutations: None, ..TestParams::default() });
    let welch = run(&TestParams { welch: true, permutations: None, ..TestParams::default() });
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-10 * b.abs().max(1.0), "{a} {b}");
    for k in 0..6 {
        close(v.statistic[k], welch.statistic[k]);
        close(v.p[k], welch.p[k]);
        let (v, welch) = (v.effect.as_ref().unwrap(), welch.effect.as_ref().unwrap());
        close(v.estimate[[k, 0]], welch.estimate[[k, 0]]);
        close(v.standard_error[[k, 0]], welch.standard_error[[k, 0]]);
        close(v.margin[[k, 0]], welch.margin[[k, 0]]);
        close(v.size[k], welch.size[k]);
    }
    let one = Some(vec![0; 13]);
    let (a, b) =
        (run(&TestParams { variance_groups: one.clone(), ..TestParams::default() }), run(&TestParams::default()));
    a.statistic.iter().zip(&b.statistic).chain(a.p.iter().zip(&b.p)).for_each(|(a, b)| close(*a, *b));
    // The statistic is F for three groups with a covariate.
    let three = Design::groups(&[4, 4, 5]).unwrap().with_covariates(noise(13, 1, 3).view(), &[]).unwrap();
    let any = Contrast { weights: array![[1.0, -1.0, 0.0, 0.0], [0.0, 1.0, -1.0, 0.0]] };
    let run = |params: &TestParams| test(y.view(), 1, &three, &any, params, &Silent).unwrap();
    let exchangeable = Some(Resampling::Permutations);
    let permutations = Some(PermutationParams { count: 300, ..PermutationParams::default() });
    let a = TestParams {
        variance_groups: one,
        errors: exchangeable,
        permutations: permutations.clone(),
        ..TestParams::default()
    };
    let (a, b) = (run(&a), run(&TestParams { permutations, ..TestParams::default() }));
    a.statistic.iter().zip(&b.statistic).chain(a.p.iter().zip(&b.p)).for_each(|(a, b)| close(*a, *b));
    assert_eq!(a.family_wise.unwrap().p, b.family_wise.unwrap().p);
}

#[test]
fn shared_slopes_of_unequal_variances_have_valid_p() {
    // 20 subjects with a variance of 1 and 20 subjects with a variance of 9 share the slope of a covariate, which has
    // no effect.
    let (n, vertices) = (40, 2000);
    let normal = |rows, seed| {
        (0..12u64).map(|k| noise(rows, vertices, seed + k)).fold(Array2::zeros((rows, vertices)), |a, b| a + b)
    };
    let mut y = normal(n, 300);
    y.slice_mut(s![20.., ..]).mapv_inplace(|value| 3.0 * value);
    let age = noise(n, 1, 99);
    let design = Design::groups(&[20, 20]).unwrap().with_covariates(age.view(), &[]).unwrap();
    let of = Some((0..n).map(|i| i / 20).collect());
    let params = TestParams { variance_groups: of, permutations: None, ..TestParams::default() };
    let found = test(y.view(), 1, &design, &Contrast::column(3, 2), &params, &Silent).unwrap();
    let rate = found.p.iter().filter(|p| **p < 0.05).count() as f64 / vertices as f64;
    assert!((0.035..0.065).contains(&rate), "{rate}");
}

#[test]
fn several_contrasts_of_unequal_variances_are_welchs_analysis_of_variance() {
    // The expected values are computed in NumPy and SciPy from the formulas of Welch (1951).
    let y = array![[1.0], [2.5], [0.5], [3.0], [9.0], [2.0], [-4.0], [7.0], [5.0], [5.5], [4.5], [6.0], [5.2]];
    let design = Design::groups(&[4, 4, 5]).unwrap();
    let any = Contrast { weights: array![[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]] };
    let of = Some([0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 2].to_vec());
    let params = TestParams { variance_groups: of, permutations: None, ..TestParams::default() };
    let found = test(y.view(), 1, &design, &any, &params, &Silent).unwrap();
    assert!((found.statistic[0] / WELCHS_F.0 - 1.0).abs() < 1e-12, "{}", found.statistic[0]);
    assert!((found.p[0] / WELCHS_F.1 - 1.0).abs() < 1e-11, "{}", found.p[0]);
}

const WELCHS_F: (f64, f64) = (12.84824640964774, 0.012921505489051018);

#[test]
fn a_vertex_without_variance_has_p_of_one_throughout() {
    let mut y = noise(8, 3, 7);
    (0..8).for_each(|i| y[[i, 1]] = f64::from(i < 4));
    let (design, contrast) = (Design::groups(&[4, 4]).unwrap(), Contrast::difference(2, 0, 1));
    let found = test(y.view(), 1, &design, &contrast, &TestParams::default(), &Silent).unwrap();
    let family_wise = found.family_wise.unwrap();
    assert_eq!((found.statistic[1], found.p[1]), (0.0, 1.0));
    assert_eq!((family_wise.p[1], family_wise.pointwise[1]), (1.0, 1.0));
}

#[test]
fn rows_of_blocks_may_be_in_any_order() {
    // Two visits of eight subjects; the errors of the second visit have a larger variance.
    let subjects = Design::groups(&[8, 8]).unwrap();
    let visit = Array2::from_shape_fn((16, 1), |(i, _)| f64::from(i % 2 == 1));
    let design = subjects.with_covariates(visit.view(), &["visit".to_owned()]).unwrap();
    let y = Array2::from_shape_fn((16, 6), |(i, v)| noise(16, 6, 5)[[i, v]] * if i % 2 == 1 { 5.0 } else { 1.0 });
    let run = |order: &[usize]| {
        let x = design.matrix().select(Axis(0), order);
        let design = Design::new(x, design.names().to_vec()).unwrap();
        let blocks = Some(Blocks::new(order.iter().map(|i| i / 2), Exchange::Whole));
        let params = TestParams { blocks, ..TestParams::default() };
        let y = y.select(Axis(0), order);
        test(y.view(), 1, &design, &Contrast::row(&[1.0, -1.0, 0.0]), &params, &Silent).unwrap()
    };
    let sorted: Vec<usize> = (0..16).collect();
    let swapped: Vec<usize> = (0..16).map(|i| if i % 4 < 2 { i ^ 1 } else { i }).collect();
    let (a, b) = (run(&sorted), run(&swapped));
    assert_eq!(a.warnings, [TestWarning::DependentRows]);
    let (a, b) = (a.family_wise.unwrap(), b.family_wise.unwrap());
    assert_eq!((a.relabellings, a.exact, &a.p, &a.pointwise), (b.relabellings, b.exact, &b.p, &b.pointwise));
}

/// Returns a study of ten subjects with three rows each. The subjects' slopes differ in proportion to `spread`.
fn growth(spread: f64) -> (Design, Array2<f64>, Blocks) {
    let (own, errors) = (noise(10, 40, 31), noise(30, 40, 7));
    let start = noise(10, 1, 3);
    let age = |i: usize| 5.0 * start[[i / 3, 0]] + [0.0, 1.3, 3.1][i % 3];
    let x = Array2::from_shape_fn((30, 11), |(i, k)| if k == 0 { age(i) } else { f64::from(i / 3 == k - 1) });
    let y = Array2::from_shape_fn((30, 40), |(i, v)| errors[[i, v]] + spread * own[[i / 3, v]] * age(i));
    (Design::new(x, Vec::new()).unwrap(), y, Blocks::new((0..30).map(|i| i / 3), Exchange::Within))
}

#[test]
fn slopes_that_differ_between_blocks_are_warned_of() {
    let warnings = |spread: f64| {
        let (design, y, blocks) = growth(spread);
        let permutations = Some(PermutationParams { count: 99, ..PermutationParams::default() });
        let params = TestParams { blocks: Some(blocks), permutations, ..TestParams::default() };
        test(y.view(), 1, &design, &Contrast::column(11, 0), &params, &Silent).unwrap().warnings
    };
    let found = warnings(2.0);
    assert!(matches!(found[..], [TestWarning::UnequalEffects { f, p }] if f > 3.0 && p < 1e-3), "{found:?}");
    assert!(warnings(0.0).is_empty(), "{:?}", warnings(0.0));
    // Blocks of two rows don't show whether effects differ between blocks.
    let params = TestParams { blocks: Some(pairs(7, Exchange::Within)), ..TestParams::default() };
    let found = test(noise(14, 9, 5).view(), 1, &paired(7), &Contrast::column(8, 0), &params, &Silent).unwrap();
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
}

#[test]
fn whole_blocks_of_different_sizes_are_refused_by_their_sizes() {
    let design = Design::groups(&[9, 6]).unwrap();
    let blocks = Blocks::new((0..15).map(|i| if i < 9 { i / 3 } else { 3 + (i - 9) / 2 }), Exchange::Whole);
    let params = TestParams { blocks: Some(blocks), ..TestParams::default() };
    let error = test(noise(15, 3, 5).view(), 1, &design, &Contrast::difference(2, 0, 1), &params, &Silent).unwrap_err();
    assert!(error.to_string().starts_with("the number of rows of a whole block is 2 or 3; only blocks"), "{error}");
}

#[test]
fn blocks_of_different_sizes_without_an_effect_between_them_are_refused_for_the_effect() {
    // The effect is the visit, which is 1 in one row of every block and 0 in the other rows.
    let visit = Array2::from_shape_fn((15, 1), |(i, _)| f64::from(if i < 9 { i % 3 == 1 } else { (i - 9) % 2 == 1 }));
    let design = Design::groups(&[15]).unwrap().with_covariates(visit.view(), &[]).unwrap();
    let blocks = Blocks::new((0..15).map(|i| if i < 9 { i / 3 } else { 3 + (i - 9) / 2 }), Exchange::Whole);
    let params = TestParams { blocks: Some(blocks), ..TestParams::default() };
    let error = test(noise(15, 3, 5).view(), 1, &design, &Contrast::column(2, 1), &params, &Silent).unwrap_err();
    assert!(matches!(error, ShapeError::NoRelabelling { blocks: true, .. }), "{error}");
}

#[test]
fn the_order_of_rows_is_warned_of_only_if_rows_are_exchanged() {
    // Age and dose vary within blocks in different ways.
    let (ages, doses) = (noise(16, 1, 3), noise(16, 1, 9));
    let x = ndarray::concatenate![Axis(1), ages, doses];
    let design = Design::groups(&[8, 8]).unwrap().with_covariates(x.view(), &[]).unwrap();
    let found = |errors| {
        let params = TestParams { blocks: Some(pairs(8, Exchange::Whole)), errors, ..TestParams::default() };
        let contrast = Contrast::row(&[1.0, -1.0, 0.0, 0.0]);
        test(noise(16, 3, 5).view(), 1, &design, &contrast, &params, &Silent).unwrap().warnings
    };
    assert!(found(None).contains(&TestWarning::RowsByOrder));
    assert!(!found(Some(Resampling::SignFlips)).contains(&TestWarning::RowsByOrder));
}
