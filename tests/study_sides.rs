//! Studies of both sides of each subject: the second side is mirrored, and differences between the sides are tested.

use std::fs;
use std::path::Path;

use spharm_model::Model;
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{read_mesh, write_mesh, write_signal};
use spharm_surface::{Signal, Similarity};

use crate::common::{error_line, finish, succeed, text, tool};
use crate::first_users::OPTIONS;
use crate::freesurfer::write_label;
use crate::shape_inference::map;
use crate::volumes::write_volume;

const TESTS: &str = r#"
[[test]]
name = "sides"
mean = true
side = "asymmetry"
[[test]]
name = "groups"
effect = "group"
side = "asymmetry"
[[test]]
name = "right"
effect = "group"
side = "rh"
permutations = 100
"#;

fn study(site: &Path) -> std::process::Output {
    finish(tool("study").args(["study.toml", "--threads", "2"]).current_dir(site))
}

/// Returns the descriptions of tests, which have their warnings.
fn of_tests(site: &Path, names: &[&str]) -> Vec<String> {
    let read = |name: &&str| fs::read_to_string(site.join(format!("out/tests/{name}/test.json"))).expect("a test");
    names.iter().map(read).collect()
}

/// Nine subjects: the left body has no bump, and the right one is the mirror image of a body of the same kind with a
/// bump.
#[test]
fn right_bodies_are_mirrored_and_compared_with_left_ones() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let generate = ["--study", "made", "--subjects", "18", "--bump", "1.5", "-q"];
    succeed(tool("generate").args(generate).current_dir(site));
    let mut table = "id,group\n".to_owned();
    for subject in 1..=9 {
        fs::create_dir_all(site.join(format!("in/s{subject}"))).expect("a folder");
        let body = |name: String| read_mesh(site.join("made").join(name)).expect("a mesh");
        let (left, right) = (body(format!("a{subject:02}.ply")), body(format!("b{subject:02}.ply")));
        write_mesh(site.join(format!("in/s{subject}/lh.ply")), &left, &OPTIONS).expect("a mesh");
        let mirrored = Similarity::reflection().apply_mesh(&right);
        write_mesh(site.join(format!("in/s{subject}/rh.ply")), &mirrored, &OPTIONS).expect("a mesh");
        table += &format!("s{subject},{}\n", if subject % 2 == 0 { "x" } else { "y" });
    }
    fs::write(site.join("table.csv"), table).expect("a table");
    let head = "output = \"out\"\n[subjects]\ntable = \"table.csv\"\nsurface = \"in/{id}/{side}.ply\"\nsides = [\"lh\", \"rh\"]\n\
                exclude = [{ id = \"s9\", reason = \"moved\" }]\n[fit]\nmax_degree = 8\n[quality]\nplain = false\nsurfaces = false\n";
    fs::write(site.join("study.toml"), format!("{head}{TESTS}")).expect("a study");
    let output = study(site);
    assert!(output.status.success(), "{}", text(&output));
    // The effect is left minus right: the bump points outwards on the right.
    let of = |test: &str, name: &str| map(site, &format!("out/tests/{test}"), name);
    let (effect, p) = (of("sides", "effect"), of("sides", "p-fwe"));
    let peak = (0..effect.len()).max_by(|i, j| effect[*i].abs().total_cmp(&effect[*j].abs())).expect("vertices");
    assert!(effect[peak] < -0.6 && p[peak] < 0.01, "{} {}", effect[peak], p[peak]);
    assert!(of("groups", "p-fwe").iter().all(|p| *p > 0.05));
    let summary = |test: &str| fs::read_to_string(site.join(format!("out/tests/{test}/summary.csv"))).expect("a table");
    // Eight subjects are tested, because one is excluded. The bump makes the right bodies larger.
    let volume = summary("sides").lines().find(|line| line.starts_with("volume,")).map(str::to_owned).expect("a row");
    assert!(volume.starts_with("volume,8,-"), "{volume}");
    assert!(summary("right").contains("\nvolume,8,"));
    // Transforms to the group's frame start in the frame of the surface's own file.
    let [left, right] = ["s1_lh", "s1_rh"].map(|id| {
        let text = fs::read(site.join(format!("out/group/members/{id}.json"))).expect("a member");
        let member: serde_json::Value = serde_json::from_slice(&text).expect("JSON");
        serde_json::from_value::<Similarity>(member["to_group"].clone()).expect("a similarity").mirrors()
    });
    assert!(!left && right);
    let methods = fs::read_to_string(site.join("out/methods.md")).expect("a paragraph");
    assert!(methods.contains("Surfaces of the side rh were mirrored first."), "{methods}");
    assert!(
        methods.contains("the mean of the displacement")
            && methods.contains("difference lh minus mirrored rh in each subject) in 8 subjects"),
        "{methods}"
    );
    // Mirrored surfaces count as surfaces of the first side.
    assert!(of_tests(site, &["sides", "right"]).iter().all(|about| !about.contains("hemisphere")));
    fs::write(site.join("rh.mask.csv"), "1\n").expect("a mask");
    for (from, to, expected) in [
        ("side = \"rh\"", "side = \"right\"", "side: expected \"lh\", \"rh\" or \"asymmetry\", found \"right\""),
        ("side = \"rh\"\n", "", "give `side` (\"lh\", \"rh\" or \"asymmetry\")"),
        (
            "{side}.ply",
            "lh.ply",
            "`surface` in [subjects]: expected a pattern with {side}, or a label for each side in `labels`",
        ),
        ("[\"lh\", \"rh\"]", "[\"lh\", \"lh\"]", "found \"lh\" twice"),
        ("\"rh\"]\n", "\"rh\"]\nlabels = [17]\n", "expected two labels, one for each side, found 1"),
        ("mean = true\nside = \"asymmetry\"", "mean = true\nside = \"lh\"", "their mean is always zero"),
        ("[fit]", "[align]\nmethod = \"none\"\n[fit]", "expected a method other than"),
        ("s9", "s13", "no subject \"s13\""),
        ("{side}.ply", "{hemi}.ply", "expected {id} or {side}, found {hemi}"),
        ("[fit]", "[align]\nmirror = true\n[fit]", "the second of the `sides` is mirrored already"),
        ("[fit]\n", "[fit]\narguments = [\"--sphere\", \"s.ply\"]\n", "each side needs its own"),
        (
            "permutations",
            "mask = \"rh.mask.csv\"\npermutations",
            "mask: rh.mask.csv: this file belongs to the right hemisphere, but side rh is mirrored",
        ),
        (
            "[fit]",
            "signal = \"in/{id}/lh.csv\"\n[fit]",
            "`signal` in [subjects]: expected a pattern with {side}, to distinguish",
        ),
    ] {
        let changed = format!("{head}{TESTS}").replacen(from, to, 1);
        fs::write(site.join("study.toml"), changed).expect("a study");
        let error = error_line(&study(site));
        assert!(error.contains(expected), "{error}");
    }
}

/// Right surfaces that are mirror images of the left ones, over mirrored spheres, have no asymmetry. The asymmetry of
/// the thickness is found at the place where the test creates it.
#[test]
fn signals_of_both_hemispheres_are_compared() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let mut table = "participant_id\tgroup\n".to_owned();
    for subject in 0..8 {
        let group = if subject < 4 { "a" } else { "b" };
        table += &format!("s{subject}\t{group}\n");
        let at = |name: &str| site.join(format!("subjects/s{subject}")).join(name);
        fs::create_dir_all(at("surf")).expect("a folder");
        let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: subject });
        let reflection = Similarity::reflection();
        for side in ["lh", "rh"] {
            let place = |mesh| if side == "lh" { Clone::clone(mesh) } else { reflection.apply_mesh(mesh) };
            let sphere = place(&sphere);
            write_mesh(at(&format!("surf/{side}.white")), &place(&surface), &OPTIONS).expect("a mesh");
            write_mesh(at(&format!("surf/{side}.sphere.reg")), &sphere, &OPTIONS).expect("a mesh");
            let length = |p: &[f64; 3]| p.iter().map(|x| x * x).sum::<f64>().sqrt();
            // The left cortex of group a is thicker where y is positive.
            let thicker = if side == "lh" && group == "a" { 1.0 } else { 0.0 };
            let value =
                |p: &[f64; 3]| 2.5 + 0.01 * subject as f64 * p[2] / length(p) + thicker * (p[1] / length(p)).max(0.0);
            let values: Vec<f64> = sphere.vertices.iter().map(value).collect();
            let count = values.len();
            write_signal(at(&format!("surf/{side}.thickness")), &Signal::new(values, count, 1), &OPTIONS)
                .expect("values");
            write_label(&at(&format!("label/{side}.cortex.label")), &sphere.vertices, |_| true);
        }
    }
    fs::write(site.join("participants.tsv"), table).expect("a table");
    let head = "output = \"out\"\n[subjects]\ntable = \"participants.tsv\"\nid = \"participant_id\"\nsides = [\"lh\", \"rh\"]\n\
                surface = \"subjects/{id}/surf/{side}.white\"\nsphere = \"subjects/{id}/surf/{side}.sphere.reg\"\n\
                signal = \"subjects/{id}/surf/{side}.thickness\"\n[fit]\nmax_degree = 6\n[modes]\ncount = 2\n";
    let test = "[[test]]\nname = \"thickness\"\neffect = \"group\"\nsignal = \"value\"\nside = \"asymmetry\"\n";
    fs::write(site.join("study.toml"), format!("{head}{test}")).expect("a study");
    let output = study(site);
    assert!(output.status.success(), "{}", text(&output));
    assert!(of_tests(site, &["thickness"]).iter().all(|about| !about.contains("hemisphere")));
    // The transforms of both sides differ only by rounding.
    let model = |path: &str| Model::read(site.join(path)).expect("a model").coefficients;
    let apart = model("out/aligned/s2_lh.spharm.npz").values() - model("out/aligned/s2_rh.spharm.npz").values();
    assert!(apart.iter().all(|apart| apart.abs() < 1e-6), "{apart}");
    let (effect, p) = (map(site, "out/tests/thickness", "effect"), map(site, "out/tests/thickness", "p"));
    for (v, u) in spharm::Sphere::icosphere(5).directions.as_slice().iter().enumerate() {
        if u[1] > 0.95 {
            assert!((effect[v] - u[1]).abs() < 0.1 && p[v] < 0.01, "{u:?}: {} {}", effect[v], p[v]);
        }
        if u[1] < -0.95 {
            assert!(effect[v].abs() < 0.1, "{u:?}: {}", effect[v]);
        }
    }
}

/// Studies of volumes with a label on each side: with `labels` and one side of a subject excluded, with exchanged
/// sides, and with `label`.
#[test]
fn labels_of_both_sides_are_in_one_volume() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let mut table = "id\tgroup\n".to_owned();
    for subject in 0..6_u8 {
        let longer = f64::from(subject % 3);
        // Label 17 is on the left, at negative x; its extent along y varies between subjects. Label 53 is its mirror
        // image, but smaller along z.
        write_volume(&site.join(format!("s{subject}.nii")), |[x, y, z]| {
            let inside =
                |x: f64, size: f64| (x / 2.6).powi(2) + (y / (4.2 + 0.4 * longer)).powi(2) + (z / size).powi(2) < 1.0;
            let bump = |x: f64| (x + 2.0).powi(2) + (y - 2.0).powi(2) + (z - 1.0).powi(2) < 3.0;
            if inside(x + 4.0, 3.3) || bump(x + 4.0) {
                17
            } else if inside(4.0 - x, 2.6) || bump(4.0 - x) {
                53
            } else {
                0
            }
        });
        table += &format!("s{subject}\t{}\n", if subject < 3 { "a" } else { "b" });
    }
    fs::write(site.join("table.tsv"), table).expect("a table");
    let head = "output = \"out\"\n[subjects]\ntable = \"table.tsv\"\nsurface = \"{id}.nii\"\nsides = [\"lh\", \"rh\"]\nlabels = [17, 53]\n\
                exclude = [\"s0_rh\"]\n[fit]\nmax_degree = 4\n[align]\nmethod = \"joint\"\n[modes]\ncount = 2\n";
    let test = "[[test]]\nname = \"any\"\nmean = true\nside = \"asymmetry\"\npermutations = 20\n";
    fs::write(site.join("study.toml"), format!("{head}{test}")).expect("a study");
    let output = study(site);
    let said = text(&output);
    assert!(
        output.status.success() && said.contains("1 subject with only one side is excluded") && said.contains("s0"),
        "{said}"
    );
    assert!(!said.contains("seem to be exchanged"), "{said}");
    let table = fs::read_to_string(site.join("out/tests/any/summary.csv")).expect("a table");
    let volume = table.lines().find(|line| line.starts_with("volume,")).expect("a row");
    let mean: f64 = volume.split(',').nth(2).and_then(|cell| cell.parse().ok()).expect("a number");
    assert!(volume.starts_with("volume,5,") && mean > 5.0, "{volume}");
    let quality = fs::read_to_string(site.join("out/quality.tsv")).expect("a table");
    assert!(quality.contains("s0_rh\texcluded") && quality.contains("\ns0_lh\t"), "{quality}");
    fs::write(site.join("study.toml"), format!("{head}{test}").replace("[17, 53]", "[53, 17]")).expect("a study");
    let said = text(&study(site));
    assert!(said.contains("in all of 5 subjects, side lh is where side rh is expected"), "{said}");
    // A study of only one of the two labels in each volume.
    let one = head.replace("sides = [\"lh\", \"rh\"]\nlabels = [17, 53]\nexclude = [\"s0_rh\"]", "label = 53");
    let test = test.replace("mean = true\nside = \"asymmetry\"", "effect = \"group\"");
    fs::write(site.join("study.toml"), format!("{one}{test}").replace("\"out\"", "\"one\"")).expect("a study");
    let output = study(site);
    assert!(output.status.success(), "{}", text(&output));
    let made = Model::read(site.join("one/models/s3.spharm.npz")).expect("a model").provenance;
    assert_eq!(made.input.and_then(|input| input.label), Some(53));
}
