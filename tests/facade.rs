//! The library's functions give the same bits as the program.

use spharm::parametrize::{CaldParams, parametrize};
use spharm::{FitParams, Method, Model, Sphere, fit, fit_mesh};
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::read_sphere;

use crate::common::{succeed, tool};
use crate::pipeline::Study;

fn threads() -> Option<usize> {
    Some(2)
}

#[test]
fn a_bare_mesh_has_the_bits_of_the_program() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (surface, _) = cortex(&Cortex { subdivisions: 4, variant: 1 });
    write_mesh(path("bare.ply"), &surface, &WriteOptions { double: true, ..WriteOptions::default() }).expect("a mesh");
    let mut program = tool("fit");
    program.arg("--surface").arg(path("bare.ply")).args(["--max-degree", "15", "--threads", "2", "-q", "-o"]);
    succeed(program.arg(path("bare.npz")));
    let expected = Model::read(path("bare.npz")).expect("a model");

    let surface = read_mesh(path("bare.ply")).expect("the mesh");
    let params = FitParams::lsq(15).with_threads(threads());
    let fitted = fit_mesh(&surface, &params).expect("a fit");
    let sphere = parametrize(&surface, &CaldParams::for_degree(15)).expect("a map").sphere;
    let found = fit(&sphere, &surface, &params).expect("a fit");
    assert_eq!(fitted.fit.coefficients, found.coefficients);
    assert_eq!(found.coefficients, expected.coefficients);
    assert!(found.report.smoothness == 0.0 && found.report.off_vertex.is_some_and(|off| off > 0.0));
    let distance = found.report.surface_distance.expect("a surface was fitted");
    assert!(0.0 < distance.rms && distance.rms < distance.percentile95 && distance.percentile95 < distance.hausdorff);
    // The models differ only in the records of files, which the library doesn't have.
    let mut model = Model::from(fitted);
    model.provenance.input.clone_from(&expected.provenance.input);
    model.provenance.sphere.clone_from(&expected.provenance.sphere);
    model.write(path("library.npz")).expect("it is written");
    let bytes = |name: &str| std::fs::read(path(name)).expect("a model");
    assert!(bytes("library.npz") == bytes("bare.npz"), "the files are the same, byte for byte");
}

#[test]
fn a_surface_on_its_sphere_has_the_bits_of_the_program() {
    let study = Study::new();
    let program = |store: bool, output: &str| {
        let mut program = tool("fit");
        program.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--surface").arg(study.path("s0.surf.gii"));
        program.args(["--max-degree", "12", "--threads", "2", "-q", "-o"]).arg(study.path(output));
        if store {
            program.arg("--store").arg(study.path("store")).args(["--passes", "3", "--granularity", "30"]);
        }
        succeed(&mut program);
        Model::read(study.path(output)).expect("a model").coefficients
    };
    let sphere: Sphere = read_sphere(study.path("sphere.surf.gii")).expect("a sphere");
    let surface = read_mesh(study.path("s0.surf.gii")).expect("a surface");
    let lsq = FitParams::lsq(12).with_threads(threads());
    assert_eq!(fit(&sphere, &surface, &lsq).expect("a fit").coefficients, program(false, "lsq.npz"));
    let irf =
        lsq.with_method(Method::Irf { passes: 3, granularity: 30, accelerate: false }).with_store(study.path("store"));
    assert_eq!(fit(&sphere, &surface, &irf).expect("a fit").coefficients, program(true, "irf.npz"));
}
