//! Tests values and weights whose products exceed the range of f64, and meshes with vertices of high valence.

use std::path::PathBuf;
use std::process::Command;

use ndarray::Array2;
use serde_json::Value;
use spharm_model::Model;
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, bipyramid, cortex};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::range::times;

use crate::common::{fail, root, succeed, tool};

/// Exponents of scales around 1e-300, 1e-170, 1e-57, 1e-39, 1e26, 1e28, 1e154 and 1e300.
const EXPONENTS: [i32; 8] = [-990, -564, -190, -130, 88, 94, 512, 990];

/// A folder with a surface, `s0.ply`, the same surface at all scales, and their sphere with a store.
struct Scales {
    folder: tempfile::TempDir,
}

impl Scales {
    fn new() -> Self {
        let scales = Self { folder: tempfile::tempdir().expect("a folder") };
        let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
        let options = WriteOptions { double: true, ..WriteOptions::default() };
        write_mesh(scales.path("sphere.ply"), &sphere, &options).expect("a sphere");
        for exponent in EXPONENTS.into_iter().chain([0]) {
            write_mesh(scales.path(&format!("s{exponent}.ply")), &scaled(&surface, exponent), &options)
                .expect("a mesh");
        }
        let mut build = tool("basis-build");
        build.arg("--sphere").arg(scales.path("sphere.ply")).arg("--store").arg(scales.path("store"));
        succeed(build.args(["-q", "--max-degree", "6"]));
        scales
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns a fit of a file over the sphere, with output `m.npz`.
    fn fit(&self, file: &str, arguments: &[&str]) -> Command {
        let mut command = tool("fit");
        command.current_dir(self.folder.path()).args(["--sphere", "sphere.ply", "--surface", file, "-o", "m.npz"]);
        command.args(["--max-degree", "6", "--json", "--force", "-q"]).args(arguments);
        command
    }

    fn fitted(&self, file: &str, arguments: &[&str]) -> (Array2<f64>, Value) {
        let report = serde_json::from_str(&succeed(&mut self.fit(file, arguments))).expect("JSON");
        (Model::read(self.path("m.npz")).expect("a model").coefficients.values().to_owned(), report)
    }
}

fn scaled(mesh: &Mesh, exponent: i32) -> Mesh {
    mesh.with_vertices(mesh.vertices.iter().map(|vertex| vertex.map(|x| times(x, exponent))).collect())
}

/// Returns the results of the last pass.
fn last(report: &Value) -> &Value {
    report["surfaces"][0]["passes"].as_array().and_then(|passes| passes.last()).expect("a sweep")
}

#[test]
fn a_surface_of_any_size_gets_the_digits_of_one_of_size_one() {
    let scales = Scales::new();
    let store = ["--store", "store"];
    let methods: [&[&str]; 9] = [
        &[],
        &["--objective", "vertices"],
        &["--objective", "vertices", "--stderr"],
        &["--smoothness", "0.01"],
        &["--objective", "vertices", "--smoothness", "auto"],
        &["--denoise"],
        &["--method", "quadrature"],
        &["--method", "irf", "--granularity", "9", "--passes", "2"],
        &["--method", "nlsf"],
    ];
    for arguments in methods {
        let over_store = arguments.contains(&"irf") || arguments.contains(&"nlsf");
        let arguments = [arguments, if over_store { &store[..] } else { &[] }].concat();
        let (expected, report) = scales.fitted("s0.ply", &arguments);
        let rms = last(&report)["msd_raw"].as_f64().expect("a number").sqrt();
        for exponent in EXPONENTS {
            let (found, report) = scales.fitted(&format!("s{exponent}.ply"), &arguments);
            let same = found.iter().zip(&expected).all(|(a, b)| a.to_bits() == times(*b, exponent).to_bits());
            assert!(same, "{arguments:?} at 2^{exponent}");
            let figure = |name: &str| last(&report)[name].as_f64();
            let reported = figure("rms_raw").or(figure("msd_raw").map(f64::sqrt)).expect("a number");
            assert!((times(reported, -exponent) / rms - 1.0).abs() < 1e-12, "{arguments:?}: {report}");
        }
    }
}

#[test]
fn a_surface_of_any_size_is_fitted_without_a_sphere() {
    let scales = Scales::new();
    let fitted = |exponent: i32| {
        let mut command = tool("fit");
        command.arg("--surface").arg(scales.path(&format!("s{exponent}.ply"))).arg("-o").arg(scales.path("bare.npz"));
        succeed(command.args(["--max-degree", "6", "--force", "-q"]));
        Model::read(scales.path("bare.npz")).expect("a model").coefficients.values().to_owned()
    };
    let expected = fitted(0);
    let largest = expected.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
    for exponent in EXPONENTS {
        let found = fitted(exponent);
        let near = |(a, b): (&f64, &f64)| (times(*a, -exponent) - b).abs() < 1e-9 * largest;
        assert!(found.iter().zip(&expected).all(near), "2^{exponent}");
    }
}

#[test]
fn each_channel_of_a_signal_has_a_range_of_its_own_and_perfect_is_only_what_is() {
    let scales = Scales::new();
    let signal = |name: &str, factors: [f64; 2]| {
        let rows = (0..162).map(|i| [0.7, 1.9].map(|x| (x * f64::from(i)).sin()));
        let text: String = rows.map(|[a, b]| format!("{:e},{:e}\n", factors[0] * a, factors[1] * b)).collect();
        std::fs::write(scales.path(name), text).expect("a signal");
    };
    signal("one.csv", [1.0, 1.0]);
    signal("apart.csv", [times(1.0, -990), times(1.0, 990)]);
    signal("zero.csv", [0.0, 0.0]);
    let (one, _) = scales.fitted("one.csv", &[]);
    let (apart, report) = scales.fitted("apart.csv", &[]);
    for (found, exponent) in apart.columns().into_iter().zip([-990, 990]) {
        let same = |(a, b): (&f64, &f64)| (times(*a, -exponent) - b).abs() < 1e-9;
        assert!(found.iter().zip(one.columns().into_iter().nth(usize::from(exponent > 0)).unwrap()).all(same));
    }
    assert!(last(&report)["rms_raw"].as_f64().is_some_and(|rms| rms > times(0.1, 990)), "{report}");
    let (zero, report) = scales.fitted("zero.csv", &[]);
    assert!(zero.iter().all(|a| *a == 0.0) && last(&report)["msd_raw"] == 0.0);
    // Coefficients beyond the range of f64 are refused, and no model is written.
    std::fs::remove_file(scales.path("m.npz")).expect("a model");
    signal("ends.csv", [1.0, 1.0]);
    std::fs::write(scales.path("ends.csv"), "1.7e308\n".repeat(162)).expect("a signal");
    assert!(fail(&mut scales.fit("ends.csv", &[])).contains("coefficient"));
    assert!(!scales.path("m.npz").exists());
}

#[test]
fn weights_count_by_what_they_are_to_each_other() {
    let scales = Scales::new();
    // The weights have so few significant bits that subnormal numbers represent them exactly.
    let weights = |name: &str, exponent: i32| {
        let text: String = (0..162).map(|i| format!("{:e}\n", times(f64::from(1 + i % 5), exponent))).collect();
        std::fs::write(scales.path(name), text).expect("weights");
    };
    weights("one.csv", 0);
    weights("least.csv", -1066);
    weights("most.csv", 1020);
    weights("little.csv", -150);
    weights("much.csv", 90);
    let store = ["--store", "store", "--method"];
    let methods: [&[&str]; 4] =
        [&[], &["--objective", "vertices", "--stderr"], &["--denoise"], &[&store[..], &["irf"][..]].concat()];
    for arguments in methods {
        let with = |weights: &str| {
            let arguments = [arguments, &["--weights", weights]].concat();
            scales.fitted("s0.ply", &arguments)
        };
        let (expected, report) = with("one.csv");
        for weights in ["least.csv", "little.csv", "much.csv", "most.csv"] {
            let (found, scaled) = with(weights);
            assert_eq!(found, expected, "{arguments:?} {weights}");
            assert_eq!(last(&scaled)["msd"], last(&report)["msd"]);
        }
    }
}

#[test]
fn surfaces_of_any_size_are_compared_and_mapped() {
    let scales = Scales::new();
    let (surface, _) = cortex(&Cortex { subdivisions: 2, variant: 1 });
    let options = WriteOptions { double: true, ..WriteOptions::default() };
    let compare = |exponent: i32| -> Value {
        let other = scales.path(&format!("other{exponent}.ply"));
        write_mesh(&other, &scaled(&surface, exponent), &options).expect("a mesh");
        let mut command = tool("compare");
        command.arg(scales.path(&format!("s{exponent}.ply"))).arg(other);
        serde_json::from_str(&succeed(command.args(["--surface-distance", "--samples", "2000", "--json"])))
            .expect("JSON")
    };
    let map = |exponent: i32| {
        let (input, output) = (scales.path(&format!("s{exponent}.ply")), scales.path("map.ply"));
        let mut command = tool("parametrize");
        succeed(command.arg("--surface").arg(input).arg("-o").arg(&output).args(["--force", "-q"]));
        std::fs::read(output).expect("a sphere")
    };
    let (expected, sphere) = (compare(0), map(0));
    for exponent in EXPONENTS {
        let found = compare(exponent);
        for figure in ["msd", "xsd"] {
            let [a, b] = [&found, &expected].map(|report| report[figure].as_f64().expect("a number"));
            assert!((a / b - 1.0).abs() < 1e-12, "{figure}: {a} {b}");
        }
        for (figure, part) in [("rms_raw", &found), ("hausdorff", &found["surface_distance"])] {
            let whole = if figure == "rms_raw" { &expected } else { &expected["surface_distance"] };
            let [a, b] = [part, whole].map(|report| report[figure].as_f64().expect("a number"));
            assert!((times(a, -exponent) / b - 1.0).abs() < 1e-12, "{figure}: {a} {b}");
        }
        assert_eq!(map(exponent), sphere, "2^{exponent}");
    }
}

#[test]
fn sums_of_squares_that_leave_the_range_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = folder.path().join("t.csv");
    for (value, weight, clear) in [
        ("1", "1", true),
        ("1e-45", "1", true),
        ("1e-170", "1", false),
        ("1e200", "1", false),
        ("1e-290", "1e-300", false),
        ("1", "1e-45", true),
        ("1", "1e-200", true),
    ] {
        let rows = (0..50).map(|i| {
            let (i, sine) = (f64::from(i), 1.0 - (2.0 * f64::from(i) + 1.0) / 50.0);
            format!("{},{},{value},{weight}\n", (137.5 * i) % 360.0, sine.asin().to_degrees())
        });
        std::fs::write(&table, format!("lon,lat,f,w\n{}", rows.collect::<String>())).expect("a table");
        let run = |arguments: &[&str]| {
            let mut command = tool(arguments[0]);
            command.current_dir(folder.path()).args(&arguments[1..]);
            command
        };
        let mut sums = run(&["moments", "--samples", "t.csv", "--values", "f", "--weight", "w", "--max-degree", "2"]);
        sums.args(["-o", "m.moments", "--force", "-q"]);
        if !clear {
            assert!(fail(&mut sums).contains("squares"), "{value} {weight}");
            continue;
        }
        succeed(&mut sums);
        succeed(&mut run(&["fit", "--moments", "m.moments", "--max-degree", "2", "-o", "m.npz", "--force", "-q"]));
        let model = Model::read(folder.path().join("m.npz")).expect("a model");
        let constant = value.parse::<f64>().expect("a number") * (4.0 * std::f64::consts::PI).sqrt();
        assert!((model.coefficients.values()[[0, 0]] / constant - 1.0).abs() < 1e-8, "{value} {weight}");
    }
}

#[test]
fn a_vertex_of_high_degree_is_mapped_compared_and_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let [surface, sphere, picture] = ["fan.ply", "map.ply", "fan.png"].map(|name| folder.path().join(name));
    write_mesh(&surface, &bipyramid(2500), &WriteOptions { double: true, ..WriteOptions::default() }).expect("a mesh");
    succeed(tool("parametrize").arg("--surface").arg(&surface).arg("-o").arg(&sphere).arg("-q"));
    let found = read_mesh(&sphere).expect("a sphere");
    assert!(spharm_parametrize::Quality::of(&read_mesh(&surface).expect("a mesh"), &found).is_bijective());
    let mut compare = tool("compare");
    let text = succeed(compare.arg(&surface).arg(&surface).args(["--surface-distance", "--samples", "5000", "--json"]));
    let report: Value = serde_json::from_str(&text).expect("JSON");
    assert!(report["surface_distance"]["hausdorff"].as_f64().expect("a number") < 1e-12, "{report}");
    succeed(tool("picture").arg(&surface).arg("-o").arg(&picture).args(["--size", "120"]));
}

#[test]
fn degrees_far_above_what_vertices_determine_are_fitted_or_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("tetrahedron.ply");
    let vertices = vec![[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]];
    let faces = vec![[0, 1, 3], [0, 2, 1], [0, 3, 2], [1, 2, 3]];
    write_mesh(&path, &Mesh::new(vertices, faces), &WriteOptions::default()).expect("a mesh");
    let fit = |degree: &str, arguments: &[&str]| {
        let mut command = tool("fit");
        command.arg("--surface").arg(&path).arg("--sphere").arg(&path).arg("-o").arg(folder.path().join("m.npz"));
        command.args(["--max-degree", degree, "--json", "--force", "-q"]).args(arguments);
        command
    };
    let refused = fail(&mut fit("300", &["--objective", "vertices", "--smoothness", "auto"]));
    assert!(refused.contains("4 for 90601"), "{refused}");
    // A fit of the surface takes samples equally dense on large and small triangles of the sphere, so it converges
    // fast.
    let report: Value = serde_json::from_str(&succeed(&mut fit("60", &[]))).expect("JSON");
    let iterations = report["batches"][0]["iterations"].as_u64().expect("a number");
    assert!(iterations < 60 && report["batches"][0]["stop"] == "converged", "{report}");
}

/// Compares the methods of `fit` with least squares in 50 digits, on a few of the problems of `./run attack`.
#[test]
fn every_method_holds_against_fifty_digits() {
    let Some(python) = std::env::var_os("SPHARM_PYTHON") else {
        eprintln!("skipped: no Python here (SPHARM_PYTHON is not set; ./run test sets it)");
        return;
    };
    let mut command = Command::new(python);
    command.arg(root().join("tests/attack/numerics.py")).arg(env!("CARGO_BIN_EXE_spharm"));
    let text = succeed(command.args(["--problems", "6"]));
    let row: Value = serde_json::from_str(text.lines().last().expect("a row")).expect("JSON");
    assert!(row["failures"] == 0 && row["cases"].as_u64().is_some_and(|cases| cases > 30), "{row}");
}
