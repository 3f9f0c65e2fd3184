//! A fit preserves the metadata of files, and detects files that don't belong together.

use std::path::Path;

use spharm_model::Model;
use spharm_surface::io::{WriteOptions, read_mesh, read_signal, write_mesh, write_signal};
use spharm_surface::{CoordinateSystem, Mesh, Signal, VolumeGeometry};

use crate::common::{fail, finish, succeed, text, tool};
use crate::pipeline::Study;

/// Writes the study's first surface under another name, modified.
fn write(study: &Study, name: &str, edit: impl FnOnce(&mut Mesh)) {
    let mut mesh = read_mesh(study.path("s0.surf.gii")).unwrap();
    edit(&mut mesh);
    write_mesh(study.path(name), &mesh, &WriteOptions { overwrite: true, double: true }).unwrap();
}

fn reconstruct(study: &Study, output: &str) -> Mesh {
    let mut command = tool("reconstruct");
    command.arg("--model").arg(study.path("m.npz")).args(["--force", "-o"]).arg(study.path(output));
    succeed(&mut command);
    read_mesh(study.path(output)).unwrap()
}

fn fit(study: &Study, input: &str) {
    let output = study.path("m.npz");
    succeed(&mut study.fit(&[input], &["--max-degree", "6", "--force", "-o", output.to_str().unwrap()]));
}

/// A reconstruction keeps the volume geometry of its input; without it, tools that add `c_ras` would show the
/// reconstruction away from the input.
#[test]
fn a_reconstruction_lies_in_the_volume_of_its_input() {
    let study = Study::new();
    let geometry = VolumeGeometry {
        filename: None,
        size: [256; 3],
        voxel_size: [1.0; 3],
        axes_and_centre: [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [5.0, -17.5, 18.2]],
    };
    write(&study, "lh.pial", |mesh| mesh.meta.freesurfer_footer = Some(geometry.to_footer()));
    fit(&study, "lh.pial");
    for output in ["lh.pial.smooth", "smooth.surf.gii"] {
        assert_eq!(VolumeGeometry::of(&reconstruct(&study, output).meta), Some(geometry.clone()), "{output}");
    }
    let system = CoordinateSystem {
        data_space: "NIFTI_XFORM_SCANNER_ANAT".to_owned(),
        transformed_space: "NIFTI_XFORM_MNI_152".to_owned(),
        matrix: std::array::from_fn(|k| k as f64),
    };
    write(&study, "placed.surf.gii", |mesh| mesh.meta.coordinate_system = Some(system.clone()));
    fit(&study, "placed.surf.gii");
    assert_eq!(reconstruct(&study, "again.surf.gii").meta.coordinate_system, Some(system));
    // 3D Slicer takes files that don't state their axes as LPS.
    let axes = |mesh: Mesh| mesh.meta.file_metadata.into_iter().find(|(name, _)| name == "SPACE").map(|(_, axes)| axes);
    assert_eq!(axes(reconstruct(&study, "again.vtk")).as_deref(), Some("RAS"));
    write(&study, "slicer.ply", |mesh| mesh.meta.file_metadata.push(("SPACE".to_owned(), "LPS".to_owned())));
    fit(&study, "slicer.ply");
    assert_eq!(axes(reconstruct(&study, "slicer.vtk")).as_deref(), Some("LPS"));
}

/// Runs a fit that gives the expected warning, and that `--strict` refuses.
fn warned_of(study: &Study, sphere: &Path, input: &str, expected: &str) {
    let command = |more: &[&str]| {
        let mut command = tool("fit");
        command.arg("--sphere").arg(sphere).arg("--surface").arg(study.path(input));
        command.args(["--max-degree", "6", "-q", "--force", "-o"]).arg(study.path("w.npz")).args(more);
        command
    };
    let run = command(&[]).output().unwrap();
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success() && said.contains("warning: ") && said.contains(expected), "{}", text(&run));
    std::fs::remove_file(study.path("w.npz")).unwrap();
    let error = fail(&mut command(&["--strict"]));
    assert!(error.contains(expected), "{error}");
    assert!(!study.path("w.npz").exists());
}

#[test]
fn spheres_off_the_origin_and_of_the_other_hemisphere_are_refused_when_strict() {
    let study = Study::new();
    let sphere = read_mesh(study.path("sphere.surf.gii")).unwrap();
    let moved = sphere.vertices.iter().map(|&[x, y, z]| [x + 0.3, y, z]).collect();
    let options = WriteOptions { overwrite: true, double: true };
    write_mesh(study.path("off.surf.gii"), &sphere.with_vertices(moved), &options).unwrap();
    warned_of(&study, &study.path("off.surf.gii"), "s0.surf.gii", "46.2 % apart");

    let mut right = sphere;
    right.meta.anatomical_structure_primary = Some("CortexRight".to_owned());
    write_mesh(study.path("right.surf.gii"), &right, &options).unwrap();
    write(&study, "left.surf.gii", |mesh| mesh.meta.anatomical_structure_primary = Some("CortexLeft".to_owned()));
    warned_of(
        &study,
        &study.path("right.surf.gii"),
        "left.surf.gii",
        "belongs to the left hemisphere, but the sphere belongs to the right",
    );

    let mirrored = right.vertices.iter().map(|&[x, y, z]| [-x, y, z]).collect();
    write_mesh(study.path("mirrored.surf.gii"), &right.with_vertices(mirrored), &options).unwrap();
    warned_of(
        &study,
        &study.path("mirrored.surf.gii"),
        "s0.surf.gii",
        "mirrored.surf.gii reverses the orientation of the surface; is this the sphere of the other hemisphere?",
    );
}

#[test]
fn freesurfer_maps_and_gzipped_surfaces_are_fitted() {
    let study = Study::new();
    let mesh = read_mesh(study.path("s0.surf.gii")).unwrap();
    write_mesh(study.path("lh.pial.gz"), &mesh, &WriteOptions::default()).unwrap();
    fit(&study, "lh.pial.gz");
    let thickness = Signal::new(mesh.vertices.iter().map(|v| v[0].abs()).collect(), mesh.vertices.len(), 1);
    write_signal(study.path("lh.thickness.mgz"), &thickness, &WriteOptions::default()).unwrap();
    fit(&study, "lh.thickness.mgz");
    let output = study.path("smooth.mgz");
    succeed(tool("reconstruct").arg("--model").arg(study.path("m.npz")).arg("-o").arg(&output));
    assert_eq!(read_signal(&output).unwrap().vertices, thickness.vertices);
}

#[test]
fn values_are_read_from_tables_with_missing_values_and_from_numpy_arrays() {
    let study = Study::new();
    let vertices = read_mesh(study.path("s0.surf.gii")).unwrap().vertices.len();
    let fit = |name: &str, more: &[&str]| {
        let mut command = tool("fit");
        command.arg("--sphere").arg(study.path("sphere.surf.gii")).arg(study.path(name)).args(more);
        let output = finish(command.args(["-L", "4", "--force", "-o"]).arg(study.path("v.npz")));
        assert!(output.status.success(), "{}", text(&output));
        (Model::read(study.path("v.npz")).unwrap().coefficients, text(&output))
    };
    let mut values: Vec<f64> = (0..vertices).map(|vertex| 2.5 + 0.001 * vertex as f64).collect();
    values[1] = f64::NAN;
    let rows = values.iter().enumerate();
    let rows: Vec<String> = rows.map(|(vertex, x)| format!("{vertex},{x:?}\n").replace("NaN", "NA")).collect();
    std::fs::write(study.path("v.csv"), format!("vno,thickness\n{}", rows.concat())).unwrap();
    ndarray_npy::write_npy(study.path("v.npy"), &ndarray::Array1::from(values.clone())).unwrap();
    let (of_table, said) = fit("v.csv", &[]);
    assert!(said.contains("\"vno\" was left out") && !said.contains("exactly 0"), "{said}");
    assert_eq!(of_table, fit("v.npy", &[]).0);
    std::fs::write(study.path("w.csv"), "2.5\n2.75\n").unwrap();
    let error = fail(tool("fit").arg(study.path("w.csv")).args(["-L", "4", "-o"]).arg(study.path("w.npz")));
    assert!(error.contains("w.csv") && error.contains("--sphere"), "{error}");
    // Zeros that may stand for missing values are a warning, unless a mask leaves them out.
    values[..20].fill(0.0);
    ndarray_npy::write_npy(study.path("v.npy"), &ndarray::Array1::from(values.clone())).unwrap();
    let expected = format!("20 of {vertices} values of channel 1 are exactly 0");
    assert!(fit("v.npy", &[]).1.contains(&expected));
    let kept: Vec<u8> = values.iter().map(|value| u8::from(*value != 0.0)).collect();
    ndarray_npy::write_npy(study.path("mask.npy"), &ndarray::Array1::from(kept)).unwrap();
    let mask = study.path("mask.npy");
    assert!(!fit("v.npy", &["--mask", mask.to_str().unwrap()]).1.contains("exactly 0"));
}

/// The distance of a signal at held-out vertices is in the signal's unit, as its rms is.
#[test]
fn the_table_states_the_unit_of_distances_at_held_out_vertices() {
    let study = Study::new();
    let vertices = read_mesh(study.path("s0.surf.gii")).unwrap().vertices;
    let values = Signal::new(vertices.iter().map(|v| v[0].abs()).collect(), vertices.len(), 1);
    write_signal(study.path("v.csv"), &values, &WriteOptions::default()).unwrap();
    let fit = |more: &[&str]| {
        let mut command = tool("fit");
        command.arg("--sphere").arg(study.path("sphere.surf.gii")).arg(study.path("v.csv"));
        command.args(["-L", "4", "--hold-out", "0.1", "--force", "-o"]).arg(study.path("h.npz"));
        succeed(command.args(more))
    };
    let report: serde_json::Value = serde_json::from_str(&fit(&["--json"])).unwrap();
    let square = report["surfaces"][0]["held_out"]["held_out"]["msd_raw"].as_f64().unwrap();
    let table = fit(&[]);
    let shown = spharm_monitor::number(square.sqrt());
    assert!(table.contains("rms held out") && table.split_whitespace().any(|cell| cell == shown), "{table}: {shown}");
    assert!(table.contains("rms held out: at the held-out vertices, in the input's unit"), "{table}");
}

#[test]
fn what_is_no_surface_is_named_for_what_it_is() {
    let study = Study::new();
    std::fs::write(study.path("cells.tif"), b"II*\0and more").unwrap();
    let error = fail(&mut study.fit(&["cells.tif"], &["--max-degree", "6"]));
    assert!(error.contains("a volume (TIFF)") && error.contains("--label N"), "{error}");
    std::fs::create_dir(study.path("subjects")).unwrap();
    let error = fail(&mut study.fit(&["subjects"], &["--max-degree", "6"]));
    assert!(error.contains("subjects: the folder has no meshes"), "{error}");
    let mut command = tool("reconstruct");
    fit(&study, "s0.surf.gii");
    let error = fail(command.arg("--model").arg(study.path("m.npz")).arg("-o").arg(study.path("a.usd")));
    assert!(error.contains("a.usd") && error.contains(".surf.gii"), "{error}");
    let mut command = tool("generate");
    let error = fail(command.args(["--subdivisions", "2", "--surface"]).arg(study.path("a.stl")));
    assert!(error.contains("order of the vertices"), "{error}");
}

#[test]
fn a_folder_stands_for_its_meshes() {
    let study = Study::new();
    // The name doesn't say that this is a sphere.
    std::fs::rename(study.path("sphere.surf.gii"), study.path("ico.surf.gii")).unwrap();
    std::fs::write(study.path("cells.nii.gz"), "").unwrap();
    let mut command = tool("fit");
    command.arg(study.path(".")).arg(study.path("s0.surf.gii")).arg("--sphere").arg(study.path("ico.surf.gii"));
    command.args(["--max-degree", "4", "--keep-going"]).arg("-o").arg(study.path("models"));
    let output = finish(&mut command);
    assert!(output.status.success() && text(&output).contains("fitting 4 of 6 files"), "{}", text(&output));
    assert!(text(&output).contains("` fits the 1 volume in it"), "{}", text(&output));
    assert!(!study.path("models/ico.spharm.npz").exists());
    for name in ["s0", "s1", "s2", "s3"] {
        assert!(study.path(&format!("models/{name}.spharm.npz")).exists(), "{name}");
    }
}
