//! `shape compress` and `shape expand`: their outputs, bad files, and a reader written from the documentation of the
//! format.

use std::path::{Path, PathBuf};
use std::process::Command;

use ndarray::Array2;
use serde_json::Value;
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::{basis_size, degree_order};
use spharm_model::Model;
use spharm_surface::{Kind, Sphere};

use crate::common::{fail, finish, root, succeed, text, tool};

/// A folder with a bumpy model of degree 20 over its own sphere, and a signal of two channels.
struct Site(tempfile::TempDir);

impl Site {
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        std::fs::create_dir(site.path("models")).expect("a folder");
        let values = |channels| {
            Array2::from_shape_fn((basis_size(20), channels), |(k, c)| {
                let degree = degree_order(k).0.max(1) as f64;
                let bump = 3.0 * ((k * k % 97 + c * 31) as f64 * 0.71).sin() * degree.powf(-2.5);
                bump + if [3, 1, 2].get(c) == Some(&k) { 10.0 } else { 0.0 }
            })
        };
        for (name, channels, kind) in [("bumpy", 3, Kind::Surface), ("signal", 2, Kind::Signal)] {
            let coefficients = Coefficients::new(values(channels)).expect("a degree");
            let model = Model::new(Sphere::icosphere(3), coefficients, kind);
            model.write(site.path(&format!("models/{name}.spharm.npz"))).expect("a model");
        }
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn shape(&self, arguments: &[&str]) -> Command {
        let mut command = tool("shape");
        command.args(arguments).arg("-q").current_dir(self.0.path());
        command
    }

    fn report(&self, arguments: &[&str]) -> Value {
        let text = succeed(self.shape(arguments).arg("--json"));
        serde_json::from_str(&text).expect("JSON")
    }

    fn read(&self, name: &str) -> Model {
        Model::read(self.path(name)).expect("a model")
    }
}

#[test]
fn models_are_compressed_to_a_distance_and_expanded() {
    let site = Site::new();
    let report = site.report(&["compress", "models", "--tolerance", "1e-3", "-o", "small"]);
    for (number, name) in ["bumpy", "signal"].into_iter().enumerate() {
        let file = &report["files"][number];
        let distance = file["distance"].as_f64().expect("a distance");
        assert!(distance > 0.9e-3 && distance <= 1e-3, "{report}");
        let bytes = std::fs::metadata(site.path(&format!("small/{name}.sphz"))).expect("a file").len();
        assert_eq!(file["bytes"].as_u64(), Some(bytes));
    }
    assert_eq!(report["tool"], "shape compress");
    let report = site.report(&["expand", "small", "-o", "large"]);
    assert_eq!(report["models"][0]["degree"], 20);
    let (model, found) = (site.read("models/bumpy.spharm.npz"), site.read("large/bumpy.spharm.npz"));
    let largest = model.coefficients.values().iter().zip(found.coefficients.values());
    assert!(largest.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 0.05);
    assert_eq!((found.sphere.is_none(), found.kind()), (true, Kind::Surface));
    assert_eq!(found.provenance.tool.as_deref(), Some("shape compress"));
    assert_eq!(site.read("large/signal.spharm.npz").kind(), Kind::Signal);
    let mut reconstruct = tool("reconstruct");
    reconstruct.arg("--model").arg(site.path("large/bumpy.spharm.npz")).args(["--icosphere", "3", "-q", "-o"]);
    succeed(reconstruct.arg(site.path("mesh.ply")));
}

#[test]
fn a_beginning_of_a_file_is_taken_when_it_is_asked_for() {
    let site = Site::new();
    let bumpy = "models/bumpy.spharm.npz";
    let report = site.report(&["compress", bumpy, "--bytes", "1500", "--bare", "--levels", "4,8", "-o", "a.sphz"]);
    let levels = report["files"][0]["levels"].as_array().expect("levels");
    assert_eq!(levels.iter().map(|level| level["degree"].as_u64()).collect::<Vec<_>>(), [Some(4), Some(8), Some(20)]);
    let bytes = std::fs::read(site.path("a.sphz")).expect("a file");
    assert!(bytes.len() <= 1500 && bytes.len() > 1450, "{}", bytes.len());
    let end = levels[1]["bytes"].as_u64().expect("bytes") as usize;
    std::fs::write(site.path("cut.sphz"), &bytes[..end + 3]).expect("a file");
    let error = fail(&mut site.shape(&["expand", "cut.sphz", "-o", "cut.npz"]));
    assert!(error.contains("cut.sphz") && error.contains("truncated") && error.contains("degree 8"), "{error}");
    assert!(error.contains("give --prefix"), "{error}");
    succeed(&mut site.shape(&["expand", "cut.sphz", "--prefix", "-o", "cut.npz"]));
    succeed(&mut site.shape(&["expand", "a.sphz", "--max-degree", "8", "-o", "eight.npz"]));
    assert_eq!(site.read("cut.npz").coefficients, site.read("eight.npz").coefficients);
    let error = fail(&mut site.shape(&["expand", "a.sphz", "--max-degree", "21", "-o", "no.npz"]));
    assert!(error.contains("degree 20") && error.contains("--max-degree 21"), "{error}");
}

#[test]
fn bad_files_and_settings_are_refused() {
    let site = Site::new();
    let bumpy = "models/bumpy.spharm.npz";
    for (arguments, what) in [
        (["--tolerance", "0"], "tolerance"),
        (["--tolerance", "nan"], "tolerance"),
        (["--bytes", "40"], "too few"),
        (["--step", "1e-12"], "too fine"),
    ] {
        let error = fail(site.shape(&["compress", bumpy, "-o", "a.sphz"]).args(arguments));
        assert!(error.contains("bumpy") && error.contains(what), "{error}");
    }
    for bytes in ["34", "37"] {
        // A file this small would hold a point.
        let compress =
            |bytes: &str| site.shape(&["compress", bumpy, "--bare", "--force", "-o", "c.sphz", "--bytes", bytes]);
        let error = fail(&mut compress(bytes));
        let least = error.split("the smallest possible file has ").nth(1).and_then(|rest| rest.split(' ').next());
        succeed(&mut compress(least.expect("a number")));
    }
    assert_eq!(finish(&mut site.shape(&["compress", bumpy, "-o", "a.sphz"])).status.code(), Some(2));
    let error = fail(&mut site.shape(&["compress", bumpy, "--step", "1e-3", "-o", "a.npz"]));
    assert!(error.contains(".sphz"), "{error}");
    succeed(&mut site.shape(&["compress", bumpy, "--step", "1e-3", "-o", "a.sphz"]));
    let error = fail(&mut site.shape(&["compress", bumpy, "--step", "1e-3", "-o", "a.sphz"]));
    assert!(error.contains("--force"), "{error}");
    let mut bytes = std::fs::read(site.path("a.sphz")).expect("a file");
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(site.path("damaged.sphz"), &bytes).expect("a file");
    let error = fail(&mut site.shape(&["expand", "damaged.sphz", "-o", "b.npz"]));
    assert!(error.contains("damaged.sphz") && error.contains("checksum"), "{error}");
    let error = fail(&mut site.shape(&["expand", bumpy, "-o", "b.npz"]));
    assert!(error.contains("not a compressed model"), "{error}");
    std::fs::write(site.path("a.sphz.gz"), b"\x1f\x8b\x08\x00").expect("a file");
    let error = fail(&mut site.shape(&["expand", "a.sphz.gz", "-o", "b.npz"]));
    assert!(error.contains("a.sphz.gz: expected a compressed model, found a gzipped file"), "{error}");
    let error = fail(&mut site.shape(&["expand", "-", "-o", "b.npz"]));
    assert!(error.contains("standard input isn't supported"), "{error}");
    for verb in ["measure", "describe"] {
        let error = fail(&mut site.shape(&[verb, "a.sphz"]));
        assert!(error.contains("a.sphz: the file is a compressed model") && error.contains("shape expand"), "{error}");
    }
    assert!(!site.path("b.npz").exists());
}

/// Returns Python with NumPy, or `None` with a message if it isn't available.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("SPHARM_PYTHON").map(PathBuf::from);
    if python.is_none() {
        eprintln!("skipped: no Python reader here (SPHARM_PYTHON is not set; ./run test sets it)");
    }
    python
}

fn reader(python: &Path, file: &Path, out: &Path) -> Command {
    let mut command = Command::new(python);
    // Without -B, Python would write a cache folder into the sources.
    command.arg("-B").arg(root().join("tests/scripts/read_sphz.py")).arg(file).arg(out);
    command
}

/// Returns the rows of values in an .npy file of f64.
fn npy(path: &Path) -> Vec<f64> {
    let bytes = std::fs::read(path).expect("the array");
    assert_eq!(bytes[..8], *b"\x93NUMPY\x01\x00");
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = String::from_utf8_lossy(&bytes[10..start]).into_owned();
    assert!(header.contains("'descr': '<f8'") && header.contains("'fortran_order': False"), "{header}");
    bytes[start..].chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().expect("8 bytes"))).collect()
}

#[test]
fn a_reader_written_from_the_page_finds_the_same_bits() {
    let Some(python) = python() else { return };
    let site = Site::new();
    succeed(&mut site.shape(&["compress", "models", "--tolerance", "3e-4", "-o", "small"]));
    succeed(&mut site.shape(&["expand", "small", "-o", "small"]));
    let golden = root().join("tests/data/sphz-v1");
    let out = site.path("out.npy");
    for (folder, name) in
        [(site.path("small"), "bumpy"), (site.path("small"), "signal"), (golden.clone(), "surface"), (golden, "signal")]
    {
        succeed(&mut reader(&python, &folder.join(format!("{name}.sphz")), &out));
        let ours = Model::read(folder.join(format!("{name}.spharm.npz"))).expect("a model");
        let same = npy(&out).iter().zip(ours.coefficients.values()).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same && npy(&out).len() == ours.coefficients.values().len(), "{name}");
    }
}

#[test]
fn it_refuses_what_is_damaged() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = std::fs::read(root().join("tests/data/sphz-v1/surface.sphz")).expect("a file");
    let copy = folder.path().join("copy.sphz");
    // Change one byte of each part: the magic number, the version, the head, the stream.
    for (at, what) in [
        (1, "magic"),
        (4, "version 0, not 1"),
        (20, "checksum of the head"),
        (bytes.len() - 2, "checksum of a segment"),
    ] {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1;
        std::fs::write(&copy, damaged).expect("a file");
        let output = finish(&mut reader(&python, &copy, &folder.path().join("out.npy")));
        assert_eq!(output.status.code(), Some(1), "{}", text(&output));
        assert!(text(&output).contains(what), "{what}: {}", text(&output));
    }
}
