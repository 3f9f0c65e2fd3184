//! Rates of the kernels on one thread: harmonics, and a block's products with three columns.
use std::hint::black_box;
use std::time::Instant;

use spharm_harmonics::product::{Matrix, accumulate_adjoint, accumulate_synthesis};
use spharm_harmonics::{Recurrence, Sweep, basis_size};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for (max_degree, rows) in [(100, 256), (100, 520), (100, 1032), (300, 520)] {
        let directions: Vec<[f64; 3]> = (0..rows)
            .map(|i| {
                let (z, phi) = ((2 * i + 1) as f64 / rows as f64 - 1.0, i as f64 * 2.4);
                let u = (1.0 - z * z).sqrt();
                [u * phi.cos(), u * phi.sin(), z]
            })
            .collect();
        let recurrence = Recurrence::new(max_degree)?;
        let mut block = vec![0.0; rows * (2 * max_degree + 1)];
        let runs = 40;
        let start = Instant::now();
        for _ in 0..runs {
            let mut sweep = Sweep::new(&recurrence, &directions);
            for l in 0..=max_degree {
                sweep.next_degree(&mut block[..rows * (2 * l + 1)]);
                black_box(&block);
            }
        }
        let seconds = start.elapsed().as_secs_f64() / runs as f64;
        let start = Instant::now();
        for _ in 0..runs {
            let mut sweep = Sweep::new(&recurrence, &directions);
            for _ in 0..=max_degree {
                sweep.skip_degree();
            }
            black_box(&sweep);
        }
        let skip = start.elapsed().as_secs_f64() / runs as f64;
        let values = (rows * basis_size(max_degree)) as f64;
        println!(
            "harmonics L={max_degree} rows={rows}: {:.2} Gvalues/s, skipping {:.2}",
            values / seconds / 1e9,
            values / skip / 1e9
        );
    }
    for rows in [256, 520, 1032] {
        let k = 201;
        let a = vec![0.5; 40 * rows * k];
        let r = vec![0.25; rows * 3];
        let mut x = vec![0.0; k * 3];
        let mut out = vec![0.0; rows * 3];
        let mut time = |what: &str, f: &mut dyn FnMut(Matrix<'_>)| {
            let start = Instant::now();
            for _ in 0..4 {
                for chunk in a.chunks_exact(rows * k) {
                    f(Matrix::new(chunk, rows, k, rows));
                }
            }
            println!(
                "{what} rows={rows}: {:.1} GB/s",
                4.0 * 8.0 * a.len() as f64 / start.elapsed().as_secs_f64() / 1e9
            );
        };
        time("adjoint", &mut |m| accumulate_adjoint(m, Matrix::new(&r, rows, 3, rows), &mut x));
        let y = x.clone();
        time("synthesis", &mut |m| accumulate_synthesis(m, &y, -1.0, &mut out, rows));
        time("both", &mut |m| {
            accumulate_adjoint(m, Matrix::new(&r, rows, 3, rows), &mut x);
            accumulate_synthesis(m, &y, -1.0, &mut out, rows);
        });
    }
    Ok(())
}
