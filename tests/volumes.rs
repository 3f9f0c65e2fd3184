//! Makes spheres from label volumes and meshes, and checks that `fit` accepts them.

use std::path::Path;

use serde_json::Value;
use spharm::Preparation;
use spharm_cli::surfaces::{Labels, surfaces};
use spharm_cohort::reader::SurfaceReader;
use spharm_model::Model;
use spharm_monitor::Silent;
use spharm_surface::generate::{icosphere, subdivide};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh, write_signal};
use spharm_surface::topology::Topology;
use spharm_surface::{Mesh, Signal};

use crate::common::{fail, finish, succeed, tool};

/// Writes a NIfTI-1 file of 16^3 voxels of 1 mm.
pub(crate) fn write_volume(path: &Path, label: impl Fn([f64; 3]) -> u8) {
    let mut bytes = vec![0; 352];
    bytes[..4].copy_from_slice(&348_i32.to_le_bytes());
    for (k, n) in [3_i16, 16, 16, 16, 1, 1, 1, 1].into_iter().enumerate() {
        bytes[40 + 2 * k..42 + 2 * k].copy_from_slice(&n.to_le_bytes());
    }
    bytes[70..72].copy_from_slice(&2_i16.to_le_bytes());
    bytes[72..74].copy_from_slice(&8_i16.to_le_bytes());
    for k in 0..4 {
        bytes[76 + 4 * k..80 + 4 * k].copy_from_slice(&1.0_f32.to_le_bytes());
    }
    bytes[108..112].copy_from_slice(&352.0_f32.to_le_bytes());
    // The sform is the identity.
    bytes[254] = 1;
    for k in 0..3 {
        bytes[280 + 20 * k..284 + 20 * k].copy_from_slice(&1.0_f32.to_le_bytes());
    }
    bytes[344..348].copy_from_slice(b"n+1\0");
    bytes.extend((0..16 * 16 * 16).map(|i| label([i % 16, i / 16 % 16, i / 256].map(|x| f64::from(x) - 7.5))));
    std::fs::write(path, bytes).unwrap();
}

fn ball([x, y, z]: [f64; 3]) -> bool {
    x * x + y * y + z * z < 30.0
}

/// Runs the tool with outputs beside the input; returns its report, the surface and the sphere.
fn run(input: &Path, arguments: &[&str]) -> (Value, Mesh, Mesh) {
    let beside = |name: &str| input.with_file_name(name);
    let [surface, sphere, report] = ["out.surf.gii", "out.sphere.surf.gii", "out.json"].map(beside);
    let mut command = tool("parametrize");
    command.arg("--input").arg(input).args(arguments).args(["--force", "-o"]).arg(&sphere);
    succeed(command.arg("--surface-output").arg(&surface).arg("--report").arg(&report));
    let report = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let (surface, sphere) = (read_mesh(surface).unwrap(), read_mesh(sphere).unwrap());
    assert!(Topology::of(&surface).is_sphere() && surface.faces == sphere.faces);
    (report, surface, sphere)
}

#[test]
fn a_volume_becomes_a_surface_and_its_sphere() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("label.nii");
    // The volume has a ball with a tunnel through it, and a second label beside the ball.
    write_volume(&path, |at| if at[2] < -7.0 { 9 } else { u8::from(ball(at) && !(at[0] == 0.5 && at[1] == 0.5)) });
    let refused = |arguments: &[&str]| {
        let sphere = folder.path().join("refused.obj");
        let error = fail(tool("parametrize").arg("--input").arg(&path).args(arguments).arg("-o").arg(&sphere));
        assert!(!sphere.exists());
        error
    };
    let named = folder.path().join("refused.ply");
    let named = ["--surface-output", named.to_str().unwrap()];
    let error = refused(&named);
    assert!(error.contains("--label") && error.contains("1 (") && error.contains("9 ("), "{error}");
    let error = refused(&[&["--label", "1"][..], &named].concat());
    assert!(error.contains("genus 1") && error.contains("--fix"), "{error}");
    let error = refused(&["--label", "9"]);
    assert!(error.contains("--surface-output"), "{error}");

    let (report, ..) = run(&path, &["--label", "1", "--fix"]);
    assert_eq!((report["method"].as_str(), report["quality"]["flipped"].as_u64()), (Some("equal-area"), Some(0)));
    let repair = &report["volume"]["repair"];
    assert!(repair["way"] == "filled" && repair["voxels_changed"].as_u64().unwrap() <= 3, "{repair}");
    // Map the surface of label 9 by a method for meshes.
    let (report, ..) = run(&path, &["--label", "9", "--method", "cald"]);
    assert_eq!((report["method"].as_str(), report["volume"]["label"].as_i64()), (Some("cald"), Some(9)));
}

/// Rows 14 and 21 of the problems of first-time users: one command makes models of all labels of a volume.
#[test]
fn each_label_of_a_volume_is_a_surface_to_fit() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // The volume has a ball, a plate below the ball, and a plate of two pieces above it.
    write_volume(&path("cells.nii"), |at| match at {
        _ if ball(at) => 1,
        [_, _, z] if z < -6.0 => 5,
        [x, _, z] if z > 6.0 && x.abs() > 1.0 => 7,
        _ => 0,
    });
    let fit = |arguments: &[&str]| {
        let mut fit = tool("fit");
        fit.arg("--surface").arg(path("cells.nii")).args(["--max-degree", "6", "-o"]).arg(path("out")).args(arguments);
        fit
    };
    let error = fail(&mut fit(&[]));
    assert!(error.contains("--label") && error.contains("5 (") && error.contains("7 ("), "{error}");
    let error = fail(&mut fit(&["--label", "7"]));
    assert!(error.contains("label 7") && error.contains("2 pieces") && error.contains("--fix"), "{error}");
    let error = fail(&mut fit(&["--label", "6"]));
    assert!(error.contains('6') && error.contains("1 ("), "{error}");
    let table = succeed(&mut fit(&["--label", "all", "--fix"]));
    for label in [1, 5, 7] {
        let name = format!("cells.{label}");
        assert!(table.lines().any(|line| line.starts_with(&name)), "{table}");
        let [surface, sphere] = ["surf.gii", "sphere.surf.gii"].map(|ending| path(&format!("out/{name}.{ending}")));
        let (surface, sphere) = (read_mesh(surface).unwrap(), read_mesh(sphere).unwrap());
        assert!(Topology::of(&surface).is_sphere() && surface.faces == sphere.faces);
        assert!(path(&format!("out/{name}.spharm.npz")).exists());
    }
    let repaired = Model::read(path("out/cells.7.spharm.npz")).unwrap().provenance.repair;
    assert!(repaired.is_some_and(|repair| repair["pieces_dropped"] == 1));
    let again = succeed(&mut fit(&["--label", "all", "--fix", "--skip-existing"]));
    assert!(again.contains("nothing to do"), "{again}");
    let output = finish(&mut fit(&["--label", "7", "--fix", "--force", "--json"]));
    let warned = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(warned.contains("cells.nii label 7: the volume was repaired: 1 piece dropped"), "{warned}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["surfaces"][0]["parametrization"]["repair"]["pieces_dropped"], 1);
    // The model of another label is refused.
    std::fs::copy(path("out/cells.1.spharm.npz"), path("out/cells.5.spharm.npz")).unwrap();
    let error = fail(&mut fit(&["--label", "5", "--skip-existing"]));
    assert!(error.contains("label 1, not from") && error.contains("label 5"), "{error}");
    succeed(fit(&["--label", "5"]).args(["--name-template", "{stem}_{label}"]));
    assert!(path("out/cells_5.spharm.npz").exists());
}

#[test]
fn a_volume_is_read_once_for_its_labels_and_their_surfaces() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cells.nii");
    write_volume(&path, |at| u8::from(ball(at)));
    let reader = SurfaceReader::new(Preparation::default());
    let paths = std::slice::from_ref(&path);
    let found = surfaces(&reader, paths, &[Labels::All], true, &Silent).unwrap();
    assert_eq!(found, [(path.clone(), Some(1))]);
    std::fs::remove_file(&path).unwrap();
    reader.read(&path, Some(1), &Silent).unwrap();
}

/// Row 15 of the problems of first-time users: values on a surface in a volume's file format are fitted on its sphere.
#[test]
fn a_map_over_a_surface_is_fitted_on_its_sphere() {
    let folder = tempfile::tempdir().unwrap();
    let [map, sphere] = ["lh.thickness.mgz", "sphere.ply"].map(|name| folder.path().join(name));
    let thickness = (0..642).map(|vertex| 2.5 + 0.01 * f64::from(vertex % 7)).collect();
    write_signal(&map, &Signal::new(thickness, 642, 1), &WriteOptions::default()).unwrap();
    write_mesh(&sphere, &icosphere(3), &WriteOptions::default()).unwrap();
    let fit = || {
        let mut fit = tool("fit");
        fit.arg("--surface").arg(&map).args(["--max-degree", "4", "-o"]).arg(folder.path());
        fit
    };
    let error = fail(&mut fit());
    assert!(error.contains("642 vertices") && error.contains("--sphere"), "{error}");
    succeed(fit().arg("--sphere").arg(&sphere));
}

#[test]
fn a_mesh_is_put_on_a_shared_sampling() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.obj");
    let mesh = subdivide(&icosphere(2));
    let long = mesh.with_vertices(mesh.vertices.iter().map(|&[x, y, z]| [x, 2.0 * y, 3.0 * z]).collect());
    write_mesh(&path, &long, &WriteOptions::default()).unwrap();
    for arguments in [["--resample-to", "icosphere:3"], ["--method", "deform"]] {
        let (report, surface, sphere) = run(&path, &arguments);
        let shared = icosphere(3);
        assert!(sphere.vertices == shared.vertices && sphere.faces == shared.faces, "{arguments:?}");
        let hausdorff = report["distance"]["hausdorff"].as_f64().unwrap();
        assert!(surface.vertices.len() == 642 && hausdorff > 0.0 && hausdorff < 0.2, "{arguments:?}: {hausdorff}");
    }
    let fit = fail(
        tool("fit").arg("--surface").arg(&path).args(["--max-degree", "4", "--label", "3", "-o"]).arg(folder.path()),
    );
    assert!(fit.contains("for volumes"), "{fit}");
    // Test a sphere file as the sampling, and conflicting arguments.
    let shared = folder.path().join("shared.ply");
    write_mesh(&shared, &icosphere(2), &WriteOptions::default()).unwrap();
    assert_eq!(run(&path, &["--resample-to", shared.to_str().unwrap()]).1.vertices.len(), 162);
    for (arguments, words) in [
        (&["--method", "equal-area"][..], "for volumes"),
        (&["--resample-to", "icosphere:2"], "--surface-output"),
        (&["--method", "deform", "--resample-to", "icosphere:2"], "omit --resample-to"),
        (&["--label", "3"], "for volumes"),
    ] {
        let sphere = folder.path().join("refused.obj");
        let error = fail(tool("parametrize").arg("--input").arg(&path).args(arguments).arg("-o").arg(&sphere));
        assert!(error.contains(words) && !sphere.exists(), "{arguments:?}: {error}");
    }
}

#[test]
fn a_speck_at_the_border_that_the_repair_drops_is_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.nii");
    write_volume(&path, |at| u8::from(ball(at) || at == [-7.5; 3]));
    let run = |arguments: &[&str], out: &str| {
        let out = folder.path().join(out);
        let mut command = tool("volumes");
        command.arg(&path).args(["--max-degree", "3", "--skip-border", "-q"]).args(arguments).arg("-o").arg(&out);
        succeed(&mut command);
        (std::fs::read_to_string(out.join("volumes.tsv")).unwrap(), out.join("cell.1.spharm.npz"))
    };
    let (table, model) = run(&["--fix"], "fixed");
    assert!(table.contains("fitted"), "{table}");
    assert_eq!(Model::read(model).unwrap().provenance.voxels.map(|voxels| voxels.at_border), Some(false));
    let (table, model) = run(&[], "as-it-is");
    assert!(table.contains("at the border of the volume") && !model.exists(), "{table}");
}
