//! `fit` and `parametrize` on surfaces without a sphere.

use serde_json::Value;
use spharm_parametrize::Quality;
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex, icosphere};
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
    assert_eq!(found["parametrization"]["quality"]["flipped"], 0);
    // A fit over the written sphere, now given with --sphere, has the same distances.
    let mut given = fit();
    given.arg("--sphere").arg(out.join("bare.sphere.surf.gii")).arg("--force");
    let given: Value = serde_json::from_str(&succeed(&mut given)).expect("JSON");
    let msd = |surface: &Value| surface["passes"][0]["msd"].as_f64().expect("an msd");
    assert!((msd(found) / msd(&given["surfaces"][0]) - 1.0).abs() < 1e-9);
    // Neither the model nor the sphere is replaced without --force, even if only the sphere exists.
    std::fs::remove_file(out.join("bare.spharm.npz")).expect("the model is there");
    assert!(fail(&mut fit()).contains("bare.sphere.surf.gii"));
}

/// Returns a surface with a few large triangles and many small ones. For a model of high degree, the large triangles
/// are gaps between the vertices.
fn uneven() -> Mesh {
    let (mut mesh, _) = cortex(&Cortex { subdivisions: 4, variant: 2 });
    let flat = |p: &[f64; 3]| p[2] < 0.0;
    let coarse = icosphere(4);
    // Move all vertices below the equator towards the twelve corners of an icosahedron.
    let corners = icosphere(0).vertices;
    for (p, unit) in mesh.vertices.iter_mut().zip(&coarse.vertices).filter(|(p, _)| flat(p)) {
        let near = |c: &&[f64; 3]| c.iter().zip(unit).map(|(a, b)| a * b).sum::<f64>();
        let corner = corners.iter().max_by(|a, b| near(a).total_cmp(&near(b))).expect("twelve");
        let size = p.iter().map(|x| x * x).sum::<f64>().sqrt();
        *p = [0, 1, 2].map(|k| 0.3 * p[k] + 0.7 * size * corner[k]);
    }
    mesh
}

#[test]
fn a_model_of_a_bare_mesh_is_held_between_its_vertices() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = folder.path().join("uneven.ply");
    write_mesh(&input, &uneven(), &WriteOptions { double: true, ..WriteOptions::default() }).expect("a mesh");
    let with = |options: &[&str]| -> (f64, f64) {
        let mut fit = tool("fit");
        fit.arg("--surface").arg(&input).args(["--max-degree", "24", "--json", "--force"]).args(options).arg("-o");
        fit.arg(folder.path().join("m.npz"));
        let report: Value = serde_json::from_str(&succeed(&mut fit)).expect("JSON");
        let found = &report["surfaces"][0];
        let msd = |distances: &Value| distances["msd_raw"].as_f64().expect("a number");
        (msd(&found["passes"][0]), msd(&found["between"]))
    };
    let (at, between) = with(&["--objective", "vertices", "--smoothness", "0"]);
    let (held_at, held_between) = with(&["--objective", "vertices"]);
    assert!(held_at < 1.5 * at, "{held_at:e} {at:e}");
    assert!(held_between < 0.1 * between, "{held_between:e} {between:e}");
    // A fit of the surface is about as close between the vertices as at the vertices.
    let (surface_at, surface_between) = with(&[]);
    assert!(surface_between < 0.5 * held_between && surface_between < 2.0 * surface_at, "{surface_between:e}");
}

#[test]
fn a_wild_model_is_warned_of_and_a_smooth_one_on_large_triangles_is_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = WriteOptions { double: true, ..WriteOptions::default() };
    let told = |surface: &Mesh, degree: &str, sphere: Option<&Mesh>| -> String {
        let input = folder.path().join("surface.ply");
        write_mesh(&input, surface, &WriteOptions { overwrite: true, ..options }).expect("a mesh");
        let mut fit = tool("fit");
        fit.arg("--surface").arg(&input).args([
            "--max-degree",
            degree,
            "--objective",
            "vertices",
            "--smoothness",
            "0",
            "--force",
            "-o",
        ]);
        fit.arg(folder.path().join("m.npz"));
        if let Some(sphere) = sphere {
            let path = folder.path().join("sphere.ply");
            write_mesh(&path, sphere, &options).expect("a sphere");
            fit.arg("--sphere").arg(path);
        }
        let output = fit.output().expect("fit runs");
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(told(&uneven(), "24", None).contains("times the error at the vertices"));
    // A model that is exact at the vertices bulges over the flat triangles between them; that is correct and gives no
    // warning.
    let sphere = icosphere(2);
    let long = sphere.with_vertices(sphere.vertices.iter().map(|&[x, y, z]| [x, y, 2.0 * z]).collect());
    assert!(!told(&long, "3", Some(&sphere)).contains("times the error at the vertices"));
}

#[test]
fn a_mesh_that_winds_inwards_is_a_warning() {
    let folder = tempfile::tempdir().expect("a folder");
    let (outward, _) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    let mut inward = outward.clone();
    inward.faces.iter_mut().for_each(|face| face.swap(0, 1));
    let (input, model) = (folder.path().join("a.ply"), folder.path().join("m.npz"));
    let cases: [(&Mesh, &[&str], bool); 3] =
        [(&outward, &[], false), (&inward, &[], true), (&inward, &["--fix"], false)];
    for (surface, arguments, warned) in cases {
        write_mesh(&input, surface, &WriteOptions { overwrite: true, ..WriteOptions::default() }).expect("a mesh");
        let mut fit = tool("fit");
        fit.arg("--surface").arg(&input).args(["--max-degree", "5", "--force", "-o"]).arg(&model).args(arguments);
        let output = fit.output().expect("fit runs");
        assert!(output.status.success());
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(told.contains("a.ply: the triangles wind inwards"), warned, "{arguments:?}: {told}");
    }
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
