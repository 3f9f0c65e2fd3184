//! Fits without `--max-degree`: the program chooses the lowest degree that is accurate enough, or the degree that
//! suits the size of labels.

use std::path::Path;

use spharm::metrics::bounding_box_scale;
use spharm::{FitParams, fit_mesh};
use spharm_model::Model;
use spharm_surface::Mesh;
use spharm_surface::io::read_mesh;

use crate::common::{fail, finish, succeed, text, tool};
use crate::volumes::write_volume;

fn folded(folder: &Path, name: &str, variant: &str) -> Mesh {
    let path = folder.join(name);
    succeed(tool("generate").args(["--subdivisions", "4", "--variant", variant, "-q", "--surface"]).arg(&path));
    read_mesh(&path).unwrap()
}

fn degree(model: &Path) -> usize {
    Model::read(model).unwrap().coefficients.max_degree()
}

fn rms(surface: &Mesh, degree: usize) -> f64 {
    let fit = fit_mesh(surface, &FitParams::lsq(degree)).unwrap().fit;
    fit.report.surface_distance.unwrap().rms_raw
}

#[test]
fn a_surface_alone_gets_the_least_degree_that_is_accurate() {
    let folder = tempfile::tempdir().unwrap();
    let surface = folded(folder.path(), "a.ply", "0");
    let output = finish(tool("fit").arg("a.ply").current_dir(folder.path()));
    assert!(
        output.status.success() && text(&output).contains("is the lowest with an rms error of at most"),
        "{output:?}"
    );
    let wanted = 0.002 * bounding_box_scale(&surface.vertices).unwrap();
    let found = degree(&folder.path().join("a.spharm.npz"));
    assert!(rms(&surface, found) <= wanted && rms(&surface, found - 1) > wanted, "degree {found}");
    // The accuracy given as an option, and as a length instead of a percentage.
    let length = wanted.to_string();
    succeed(
        tool("fit")
            .args(["--surface", "a.ply", "--accuracy", &length, "-q", "-o", "b.spharm.npz"])
            .current_dir(folder.path()),
    );
    assert_eq!(degree(&folder.path().join("b.spharm.npz")), found);
}

#[test]
fn all_models_of_a_call_have_the_degree_that_the_worst_surface_needs() {
    let folder = tempfile::tempdir().unwrap();
    let surfaces = ["0", "1"].map(|variant| folded(folder.path(), &format!("{variant}.ply"), variant));
    succeed(tool("fit").args(["0.ply", "1.ply", "--accuracy", "1%", "-q", "-o", "models"]).current_dir(folder.path()));
    let degrees = ["0", "1"].map(|name| degree(&folder.path().join(format!("models/{name}.spharm.npz"))));
    assert_eq!(degrees[0], degrees[1]);
    let errors = |degree: usize| {
        surfaces
            .each_ref()
            .map(|of| rms(of, degree) / bounding_box_scale(&of.vertices).unwrap())
            .into_iter()
            .fold(0.0, f64::max)
    };
    assert!(errors(degrees[0]) <= 0.01 && errors(degrees[0] - 1) > 0.01, "{degrees:?}");
}

#[test]
fn an_accuracy_out_of_reach_is_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    folded(folder.path(), "a.ply", "0");
    let mut fit = tool("fit");
    let output = finish(fit.args(["a.ply", "--accuracy", "1e-6%"]).current_dir(folder.path()));
    let said = text(&output);
    assert!(output.status.success() && said.contains("warning: no degree up to 49 has an rms error of"), "{said}");
    // If no degree is accurate enough, the degree resolves one and a half edges: (2562 pi)^(1/2) / 3 for 2,562
    // vertices.
    assert_eq!(degree(&folder.path().join("a.spharm.npz")), 29);
}

#[test]
fn labels_get_the_degree_of_their_size() {
    let folder = tempfile::tempdir().unwrap();
    let ball = |at: [f64; 3], centre: f64, square: f64| at.map(|x| (x - centre).powi(2)).iter().sum::<f64>() < square;
    write_volume(&folder.path().join("a.nii"), |at| {
        if ball(at, 2.0, 20.0) { 1 } else { 2 * u8::from(ball(at, -5.0, 3.0)) + 3 * u8::from(ball(at, -1.0, 1.0)) }
    });
    let run = |arguments: &[&str]| succeed(tool(arguments[0]).args(&arguments[1..]).current_dir(folder.path()));
    run(&["fit", "a.nii", "--label", "1", "-o", "models", "-q"]);
    // The ball of this volume, 389 voxels, has a radius of 4.5 voxels, and degree L resolves 4.5 pi / L voxels.
    assert_eq!(degree(&folder.path().join("models/a.1.spharm.npz")), 9);
    run(&["volumes", "a.nii", "--label", "1", "-o", "table", "-q"]);
    assert_eq!(degree(&folder.path().join("table/a.1.spharm.npz")), 9);
    // Models that are added to a table have the degree of the table.
    run(&["volumes", "a.nii", "--label", "1", "2", "-o", "table", "-q", "--skip-existing"]);
    assert_eq!(degree(&folder.path().join("table/a.2.spharm.npz")), 9);
    let rows = std::fs::read_to_string(folder.path().join("table/volumes.tsv")).unwrap();
    assert_eq!(rows.lines().count(), 3, "{rows}");
}

#[test]
fn a_degree_is_one_that_all_surfaces_determine_and_that_of_existing_models() {
    let folder = tempfile::tempdir().unwrap();
    folded(folder.path(), "large.ply", "0");
    let small = folder.path().join("small.ply");
    succeed(tool("generate").args(["--subdivisions", "2", "-q", "--surface"]).arg(&small));
    let output = finish(tool("fit").args(["large.ply", "small.ply", "-o", "models"]).current_dir(folder.path()));
    let said = text(&output);
    assert!(output.status.success() && said.contains("warning: degree 11: 2 of 2 surfaces would need"), "{said}");
    // 162 vertices determine at most degree 11, with 144 coefficients.
    assert_eq!(degree(&folder.path().join("models/large.spharm.npz")), 11);
    // A surface added later gets the degree of the existing models.
    folded(folder.path(), "new.ply", "1");
    let arguments = ["large.ply", "small.ply", "new.ply", "-o", "models", "--skip-existing"];
    let output = finish(tool("fit").args(arguments).current_dir(folder.path()));
    assert!(output.status.success() && text(&output).contains("as in an existing model"), "{}", text(&output));
    assert_eq!(degree(&folder.path().join("models/new.spharm.npz")), 11);
}

#[test]
fn volumes_take_the_degree_of_the_first_volume_with_the_labels() {
    let folder = tempfile::tempdir().unwrap();
    let ball = |at: [f64; 3]| u8::from(at.iter().map(|x| x * x).sum::<f64>() < 20.0);
    write_volume(&folder.path().join("a.nii"), |at| 2 * ball(at));
    write_volume(&folder.path().join("b.nii"), |at| 5 * ball(at));
    std::fs::write(folder.path().join("0.nii"), "none").unwrap();
    let arguments = ["0.nii", "a.nii", "b.nii", "--label", "5", "-o", "out"];
    let output = finish(tool("volumes").args(arguments).current_dir(folder.path()));
    assert!(text(&output).contains("degree 9, chosen from the label's size in voxels in b.nii"), "{}", text(&output));
    assert_eq!(degree(&folder.path().join("out/b.5.spharm.npz")), 9);
}

/// Labels that need more than their share of the memory are fitted one after another, to the same models.
#[test]
fn labels_above_their_share_of_the_memory_are_fitted() {
    let folder = tempfile::tempdir().unwrap();
    write_volume(&folder.path().join("a.nii"), |at| {
        let ball = |centre: f64| at.map(|x| (x - centre).powi(2)).iter().sum::<f64>() < 12.0;
        u8::from(ball(3.5)) + 2 * u8::from(ball(-3.5))
    });
    let run = |memory: &str, out: &str| {
        let arguments = ["a.nii", "--max-degree", "25", "--threads", "2", "-q", "--memory", memory, "-o", out];
        succeed(tool("volumes").args(arguments).current_dir(folder.path()));
        let models = ["1", "2"].map(|label| Model::read(folder.path().join(format!("{out}/a.{label}.spharm.npz"))));
        models.map(|model| model.unwrap().coefficients)
    };
    let whole = run("2GiB", "whole");
    // The fit needs 40 MiB, and mapping to the sphere less.
    for memory in ["60MiB", "50MiB"] {
        assert!(run(memory, memory) == whole, "{memory}");
    }
}

#[test]
fn calls_without_a_default_ask_for_the_degree() {
    let folder = tempfile::tempdir().unwrap();
    folded(folder.path(), "a.ply", "0");
    for arguments in [
        &["--shard", "0/2"][..],
        &["--store", "none"],
        &["--objective", "vertices"],
        &["--dry-run"],
        &["--method", "quadrature"],
    ] {
        let output = finish(tool("fit").arg("a.ply").args(arguments).current_dir(folder.path()));
        assert!(output.status.code() == Some(2) && text(&output).contains("--max-degree"), "{}", text(&output));
    }
    succeed(tool("generate").args(["-q", "--subdivisions", "2", "--sphere", "s.ply"]).current_dir(folder.path()));
    let values = "0.5\n".repeat(162);
    std::fs::write(folder.path().join("values.csv"), values).unwrap();
    let error = fail(tool("fit").args(["values.csv", "--sphere", "s.ply"]).current_dir(folder.path()));
    assert!(error.contains("signals need --max-degree L"), "{error}");
    let error = fail(tool("fit").arg("gone.ply").current_dir(folder.path()));
    assert!(error.contains("gone.ply: cannot open"), "{error}");
}

#[test]
fn plain_arguments_are_those_of_the_options() {
    let folder = tempfile::tempdir().unwrap();
    folded(folder.path(), "a.ply", "0");
    let run = |arguments: &[&str]| succeed(tool(arguments[0]).args(&arguments[1..]).current_dir(folder.path()));
    run(&["fit", "a.ply", "--max-degree", "5", "-q", "-o", "1.spharm.npz"]);
    run(&["fit", "--surface", "a.ply", "--max-degree", "5", "-q", "-o", "2.spharm.npz"]);
    run(&["reconstruct", "1.spharm.npz", "-o", "1.ply"]);
    run(&["reconstruct", "--model", "2.spharm.npz", "-o", "2.ply"]);
    run(&["parametrize", "a.ply", "-q", "-o", "3.surf.gii"]);
    run(&["parametrize", "--surface", "a.ply", "-q", "-o", "4.surf.gii"]);
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("1.ply") == bytes("2.ply") && bytes("3.surf.gii") == bytes("4.surf.gii"));
}
