//! Tests `shape`: outputs of its subcommands, and bad models.

use std::f64::consts::PI;
use std::path::PathBuf;
use std::process::Command;

use ndarray::Array2;
use serde_json::Value;
use spharm::shape::{area_spread, local_geometry, rotational_derivatives, tails};
use spharm_harmonics::{Coefficients, Directions};
use spharm_model::Model;
use spharm_monitor::Silent;
use spharm_surface::io::{read_mesh, read_signal};
use spharm_surface::{Kind, Sphere};

use crate::common::{fail, finish, succeed, text, tool};

/// A folder with an ellipsoid of semi-axes 3, 2, 1, a bumpy model over its own sphere, and invalid models.
struct Site(tempfile::TempDir);

impl Site {
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        site.write("ellipsoid", ellipsoid());
        site.write("bumpy", bumpy());
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn model(&self, name: &str) -> PathBuf {
        self.path(&format!("models/{name}.spharm.npz"))
    }

    fn write(&self, name: &str, values: Array2<f64>) {
        let kind = if values.ncols() == 3 { Kind::Surface } else { Kind::Signal };
        let coefficients = Coefficients::new(values).expect("a degree");
        std::fs::create_dir_all(self.path("models")).expect("a folder");
        Model::new(Sphere::icosphere(3), coefficients, kind).write(self.model(name)).expect("a model");
    }

    fn read(&self, name: &str) -> Model {
        Model::read(self.path(name)).expect("a model")
    }

    fn shape(&self, subcommand: &str, models: &[&str], more: &[&str]) -> Command {
        let mut command = tool("shape");
        command.arg(subcommand).args(models.iter().map(|name| self.model(name))).args(more).arg("-q");
        command.current_dir(self.0.path());
        command
    }
}

fn ellipsoid() -> Array2<f64> {
    let (mut values, unit) = (Array2::zeros((4, 3)), (4.0 * PI / 3.0).sqrt());
    (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (3.0 * unit, 2.0 * unit, unit);
    values[[0, 0]] = 10.0 * (4.0 * PI).sqrt();
    values
}

fn bumpy() -> Array2<f64> {
    let mut values =
        Array2::from_shape_fn((81, 3), |(k, c)| 0.1 * ((k * 7 + c * 3) as f64 * 0.37).sin() / (1.0 + k as f64));
    values.slice_mut(ndarray::s![..4, ..]).scaled_add(1.0, &ellipsoid());
    values
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

#[test]
fn an_ellipsoid_is_measured_and_its_maps_are_written() {
    let site = Site::new();
    let report =
        json(&succeed(&mut site.shape("measure", &["ellipsoid"], &["--json", "-o", "t.csv", "--maps", "maps"])));
    let model = &report["models"][0];
    let is = |field: &str, known: f64| {
        let found = model[field].as_f64().expect("a number");
        assert!((found / known - 1.0).abs() < 1e-9, "{field}: {found} {known}");
    };
    is("volume", 8.0 * PI);
    is("area", 48.882_146_302_582_06);
    assert!((model["centroid"][0].as_f64().expect("a number") - 10.0).abs() < 1e-12, "{model}");
    assert_eq!(report["tool"], "shape measure");
    let table = std::fs::read_to_string(site.path("t.csv")).expect("a table");
    assert!(table.starts_with("model,degree,area,volume,") && table.lines().count() == 2, "{table}");
    succeed(&mut site.shape("measure", &["ellipsoid"], &["-o", "t.tsv"]));
    let tabs = std::fs::read_to_string(site.path("t.tsv")).expect("a table");
    assert_eq!(tabs, table.replace(',', "\t"));
    // The end of the longest axis isn't a vertex of an icosphere, so it is given as a direction in a table.
    std::fs::write(site.path("tip.csv"), format!("{},0\n0,0\n", PI / 2.0)).expect("a table");
    let more = ["--sphere", "tip.csv", "--maps", "tip", "--format", "csv"];
    succeed(&mut site.shape("measure", &["ellipsoid"], &more));
    let table = std::fs::read_to_string(site.path("tip/ellipsoid.geometry.csv")).expect("a table");
    let cells: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    // The Gaussian curvature at the end of axis a is (a / b^2) (a / c^2), and at the end of axis c, the pole, (c / a^2)
    // (c / b^2).
    for (row, gaussian, normal) in [(&cells[0], 9.0 / 4.0, [1.0, 0.0, 0.0]), (&cells[1], 1.0 / 36.0, [0.0, 0.0, 1.0])] {
        assert!((row[11] - gaussian).abs() < 1e-12, "{row:?}");
        assert!((0..3).all(|k| (row[6 + k] - normal[k]).abs() < 1e-12), "{row:?}");
    }
    let model = site.read("models/ellipsoid.spharm.npz");
    let points = local_geometry(&model.coefficients, &Sphere::icosphere(3).directions, &Silent).expect("a surface");
    let map = read_signal(site.path("maps/ellipsoid.mean-curvature.shape.gii")).expect("a map");
    assert_eq!((map.vertices, map.channels), (642, 1));
    for (found, point) in map.values.iter().zip(&points) {
        assert!((found - point.mean_curvature()).abs() < 1e-6);
    }
    for name in ["gaussian-curvature", "shape-index", "curvedness", "area-element"] {
        assert!(site.path(&format!("maps/ellipsoid.{name}.shape.gii")).is_file(), "{name}");
    }
}

#[test]
fn smoothing_is_recorded_and_is_not_taken_for_a_fit() {
    let site = Site::new();
    succeed(&mut site.shape("smooth", &["bumpy"], &["--s", "0.01", "-o", "one.npz"]));
    succeed(&mut site.shape("smooth", &["bumpy", "ellipsoid"], &["--fwhm", "20", "-o", "both", "--report", "r.json"]));
    let (rough, smooth) = (site.read("models/bumpy.spharm.npz"), site.read("one.npz"));
    for (row, (a, b)) in
        rough.coefficients.values().rows().into_iter().zip(smooth.coefficients.values().rows()).enumerate()
    {
        let l = row.isqrt() as f64;
        assert!(a.iter().zip(b).all(|(a, b)| (a * (-l * (l + 1.0) * 0.01).exp() - b).abs() < 1e-15));
    }
    assert_eq!((smooth.sphere, smooth.scheme_key), (rough.sphere, rough.scheme_key));
    let provenance = smooth.provenance;
    assert_eq!((provenance.tool.as_deref(), provenance.settings), (Some("shape smooth"), None));
    assert_eq!(provenance.other["transform"][0]["heat_kernel"]["s"], 0.01);
    let report = json(&std::fs::read_to_string(site.path("r.json")).expect("a report"));
    let s = report["s"].as_f64().expect("a number");
    assert!((s / (20f64.to_radians().powi(2) / (16.0 * std::f64::consts::LN_2)) - 1.0).abs() < 1e-12, "{report}");
    assert!(site.path("both/bumpy.spharm.npz").is_file() && site.path("both/ellipsoid.spharm.npz").is_file());
    // A second transform is appended to the list of transforms.
    let mut again = tool("shape");
    succeed(again.args(["smooth", "--s", "0.02", "-q", "-o"]).arg(site.path("two.npz")).arg(site.path("one.npz")));
    let steps = site.read("two.npz").provenance.other["transform"].as_array().map(Vec::len);
    assert_eq!(steps, Some(2));
    let error = fail(&mut site.shape("smooth", &["bumpy"], &["--fwhm", "-1", "-o", "bad.npz"]));
    assert!(error.contains("--fwhm") && error.contains("from 0 to 180 degrees"), "{error}");
    let error = fail(&mut site.shape("smooth", &["bumpy"], &["--fwhm", "1e300", "-o", "bad.npz"]));
    assert!(error.contains("from 0 to 180 degrees"), "{error}");
    let refused = finish(&mut site.shape("smooth", &["bumpy"], &["--fwhm", "12mm", "-o", "bad.npz"]));
    assert!(!refused.status.success() && text(&refused).contains("a length w is 57.3 w / R"), "{}", text(&refused));
    assert_eq!(finish(&mut site.shape("smooth", &["bumpy"], &["-o", "bad.npz"])).status.code(), Some(2));
}

/// A model that is rotated by a quarter turn about the axis of its sphere, mirrored and moved is found, and has the
/// same descriptors.
#[test]
fn models_are_described_and_found_in_any_pose() {
    let site = Site::new();
    let values = bumpy();
    let turned = Array2::from_shape_fn(values.dim(), |(row, c)| {
        let (l, m) = spharm_harmonics::index::degree_order(row);
        let (sin, cos) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][m.rem_euclid(4) as usize];
        let c = (c + 1) % 3;
        let value = cos * values[[row, c]] - sin * values[[spharm_harmonics::column(l, -m), c]];
        if row == 0 { value + 50.0 } else { -value }
    });
    site.write("turned", turned);
    succeed(&mut site.shape("describe", &["bumpy", "turned"], &["-o", "d.csv"]));
    let table = std::fs::read_to_string(site.path("d.csv")).expect("a table");
    let rows: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').skip(1).map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    assert_eq!(rows[0].len(), 1 + 8 + 24);
    assert!(rows[0].iter().zip(&rows[1]).all(|(a, b)| (a - b).abs() < 1e-13), "{table}");
    let more = ["--among", "models", "--top", "2", "--mirror", "--json"];
    let mut command = site.shape("match", &["turned"], &more);
    let output = finish(&mut command);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("degrees from 1 to 8"), "{text}");
    std::fs::remove_file(site.model("ellipsoid")).expect("it was there");
    let report = json(&succeed(&mut site.shape("match", &["turned"], &more)));
    let matches = report["queries"][0]["matches"].as_array().expect("matches");
    assert_eq!(matches.len(), 2);
    let below = |name: &str, most: f64| matches.iter().all(|found| found[name].as_f64().is_some_and(|d| d < most));
    assert!(below("bound", 1e-13) && below("distance", 1e-8), "{report}");
    // Without --mirror, the distance of the mirrored model remains.
    let more = ["--among", "models", "--top", "2", "--json"];
    let report = json(&succeed(&mut site.shape("match", &["turned"], &more)));
    let distance = |rank: usize| report["queries"][0]["matches"][rank]["distance"].as_f64().expect("a distance");
    assert!(report["queries"][0]["matches"][0]["model"].as_str().is_some_and(|name| name.contains("turned")));
    assert!(distance(0) < 1e-8 && distance(1) > 1e-3, "{report}");
    let printed = succeed(&mut site.shape("describe", &["bumpy"], &["--only", "power", "--max-degree", "2"]));
    assert!(printed.starts_with("model,size,power_1,power_2\n"), "{printed}");
}

/// In a group of which half is mirrored no member is an outlier, but a warning reports the group.
#[test]
fn the_members_of_a_groups_smaller_side_are_named_by_their_files() {
    let site = Site::new();
    let names = ["s0", "s1", "s2", "s3", "s4", "s5", "s6"];
    for (subject, name) in names.iter().enumerate() {
        let mut values = Array2::from_shape_fn((36, 3), |(k, c)| {
            let l = k.isqrt() as f64;
            let own = 0.02 * ((k * (subject + 3) + c) as f64 * 0.91).sin();
            own + ((k * 7 + c * 31) as f64 * 0.37).sin() * 2.0 / (1.0 + l * l)
        });
        (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 5.0, 3.0);
        if subject % 2 == 1 {
            values.column_mut(0).mapv_inplace(|v| -v);
        }
        site.write(name, values);
    }
    let output = finish(&mut site.shape("align", &names, &["--group", "-o", "aligned", "--json"]));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && told.contains("two sides") && told.contains("s1.spharm.npz"), "{told}");
    let report = json(&String::from_utf8_lossy(&output.stdout));
    let expected: Vec<Value> = ["s1", "s3", "s5"].map(|name| site.model(name).display().to_string().into()).into();
    assert_eq!(report["mirrored"], Value::from(expected), "{report}");
}

#[test]
fn levels_have_the_distances_that_parseval_says() {
    let site = Site::new();
    let more = ["--levels", "1,4,8", "--icosphere", "4", "-o", "levels", "--format", "ply", "--double", "--json"];
    let report = json(&succeed(&mut site.shape("remesh", &["bumpy"], &more)));
    let tails = tails(&site.read("models/bumpy.spharm.npz").coefficients).expect("finite");
    let areas = Sphere::icosphere(4).areas();
    let whole = read_mesh(site.path("levels/bumpy.degree8.ply")).expect("a mesh");
    for (number, degree) in [1, 4, 8].into_iter().enumerate() {
        let mesh = read_mesh(site.path(&format!("levels/bumpy.degree{degree}.ply"))).expect("a mesh");
        assert_eq!(mesh.faces, whole.faces);
        let squares = mesh.vertices.iter().zip(&whole.vertices).zip(&areas);
        let mean = squares.map(|((a, b), w)| w * (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>()).sum::<f64>();
        let found = (mean / (4.0 * PI)).sqrt();
        // The areas of the icosphere's vertices aren't an exact quadrature.
        assert!((found - tails[degree]).abs() <= 0.01 * tails[degree], "{degree}: {found} {}", tails[degree]);
        assert_eq!(report["meshes"][number]["distance"].as_f64(), Some(tails[degree]));
    }
    let tolerance = format!("{:?}", tails[3] * 1.000_001);
    let report = json(&succeed(&mut site.shape(
        "remesh",
        &["bumpy"],
        &["--tolerance", &tolerance, "-o", "t.surf.gii", "--json"],
    )));
    assert_eq!(report["meshes"][0]["degree"], 3);
    let error = fail(&mut site.shape("remesh", &["bumpy"], &["--levels", "2,9", "-o", "more"]));
    assert!(error.contains("degree 8") && error.contains("--levels 9"), "{error}");
}

#[test]
fn an_even_mesh_is_more_even() {
    let site = Site::new();
    let mesh = |more: &[&str], name: &str| {
        succeed(&mut site.shape("remesh", &["ellipsoid"], &[more, &["--icosphere", "4", "-o", name]].concat()));
        read_mesh(site.path(name)).expect("a mesh")
    };
    let (plain, even) = (mesh(&[], "plain.ply"), mesh(&["--even"], "even.ply"));
    assert_eq!(plain.faces, even.faces);
    let (before, after) = (area_spread(&plain), area_spread(&even));
    assert!(after < 0.5 * before && after < 0.11, "{before} {after}");
}

#[test]
fn what_is_no_surface_is_refused_by_name_and_nothing_is_left_behind() {
    let site = Site::new();
    site.write("signal", Array2::ones((16, 2)));
    site.write("point", Array2::ones((1, 3)));
    site.write("line", Array2::ones((9, 3)));
    std::fs::write(site.path("models/broken.spharm.npz"), "no model").expect("a file");
    for subcommand in ["measure", "remesh"] {
        for (name, word) in
            [("signal", "2 channels"), ("point", "a point"), ("line", "a line"), ("broken", "not a SPHARM")]
        {
            let more: &[&str] = if subcommand == "remesh" { &["-o", "out.ply"] } else { &["-o", "out.csv"] };
            let error = fail(&mut site.shape(subcommand, &[name], more));
            assert!(error.contains(&format!("{name}.spharm.npz")) && error.contains(word), "{error}");
        }
    }
    assert!(!site.path("out.ply").exists() && !site.path("out.csv").exists());
    // Signals can be smoothed and described.
    succeed(&mut site.shape("smooth", &["signal"], &["--s", "0.1", "-o", "s.npz"]));
    let error = fail(&mut site.shape("describe", &["bumpy", "signal"], &[]));
    assert!(error.contains("signal.spharm.npz") && error.contains("channels"), "{error}");
    let error = fail(&mut site.shape("match", &["bumpy"], &["--among", "models/point.spharm.npz"]));
    assert!(error.contains("degree"), "{error}");
    for (subcommand, more) in
        [("measure", &["-o", "t.txt"][..]), ("smooth", &["--s", "1", "-o", "t.ply"]), ("remesh", &["-o", "t.npz"])]
    {
        let error = fail(&mut site.shape(subcommand, &["bumpy"], more));
        assert!(error.contains("--output") && error.contains(more[more.len() - 1]), "{error}");
    }
    std::fs::write(site.path("there.csv"), "mine").expect("a file");
    let error = fail(&mut site.shape("measure", &["bumpy"], &["-o", "there.csv"]));
    assert!(error.contains("--force"), "{error}");
    assert_eq!(std::fs::read_to_string(site.path("there.csv")).expect("it is there"), "mine");
}

#[test]
fn short_help_stays_short_and_long_help_has_examples() {
    for subcommand in ["measure", "smooth", "describe", "match", "remesh"] {
        let (short, long) =
            (succeed(tool("shape").args([subcommand, "-h"])), succeed(tool("shape").args([subcommand, "--help"])));
        assert!(short.lines().count() <= 60 && short.len() < long.len(), "{short}");
        assert!(long.contains("Examples:") && long.contains(&format!("spharm shape {subcommand} ")), "{long}");
    }
}

/// Uses the crate `spharm-shape` through `spharm`.
#[test]
fn the_facade_has_the_crate() {
    let directions = Directions::fibonacci(10).expect("directions");
    let ellipsoid = Coefficients::new(ellipsoid()).expect("degree 1");
    let [x, ..] = rotational_derivatives(ellipsoid.values().view()).expect("degree 1");
    assert_eq!(x.dim(), (4, 3));
    let stop = std::sync::atomic::AtomicBool::new(true);
    let error = spharm::Error::from(local_geometry(&ellipsoid, &directions, &stop).expect_err("stopped"));
    assert!(error.is_interrupted());
}

/// Two kinds in several sizes and poses: all models of a kind are in one cluster, and the larger cluster is the first.
#[test]
fn models_are_grouped_by_their_shapes() {
    let site = Site::new();
    for (index, kind) in ["x", "y", "x", "x", "y"].into_iter().enumerate() {
        let mut values = if kind == "x" { bumpy() } else { Array2::zeros((81, 3)) };
        if kind == "y" {
            // The second kind is a ball.
            [(1, 1), (2, 2), (3, 0)].into_iter().for_each(|(row, axis)| values[[row, axis]] = 2.0);
        }
        values *= 1.0 + 0.01 * index as f64;
        values[[0, 0]] = 9.0 * index as f64;
        site.write(&format!("c{index}{kind}"), values);
    }
    let models = ["c0x", "c1y", "c2x", "c3x", "c4y"];
    let report = json(&succeed(&mut site.shape("cluster", &models, &["--json", "-o", "c.csv"])));
    assert_eq!(report["clusters"].as_array().map(Vec::len), Some(2));
    assert_eq!((&report["clusters"][0]["models"], &report["tried"][0]["clusters"]), (&3.into(), &2.into()));
    let table = std::fs::read_to_string(site.path("c.csv")).expect("a table");
    let mut lines = table.lines();
    assert_eq!(lines.next(), Some("model,cluster,silhouette,typical"));
    for line in lines {
        assert_eq!(line.split(',').nth(1), Some(if line.contains("x,") { "1" } else { "2" }), "{table}");
    }
    // Models of other degrees are compared at the lowest one, with a warning.
    site.write("c5x", ellipsoid());
    let mixed = ["c0x", "c1y", "c2x", "c5x"];
    let report = json(&succeed(&mut site.shape("cluster", &mixed, &["--json", "-o", "e.csv"])));
    assert!(report["warnings"][0].as_str().is_some_and(|text| text.contains("degrees from 1 to 8")), "{report}");
    let error = fail(&mut site.shape("cluster", &models[..2], &["-o", "d.csv"]));
    assert!(error.contains("expected three models or more, found 2"), "{error}");
}
