//! Compares tests of means with brute-force computations.

use super::*;

/// Returns the squared statistic of a contrast of one row, computed from orthonormal bases.
fn squared(design: &Design, contrast: &[f64], y: &[f64]) -> f64 {
    let x = design.matrix();
    let model = projection::Projection::new(design, &Contrast::row(contrast)).unwrap();
    let y = Array2::from_shape_fn((y.len(), 1), |(i, _)| y[i]);
    let (basis, _) = design::orthonormalise(x);
    let errors = projection::without(basis.view(), y.clone());
    let along = product(model.effect.t(), y.view())[[0, 0]];
    along * along / errors.iter().map(|e| e * e).sum::<f64>() * model.freedom as f64
}

#[test]
fn a_mean_with_a_covariate_is_tested_by_flips_of_residuals() {
    let (n, vertices) = (9, 5);
    let y = noise(n, vertices, 71) + 0.3;
    let age = noise(n, 1, 72);
    let design = Design::groups(&[n]).unwrap().with_covariates(age.view(), &[]).unwrap();
    let found = test(y.view(), 1, &design, &Contrast::row(&[1.0, 0.0]), &TestParams::default(), &Silent).unwrap();
    let family_wise = found.family_wise.unwrap();
    assert_eq!((family_wise.resampling, family_wise.relabellings), (Resampling::SignFlips, 512));
    let (reduced, _) = design::orthonormalise(design.matrix().slice(s![.., 1..]));
    let residual = projection::without(reduced.view(), y.clone());
    let fitted = &y - &residual;
    let largest: Vec<f64> = (0u32..512)
        .map(|signs| {
            let moved = |v: usize| -> Vec<f64> {
                let sign = |i: usize| if signs >> i & 1 == 1 { -1.0 } else { 1.0 };
                (0..n).map(|i| fitted[[i, v]] + sign(i) * residual[[i, v]]).collect()
            };
            (0..vertices).map(|v| squared(&design, &[1.0, 0.0], &moved(v))).fold(0.0, f64::max)
        })
        .collect();
    for v in 0..vertices {
        let own = squared(&design, &[1.0, 0.0], &y.column(v).to_vec());
        assert!((found.statistic[v].powi(2) / own - 1.0).abs() < 1e-10);
        let reached = largest.iter().filter(|most| **most >= own * (1.0 - 1e-8)).count();
        assert_eq!(family_wise.p[v], reached as f64 / 512.0, "vertex {v}");
    }
}

#[test]
fn a_mean_far_from_zero_is_found_with_any_columns_beside_it() {
    let age = noise(24, 1, 81);
    let groups = Design::groups(&[12, 12]).unwrap();
    let raw = Array2::from_shape_fn((24, 2), |(i, column)| if column == 0 { 1.0 } else { 2.0 + age[[i, 0]] });
    let raw = Design::new(raw, Vec::new()).unwrap();
    let centred = Design::groups(&[24]).unwrap().with_covariates(age.view(), &[]).unwrap();
    let both = array![[1.0, 0.0], [0.0, 1.0]];
    let designs: [(&Design, Array2<f64>); 5] = [
        (&groups, array![[1.0, 0.0]]),
        (&groups, array![[0.5, 0.5]]),
        (&groups, both),
        (&raw, array![[1.0, 0.0]]),
        (&centred, array![[1.0, 0.0]]),
    ];
    let y = noise(24, 30, 82) + 10.0;
    let permutations = PermutationParams { count: 999, ..PermutationParams::default() };
    let params = TestParams { permutations: Some(permutations), ..TestParams::default() };
    for (design, weights) in designs {
        let contrast = Contrast { weights };
        let found = test(y.view(), 1, design, &contrast, &params, &Silent).unwrap().family_wise.unwrap();
        assert_eq!(found.resampling, Resampling::SignFlips);
        assert!(found.p.iter().all(|p| *p <= 0.005), "{:?}: {:?}", contrast.weights, found.p);
    }
}
