//! Bad input gives exit code 1 and one line that names the file and the remedy, without half-written files or panics.

use std::path::Path;
use std::process::Command;

use spharm_surface::Mesh;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{fail, shared, text, tool};
use crate::pipeline::{Study, names};

/// Checks that a command fails with a message that contains `expected`, and leaves the study's folder unchanged.
fn refuses(study: &Study, command: &mut Command, expected: &[&str]) {
    let before = names(&study.path(""));
    let error = fail(command);
    for word in expected {
        assert!(error.contains(word), "{word:?} is not in: {error}");
    }
    assert_eq!(names(&study.path("")), before, "nothing is left behind");
}

fn change(study: &Study, output: &str, edit: impl FnOnce(&mut Mesh)) {
    let mut mesh = read_mesh(study.path("s0.surf.gii")).unwrap();
    edit(&mut mesh);
    write_mesh(study.path(output), &mesh, &WriteOptions { overwrite: true, double: true }).unwrap();
}

#[test]
fn files_that_are_missing_empty_truncated_or_something_else() {
    let study = Study::new();
    let whole = std::fs::read(study.path("s0.surf.gii")).unwrap();
    std::fs::write(study.path("empty.surf.gii"), b"").unwrap();
    std::fs::write(study.path("half.surf.gii"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(study.path("noise.obj"), b"\x00\xff\xfe not a mesh").unwrap();
    std::fs::create_dir(study.path("folder.surf.gii")).unwrap();
    let fifo = study.path("fifo.surf.gii");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let output = study.path("out.npz");
    for name in ["missing.surf.gii", "empty.surf.gii", "half.surf.gii", "noise.obj", "folder.surf.gii", "fifo.surf.gii"]
    {
        let arguments = ["--max-degree", "6", "-o", output.to_str().unwrap()];
        refuses(&study, &mut study.fit(&[name], &arguments), &[name]);
        let mut build = tool("basis-build");
        build.arg("--sphere").arg(study.path(name)).arg("--store").arg(study.path("new")).args(["--max-degree", "2"]);
        refuses(&study, &mut build, &[name]);
        let mut compare = tool("compare");
        refuses(&study, compare.arg(study.path(name)).arg(study.path("s0.surf.gii")), &[name]);
        let mut reconstruct = tool("reconstruct");
        refuses(&study, reconstruct.arg("--model").arg(study.path(name)).arg("-o").arg(study.path("r.ply")), &[name]);
    }
}

#[test]
fn coordinates_that_are_not_numbers() {
    let study = Study::new();
    for (name, bad) in [("nan.csv", "nan"), ("inf.csv", "inf")] {
        let rows: String =
            (0..642).map(|i| if i == 5 { format!("1,{bad},2\n") } else { "1,2,3\n".to_owned() }).collect();
        std::fs::write(study.path(name), rows).unwrap();
        let output = study.path("out.npz");
        refuses(&study, &mut study.fit(&[name], &["--max-degree", "6", "-o", output.to_str().unwrap()]), &[name]);
    }
    let obj = "v 0 0 1\nv nan 0 0\nv 0 1 0\nf 1 2 3\n";
    std::fs::write(study.path("nan.obj"), obj).unwrap();
    let mut build = tool("basis-build");
    build.arg("--sphere").arg(study.path("nan.obj")).arg("--store").arg(study.path("new")).args(["--max-degree", "2"]);
    refuses(&study, &mut build, &["nan.obj"]);
}

/// `fit` only warns about a surface that isn't closed, since the least squares is still defined; `--strict` refuses it.
#[test]
fn surfaces_that_are_not_closed_spheres() {
    let study = Study::new();
    change(&study, "open.surf.gii", |mesh| mesh.faces.truncate(1200));
    std::fs::write(study.path("nofaces.csv"), "").unwrap();
    let output = study.path("open.npz");
    let arguments = ["--max-degree", "6", "--force", "-o", output.to_str().unwrap()];
    // The surface and the sphere must have the same triangles, so the sphere gets the same hole.
    let mut sphere = read_mesh(study.path("sphere.surf.gii")).unwrap();
    sphere.faces.truncate(1200);
    write_mesh(study.path("sphere.surf.gii"), &sphere, &WriteOptions { overwrite: true, double: true }).unwrap();
    let run = study.fit(&["open.surf.gii"], &arguments).output().unwrap();
    assert!(run.status.success(), "{}", text(&run));
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(said.contains("warning: ") && said.contains("edges belong to one triangle only"), "{said}");
    std::fs::remove_file(&output).unwrap();
    let strict = [&arguments[..], &["--strict"]].concat();
    refuses(&study, &mut study.fit(&["open.surf.gii"], &strict), &["open.surf.gii", "not a closed surface"]);
    for (name, words) in [("bad_cow.obj", "vertices, but the sphere"), ("bad_suzanne.obj", "vertices, but the sphere")]
    {
        let Some(path) = shared(name) else { continue };
        // Copy the file into the study's folder, so that `fit` gets a path in that folder.
        std::fs::copy(path, study.path(name)).unwrap();
        let mut command = study.fit(&[name], &arguments);
        refuses(&study, &mut command, &[name, words]);
    }
}

#[test]
fn spheres_that_do_not_fit_their_surface() {
    let study = Study::new();
    change(&study, "fewer.surf.gii", |mesh| {
        mesh.vertices.truncate(600);
        mesh.faces.retain(|face| face.iter().all(|&v| v < 600));
    });
    change(&study, "other.surf.gii", |mesh| mesh.faces.swap_remove(0).clone_into(&mut mesh.faces[0]));
    change(&study, "swapped.surf.gii", |mesh| {
        for face in &mut mesh.faces {
            face.iter_mut().for_each(|v| *v = (*v + 1) % 642);
        }
    });
    let output = study.path("out.npz");
    let arguments = ["--max-degree", "6", "-o", output.to_str().unwrap()];
    refuses(&study, &mut study.fit(&["fewer.surf.gii"], &arguments), &["600 vertices", "642"]);
    refuses(
        &study,
        &mut study.fit(&["swapped.surf.gii"], &arguments),
        &["swapped.surf.gii", "triangles differ between this surface and"],
    );
    refuses(&study, &mut study.fit(&["other.surf.gii"], &arguments), &["other.surf.gii", "differ"]);
}

#[test]
fn spheres_through_or_off_the_origin() {
    let study = Study::new();
    let sphere = read_mesh(study.path("sphere.surf.gii")).unwrap();
    let moved = |name: &str, by: [f64; 3]| {
        let vertices = sphere.vertices.iter().map(|v| [v[0] + by[0], v[1] + by[1], v[2] + by[2]]).collect();
        let path = study.path(name);
        write_mesh(&path, &sphere.with_vertices(vertices), &WriteOptions { overwrite: true, double: true }).unwrap();
        path
    };
    let build = |sphere: &Path| {
        let mut command = tool("basis-build");
        command.arg("--sphere").arg(sphere).arg("--store").arg(study.path("new")).args(["--max-degree", "2", "-q"]);
        command
    };
    let first = sphere.vertices[0].map(|c| -c);
    let through = moved("through.surf.gii", first);
    refuses(&study, &mut build(&through), &["through.surf.gii", "vertex 0 lies at the origin", "centre"]);
    let off = moved("off.surf.gii", [3.0, 0.0, 0.0]);
    refuses(&study, &mut build(&off), &["off.surf.gii", "origin lies outside"]);
    let near = moved("near.surf.gii", [0.1, 0.0, 0.0]);
    let run = build(&near).output().unwrap();
    assert!(run.status.success() && String::from_utf8_lossy(&run.stderr).contains("warning: "), "{}", text(&run));
    assert!(String::from_utf8_lossy(&run.stderr).contains("the radii range from"), "{}", text(&run));
}

#[test]
fn directions_from_angles_are_checked() {
    let study = Study::new();
    let build = |name: &str, rows: &str| {
        std::fs::write(study.path(name), rows).unwrap();
        let mut command = tool("basis-build");
        command.arg("--sphere").arg(study.path(name)).arg("--store").arg(study.path(&format!("{name}-store")));
        command.args(["--max-degree", "2", "-q"]);
        command
    };
    let degrees = build("degrees.csv", "theta,phi\n90,180\n").output().unwrap();
    assert_eq!(degrees.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&degrees.stderr).contains("theta must be from 0 to pi"), "{}", text(&degrees));
    let three = build("three.csv", "1,2,3\n").output().unwrap();
    assert!(String::from_utf8_lossy(&three.stderr).contains("expected two columns"), "{}", text(&three));
    let twice = build("twice.csv", "0.1,0.2\n1,2\n0.1,0.2\n1.5,3\n").output().unwrap();
    assert!(twice.status.success(), "{}", text(&twice));
    assert!(String::from_utf8_lossy(&twice.stderr).contains("1 direction is equal to an earlier"), "{}", text(&twice));
}

#[test]
fn stores_that_do_not_have_what_is_asked_for() {
    let study = Study::new();
    let output = study.path("out.npz");
    let above = ["--max-degree", "20", "-o", output.to_str().unwrap()];
    refuses(
        &study,
        &mut study.fit(&["s0.surf.gii"], &above),
        &["degrees 0 to 12", "spharm basis-build", "--max-degree 20"],
    );
    let arguments = ["--max-degree", "6", "-o", output.to_str().unwrap()];
    // Use a different sphere: the directions of another surface's vertices as seen from the origin.
    let mut command = tool("fit");
    command.arg("--sphere").arg(study.path("s1.surf.gii")).arg("--store").arg(study.path("store"));
    command.arg("--surface").arg(study.path("s1.surf.gii")).args(arguments).arg("-q");
    let key = names(&study.path("store"))[0][..12].to_owned();
    refuses(&study, &mut command, &["no basis for scheme", &key, "spharm basis-build"]);
    let mut command = study.fit(&["s0.surf.gii"], &arguments);
    command.arg("--store").arg(study.path("nowhere"));
    let run = command.output().unwrap();
    assert_eq!(run.status.code(), Some(2), "--store twice is a usage error");
    let mut command = tool("fit");
    command.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--store").arg(study.path("nowhere"));
    command.arg("--surface").arg(study.path("s0.surf.gii")).args(arguments).arg("-q");
    refuses(&study, &mut command, &["nowhere", "cannot open the store"]);
}

#[test]
fn usage_errors_exit_with_two_and_name_the_flag() {
    let study = Study::new();
    for arguments in [
        &["--max-degree", "6", "--granularity", "0"][..],
        &["--max-degree", "6", "--passes", "0"],
        &["--max-degree", "6", "--threads", "0"],
        &["--max-degree", "6", "--memory", "lots"],
        &["--max-degree", "6", "--method", "nlsf", "--granularity", "5"],
        &["--max-degree", "6", "--method", "sirf", "--passes", "2"],
        &["--max-degree", "6", "--start-degree", "2"],
        &["--max-degree", "6", "--method", "nlsf", "--accelerate"],
        &["--max-degree", "6", "--method", "lsq", "--accelerate"],
        &["--max-degree", "-1"],
        &[],
    ] {
        let run = study.fit(&["s0.surf.gii"], arguments).output().unwrap();
        assert_eq!(run.status.code(), Some(2), "{arguments:?} {}", text(&run));
        assert!(!String::from_utf8_lossy(&run.stderr).contains("panicked"));
    }
    let error =
        fail(&mut study.fit(&["s0.surf.gii"], &["--max-degree", "6", "--method", "sirf", "--start-degree", "9"]));
    assert!(error.contains("exceeds the highest degree of the fit, 6"), "{error}");
}

#[test]
fn a_build_that_is_too_large_says_what_it_takes_and_what_is_free() {
    let study = Study::new();
    let sphere = study.path("large.surf.gii");
    let run = tool("generate").args(["--subdivisions", "7", "--sphere"]).arg(&sphere).status().unwrap();
    assert!(run.success());
    let mut command = tool("basis-build");
    command.arg("--sphere").arg(&sphere).arg("--store").arg(study.path("large")).args(["--max-degree", "300", "-q"]);
    refuses(&study, &mut command, &["118.", "free", "--yes"]);
    let mut command = study.build(12);
    let error = fail(command.args(["--memory", "1MiB"]));
    assert!(error.contains("is too small; at least"), "{error}");
}

#[test]
fn damaged_models_are_refused() {
    let study = Study::new();
    study.report(&["s0.surf.gii"], "m.npz", &["--max-degree", "6"]);
    let whole = std::fs::read(study.path("m.npz")).unwrap();
    std::fs::write(study.path("half.npz"), &whole[..whole.len() / 2]).unwrap();
    for name in ["half.npz", "s0.surf.gii"] {
        let mut command = tool("reconstruct");
        command.arg("--model").arg(study.path(name)).arg("-o").arg(study.path("r.ply"));
        refuses(&study, &mut command, &[name, "not a SPHARM model"]);
    }
}
