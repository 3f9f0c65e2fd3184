//! Tests factors that are kept between batches, stored, or in single precision.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::cholesky::build_factor;
use spharm_solver::gram::{Penalised, smoothness_penalty};
use spharm_solver::lsq::Stop;
use spharm_solver::{
    FactorParams, GramMatrix, LsqParams, LsqSolver, StoredFactor, Strategy, moment_gram, moment_normal,
};
use spharm_store::factor::open_factor;
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};

use crate::problems::{
    Random, Sampling, clustered, dense, even, irregular, matrix, params, solve, transforms, uneven_weights,
};

/// Batches on the same solver use the factor that was computed for the first one.
#[test]
fn a_solver_keeps_its_factor_from_batch_to_batch() {
    let sampling = irregular(400, 4);
    let a = matrix(&sampling.directions, 14);
    let operator = transforms(&sampling.directions, 14);
    let made = std::sync::atomic::AtomicUsize::new(0);
    let gram = || {
        made.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(moment_gram(&sampling.directions, None, 14)?) as Box<dyn GramMatrix>)
    };
    let mut solver = LsqSolver::new(&operator, Some(&gram), params(Strategy::Auto)).unwrap();
    for seed in 0..3 {
        let targets = Random(seed).normals(400, 3);
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..3)), &Silent).unwrap();
        dense(&a, &targets, None, 0.0).meets(&fit, fit.report.optimality, "batch");
        assert_eq!((fit.report.preconditioner, fit.report.stop), ("factor", Stop::Converged), "{:?}", fit.report);
        // Only the first batch iterates.
        assert_eq!(fit.report.iterations > 0, seed == 0);
    }
    assert_eq!(made.into_inner(), 1);
}

/// Builds the factor for fits on `sampling` in a store, and opens it.
fn stored(
    folder: &std::path::Path,
    sampling: &Sampling,
    max_degree: usize,
    weights: Option<&[f64]>,
    smoothness: f64,
    scalar: Scalar,
) -> StoredFactor {
    let spec = FactorSpec {
        key: SchemeKey::of(&sampling.directions, Scalar::F64),
        rows: sampling.directions.len(),
        max_degree,
        weights: WeightsHash::of(weights),
        smoothness,
    };
    let gram = moment_gram(&sampling.directions, weights, max_degree).unwrap();
    let penalised = Penalised::new(&gram, smoothness_penalty(max_degree, smoothness));
    let params = FactorParams { scalar, threads: 2, ..FactorParams::default() };
    build_factor(folder, &spec, &penalised, &params, &Silent).unwrap();
    StoredFactor::new(open_factor(folder, &spec, Some(scalar)).unwrap(), 1 << 30, 2)
}

#[test]
fn a_stored_factor_gives_what_a_made_one_gives_and_single_precision_is_refined() {
    let folder = tempfile::tempdir().unwrap();
    for (sampling, max_degree, smoothness) in
        [(even(642), 12, 0.0), (clustered(500), 9, 0.0), (irregular(300, 2), 14, 0.0), (irregular(300, 2), 14, 1e-4)]
    {
        let n = sampling.directions.len();
        let weights = uneven_weights(n);
        let targets = Random(9).normals(n, 4);
        let expected = dense(&matrix(&sampling.directions, max_degree), &targets, Some(&weights), smoothness);
        let operator = transforms(&sampling.directions, max_degree);
        let base = LsqParams { weights: Some(weights.clone()), smoothness, ..params(Strategy::Cholesky) };
        let made = solve(&sampling, max_degree, &targets, base.clone());
        for scalar in [Scalar::F64, Scalar::F32] {
            let factor = stored(folder.path(), &sampling, max_degree, Some(&weights), smoothness, scalar);
            // Without a Gram matrix, no other factor can be computed.
            let mut solver = LsqSolver::new(&operator, None, base.clone()).unwrap().with_factor(&factor);
            let fit = solver.fit(&targets, std::slice::from_ref(&(0..4)), &Silent).unwrap();
            let what = format!("{} {scalar:?} {smoothness} {:?}", sampling.name, fit.report);
            assert_eq!((fit.report.preconditioner, fit.report.iterations), ("stored-factor", 0), "{what}");
            assert!(fit.report.stop == Stop::Converged && fit.report.optimality <= 1e-10, "{what}");
            expected.meets(&fit, 1e-10, &what);
            if scalar == Scalar::F64 {
                assert_eq!(fit.coefficients.values(), made.coefficients.values(), "{what}: the same bits");
            }
            // The report has the condition number in the 1-norm. It differs from the condition number in the Euclidean
            // norm by a factor of at most the size of the matrix, and by less on even samplings.
            let ratio = fit.report.condition / expected.condition();
            let most = if sampling.name == "even" { 3.0 } else { (basis_size(max_degree) as f64).sqrt() };
            assert!(ratio > 1.0 / most && ratio < most, "{what}: {ratio}");
        }
    }
}

/// A fit ends with the best solution found if the condition number of the normal equations is so large that a solve in
/// single precision loses all digits.
#[test]
fn a_single_precision_factor_of_ill_conditioned_equations_ends_with_the_best_that_was_found() {
    let folder = tempfile::tempdir().unwrap();
    let sampling = irregular(300, 5);
    let targets = Random(9).normals(300, 2);
    let expected = dense(&matrix(&sampling.directions, 16), &targets, None, 0.0);
    assert!(expected.condition() > 2e3, "{}", expected.condition());
    let operator = transforms(&sampling.directions, 16);
    let factor = stored(folder.path(), &sampling, 16, None, 0.0, Scalar::F32);
    let mut solver = LsqSolver::new(&operator, None, params(Strategy::Auto)).unwrap().with_factor(&factor);
    let fit = solver.fit(&targets, std::slice::from_ref(&(0..2)), &Silent).unwrap();
    assert!(fit.report.optimality <= 1e-9, "{:?}", fit.report);
    expected.meets(&fit, fit.report.optimality, "single");
}

/// Even if there is a factor of a well-conditioned matrix, many columns are iterated by moments as long as few
/// iterations seem to remain; otherwise the factor is used.
#[test]
fn iterations_by_moments_go_before_a_stored_factor_while_they_are_faster() {
    const DEGREE: usize = 12;
    let folder = tempfile::tempdir().unwrap();
    let sampling = even(6000);
    let targets = Random(3).normals(6000, 48);
    let a = matrix(&sampling.directions, DEGREE);
    let operator = transforms(&sampling.directions, DEGREE);
    // With a penalty the density doesn't precondition. A small penalty hardly changes the iterations.
    for (steepness, smoothness, expected) in [(0.4, 0.0, "none"), (1.8, 0.0, "density"), (1.8, 1e-9, "stored-factor")] {
        let iterated = expected != "stored-factor";
        let weights = sampling.directions.as_slice().iter().map(|[_, _, z]| (steepness * z).exp());
        let weights: Vec<f64> = weights.collect();
        let weights = Some(&weights[..]);
        let factor = stored(folder.path(), &sampling, DEGREE, weights, smoothness, Scalar::F64);
        let moments = |accuracy: f64, _: Option<&Array2<f64>>| {
            Ok((Arc::new(moment_normal(&sampling.directions, weights, DEGREE, accuracy)?), None))
        };
        let weighted = weights.map(<[f64]>::to_vec);
        let params = LsqParams { weights: weighted, smoothness, ..params(Strategy::Auto) };
        let mut solver = LsqSolver::new(&operator, None, params).unwrap().with_factor(&factor).with_moments(&moments);
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..48)), &Silent).unwrap();
        dense(&a, &targets, weights, smoothness).meets(&fit, fit.report.optimality, "beside a factor");
        assert_eq!(fit.report.stop, Stop::Converged, "{:?}", fit.report);
        assert_eq!((fit.report.preconditioner, fit.report.products), (expected, "moments"), "{:?}", fit.report);
        // The first three iterations suffice to predict the remaining number of iterations.
        assert!(fit.report.condition < 100.0, "{:?}", fit.report);
        assert!(if iterated { fit.report.iterations > 3 } else { fit.report.iterations == 3 }, "{:?}", fit.report);
        assert_eq!(fit.report.refinements > 0, !iterated, "{:?}", fit.report);
    }
}
