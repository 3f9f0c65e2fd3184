//! Tests the verbs of the program, and problems that first-time users found in them.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::common::{fail, finish, succeed, text, tool};

/// A folder with a small surface, its sphere and a model.
struct Site {
    folder: tempfile::TempDir,
}

impl Site {
    fn new() -> Self {
        let site = Self { folder: tempfile::tempdir().expect("a folder") };
        let mut generate = tool("generate");
        generate.args(["-q", "--subdivisions", "3", "--surface"]).arg(site.path("s.ply"));
        succeed(generate.arg("--sphere").arg(site.path("sphere.surf.gii")));
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn fit(&self, model: &str) {
        let mut fit = tool("fit");
        fit.arg("--sphere").arg(self.path("sphere.surf.gii")).arg("--surface").arg(self.path("s.ply"));
        succeed(fit.args(["--max-degree", "8", "-q", "-o"]).arg(self.path(model)));
    }

    fn reconstruct(&self, models: &[&str], arguments: &[&str], output: &str) -> Command {
        let mut command = tool("reconstruct");
        command.arg("--model").args(models.iter().map(|model| self.path(model)));
        command.args(arguments).arg("-o").arg(self.path(output));
        command
    }

    fn compare(&self, reconstruction: &str, arguments: &[&str]) -> Command {
        let mut command = tool("compare");
        command.arg(self.path("s.ply")).arg(self.path(reconstruction)).args(arguments);
        command
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn every_verb_has_help_with_examples_completions_and_a_manual_page() {
    let verbs = [
        "fit",
        "parametrize",
        "reconstruct",
        "compare",
        "picture",
        "report",
        "moments",
        "volumes",
        "export",
        "import",
        "status",
        "freesurfer",
        "study",
        "bids",
        "shape",
        "basis-build",
        "store",
        "generate",
    ];
    let script = succeed(tool("completions").arg("bash"));
    let folder = tempfile::tempdir().expect("a folder");
    let pages = folder.path().join("new/man");
    succeed(tool("man").arg(&pages));
    for verb in verbs {
        assert!(script.contains(verb), "{verb}");
        let page = std::fs::read_to_string(pages.join(format!("spharm-{verb}.1"))).expect("a page");
        assert!(page.starts_with(".ie"), "{page}");
        let (short, long) = (succeed(tool(verb).arg("-h")), succeed(tool(verb).arg("--help")));
        assert!(long.contains("Examples:") && long.contains(&format!("spharm {verb} ")), "{long}");
        assert!(short.lines().count() <= 60 && short.len() < long.len(), "{short}");
    }
}

#[test]
fn a_link_named_after_a_verb_is_that_verb() {
    let folder = tempfile::tempdir().expect("a folder");
    for verb in ["fit", "basis-build"] {
        let link = folder.path().join(verb);
        std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_spharm"), &link).expect("a link");
        assert_eq!(succeed(Command::new(link).arg("--help")), succeed(tool(verb).arg("--help")));
    }
}

#[test]
fn an_ending_of_another_format_is_refused_before_any_work() {
    let site = Site::new();
    let error = fail(&mut site.compare("missing.ply", &["-o", "error.jpg"]));
    assert!(error.contains("error.jpg") && error.contains(".ply"), "{error}");
    let error = fail(tool("picture").arg(site.path("missing.ply")).args(["-o", "pic.jpg"]));
    assert!(error.contains("pic.jpg") && error.contains(".png"), "{error}");
}

#[test]
fn a_size_is_said_and_refused_before_it_is_built() {
    let site = Site::new();
    site.fit("m.npz");
    let error = fail(&mut site.reconstruct(&["m.npz"], &["--icosphere", "12", "--memory", "4GiB"], "lod.ply"));
    assert!(error.contains("167772162 vertices") && error.contains("GiB") && error.contains("--memory"), "{error}");
    assert!(!site.path("lod.ply").exists());
    succeed(&mut site.reconstruct(&["m.npz"], &["--icosphere", "2", "--memory", "4GiB"], "lod.ply"));
}

#[test]
fn folders_are_made_alike_and_outputs_checked_first() {
    let site = Site::new();
    site.fit("m.npz");
    succeed(&mut site.reconstruct(&["m.npz"], &[], "new/folder/x.surf.gii"));
    assert!(site.path("new/folder/x.surf.gii").is_file());
    let json = |text: String| serde_json::from_str::<Value>(&text).expect("JSON");
    let made = json(succeed(&mut site.reconstruct(&["m.npz"], &["--json"], "y.ply")));
    assert_eq!((&made["tool"], made["outputs"].as_array().map(Vec::len)), (&"reconstruct".into(), Some(1)));
    assert!(made["outputs"][0]["vertices"].is_u64() && made["outputs"][0]["output"].as_str().is_some());
    let mut export = tool("export");
    export.arg(site.path("m.npz")).args(["--to", "csv", "--json", "-o"]).arg(site.path("m.csv"));
    let made = json(succeed(&mut export));
    assert_eq!((&made["format"], &made["outputs"][0]["warnings"]), (&"csv".into(), &Value::Array(Vec::new())));
    let report = site.path("reports/r.json");
    succeed(site.compare("new/folder/x.surf.gii", &["--report"]).arg(&report).arg("-o").arg(site.path("ply/e.ply")));
    let written: Value = serde_json::from_slice(&std::fs::read(report).expect("a report")).expect("JSON");
    assert!(written["msd"].as_f64().is_some_and(|msd| msd > 0.0));
    assert!(site.path("ply/e.ply").is_file());
    // A file in place of an output's folder, and a folder in place of an output file, are refused.
    for output in ["m.npz/x.ply", "new"] {
        let error = fail(&mut site.compare("missing.ply", &["-o", site.path(output).to_str().unwrap()]));
        assert!(error.contains(output.split('/').next().unwrap()) && !error.contains(".spharm."), "{error}");
    }
}

#[test]
fn many_models_are_reconstructed_in_one_call() {
    let site = Site::new();
    for model in ["models/a.spharm.npz", "models/b.spharm.npz"] {
        site.fit(model);
    }
    let expected = ["a.surf.gii", "b.surf.gii"];
    let models = ["models/a.spharm.npz", "models/b.spharm.npz"];
    succeed(&mut site.reconstruct(&models, &["--icosphere", "2"], "out"));
    assert_eq!(names(&site.path("out")), expected);
    succeed(&mut site.reconstruct(&["models"], &["--icosphere", "2"], "of-folder"));
    assert_eq!(names(&site.path("of-folder")), expected);
    std::fs::write(site.path("list.txt"), "models/a.spharm.npz\nmodels/b.spharm.npz\n").unwrap();
    let mut of_list = tool("reconstruct");
    of_list.arg("--model").arg(format!("@{}", site.path("list.txt").display())).arg("-o").arg(site.path("of-list"));
    succeed(of_list.args(["--format", "ply", "--icosphere", "2"]));
    assert_eq!(names(&site.path("of-list")), ["a.ply", "b.ply"]);
    let bytes = |name: &str| std::fs::read(site.path(name)).expect("a surface");
    assert_eq!(bytes("out/a.surf.gii"), bytes("of-folder/a.surf.gii"));
    // An existing output is refused before any output is written.
    std::fs::remove_file(site.path("out/a.surf.gii")).unwrap();
    let error = fail(&mut site.reconstruct(&models, &["--icosphere", "2"], "out"));
    assert!(error.contains("b.surf.gii") && error.contains("--force"), "{error}");
    assert_eq!(names(&site.path("out")), ["b.surf.gii"]);
}

#[test]
fn surfaces_of_different_triangles_are_compared_and_drawn_by_their_distance() {
    let site = Site::new();
    site.fit("m.npz");
    succeed(&mut site.reconstruct(&["m.npz"], &["--icosphere", "2"], "lod.ply"));
    let error = fail(&mut site.compare("lod.ply", &[]));
    assert!(error.contains("triangles") && error.contains("--surface-distance"), "{error}");
    succeed(&mut site.compare("lod.ply", &["--surface-distance"]));
    let mut picture = tool("picture");
    picture.arg(site.path("s.ply")).arg(site.path("lod.ply")).args(["--error", "--size", "64", "-o"]);
    let printed = succeed(picture.arg(site.path("pic.png")));
    assert!(printed.contains("3 panels"), "{printed}");
    let mut one = tool("picture");
    let printed = succeed(one.arg(site.path("s.ply")).args(["--size", "64", "-o"]).arg(site.path("one.png")));
    assert!(printed.contains("1 panel") && !printed.contains("panels"), "{printed}");
}

#[test]
fn a_mask_limits_what_is_compared() {
    let site = Site::new();
    site.fit("m.npz");
    succeed(&mut site.reconstruct(&["m.npz"], &[], "again.ply"));
    let vertices = 20;
    let rows: String = (0..vertices).map(|vertex| format!("{vertex} 0 0 0 0\n")).collect();
    std::fs::write(site.path("part.label"), format!("#!ascii label\n{vertices}\n{rows}")).unwrap();
    let mask = site.path("part.label");
    let arguments = ["--mask", mask.to_str().unwrap(), "--json"];
    let part: Value = serde_json::from_str(&succeed(&mut site.compare("again.ply", &arguments))).unwrap();
    let all: Value = serde_json::from_str(&succeed(&mut site.compare("again.ply", &["--json"]))).unwrap();
    assert_eq!(part["vertices"], vertices);
    assert!(part["scale"] == all["scale"] && part["worst_vertex"].as_u64().unwrap() < vertices);
    assert!(part["max_raw"].as_f64() <= all["max_raw"].as_f64() && part["msd"] != all["msd"]);
    succeed(&mut site.reconstruct(&["m.npz"], &["--icosphere", "2"], "lod.ply"));
    let error = fail(&mut site.compare("lod.ply", &["--surface-distance", arguments[0], arguments[1]]));
    assert!(error.contains("--mask") && error.contains("the same triangles"), "{error}");
}

#[test]
fn earlier_spellings_of_options_are_understood() {
    let site = Site::new();
    site.fit("m.npz");
    succeed(&mut site.reconstruct(&["m.npz"], &["--degree", "3"], "three.ply"));
    succeed(&mut site.reconstruct(&["m.npz"], &["--max-degree", "3"], "same.ply"));
    assert_eq!(std::fs::read(site.path("three.ply")).unwrap(), std::fs::read(site.path("same.ply")).unwrap());
    let build = |arguments: &[&str]| {
        let mut command = tool("basis-build");
        command.arg("--sphere").arg(site.path("sphere.surf.gii")).arg("--store").arg(site.path("store"));
        command.args(["--max-degree", "2", "-q"]).args(arguments);
        command
    };
    let json = |text: &str| serde_json::from_str::<Value>(text).expect("JSON")["max_degree"].as_u64();
    assert_eq!(json(&succeed(&mut build(&["--json"]))), Some(2));
    assert_eq!(json(&succeed(&mut build(&["--json", "-"]))), Some(2));
    let file = site.path("r.json");
    let table = succeed(build(&["--json"]).arg(&file));
    assert!(table.contains("max degree"), "{table}");
    assert_eq!(json(&std::fs::read_to_string(&file).expect("a report")), Some(2));
    let both = finish(build(&["--json"]).arg(&file).arg("--report").arg(&file));
    assert_eq!(both.status.code(), Some(2), "{}", text(&both));
}

#[test]
fn many_surfaces_are_parametrised_in_one_call() {
    let site = Site::new();
    for name in ["a.ply", "b.ply"] {
        std::fs::copy(site.path("s.ply"), site.path(name)).unwrap();
    }
    let parametrize = |arguments: &[&str], output: &str| {
        let mut command = tool("parametrize");
        command.arg("--surface").args(["a.ply", "b.ply"].map(|name| site.path(name))).args(arguments);
        command.arg("-q").arg("-o").arg(site.path(output));
        command
    };
    let json = succeed(&mut parametrize(&["--method", "conformal", "--json"], "spheres"));
    assert_eq!(serde_json::from_str::<Value>(&json).expect("JSON").as_array().map(Vec::len), Some(2));
    assert_eq!(names(&site.path("spheres")), ["a.sphere.surf.gii", "b.sphere.surf.gii"]);
    let error = fail(&mut parametrize(&[], "both.ply"));
    assert!(error.contains("both.ply") && error.contains("folder"), "{error}");
    // The resampled surface is written beside the sphere, to a name derived from the sphere's.
    let mut one = tool("parametrize");
    one.arg("--input").arg(site.path("a.ply")).args(["--method", "conformal", "--resample-to", "icosphere:2", "-q"]);
    succeed(one.arg("-o").arg(site.path("new/x.sphere.ply")));
    assert_eq!(names(&site.path("new")), ["x.ply", "x.sphere.ply"]);
    // The derived name must not be that of the input.
    let mut over = tool("parametrize");
    over.arg("--surface").arg(site.path("new/x.ply")).args(["--resample-to", "icosphere:2", "--force"]);
    let error = fail(over.arg("-o").arg(site.path("new/x.sphere.ply")));
    assert!(error.contains("x.ply") && error.contains("an input"), "{error}");
}
