//! Studies that bring subjects into correspondence: results, quality and landmarks, and the conditions under which this
//! method is the default.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::io::read_signal;

use crate::common::{fail, finish, succeed, text, tool};
use crate::correspond_inputs::near_landmark;

struct Site(tempfile::TempDir);

impl Site {
    fn new(study: &str) -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        site.write("study.toml", study);
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).expect("a file");
    }

    fn generate(&self, arguments: &[&str]) {
        succeed(tool("generate").args(arguments).arg("-q").current_dir(self.0.path()));
    }

    fn study(&self, more: &[&str]) -> Command {
        let mut command = tool("study");
        command.arg("study.toml").args(more).args(["--threads", "2"]).current_dir(self.0.path());
        command
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).expect("a file")
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.text(name)).expect("JSON")
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|value| value.as_f64().expect("a number")).collect()
}

#[test]
fn a_study_of_bare_meshes_finds_the_bump_and_shows_its_quality() {
    let site = Site::new(
        "output = \"out\"\n[subjects]\ntable = \"meshes/study.csv\"\n[fit]\nmax_degree = 10\n[quality]\nsurfaces = false\n\
         [[test]]\nname = \"bump\"\neffect = \"group\"\n",
    );
    site.generate(&["--study", "meshes", "--subjects", "12", "--bump", "1.5"]);
    let output = finish(&mut site.study(&[]));
    assert!(output.status.success(), "{}", text(&output));
    // Bodies without the bump nearly equal themselves after half a turn.
    assert!(text(&output).contains("two poses fit nearly equally well for 6 subjects: a01, a02, a03, a04, a05, a06;"));
    let models = ["a01", "b06", "mean"].map(|name| site.path(&format!("out/group/{name}.spharm.npz")));
    let [a, b, mean] = models.map(|path| Model::read(path).expect("a model"));
    let sphere = |model: &Model| model.sphere.as_ref().map(|sphere| sphere.directions.clone());
    assert!(sphere(&a).is_some() && sphere(&a) == sphere(&b) && sphere(&a) == sphere(&mean), "over one sphere");

    // The effect is a - b: it points inwards at the bump of group b.
    let map = |name: &str| read_signal(site.path(&format!("out/tests/bump/{name}.shape.gii"))).expect("a map").values;
    let (effect, p) = (map("effect"), map("p-fwe"));
    let peak = (0..effect.len()).max_by(|i, j| effect[*i].abs().total_cmp(&effect[*j].abs())).expect("vertices");
    assert!(effect[peak] < -0.6 && p[peak] < 0.01, "{} {}", effect[peak], p[peak]);

    let [corresponding, plain] = ["correspond", "plain"].map(|name| site.json(&format!("out/quality/{name}.json")));
    for measure in ["generalisation", "specificity"] {
        let [ours, other] = [&corresponding, &plain].map(|found| numbers(&found[measure]["values"]));
        // For smooth bodies with smooth maps, the plain alignment is good as well.
        assert!(ours[0] < 1.1 * other[0] && ours[2] < other[2], "{measure}: {ours:?} {other:?}");
    }
    let page = site.text("out/report.html");
    for said in
        ["Quality of the correspondence", "<bdi>plain</bdi>", "Compactness", "<h2>Correspondence</h2>", "<polygon"]
    {
        assert!(page.contains(said), "{said}");
    }
    // The page has no warning that equal directions aren't equal places.
    let head = page.split_once("class=\"warnings\"").and_then(|(_, rest)| rest.split_once("</section>"));
    assert!(!head.is_some_and(|(head, _)| head.contains("equal directions don't correspond")));
    assert_eq!(&fs::read(site.path("out/quality/correspond.png")).expect("a picture")[1..4], b"PNG");
}

/// Creates a study of ellipsoids with landmarks at known ends; `subjects` is its section of subjects.
fn ellipsoids(subjects: &str) -> Site {
    let rest = "\n[fit]\nmax_degree = 4\n[modes]\ncount = 2\n[quality]\nplain = false\nsurfaces = false\n";
    let site = Site::new(&format!("output = \"out\"\n[subjects]\n{subjects}{rest}"));
    site.generate(&["--group", "ellipsoids", "--members", "4", "--subdivisions", "3", "--output-dir", "in"]);
    site
}

#[test]
fn landmarks_of_the_table_or_by_a_pattern_are_carried_and_shown() {
    let site = ellipsoids("table = \"in/truth.csv\"");
    succeed(&mut site.study(&[]));
    let report = site.json("out/.study/reports/correspond.json");
    let marks = &report["landmarks"];
    assert_eq!(marks["names"].as_array().map(Vec::len), Some(10), "{marks}");
    assert!(!site.path("out/plain").exists() && !site.path("out/quality/plain.json").exists());
    // Landmark errors measured on the models are close to those of landmarks carried on the surfaces.
    let mean = |found: &Value| found["mean"].as_f64().expect("a number");
    let measured = &site.json("out/quality/correspond.json")["landmarks"];
    assert!((mean(measured) / mean(marks) - 1.0).abs() < 0.3, "{measured} {marks}");
    let page = site.text("out/report.html");
    for said in ["<h2>Landmarks</h2>", "landmark error, mean", "<bdi>x1</bdi>"] {
        assert!(page.contains(said), "{said}");
    }
    // Landmarks can also be named by a pattern, with a table that has no paths of landmarks.
    let table: String = site
        .text("in/truth.csv")
        .lines()
        .map(|line| line.split(',').take(2).collect::<Vec<_>>().join(",") + "\n")
        .collect();
    site.write("in/bare.csv", &table);
    let by_pattern = "table = \"in/bare.csv\"\nlandmarks = \"in/{id}.json\"";
    let study = site.text("study.toml").replace("table = \"in/truth.csv\"", by_pattern);
    site.write("study.toml", &study);
    assert!(succeed(&mut site.study(&[])).contains("up to date"), "the same surfaces and landmarks");
    assert_eq!(&site.json("out/.study/reports/correspond.json")["landmarks"], marks);

    // Guiding landmarks have smaller errors.
    site.write("study.toml", &study.replace("[modes]", "[align]\nguide = true\n[modes]"));
    succeed(&mut site.study(&[]));
    let guided = &site.json("out/.study/reports/correspond.json")["landmarks"];
    assert!(mean(guided) < 0.5 * mean(marks) && guided["guide"]["left_out"].is_array(), "{guided}");
    assert!(site.text("out/report.html").contains("if not used as a guide"));

    for (from, to, expected) in [
        ("landmarks = \"in/{id}.json\"", "[align]\nguide = true", "`guide` in [align] needs `landmarks` in [subjects]"),
        ("in/{id}.json", "in/marks.json", "`landmarks` in [subjects]: expected a pattern with {id}"),
        ("in/{id}.json", "in/{id}.fcsv", "in/s01.fcsv: landmarks of s01: no such file"),
        ("[modes]", "[align]\nmethod = \"joint\"\n[modes]", "`landmarks` in [subjects] needs method \"correspond\""),
    ] {
        site.write("study.toml", &study.replace(from, to));
        let error = fail(&mut site.study(&[]));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn signals_are_matched_from_the_table_or_by_a_pattern() {
    let site = ellipsoids("table = \"in/truth.csv\"");
    let rows = site.text("in/truth.csv");
    let cell = |(index, row): (usize, &str)| match row.split_once(',') {
        Some((id, _)) if index > 0 => format!("{row},{}\n", near_landmark(site.0.path(), id).replace("in/", "")),
        _ => format!("{row},near\n"),
    };
    site.write("in/study.csv", &rows.lines().enumerate().map(cell).collect::<String>());
    let model = || fs::read(site.path("out/group/s03.spharm.npz")).expect("a model");
    let plain = site.text("study.toml").replace("truth.csv", "study.csv");
    let with = |signals: &str| plain.replace("[modes]", &format!("[align]\nsignals = [{signals}]\n[modes]"));
    site.write("study.toml", &plain);
    succeed(&mut site.study(&[]));
    let without = model();
    site.write("study.toml", &with("\"near:0.3\""));
    succeed(&mut site.study(&[]));
    let matched = model();
    assert!(matched != without);
    site.write("study.toml", &with("\"in/{id}.near.shape.gii:0.3\""));
    assert!(succeed(&mut site.study(&[])).contains("up to date"), "the same files and weights");
    assert!(model() == matched);
    for (study, expected) in [
        (
            with("\"far\""),
            "`signals` in [align]: expected a column of in/study.csv or a pattern with {id}, found \"far\"",
        ),
        (with("\"near:0\""), "a weight above 0"),
        (with("\"in/{id}.gii\""), "in/s01.gii: a signal of s01: no such file"),
        (with("\"near\"").replace("signals", "method = \"joint\"\nsignals"), "needs method \"correspond\""),
    ] {
        site.write("study.toml", &study);
        let error = fail(&mut site.study(&[]));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn subjects_that_leave_or_change_make_the_group_anew_and_nothing_else_does() {
    let site = ellipsoids("table = \"in/truth.csv\"");
    site.write("in/study.csv", &site.text("in/truth.csv"));
    site.write("study.toml", &site.text("study.toml").replace("truth.csv", "study.csv"));
    let state = |more: &[&str]| {
        let said = succeed(&mut site.study(more));
        let row = said.lines().find(|line| line.starts_with("correspond  ")).expect("a row").to_owned();
        row.contains("up to date")
    };
    assert!(!state(&[]) && state(&[]));
    // A change in another column of the table doesn't cause the group to be made again.
    site.write("in/study.csv", &site.text("in/truth.csv").replace(",a,", ",axis,"));
    assert!(state(&[]));
    // Another method removes the group, and returning to this method makes it again.
    let study = site.text("study.toml");
    site.write("study.toml", &study.replace("[modes]", "[align]\nmethod = \"joint\"\n[modes]"));
    succeed(&mut site.study(&[]));
    assert!(site.path("out/aligned/s01.spharm.npz").exists() && !site.path("out/group").exists());
    assert!(!site.path("out/quality").exists());
    site.write("study.toml", &study);
    assert!(!state(&[]) && !site.path("out/aligned").exists());
    let without = |id: &str| {
        let rows = site.text("in/truth.csv");
        rows.lines().filter(|line| !line.starts_with(id)).map(|line| format!("{line}\n")).collect::<String>()
    };
    site.write("in/study.csv", &without("s04,"));
    assert!(!state(&[]) && state(&[]));
    assert!(!site.path("out/group/s04.spharm.npz").exists() && site.path("out/group/s03.spharm.npz").exists());
    fs::copy(site.path("in/s02.ply"), site.path("in/s03.ply")).expect("a copy");
    fs::copy(site.path("in/s02.json"), site.path("in/s03.json")).expect("a copy");
    assert!(!state(&[]));
    // Warnings of the correspondence, such as doubtful poses of symmetric bodies, are in the page's quality control.
    let page = site.text("out/report.html");
    let control = page.split_once("id=\"quality-control\"").and_then(|(_, rest)| rest.split_once("</section>"));
    let said = site.json("out/.study/warnings/correspond.json");
    let said: Vec<&str> = said.as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    let shown = |text: &&str| {
        let (_, text) = text.split_once(": ").expect("a subject and a warning");
        let text = if text.starts_with("the surface is identical to ") { "same input as s02" } else { text };
        control.is_some_and(|(control, _)| control.contains(text))
    };
    assert!(!said.is_empty() && said.iter().all(shown), "{said:?}");
}

/// The template of a group of tori has a filled cut, which has no counterpart on the members.
#[test]
fn a_mask_of_a_test_is_used_beside_that_of_the_group() {
    let site = Site::new(
        "output = \"out\"\n[subjects]\ntable = \"in/study.csv\"\n[fit]\nmax_degree = 3\n\
         arguments = [\"--fix\", \"--cut-handles\"]\n[modes]\ncount = 2\n[quality]\nplain = false\nsurfaces = false\n[[test]]\n\
         name = \"half\"\neffect = \"group\"\nmask = \"in/half.csv\"\ntfce = true\npermutations = 20\n",
    );
    site.generate(&["--group", "tori", "--members", "4", "--subdivisions", "3", "--output-dir", "in"]);
    let rows = (1..=4).map(|k| format!("s{k:02},s{k:02}.ply,{}\n", ["a", "b"][k % 2]));
    site.write("in/study.csv", &("id,surface,group\n".to_owned() + &rows.collect::<String>()));
    site.write("in/half.csv", "1\n1\n1\n");
    let error = fail(&mut site.study(&[]));
    let expected = "mask: in/half.csv: expected a mask for the 10242 vertices of an icosphere of 5 subdivisions, found one \
                    for 3; give a mask for the vertices of a test's mean.surf.gii, or the mask's own sphere as `sphere`";
    assert!(error.contains(expected) && !site.path("out").exists(), "{error}");

    site.write("in/half.csv", &(0..10242).map(|vertex| format!("{}\n", vertex % 2)).collect::<String>());
    succeed(&mut site.study(&[]));
    let vertices = |folder: &str| -> Vec<usize> {
        let table = site.text(&format!("{folder}/test.csv"));
        let vertex = |line: &str| line.split(',').next().and_then(|cell| cell.parse().ok()).expect("a number");
        table.lines().skip(1).map(vertex).collect()
    };
    let of_group = ["test", "--table", "out/.study/aligned.csv", "--effect", "group", "--permutations", "0"];
    let mut test = tool("shape");
    succeed(test.args(of_group).args(["--mask", "out/group", "-o", "all", "-q"]).current_dir(site.0.path()));
    let (tested, all) = (vertices("out/tests/half"), vertices("all"));
    assert_eq!(tested, all.iter().copied().filter(|vertex| vertex % 2 == 1).collect::<Vec<_>>());
    assert!((1..10242).contains(&all.len()), "the group masks vertices: {}", all.len());

    let about = site.json("out/tests/half/test.json");
    assert_eq!((&about["mask"], &about["map"]), (&Value::from(vec!["in/half.csv"]), &"p-tfce".into()), "{about}");
    let left_out = about["without_counterpart"].as_u64().expect("a number");
    assert_eq!(left_out as usize, 10242 - all.len());
    let methods = site.text("out/methods.md");
    for said in [
        "Only vertices within the mask in/half.csv were tested.",
        &format!("Vertices without a counterpart on the subjects' surfaces ({left_out}) were left out."),
        "shows the effect, the statistic and -log10 of the family-wise p values of threshold-free cluster enhancement.",
    ] {
        assert!(methods.contains(said), "{said}: {methods}");
    }
    let page = site.text("out/report.html");
    assert!(page.contains("vertices without a counterpart on the members of the group: ") && page.contains("Map of p"));
    // The group's file isn't shown as a mask that the user gave.
    assert!(page.contains("Mask</th><td><bdi>in/half.csv</bdi>"));
}

#[test]
fn spheres_that_are_shared_are_kept() {
    let site = Site::new("output = \"out\"\n[subjects]\ntable = \"s.csv\"\n[fit]\nmax_degree = 3\n");
    let mut table = "id,surface,sphere\n".to_owned();
    for variant in ["1", "2", "3"] {
        let surface = format!("s{variant}.ply");
        site.generate(&[
            "--subdivisions",
            "3",
            "--variant",
            variant,
            "--surface",
            &surface,
            "--sphere",
            "sphere.ply",
            "--force",
        ]);
        table += &format!("s{variant},{surface},sphere.ply\n");
    }
    site.write("s.csv", &table);
    let method = |expected: &str| {
        let commands = succeed(&mut site.study(&["--dry-run"]));
        assert!(commands.contains(expected), "{commands}");
    };
    method("--method fixed");
    site.write("s.csv", &table.replace("s3.ply,sphere.ply", "s3.ply,"));
    method("shape correspond --table out/.study/surfaces.tsv --max-degree 3");
    let study = site.text("study.toml");
    site.write("study.toml", &study.replace("max_degree", "arguments = [\"--sphere=sphere.ply\"]\nmax_degree"));
    method("--method fixed");
    site.write("study.toml", &(study.clone() + "[align]\nmethod = \"joint\"\n"));
    method("--method joint");
    // An id that is the name of another file of the group's folder is refused.
    site.write("study.toml", &study);
    site.write("s.csv", &table.replace("s3,s3.ply,sphere.ply", "mean,s3.ply,"));
    let error = fail(&mut site.study(&[]));
    assert!(error.contains("line 4: expected an id other than `mean`") && !site.path("out").exists(), "{error}");
}
