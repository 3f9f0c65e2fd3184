//! Measures the time of planning, synthesis, adjoint synthesis, and the normal operator by samples and by moments:
//! `rates DIRECTIONS DEGREE ACCURACY CHANNELS`.

use std::time::Instant;

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_harmonics::index::basis_size;
use spharm_transform::{MomentOperator, SampleSums, Transform, TransformParams};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<f64> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let [n, max_degree, accuracy, channels] = arguments[..] else { return Err("four numbers are needed".into()) };
    let (n, max_degree, channels) = (n as usize, max_degree as usize, channels as usize);
    rayon::ThreadPoolBuilder::new().num_threads(2).build_global()?;
    let directions = Directions::fibonacci(n)?;
    let time = |what: &str, work: &mut dyn FnMut()| {
        let mut seconds: Vec<f64> = (0..15)
            .map(|_| {
                let start = Instant::now();
                work();
                start.elapsed().as_secs_f64()
            })
            .collect();
        seconds.sort_by(f64::total_cmp);
        println!("{what:<10} median {:.6} s, least {:.6} s", seconds[7], seconds[0]);
    };
    let params = TransformParams { max_degree, accuracy, ..Default::default() };
    let transform = Transform::new(&directions, &params)?;
    let x = Array2::from_shape_fn((basis_size(max_degree), channels), |(k, c)| ((k * 7 + c) as f64).sin());
    let samples = transform.synthesis(x.view())?;
    time("plan", &mut || drop(Transform::new(&directions, &params)));
    time("synthesis", &mut || drop(transform.synthesis(x.view())));
    time("adjoint", &mut || drop(transform.adjoint_synthesis(samples.view())));
    time("normal", &mut || drop(transform.normal(x.view(), None)));
    drop(transform);
    let sums = || SampleSums::new(&directions, None, samples.view(), max_degree, accuracy);
    let moments = sums()?.moments;
    let operator = MomentOperator::new(max_degree, &moments)?;
    time("sums", &mut || drop(sums()));
    time("operator", &mut || drop(MomentOperator::new(max_degree, &moments)));
    time("product", &mut || drop(operator.apply(x.view())));
    Ok(())
}
