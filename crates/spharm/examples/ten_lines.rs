//! Fits a model to a mesh and reconstructs a mesh from it: `cargo run --example ten_lines -- bunny.ply 60`. Without
//! arguments, a generated surface is fitted.

use std::path::{Path, PathBuf};

use spharm::generate::{Cortex, cortex};
use spharm::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let Some(path) = arguments.next() else { return on_a_made_surface() };
    let degree = arguments.next().map_or(Ok(60), |text| text.parse())?;
    Ok(ten_lines(Path::new(&path), degree)?)
}

fn ten_lines(path: &Path, degree: usize) -> Result<(), Error> {
    let beside = |ending: &str| PathBuf::from(path).with_extension(ending);
    let surface = read_mesh(path)?;
    let fitted = fit_mesh(&surface, &FitParams::lsq(degree))?;
    println!("msd {:?}, off-vertex {:?}", fitted.fit.report.msd, fitted.fit.report.off_vertex);
    let model = Model::from(fitted);
    model.write(beside("spharm.npz"))?;
    write_mesh(beside("model.ply"), &model.reconstruct(&Sphere::icosphere(6), degree)?)
}

fn on_a_made_surface() -> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("folded.ply");
    let (surface, _) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    write_mesh(&path, &surface)?;
    Ok(ten_lines(&path, 15)?)
}

#[test]
fn the_ten_lines_run() {
    on_a_made_surface().expect("a model");
}
