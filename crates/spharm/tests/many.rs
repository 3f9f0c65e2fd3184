//! Tests fits of many targets over one sphere: they are bit-identical to single fits, use bounded memory, and pass
//! errors on.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use spharm::generate::{Cortex, cortex};
use spharm::{Error, FitParams, Silent, SolverError, Sphere, Target, fit, fit_each, fit_many, fit_with};
use spharm_store::{BuildParams, build};
use spharm_surface::Signal;

const COUNT: usize = 70;

fn sphere() -> Sphere {
    Sphere::icosphere(3)
}

fn target(number: usize) -> Target {
    let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: number as u64 });
    Target::from_mesh(&surface, &sphere()).expect("they correspond")
}

fn params() -> FitParams {
    FitParams::lsq(6).with_threads(2)
}

#[test]
fn results_are_in_order_and_those_of_each_alone() {
    let sphere = sphere();
    let (read, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let most = AtomicUsize::new(0);
    let next = |number| {
        let waiting = read.fetch_add(1, Ordering::SeqCst) + 1 - done.load(Ordering::SeqCst);
        most.fetch_max(waiting, Ordering::SeqCst);
        Ok::<_, Error>(target(number))
    };
    let keep = |number: usize, fit: spharm::Fit| {
        done.fetch_add(1, Ordering::SeqCst);
        Ok((number, fit))
    };
    let (found, report) = fit_many(&sphere, COUNT, &next, &params(), &keep, &Silent).expect("fits");
    assert!(found.iter().map(|(number, _)| *number).eq(0..COUNT));
    assert_eq!(report.batches.len(), 3, "96 columns at a time are 32 surfaces");
    assert_eq!(report.targets.iter().map(Vec::len).collect::<Vec<_>>(), [32, 32, COUNT - 64]);
    assert!(report.targets.concat().into_iter().eq(0..COUNT));
    // These are one batch of 32 targets, and 2 targets of the next batch that the threads have read.
    assert!(most.into_inner() <= 32 + 2);
    for number in [0, 1, 31, 32, COUNT - 2, COUNT - 1] {
        let (alone, among) = (fit(&sphere, &target(number), &params()).expect("a fit"), &found[number].1);
        assert!(alone.coefficients == among.coefficients, "{number}: not the same bits");
        let figures = |fit: &spharm::Fit| {
            let report = &fit.report;
            let distance = report.surface_distance.map(|found| [found.rms, found.percentile95, found.hausdorff]);
            ([report.msd, report.xsd, report.off_vertex], report.optimality, distance)
        };
        assert_eq!(figures(&alone), figures(among), "{number}");
        assert!(alone.report.msd.is_some_and(|msd| msd > 0.0) && alone.report.off_vertex.is_some_and(|off| off > 0.0));
    }
}

#[test]
fn targets_are_read_at_once_only_where_the_memory_has_room() {
    let sphere = Sphere::icosphere(6);
    let target = |_| Target::from_signal(Signal::new(vec![1.0; 40_962], 40_962, 1), &sphere).map_err(Error::from);
    let params = |memory| FitParams::lsq(6).with_threads(4).with_memory(memory);
    let most_at_once = |memory| {
        let (reading, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let read = |number: usize| {
            most.fetch_max(reading.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            std::thread::sleep(std::time::Duration::from_millis(20));
            reading.fetch_sub(1, Ordering::SeqCst);
            target(number)
        };
        fit_many(&sphere, 12, &read, &params(memory), &|_, _| Ok::<_, Error>(()), &Silent).map(|_| most.into_inner())
    };
    let Err(Error::Memory { needed, .. }) = most_at_once(1) else { panic!("it is too little") };
    assert_eq!(most_at_once(needed).expect("fits"), 1);
    assert!(most_at_once(1 << 30).expect("fits") > 1);
}

/// A fit's report has the optimality of its own columns, and the report of the batch has the largest.
#[test]
fn each_target_of_a_batch_has_its_own_optimality() {
    let sphere = sphere();
    let read = |number: usize| {
        let power = number as i32 + 3;
        let values = sphere.directions.as_slice().iter().map(|u| (u[0] + 0.3 * u[2]).powi(power)).collect();
        Target::from_signal(Signal::new(values, 642, 1), &sphere).map_err(Error::from)
    };
    let keep = |_: usize, fit: spharm::Fit| Ok::<_, Error>(fit.report.optimality.expect("a least-squares fit"));
    let (found, report) = fit_many(&sphere, 3, &read, &params(), &keep, &Silent).expect("fits");
    assert_eq!(report.batches.len(), 1);
    assert_eq!(report.batches[0].optimality(), found.iter().copied().reduce(f64::max));
    assert!(found[0] != found[1] || found[1] != found[2], "{found:?}");
}

/// The smallest budget for NLSF is that of computing the Gram matrix from moments.
#[test]
fn the_stated_need_of_nlsf_is_the_smallest_budget_that_works() {
    let (sphere, folder) = (Sphere::icosphere(4), tempfile::tempdir().expect("a folder"));
    let params = BuildParams { max_degree: 20, ..BuildParams::default() };
    build(folder.path(), &sphere.directions, &params, &Silent).expect("a store");
    let n = sphere.directions.len();
    let target = Target::from_signal(Signal::new(vec![1.0; n], n, 1), &sphere).expect("a signal");
    let params = FitParams::irf(20, folder.path()).with_method(spharm::Method::Nlsf).with_threads(1);
    let needed = |memory| match fit(&sphere, &target, &params.clone().with_memory(memory)) {
        Ok(_) => None,
        Err(Error::Solver(SolverError::Budget { needed, .. })) => Some(needed),
        Err(error) => panic!("{error}"),
    };
    let least = needed(1 << 20).expect("too little memory");
    assert_eq!((needed(least - 1), needed(least)), (Some(least), None));
}

/// With more memory, blocks of the basis could be kept in memory for few surfaces at a time, but one batch, which reads
/// its blocks twice, reads less than several batches.
#[test]
fn more_memory_makes_no_more_batches_over_a_store() {
    let (sphere, folder) = (Sphere::icosphere(4), tempfile::tempdir().expect("a folder"));
    let params = BuildParams { max_degree: 20, chunk_rows: 104, ..BuildParams::default() };
    build(folder.path(), &sphere.directions, &params, &Silent).expect("a store");
    let (surface, _) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    let target = Target::from_mesh(&surface, &sphere).expect("they correspond");
    let method = spharm::Method::Irf { passes: 1, granularity: 300, accelerate: false };
    let params = FitParams::irf(20, folder.path()).with_method(method).with_threads(1);
    let batches = |quarters: usize| {
        let params = params.clone().with_memory(quarters << 18);
        let read = |_| Ok::<_, Error>(target.clone());
        fit_many(&sphere, 9, &read, &params, &|_, _| Ok(()), &Silent).expect("enough memory").1.batches.len()
    };
    let counts: Vec<usize> = (96..110).map(batches).collect();
    assert_eq!(counts, [1; 14]);
}

#[derive(Debug)]
enum Mine {
    Missing(usize),
    Library(Error),
}

impl From<Error> for Mine {
    fn from(error: Error) -> Self {
        Self::Library(error)
    }
}

#[test]
fn errors_of_the_caller_and_of_the_library_come_back_as_they_are() {
    let sphere = sphere();
    let read = |number| if number < 40 { Ok(target(number)) } else { Err(Mine::Missing(number)) };
    let error = fit_many(&sphere, COUNT, &read, &params(), &|_, _| Ok(()), &Silent).expect_err("the 41st is missing");
    assert!(matches!(error, Mine::Missing(40 | 41)), "{error:?}");
    let small = Signal::new(vec![0.0; 5], 5, 1);
    let read = |_| Ok::<_, Mine>(Target { values: small.values.clone(), channels: 1, ..target(0) });
    let error = fit_many(&sphere, 1, &read, &params(), &|_, _| Ok(()), &Silent).expect_err("five values");
    assert!(matches!(error, Mine::Library(Error::Surface(_))), "{error:?}");
}

/// The targets include unreadable ones, ones with too few values, and valid ones.
#[test]
fn targets_that_fail_are_handed_over_and_change_no_other() {
    let sphere = sphere();
    let small = |number| Target { values: vec![0.0; 15], ..target(number) };
    let read = |number: usize| match number {
        0 | 5 | 6 | 69 => Err(Mine::Missing(number)),
        7 => Ok(small(number)),
        _ => Ok(target(number)),
    };
    let done = |number: usize, fit: Result<spharm::Fit, Mine>| match fit {
        Ok(fit) => Ok(Some(fit.coefficients)),
        Err(Mine::Missing(_)) => Ok(None),
        Err(Mine::Library(Error::Surface(_))) if number == 7 => Ok(None),
        Err(other) => Err(other),
    };
    let (found, _) = fit_each(&sphere, COUNT, &read, &params(), &done, &Silent).expect("the others");
    assert_eq!(found.len(), COUNT);
    for (number, found) in found.iter().enumerate() {
        assert_eq!(found.is_none(), [0, 5, 6, 7, 69].contains(&number), "{number}");
    }
    for number in [1, 8, 33, 68] {
        let alone = fit(&sphere, &target(number), &params()).expect("a fit");
        assert!(found[number] == Some(alone.coefficients), "{number}: not the same bits");
    }
    let (none, report) =
        fit_each(&sphere, 3, &|number| Err(Mine::Missing(number)), &params(), &done, &Silent).expect("none");
    assert!(none == [None, None, None] && report.batches.is_empty() && report.targets.is_empty());
}

/// If a batch misses the tolerance, its targets are fitted separately, and each that then meets the tolerance keeps
/// this fit.
#[test]
fn a_fit_that_does_not_converge_is_named_alone() {
    let sphere = sphere();
    // The third target is zero; the other targets need some iterations.
    let read = |number: usize| match number {
        2 => Target::from_signal(Signal::new(vec![0.0; 642 * 3], 642, 3), &sphere).map_err(Error::from),
        _ => Ok(target(number)),
    };
    let params = params()
        .with_strict(true)
        .with_max_iterations(1)
        .with_objective(spharm::Objective::Vertices)
        .with_preconditioner(spharm::Preconditioner::None);
    let done = |_, fit: Result<spharm::Fit, Error>| match fit {
        Ok(_) => Ok(true),
        Err(Error::NotConverged(_)) => Ok(false),
        Err(other) => Err(other),
    };
    let (found, _) = fit_each(&sphere, 4, &read, &params, &done, &Silent).expect("it goes on");
    assert_eq!(found, [false, false, true, false]);
}

#[test]
fn settings_that_do_not_go_together_are_refused_and_a_fit_is_cancelled() {
    let sphere = sphere();
    let refused = |params: FitParams| fit(&sphere, &target(0), &params).expect_err("refused").to_string();
    assert!(refused(params().with_hold_out(1.5)).contains("hold_out"));
    assert!(refused(params().with_method(spharm::Method::Nlsf)).contains("store"));
    let quadrature = params().with_method(spharm::Method::Quadrature).with_hold_out(0.1);
    assert!(refused(quadrature).contains("quadrature"));
    assert!(refused(params().with_memory(1 << 20)).contains("memory budget"));
    let error = fit_with(&sphere, &target(0), &params(), &AtomicBool::new(true)).expect_err("cancelled");
    assert!(error.is_interrupted(), "{error}");
}
