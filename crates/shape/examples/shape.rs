//! Rotates and aligns arrays of coefficients, and measures the time. `benches/shape.py` runs this program and
//! compares it with other programs on the same arrays.
//!
//! Arrays are `.npy` files of f64. Coefficients have the shape (K, 3) for one surface and (n, K, 3) for n surfaces. A
//! rotation has the shape (3, 3). Each command prints JSON with the CPU seconds and the elapsed seconds of each
//! repetition or pair, and writes its results for verification.

use std::path::Path;
use std::time::Instant;

use ndarray::{Array2, Array3, Axis};
use ndarray_npy::{read_npy, write_npy};
use rustix::time::{ClockId, clock_gettime};
use serde_json::json;
use spharm_harmonics::Coefficients;
use spharm_monitor::Silent;
use spharm_shape::{AlignParams, ProcrustesParams, Rotation, align, procrustes, rotate_parameters};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const USAGE: &str = "\
    rotate COEFFICIENTS MATRIX REPEATS OUT | align MOVING TARGETS BANDWIDTH STARTS OUT | procrustes MEMBERS OUT; \
    threads by RAYON_NUM_THREADS";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["rotate", coefficients, matrix, repeats, out] => {
            let coefficients = Coefficients::new(read_npy(coefficients)?)?;
            let matrix: Array2<f64> = read_npy(matrix)?;
            let rotation = Rotation::from_matrix(std::array::from_fn(|i| std::array::from_fn(|j| matrix[[i, j]])))?;
            let mut times = Times::default();
            for _ in 0..repeats.parse()? {
                let rotated = times.of(|| rotate_parameters(&coefficients, &rotation, &Silent))?;
                write_npy(out, rotated.values())?;
            }
            println!("{}", times.json(&json!({})));
        }
        ["align", moving, targets, bandwidth, starts, out] => {
            // A value of 0 selects the default bandwidth or the default number of starts.
            let (bandwidth, starts): (usize, usize) = (bandwidth.parse()?, starts.parse()?);
            let mut params = AlignParams { bandwidth: (bandwidth > 0).then_some(bandwidth), ..Default::default() };
            params.starts = if starts > 0 { starts } else { params.starts };
            let (mut times, mut rmsd, mut aligned) = (Times::default(), Vec::new(), Vec::new());
            for (moving, target) in surfaces(moving)?.iter().zip(&surfaces(targets)?) {
                let found = times.of(|| align(moving, target, &params, &Silent))?;
                rmsd.push(found.report.rmsd_after);
                aligned.push(found.coefficients);
            }
            write(out, &aligned)?;
            println!("{}", times.json(&json!({ "rmsd": rmsd })));
        }
        ["procrustes", members, out] => {
            let (members, mut times) = (surfaces(members)?, Times::default());
            let found = times.of(|| procrustes(&members, &ProcrustesParams::default(), &Silent))?;
            write(out, &[found.mean])?;
            let ends: Vec<_> =
                found.report.ends.iter().map(|end| json!([end.template, end.spread, end.rounds])).collect();
            let warnings: Vec<_> = found.report.warnings.iter().map(ToString::to_string).collect();
            let spread = found.report.spread_after;
            println!("{}", times.json(&json!({ "spread": spread, "ends": ends, "warnings": warnings })));
        }
        _ => return Err(USAGE.into()),
    }
    Ok(())
}

fn surfaces(path: impl AsRef<Path>) -> Result<Vec<Coefficients>> {
    let values: Array3<f64> = read_npy(path)?;
    Ok(values.outer_iter().map(|values| Coefficients::new(values.to_owned())).collect::<std::result::Result<_, _>>()?)
}

fn write(path: &str, surfaces: &[Coefficients]) -> Result<()> {
    let views: Vec<_> = surfaces.iter().map(|surface| surface.values().view()).collect();
    Ok(write_npy(path, &ndarray::stack(Axis(0), &views)?)?)
}

#[derive(Default)]
struct Times {
    cpu: Vec<f64>,
    seconds: Vec<f64>,
}

impl Times {
    fn of<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let (cpu, start) = (cpu_seconds(), Instant::now());
        let done = work();
        self.seconds.push(start.elapsed().as_secs_f64());
        self.cpu.push(cpu_seconds() - cpu);
        done
    }

    fn json(&self, more: &serde_json::Value) -> serde_json::Value {
        json!({ "cpu": self.cpu, "seconds": self.seconds, "found": more })
    }
}

/// Returns the CPU time of all threads of this process, in seconds. Other programs on the machine affect the CPU time
/// less than the elapsed time.
fn cpu_seconds() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}
