//! Tests `moments --sphere` and `--icosphere`: one row per vertex, and the key of the sampling scheme from table to
//! model.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ndarray::Array2;
use serde_json::Value;
use spharm_model::Model;
use spharm_moments::Moments;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, write_mesh};

use crate::common::{fail, finish, succeed, text, tool, wait};

/// Number of vertices of an icosphere of 4 subdivisions.
const N: usize = 2_562;

/// A folder with a sphere of radius 100, and values at its vertices, in two files: without and with the positions.
struct Site(tempfile::TempDir);

impl Site {
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        let mut sphere = icosphere(4);
        let value = |row: usize| 2.0 + (0.3 * row as f64).sin();
        let vertices = sphere.vertices.clone();
        let beside = Array2::from_shape_fn((N, 4), |(row, j)| *vertices[row].get(j).unwrap_or(&value(row)));
        let alone = Array2::from_shape_fn((N, 1), |(row, _)| value(row));
        ndarray_npy::write_npy(site.path("thickness.npy"), &alone).expect("a table");
        ndarray_npy::write_npy(site.path("beside.npy"), &beside).expect("a table");
        sphere.vertices.iter_mut().flatten().for_each(|x| *x *= 128.0);
        write_mesh(site.path("lh.sphere.obj"), &sphere, &WriteOptions::default()).expect("a sphere");
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn moments(&self, samples: &str, value: &str, more: &[&str], output: &str) -> Command {
        let mut command = tool("moments");
        command.arg("--samples").arg(if samples == "-" { samples.into() } else { self.path(samples) });
        command.args(["--values", value, "--max-degree", "10", "--threads", "2", "--json", "-q", "-o"]);
        command.arg(self.path(output)).args(more).current_dir(self.0.path());
        command
    }

    /// Computes moments over the icosphere; returns the report.
    fn over(&self, more: &[&str], output: &str) -> Value {
        let more = [&["--icosphere", "4"], more].concat();
        json(&succeed(&mut self.moments("thickness.npy", "0", &more, output)))
    }

    fn merge(&self, parts: &[&str], output: &str) -> Value {
        let mut command = tool("moments");
        command.arg("merge").args(parts.iter().map(|part| self.path(part))).args(["--json", "-o"]);
        json(&succeed(command.arg(self.path(output))))
    }

    fn read(&self, name: &str) -> Moments {
        Moments::read(&self.path(name)).expect("moments")
    }
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

/// Checks that the sums of two files are equal up to rounding.
fn assert_same(a: &Moments, b: &Moments) {
    assert_eq!((a.rows, a.sums.count, &a.occupied), (b.rows, b.sums.count, &b.occupied));
    let pairs = a.sums.moments.iter().zip(&b.sums.moments).chain(a.sums.right_sides.iter().zip(&b.sums.right_sides));
    let off = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / a.sums.moments[0];
    assert!(off < 1e-13, "{off:e}");
    assert!((a.sums.squares[0] / b.sums.squares[0] - 1.0).abs() < 1e-13 && a.sums.weight == b.sums.weight);
}

#[test]
fn the_key_is_that_of_a_store_and_goes_from_the_table_to_the_model() {
    let site = Site::new();
    let report = site.over(&[], "over.moments");
    let vectors = ["--vectors", "0", "1", "2"];
    let anywhere = json(&succeed(&mut site.moments("beside.npy", "3", &vectors, "anywhere.moments")));
    assert!(anywhere["scheme_key"].is_null(), "{anywhere}");
    assert_same(&site.read("over.moments"), &site.read("anywhere.moments"));
    // Read the same sphere from a file, with another radius.
    let sphere = ["--sphere", "lh.sphere.obj"];
    let of_sphere = json(&succeed(&mut site.moments("thickness.npy", "0", &sphere, "sphere.moments")));
    assert_same(&site.read("over.moments"), &site.read("sphere.moments"));
    assert_eq!(of_sphere["sphere"], "lh.sphere.obj");
    let mut build = tool("basis-build");
    build.arg("--sphere").arg(site.path("lh.sphere.obj")).args(["--max-degree", "1", "--json", "-q", "--store"]);
    let built = json(&succeed(build.arg(site.path("store"))));
    let key = built["scheme_key"].as_str().expect("a key");
    assert_eq!((&report["scheme_key"], &of_sphere["scheme_key"]), (&key.into(), &key.into()));
    assert_eq!(site.read("over.moments").scheme.map(|key| key.to_string()).as_deref(), Some(key));

    let fit = |name: &str| {
        let mut fit = tool("fit");
        fit.arg("--moments").arg(site.path(name)).args(["--max-degree", "8", "-q", "--json", "-o"]);
        json(&succeed(fit.arg(site.0.path())))
    };
    assert_eq!(fit("over.moments")["scheme_key"], key);
    assert!(fit("anywhere.moments")["scheme_key"].is_null());
    let model = |name: &str| Model::read(site.path(name)).expect("a model");
    assert_eq!(model("over.spharm.npz").scheme_key.as_deref(), Some(key));
    assert_eq!(model("anywhere.spharm.npz").scheme_key, None);
    // A model with a scheme key but without a sphere can be reconstructed.
    let mut reconstruct = tool("reconstruct");
    reconstruct.arg("--model").arg(site.path("over.spharm.npz")).args(["--icosphere", "2", "-q", "-o"]);
    succeed(reconstruct.arg(site.path("back.csv")));
}

#[test]
fn shards_of_a_scheme_make_up_the_whole_and_keep_its_key() {
    let site = Site::new();
    let whole = site.over(&[], "whole.moments");
    let parts = ["0.moments", "1.moments", "2.moments"];
    for (index, part) in parts.into_iter().enumerate() {
        let report = site.over(&["--shard", &format!("{index}/3")], part);
        assert_eq!((&report["rows"], &report["scheme_key"]), (&854.into(), &whole["scheme_key"]));
    }
    let merged = site.merge(&parts, "all.moments");
    assert_eq!((&merged["scheme_key"], &merged["shards"]), (&whole["scheme_key"], &whole["shards"]));
    assert_same(&site.read("all.moments"), &site.read("whole.moments"));
    // Test moments over another scheme, and moments without a scheme.
    let fewer = Array2::from_elem((642, 1), 1.0);
    ndarray_npy::write_npy(site.path("fewer.npy"), &fewer).expect("a table");
    succeed(&mut site.moments("fewer.npy", "0", &["--icosphere", "3"], "fewer.moments"));
    let mut anywhere = site.moments("beside.npy", "0", &["--vectors", "0", "1", "2"], "anywhere.moments");
    succeed(&mut anywhere);
    for (other, rows) in [("fewer.moments", N + 642), ("anywhere.moments", 2 * N)] {
        for parts in [["whole.moments", other], [other, "whole.moments"]] {
            let merged = site.merge(&parts, &format!("with-{}-{}", parts[0], parts[1]));
            assert_eq!((&merged["rows"], &merged["scheme_key"]), (&rows.into(), &Value::Null));
        }
    }
}

/// Sums of samples in arbitrary directions keep the keys that they had before sampling schemes were introduced.
#[test]
fn keys_of_other_requests_stay() {
    let site = tempfile::tempdir().expect("a folder");
    std::fs::write(site.path().join("s.csv"), "lon,lat,f,w\n0,90,1,1\n120,-30,2,1\n240,-30,3,2\n").expect("a table");
    let key = |more: &[&str]| {
        let mut command = tool("moments");
        command.args(["--samples", "s.csv", "--values", "f", "--max-degree", "1", "--json", "-q", "--force"]);
        let report = json(&succeed(command.args(["-o", "s.moments"]).args(more).current_dir(site.path())));
        report["shards"][0]["key"].as_str().expect("a key").to_owned()
    };
    assert_eq!(key(&[]), "809c9510c9b74519fe1898f149abdc7b266eea112b931139f560286dd50cae18");
    assert_eq!(
        key(&["--lonlat", "lon", "lat", "--weight", "w"]),
        "7a461e7084aa67ce4ad5f350857897f66add15f85c5be90b1aabdf2f667fbd09"
    );
}

#[test]
fn standard_input_has_a_row_for_each_vertex_too() {
    let site = Site::new();
    let whole = site.over(&[], "whole.moments");
    let piped = |bytes: &[u8], more: &[&str]| {
        let more = [&["--icosphere", "4", "--force"], more].concat();
        let mut command = site.moments("-", "0", &more, "piped.moments");
        let child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let mut child = child.expect("the tool starts");
        let mut input = child.stdin.take().expect("a pipe");
        // The process may end before it has read all input.
        let _ = std::io::Write::write_all(&mut input, bytes);
        drop(input);
        wait(child)
    };
    let table = std::fs::read(site.path("thickness.npy")).expect("a table");
    let output = piped(&table, &[]);
    assert!(output.status.success(), "{}", text(&output));
    assert_eq!(json(&String::from_utf8_lossy(&output.stdout))["scheme_key"], whole["scheme_key"]);
    assert_same(&site.read("piped.moments"), &site.read("whole.moments"));
    for (output, expected) in [
        (piped(&b"1\n".repeat(N + 1), &[]), "-: expected 2562 rows, one for each vertex of the sphere, found 2563"),
        (piped(&table, &["--shard", "0/2"]), "standard input can't be divided into shards"),
    ] {
        assert!(output.status.code() == Some(1) && text(&output).contains(expected), "{}", text(&output));
    }
}

#[test]
fn rows_and_options_that_do_not_fit_are_refused() {
    let site = Site::new();
    let missing = |name: &str| !Path::exists(&site.path(name));
    for more in [&["--icosphere", "3"][..], &["--icosphere", "3", "--shard", "1/2"]] {
        let error = fail(&mut site.moments("thickness.npy", "0", more, "out.moments"));
        let expected =
            "thickness.npy: expected 642 rows, one for each vertex of the sphere, found 2562; give the sphere";
        assert!(error.contains(expected) && missing("out.moments"), "{error}");
    }
    let over = ["--icosphere", "4"];
    for (samples, value, more, expected) in [
        ("thickness.npy", "1", &over[..], "no column 1"),
        ("thickness.npy", "radius", &over, "the value `radius` and a centre require positions as vectors (x, y, z)"),
        ("lh.sphere.obj", "0", &over, "lh.sphere.obj"),
        ("thickness.npy", "0", &["--sphere", "none.ply"], "none.ply"),
        ("thickness.npy", "0", &["--sphere", "thickness.npy"], "thickness.npy"),
        (
            "thickness.npy",
            "0",
            &["--icosphere", "12", "--memory", "1GiB"],
            "moments --icosphere 12 (167772162 vertices)",
        ),
        ("thickness.npy", "0", &["--sphere", "lh.sphere.obj", "--memory", "21MiB"], "MiB"),
    ] {
        let error = fail(&mut site.moments(samples, value, more, "out.moments"));
        assert!(error.contains(expected) && missing("out.moments"), "{error}");
    }
    for more in [
        &["--sphere", "lh.sphere.obj"][..],
        &["--vectors", "0", "1", "2"],
        &["--angles", "0", "1"],
        &["--lonlat", "0", "1"],
        &["--centre", "0", "0", "0"],
    ] {
        let run = finish(&mut site.moments("thickness.npy", "0", &[&over, more].concat(), "out.moments"));
        assert_eq!(run.status.code(), Some(2), "{more:?} {}", text(&run));
        assert!(text(&run).contains("cannot be used with"), "{}", text(&run));
    }
    let run = finish(&mut site.moments("thickness.npy", "0", &["--icosphere", "13"], "out.moments"));
    assert_eq!(run.status.code(), Some(2), "{}", text(&run));
    // The sphere is an input, so no output may replace it.
    let mut onto = site.moments("thickness.npy", "0", &["--sphere", "lh.sphere.obj", "--force"], "out.moments");
    let error = fail(onto.args(["--report", "lh.sphere.obj"]));
    assert!(error.contains("an input; choose another --report"), "{error}");
}
