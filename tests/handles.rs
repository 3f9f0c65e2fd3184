//! Tests surfaces with handles through the program: the handles are cut, the surface is fitted, and the handles
//! restored.

use std::path::{Path, PathBuf};

use serde_json::Value;
use spharm::{Model, Silent};
use spharm_surface::generate::{Torus, double_torus, icosphere, torus};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::metrics::{SurfaceDistanceParams, surface_distance};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::topology::Topology;
use spharm_surface::{Mesh, Seam};

use crate::common::{fail, finish, succeed, tool};
use crate::volumes::write_volume;

fn written(folder: &Path, name: &str, surface: &Mesh) -> PathBuf {
    let path = folder.join(name);
    write_mesh(&path, surface, &WriteOptions { double: true, ..WriteOptions::default() }).expect("a mesh");
    path
}

/// Fits a surface with handles, reconstructs the original, and checks the guaranteed bounds. The guaranteed gap
/// between the sides of the seam is a thousandth of the bounding box; the test requires a fifth less.
fn there_and_back(name: &str, surface: &Mesh, genus: i64) {
    let folder = tempfile::tempdir().expect("a folder");
    let input = written(folder.path(), "in.ply", surface);
    let (model, out) = (folder.path().join("in.spharm.npz"), folder.path().join("out.ply"));
    let mut fit = tool("fit");
    fit.arg("--surface").arg(&input).args(["--cut-handles", "--max-degree", "60", "--json", "-o"]).arg(&model);
    let report: Value = serde_json::from_str(&succeed(&mut fit)).expect("JSON");
    let cut = &report["surfaces"][0]["parametrization"]["handles"];
    assert_eq!((cut["genus_before"].as_i64(), cut["genus_after"].as_i64()), (Some(genus), Some(0)));
    assert_eq!(cut["loops"].as_array().expect("loops").len() as i64, genus);
    let back = succeed(tool("reconstruct").arg("--model").arg(&model).args(["--double", "-o"]).arg(&out));
    assert!(back.contains(&format!("{} vertices", surface.vertices.len())), "{back}");

    let found = read_mesh(&out).expect("a mesh");
    assert_eq!(found.faces, surface.faces, "the triangles, in their order");
    assert_eq!(Topology::of(&found).genus(), Some(genus));
    let distance = surface_distance(surface, &found, &SurfaceDistanceParams::default(), &Silent).expect("a distance");
    let read = Model::read(&model).expect("a model");
    let gap = read.reconstruct_original(60).expect("a surface").gap / distance.scale;
    let (rms, hausdorff) = (distance.rms / distance.scale, distance.hausdorff / distance.scale);
    // Compute the largest distance of the welded seam from the surface.
    let tree = TriangleTree::new(surface);
    let seam = read.sphere.as_ref().and_then(|sphere| sphere.seam.clone()).expect("the model keeps the seam");
    let off = seam.copies.iter().filter_map(|&v| tree.nearest(found.vertices[v as usize]));
    let off = off.map(|nearest| nearest.distance / distance.scale).fold(0.0, f64::max);
    assert!(off < 5e-4, "{name}: {off:e}");
    // Before welding, the two sides of the seam are also apart along the surface.
    assert!(gap > 0.0 && gap < 8e-4, "{name}: {gap:e}");
    eprintln!(
        "{name}: seam off {off:.2e}, n {}, rms {rms:.2e}, Hausdorff {hausdorff:.2e}, gap {gap:.2e} of the box",
        surface.vertices.len()
    );
    assert!(rms < 2e-3, "{name}: {rms:e}");
    // Vertices correspond to the vertices of the original, also on the seam.
    let largest = surface
        .vertices
        .iter()
        .zip(&found.vertices)
        .map(|(a, b)| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt() / distance.scale);
    let largest = largest.fold(0.0, f64::max);
    assert!(largest < 1e-2, "{largest:e}");
    let recorded = read.provenance.handles.expect("the model says what was cut");
    assert_eq!(Value::from(recorded)["loops"], cut["loops"]);
}

#[test]
fn a_torus_comes_back_with_its_handle() {
    there_and_back("torus", &torus(&Torus { around: 48, ..Torus::default() }), 1);
}

#[test]
fn a_torus_with_bumps_comes_back_with_its_handle() {
    there_and_back("torus with bumps", &torus(&Torus { around: 48, bumps: 0.15, ..Torus::default() }), 1);
}

#[test]
fn a_double_torus_comes_back_with_both_handles() {
    there_and_back("double torus", &double_torus(100), 2);
}

/// Runs three verbs with files between them; the sphere's file keeps the seams.
#[test]
fn a_cut_surface_and_its_sphere_are_files_that_a_fit_takes() {
    let folder = tempfile::tempdir().expect("a folder");
    let surface = torus(&Torus { around: 16, ..Torus::default() });
    let input = written(folder.path(), "torus.ply", &surface);
    let sphere = folder.path().join("cut.sphere.surf.gii");
    let parametrize = |sphere: &Path| {
        let mut command = tool("parametrize");
        command.arg("--surface").arg(&input).args(["--cut-handles", "--force", "-o"]).arg(sphere);
        command
    };
    let told = succeed(&mut parametrize(&sphere));
    assert!(told.contains("genus reduced from 1 to 0") && told.contains("handle"), "{told}");
    let (cut, mapped) = (folder.path().join("cut.surf.gii"), read_mesh(&sphere).expect("a sphere"));
    let seam = Seam::of(&mapped.meta).expect("the sphere says where the surface was cut");
    assert_eq!((seam.vertices, seam.faces), (surface.vertices.len(), surface.faces.len()));
    assert!(Topology::of(&read_mesh(&cut).expect("the cut surface")).is_sphere());
    let mut fit = tool("fit");
    fit.arg("--surface").arg(&cut).arg("--sphere").arg(&sphere).args(["--max-degree", "12", "-o"]).arg(folder.path());
    succeed(&mut fit);
    let model = folder.path().join("cut.spharm.npz");
    let genus = |options: &[&std::ffi::OsStr]| {
        let out = folder.path().join("out.ply");
        let mut command = tool("reconstruct");
        command.arg("--model").arg(&model).args(options).arg("--force").arg("-o").arg(&out);
        succeed(&mut command);
        Topology::of(&read_mesh(&out).expect("a mesh")).genus()
    };
    assert_eq!(genus(&["--original".as_ref()]), Some(1));
    assert_eq!(genus(&["--sphere".as_ref(), sphere.as_ref()]), Some(0), "as it was cut");
    assert_eq!(genus(&["--icosphere".as_ref(), "4".as_ref()]), Some(0));
    // Other formats lose the seams; a warning says so.
    let output = finish(&mut parametrize(&folder.path().join("cut.sphere.ply")));
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("doesn't store the seams"));
}

#[test]
fn handles_are_refused_unless_asked_for_and_spheres_are_left_as_they_are() {
    let folder = tempfile::tempdir().expect("a folder");
    let handle = written(folder.path(), "torus.ply", &torus(&Torus { around: 16, ..Torus::default() }));
    let ball = written(folder.path(), "ball.ply", &icosphere(3));
    let fit = |input: &Path, options: &[&str]| {
        let mut command = tool("fit");
        command.arg("--surface").arg(input).args(["--max-degree", "6", "-o"]).arg(folder.path()).args(options);
        command
    };
    let refused = fail(&mut fit(&handle, &[]));
    assert!(refused.contains("genus 1") && refused.contains("length 6."), "{refused}");
    assert!(refused.contains("--cut-handles"), "{refused}");
    succeed(&mut fit(&handle, &["--cut-handles"]));
    assert!(folder.path().join("torus.cut.surf.gii").exists());
    // A second run has nothing to do; if only the model is missing, the existing sphere is reused.
    let again = succeed(&mut fit(&handle, &["--cut-handles", "--skip-existing"]));
    assert!(!again.contains("torus.spharm.npz"), "{again}");
    let model = folder.path().join("torus.spharm.npz");
    let first = Model::read(&model).expect("a model");
    std::fs::remove_file(&model).expect("the model is there");
    let told = finish(&mut fit(&handle, &["--cut-handles", "--skip-existing"]));
    assert!(String::from_utf8_lossy(&told.stderr).contains("reusing the sphere"));
    assert_eq!(Model::read(&model).expect("a model").sphere.map(|s| s.seam), first.sphere.map(|s| s.seam));

    succeed(&mut fit(&ball, &["--cut-handles"]));
    let plain = Model::read(folder.path().join("ball.spharm.npz")).expect("a model");
    assert_eq!(plain.sphere.and_then(|sphere| sphere.seam), None);
    assert!(plain.provenance.handles.is_none() && !folder.path().join("ball.cut.surf.gii").exists());

    for arguments in [
        &["reconstruct", "--model", "torus.spharm.npz", "--icosphere", "2", "-o", "out.ply"][..],
        &["compare", "torus.ply", "torus.spharm.npz", "--samples", "1000"],
        &["shape", "measure", "torus.spharm.npz"],
        &["shape", "remesh", "torus.spharm.npz", "--icosphere", "2", "-o", "remeshed.ply"],
        &["shape", "morph", "torus.spharm.npz", "ball.spharm.npz", "--steps", "2", "--icosphere", "2", "-o", "path"],
    ] {
        let output = finish(tool(arguments[0]).args(&arguments[1..]).current_dir(folder.path()));
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {told}");
        let warning = "torus.spharm.npz: handles were cut: the surface includes the caps that close the cuts";
        assert!(told.contains(warning), "{arguments:?}: {told}");
    }
}

/// A fit of a label with a handle restores the triangles of the label's surface, including the handle.
#[test]
fn a_label_with_a_handle_comes_back_with_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let [ring, ball] = ["ring.nii", "ball.nii"].map(|name| folder.path().join(name));
    write_volume(&ring, |[x, y, z]| u8::from((x.hypot(y) - 4.6).powi(2) + z * z < 5.0));
    write_volume(&ball, |[x, y, z]| u8::from(x * x + y * y + z * z < 30.0));
    let fit = |input: &Path, options: &[&str]| {
        let mut command = tool("fit");
        command.arg("--surface").arg(input).args(["--max-degree", "12", "-o"]).arg(folder.path()).args(options);
        command
    };
    let refused = fail(&mut fit(&ring, &[]));
    assert!(refused.contains("1 handle (genus 1)") && refused.contains("--cut-handles"), "{refused}");
    let told = finish(&mut fit(&ring, &["--cut-handles"]));
    assert!(
        told.status.success() && String::from_utf8_lossy(&told.stderr).contains("genus reduced from 1 to 0"),
        "{told:?}"
    );
    let named = |ending: &str| folder.path().join(format!("ring.1{ending}"));
    let files = || std::fs::read_dir(folder.path()).expect("a folder").count();
    // Read the label's surface before and after the cut.
    let [whole, cut] = [".surf.gii", ".cut.surf.gii"].map(|ending| read_mesh(named(ending)).expect("a mesh"));
    assert_eq!((Topology::of(&whole).genus(), Topology::of(&cut).genus()), (Some(1), Some(0)));
    let out = folder.path().join("out.ply");
    succeed(tool("reconstruct").arg("--model").arg(named(".spharm.npz")).arg("-o").arg(&out));
    let back = read_mesh(&out).expect("a mesh");
    assert_eq!((Topology::of(&back).genus(), &back.faces), (Some(1), &whole.faces));
    let before = files();
    succeed(&mut fit(&ring, &["--cut-handles", "--skip-existing"]));
    assert_eq!(files(), before, "nothing is left to do");
    // A label without handles, or whose handles the repair opens, isn't cut.
    succeed(&mut fit(&ball, &["--cut-handles"]));
    assert!(folder.path().join("ball.1.surf.gii").exists() && !folder.path().join("ball.1.cut.surf.gii").exists());
    let told = finish(&mut fit(&ring, &["--cut-handles", "--fix", "--force"]));
    let told = String::from_utf8_lossy(&told.stderr).into_owned();
    assert!(told.contains("the repair removed 1 handle, so no handle was left to cut"), "{told}");
    let repaired = Model::read(named(".spharm.npz")).expect("a model").provenance;
    assert!(repaired.handles.is_none());
    assert_eq!(repaired.repair.and_then(|repair| repair["handles"].as_u64()), Some(1));
    // The report of `parametrize` describes the label from which the cut surface was made.
    let sphere = folder.path().join("p.sphere.surf.gii");
    let mut parametrize = tool("parametrize");
    parametrize.arg("--surface").arg(&ring).args(["--cut-handles", "--json", "-o"]).arg(&sphere);
    let report: Value = serde_json::from_str(&succeed(&mut parametrize)).expect("JSON");
    assert!(report["volume"]["label"] == 1 && report["volume"]["voxels"].as_u64() > Some(100), "{report}");
    assert_eq!(report["handles"]["genus_before"], 1);
}

/// With --cut-handles, `volumes` fits a label with a handle like any other label.
#[test]
fn labels_with_handles_are_rows_like_others_where_they_are_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    write_volume(&folder.path().join("ring.nii"), |[x, y, z]| u8::from((x.hypot(y) - 4.6).powi(2) + z * z < 5.0));
    let run = |options: &[&str]| {
        let mut command = tool("volumes");
        command.current_dir(folder.path()).args(["ring.nii", "--max-degree", "8", "-o", "out"]).args(options);
        command
    };
    let refused = fail(&mut run(&[]));
    assert!(refused.contains("1 of 1 row failed"), "{refused}");
    let told = finish(&mut run(&["--cut-handles", "--skip-existing"]));
    let told = String::from_utf8_lossy(&told.stderr).into_owned();
    assert!(told.contains("genus reduced from 1 to 0"), "{told}");
    let model = folder.path().join("out/ring.1.spharm.npz");
    assert!(Model::read(&model).expect("a model").provenance.handles.is_some());
    let out = folder.path().join("out.ply");
    let told = finish(tool("reconstruct").arg("--model").arg(&model).arg("-o").arg(&out));
    assert_eq!(Topology::of(&read_mesh(&out).expect("a mesh")).genus(), Some(1));
    // At this low degree the sides of the seam are far apart, so a warning is given.
    let told = String::from_utf8_lossy(&told.stderr).into_owned();
    assert!(told.contains("warning: ") && told.contains("a higher degree"), "{told}");
    let table = || std::fs::read_to_string(folder.path().join("out/volumes.tsv")).expect("a table");
    assert!(table().contains("fitted"), "{}", table());
    succeed(&mut run(&["--cut-handles", "--skip-existing"]));
    assert!(table().contains("kept"), "{}", table());
}
