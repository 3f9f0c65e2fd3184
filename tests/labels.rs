//! Models of labels: degrees at which models follow voxels, equal inputs, and the page that compares models with
//! surfaces.

use std::fs;
use std::path::Path;

use serde_json::Value;
use spharm::Model;
use spharm::fit_mesh::steps_of;

use crate::common::{fail, finish, succeed, text, tool};
use crate::volumes::write_volume;

/// Writes a volume with one label, a ball of about this radius in voxels of 1 mm.
fn ball(path: &Path, radius: f64) {
    write_volume(path, |[x, y, z]| u8::from(x * x + y * y + z * z < radius * radius));
}

/// Returns the warnings of a call that succeeds.
fn warnings(command: &mut std::process::Command) -> Vec<String> {
    let output = finish(command);
    assert!(output.status.success(), "{}", text(&output));
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    stderr.lines().filter_map(|line| line.strip_prefix("warning: ")).map(str::to_owned).collect()
}

#[test]
fn degrees_that_resolve_the_voxels_and_equal_volumes_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    ball(&path("a.nii"), 5.0);
    ball(&path("b.nii"), 6.0);
    fs::copy(path("a.nii"), path("c.nii")).unwrap();
    let fit = |degree: &str, output: &str| {
        let mut fit = tool("fit");
        fit.args(["--surface", "a.nii", "b.nii", "--max-degree", degree, "-o", output]).current_dir(folder.path());
        fit.args(["--label-surface", "voxels"]);
        fit
    };
    // Models of smooth surfaces have no steps at any degree.
    let mut smooth = tool("fit");
    smooth.args(["--surface", "a.nii", "b.nii", "--max-degree", "16", "-o", "smooth"]).current_dir(folder.path());
    assert_eq!(warnings(&mut smooth), Vec::<String>::new());
    // An existing model of the other kind of surface is refused.
    let mut other = fit("16", "smooth");
    let error = fail(other.arg("--skip-existing"));
    assert!(error.contains("label-surface smooth, not voxels"), "{error}");
    // A warning is given from degree pi 5 / 1.5 = 10.5 on, for a radius of 5 voxels.
    assert_eq!(warnings(&mut fit("10", "coarse")), Vec::<String>::new());
    let fine = warnings(&mut fit("12", "fine"));
    let [only] = &fine[..] else { panic!("{fine:?}") };
    assert!(
        only.starts_with("a.nii label 1: a model of degree 12 follows the voxels' steps: ")
            && only.contains("up to 10"),
        "{only}"
    );
    let both = warnings(&mut fit("16", "finer"));
    assert!(both.iter().any(|warning| warning.contains("the voxels' steps of 2 labels (a.nii label 1, b")), "{both:?}");
    let steps = |name: &str| steps_of(&Model::read(path(name)).unwrap().provenance);
    assert_eq!(steps("fine/a.1.spharm.npz").map(|steps| steps.suitable_degree), Some(10));
    assert_eq!(steps("fine/b.1.spharm.npz"), None);

    let mut volumes = tool("volumes");
    volumes.args(["a.nii", "b.nii", "c.nii", "--max-degree", "12", "-o", "cells"]).current_dir(folder.path());
    volumes.args(["--label-surface", "voxels"]);
    let found = warnings(&mut volumes);
    assert!(found.iter().any(|warning| warning.starts_with("a.nii label 1, c.nii label 1: these inputs")), "{found:?}");
    assert!(
        found.iter().any(|warning| warning.contains("follow the voxels' steps of 2 labels (a.nii label 1")),
        "{found:?}"
    );
}

#[test]
fn a_study_of_labels_says_on_its_page_that_they_follow_the_voxels() {
    let folder = tempfile::tempdir().unwrap();
    let site = folder.path();
    let ids = ["s1", "s2", "s3", "s4"];
    for (k, id) in ids.into_iter().enumerate() {
        ball(&site.join(format!("{id}.nii")), 4.6 + 0.3 * k as f64);
    }
    let rows: String = ids.iter().map(|id| format!("{id},{id}.nii,1\n")).collect();
    fs::write(site.join("table.csv"), format!("id,surface,label\n{rows}")).unwrap();
    let study = "output = \"out\"\n[subjects]\ntable = \"table.csv\"\n[fit]\nmax_degree = 12\n\
         arguments = [\"--label-surface\", \"voxels\"]\n[quality]\nplain = false\nsurfaces = false\n[page]\nsubjects = true\n";
    fs::write(site.join("study.toml"), study).unwrap();
    let output = finish(tool("study").args(["study.toml", "--threads", "2"]).current_dir(site));
    assert!(output.status.success(), "{}", text(&output));
    let page = fs::read_to_string(site.join("out/report.html")).unwrap();
    let head = page.split_once("class=\"warnings\"").and_then(|(_, rest)| rest.split_once("</section>")).unwrap().0;
    assert!(head.contains("steps of 4 labels (s1, s2, s3, s4)"), "{head}");
    // The page shows each model beside the surface to which it was fitted.
    assert!(!String::from_utf8_lossy(&output.stderr).contains("without the original surface"), "{}", text(&output));
    for item in items(&page).iter().filter(|item| item.get("reference").is_some()) {
        assert_eq!(item["reference"]["kind"], "vertices");
    }
}

/// Returns the contents of a page's views.
fn items(page: &str) -> Vec<Value> {
    let info = page.split_once("id=\"info\">").and_then(|(_, rest)| rest.split_once("</script>")).unwrap().0;
    let info: Value = serde_json::from_str(info).unwrap();
    info["items"].as_array().unwrap().clone()
}

#[test]
fn a_page_shows_a_label_beside_its_surface() {
    let folder = tempfile::tempdir().unwrap();
    ball(&folder.path().join("cell.nii"), 5.0);
    let run = |arguments: &[&str]| succeed(tool(arguments[0]).args(&arguments[1..]).current_dir(folder.path()));
    run(&["fit", "--surface", "cell.nii", "--max-degree", "6", "-o", "cell.spharm.npz"]);
    run(&["report", "cell.spharm.npz", "-o", "page.html"]);
    let page = |name: &str| items(&fs::read_to_string(folder.path().join(name)).unwrap());
    let found = page("page.html");
    assert_eq!(found[0]["reference"]["kind"], "vertices", "{}", found[0]["reference"]);
    fs::remove_file(folder.path().join("cell.surf.gii")).unwrap();
    let output = finish(tool("report").args(["cell.spharm.npz", "-o", "without.html"]).current_dir(folder.path()));
    let said = text(&output);
    assert!(
        output.status.success() && said.contains("its surface cell.surf.gii doesn't exist next to the model"),
        "{said}"
    );
    assert_eq!(page("without.html")[0]["reference"]["kind"], "model");
}
