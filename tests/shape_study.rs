//! A study from bare meshes to a map of p values, through the program, and bad studies.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use spharm::shape::rmsd;
use spharm_model::Model;
use spharm_surface::io::{read_mesh, read_signal};

use crate::common::{fail, finish, succeed, tool};

fn run(folder: &Path, arguments: &[&str]) -> std::process::Command {
    let mut command = tool(arguments[0]);
    command.args(&arguments[1..]).arg("-q").current_dir(folder);
    command
}

fn report(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).expect("a report")).expect("JSON")
}

/// Returns the sorted paths of a folder's files whose names start with `start`.
fn files(folder: &Path, start: &str) -> Vec<String> {
    let mut names: Vec<PathBuf> =
        fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    names.sort();
    let named = |path: &&PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(start));
    names.iter().filter(named).map(|path| path.display().to_string()).collect()
}

#[test]
fn a_study_finds_the_bump_of_its_second_group() {
    let site = tempfile::tempdir().expect("a folder");
    let at = |name: &str| site.path().join(name);
    succeed(&mut run(site.path(), &["generate", "--study", "meshes", "--subjects", "12", "--bump", "1.5"]));
    assert_eq!(fs::read_to_string(at("meshes/study.csv")).expect("a table").lines().count(), 13);
    let meshes = files(&at("meshes"), "");
    let meshes = meshes.iter().map(String::as_str).filter(|name| name.ends_with(".ply"));
    let fit: Vec<&str> = ["fit", "--max-degree", "10", "-o", "models", "--surface"].into_iter().chain(meshes).collect();
    succeed(&mut run(site.path(), &fit));
    let align =
        ["shape", "align", "models", "--group", "-o", "aligned", "--mean", "mean.spharm.npz", "--report", "align.json"];
    succeed(&mut run(site.path(), &align));
    let aligned = report(&at("align.json"));
    let spread = |name: &str| aligned[name].as_f64().expect("a number");
    assert!(spread("spread_after") < 0.05 * spread("spread_before") && spread("spread_after") < 0.6, "{aligned}");

    succeed(&mut run(
        site.path(),
        &["shape", "pca", "aligned", "--quality", "-o", "g.shape-model.npz", "--report", "pca.json"],
    ));
    let modes = report(&at("pca.json"));
    assert_eq!(modes["modes"], 11);
    let list = |name: &str| -> Vec<f64> {
        modes[name].as_array().expect("a list").iter().map(|value| value.as_f64().expect("a number")).collect()
    };
    let (shares, cumulative) = (list("shares"), list("compactness"));
    assert!((shares[0] + shares[1] - cumulative[1]).abs() < 1e-12 && shares[1] < 0.9 * cumulative[1], "{modes}");
    // The spread divides by the number of members, and the variance by one less than this number.
    let variance = modes["total_variance"].as_f64().expect("a number");
    assert!((variance * 11.0 / 12.0 / spread("spread_after").powi(2) - 1.0).abs() < 1e-6);
    succeed(&mut run(site.path(), &["shape", "sample", "g.shape-model.npz", "-o", "middle.spharm.npz"]));
    succeed(&mut run(site.path(), &["shape", "mean", "aligned", "-o", "again.spharm.npz"]));
    let [mean, middle, again] = ["mean", "middle", "again"]
        .map(|name| Model::read(at(&format!("{name}.spharm.npz"))).expect("a model").coefficients);
    assert!(rmsd(&mean, &middle).expect("one degree") < 1e-9 && rmsd(&mean, &again).expect("one degree") < 1e-9);

    let (a, b) = (files(&at("aligned"), "a"), files(&at("aligned"), "b"));
    let groups = |a: &[String], b: &[String], more: &[&str]| -> Vec<String> {
        let all = ["shape", "test", "--a"].into_iter().map(str::to_owned).chain(a.iter().cloned());
        let all = all.chain(["--b".to_owned()]).chain(b.iter().cloned());
        all.chain(more.iter().map(|word| (*word).to_owned())).collect()
    };
    let test = groups(&a, &b, &["-o", "test", "--report", "test.json", "--icosphere", "4"]);
    succeed(&mut run(site.path(), &test.iter().map(String::as_str).collect::<Vec<_>>()));
    let found = report(&at("test.json"));
    // Of the C(12, 6) relabellings, 2 give the same |t|.
    assert_eq!((&found["relabellings"], &found["exact"]), (&Value::from(924), &Value::from(true)));
    assert!((found["smallest_p_possible"].as_f64().expect("a number") - 2.0 / 924.0).abs() < 1e-12);
    assert!(found["summary"]["p_fwe"]["least"].as_f64().expect("a number") < 0.01, "{}", found["summary"]);
    let map = |name: &str| read_signal(at(&format!("test/{name}.shape.gii"))).expect("a map").values;
    let (effect, p) = (map("effect"), map("p-fwe"));
    let mean = read_mesh(at("test/mean.surf.gii")).expect("a mesh");
    assert_eq!((mean.vertices.len(), effect.len(), p.len()), (2562, 2562, 2562));
    // The effect is a - b: it points inwards at the bump of group b, where it is largest and significant.
    let peak = (0..2562).max_by(|i, j| effect[*i].abs().total_cmp(&effect[*j].abs())).expect("vertices");
    assert!(effect[peak] < -0.4 && p[peak] < 0.05, "{} {}", effect[peak], p[peak]);

    // The study's own table, with the models named by their ids in a folder, gives the same results.
    let named = ["shape", "test", "--table", "meshes/study.csv", "--models", "aligned", "--effect", "group"];
    succeed(run(site.path(), &named).args(["--icosphere", "4", "-o", "named"]));
    let file = |folder: &str| fs::read(at(folder).join("test.csv")).expect("a table");
    assert!(file("named") == file("test"));
    // A warning is given for models that weren't aligned, and none for aligned models.
    for (folder, noticed) in [("models", true), ("aligned", false)] {
        let test = ["shape", "test", "--table", "meshes/study.csv", "--effect", "group", "--models", folder];
        let commands = [
            (vec!["shape", "mean", folder], "m.npz"),
            (vec!["shape", "pca", folder], "p.npz"),
            ([&test[..], &["--icosphere", "2"]].concat(), "t"),
        ];
        for (arguments, name) in commands {
            let output = finish(run(site.path(), &arguments).arg("-o").arg(format!("{folder}-{name}")));
            let told = String::from_utf8(output.stderr).expect("text");
            assert!(
                output.status.success() && told.contains("the surfaces are not aligned") == noticed,
                "{arguments:?}: {told}"
            );
        }
    }

    // Test a table with the levels in the other order, and positions as the signal.
    let rows: String =
        a.iter().map(|path| format!("{path},first\n")).chain(b.iter().map(|path| format!("{path},second\n"))).collect();
    fs::write(at("study.csv"), format!("model,group\n{rows}")).expect("a table");
    let table =
        ["shape", "test", "--table", "study.csv", "--effect", "group", "--levels", "second,first", "--icosphere", "4"];
    succeed(run(site.path(), &table).args(["-o", "turned"]));
    let turned = read_signal(at("turned/effect.shape.gii")).expect("a map").values;
    assert!(turned.iter().zip(&effect).all(|(turned, effect)| (turned + effect).abs() < 1e-5));
    succeed(run(site.path(), &table).args(["-o", "positions", "--signal", "position", "--report", "positions.json"]));
    assert_eq!(report(&at("positions.json"))["statistic"]["name"], "T2");

    let picture =
        ["picture", "test/mean.surf.gii", "--map", "test/effect.shape.gii", "test/p-fwe.shape.gii", "-o", "study.png"];
    succeed(&mut run(site.path(), &picture));
    let sides = ["--view", "left", "right", "top", "bottom", "--size", "100", "-o", "sides.png"];
    let drawn = succeed(
        tool("picture")
            .args(["test/mean.surf.gii", "--map", "test/effect.shape.gii"])
            .args(sides)
            .current_dir(site.path()),
    );
    assert!(drawn.contains("8 panels"), "{drawn}");
    let contour = ["picture", "test/mean.surf.gii", "--map", "test/effect.shape.gii", "--contour"];
    let line = [&contour[..], &["test/p-fwe.shape.gii", "--dpi", "300", "-o", "line.svg"]].concat();
    succeed(&mut run(site.path(), &line));
    let svg = std::fs::read_to_string(at("line.svg")).expect("a picture");
    let small = p.iter().filter(|p| **p <= 0.05).count();
    let beyond = format!("0.05; at most 0.05 at {small} of {} vertices", p.len());
    // A long text has several lines.
    let texts = |svg: &str| -> String {
        let lines: Vec<&str> = svg.split("</text>").filter_map(|part| Some(part.rsplit_once('>')?.1)).collect();
        lines.join(" ")
    };
    assert!(svg.contains("width=\"81.280mm\""), "{}", &svg[..300]);
    assert!(texts(&svg).contains(&format!("line: p-fwe = {beyond}")), "{}", texts(&svg));
    // A test's result in one command: the texts say what was subtracted from what, and which p values are shown.
    let shown = succeed(&mut run(site.path(), &["picture", "--test", "test", "--dpi", "300", "-o", "test.svg"]));
    assert!(shown.contains("4 panels"), "{shown}");
    let svg = std::fs::read_to_string(at("test.svg")).expect("a picture");
    for text in ["a - b, positive outward", "t of a - b", "-log10 family-wise p"] {
        assert!(svg.contains(&format!(">{text}</text>")), "{text}");
    }
    // The line's text says on which side of it p is small.
    assert!(texts(&svg).contains(&format!("line: family-wise p = {beyond}")), "{}", texts(&svg));
    succeed(&mut run(site.path(), &["picture", "--test", "positions", "--dpi", "300", "-o", "positions.svg"]));
    let svg = std::fs::read_to_string(at("positions.svg")).expect("a picture");
    assert!(
        svg.contains(">T2 of second - first</text>") && !svg.contains("outward"),
        "positions have no map of one effect"
    );
    let none = fail(&mut run(site.path(), &["picture", "--test", "meshes", "-o", "none.png"]));
    assert!(none.contains("meshes: expected a folder written by `spharm shape test`"), "{none}");
    let without = fail(&mut run(site.path(), &[&contour[..], &["test/effect.shape.gii", "-o", "x.png"]].concat()));
    assert!(without.contains("--contour-level is required for maps other than p values"), "{without}");
    let wrong = ["picture", "meshes/a01.ply", "--map", "test/test.csv", "-o", "other.png"];
    fail(&mut run(site.path(), &wrong));
    succeed(run(site.path(), &["shape", "morph"]).args([&a[0], &b[0]]).args([
        "--steps",
        "3",
        "-o",
        "path",
        "--animation",
        "m.gif",
    ]));
    assert_eq!(files(&at("path"), "step").len(), 3);
    let morph = ["shape", "morph", a[0].as_str(), b[0].as_str(), "--icosphere", "2", "-o", "path", "--steps"];
    // Frames step00 to step10 would lie among the frames step0 to step2.
    let refused = fail(&mut run(site.path(), &[&morph[..], &["11"]].concat()));
    assert!(refused.contains("step0.ply: this file from an earlier sequence"), "{refused}");
    succeed(&mut run(site.path(), &[&morph[..], &["2", "--force"]].concat()));
    assert_eq!(files(&at("path"), "step").len(), 2);
    assert_eq!(fs::read(at("m.gif")).expect("an animation")[..6], *b"GIF89a");
}

#[test]
fn a_model_returns_to_its_rotated_copy() {
    let site = tempfile::tempdir().expect("a folder");
    succeed(&mut run(site.path(), &["generate", "--study", "meshes", "--subjects", "2"]));
    succeed(&mut run(site.path(), &["fit", "--surface", "meshes/a01.ply", "--max-degree", "8", "-o", "a.spharm.npz"]));
    let turn = ["shape", "rotate", "a.spharm.npz", "--parameters", "30,60,-80", "--object", "0.5,0.5,0.5,0.5"];
    succeed(run(site.path(), &turn).args(["--translate", "4,-5,6", "-o", "turned.spharm.npz"]));
    let back = ["shape", "align", "turned.spharm.npz", "--to", "a.spharm.npz", "-o", "back.spharm.npz"];
    succeed(run(site.path(), &back).args(["--transforms", "transforms.json"]));
    let read = |name: &str| Model::read(site.path().join(name)).expect("a model");
    let (model, back) = (read("a.spharm.npz"), read("back.spharm.npz"));
    assert!(rmsd(&model.coefficients, &back.coefficients).expect("one degree") < 1e-9);
    // Vertices keep their positions on the surface, because the sphere rotates with the parameters.
    let degree = model.coefficients.max_degree();
    let mesh =
        |model: &Model| model.reconstruct(model.own_sphere().expect("a sphere"), degree).expect("a mesh").vertices;
    let off =
        mesh(&model).into_iter().zip(mesh(&back)).map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max));
    assert!(off.fold(0.0, f64::max) < 1e-8);
    let transforms = report(&site.path().join("transforms.json"));
    assert!(transforms[0]["rmsd_after"].as_f64().expect("a number") < 1e-9);
}

#[test]
fn studies_that_are_none_are_refused() {
    let site = tempfile::tempdir().expect("a folder");
    succeed(&mut run(site.path(), &["generate", "--study", "meshes", "--subjects", "4"]));
    let meshes = ["meshes/a01.ply", "meshes/a02.ply", "meshes/b01.ply", "meshes/b02.ply"];
    let fit: Vec<&str> = ["fit", "--max-degree", "4", "-o", "models", "--surface"].into_iter().chain(meshes).collect();
    succeed(&mut run(site.path(), &fit));
    let said = |arguments: &[&str]| String::from_utf8(finish(&mut run(site.path(), arguments)).stderr).expect("text");
    for (arguments, words) in [
        (
            &["shape", "align", "models/a01.spharm.npz", "models/b01.spharm.npz", "--group", "-o", "out"][..],
            "at least 3 models, found 2; to align one model to another, use `align MODEL --to OTHER`",
        ),
        (&["shape", "smooth", "models", "--fwhm", "-5", "-o", "out"], "-5 degrees"),
        (&["shape", "align", "nothing", "--group", "-o", "out"], "nothing"),
        (&["shape", "rotate", "models", "--object", "1,2", "-o", "out"], "3, 4 or 9 numbers"),
        (&["shape", "rotate", "models", "--object", "1,0,0,0,1,0,0,0,-1", "-o", "out"], "rotation"),
        (&["shape", "rotate", "models", "-o", "out"], "--parameters"),
        (&["shape", "test", "-o", "out"], "--a and --b"),
        (
            &["shape", "test", "--a", "models/a01.spharm.npz", "--b", "models/a01.spharm.npz", "-o", "out"],
            "both groups",
        ),
        (&["shape", "pca", "models/a01.spharm.npz", "models/b01.spharm.npz", "-o", "g.npz"], "at least 3"),
        (&["shape", "mean", "models/a01.spharm.npz", "-o", "m.npz"], "2 models"),
        (&["shape", "sample", "models/a01.spharm.npz", "-o", "s.npz"], "modes"),
        (&["shape", "test", "--table", "meshes/study.csv", "--effect", "group", "-o", "out"], "no column \"model\""),
        (
            &[
                "shape",
                "test",
                "--table",
                "meshes/study.csv",
                "--effect",
                "group",
                "--model-column",
                "surface",
                "-o",
                "out",
            ],
            "a01.ply",
        ),
    ] {
        let said = said(arguments);
        assert!(said.contains(words), "{arguments:?}: {said}");
        assert!(!site.path().join("out").exists(), "{arguments:?}");
    }
    // With two subjects against two there are 6 relabellings, so no p value can be significant.
    let models = ["a01", "a02", "b01", "b02"].map(|name| format!("models/{name}.spharm.npz"));
    let [a, b, c, d] = &models;
    let few = ["shape", "test", "--a", a, b, "--b", c, d, "-o", "few", "--icosphere", "1"];
    let output = finish(&mut run(site.path(), &few));
    let warned = String::from_utf8(output.stderr).expect("text");
    assert!(output.status.success() && warned.contains("more subjects are needed"), "{warned}");
}
