//! Tests the warning about groups of unequal variance, and compares Welch's test with SciPy and with brute-force
//! computations.

use ndarray::concatenate;

use super::*;

#[test]
fn welchs_test_is_scipys() {
    // The expected values are from scipy.stats.ttest_ind(a, b, equal_var=False).
    let y = array![[1.0], [2.0], [3.0], [4.0], [2.0], [9.0], [4.0], [6.0], [3.0], [7.0], [5.5]];
    let params = TestParams { welch: true, ..TestParams::default() };
    let design = Design::groups(&[4, 7]).unwrap();
    let contrast = Contrast::difference(2, 0, 1);
    let found = test(y.view(), 1, &design, &contrast, &params, &Silent).unwrap();
    assert!((found.statistic[0] - WELCH.0).abs() < 1e-13, "{}", found.statistic[0]);
    assert!((found.p[0] / WELCH.1 - 1.0).abs() < 1e-12, "{}", found.p[0]);
    // Expected p values are from sign flips of the residuals about the common mean, weighted by n / s^2.
    let half = |from: usize, to: usize| -> (f64, f64) {
        let x = y.slice(s![from..to, 0]);
        let (n, mean) = (x.len() as f64, x.mean().unwrap());
        (mean, n * (n - 1.0) / x.iter().map(|x| (x - mean).powi(2)).sum::<f64>())
    };
    let ((m1, w1), (m2, w2)) = (half(0, 4), half(4, 11));
    let common = (w1 * m1 + w2 * m2) / (w1 + w2);
    let reached = (0u32..1 << 11).filter(|signs| {
        let flipped = |i: usize| if signs >> i & 1 == 1 { common - y[[i, 0]] } else { y[[i, 0]] - common };
        let x: Vec<f64> = (0..11).map(flipped).collect();
        welch_t(&x[..4], &x[4..]).abs() >= found.statistic[0].abs() * (1.0 - 1e-9)
    });
    let expected = reached.count() as f64 / 2048.0;
    let family_wise = found.family_wise.unwrap();
    assert_eq!((family_wise.relabellings, family_wise.p[0]), (2048, expected));
    assert_eq!((family_wise.resampling, family_wise.floor), (Resampling::SignFlips, 2.0 / 2048.0));
}

fn welch_t(a: &[f64], b: &[f64]) -> f64 {
    let half = |x: &[f64]| {
        let (n, mean) = (x.len() as f64, x.iter().sum::<f64>() / x.len() as f64);
        (mean, x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0) / n)
    };
    let ((m1, v1), (m2, v2)) = (half(a), half(b));
    (m1 - m2) / (v1 + v2).sqrt()
}

const WELCH: (f64, f64) = (-2.429384151785845, 0.038020963933738994);

#[test]
fn unequal_variances_of_groups_of_unequal_size_are_warned_of() {
    let mut y = noise(24, 40, 91);
    y.slice_mut(s![..6, ..]).mapv_inplace(|value| 3.0 * value);
    let contrast = Contrast::difference(2, 0, 1);
    let run = |y: &Array2<f64>, sizes: &[usize], params: &TestParams| {
        let design = Design::groups(sizes).unwrap();
        test(y.view(), 1, &design, &contrast, params, &Silent).unwrap().warnings
    };
    let warnings = run(&y, &[6, 18], &without_permutations());
    let [warning @ TestWarning::UnequalVariances { wide_subjects: 6, narrow_subjects: 18, ratio, .. }] = &warnings[..]
    else {
        panic!("{warnings:?}")
    };
    assert!((6.0..13.0).contains(ratio), "{ratio}");
    assert!(warning.to_string().contains("group 1 (6 subjects)") && warning.to_string().contains("too small"));
    // In this study the larger group has the larger variance.
    let turned =
        concatenate![Axis(0), y.slice(s![6..12, ..]), y.slice(s![..6, ..]), y.slice(s![..6, ..]), y.slice(s![..6, ..])];
    let warnings = run(&turned, &[6, 18], &without_permutations());
    assert!(warnings.len() == 1 && warnings[0].to_string().contains("too large"), "{warnings:?}");
    // There is no warning for groups of equal size, for groups of equal variance, or with Welch's test.
    assert!(run(&y.slice(s![..12, ..]).to_owned(), &[6, 6], &without_permutations()).is_empty());
    assert!(run(&noise(24, 40, 91), &[6, 18], &without_permutations()).is_empty());
    let welch = TestParams { welch: true, ..without_permutations() };
    assert!(run(&y, &[6, 18], &welch).is_empty());
    // With a covariate, the variances of the residuals are compared.
    let age = noise(24, 1, 92);
    let design = Design::groups(&[6, 18]).unwrap().with_covariates(age.view(), &[]).unwrap();
    let contrast = Contrast::row(&[1.0, -1.0, 0.0]);
    let found = test(y.view(), 1, &design, &contrast, &without_permutations(), &Silent).unwrap();
    assert!(matches!(found.warnings[..], [TestWarning::UnequalVariances { remedy: Some(Remedy::VarianceGroups), .. }]));
    // A design may also have more than two groups, and groups may be defined by a column of numbers with two distinct
    // values.
    let three = Design::groups(&[6, 10, 8]).unwrap();
    let any = Contrast { weights: array![[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]] };
    let code = Array2::from_shape_fn((24, 1), |(i, _)| f64::from(i < 6));
    let code = Design::groups(&[24]).unwrap().with_covariates(code.view(), &["patient".to_owned()]).unwrap();
    for (design, contrast, name) in [
        (&three, any, "group 1"),
        (&three, Contrast::difference(3, 0, 1), "group 1"),
        (&code, Contrast::column(2, 1), "subjects with the higher patient"),
    ] {
        let found = test(y.view(), 1, design, &contrast, &without_permutations(), &Silent).unwrap();
        let [TestWarning::UnequalVariances { wide, wide_subjects: 6, .. }] = &found.warnings[..] else {
            panic!("{:?}", found.warnings)
        };
        assert_eq!(wide, name);
    }
    // A continuous effect defines no groups, so there is no warning.
    let slope = Design::groups(&[24]).unwrap().with_covariates(age.view(), &[]).unwrap();
    let found = test(y.view(), 1, &slope, &Contrast::column(2, 1), &without_permutations(), &Silent).unwrap();
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
}

#[test]
fn welchs_test_of_positions_is_the_multivariate_behrens_fisher_test() {
    let mut y = noise(13, 6, 101);
    y.slice_mut(s![..5, ..]).mapv_inplace(|value| 2.0 * value + 0.4);
    let params = TestParams { welch: true, ..TestParams::default() };
    let design = Design::groups(&[5, 8]).unwrap();
    let contrast = Contrast::difference(2, 0, 1);
    let found = test(y.view(), 3, &design, &contrast, &params, &Silent).unwrap();
    // The expected values are computed in NumPy and SciPy from the formulas, with explicit inverses.
    for (v, (statistic, p)) in BEHRENS_FISHER.into_iter().enumerate() {
        assert!((found.statistic[v] / statistic - 1.0).abs() < 1e-12, "{}", found.statistic[v]);
        assert!((found.p[v] / p - 1.0).abs() < 1e-11, "{}", found.p[v]);
    }
    // For a single component T^2 is t^2.
    let one = y.select(Axis(1), &[0, 3]);
    let t = test(one.view(), 1, &design, &contrast, &params, &Silent).unwrap();
    for (v, column) in [0, 3].into_iter().enumerate() {
        let (a, b): (Vec<f64>, Vec<f64>) = (y.slice(s![..5, column]).to_vec(), y.slice(s![5.., column]).to_vec());
        assert!((t.statistic[v] - welch_t(&a, &b)).abs() < 1e-12);
    }
    let family_wise = found.family_wise.unwrap();
    assert_eq!(
        (family_wise.resampling, family_wise.relabellings, family_wise.exact),
        (Resampling::SignFlips, 8192, true)
    );
    let order = usize::from(found.statistic[0] < found.statistic[1]);
    assert!(family_wise.p[order] <= family_wise.p[1 - order] && family_wise.p[order] >= family_wise.floor);
    for v in 0..2 {
        assert!(family_wise.p[v] >= family_wise.pointwise[v]);
        assert!((family_wise.pointwise[v] - found.p[v]).abs() < 0.1, "{} {}", family_wise.pointwise[v], found.p[v]);
    }
}

const BEHRENS_FISHER: [(f64, f64); 2] =
    [(0.5984253805144911, 0.940285509850693), (2.2010531348908553, 0.7375577818284575)];
