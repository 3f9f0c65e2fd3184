//! Tests meshes repaired with `--fix`, masked vertices, and SPHARM-PDM's pairs of files.

use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use spharm_model::Model;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::topology::Topology;
use spharm_surface::{Mesh, Sphere};

use crate::common::{error_line, fail, finish, shared, succeed, text, tool};

struct Site {
    folder: tempfile::TempDir,
    surface: Mesh,
}

impl Site {
    /// Creates a folder with a surface and its sphere.
    fn new() -> Self {
        let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
        let site = Self { folder: tempfile::tempdir().expect("a folder"), surface };
        for (name, mesh) in [("surface.ply", &site.surface), ("sphere.ply", &sphere)] {
            write_mesh(site.path(name), mesh, &WriteOptions { double: true, overwrite: false }).expect("written");
        }
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, verb: &str, arguments: &[&str]) -> Command {
        let mut command = tool(verb);
        command.current_dir(self.folder.path()).args(arguments);
        command
    }

    /// Writes the surface as a triangle soup with a hole, a duplicate triangle, a separate triangle, and an unused
    /// vertex.
    fn soup(&self, name: &str) {
        let corners = self.surface.faces.iter().skip(1).chain(&self.surface.faces[5..6]);
        let mut vertices: Vec<[f64; 3]> = corners.flatten().map(|&v| self.surface.vertices[v as usize]).collect();
        vertices.extend([[900.0, 0.0, 0.0], [901.0, 0.0, 0.0], [900.0, 1.0, 0.0]]);
        let faces = (0..vertices.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        vertices.push([1.0, 2.0, 3.0]);
        write_mesh(self.path(name), &Mesh::new(vertices, faces), &WriteOptions::default()).expect("written");
    }

    fn column(&self, name: &str, value: impl Fn(usize, &[f64; 3]) -> f64) {
        let lines = self.surface.vertices.iter().enumerate().map(|(i, v)| format!("{}\n", value(i, v)));
        std::fs::write(self.path(name), lines.collect::<String>()).expect("written");
    }
}

#[test]
fn a_broken_mesh_is_mended_and_what_was_done_is_counted() {
    let site = Site::new();
    site.soup("soup.obj");
    let said = fail(&mut site.run("fit", &["--surface", "soup.obj", "--max-degree", "6", "-o", "out"]));
    assert!(said.contains("soup.obj") && said.contains("welding"), "{said}");
    let fit = ["--surface", "soup.obj", "--fix", "--max-degree", "6", "-o", "out", "--report", "r.json"];
    let output = finish(&mut site.run("fit", &fit));
    let warned = text(&output);
    assert!(output.status.success() && warned.contains("1 hole filled"), "{warned}");
    let report: Value = serde_json::from_slice(&std::fs::read(site.path("r.json")).expect("a report")).expect("JSON");
    let counts = &report["surfaces"][0]["parametrization"]["mesh_repair"];
    for (name, count) in [
        ("repeated_triangles_dropped", 1),
        ("pieces_dropped", 1),
        ("holes_filled", 1),
        ("triangles_added", 1),
        ("unused_vertices_dropped", 4),
    ] {
        assert_eq!(counts[name], count, "{name}: {counts}");
    }
    let mended = read_mesh(site.path("out/soup.fixed.surf.gii")).expect("a mesh");
    assert!(Topology::of(&mended).is_sphere() && mended.vertices.len() == site.surface.vertices.len());
    let model = Model::read(site.path("out/soup.spharm.npz")).expect("a model");
    assert_eq!(model.provenance.repair.expect("a record")["holes_filled"], 1);
    // A sound mesh is fitted unchanged, and no repaired mesh is written.
    succeed(&mut site.run("fit", &["--surface", "surface.ply", "--fix", "--max-degree", "6", "-o", "sound"]));
    assert!(site.path("sound/surface.spharm.npz").exists() && !site.path("sound/surface.fixed.surf.gii").exists());
    // `parametrize` writes the repaired mesh to a default path.
    let parametrize = ["--surface", "soup.obj", "--fix", "-o", "soup.sphere.ply", "--report", "p.json", "-q"];
    succeed(&mut site.run("parametrize", &parametrize));
    let [surface, sphere] = ["soup.ply", "soup.sphere.ply"].map(|name| read_mesh(site.path(name)).expect("a mesh"));
    assert_eq!(surface.faces, sphere.faces);
    let report: Value = serde_json::from_slice(&std::fs::read(site.path("p.json")).expect("a report")).expect("JSON");
    assert_eq!(report["mesh_repair"]["holes_filled"], 1);
    let said = fail(&mut site.run("parametrize", &["--surface", "soup.obj", "--fix", "-o", "x.ply"]));
    assert!(said.contains("--fix makes a new surface") && said.contains("--surface-output"), "{said}");
}

/// Models from collections for graphics: parts that touch, fins and open sheets. What changes a large part of a surface
/// is refused unless it is allowed.
#[test]
fn meshes_as_they_lie_about_are_mended_or_refused_with_the_reason() {
    let site = Site::new();
    let run = |name: &str, more: &[&str]| {
        let path = shared(name)?;
        let mut command = site.run("fit", &["--fix", "--max-degree", "8", "-o", "m.spharm.npz", "--force"]);
        Some(finish(command.arg("--surface").arg(path).args(more)))
    };
    let suzanne =
        "1 triangle of fins or inner walls dropped, 2 smaller pieces dropped (5.6 % of the area), 2 holes filled";
    for (name, more, said) in [
        ("bad_cow.obj", &[][..], "1 vertex added where parts touched"),
        ("bad_suzanne.obj", &["--largest-repair", "6"], suzanne),
        ("wild/beetle.obj", &["--largest-repair", "61%"], "10 triangles reversed, 1 smaller piece dropped"),
    ] {
        let Some(output) = run(name, more) else { return };
        assert!(output.status.success() && text(&output).contains(said), "{name}: {}", text(&output));
        let mended = read_mesh(site.path("m.fixed.surf.gii")).expect("a mesh");
        assert!(Topology::of(&mended).is_sphere(), "{name}");
    }
    for (name, said) in [
        ("bad_suzanne.obj", "at most 5 % is allowed: 2 smaller pieces dropped (5.6 % of the area), 2 holes filled"),
        ("wild/teapot.obj", "3 smaller pieces dropped (2"),
        ("wild/woody.obj", "the mesh is an open sheet"),
    ] {
        let Some(output) = run(name, &[]) else { return };
        let error = error_line(&output);
        assert!(!output.status.success() && error.contains(name) && error.contains(said), "{name}: {error}");
    }
}

/// Returns a mesh of a ball of radius 1 and a ball of radius 0.7, whose centres are a distance apart.
fn two_balls(subdivisions: u32, distance: f64) -> Mesh {
    let mut both = icosphere(subdivisions);
    let count = both.vertices.len() as u32;
    both.vertices.extend(both.vertices.clone().iter().map(|[x, y, z]| [0.7 * x + distance, 0.7 * y, 0.7 * z]));
    both.faces.extend(both.faces.clone().iter().map(|face| face.map(|v| v + count)));
    both
}

/// `--wrap` closes models of several parts that `--fix` would spoil, and refuses sheets, which enclose nothing.
#[test]
fn the_surface_around_several_parts_is_fitted() {
    let site = Site::new();
    write_mesh(site.path("parts.ply"), &two_balls(4, 0.9), &WriteOptions::default()).expect("written");
    let fit = ["--surface", "parts.ply", "--max-degree", "8", "-o", "m.spharm.npz"];
    let error = fail(&mut site.run("fit", &[&fit[..], &["--fix"]].concat()));
    let wrap = "; --wrap 128 replaces the mesh by the closed surface around it; alternatively, ";
    assert!(error.contains(&format!("{wrap}--largest-repair ")), "{error}");
    let error = fail(&mut site.run("fit", &fit));
    assert!(error.contains(&format!("{wrap}give --fix --largest-repair ")), "{error}");
    let output = finish(&mut site.run("fit", &[&fit[..], &["--wrap", "48"]].concat()));
    assert!(output.status.success(), "{}", text(&output));
    assert!(
        text(&output).contains("warning: parts.ply: the mesh was repaired: wrapped with 48 voxels"),
        "{}",
        text(&output)
    );
    let surface = read_mesh(site.path("m.fixed.surf.gii")).expect("a mesh");
    assert!(Topology::of(&surface).is_sphere());
    let model = Model::read(site.path("m.spharm.npz")).expect("a model").provenance;
    assert_eq!(model.wrap, Some(48));
    assert_eq!(model.repair.expect("recorded")["wrap"]["voxels"], 48);
    // The same request is up to date; another number of voxels isn't.
    let again =
        |voxels: &str| text(&finish(&mut site.run("fit", &[&fit[..], &["--update", "--wrap", voxels]].concat())));
    assert!(again("48").contains("up to date") || again("48").contains("skipped"), "{}", again("48"));
    assert!(again("50").contains("wrapped with 50 voxels"));
    let output = finish(&mut site.run("fit", &[&fit[..], &["--wrap", "5"]].concat()));
    assert!(text(&output).contains("expected a number of voxels from 16 to 512"), "{}", text(&output));
    // The beetle has no floor.
    for (name, percent, said) in [
        ("wild/teapot.obj", "0", ""),
        ("wild/beetle.obj", "0", "span large holes, but at most 25 % is allowed"),
        ("wild/beetle.obj", "40", ""),
        ("wild/woody.obj", "0", "the mesh is an open sheet"),
    ] {
        let Some(path) = shared(name) else { return };
        let options =
            ["--wrap", "32", "--largest-repair", percent, "--max-degree", "6", "-o", "w.spharm.npz", "--force"];
        let options = [&options[..], &["--surface"]].concat();
        let output = finish(site.run("fit", &options).arg(path));
        assert_eq!(output.status.success(), said.is_empty(), "{name}: {}", text(&output));
        assert!(text(&output).contains(said), "{name}: {}", text(&output));
    }
}

/// `--wrap` keeps one piece: it is refused if the others are large, unless the loss is allowed.
#[test]
fn a_wrap_that_loses_a_body_is_refused() {
    let site = Site::new();
    write_mesh(site.path("apart.ply"), &two_balls(3, 2.5), &WriteOptions::default()).expect("written");
    let fit = ["--surface", "apart.ply", "--max-degree", "4", "-o", "m.spharm.npz", "--force", "--wrap", "32"];
    let output = finish(&mut site.run("fit", &fit));
    let error = error_line(&output);
    assert!(
        !output.status.success() && error.contains("apart.ply") && error.contains("at most 5 % is allowed"),
        "{error}"
    );
    assert!(error.contains("1 smaller piece left out (2"), "{error}");
    let (_, option) = error.split_once("; --largest-repair ").expect("the option");
    let percent = option.strip_suffix(" allows this wrap").expect("the percentage");
    assert!(percent.parse::<u32>().is_ok_and(|percent| (30..=35).contains(&percent)), "{error}");
    succeed(&mut site.run("fit", &[&fit[..], &["--largest-repair", percent]].concat()));
    let output = finish(&mut site.run("fit", &["--surface", "apart.ply", "--largest-repair", "40", "-o", "n.npz"]));
    assert!(!output.status.success() && text(&output).contains("--wrap"), "{}", text(&output));
}

/// A wrap is advised only if it would succeed, and its spans are limited like the fillings of `--fix`.
#[test]
fn a_wrap_that_spans_a_large_hole_is_refused() {
    let site = Site::new();
    let write = |name: &str, mesh: &Mesh| write_mesh(site.path(name), mesh, &WriteOptions::default()).expect("written");
    let ball = icosphere(4);
    let above = |face: &&[u32; 3]| face.iter().all(|&v| ball.vertices[v as usize][2] > 0.5);
    write("cap.ply", &Mesh::new(ball.vertices.clone(), ball.faces.iter().filter(above).copied().collect()));
    write("apart.ply", &two_balls(3, 2.5));
    let fit = ["--max-degree", "4", "-o", "m.spharm.npz", "--surface"];
    for name in ["cap.ply", "apart.ply"] {
        let error = fail(&mut site.run("fit", &[&fit[..], &[name, "--fix"]].concat()));
        assert!(error.contains(" allows this repair") && !error.contains("--wrap"), "{error}");
    }
    let error = fail(&mut site.run("fit", &[&fit[..], &["cap.ply", "--wrap", "32"]].concat()));
    assert!(error.contains("would span large holes, but at most 25 % is allowed: 3"), "{error}");
    let option = error.split_once("; --largest-repair ").and_then(|(_, rest)| rest.split_once(" allows this wrap"));
    let (percent, _) = option.expect("the option");
    succeed(&mut site.run("fit", &[&fit[..], &["cap.ply", "--wrap", "32", "--largest-repair", percent]].concat()));
}

/// A mesh that is refused is repaired on trial: the error states the changes, and the options with which they are made.
#[test]
fn the_error_names_the_options_that_repair_a_mesh() {
    let site = Site::new();
    let write = |name: &str, mesh: &Mesh| write_mesh(site.path(name), mesh, &WriteOptions::default()).expect("written");
    let refused = |name: &str, more: &[&str]| {
        let fit = ["--max-degree", "4", "-o", "m.spharm.npz", "--surface", name];
        let output = finish(site.run("fit", &fit).args(more));
        assert!(!output.status.success(), "{name}");
        error_line(&output)
    };
    let sphere = icosphere(4);
    let without = |cap: f64| {
        let outside = |face: &&[u32; 3]| face.iter().any(|&v| sphere.vertices[v as usize][2] < cap);
        Mesh::new(sphere.vertices.clone(), sphere.faces.iter().filter(outside).copied().collect())
    };
    write("open.ply", &without(0.9));
    let error = refused("open.ply", &[]);
    assert!(error.contains("a repair is possible: 1 hole filled (") && error.ends_with("; give --fix"), "{error}");
    succeed(&mut site.run("fit", &["--fix", "--max-degree", "4", "-o", "m.spharm.npz", "--surface", "open.ply"]));

    write("half.ply", &without(0.1));
    let error = refused("half.ply", &["--force"]);
    let (_, percent) = error.split_once("; give --fix --largest-repair ").expect("the option");
    let fit = ["--fix", "--largest-repair", percent, "--max-degree", "4", "-o", "m.spharm.npz", "--force", "--surface"];
    succeed(site.run("fit", &fit).arg("half.ply"));

    // A torus with a hole keeps its handle.
    let (n, turn) = (24_u32, std::f64::consts::TAU / 24.0);
    let at = |i: u32, j: u32| {
        let (u, v) = (f64::from(i) * turn, f64::from(j) * turn);
        [(2.0 + v.cos()) * u.cos(), (2.0 + v.cos()) * u.sin(), v.sin()]
    };
    let vertices = (0..n * n).map(|k| at(k / n, k % n)).collect();
    let quad = |k: u32| {
        let [i, j, after, next] = [k / n, k % n, (k / n + 1) % n, (k % n + 1) % n];
        let [a, b, c, d] = [i * n + j, after * n + j, after * n + next, i * n + next];
        [[a, b, c], [a, c, d]]
    };
    write("torus.ply", &Mesh::new(vertices, (1..n * n).flat_map(quad).collect()));
    let error = refused("torus.ply", &["--force"]);
    let said = "which leaves 1 handle: 1 hole filled";
    assert!(error.contains(said) && error.ends_with("; give --fix --cut-handles"), "{error}");
    let error = refused("torus.ply", &["--force", "--fix"]);
    assert!(error.contains("use --cut-handles to cut the handles") && !error.contains("--fix"), "{error}");

    // No repair makes a closed surface of a Möbius strip.
    let strip = |k: u32| {
        let (along, across) = (f64::from(k / 2) * turn, if k.is_multiple_of(2) { -0.4 } else { 0.4 });
        let out = 1.0 + across * (0.5 * along).cos();
        [out * along.cos(), out * along.sin(), across * (0.5 * along).sin()]
    };
    let pair = |i: u32| {
        let [a, b] = [2 * i, 2 * i + 1];
        let [c, d] = if i + 1 < n { [a + 2, b + 2] } else { [1, 0] };
        [[a, c, b], [b, c, d]]
    };
    write("strip.ply", &Mesh::new((0..2 * n).map(strip).collect(), (0..n).flat_map(pair).collect()));
    let error = refused("strip.ply", &["--force"]);
    assert!(error.contains("not orientable: it has one side only"), "{error}");
    for option in ["a repair is possible", "--wrap", "--fix"] {
        assert!(!error.contains(option), "{error}");
    }
    for change in [&["--fix"][..], &["--wrap", "32"]] {
        let error = refused("strip.ply", &[&["--force"][..], change].concat());
        assert!(
            error.contains("strip.ply") && error.contains("not orientable") && !error.contains("--wrap"),
            "{error}"
        );
    }
}

/// Values at masked vertices have no effect, and the model still covers the entire sphere.
#[test]
fn masked_vertices_and_missing_values_are_not_read() {
    let site = Site::new();
    let smooth = |_: usize, v: &[f64; 3]| v[0] / 70.0;
    let unread = |i: usize| i < 40;
    site.column("mask.csv", |i, _| f64::from(!unread(i)));
    site.column("full.csv", smooth);
    site.column("wild.csv", |i, v| if unread(i) { 1e6 } else { smooth(i, v) });
    site.column("nan.csv", |i, v| if unread(i) { f64::NAN } else { smooth(i, v) });
    let fit = |files: &[&str], out: &str, more: &[&str]| {
        let mut command = site.run("fit", &["--sphere", "sphere.ply", "--max-degree", "8", "-o", out, "--surface"]);
        command.args(files).args(more);
        command
    };
    let output = finish(&mut fit(&["nan.csv", "full.csv"], "gaps", &["--report", "r.json"]));
    assert!(
        output.status.success() && text(&output).contains("nan.csv: 40 of 642 vertices are excluded"),
        "{}",
        text(&output)
    );
    let report: Value = serde_json::from_slice(&std::fs::read(site.path("r.json")).expect("a report")).expect("JSON");
    let of = |name: &str| {
        let surfaces = report["surfaces"].as_array().expect("a list");
        surfaces.iter().find(|surface| surface["name"] == name).expect("a report").clone()
    };
    assert_eq!((&of("nan")["unread"], of("full").get("unread")), (&Value::from(40), None));
    let masked = ["--mask", "mask.csv"];
    succeed(&mut fit(&["nan.csv", "wild.csv", "full.csv"], "masked", &masked));
    let model = |name: &str| Model::read(site.path(name)).expect("a model");
    let known = model("masked/nan.spharm.npz");
    for name in ["masked/wild.spharm.npz", "masked/full.spharm.npz", "gaps/nan.spharm.npz"] {
        let off = model(name).coefficients.values() - known.coefficients.values();
        assert!(off.iter().all(|x| x.abs() < 1e-9), "{name}");
    }
    assert_eq!(known.sphere.as_ref().map(|sphere| sphere.directions.len()), Some(642));
    let whole = Sphere::from_mesh(&read_mesh(site.path("sphere.ply")).expect("a mesh")).expect("a sphere");
    assert_eq!(known.sphere.expect("a sphere").faces, whole.faces);
    // With the same mask the model is up to date; without it the settings differ.
    assert!(
        succeed(&mut fit(&["nan.csv"], "masked", &[&masked[..], &["--skip-existing"]].concat()))
            .contains("nothing to do")
    );
    let said = fail(&mut fit(&["nan.csv"], "masked", &["--skip-existing"]));
    assert!(said.contains("other settings: weights"), "{said}");
    // A surface can be fitted with a mask, too.
    succeed(&mut fit(&["surface.ply"], "masked", &masked));
    std::fs::write(site.path("short.csv"), "1\n0\n").expect("written");
    let said = error_line(&finish(&mut fit(&["full.csv"], "short", &["--mask", "short.csv"])));
    assert!(said.contains("short.csv: found 2 vertices, but the sphere has 642"), "{said}");
    site.column("none.csv", |_, _| 0.0);
    let said = fail(&mut fit(&["full.csv"], "none", &["--mask", "none.csv"]));
    assert!(said.contains("all vertices are excluded by the mask"), "{said}");
    site.column("infinite.csv", |i, _| if i == 3 { f64::INFINITY } else { 1.0 });
    let said = fail(&mut fit(&["infinite.csv"], "infinite", &[]));
    assert!(said.contains("infinite.csv") && said.contains("inf at vertex 3"), "{said}");
}

/// Reads SPHARM-PDM's surface and parameterisation as a pair; the program's own sphere of this surface isn't more
/// distorted.
#[test]
fn a_pair_of_spharm_pdm_is_surface_and_sphere() {
    let names = ["peers/a01_l_hippo.surf.meta", "peers/a01_l_hippo.para.meta"];
    let (Some(surface), Some(sphere)) = (shared(names[0]), shared(names[1])) else { return };
    let site = Site::new();
    let (surface, theirs) = (surface.to_str().expect("a name"), sphere.to_str().expect("a name"));
    succeed(
        &mut site.run("fit", &["--surface", surface, "--sphere", theirs, "--max-degree", "12", "-o", "m.spharm.npz"]),
    );
    assert_eq!(Model::read(site.path("m.spharm.npz")).expect("a model").coefficients.max_degree(), 12);
    let areas = |sphere: &Mesh| {
        let surface = read_mesh(surface).expect("a mesh");
        let area = |mesh: &Mesh, face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| mesh.vertices[v as usize]);
            let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            n.iter().map(|x| x * x).sum::<f64>().sqrt()
        };
        let whole = |mesh: &Mesh| mesh.faces.iter().map(|face| area(mesh, face)).sum::<f64>();
        let share = whole(&surface) / whole(sphere);
        let ratio = |face: &[u32; 3]| (area(sphere, face) * share / area(&surface, face)).ln();
        let ratios: Vec<f64> = surface.faces.iter().map(ratio).collect();
        (ratios.iter().map(|x| x * x).sum::<f64>() / ratios.len() as f64).sqrt()
    };
    succeed(&mut site.run("parametrize", &["--surface", surface, "-o", "ours.sphere.ply", "-q"]));
    let (theirs, ours) = (read_mesh(theirs).expect("a mesh"), read_mesh(site.path("ours.sphere.ply")).expect("a mesh"));
    let (theirs, ours) = (areas(&theirs), areas(&ours));
    eprintln!("log area ratio, rms: SPHARM-PDM's sphere {theirs:.3}, ours {ours:.3}");
    assert!(ours <= theirs, "log area ratio: ours {ours}, SPHARM-PDM's {theirs}");
}
