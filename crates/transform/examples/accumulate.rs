//! Measures the time for accumulating the sums of random samples, and for the transforms at the end.
//!
//! `cargo run --release -p spharm-transform --example accumulate [DEGREE [SAMPLES [CHANNELS]]]`

use std::time::Instant;

use ndarray::Array2;
use spharm_transform::{Accumulator, SumsSeconds};

/// Returns a pseudorandom number in [-1, 1), computed from a counter.
fn noise(i: u64) -> f64 {
    let mut z = (i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn main() -> Result<(), spharm_transform::TransformError> {
    let arguments: Vec<usize> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    let argument = |i: usize, default: usize| arguments.get(i).copied().unwrap_or(default);
    let (max_degree, samples, channels) = (argument(0, 1000), argument(1, 20_000_000), argument(2, 1));
    const CHUNK: usize = 1 << 20;
    let directions: Vec<[f64; 3]> = (0..CHUNK as u64)
        .map(|i| {
            let (z, phi) = (noise(2 * i), std::f64::consts::PI * noise(2 * i + 1));
            let u = (1.0 - z * z).sqrt();
            [u * phi.cos(), u * phi.sin(), z]
        })
        .collect();
    let values = Array2::from_shape_fn((CHUNK, channels), |(i, c)| noise((i * channels + c) as u64));
    let mut sums = Accumulator::new(max_degree, channels)?;
    println!("{} MB planned", Accumulator::bytes(max_degree, channels) / 1_000_000);
    let started = Instant::now();
    for _ in 0..samples.div_ceil(CHUNK) {
        sums.add(&directions, None, values.view())?;
    }
    sums.spread();
    let added = started.elapsed().as_secs_f64();
    let each = 1e9 * added / (samples.div_ceil(CHUNK) * CHUNK) as f64;
    println!("degree {max_degree}, {channels} channels: {each:.1} ns per sample");
    let SumsSeconds { place, spread } = sums.seconds();
    println!("placing: {place:.2} s, spreading: {spread:.2} s");
    let started = Instant::now();
    sums.finish()?;
    println!("transforms: {:.2} s", started.elapsed().as_secs_f64());
    Ok(())
}
