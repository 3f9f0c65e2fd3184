//! Tests that memory plans fit their budget, include the stated memory, and choose the fastest option within the
//! budget, and that reports are correct.

use std::ops::RangeInclusive;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Directions;
use spharm_monitor::{Level, Monitor, Silent, Stage};
use spharm_solver::irf::{self, plan};
use spharm_solver::operator::Block;
use spharm_solver::threaded::{Kernels, ThreadedKernels};
use spharm_solver::{
    BlockOperator, ChunkedRows, IrfParams, IrfPlan, IrfSolver, MemoryOperator, Method, Operator, Residency,
    SolverError, moment_gram, moment_gram_bytes,
};

const L: usize = 7;
const N: usize = 400;
const CHUNK: usize = 40;

fn operator() -> MemoryOperator {
    MemoryOperator::new(&Directions::fibonacci(N).unwrap(), L, CHUNK).unwrap()
}

/// A basis outside memory: a block needs 1,000 bytes per column if it is read into memory as a whole, or 30,000 bytes
/// in total if it is read in chunks.
struct Elsewhere(MemoryOperator);

const WHOLE: usize = 1000;
const CHUNKWISE: usize = 30_000;

impl Operator for Elsewhere {
    fn rows(&self) -> usize {
        self.0.rows()
    }

    fn max_degree(&self) -> usize {
        self.0.max_degree()
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.0.apply(x)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.0.apply_adjoint(r)
    }
}

impl BlockOperator for Elsewhere {
    fn chunk_rows(&self) -> usize {
        self.0.chunk_rows()
    }

    fn resident_bytes(&self, degrees: &RangeInclusive<usize>, residency: Residency, _: usize) -> usize {
        match residency {
            Residency::Whole => WHOLE * irf::columns(degrees),
            Residency::Chunks => CHUNKWISE,
        }
    }

    fn open<'a>(
        &'a self,
        degrees: RangeInclusive<usize>,
        residency: Residency,
    ) -> Result<Box<dyn Block + 'a>, SolverError> {
        self.0.open(degrees, residency)
    }
}

fn params(passes: usize, granularity: usize) -> IrfParams {
    let method = Method::Irf { passes, granularity };
    IrfParams { max_degree: L, method, threads: 1, memory: 1 << 30, ..IrfParams::default() }
}

fn adds_up(plan: &IrfPlan) {
    let sum = plan.held + plan.arrays + plan.work + plan.grams + plan.factors + plan.basis;
    assert_eq!(plan.total, sum, "{plan:?}");
    assert!(plan.total <= plan.budget, "{plan:?}");
}

/// The plan's sizes are as documented, counted in f64 values of 8 bytes.
#[test]
fn arrays_and_factors_are_counted_to_the_byte() {
    let operator = operator();
    // The blocks have degrees 0 to 3, 4 and 5, 6, and 7, with 16, 20, 13 and 15 columns: K = 64.
    let (columns, size, widest, c) = ([16, 20, 13, 15], 64, 20, 3);
    let planned = |change: &dyn Fn(&mut IrfParams)| {
        let mut params = params(3, 20);
        change(&mut params);
        let plan = plan(&operator, c, &params).unwrap();
        adds_up(&plan);
        plan
    };
    let plain = planned(&|_| {});
    // The arrays are the residual, the coefficients, and a block's right-hand sides and solution, both also transposed.
    assert_eq!(plain.arrays, 8 * (N * c + size * c + 4 * widest * c));
    let weighted = planned(&|params| params.weights = Some(vec![1.0; N]));
    assert_eq!(weighted.arrays, plain.arrays + 8 * N);
    // Acceleration needs two more arrays like the residual, and two more like the coefficients.
    let accelerated = planned(&|params| params.accelerate = true);
    assert_eq!(accelerated.arrays, plain.arrays + 8 * 2 * (N * c + size * c));
    // Memory for factors covers all kept factors and the one being computed.
    let squares: usize = columns.iter().map(|k| k * k).sum();
    assert_eq!((plain.factors, plain.keep_factors), (8 * (squares + widest * widest), true));
    let once = planned(&|params| params.method = Method::Irf { passes: 1, granularity: 20 });
    assert_eq!((once.factors, once.keep_factors), (8 * widest * widest, false));
    let reused = planned(&|params| (params.method, params.reuse) = (Method::Irf { passes: 1, granularity: 20 }, true));
    assert_eq!((reused.factors, reused.keep_factors), (plain.factors, true));
    let refined = planned(&|params| (params.method, params.refinements) = (Method::Nlsf, 1));
    assert_eq!((refined.factors, refined.keep_factors), (8 * size * size, true));
    // Each thread needs a Gram matrix, a chunk of the block, sums of the right-hand sides, and 4 MiB for products.
    let thread = 8 * (widest * widest + CHUNK * widest + widest * c);
    assert_eq!(plain.work, thread + (4 << 20));
    assert_eq!(planned(&|params| params.threads = 3).work, 3 * plain.work);
    assert_eq!(weighted.work, plain.work + 8 * CHUNK * c);
    // If a source provides the Gram matrices, no thread sums one; computing one takes a MiB per thread.
    let given = planned(&|params| (params.gram_bytes, params.threads) = (Some(5000), 2));
    assert_eq!((given.grams, given.work), (5000 + (2 << 20), 2 * (8 * widest * c + (4 << 20))));
    let held = planned(&|params| params.held = 12_345);
    assert_eq!((held.held, held.total, held.work), (12_345, plain.total + 12_345, plain.work));
    assert_eq!((plain.reserved, plain.basis, plain.whole.len()), (0, 0, 4));
}

/// Blocks of more than a thousand columns are summed by a call that all threads share.
#[test]
fn wide_blocks_are_shared_by_the_threads() {
    let directions = Directions::fibonacci(1200).unwrap();
    // The basis has (32 + 1)^2 = 1089 columns in chunks of 120 rows.
    let operator = MemoryOperator::new(&directions, 32, 120).unwrap();
    let planned = |max_degree, threads| {
        let params = IrfParams { max_degree, method: Method::Nlsf, threads, memory: 1 << 30, ..IrfParams::default() };
        let plan = plan(&operator, 2, &params).unwrap();
        adds_up(&plan);
        plan
    };
    let (one, two) = (planned(32, 1), planned(32, 2));
    // The memory includes 2,048 stacked rows and a chunk being packed.
    let stacked = 8 * 1089 * (2048 + 120);
    let thread = 8 * 1089 * 2;
    assert_eq!(two.work - one.work, one.work - stacked);
    assert!(one.work > stacked + thread);
    assert_eq!([one.reserved, two.reserved], [1, 2].map(|threads| threads * Kernels::RESERVED_PER_THREAD));
    // Threads share blocks of 1,024 columns, but not of 961.
    assert_eq!([31, 30].map(|degree| planned(degree, 1).reserved), [Kernels::RESERVED_PER_THREAD, 0]);
    assert_eq!(planned(30, 1).work, 8 * (961 * 961 + 120 * 961 + 961 * 2) + (4 << 20));
}

/// The error states the smallest sufficient budget and the largest granularity that fits. Both suffice, but a byte less
/// or a larger granularity doesn't.
#[test]
fn a_refusal_names_the_least_budget_and_the_granularity_that_fits() {
    let operator = Elsewhere(operator());
    for granularity in [1, 20, 64] {
        let refused = |memory, method| match plan(&operator, 3, &IrfParams { memory, method, ..params(2, granularity) })
        {
            Err(SolverError::Budget { budget, needed, granularity }) => {
                assert_eq!(budget, memory);
                (needed, granularity)
            }
            other => panic!("{other:?}"),
        };
        let method = Method::Irf { passes: 2, granularity };
        let (needed, none) = refused(1000, method);
        assert_eq!(none, None);
        let least = plan(&operator, 3, &IrfParams { memory: needed, ..params(2, granularity) }).unwrap();
        adds_up(&least);
        // A single block's factor is computed in place, so keeping it needs no further memory.
        assert_eq!(least.keep_factors, granularity == 64);
        assert_eq!(refused(needed - 1, method).0, needed);
    }
    // If the widest block needs too much memory, narrower blocks fit.
    let (whole, _) = match plan(&operator, 3, &IrfParams { memory: 1, ..params(2, 64) }) {
        Err(SolverError::Budget { needed, granularity, .. }) => (needed, granularity),
        other => panic!("{other:?}"),
    };
    let fits = |granularity, memory| plan(&operator, 3, &IrfParams { memory, ..params(2, granularity) }).is_ok();
    let mut told = Vec::new();
    for less in [1, 20_000, 40_000, 60_000] {
        let memory = whole - less;
        let Err(SolverError::Budget { granularity, .. }) = plan(&operator, 3, &IrfParams { memory, ..params(2, 64) })
        else {
            panic!("it fits")
        };
        if let Some(granularity) = granularity {
            assert!(fits(granularity, memory) && !fits(2 * granularity, memory), "{granularity}");
            told.push(granularity);
        }
    }
    assert!(!told.is_empty());
    // For methods with fixed blocks the error states no granularity.
    let sirf = IrfParams { memory: 1, method: Method::Sirf { start_degree: 2 }, ..params(1, 64) };
    assert!(matches!(plan(&operator, 3, &sirf), Err(SolverError::Budget { granularity: None, .. })));
}

/// With enough memory blocks are read once, with read-ahead; with less they are read in chunks if that needs less
/// memory.
#[test]
fn what_is_left_of_the_budget_goes_to_the_basis() {
    let operator = Elsewhere(operator());
    let columns = [16, 20, 13, 15];
    let generous = plan(&operator, 3, &params(1, 20)).unwrap();
    assert!(generous.read_ahead && generous.whole == [true; 4]);
    // Read-ahead needs memory for the two largest neighbouring blocks; the last block and the first are neighbours,
    // too.
    assert_eq!(generous.basis, WHOLE * (16 + 20));
    let fixed = generous.total - generous.basis;
    let with = |basis: usize| plan(&operator, 3, &IrfParams { memory: fixed + basis, ..params(1, 20) });
    assert!(with(WHOLE * 36).unwrap().read_ahead);
    let alone = with(WHOLE * 36 - 1).unwrap();
    assert!(!alone.read_ahead && alone.whole == [true; 4]);
    assert_eq!(alone.basis, WHOLE * 20);
    assert_eq!(with(WHOLE * 20).unwrap().whole, [true; 4]);
    // Each of these blocks needs the least memory if it is entirely in memory.
    let Err(SolverError::Budget { needed, .. }) = with(WHOLE * 20 - 1) else { panic!("it fits") };
    assert_eq!(needed, fixed + WHOLE * 20);
    // For blocks of more than 30 columns, chunks need less memory.
    let wide = |memory| plan(&operator, 3, &IrfParams { memory, ..params(1, 36) }).unwrap();
    let wide_fixed = wide(1 << 30).total - wide(1 << 30).basis;
    let chunks = wide(wide_fixed + CHUNKWISE);
    // Degrees 0 to 5 have 36 columns, 6 and 7 have 28.
    assert_eq!((chunks.whole.clone(), chunks.basis, chunks.read_ahead), (vec![false, true], CHUNKWISE, false));
    let one = plan(&operator, 3, &IrfParams { method: Method::Nlsf, ..params(1, 1) }).unwrap();
    assert_eq!((one.basis, one.read_ahead), (WHOLE * columns.iter().sum::<usize>(), true));
}

/// A monitor that records its calls.
#[derive(Default)]
struct Told {
    total: AtomicU64,
    steps: AtomicU64,
    notes: Mutex<Vec<(Level, String)>>,
}

impl Monitor for Told {
    fn begin(&self, stage: Stage, total: u64) {
        assert_eq!(stage.name, "fit");
        self.total.store(total, Ordering::Relaxed);
    }

    fn step(&self, steps: u64) {
        self.steps.fetch_add(steps, Ordering::Relaxed);
    }

    fn note(&self, level: Level, text: std::fmt::Arguments<'_>) {
        self.notes.lock().unwrap().push((level, text.to_string()));
    }
}

fn targets() -> Array2<f64> {
    Array2::from_shape_fn((N, 2), |(i, j)| ((i * 7 + j * 13) as f64 * 0.37).sin())
}

#[test]
fn progress_adds_up_and_passes_are_numbered() {
    let operator = operator();
    let told = Told::default();
    let params = IrfParams { refinements: 1, ..params(3, 20) };
    let fit = irf::solve(&operator, targets().view(), std::slice::from_ref(&(0..2)), &params, &told).unwrap();
    let report = &fit.report;
    assert_eq!((report.method, report.passes, report.accelerated), ("irf", 3, false));
    assert_eq!((report.max_degree, report.rows, report.channels, report.threads), (L, N, 2, 1));
    // Refinements are neither in the announced number of steps nor counted as steps.
    assert_eq!((told.total.into_inner(), told.steps.into_inner()), (3 * 64, 3 * 64));
    let history: Vec<_> = report.history.iter().map(|pass| (pass.pass, pass.refinement, pass.bytes_read)).collect();
    assert_eq!(history, [(1, false, 0), (2, false, 0), (3, false, 0), (3, true, 0)]);
    assert!(report.history.iter().all(|pass| pass.seconds > 0.0 && pass.residuals.len() == 1));
    assert!(report.seconds.solve > 0.0 && report.seconds.update > 0.0);
    let blocks: Vec<_> = report.blocks.iter().map(|b| (b.first_degree, b.last_degree, b.columns, b.rank)).collect();
    assert_eq!(blocks, [(0, 3, 16, 16), (4, 5, 20, 20), (6, 6, 13, 13), (7, 7, 15, 15)]);
    assert!(report.blocks.iter().all(|block| block.solver == "cholesky" && (1.0..2.0).contains(&block.condition)));
    let notes = told.notes.into_inner().unwrap();
    let of =
        |level| notes.iter().filter(|(found, _)| *found == level).map(|(_, text)| text.as_str()).collect::<Vec<_>>();
    let statuses = of(Level::Status);
    assert_eq!((statuses.len(), statuses[0], statuses[5]), (16, "pass 1, degrees 0 to 3", "pass 2, degrees 4 to 5"));
    let details = of(Level::Detail);
    assert!(details[2].starts_with("pass 3: ") && details[2].ends_with(" s, 0.00 GB read"), "{details:?}");
    assert!(details[3].starts_with("refinement after pass 3: "), "{details:?}");
}

#[test]
fn batches_keep_to_the_plan_and_share_factors() {
    let operator = operator();
    let mut solver = IrfSolver::new(&operator, 2, IrfParams { reuse: true, ..params(1, 20) }).unwrap();
    assert_eq!((solver.channels(), solver.blocks().len()), (2, 4));
    assert!(solver.plan().keep_factors);
    let all = IrfSolver::new(&operator, 2, IrfParams { threads: 0, ..params(1, 20) }).unwrap();
    assert_eq!(all.plan().work, rayon::current_num_threads() * solver.plan().work);
    let gram = moment_gram(&Directions::fibonacci(N).unwrap(), None, L).unwrap();
    assert!(IrfSolver::with_gram(&operator, 2, params(1, 20), &gram).unwrap().plan().grams > 1 << 20);
    let targets = targets();
    let fit = |solver: &mut IrfSolver<'_>, targets: ArrayView2<'_, f64>| {
        let columns = 0..targets.ncols();
        solver.fit(ChunkedRows::from_array(targets, CHUNK), std::slice::from_ref(&columns), &Silent)
    };
    let first = fit(&mut solver, targets.view()).unwrap();
    let again = fit(&mut solver, targets.view()).unwrap();
    assert_eq!(first.coefficients.values(), again.coefficients.values());
    let one = fit(&mut solver, targets.slice(ndarray::s![.., 1..2])).unwrap();
    let off = (&one.coefficients.values().column(0) - &first.coefficients.values().column(1)).mapv(f64::abs);
    assert!(off.iter().all(|off| *off < 1e-14));
    let three = Array2::<f64>::zeros((N, 3));
    assert!(matches!(fit(&mut solver, three.view()), Err(SolverError::Channels { planned: 2, found: 3 })));
    let short = Array2::<f64>::zeros((N - 1, 2));
    assert!(matches!(fit(&mut solver, short.view()), Err(SolverError::Rows { expected: N, found: 399, .. })));
    let mut broken = targets.clone();
    broken[[2 * CHUNK + 3, 1]] = f64::NAN;
    assert!(matches!(fit(&mut solver, broken.view()), Err(SolverError::NotFinite { row: 83, column: 1 })));
    broken[[N - 1, 0]] = f64::INFINITY;
    broken[[83, 1]] = 0.0;
    assert!(matches!(fit(&mut solver, broken.view()), Err(SolverError::NotFinite { row: 399, column: 0 })));
}

#[test]
fn degrees_above_the_basis_or_its_gram_matrix_are_refused() {
    let operator = operator();
    let high = IrfParams { max_degree: L + 1, ..params(1, 20) };
    let found = IrfSolver::new(&operator, 1, high.clone()).err();
    assert!(matches!(found, Some(SolverError::Degree { found: 8, max_degree: L })), "{found:?}");
    let gram = moment_gram(&Directions::fibonacci(N).unwrap(), None, L - 1).unwrap();
    let found = IrfSolver::with_gram(&operator, 1, params(1, 20), &gram).err();
    assert!(matches!(found, Some(SolverError::Degree { found: L, max_degree: 6 })), "{found:?}");
    let below = IrfParams { max_degree: L - 1, ..params(1, 20) };
    assert!(IrfSolver::with_gram(&operator, 1, below, &gram).is_ok());
    // Moments need transforms of twice the degree.
    assert!(moment_gram_bytes(N, 1000).is_ok());
    assert!(matches!(moment_gram_bytes(N, 1001), Err(SolverError::Harmonics(_))));
    assert!(moment_gram_bytes(2 * N, L).unwrap() >= moment_gram_bytes(N, L).unwrap() + 8 * N);
}
