//! Errors of `fit` about its arguments: conflicting arguments, values that are too small, existing outputs.

use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{fail, finish, succeed, text, tool};
use crate::full_least_squares::{DEGREE, fit_alone, lsq, report_of};
use crate::pipeline::{Study, names};

#[test]
fn ways_that_need_triangles_refuse_a_list_of_directions() {
    let study = Study::new();
    let sphere = read_mesh(study.path("sphere.surf.gii")).unwrap();
    let rows = sphere
        .vertices
        .iter()
        .map(|v| format!("{:?},{:?}\n", v[2].acos(), v[1].atan2(v[0]).rem_euclid(std::f64::consts::TAU)));
    std::fs::write(study.path("sphere.csv"), rows.collect::<String>()).unwrap();
    let values: String = sphere.vertices.iter().map(|v| format!("{:?}\n", v[0] * v[1])).collect();
    std::fs::write(study.path("values.csv"), values).unwrap();
    let before = names(&study.path(""));
    for arguments in [&["--method", "quadrature"][..], &["--weights", "area"]] {
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(study.path("sphere.csv")).arg("--surface").arg(study.path("values.csv"));
        let error = fail(fit.args(["-q", "--max-degree", "6", "-o"]).arg(study.path("")).args(arguments));
        assert!(error.contains("sphere.csv") && error.contains("needs triangles"), "{error}");
        assert_eq!(names(&study.path("")), before);
    }
    let mut fit = tool("fit");
    fit.arg("--sphere").arg(study.path("sphere.csv")).arg("--surface").arg(study.path("values.csv"));
    fit.args(["--preconditioner", "density"]);
    let report = report_of(fit.args(["-q", "--json", "--max-degree", "6", "-o"]).arg(study.path("v.npz")));
    assert_eq!(report["batches"][0]["products"], "moments", "the density needs none: {report}");
    assert!(report["surfaces"][0]["passes"][0]["msd_raw"].as_f64().unwrap() < 1e-20, "x y is of degree 2: {report}");
}

#[test]
fn flags_that_do_not_go_together_are_usage_errors() {
    let study = Study::new();
    let before = names(&study.path(""));
    for (with_store, arguments, flag) in [
        (false, &["--granularity", "5"][..], "--granularity"),
        (true, &["--method", "lsq", "--granularity", "5"], "--granularity"),
        (false, &["--passes", "2"], "--passes"),
        (false, &["--method", "irf"], "--store"),
        (false, &["--method", "nlsf"], "--store"),
        (false, &["--verify"], "--verify"),
        (true, &["--smoothness", "1e-3"], "--smoothness"),
        (true, &["--denoise"], "--denoise"),
        (false, &["--denoise", "--method", "quadrature"], "--denoise"),
        (false, &["--denoise", "--smoothness", "1e-3"], "--denoise"),
        (false, &["--denoise", "--smoothness", "auto"], "--smoothness"),
        (true, &["--objective", "surface"], "--objective surface"),
        (
            true,
            &["--objective", "surface", "--method", "lsq"],
            "because the basis and the factor in a store are for vertices",
        ),
        (false, &["--objective", "surface", "--method", "quadrature"], "--objective surface"),
        (false, &["--objective", "points"], "surface or vertices"),
        (true, &["--method", "nlsf", "--stderr"], "--stderr"),
        (true, &["--preconditioner", "factor"], "--preconditioner"),
        (true, &["--tolerance", "1e-6"], "--tolerance"),
        (false, &["--method", "quadrature", "--max-iterations", "7"], "--max-iterations"),
        (false, &["--method", "quadrature", "--smoothness", "1"], "--smoothness"),
        (false, &["--method", "quadrature", "--hold-out", "0.1"], "--hold-out"),
        (false, &["--method", "quadrature", "--weights", "area"], "--weights"),
        (false, &["--smoothness=-1"], "--smoothness"),
        (false, &["--smoothness", "nan"], "--smoothness"),
        (false, &["--smoothness", "some"], "--smoothness"),
        (false, &["--hold-out", "0"], "--hold-out"),
        (false, &["--hold-out", "1"], "--hold-out"),
        (false, &["--tolerance", "0"], "--tolerance"),
        (false, &["--preconditioner", "magic"], "--preconditioner"),
    ] {
        let mut command = fit_alone(&study, &[&DEGREE[..], arguments].concat());
        if with_store {
            command.arg("--store").arg(study.path("store"));
        }
        let output = finish(&mut command);
        assert_eq!(output.status.code(), Some(2), "{arguments:?} {}", text(&output));
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(stderr.contains(flag) && !stderr.contains("panicked"), "{arguments:?} {stderr}");
    }
    assert_eq!(names(&study.path("")), before);
}

#[test]
fn too_little_memory_is_refused_with_the_figure_that_works() {
    for method in ["lsq", "quadrature"] {
        let study = Study::new();
        let with = |memory: &str| lsq(&study, &["--max-degree", "12", "--method", method, "--memory", memory]);
        let error = fail(&mut with("8MiB"));
        assert!(error.contains("a memory budget of 8MiB is too small") && error.matches("MiB").count() == 2, "{error}");
        let figure = error.split("at least ").nth(1).expect(&error);
        let figure = figure.split("MiB").next().expect("a number");
        let figure: usize = figure.parse().expect(&error);
        assert!(!study.path("m.npz").exists());
        fail(&mut with(&format!("{}MiB", figure - 1)));
        let output = finish(&mut with(&format!("{figure}MiB")));
        assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output));
    }
}

#[test]
fn outputs_are_not_replaced_unasked() {
    let study = Study::new();
    let arguments = ["--max-degree", "12", "--stderr", "--coefficients-csv"];
    let outputs = ["m.npz", "m.stderr.npy", "m.csv"];
    succeed(&mut lsq(&study, &arguments));
    let bytes = || outputs.map(|name| std::fs::read(study.path(name)).ok());
    let before = bytes();
    assert!(before.iter().all(Option::is_some));
    for keep in outputs {
        // Each of the existing outputs alone is enough for a refusal.
        for name in outputs.into_iter().filter(|name| *name != keep) {
            std::fs::rename(study.path(name), study.path(&format!("{name}.away"))).unwrap();
        }
        std::fs::write(study.path(keep), "mine").unwrap();
        let all = names(&study.path(""));
        let error = fail(&mut lsq(&study, &arguments));
        assert!(error.contains(keep) && error.contains("exists"), "{error}");
        assert_eq!(names(&study.path("")), all);
        assert_eq!(std::fs::read(study.path(keep)).unwrap(), b"mine");
        for name in outputs.into_iter().filter(|name| *name != keep) {
            std::fs::rename(study.path(&format!("{name}.away")), study.path(name)).unwrap();
        }
    }
    succeed(lsq(&study, &arguments).arg("--force"));
    assert_eq!(bytes()[1..], before[1..], "the same again");
    let other = fail(lsq(&study, &["--max-degree", "6", "--stderr"]).arg("--skip-existing"));
    assert!(other.contains("max-degree 12, not 6"), "{other}");
    let skipped = succeed(lsq(&study, &arguments).arg("--skip-existing"));
    assert!(skipped.contains("nothing to do"), "{skipped}");
    assert_eq!(bytes()[1..], before[1..]);
}

#[test]
fn a_dry_run_over_a_store_ends_as_the_run_would() {
    let study = Study::new();
    let mut sphere = read_mesh(study.path("sphere.surf.gii")).unwrap();
    sphere.vertices[0][0] += 1e-9;
    write_mesh(study.path("moved.surf.gii"), &sphere, &WriteOptions { overwrite: false, double: true }).unwrap();
    let [store, moved, none] =
        ["store", "moved.surf.gii", "none"].map(|name| study.path(name).to_str().expect("UTF-8").to_owned());
    for (arguments, expected) in [
        (&["--max-degree", "13", "--store", &store][..], "degree 13 is missing"),
        (&["--max-degree", "12", "--method", "nlsf", "--memory", "13MiB", "--store", &store], "too small; at least"),
        (&["--max-degree", "12", "--store", &none], "cannot open the store"),
        (&["--max-degree", "12", "--method", "lsq", "--store", &none], "cannot open the store"),
        (&["--max-degree", "12", "--store", &store, "--sphere", &moved], "has the same 642 directions within"),
    ] {
        let command = |more: &[&str]| {
            let mut command = tool("fit");
            if !arguments.contains(&"--sphere") {
                command.arg("--sphere").arg(study.path("sphere.surf.gii"));
            }
            command.arg(study.path("s0.surf.gii")).args(["-q", "-o"]).arg(study.path("m.npz"));
            command.args(arguments).args(more);
            command
        };
        for more in [&["--dry-run"][..], &[]] {
            let error = fail(&mut command(more));
            assert!(error.contains(expected), "{more:?}: {error}");
        }
    }
    let said = succeed(study.fit(&["s0.surf.gii"], &["--max-degree", "12", "--dry-run"]).arg("-o").arg(&none));
    assert!(said.contains("fitted over 1 sphere"), "{said}");
}

#[test]
fn the_environment_names_a_store_but_chooses_no_method() {
    let study = Study::new();
    let fit = |arguments: &[&str]| {
        let mut command = fit_alone(&study, &[&DEGREE[..], &["--json", "--force"], arguments].concat());
        report_of(command.env("SPHARM_STORE", study.path("store")))
    };
    let usual = fit(&[]);
    assert_eq!((&usual["method"], &usual["store"]), (&"lsq".into(), &serde_json::Value::Null), "{usual}");
    assert!(usual["surfaces"][0]["surface_distance"].is_object(), "a fit of the surface: {usual}");
    let named = fit(&["--method", "mirf"]);
    assert_eq!((&named["method"], named["store"].is_string()), (&"mirf".into(), true), "{named}");
    assert_eq!(named["surfaces"][0]["passes"].as_array().unwrap().len(), 4, "{named}");
}

#[test]
fn a_factor_is_named_only_if_it_is_used() {
    let study = Study::new();
    let mut build = tool("basis-build");
    build.arg("--sphere").arg(study.path("sphere.surf.gii")).arg("--store").arg(study.path("store"));
    succeed(build.args(["-q", "--factor-only", "--factor", "12"]));
    for (preconditioner, used) in [("none", false), ("factor", true)] {
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(study.path("sphere.surf.gii")).arg(study.path("s0.surf.gii")).args(DEGREE);
        fit.args(["--method", "lsq", "--preconditioner", preconditioner, "--force", "--store"])
            .arg(study.path("store"));
        let said = text(&finish(fit.arg("-o").arg(study.path("m.npz"))));
        assert_eq!(said.contains("using the Cholesky factor"), used, "{said}");
    }
}

#[test]
fn passes_that_end_early_are_named() {
    let study = Study::new();
    // On directions that are dense around a pole, different degrees are far from orthogonal.
    let mut sphere = read_mesh(study.path("sphere.surf.gii")).unwrap();
    for vertex in &mut sphere.vertices {
        let radius = vertex.iter().map(|x| x * x).sum::<f64>().sqrt();
        vertex[2] += 0.6 * radius;
        let length = vertex.iter().map(|x| x * x).sum::<f64>().sqrt();
        *vertex = vertex.map(|x| x / length);
    }
    let path = study.path("dense.ply");
    write_mesh(&path, &sphere, &WriteOptions { overwrite: false, double: true }).unwrap();
    let mut build = tool("basis-build");
    succeed(build.arg("--sphere").arg(&path).arg("--store").arg(study.path("dense")).args([
        "-q",
        "--max-degree",
        "12",
    ]));
    for (passes, warned) in [("1", false), ("2", true), ("6", false)] {
        let mut fit = tool("fit");
        fit.arg("--sphere")
            .arg(&path)
            .arg("--store")
            .arg(study.path("dense"))
            .arg(study.path("s0.surf.gii"))
            .args(DEGREE);
        fit.args(["-q", "--granularity", "1", "--passes", passes, "--force", "-o"]).arg(study.path("m.npz"));
        let output = finish(&mut fit);
        assert!(output.status.success(), "{}", text(&output));
        assert_eq!(text(&output).contains("still falling after"), warned, "{}", text(&output));
    }
}
