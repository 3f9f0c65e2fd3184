//! Measures the time for computing a Cholesky factor, for publishing it in a store, and for solving with the factor in
//! the page cache.
//!
//! `cargo bench -p spharm-solver --bench factor [-- SIZE]`. Rates in GB/s assume that each of the two triangular solves
//! reads the factor once. Rates in GFLOP/s assume 2 K^2 flops per column.

use std::ops::Range;
use std::time::Instant;

use ndarray::Array2;
use spharm_harmonics::index::max_degree_of;
use spharm_monitor::Silent;
use spharm_solver::cholesky::{CholeskyFactor, FactorParams, StoredFactor, build_factor};
use spharm_solver::threaded::{Kernels, ThreadedKernels};
use spharm_solver::{GramMatrix, SolverError};
use spharm_store::factor::FactorFile;
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};

/// A matrix that is cheap to compute: noise, with a diagonal above the noise's spectral radius of 2 sqrt(K / 3).
/// If the entries decreased with the distance from the diagonal, some would become denormal numbers, whose slow
/// arithmetic would distort the measurement.
struct Noise(usize);

impl GramMatrix for Noise {
    fn size(&self) -> usize {
        self.0
    }

    fn bytes(&self) -> usize {
        0
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        let noise = |i: usize, j: usize| {
            let mixed = ((i.min(j) as u64) << 32 | i.max(j) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) as i64 as f64 / i64::MAX as f64
        };
        for (column, out) in columns.zip(out.chunks_mut(leading)) {
            for (row, out) in rows.clone().zip(out) {
                *out = if row == column { 2.0 * (self.0 as f64).sqrt() } else { noise(row, column) };
            }
        }
        Ok(())
    }
}

fn main() {
    let size = std::env::args().filter_map(|text| text.parse().ok()).next().unwrap_or(10_201);
    let max_degree = max_degree_of(size).expect("a square");
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    println!("{}; {threads} threads; K = {size}", Kernels::version());
    let folder = tempfile::tempdir().expect("a folder");
    let spec =
        FactorSpec { key: SchemeKey([1; 32]), rows: 4 * size, max_degree, weights: WeightsHash::ONES, smoothness: 0.0 };
    let flops = (size as f64).powi(3) / 3.0;
    for (what, memory) in [("in memory", 8 << 30), ("out of core, 256 MiB", 256 << 20)] {
        for scalar in [Scalar::F64, Scalar::F32] {
            let params = FactorParams { scalar, memory, threads, ..FactorParams::default() };
            let started = Instant::now();
            let built = build_factor(folder.path(), &spec, &Noise(size), &params, &Silent).expect("a factor");
            let seconds = started.elapsed().as_secs_f64();
            println!(
                "{} {what}: {seconds:.2} s, {:.1} GFLOP/s, {} bytes, rcond {:.1e}",
                scalar.name(),
                flops / seconds / 1e9,
                built.file.file_len(),
                built.file.header().condition.reciprocal
            );
            if memory < 1 << 30 {
                for channels in [1, 3, 6, 8, 12, 24, 96] {
                    solves(&built.file, channels, threads);
                }
            }
            std::fs::remove_file(built.file.path()).expect("a removal");
        }
    }
}

/// Returns the processor time of this thread in seconds.
fn processor_time() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds: f64 = text.split(' ').next().and_then(|number| number.parse().ok()).unwrap_or(0.0);
    nanoseconds / 1e9
}

/// Measures the first solve after opening the file, and the solves that follow it.
fn solves(file: &FactorFile, channels: usize, threads: usize) {
    let (size, len) = (file.header().grid.size(), file.file_len() as f64);
    let right = Array2::from_shape_fn((size, channels), |(i, c)| ((i * 3 + c) as f64).sin());
    let (mut first, mut later) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let mut x = right.clone();
        let started = Instant::now();
        let opened = FactorFile::open(file.path()).expect("a file");
        let factor = StoredFactor::new(opened, 1 << 40, threads);
        factor.solve(&mut x).expect("a solution");
        first.push(started.elapsed().as_secs_f64());
        for _ in 0..3 {
            let mut x = right.clone();
            let started = Instant::now();
            factor.solve(&mut x).expect("a solution");
            later.push(started.elapsed().as_secs_f64());
        }
    }
    // On a shared machine, the processor time of one thread is more reliable than the clock.
    let mut processor = Vec::new();
    let alone = StoredFactor::new(FactorFile::open(file.path()).expect("a file"), 1 << 40, 1);
    for _ in 0..4 {
        let mut x = right.clone();
        let started = processor_time();
        alone.solve(&mut x).expect("a solution");
        processor.push(processor_time() - started);
    }
    let checked = processor.remove(0);
    let mut streamed = Vec::new();
    for _ in 0..3 {
        let factor = StoredFactor::new(FactorFile::open(file.path()).expect("a file"), 0, threads);
        let mut x = right.clone();
        let started = Instant::now();
        factor.solve(&mut x).expect("a solution");
        streamed.push(started.elapsed().as_secs_f64());
    }
    let rates = |mut seconds: Vec<f64>| {
        seconds.sort_by(f64::total_cmp);
        let (best, median) = (seconds[0], seconds[seconds.len() / 2]);
        let flops = 2.0 * (size as f64).powi(2) * channels as f64;
        let (bytes, flops) = (2.0 * len / median / 1e9, flops / median / 1e9);
        format!("{:.1} ms (best {:.1}), {bytes:.1} GB/s, {flops:.1} GFLOP/s", 1e3 * median, 1e3 * best)
    };
    println!("  {channels:>3} columns, opening it: {}", rates(first));
    println!("      then: {}", rates(later));
    println!("      processor time of one thread, first solve {:.1} ms, then {}", 1e3 * checked, rates(processor));
    println!("      by windows that are dropped: {}", rates(streamed));
}
