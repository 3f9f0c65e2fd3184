//! Measures the time and the rate, in GFLOP/s, of computing the Gram matrix.
//!
//! `cargo run --release -p spharm-transform --example gram -- [DEGREE [COLUMNS_PER_TILE]]`

use std::time::Instant;

use spharm_harmonics::{basis_size, gauss_legendre};
use spharm_transform::MomentGram;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let max_degree = arguments.first().copied().unwrap_or(100);
    let width = arguments.get(1).copied().unwrap_or(1_024);
    // The moments are arbitrary, because the time doesn't depend on them.
    let moments: Vec<f64> = (0..basis_size(2 * max_degree)).map(|i| (i as f64).sin()).collect();

    let start = Instant::now();
    let rings = gauss_legendre(2 * max_degree + 1).len();
    println!("{rings} rings: {:.4} s", start.elapsed().as_secs_f64());
    let start = Instant::now();
    let gram = MomentGram::new(max_degree, &moments)?;
    println!("tables, {:.1} MB: {:.4} s", MomentGram::bytes(max_degree) as f64 / 1e6, start.elapsed().as_secs_f64());

    // Each of L + 1 rings costs 2 flops for each entry of the lower triangle.
    let size = gram.size();
    let flops = (max_degree + 1) as f64 * size as f64 * (size + 1) as f64;
    let report = |what: &str, seconds: f64| println!("{what}: {seconds:.4} s, {:.1} GFLOP/s", flops / seconds / 1e9);
    if 8 * size * size < 4 << 30 {
        let mut whole = vec![0.0; size * size];
        for what in ["lower triangle, fresh memory", "lower triangle, again", "lower triangle, again"] {
            let start = Instant::now();
            gram.write_lower(&mut whole, size);
            report(what, start.elapsed().as_secs_f64());
        }
    }
    for (what, height) in [("columns, all rows", size), ("columns and rows", width)] {
        let mut tile = vec![0.0; height * width];
        let start = Instant::now();
        for column in (0..size).step_by(width) {
            for row in (column..size).step_by(height) {
                gram.tile(row..size.min(row + height), column..size.min(column + width), &mut tile, height);
            }
        }
        report(&format!("tiles of {width} {what}"), start.elapsed().as_secs_f64());
    }
    Ok(())
}
