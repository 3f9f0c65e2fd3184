//! Brings groups into correspondence through the program, and compares places with the known truth of generated groups;
//! checks the outputs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use spharm_model::Model;
use spharm_surface::Similarity;
use spharm_surface::io::landmarks::Landmarks;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::nearest::TriangleTree;

use crate::common::{error_line, fail, finish, succeed, text, tool, wait};

/// Boxes with a growing bump, about 30 x 20 x 10, in random poses, each with its landmarks.
pub(crate) struct Site(tempfile::TempDir);

impl Site {
    pub(crate) fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        let group = ["--group", "growing-bump", "--members", "5", "--subdivisions", "4", "--output-dir", "in", "-q"];
        succeed(tool("generate").args(group).current_dir(site.0.path()));
        site
    }

    /// Creates the site, with all boxes except the third brought into correspondence.
    pub(crate) fn with_group() -> Self {
        let site = Self::new();
        succeed(&mut site.correspond("group", &["--report", "group.json", "--landmarks", "in"]));
        site
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn shape(&self, arguments: &[&str]) -> Command {
        let mut command = tool("shape");
        command.args(arguments).args(["-q"]).current_dir(self.0.path());
        command
    }

    pub(crate) fn correspond(&self, output: &str, more: &[&str]) -> Command {
        let mut command = self.shape(&["correspond", "in/s01.ply", "in/s02.ply", "in/s04.ply", "in/s05.ply"]);
        command.args(["--max-degree", "8", "--subdivisions", "4", "-o", output]).args(more);
        command
    }

    pub(crate) fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&fs::read(self.path(name)).expect("a file")).expect("JSON")
    }

    /// Returns the paths and contents of all files in a folder.
    fn contents(&self, folder: &str) -> Vec<(PathBuf, Vec<u8>)> {
        fn add(folder: &Path, files: &mut Vec<(PathBuf, Vec<u8>)>) {
            for entry in fs::read_dir(folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    add(&path, files)
                } else {
                    files.push((path.clone(), fs::read(path).expect("a file")))
                }
            }
        }
        let mut files = Vec::new();
        add(&self.path(folder), &mut files);
        files.sort();
        files
    }

    /// Returns the mean distance between carried landmarks and the true ones.
    fn apart(&self, carried: &str, truth: &str) -> f64 {
        let [carried, truth] = [carried, truth].map(|name| Landmarks::read(self.path(name)).expect("landmarks"));
        assert_eq!(carried.names, truth.names);
        let distance = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        carried.points.iter().zip(&truth.points).map(distance).sum::<f64>() / carried.points.len() as f64
    }
}

#[test]
fn places_are_carried_to_where_the_truth_has_them() {
    let site = Site::with_group();
    let report = site.json("group.json");
    let marks = &report["landmarks"];
    assert!(marks["mean"].as_f64().expect("a number") < 0.5, "{marks}");
    assert_eq!(marks["carried"], 4 * 3 * marks["names"].as_array().expect("names").len());
    assert_eq!(report["members"].as_array().map(Vec::len), Some(4));
    assert!(report["quality"]["generalisation"][0].as_f64().expect("a number") < 0.3, "{report}");
    // Landmarks are carried to one member in Slicer's format, and to all members as tables.
    succeed(&mut site.shape(&["carry", "group", "in/s01.json", "--from", "s01", "--to", "s05", "-o", "s05.mrk.json"]));
    assert!(site.apart("s05.mrk.json", "in/s05.json") < 0.8);
    let all =
        ["carry", "group", "in/s01.json", "--from", "s01", "--to", "all", "--format", "csv", "-o", "carried", "--json"];
    let found: Value = serde_json::from_str(&succeed(&mut site.shape(&all))).expect("JSON");
    assert_eq!(found["carried"][0]["landmarks"][0]["reached"], true);
    for name in ["s02", "s04", "s05"] {
        assert!(site.apart(&format!("carried/{name}.csv"), &format!("in/{name}.json")) < 0.8, "{name}");
    }
    assert!(fail(&mut site.shape(&all)).contains("exists"));
    let error = fail(&mut site.shape(&["carry", "group", "in/s01.json", "--from", "s09", "--to", "all", "-o", "x"]));
    assert!(error.contains("s09") && error.contains("s01"), "{error}");
    // The folder of the group stands for its members; its mean takes part only if it is named.
    let names = |models: &[&str]| -> Vec<String> {
        succeed(&mut site.shape(&[&["describe"][..], models, &["-o", "table.csv", "--force"]].concat()));
        let table = fs::read_to_string(site.path("table.csv")).expect("a table");
        table.lines().skip(1).filter_map(|line| line.split(',').next().map(str::to_owned)).collect()
    };
    let (members, with_mean) = (names(&["group"]), names(&["group", "group/mean.spharm.npz"]));
    assert_eq!((members.len(), with_mean.len()), (4, 5), "{members:?} {with_mean:?}");
    // Points far from the surface are reported.
    fs::write(site.path("off.csv"), "name,x,y,z\na,500,0,0\n").expect("a file");
    let output = finish(
        tool("shape")
            .args(["carry", "group", "off.csv", "--from", "s01", "--to", "s02", "-o", "o.csv"])
            .current_dir(site.0.path()),
    );
    assert!(output.status.success() && text(&output).contains("far from the surface: a"), "{}", text(&output));
}

#[test]
fn groups_are_the_same_bits_and_replaced_only_when_asked() {
    let site = Site::with_group();
    let before = site.contents("group");
    assert!(fail(&mut site.correspond("group", &[])).contains("exists"));
    assert_eq!(site.contents("group"), before);
    succeed(&mut site.correspond("other", &["--threads", "1"]));
    for (path, bytes) in before.iter().filter(|(path, _)| path.file_name().is_some_and(|name| name != "group.json")) {
        let other = site.path("other").join(path.strip_prefix(site.path("group")).expect("in the folder"));
        assert!(fs::read(&other).expect("a file") == *bytes, "{}", path.display());
    }
    succeed(&mut site.correspond("group", &["--force"]));
    // A foreign file at an output's path is kept, and no other output is written.
    fs::create_dir_all(site.path("mine/places")).expect("a folder");
    fs::write(site.path("mine/places/s02.npz"), "mine").expect("a file");
    assert!(fail(&mut site.correspond("mine", &[])).contains("places/s02.npz"));
    assert_eq!(site.contents("mine"), [(site.path("mine/places/s02.npz"), b"mine".to_vec())]);
}

#[test]
fn a_new_member_has_the_groups_sphere_and_changes_nothing() {
    let site = Site::with_group();
    let before = site.contents("group");
    let add = ["correspond", "in/s03.ply", "in/s01.ply", "--to", "group", "-o", "added"];
    succeed(site.shape(&add).args(["--shard", "0/2"]));
    assert!(site.path("added/s03.spharm.npz").exists() && !site.path("added/s01.spharm.npz").exists());
    let first = fs::read(site.path("added/s03.spharm.npz")).expect("a model");
    let found: Value = serde_json::from_str(&succeed(site.shape(&add).args(["--json"]))).expect("JSON");
    assert_eq!((&found["there_already"], found["members"].as_array().map(Vec::len)), (&1.into(), Some(1)), "{found}");
    assert_eq!(found["warnings"][0], "s01: the surface is identical to s01", "{found}");
    assert_eq!(fs::read(site.path("added/s03.spharm.npz")).expect("a model"), first);
    assert_eq!(site.contents("group"), before);
    let read = |name: &str| Model::read(site.path(name)).expect("a model");
    let (new, mean, old) = (read("added/s03.spharm.npz"), read("group/mean.spharm.npz"), read("group/s01.spharm.npz"));
    let sphere = |model: &Model| model.sphere.clone().map(|sphere| (sphere.directions, sphere.faces));
    assert!(sphere(&new).is_some() && sphere(&new) == sphere(&mean) && sphere(&new) == sphere(&old));
    // A folder of added members can be read like a group's folder.
    succeed(&mut site.shape(&["carry", "added", "in/s01.json", "--from", "s01", "--to", "s03", "-o", "c.csv"]));
    assert!(site.apart("c.csv", "in/s03.json") < 0.8);
    succeed(&mut site.shape(&[
        "quality",
        "group/s01.spharm.npz",
        "group/s02.spharm.npz",
        "added/s03.spharm.npz",
        "--icosphere",
        "2",
        "--bands",
        "0",
        "--no-surfaces",
    ]));
    // A surface of a member's name from another file is refused, and so is a model that wasn't written by `shape
    // correspond`.
    fs::create_dir(site.path("b")).expect("a folder");
    fs::copy(site.path("in/s02.ply"), site.path("b/s03.ply")).expect("a copy");
    let error = fail(&mut site.shape(&["correspond", "b/s03.ply", "--to", "group", "-o", "added"]));
    assert!(error.contains("another file"), "{error}");
    fs::write(site.path("added/s02.spharm.npz"), "mine").expect("a file");
    let error = fail(&mut site.shape(&["correspond", "in/s02.ply", "--to", "group", "-o", "added"]));
    assert!(error.contains("s02.spharm.npz") && error.contains("exists"), "{error}");
    assert_eq!(fs::read(site.path("added/s02.spharm.npz")).expect("a file"), b"mine");
    // A model without a member's record was left by an interrupted run, because the record is written last: it is made
    // again.
    fs::remove_file(site.path("added/members/s03.json")).expect("removed");
    succeed(&mut site.shape(&["correspond", "in/s03.ply", "--to", "group", "-o", "added"]));
    assert_eq!(fs::read(site.path("added/s03.spharm.npz")).expect("a model"), first);
    let output = finish(site.shape(&["correspond", "in/s03.ply", "--to", "group", "-o", "group"]).args(["--force"]));
    assert_eq!(output.status.code(), Some(2), "{}", text(&output));
}

#[test]
fn an_interrupted_group_leaves_nothing() {
    let site = Site::new();
    let mut command = site.correspond("group", &[]);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a run");
    let pid = Pid::from_child(&child);
    std::thread::sleep(Duration::from_millis(300));
    kill_process(pid, Signal::INT).expect("it runs");
    let output = wait(child);
    assert!(!output.status.success() && text(&output).contains("interrupted"), "{}", text(&output));
    assert!(!site.path("group").exists());
    succeed(&mut site.correspond("group", &["--no-refinement"]));
}

#[test]
fn an_interrupted_group_goes_on_where_it_was_ended() {
    let site = Site::new();
    let resume = ["--resume", "state"];
    let mut command = site.correspond("group", &resume);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a run");
    while !site.path("state/0-0.npz").exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    kill_process(Pid::from_child(&child), Signal::INT).expect("it runs");
    assert!(!wait(child).status.success() && !site.path("group").exists());
    // Registrations of another group, or in another folder, aren't used.
    let error = fail(&mut site.correspond("group", &["--resume", "state", "--rounds", "1"]));
    assert!(
        error.contains("state/key.json") && error.contains("registrations of other surfaces or with other settings"),
        "{error}"
    );
    let error = fail(&mut site.correspond("group", &["--resume", "in"]));
    assert!(error.contains("a folder with other files"), "{error}");
    // A truncated registration is made again.
    let kept = site.path("state/0-0.npz");
    let bytes = fs::read(&kept).expect("a registration");
    fs::write(&kept, &bytes[..bytes.len() / 2]).expect("written");
    succeed(&mut site.correspond("group", &resume));
    assert!(!site.path("state").exists());
    succeed(&mut site.correspond("whole", &[]));
    for name in ["mean.spharm.npz", "s01.spharm.npz", "places/s05.npz", "members/s02.json"] {
        let [resumed, whole] = ["group", "whole"].map(|folder| fs::read(site.path(folder).join(name)).expect("a file"));
        assert!(resumed == whole, "{name}");
    }
}

#[test]
fn registered_meshes_have_the_templates_triangles_on_the_surfaces() {
    let site = Site::new();
    let register = ["register", "in/s02.ply", "in/s05.ply", "--template", "in/s01.ply", "-o", "registered", "--json"];
    let found: Value = serde_json::from_str(&succeed(&mut site.shape(&register))).expect("JSON");
    let template = read_mesh(site.path("in/s01.ply")).expect("a mesh");
    for (index, name) in ["s02", "s05"].into_iter().enumerate() {
        let moved = read_mesh(site.path(&format!("registered/{name}.ply"))).expect("a mesh");
        let surface = TriangleTree::new(&read_mesh(site.path(&format!("in/{name}.ply"))).expect("a mesh"));
        assert_eq!(moved.faces, template.faces);
        let far = moved.vertices.iter().map(|v| surface.nearest(*v).expect("a place").distance).fold(0.0, f64::max);
        assert!(far < 1e-4, "{far}");
        let cover = &found["surfaces"][index]["cover"];
        assert!(cover["rms"].as_f64().expect("a number") < 0.2, "{cover}");
    }
    assert!(fail(&mut site.shape(&register)).contains("exists"));
}

#[test]
fn what_cannot_correspond_is_refused_in_words() {
    let site = Site::with_group();
    let refused = |arguments: &[&str], words: &[&str]| {
        let output = finish(&mut site.shape(arguments));
        let error = error_line(&output);
        assert!(words.iter().all(|word| error.contains(word)), "{arguments:?}: {error}");
        assert!(!site.path("x").exists(), "{arguments:?}");
    };
    let degree = ["--max-degree", "4", "-o", "x"];
    let with = |surfaces: &[&'static str]| [&["correspond"][..], surfaces, &degree].concat();
    refused(&with(&["in/s01.ply"]), &["at least 2 surfaces, found 1"]);
    refused(&with(&["in/s01.ply", "in/s99.ply"]), &["s99.ply", "no such file"]);
    refused(&with(&["in", "in/s01.ply"]), &["folder"]);
    fs::create_dir(site.path("b")).expect("a folder");
    fs::copy(site.path("in/s02.ply"), site.path("b/s01.ply")).expect("a copy");
    refused(&with(&["in/s01.ply", "b/s01.ply"]), &["both have the name s01", "--name-template"]);
    fs::write(site.path("b/flat.obj"), "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n").expect("a file");
    refused(&with(&["in/s01.ply", "b/flat.obj"]), &["flat.obj"]);
    let tight = [&with(&["in/s01.ply", "in/s02.ply"])[..], &["--memory", "30MiB"]].concat();
    refused(&tight, &["shape correspond", "--memory"]);
    for usage in [
        &["in/s01.ply", "in/s02.ply", "-o", "x"][..],
        &["in/s01.ply", "--shard", "0/2", "--max-degree", "4", "-o", "x"],
    ] {
        let output = finish(&mut site.shape(&[&["correspond"][..], usage].concat()));
        assert_eq!(output.status.code(), Some(2), "{}", text(&output));
    }
    fs::write(site.path("group/group.json"), "{}").expect("a file");
    refused(&["correspond", "in/s03.ply", "--to", "group", "-o", "x"], &["group.json", "expected", "found"]);
    refused(&["carry", "group", "in/s01.json", "--from", "s01", "--to", "s02", "-o", "x"], &["group.json"]);
}

#[test]
fn meshes_of_any_topology_are_aligned_by_their_surfaces() {
    let site = Site::new();
    // The second mesh has a hole.
    let mut open = read_mesh(site.path("in/s02.ply")).expect("a mesh");
    open.faces.truncate(open.faces.len() - 20);
    write_mesh(site.path("in/s02.ply"), &open, &WriteOptions { overwrite: true, double: false }).expect("a file");
    let marks = |name: &str| Landmarks::read(site.path(&format!("in/{name}.json"))).expect("landmarks").points;
    let apart = |moved: &dyn Fn(usize, [f64; 3]) -> [f64; 3], names: &[&str]| {
        let placed: Vec<Vec<[f64; 3]>> =
            names.iter().enumerate().map(|(k, name)| marks(name).iter().map(|p| moved(k, *p)).collect()).collect();
        let pairs = placed[1..].iter().flat_map(|other| placed[0].iter().zip(other));
        let far = pairs.map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt());
        far.fold(0.0, f64::max)
    };
    let names = ["s01", "s02", "s03"];
    let group = ["align", "in/s01.ply", "in/s02.ply", "in/s03.ply", "--group", "-o", "out", "--transforms", "t.json"];
    succeed(&mut site.shape(&group));
    let written = site.json("t.json");
    let number = |value: &Value| value.as_f64().expect("a number");
    let moves: Vec<Similarity> = (0..3)
        .map(|k| Similarity {
            orthogonal: std::array::from_fn(|i| std::array::from_fn(|j| number(&written[k]["object"][i][j]))),
            scale: number(&written[k]["scale"]),
            translation: std::array::from_fn(|i| number(&written[k]["translation"][i])),
        })
        .collect();
    assert!(apart(&|_, p| p, &names) > 20.0, "they come in random poses");
    // Corresponding landmarks differ by some millimetres, because the bumps have different heights.
    assert!(apart(&|k, p| moves[k].apply(p), &names) < 4.0, "{}", apart(&|k, p| moves[k].apply(p), &names));
    for (name, to) in names.iter().zip(&moves) {
        let [own, moved] =
            ["in", "out"].map(|folder| read_mesh(site.path(&format!("{folder}/{name}.ply"))).expect("a mesh"));
        assert_eq!(own.faces, moved.faces);
        let there = to.apply(own.vertices[7]);
        assert!((0..3).all(|k| (moved.vertices[7][k] - there[k]).abs() < 1e-3), "{name}");
    }
    succeed(&mut site.shape(&["align", "in/s03.ply", "--to", "in/s01.ply", "-o", "one.ply"]));
    let (one, fixed) =
        (read_mesh(site.path("one.ply")).expect("a mesh"), read_mesh(site.path("in/s01.ply")).expect("a mesh"));
    let tree = TriangleTree::new(&fixed);
    let far: Vec<f64> = one.vertices.iter().map(|v| tree.nearest(*v).expect("a place").distance).collect();
    assert!(far.iter().sum::<f64>() / (far.len() as f64) < 0.3);
}
