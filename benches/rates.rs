//! Measures the speed of the machine, and prints it as JSON: the rate of a large dense product in flops per second, and
//! the rates at which one thread evaluates harmonics and processes bytes from memory.
//!
//! `cargo bench --bench rates`. The limits required by `./run bench` are stated relative to the rate of dgemm.

use std::hint::black_box;
use std::time::Instant;

use spharm_harmonics::product::{self, Matrix};
use spharm_harmonics::{Recurrence, Sweep, basis_size};
use spharm_solver::threaded::{Kernels, ThreadedKernels};

// The program's choice, so that its rates are measured.
#[cfg(all(feature = "openblas", target_os = "linux", target_arch = "x86_64"))]
#[path = "../tools/kernels.rs"]
mod kernels;

/// Returns the median duration of five runs, in seconds, after one run to warm up.
fn median(mut work: impl FnMut()) -> f64 {
    work();
    let mut seconds: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[2]
}

fn main() {
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let order = 4096;
    let a: Vec<f64> = (0..order * order).map(|i| (i % 97) as f64).collect();
    let matrix = Matrix::new(&a, order, order, order);
    let mut out = vec![0.0; order * order];
    let dgemm = {
        let mut kernels = Kernels::with_threads(threads);
        2.0 * (order as f64).powi(3) / median(|| kernels.subtract_outer(matrix, matrix, &mut out, order))
    };

    let (rows, max_degree) = (520, 100);
    let directions: Vec<[f64; 3]> = (0..rows)
        .map(|i| {
            let (z, phi) = ((2 * i + 1) as f64 / rows as f64 - 1.0, 2.4 * i as f64);
            let u = (1.0 - z * z).sqrt();
            [u * phi.cos(), u * phi.sin(), z]
        })
        .collect();
    let recurrence = Recurrence::new(max_degree).expect("degree 100 is supported");
    let mut block = vec![0.0; rows * (2 * max_degree + 1)];
    let values = (rows * basis_size(max_degree)) as f64;
    let harmonics = values
        / median(|| {
            let mut sweep = Sweep::new(&recurrence, &directions);
            for l in 0..=max_degree {
                sweep.next_degree(&mut block[..rows * (2 * l + 1)]);
                black_box(&block);
            }
        });

    // Measures the rate at which a pass processes bytes that it streams from memory. The pass uses forty chunks, which
    // don't fit into any cache.
    let columns = 2 * max_degree + 1;
    let chunks = vec![0.5; 40 * rows * columns];
    let residual = vec![0.25; rows * 3];
    let (mut x, mut updated) = (vec![0.0; columns * 3], vec![0.0; rows * 3]);
    let stream = 8.0 * chunks.len() as f64
        / median(|| {
            for chunk in chunks.chunks_exact(rows * columns) {
                let chunk = Matrix::new(chunk, rows, columns, rows);
                product::accumulate_adjoint(chunk, Matrix::new(&residual, rows, 3, rows), &mut x);
                product::accumulate_synthesis(chunk, &x, -1e-9, &mut updated, rows);
            }
        });
    println!(
        "{{\"threads\": {threads}, \"dgemm_flops\": {dgemm:.4e}, \"harmonics_per_second_one_thread\": {harmonics:.4e}, \
         \"stream_bytes_per_second_one_thread\": {stream:.4e}}}"
    );
}
