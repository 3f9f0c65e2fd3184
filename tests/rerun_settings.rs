//! Checks that the preparation of a surface before its fit is compared with the settings of existing models. Also
//! tests dry runs on existing outputs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use spharm_model::Model;
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::io::write_mesh;

use crate::common::{error_line, fail, finish, succeed, text, tool};
use crate::first_users::OPTIONS;
use crate::volumes::write_volume;

struct Site(tempfile::TempDir);

impl Site {
    /// Creates two volumes, a ball and a ball with a separate crumb, and two meshes, a sphere and a sphere with a hole.
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        write_volume(&site.path("ball.nii"), |[x, y, z]| u8::from(x * x + y * y + z * z < 20.0));
        write_volume(&site.path("crumb.nii"), |[x, y, z]| {
            u8::from(x * x + y * y + z * z < 20.0 || (x > 7.0 && y > 7.0 && z > 7.0))
        });
        let whole = icosphere(2);
        let faces = whole.faces[1..].to_vec();
        write_mesh(site.path("hole.ply"), &Mesh { faces, ..whole.clone() }, &OPTIONS).expect("a mesh");
        write_mesh(site.path("whole.ply"), &whole, &OPTIONS).expect("a mesh");
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, verb: &str, arguments: &[&str]) -> Command {
        let mut command = tool(verb);
        command.current_dir(self.0.path()).args(arguments).args(["--max-degree", "4", "-o", "out"]);
        command
    }

    fn fit(&self, surface: &str, more: &[&str]) -> Command {
        let mut fit = self.run("fit", &["--surface", surface]);
        fit.args(more);
        fit
    }

    fn model(&self, name: &str) -> Model {
        Model::read(self.path("out").join(name)).expect("a model")
    }

    /// Rewrites a model as an earlier version wrote it, without a record of the preparation.
    fn forget(&self, name: &str) {
        let mut model = self.model(name);
        let provenance = &mut model.provenance;
        (provenance.voxel_size, provenance.fix, provenance.cut_handles) = (None, false, false);
        model.write_with(self.path("out").join(name), true).expect("a model");
    }
}

fn nothing_to_do(mut command: Command) {
    let said = succeed(&mut command);
    assert!(said.contains("nothing to do"), "{said}");
}

#[test]
fn another_size_of_the_voxels_is_another_setting() {
    let site = Site::new();
    let (skip, size) = ("--skip-existing", ["--voxel-size", "3,3,3"]);
    let volumes = |more: &[&str]| {
        let mut volumes = site.run("volumes", &["ball.nii"]);
        volumes.args(more);
        volumes
    };
    succeed(&mut volumes(&[]));
    succeed(&mut volumes(&[skip]));
    let error = text(&finish(volumes(&[skip]).args(size)));
    assert!(error.contains("fitted with other settings: voxel-size from the file, not 3,3,3"), "{error}");
    succeed(volumes(&["--force"]).args(size));
    succeed(volumes(&[skip]).args(size));
    let error = text(&finish(&mut volumes(&[skip])));
    assert!(error.contains("voxel-size 3,3,3, not from the file"), "{error}");
    let name = "ball.1.spharm.npz";
    assert_eq!(site.model(name).provenance.voxel_size, Some([3.0; 3]));

    // `fit` refuses a model with another voxel size, and replaces it with --update.
    let error = fail(&mut site.fit("ball.nii", &[skip]));
    assert!(error.contains("voxel-size 3,3,3, not from the file"), "{error}");
    let scale = |model: Model| model.coefficients.values()[[1, 1]].abs();
    let large = scale(site.model(name));
    succeed(&mut site.fit("ball.nii", &["--update", "--objective", "vertices"]));
    assert!((scale(site.model(name)) * 3.0 / large - 1.0).abs() < 0.05);
    nothing_to_do(site.fit("ball.nii", &["--update", "--objective", "vertices"]));

    // An earlier version wrote models without a record of the voxel size.
    site.forget(name);
    succeed(&mut site.fit("ball.nii", &[skip, "--objective", "vertices"]));
    let error = text(&finish(site.fit("ball.nii", &[skip]).args(size)));
    assert!(error.contains("voxel-size from the file, not 3,3,3"), "{error}");
}

#[test]
fn a_repair_that_changed_something_is_a_setting() {
    let site = Site::new();
    let skip = "--skip-existing";
    for (surface, model) in [("crumb.nii", "crumb.1.spharm.npz"), ("hole.ply", "hole.spharm.npz")] {
        succeed(&mut site.fit(surface, &["--fix"]));
        nothing_to_do(site.fit(surface, &["--fix", skip]));
        let error = fail(&mut site.fit(surface, &[skip]));
        assert!(error.contains("fitted with other settings: fix yes, not no"), "{error}");
        // An earlier version recorded the repairs, but not the option --fix.
        site.forget(model);
        nothing_to_do(site.fit(surface, &["--fix", skip]));
    }
    // If there is nothing to repair or cut, models with and without these options are equal.
    for (surface, model) in [("ball.nii", "ball.1.spharm.npz"), ("whole.ply", "whole.spharm.npz")] {
        succeed(&mut site.fit(surface, &[]));
        let before = fs::read(site.path("out").join(model)).expect("a model");
        nothing_to_do(site.fit(surface, &["--fix", skip]));
        nothing_to_do(site.fit(surface, &["--fix", "--cut-handles", "--update"]));
        succeed(&mut site.fit(surface, &["--fix", "--cut-handles", "--force"]));
        nothing_to_do(site.fit(surface, &[skip]));
        assert_eq!(site.model(model).coefficients, {
            fs::write(site.path("before.npz"), &before).expect("a file");
            Model::read(site.path("before.npz")).expect("a model").coefficients
        });
    }
}

#[test]
fn a_cut_that_changed_something_is_a_setting() {
    let site = Site::new();
    let torus = |[x, y, z]: [f64; 3]| ((x * x + y * y).sqrt() - 5.0).powi(2) + z * z < 4.0;
    write_volume(&site.path("torus.nii"), |at| u8::from(torus(at)));
    succeed(&mut site.fit("torus.nii", &["--cut-handles"]));
    nothing_to_do(site.fit("torus.nii", &["--cut-handles", "--skip-existing"]));
    let error = fail(&mut site.fit("torus.nii", &["--skip-existing"]));
    assert!(error.contains("cut-handles yes, not no"), "{error}");
    let error = fail(&mut site.fit("torus.nii", &["--skip-existing", "--cut-handles", "--fix"]));
    assert!(error.contains("fix no, not yes"), "a repair leaves nothing to cut: {error}");
}

#[test]
fn an_input_whose_contents_have_changed_is_said_to_be_that() {
    let site = Site::new();
    succeed(&mut site.fit("whole.ply", &[]));
    write_mesh(site.path("whole.ply"), &icosphere(1), &OPTIONS).expect("a mesh");
    let error = fail(&mut site.fit("whole.ply", &["--skip-existing"]));
    assert!(error.contains("made from an earlier version of whole.ply"), "{error}");
    assert!(text(&finish(&mut site.fit("whole.ply", &["--update"]))).contains("whole.spharm.npz"));
}

/// Writes a manifest of three surfaces, one of which lacks its sphere.
fn cohort(folder: &Path) {
    for (name, variant) in [("a", 1), ("b", 2), ("c", 3)] {
        let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant });
        write_mesh(folder.join(format!("{name}.ply")), &surface, &OPTIONS).expect("a mesh");
        write_mesh(folder.join("sphere.ply"), &sphere, &OPTIONS).expect("a sphere");
    }
    let table = "id\tsurface\tsphere\nA\ta.ply\tsphere.ply\nB\tb.ply\tno-sphere.ply\nC\tc.ply\tsphere.ply\n";
    fs::write(folder.join("all.tsv"), table).expect("a table");
    fs::write(folder.join("two.tsv"), table.replace("B\tb.ply\tno-sphere.ply\n", "")).expect("a table");
}

#[test]
fn a_dry_run_ends_as_the_run_would() {
    let folder = tempfile::tempdir().expect("a folder");
    cohort(folder.path());
    let fit = |table: &str, degree: &str, more: &[&str]| {
        let mut fit = tool("fit");
        fit.args(["--manifest", table, "-o", "out", "--no-surface-distance", "--max-degree", degree]).args(more);
        fit.current_dir(folder.path());
        fit
    };
    let dry = finish(&mut fit("all.tsv", "4", &["--keep-going", "--dry-run"]));
    assert!(error_line(&dry).contains("1 of 3 surfaces would fail: B"), "{}", text(&dry));
    let said = String::from_utf8_lossy(&dry.stdout).into_owned();
    assert!(said.contains("3 models, of which 0 exist") && said.contains("  B: no-sphere.ply"), "{said}");
    assert!(!folder.path().join("out").exists());
    assert_eq!(fail(&mut fit("all.tsv", "4", &["--dry-run"])), fail(&mut fit("all.tsv", "4", &[])));

    succeed(&mut fit("two.tsv", "4", &["--force"]));
    for more in [&[][..], &["--skip-existing"]] {
        let degree = if more.is_empty() { "4" } else { "5" };
        let real = fail(&mut fit("two.tsv", degree, more));
        assert_eq!(fail(fit("two.tsv", degree, more).arg("--dry-run")), real);
        assert!(real.contains("exists") || real.contains("other settings: max-degree 4, not 5"), "{real}");
    }
    let said = succeed(&mut fit("two.tsv", "4", &["--skip-existing", "--dry-run"]));
    assert!(said.contains("2 models, of which 2 exist and 2 would be kept"), "{said}");
    let said = succeed(&mut fit("two.tsv", "5", &["--update", "--dry-run"]));
    assert!(said.contains("of which 2 exist and 0 would be kept"), "{said}");
    succeed(&mut fit("two.tsv", "5", &["--force", "--dry-run"]));

    let table = fs::read_to_string(folder.path().join("two.tsv")).expect("a table");
    let weighted = table.replace("sphere\n", "sphere\tweights\n").replace(".ply\n", ".ply\tuniformm\n");
    fs::write(folder.path().join("weights.tsv"), weighted).expect("a table");
    let error = fail(&mut fit("weights.tsv", "4", &["--force"]));
    assert!(error.contains("A: column weights: expected uniform, area or an existing file, found uniformm"), "{error}");
    assert_eq!(fail(&mut fit("weights.tsv", "4", &["--force", "--dry-run"])), error);
    let said = text(&finish(&mut fit("weights.tsv", "4", &["--force", "--keep-going"])));
    assert!(said.contains("C: sphere.ply: column weights: expected uniform"), "{said}");
}

#[test]
fn a_dry_run_compares_numbers_of_vertices_in_headers() {
    let folder = tempfile::tempdir().expect("a folder");
    cohort(folder.path());
    write_mesh(folder.path().join("small.ply"), &icosphere(1), &OPTIONS).expect("a mesh");
    let table = "id\tsurface\tsphere\nA\ta.ply\tsphere.ply\nS\tsmall.ply\tsphere.ply\n";
    fs::write(folder.path().join("small.tsv"), table).expect("a table");
    let mut fit = tool("fit");
    fit.args(["--manifest", "small.tsv", "--max-degree", "4", "--keep-going", "--dry-run"]).current_dir(folder.path());
    let dry = finish(&mut fit);
    assert!(error_line(&dry).contains("1 of 2 surfaces would fail: S"), "{}", text(&dry));
    assert!(text(&dry).contains("small.ply") && text(&dry).contains("42"), "{}", text(&dry));
}
