//! Writes a mesh in every format. `tests/scripts/make_mesh_fixtures.py --check DIR` then reads the files with the
//! formats' reference libraries. Usage: `cargo run --example write_all -- tests/data/meshes/double.surf.gii DIR`.

use std::error::Error;
use std::path::PathBuf;

use spharm_surface::Signal;
use spharm_surface::io::{PlyAttributes, WriteOptions, read_mesh, write_mesh, write_painted, write_ply, write_signal};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [input, folder] = arguments.as_slice() else {
        return Err("usage: write_all SURFACE DIR".into());
    };
    let mesh = read_mesh(input)?;
    let single = WriteOptions { overwrite: true, double: false };
    let double = WriteOptions { double: true, ..single };
    for name in [
        "out.surf.gii",
        "out.surf.gii.gz",
        "lh.out",
        "out.obj",
        "out.off",
        "out.ply",
        "out.stl",
        "out.vtk",
        "out.vtp",
        "out.glb",
        "out.3mf",
    ] {
        write_mesh(folder.join(name), &mesh, &single)?;
    }
    for name in ["out_double.surf.gii", "out_double.ply"] {
        write_mesh(folder.join(name), &mesh, &double)?;
    }

    let n = mesh.vertices.len();
    let error: Vec<f64> = (0..n).map(|i| i as f64 / 8.0).collect();
    let colors: Vec<[u8; 3]> = (0..n).map(|i| [i as u8, 0, 7]).collect();
    let attributes = PlyAttributes { scalar: Some(("error", &error)), colors: Some(&colors) };
    write_ply(folder.join("attributes.ply"), &mesh, &attributes, &single)?;
    write_painted(folder.join("attributes.vtp"), &mesh, &attributes, &single)?;

    let values: Vec<f64> = (0..3 * n).map(|i| i as f64 / 7.0).collect();
    let first = values.iter().step_by(3).copied().collect();
    let signal = Signal::new(values, n, 3);
    write_signal(folder.join("out.func.gii"), &signal, &single)?;
    write_signal(folder.join("out.csv"), &signal, &single)?;
    write_signal(folder.join("lh.out.curv"), &Signal::new(first, n, 1), &single)?;
    Ok(())
}
