//! Refines the correspondence of a group. The group's coefficients are read from a `.npy` file of f64 with shape (N, K,
//! 3 + c).
//!
//! Writes an array of shape (N, n, 3): the images of an icosphere's n directions under the map of each of the N
//! members. Prints the report of each stage.

use std::time::Instant;

use ndarray::{Array3, Axis};
use ndarray_npy::{read_npy, write_npy};
use spharm_harmonics::Coefficients;
use spharm_monitor::Silent;
use spharm_shape::{GroupwiseParams, ProcrustesParams, StageParams, groupwise, procrustes};
use spharm_surface::Sphere;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const USAGE: &str = "MEMBERS LEVEL OUT [align] [together] [normals=SHARE] [elasticity=MU] [delta=SHARE] [tolerance=CHANGE] \
    [stages=DEGREE,FIELDS,ROUNDS;...]; threads by RAYON_NUM_THREADS";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [members, level, out, settings @ ..] = &arguments[..] else { return Err(USAGE.into()) };
    let members: Array3<f64> = read_npy(members)?;
    let mut members: Vec<_> = members.axis_iter(Axis(0)).map(|member| member.to_owned()).collect();
    let mut params = GroupwiseParams::default();
    for setting in settings {
        match setting.split_once('=').unwrap_or((setting, "")) {
            ("align", _) => {
                let surfaces: Vec<_> =
                    members.drain(..).map(Coefficients::new).collect::<std::result::Result<_, _>>()?;
                let found = procrustes(&surfaces, &ProcrustesParams::default(), &Silent)?;
                for (surface, transform) in surfaces.iter().zip(&found.transforms) {
                    members.push(transform.apply(surface, &Silent)?.values().clone());
                }
            }
            ("together", _) => params.together = true,
            ("normals", value) => params.normals = value.parse()?,
            ("elasticity", value) => params.elasticity = value.parse()?,
            ("delta", value) => params.delta = value.parse()?,
            ("tolerance", value) => params.tolerance = value.parse()?,
            ("stages", value) => params.stages = Some(value.split(';').map(stage).collect::<Result<_>>()?),
            _ => return Err(USAGE.into()),
        }
    }
    let sphere = Sphere::icosphere(level.parse()?);
    let views: Vec<_> = members.iter().map(|member| member.view()).collect();
    let start = Instant::now();
    let found = groupwise(&views, &sphere, None, &params, &Silent)?;
    println!("{:.2} s", start.elapsed().as_secs_f64());
    for stage in &found.report.stages {
        println!("{stage:?}");
    }
    let start = Instant::now();
    let directions = sphere.directions.as_slice();
    let mut carried = Array3::zeros((members.len(), directions.len(), 3));
    for (mut carried, flow) in carried.outer_iter_mut().zip(&found.flows) {
        for (mut row, u) in carried.rows_mut().into_iter().zip(flow.apply(directions)?) {
            (0..3).for_each(|k| row[k] = u[k]);
        }
    }
    println!("applied in {:.2} s", start.elapsed().as_secs_f64());
    write_npy(out, &carried)?;
    let aligned =
        Array3::from_shape_fn((members.len(), views[0].nrows(), views[0].ncols()), |(i, k, c)| views[i][[k, c]]);
    write_npy(format!("{out}.members.npy"), &aligned)?;
    Ok(())
}

fn stage(text: &str) -> Result<StageParams> {
    let numbers: Vec<usize> = text.split(',').map(str::parse).collect::<std::result::Result<_, _>>()?;
    let [max_degree, field_degree, rounds] = numbers[..] else { return Err(USAGE.into()) };
    Ok(StageParams { max_degree, field_degree, rounds })
}
