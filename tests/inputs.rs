//! A fit preserves the metadata of files, and detects files that don't belong together.

use std::path::Path;

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
