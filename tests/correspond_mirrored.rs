//! Mirrors members of groups before bringing them into correspondence, through the program.

use std::fs;

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::Similarity;
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::dot;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use crate::common::{fail, finish, succeed, text, tool};
use crate::correspond::Site;

/// A member that is mirrored, by `--mirrored` or by a table, has the same model as the surface of which it is the
/// mirror image.
#[test]
fn mirrored_members_end_where_their_originals_would() {
    let site = Site::new();
    let member = |folder: &str, name: &str| site.json(&format!("{folder}/members/{name}.json"));
    let reflect = |name: &str, to: &str| {
        let mesh = Similarity::reflection().apply_mesh(&read_mesh(site.path(name)).expect("a mesh"));
        write_mesh(site.path(to), &mesh, &WriteOptions { overwrite: true, double: true }).expect("a mesh");
    };
    succeed(&mut site.correspond("plain", &["--rounds", "1", "--no-refinement"]));
    reflect("in/s02.ply", "in/s02.ply");
    succeed(&mut site.correspond("group", &["--rounds", "1", "--no-refinement", "--mirrored", "in/s02.ply"]));
    let model =
        |folder: &str| Model::read(site.path(&format!("{folder}/s02.spharm.npz"))).expect("a model").coefficients;
    let apart = model("plain").values() - model("group").values();
    assert!(apart.iter().all(|apart| apart.abs() < 1e-6), "{apart}");
    let to_group: Similarity =
        serde_json::from_value(member("group", "s02")["to_group"].clone()).expect("a similarity");
    assert!(to_group.mirrors() && member("group", "s02")["mirrored"] == true);
    // The column `mirrored` of a table has the same effect as `--mirrored`.
    let rows = ["s01", "s02", "s04", "s05"]
        .map(|id| format!("{id}\tin/{id}.ply\t{}\n", if id == "s02" { "yes" } else { "no" }));
    fs::write(site.path("t.tsv"), format!("id\tsurface\tmirrored\n{}", rows.concat())).expect("a table");
    let table = [
        "correspond",
        "--table",
        "t.tsv",
        "--max-degree",
        "8",
        "--subdivisions",
        "4",
        "--rounds",
        "1",
        "--no-refinement",
    ];
    succeed(site.shape(&table).args(["-o", "by-table"]));
    assert_eq!(model("by-table"), model("group"));
    fs::write(site.path("t.tsv"), format!("id\tsurface\tmirrored\n{}", rows.concat().replace("yes", "left")))
        .expect("a table");
    assert!(
        fail(site.shape(&table).args(["-o", "none"]))
            .contains("column \"mirrored\": expected yes or no, found \"left\"")
    );
    // New members can be mirrored, too. A member added with --mirrored isn't accepted as the member without
    // --mirrored.
    reflect("in/s03.ply", "in/s03.ply");
    let add = |more: &[&str]| {
        let mut command = site.shape(&["correspond", "in/s03.ply", "--to", "group", "-o", "added"]);
        command.args(more);
        command
    };
    succeed(&mut add(&["--mirrored", "in/s03.ply"]));
    assert!(member("added", "s03")["registration"]["cover_rms"].as_f64().is_some_and(|rms| rms < 0.5));
    assert!(fail(&mut add(&[])).contains("was made with --mirrored"));
    assert!(fail(&mut add(&["--mirrored", "in/s04.ply"])).contains("in/s04.ply: not among the given surfaces"));
}

/// In a group of two sides, all members may seem mirrored. A warning says so and names the members of one side; the
/// records state which members are mirror images.
#[test]
fn a_group_of_two_sides_is_noticed() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let ball = icosphere(3);
    let names: Vec<String> = (0..4).map(|n| format!("s{n}_{}", ["L", "R"][n % 2])).collect();
    for (name, wide) in names.iter().zip([6.0, 6.1, 6.2, 6.3]) {
        let place = |v: &[f64; 3]| {
            let at = |d: [f64; 3]| (6.0 * (dot(d, *v) - 1.0)).exp();
            let bump = 1.0 + 0.4 * at([0.6, 0.64, 0.48]) + 0.3 * at([-0.36, 0.48, -0.8]);
            [9.0 * v[0] * bump, wide * v[1] * bump, 4.0 * v[2] * bump]
        };
        let mut body = ball.with_vertices(ball.vertices.iter().map(place).collect());
        if name.ends_with('R') {
            body = Similarity::reflection().apply_mesh(&body);
        }
        let options = WriteOptions { overwrite: true, double: true };
        write_mesh(site.join(format!("{name}.ply")), &body, &options).expect("a mesh");
    }
    let correspond = |more: &[&str]| {
        let mut command = tool("shape");
        command.arg("correspond").args(names.iter().map(|name| format!("{name}.ply"))).current_dir(site);
        command.args(["--max-degree", "4", "--subdivisions", "2", "--rounds", "1", "--no-refinement", "--force"]);
        let output = finish(command.args(["-o", "group"]).args(more));
        assert!(output.status.success(), "{}", text(&output));
        text(&output)
    };
    let said = correspond(&[]);
    let expected = ["the group seems to mix two sides", "by their names, the members of the right side are s1_R, s3_R"];
    assert!(expected.iter().all(|words| said.contains(words)), "{said}");
    let said = correspond(&["--mirrored", "s1_R.ply", "s3_R.ply"]);
    assert!(!said.contains("mix two sides") && !said.contains("mirror image"), "{said}");
    let said = correspond(&["--mirror"]);
    let records = names.iter().map(|name| -> Value {
        let text = fs::read(site.join(format!("group/members/{name}.json"))).expect("a record");
        serde_json::from_slice(&text).expect("JSON")
    });
    for (record, name) in records.zip(&names) {
        let to_group: Similarity = serde_json::from_value(record["to_group"].clone()).expect("a similarity");
        let found = (&record["mirrored"], &record["mirrored_first"]);
        assert_eq!(found, (&to_group.mirrors().into(), &false.into()), "{name}");
        assert_eq!(said.contains(&format!("{name} (mirrored)")), to_group.mirrors(), "{said}");
    }
    assert_eq!(said.matches("(mirrored)").count(), 2, "{said}");
}

/// A mirrored model is the model of the mirrored surface. An alignment with --mirrored includes the reflection in the
/// transform.
#[test]
fn mirrored_models_are_aligned() {
    let site = Site::with_group();
    succeed(&mut site.shape(&["rotate", "group/s02.spharm.npz", "--mirror", "-o", "m/s02.spharm.npz"]));
    let [model, mirrored] =
        ["group", "m"].map(|folder| Model::read(site.path(&format!("{folder}/s02.spharm.npz"))).expect("a model"));
    let surface = |model: &Model| model.reconstruct(model.own_sphere().expect("a sphere"), 8).expect("a surface");
    let expected = Similarity::reflection().apply_mesh(&surface(&model));
    let found = surface(&mirrored);
    assert_eq!(found.faces, expected.faces);
    let near = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-9);
    assert!(found.vertices.iter().zip(&expected.vertices).all(near));
    let align = ["align", "m/s02.spharm.npz", "group/s01.spharm.npz", "group/s04.spharm.npz", "group/s05.spharm.npz"];
    let more =
        ["--group", "--method", "fixed", "-o", "aligned", "--transforms", "t.json", "--mirrored", "m/s02.spharm.npz"];
    succeed(site.shape(&align).args(more));
    let first = site.json("t.json")[0].clone();
    assert_eq!((&first["antipodal"], &first["model"]), (&true.into(), &"m/s02.spharm.npz".into()));
    // The transform maps the frame of the model's file to the frame of the aligned model.
    let to_aligned = Similarity {
        orthogonal: serde_json::from_value(first["object"].clone()).expect("a matrix"),
        scale: first["scale"].as_f64().expect("a number"),
        translation: serde_json::from_value(first["translation"].clone()).expect("a vector"),
    };
    let aligned = Model::read(site.path("aligned/s02.spharm.npz")).expect("a model");
    let centre = |model: &Model| -> [f64; 3] {
        std::array::from_fn(|k| model.coefficients.values()[[0, k]] / (4.0 * std::f64::consts::PI).sqrt())
    };
    assert!(near((&to_aligned.apply(centre(&mirrored)), &centre(&aligned))));
}
