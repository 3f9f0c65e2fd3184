//! `fit` and `parametrize` on surfaces that come without a sphere.

use serde_json::Value;
use spharm_parametrize::Quality;
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{fail, succeed, tool};

#[test]
fn a_bare_mesh_is_mapped_fitted_and_its_sphere_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let (surface, _) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    let input = folder.path().join("bare.ply");
    write_mesh(&input, &surface, &WriteOptions { double: true, ..WriteOptions::default() }).expect("a mesh");
    let out = folder.path().join("models");
    let fit = || {
        let mut command = tool("fit");
        command.arg("--surface").arg(&input).args(["--max-degree", "15", "--json", "-o"]).arg(&out);
        command
    };
    let report: Value = serde_json::from_str(&succeed(&mut fit())).expect("JSON");
    let sphere = read_mesh(out.join("bare.sphere.surf.gii")).expect("the sphere is kept");
    assert_eq!(sphere.faces, surface.faces);
    assert!(Quality::of(&surface, &sphere).is_bijective());
    let found = &report["surfaces"][0];
    assert_eq!(found["parametrization"][1]["quality"]["flipped"], 0);
    // The same sphere, given, is fitted to the same distances.
    let mut given = fit();
    given.arg("--sphere").arg(out.join("bare.sphere.surf.gii")).arg("--force");
    let given: Value = serde_json::from_str(&succeed(&mut given)).expect("JSON");
    let msd = |surface: &Value| surface["passes"][0]["msd"].as_f64().expect("an msd");
    assert!((msd(found) / msd(&given["surfaces"][0]) - 1.0).abs() < 1e-9);
    // Neither is replaced unasked, not even the sphere alone.
    std::fs::remove_file(out.join("bare.spharm.npz")).expect("the model is there");
    assert!(fail(&mut fit()).contains("bare.sphere.surf.gii"));
}

#[test]
fn a_mesh_with_a_hole_is_refused_with_what_is_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut surface, _) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    surface.faces.pop();
    let input = folder.path().join("open.obj");
    write_mesh(&input, &surface, &WriteOptions::default()).expect("a mesh");
    let mut fit = tool("fit");
    fit.arg("--surface").arg(&input).args(["--max-degree", "5", "-o"]).arg(folder.path().join("m.npz"));
    let line = fail(&mut fit);
    assert!(line.contains("3 edges") && line.contains("holes"), "{line}");
    assert!(!folder.path().join("m.sphere.surf.gii").exists());
}
