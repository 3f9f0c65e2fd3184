//! Runs a kernel a given number of times, so that its instructions can be counted: `RAYON_NUM_THREADS=1 instructions
//! KERNEL REPEATS`.
//!
//! The kernel `legendre` is a synthesis at few directions to a high degree. Nearly all of its work is Legendre sums.
//! The kernels `synthesis` and `adjoint` have many directions and a low degree. Most of their work is interpolation.

use std::error::Error;

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_transform::{Transform, TransformParams};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [kernel, repeats] = arguments.as_slice() else { return Err("expected KERNEL REPEATS".into()) };
    let (max_degree, count) = if kernel == "legendre" { (800, 100) } else { (40, 40_000) };
    let direction = |i: usize| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let (across, phi) = ((1.0 - z * z).sqrt(), 2.4 * i as f64);
        [across * phi.cos(), across * phi.sin(), z]
    };
    let directions = Directions::from_vertices(&(0..count).map(direction).collect::<Vec<_>>())?;
    let transform = Transform::new(&directions, &TransformParams { max_degree, ..TransformParams::default() })?;
    let coefficients = Array2::from_shape_fn(((max_degree + 1).pow(2), 3), |(k, c)| ((k + c) as f64).sin());
    let samples = Array2::from_shape_fn((count, 3), |(i, c)| ((i + c) as f64).cos());
    let mut sum = 0.0;
    for _ in 0..repeats.parse::<usize>()? {
        sum += match kernel.as_str() {
            "legendre" | "synthesis" => transform.synthesis(coefficients.view())?.sum(),
            "adjoint" => transform.adjoint_synthesis(samples.view())?.sum(),
            _ => return Err(format!("{kernel}: expected legendre, synthesis or adjoint").into()),
        };
    }
    println!("{sum}");
    Ok(())
}
