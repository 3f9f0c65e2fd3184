//! Tests `export` and `import`: round trips in every format, genuine files of other packages, and bad files.

use std::path::PathBuf;
use std::process::Command;

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_surface::io::read_mesh;
use spharm_surface::{Kind, Sphere};

use crate::common::{fail, finish, shared, succeed, text, tool};

struct Site(tempfile::TempDir);

impl Site {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a model whose coefficients decrease with the degree.
    fn model(&self, name: &str, degree: usize, channels: usize) -> Model {
        let values = Array2::from_shape_fn(((degree + 1).pow(2), channels), |(k, c)| {
            10.0 * ((k * 7 + c * 3 + 1) as f64 * 0.37).sin() / (1.0 + (k as f64).sqrt())
        });
        let kind = if channels == 3 { Kind::Surface } else { Kind::Signal };
        let model = Model::new(Sphere::icosphere(2), Coefficients::new(values).expect("a degree"), kind);
        model.write(self.path(name)).expect("a model");
        model
    }

    fn run(&self, verb: &str, arguments: &[&str]) -> Command {
        let mut command = tool(verb);
        command.current_dir(self.0.path()).args(arguments);
        command
    }
}

fn relative(found: &Model, known: &Model) -> f64 {
    let (found, known) = (found.coefficients.values(), known.coefficients.values());
    assert_eq!(found.dim(), known.dim());
    let largest = known.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    found.iter().zip(known).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs())) / largest
}

#[test]
fn every_format_gives_the_model_back() {
    let site = Site::new();
    for (degree, bar) in [(20, 1e-13), (100, 1e-12)] {
        let known = site.model(&format!("{degree}.spharm.npz"), degree, 3);
        for (format, ending, named) in [
            ("pdm", "coef", false),
            ("mat", "mat", false),
            ("pyshtools", "sh", false),
            ("healpy", "fits", false),
            ("s2fft", "npy", false),
            ("ktch", "npy", true),
            ("flowshape", "npy", true),
            ("afni", "1D", true),
            ("csv", "csv", false),
            ("json", "json", false),
        ] {
            let stem = format!("{format}{degree}");
            let file = format!("{stem}.{ending}");
            succeed(&mut site.run("export", &[&format!("{degree}.spharm.npz"), "--to", format, "-o", &file]));
            let axes = ["x", "y", "z"].map(|axis| format!("{stem}.{axis}.{ending}"));
            let files = if ["pyshtools", "afni"].contains(&format) { axes.to_vec() } else { vec![file] };
            let back = format!("{stem}.npz");
            let mut import = site.run("import", &["-o", &back]);
            if named {
                import.args(["--from", format]);
            }
            let said = succeed(import.args(&files));
            assert!(said.contains(&format!("{format}, degree {degree}, 3 channels")), "{said}");
            let back = Model::read(site.path(&back)).expect("a model");
            assert!(relative(&back, &known) <= bar, "{format} {degree}: {}", relative(&back, &known));
            assert_eq!(back.sphere.is_some(), format == "mat");
        }
    }
}

#[test]
fn a_folder_of_models_is_exported_and_nothing_is_replaced() {
    let site = Site::new();
    std::fs::create_dir(site.path("models")).expect("a folder");
    site.model("models/a.spharm.npz", 4, 3);
    site.model("models/b.spharm.npz", 4, 3);
    succeed(&mut site.run("export", &["models", "--to", "pyshtools", "-o", "sh"]));
    for name in ["a.x.sh", "a.y.sh", "a.z.sh", "b.x.sh"] {
        assert!(site.path("sh").join(name).exists(), "{name}");
    }
    let said = fail(&mut site.run("export", &["models", "--to", "pyshtools", "-o", "sh"]));
    assert!(said.contains("exists") && said.contains("--force"), "{said}");
    succeed(&mut site.run("export", &["models", "--to", "pyshtools", "-o", "sh", "--force"]));
    // The file doesn't record its normalisation, so `import` needs --normalization too.
    succeed(
        &mut site.run("export", &["models/a.spharm.npz", "--to", "pyshtools", "--normalization", "4pi", "-o", "g"]),
    );
    succeed(&mut site.run("import", &["g.x", "g.y", "g.z", "--normalization", "4pi", "-o", "g.npz"]));
    // What was assumed instead is said.
    let options: [(&[&str], &str); 2] = [(&[], "ortho"), (&["--normalization", "4pi"], "4pi")];
    for (more, name) in options {
        let output = finish(site.run("import", &["g.x", "g.y", "g.z", "-o", "said.npz", "--force"]).args(more));
        assert!(
            text(&output).contains(&format!("assumed --normalization {name} and --csphase 1")),
            "{}",
            text(&output)
        );
    }
    let [back, known] = ["g.npz", "models/a.spharm.npz"].map(|name| Model::read(site.path(name)).expect("a model"));
    assert!(relative(&back, &known) < 1e-14);
}

#[test]
fn names_of_other_formats_are_refused() {
    let site = Site::new();
    site.model("m.npz", 3, 3);
    for (format, name, expected) in [
        ("healpy", "Alm.NPY", "(the name is \"Alm.NPY\"): expected a name that ends in .fits or .fit"),
        ("pyshtools", "m.npy", "expected a name that ends in .sh or .txt or .dat"),
        ("csv", "m.json", "expected a name that ends in .csv"),
    ] {
        let said = fail(&mut site.run("export", &["m.npz", "--to", format, "-o", name]));
        assert!(said.contains("--output") && said.contains(expected), "{said}");
    }
    assert!(!site.path("Alm.NPY").exists() && !site.path("m.x.npy").exists());
    for (format, name) in [("healpy", "alm"), ("healpy", "Alm.FITS"), ("afni", "m.1D")] {
        succeed(&mut site.run("export", &["m.npz", "--to", format, "-o", name]));
    }
}

#[test]
fn what_a_format_cannot_hold_is_refused_with_the_reason() {
    let site = Site::new();
    site.model("surface.npz", 3, 3);
    site.model("radius.npz", 3, 1);
    for (model, format, why) in [
        ("radius.npz", "pdm", "SPHARM-PDM files can only hold surfaces (3 channels), but the model has 1"),
        ("radius.npz", "mat", "SPHARM-MAT files can only hold surfaces (3 channels), but the model has 1"),
        ("surface.npz", "aics", "radius of a star-shaped body"),
    ] {
        let said = fail(&mut site.run("export", &[model, "--to", format, "-o", "x"]));
        assert!(said.contains(why) && said.contains(model), "{said}");
        assert!(!site.path("x").exists());
    }
    succeed(&mut site.run("export", &["radius.npz", "--to", "aics", "-o", "r.csv"]));
    let table = std::fs::read_to_string(site.path("r.csv")).expect("a table");
    assert!(table.starts_with("shcoeffs_L0M0C,shcoeffs_L0M1C,shcoeffs_L0M2C,") && table.lines().count() == 2);
    let said = fail(&mut site.run("import", &["r.csv", "-o", "r.npz"]));
    assert!(said.contains("can be exported, but not imported"), "{said}");
    site.model("high.npz", 90, 3);
    let output = finish(&mut site.run("export", &["high.npz", "--to", "pdm", "-o", "high.coef"]));
    assert!(
        output.status.success() && text(&output).contains("warning: high.npz: degree 90: SPHARM-PDM"),
        "{}",
        text(&output)
    );
}

/// A genuine file of SPHARM-PDM describes the surface that SPHARM-PDM wrote beside it, with six decimals: it evaluated
/// the coefficients on its icosphere, at the antipodes of the vertices.
#[test]
fn a_genuine_file_of_spharm_pdm_is_its_surface() {
    let (Some(coef), Some(meta)) =
        (shared("peers/a01_l_hippo.ellalign.coef"), shared("peers/a01_l_hippo.ellalign.meta"))
    else {
        return;
    };
    let site = Site::new();
    let said = succeed(&mut site.run("import", &[coef.to_str().expect("a name"), "-o", "m.npz"]));
    assert!(said.contains("pdm, degree 12, 3 channels"), "{said}");
    let model = Model::read(site.path("m.npz")).expect("a model");
    let surface = read_mesh(meta).expect("a mesh");
    // Every hundredth vertex is compared with the nearest point of a fine evaluation.
    let fine = model.reconstruct(&Sphere::icosphere(6), 12).expect("a surface");
    for vertex in surface.vertices.iter().step_by(100) {
        let distance = |p: &[f64; 3]| (0..3).map(|k| (p[k] - vertex[k]).powi(2)).sum::<f64>();
        let nearest = fine.vertices.iter().map(distance).fold(f64::INFINITY, f64::min).sqrt();
        assert!(nearest < 0.3, "{nearest}");
    }
}

/// SPHARM-MAT's 20 hippocampi are published as its models: fvec was fitted to the surface's vertices over its sphere.
#[test]
fn a_genuine_file_of_spharm_mat_is_read_with_its_sphere() {
    let Some(mat) = shared("peers/a01_l_hippo.des.mat") else { return };
    let site = Site::new();
    let said = succeed(&mut site.run("import", &[mat.to_str().expect("a name"), "-o", "m.npz"]));
    assert!(said.contains("mat, degree 15, 3 channels, a sphere of "), "{said}");
    let model = Model::read(site.path("m.npz")).expect("a model");
    if let Some(csv) = shared("hippo_a01_l.degree15.fvec.csv") {
        succeed(&mut site.run("import", &[csv.to_str().expect("a name"), "-o", "csv.npz"]));
        let table = Model::read(site.path("csv.npz")).expect("a model");
        assert!(relative(&table, &model) < 1e-13, "{}", relative(&table, &model));
    }
    succeed(&mut site.run("reconstruct", &["--model", "m.npz", "-o", "surface.ply"]));
    succeed(&mut site.run("export", &["m.npz", "--to", "mat", "-o", "again.mat"]));
    succeed(&mut site.run("import", &["again.mat", "-o", "again.npz"]));
    let again = Model::read(site.path("again.npz")).expect("a model");
    assert_eq!(again.sphere.map(|sphere| sphere.faces), model.sphere.map(|sphere| sphere.faces));
}

#[test]
fn coefficients_of_another_package_are_refused_where_models_are_wanted() {
    let site = Site::new();
    site.model("a.npz", 3, 3);
    for name in ["a.coef", "b.coef", "c.coef"] {
        succeed(&mut site.run("export", &["a.npz", "--to", "pdm", "-o", name]));
    }
    let said = fail(&mut site.run("shape", &["align", "a.coef", "b.coef", "c.coef", "--group", "-o", "al"]));
    assert!(said.contains("a.coef: expected a model or a mesh") && said.contains("spharm import"), "{said}");
    // A mesh may have any name, but an aligned mesh needs a known extension.
    succeed(&mut site.run("reconstruct", &["--model", "a.npz", "-o", "a.ply"]));
    for name in ["a.txt", "b.txt"] {
        std::fs::copy(site.path("a.ply"), site.path(name)).expect("a mesh");
    }
    let said = fail(&mut site.run("shape", &["align", "a.txt", "b.txt", "--group", "-o", "al"]));
    assert!(!said.contains("coefficients"), "{said}");
    succeed(&mut site.run("shape", &["align", "a.ply", "--to", "b.txt", "-o", "al.ply"]));
    let said = fail(&mut site.run("import", &["a.coef", "b.coef", "c.coef", "-o", "three.npz"]));
    assert!(said.contains("a.coef: the file has 3 channels") && !site.path("three.npz").exists(), "{said}");
}

#[test]
fn channels_of_a_model_are_of_one_format_and_degree() {
    let site = Site::new();
    site.model("three.npz", 3, 3);
    site.model("two.npz", 2, 3);
    succeed(&mut site.run("export", &["three.npz", "--to", "pyshtools", "-o", "a.sh"]));
    succeed(&mut site.run("export", &["two.npz", "--to", "pyshtools", "-o", "b.sh"]));
    succeed(&mut site.run("export", &["three.npz", "--to", "csv", "-o", "c.csv"]));
    for (files, expected) in [
        (["a.x.sh", "c.csv"], "c.csv: the file is a table of coefficients, but a.x.sh is an SHTOOLS text file"),
        (["a.x.sh", "b.y.sh"], "b.y.sh: the file has degree 2, but a.x.sh has degree 3"),
    ] {
        let said = fail(&mut site.run("import", &[files[0], files[1], "-o", "x.npz"]));
        assert!(said.contains(expected), "{said}");
    }
    let two = finish(&mut site.run("import", &["a.x.sh", "a.y.sh", "-o", "y.npz"]));
    assert!(text(&two).contains("2 channels: imported as a signal, because a surface has 3"), "{}", text(&two));
    // Test a table without its third row, and a table truncated at the end.
    let table = std::fs::read_to_string(site.path("c.csv")).expect("a table");
    let lines: Vec<&str> = table.lines().collect();
    for (kept, expected) in [
        ([&lines[..3], &lines[4..]].concat(), "expected degree 1, order 0 on line 4, found \"1,1,"),
        (
            lines[..16].to_vec(),
            "expected a row for each order of every degree, found 15 rows with an incomplete last degree",
        ),
    ] {
        std::fs::write(site.path("d.csv"), kept.join("\n")).expect("written");
        let said = fail(&mut site.run("import", &["d.csv", "-o", "z.npz"]));
        assert!(said.contains(expected) && said.matches("expected").count() == 1, "{said}");
    }
}

#[test]
fn damaged_files_get_one_line_that_names_them() {
    let site = Site::new();
    site.model("m.npz", 5, 3);
    let exports = [
        ("pdm", "x.coef"),
        ("mat", "x.mat"),
        ("healpy", "x.fits"),
        ("s2fft", "x.npy"),
        ("csv", "x.csv"),
        ("json", "x.json"),
    ];
    for (format, file) in exports {
        succeed(&mut site.run("export", &["m.npz", "--to", format, "-o", file]));
        let whole = std::fs::read(site.path(file)).expect("a file");
        // The cut must be in the first part of a FITS file: the file ends in padding, and without its last tables it is
        // a valid file of fewer channels.
        let part = if format == "healpy" { 4 } else { 1 };
        for cut in [0, 1, 7, 100, whole.len() / 3 / part, whole.len() * 9 / 10 / part] {
            std::fs::write(site.path("cut"), &whole[..cut]).expect("written");
            let said = fail(&mut site.run("import", &["cut", "--from", format, "-o", "y.npz"]));
            assert!(said.starts_with("error: cut: "), "{format} {cut}: {said}");
        }
    }
    for (name, contents) in [("text", "hello\n"), ("bytes", "\u{0}\u{1}\u{2}"), ("matrix", "1 2 3\n4 5 6\n")] {
        std::fs::write(site.path(name), contents).expect("written");
        let said = fail(&mut site.run("import", &[name, "-o", "y.npz"]));
        assert!(said.contains(name) && said.contains("give the format with --from"), "{said}");
    }
    let said = fail(&mut site.run("import", &["nowhere.coef", "-o", "y.npz"]));
    assert!(said.contains("nowhere.coef"), "{said}");
    assert!(!site.path("y.npz").exists());
}
