//! Draws surfaces side by side: `cargo run --release -p spharm-render --example draw -- out.png [surface...]`. Without
//! surfaces, draws variants 0 and 1 of the generated cortex.

use std::error::Error;

use spharm_render::{Panel, Settings, View, render, write_png};
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, read_mesh};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("usage: draw OUT.png [SURFACE...]")?;
    let mut meshes: Vec<(String, Mesh)> = Vec::new();
    for path in arguments {
        let mesh = read_mesh(&path)?;
        meshes.push((path, mesh));
    }
    if meshes.is_empty() {
        for variant in [0, 1] {
            let (surface, _) = cortex(&Cortex { subdivisions: 6, variant });
            meshes.push((format!("subject {variant}"), surface));
        }
    }
    let settings = Settings { width: 720, height: 600, view: View::CORNER, common_scale: false, ..Settings::default() };
    let panels: Vec<Panel<'_>> = meshes.iter().map(|(caption, mesh)| Panel::new(mesh, caption)).collect();
    let picture = render(&panels, &settings)?;
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    Ok(write_png(out, &picture, &options)?)
}
