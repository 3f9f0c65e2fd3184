//! x
use spharm_model::Model;
use spharm_monitor::Silent;
use spharm_shape::codec::*;
#[allow(missing_docs)]
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let model = Model::read(&args[1]).unwrap();
    for a in &args[2..] {
        let (k, v) = a.split_at(1);
        let target = match k {
            "s" => Target::Step(2f64.powf(-v.parse::<f64>().unwrap())),
            "t" => Target::Tolerance(v.parse().unwrap()),
            _ => Target::Bytes(v.parse().unwrap()),
        };
        let p = CompressParams { provenance: false, ..CompressParams::new(target) };
        let start = std::time::Instant::now();
        let c = compress(&model, &p, &Silent).unwrap();
        let t = start.elapsed().as_secs_f64();
        let start = std::time::Instant::now();
        let e = expand(&c.bytes, &ExpandParams::default()).unwrap();
        println!(
            "{a} bytes {} head {} distance {:.4e} step {:.4e} {t:.2} s, expand {:.3} s levels {:?}",
            c.bytes.len(),
            c.head,
            c.distance,
            c.step,
            start.elapsed().as_secs_f64(),
            c.levels
        );
        std::fs::write(format!("/tmp/codec-work/{a}.sphz"), &c.bytes).unwrap();
        let _ = e.model.write_with(format!("/tmp/codec-work/{a}.npz"), true);
        assert_eq!(e.model.coefficients.max_degree(), c.max_degree);
    }
}
