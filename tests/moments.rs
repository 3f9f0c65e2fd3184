//! Tests `moments`, `moments merge` and `fit --moments`: models from tables, sums of parts, and refusal of bad input.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;
use spharm_harmonics::Directions;
use spharm_model::Model;

use crate::common::{error_line, fail, finish, succeed, text, tool, wait};

/// A folder with a table of 4,000 weighted samples of `2 + sin(lat)` with noise.
struct Survey(tempfile::TempDir);

impl Survey {
    fn new() -> Self {
        let survey = Self(tempfile::tempdir().expect("a folder"));
        std::fs::write(survey.path("heights.csv"), Self::table()).expect("a table");
        survey
    }

    fn table() -> String {
        let directions = Directions::fibonacci(4_000).expect("directions");
        let rows = directions.as_slice().iter().enumerate().map(|(i, v)| {
            let (lon, lat) = (v[1].atan2(v[0]).to_degrees(), v[2].asin().to_degrees());
            let noise = 0.01 * ((i * 7919) as f64).sin();
            format!("{lon},{lat},{},{}\n", 2.0 + v[2] + noise, 1 + i % 2)
        });
        rows.fold("lon,lat,height,w\n".to_owned(), |table, row| table + &row)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).expect("a folder");
        let mut names: Vec<_> =
            entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    fn moments(&self, samples: &str, output: &str, more: &[&str]) -> Command {
        let mut command = tool("moments");
        command.arg("--samples").arg(self.path(samples)).args(["--values", "height", "--weight", "w", "-q"]);
        command.args(["--max-degree", "12", "--threads", "2", "-o"]).arg(self.path(output)).args(more);
        command
    }

    fn merge(&self, parts: &[&str], output: &str, more: &[&str]) -> Command {
        let mut command = tool("moments");
        command.arg("merge").args(parts.iter().map(|part| self.path(part))).args(more);
        command.arg("-o").arg(self.path(output));
        command
    }

    fn fit(&self, moments: &str, degree: usize, more: &[&str]) -> Command {
        let mut command = tool("fit");
        command.arg("--moments").arg(self.path(moments)).args(["--max-degree", &degree.to_string(), "--threads", "2"]);
        command.args(["-q", "--json", "-o"]).arg(self.0.path()).args(more);
        command
    }

    fn model(&self, name: &str) -> Model {
        Model::read(self.path(name)).expect("a model")
    }
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

fn largest_difference(a: &Model, b: &Model) -> f64 {
    let difference = a.coefficients.values() - b.coefficients.values();
    difference.iter().fold(0.0, |most: f64, d| most.max(d.abs()))
}

#[test]
fn shards_give_the_model_of_the_whole() {
    let survey = Survey::new();
    let report = json(&succeed(&mut survey.moments("heights.csv", "whole.moments", &["--json"])));
    assert_eq!((&report["rows"], &report["max_degree"]), (&4_000.into(), &12.into()));
    succeed(&mut survey.fit("whole.moments", 10, &[]));
    let whole = survey.model("whole.spharm.npz");
    for of in [2, 7] {
        let parts: Vec<String> = (0..of).map(|index| format!("{of}-{index}.moments")).collect();
        for (index, part) in parts.iter().enumerate() {
            succeed(&mut survey.moments("heights.csv", part, &["--shard", &format!("{index}/{of}")]));
        }
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        let all = format!("all{of}.moments");
        let error = fail(&mut survey.merge(&parts[1..], &all, &[]));
        assert!(
            error.contains(&format!("1 range of shards is missing: shard 0/{of}")) && error.contains("--partial"),
            "{error}"
        );
        succeed(&mut survey.merge(&parts, &all, &[]));
        succeed(&mut survey.fit(&all, 10, &[]));
        let merged = survey.model(&format!("all{of}.spharm.npz"));
        let off = largest_difference(&whole, &merged);
        assert!(off < 1e-12, "{of} shards: {off:e}");
    }
}

/// Compares a model from moments with the weighted least squares of the same samples by `fit --surface`, which uses
/// transforms.
#[test]
fn a_model_from_moments_is_that_of_the_samples() {
    let survey = Survey::new();
    let table = Survey::table();
    let cells: Vec<Vec<f64>> =
        table.lines().skip(1).map(|row| row.split(',').map(|cell| cell.parse().expect("a number")).collect()).collect();
    let column = |name: &str, of: &dyn Fn(&[f64]) -> String| {
        let rows: String = cells.iter().map(|row| of(row) + "\n").collect();
        std::fs::write(survey.path(name), rows).expect("a table");
    };
    column("sphere.csv", &|row| format!("{},{}", (90.0 - row[1]).to_radians(), row[0].rem_euclid(360.0).to_radians()));
    column("f.csv", &|row| row[2].to_string());
    column("w.csv", &|row| row[3].to_string());
    let mut fit = tool("fit");
    fit.arg("--sphere").arg(survey.path("sphere.csv")).arg("--surface").arg(survey.path("f.csv"));
    fit.arg("--weights").arg(survey.path("w.csv")).args(["--max-degree", "9", "--stderr", "-q", "-o"]);
    succeed(fit.arg(survey.0.path()));
    succeed(&mut survey.moments("heights.csv", "m.moments", &[]));
    let report = json(&succeed(&mut survey.fit("m.moments", 9, &["--stderr", "--coefficients-csv"])));
    let off = largest_difference(&survey.model("f.spharm.npz"), &survey.model("m.spharm.npz"));
    assert!(off < 1e-9, "{off:e}");
    let errors = |name: &str| -> ndarray::Array2<f64> {
        ndarray_npy::read_npy(survey.path(&format!("{name}.spharm.stderr.npy"))).expect("standard errors")
    };
    let (a, b) = (errors("f"), errors("m"));
    assert!(a.iter().zip(&b).all(|(a, b)| (a / b - 1.0).abs() < 1e-6), "{a} {b}");
    let rms = report["fit"]["rms"][0].as_f64().expect("a number");
    assert!((0.005..0.008).contains(&rms), "the noise: {report}");
    assert!(report["fit"]["largest_gap"].as_f64().is_some_and(|gap| gap < 15.0), "{report}");
    let degree_1 = survey.model("m.spharm.npz").coefficients.values()[[2, 0]];
    assert!((degree_1 - (4.0 * std::f64::consts::PI / 3.0).sqrt()).abs() < 1e-3, "{degree_1}");
    // Compare smoothness chosen by cross-validation, no smoothness, and smoothness 1.
    let report = json(&succeed(&mut survey.fit("m.moments", 12, &["--smoothness", "auto", "--force"])));
    assert!(report["fit"]["gcv"]["smoothness"].as_f64().is_some_and(|lambda| lambda > 0.0), "{report}");
    let rough = json(&succeed(&mut survey.fit("m.moments", 12, &["--force"])));
    let smooth = json(&succeed(&mut survey.fit("m.moments", 12, &["--smoothness", "1", "--force"])));
    assert!(rough["fit"]["rms"][0].as_f64() < smooth["fit"]["rms"][0].as_f64());
}

#[test]
fn standard_input_is_a_table_too() {
    let survey = Survey::new();
    succeed(&mut survey.moments("heights.csv", "file.moments", &[]));
    let mut command = tool("moments");
    command.args(["--samples", "-", "--values", "height", "--weight", "w", "-q", "--max-degree", "12", "-o"]);
    command.arg(survey.path("piped.moments")).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the tool starts");
    let mut input = child.stdin.take().expect("a pipe");
    input.write_all(Survey::table().as_bytes()).expect("it reads");
    drop(input);
    let output = wait(child);
    assert!(output.status.success(), "{}", text(&output));
    for name in ["file", "piped"] {
        succeed(&mut survey.fit(&format!("{name}.moments"), 8, &[]));
    }
    let off = largest_difference(&survey.model("file.spharm.npz"), &survey.model("piped.spharm.npz"));
    assert!(off < 1e-13, "{off:e}");
}

#[test]
fn bad_input_is_refused_and_nothing_is_left_behind() {
    let survey = Survey::new();
    succeed(&mut survey.moments("heights.csv", "good.moments", &[]));
    succeed(&mut survey.moments("heights.csv", "half.moments", &["--shard", "0/2"]));
    let table = Survey::table();
    let write = |name: &str, bytes: &[u8]| std::fs::write(survey.path(name), bytes).expect("a file");
    let moments = std::fs::read(survey.path("good.moments")).expect("a file");
    write("nan.csv", (table.clone() + "1,2,nan,1\n").as_bytes());
    write("empty.csv", b"");
    write("ragged.csv", (table.clone() + "1,2,3\n").as_bytes());
    write("truncated.moments", &moments[..moments.len() - 1]);
    let mut flipped = moments.clone();
    flipped[moments.len() / 2] ^= 1;
    write("flipped.moments", &flipped);
    let mut newer = moments;
    newer[8] = 9;
    write("newer.moments", &newer);
    let before = survey.names();
    let refuses = |command: &mut Command, expected: &[&str]| {
        let error = fail(command);
        assert!(expected.iter().all(|word| error.contains(word)), "{expected:?} is not in: {error}");
        assert_eq!(survey.names(), before, "nothing is left behind");
    };
    refuses(&mut survey.moments("nan.csv", "out.moments", &[]), &["nan.csv", "row ", "a finite number"]);
    refuses(&mut survey.moments("empty.csv", "out.moments", &[]), &["empty.csv", "found none"]);
    refuses(&mut survey.moments("ragged.csv", "out.moments", &[]), &["ragged.csv", "row 4001", "3 fields"]);
    refuses(&mut survey.moments("none.csv", "out.moments", &[]), &["none.csv", "open"]);
    refuses(&mut survey.moments("heights.csv", "good.moments", &[]), &["good.moments", "exists", "--force"]);
    refuses(&mut survey.moments("heights.csv", "out.npz", &[]), &["out.npz", ".moments"]);
    refuses(&mut survey.moments("heights.csv", "out.moments", &["--angles", "lon", "lat"]), &["row ", "in radians"]);
    refuses(
        &mut survey.moments("heights.csv", "out.moments", &["--lonlat", "longitude", "lat"]),
        &["heights.csv", "no column longitude", "lon, lat, height, w"],
    );
    refuses(&mut survey.moments("heights.csv", "out.moments", &["--memory", "1MiB"]), &["degree 12", "1 MiB"]);
    refuses(
        &mut survey.merge(&["good.moments", "half.moments"], "out.moments", &[]),
        &["good.moments", "half.moments"],
    );
    refuses(&mut survey.merge(&["half.moments", "half.moments"], "out.moments", &[]), &["shard 0/2"]);
    for (name, words) in [("truncated", "length"), ("flipped", "hash"), ("newer", "version 9")] {
        let name = format!("{name}.moments");
        refuses(&mut survey.merge(&[&name], "out.moments", &[]), &[&name, words]);
        refuses(&mut survey.fit(&name, 5, &[]), &[&name, words]);
    }
    refuses(&mut survey.fit("good.moments", 13, &[]), &["13", "12, the highest degree of the moments"]);
    for more in [&["--surface", "a.ply"][..], &["--method", "irf"], &["--hold-out", "0.1"], &["--weights", "area"]] {
        let run = finish(&mut survey.fit("good.moments", 5, more));
        assert_eq!(run.status.code(), Some(2), "{more:?} {}", text(&run));
    }
    let mut bare = tool("moments");
    assert_eq!(finish(&mut bare).status.code(), Some(2));
    assert_eq!(finish(tool("fit").args(["--max-degree", "3"])).status.code(), Some(2));
    assert_eq!(finish(&mut survey.moments("heights.csv", "out.moments", &["--shard", "2/2"])).status.code(), Some(2));
}

#[test]
fn a_degree_that_the_samples_do_not_determine_is_said_with_the_gap() {
    let survey = Survey::new();
    let table = Survey::table();
    let north =
        |row: &&str| row.split(',').nth(1).and_then(|lat| lat.parse::<f64>().ok()).is_some_and(|lat| lat > 20.0);
    let rows: String = table.lines().skip(1).filter(north).map(|row| format!("{row}\n")).collect();
    std::fs::write(survey.path("north.csv"), format!("lon,lat,height,w\n{rows}")).expect("a table");
    succeed(&mut survey.moments("north.csv", "north.moments", &[]));
    let output = finish(&mut survey.fit("north.moments", 12, &[]));
    assert!(output.status.success(), "{}", text(&output));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("isn't determined by the samples") && said.contains("resolves angles of 15.0"), "{said}");
    let report = json(&String::from_utf8_lossy(&output.stdout));
    let gap = report["fit"]["largest_gap"].as_f64().expect("a number");
    // The largest gap is determined to within three cells of 180 / 26 degrees.
    assert!((gap - 220.0).abs() < 21.0, "{gap}");
    // With at least as many coefficients as samples, standard errors are refused.
    let few: String = table.lines().take(50).map(|row| format!("{row}\n")).collect();
    std::fs::write(survey.path("few.csv"), few).expect("a table");
    succeed(&mut survey.moments("few.csv", "few.moments", &[]));
    let error = error_line(&finish(&mut survey.fit("few.moments", 12, &["--stderr"])));
    assert!(error.contains("49") && error.contains("169"), "{error}");
}

/// Five places with 100 observations each are said not to determine 81 coefficients, also with `--strict`.
#[test]
fn repeated_places_do_not_determine_a_degree() {
    let survey = Survey::new();
    let row = |i: i32| format!("{},{},{},1\n", 72 * (i % 5), 30 * (i % 5) - 60, f64::from(i).sin());
    let rows: String = (0..500).map(row).collect();
    std::fs::write(survey.path("few.csv"), format!("lon,lat,height,w\n{rows}")).expect("a table");
    succeed(&mut survey.moments("few.csv", "few.moments", &[]));
    let output = finish(&mut survey.fit("few.moments", 8, &["--strict"]));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("degree 8 isn't determined by the samples"), "{said}");
}

/// Copies of a table are noticed in one run, and when their moments are added.
#[test]
fn samples_that_count_twice_are_warned_of() {
    let survey = Survey::new();
    std::fs::copy(survey.path("heights.csv"), survey.path("copy.csv")).expect("a copy");
    let copy = survey.path("copy.csv");
    let mut both = survey.moments("heights.csv", "both.moments", &["--json", "--samples"]);
    let report = json(&succeed(both.arg(copy)));
    assert!(report["warnings"][0].as_str().expect("a warning").contains("equal, byte for byte"), "{report}");
    for name in ["heights", "copy"] {
        succeed(&mut survey.moments(&format!("{name}.csv"), &format!("{name}.moments"), &[]));
    }
    let report = json(&succeed(&mut survey.merge(&["heights.moments", "copy.moments"], "sum.moments", &["--json"])));
    assert!(report["warnings"][0].as_str().expect("a warning").contains("equal sums"), "{report}");
}

#[test]
fn a_mean_that_hides_the_residual_and_a_missing_shard_are_said() {
    let survey = Survey::new();
    let table = Survey::table();
    let raised = table.lines().skip(1).map(|row| {
        let cells: Vec<f64> = row.split(',').map(|cell| cell.parse().expect("a number")).collect();
        format!("{},{},{},{}\n", cells[0], cells[1], 6_371_000.0 + cells[2], cells[3])
    });
    let raised = raised.fold("lon,lat,height,w\n".to_owned(), |table, row| table + &row);
    std::fs::write(survey.path("raised.csv"), raised).expect("a table");
    succeed(&mut survey.moments("raised.csv", "raised.moments", &[]));
    for more in [&["--stderr"][..], &["--denoise"], &["--smoothness", "auto"]] {
        let error = fail(&mut survey.fit("raised.moments", 9, more));
        for words in ["height", "subtract a constant", "or leave out this channel"] {
            assert!(error.contains(words), "{more:?}: {error}");
        }
    }
    let warned = |name: &str, words: &str| {
        let output = finish(&mut survey.fit(name, 2, &[]));
        assert!(output.status.success(), "{}", text(&output));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains(name) && said.contains(words), "{said}");
        json(&String::from_utf8_lossy(&output.stdout))
    };
    let report = warned("raised.moments", "subtract a constant");
    assert!(report["fit"]["rms"][0].is_null() && report["fit"]["explained"][0].is_null(), "{report}");
    succeed(&mut survey.moments("heights.csv", "half.moments", &["--shard", "0/2"]));
    warned("half.moments", "missing: shard 1/2");
}

#[test]
fn an_interrupted_run_leaves_nothing_and_can_be_done_again() {
    let survey = Survey::new();
    let header = "lon,lat,height,w\n";
    let rows = Survey::table().replacen(header, "", 1).repeat(200);
    std::fs::write(survey.path("long.csv"), header.to_owned() + &rows).expect("a table");
    let before = survey.names();
    let mut command = survey.moments("long.csv", "long.moments", &[]);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    std::thread::sleep(std::time::Duration::from_millis(150));
    let pid = rustix::process::Pid::from_child(&child);
    // The process may just have ended, so the signal may fail.
    let _ = rustix::process::kill_process(pid, rustix::process::Signal::INT);
    let output = wait(child);
    match output.status.code() {
        Some(75) => assert_eq!(survey.names(), before),
        code => assert_eq!(code, Some(0), "{}", text(&output)),
    }
    succeed(&mut survey.moments("long.csv", "long.moments", &["--force"]));
    assert!(Path::new(&survey.path("long.moments")).exists());
}
