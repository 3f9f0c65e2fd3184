//! Runs every verb that reads files on endless inputs, inputs without data yet, and names that aren't UTF-8.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, write_mesh};

use crate::common::{finish, succeed, text, tool};

struct Site(tempfile::TempDir);

impl Site {
    /// Creates three surfaces, their sphere, and models of them in `models`.
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        for variant in 0..3 {
            let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant });
            let options = WriteOptions { double: true, overwrite: true };
            write_mesh(site.path(format!("s{variant}.ply")), &surface, &options).expect("written");
            write_mesh(site.path("sphere.ply"), &sphere, &options).expect("written");
        }
        let fit = "fit --sphere sphere.ply --max-degree 3 -q -o models --surface s0.ply s1.ply s2.ply";
        succeed(&mut site.run(fit));
        site
    }

    fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, line: &str) -> Command {
        self.run_words(line.split(' ').map(OsString::from))
    }

    fn run_words(&self, words: impl IntoIterator<Item = OsString>) -> Command {
        let words: Vec<OsString> = words.into_iter().collect();
        let mut command = tool(words[0].to_str().expect("a verb"));
        command.args(&words[1..]).current_dir(self.0.path());
        command
    }
}

/// If a small file that is read completely is expected, pipes and devices are refused immediately. The error is one
/// line with their name.
#[test]
fn pipes_and_devices_are_refused_at_once() {
    let site = Site::new();
    rustix::fs::mkfifoat(rustix::fs::CWD, site.path("pipe"), rustix::fs::Mode::RWXU).expect("a pipe");
    let study = |table: &str| format!("[subjects]\ntable = \"{table}\"\n[fit]\nmax_degree = 2\n");
    std::fs::write(site.path("of-pipe.toml"), study("pipe")).expect("written");
    std::fs::write(site.path("of-device.toml"), study("/dev/zero")).expect("written");
    std::fs::write(site.path("t.tsv"), "id\tsurface\na\ts0.ply\n").expect("written");
    let fit = "fit --manifest t.tsv --sphere sphere.ply --max-degree 2 -q --status log.tsv -o fitted";
    succeed(&mut site.run(fit));
    for (name, of) in [("pipe", "of-pipe.toml"), ("/dev/zero", "of-device.toml")] {
        for line in [
            "shape test --table ODD --effect g -o t",
            "shape test --a @ODD --b models -o t",
            "shape align models --group --resume ODD -o aligned",
            "shape mean ODD models/s0.spharm.npz -o mean.npz",
            "shape expand ODD -o e.npz",
            "fit --manifest ODD --max-degree 2 -o m",
            "fit --manifest t.tsv --status ODD --max-degree 2 -o m",
            "fit --surface @ODD --max-degree 2 -o m",
            "fit --surface ODD --max-degree 2 -o m",
            "fit --surface s0.ply --sphere ODD --max-degree 2 -o m",
            "fit --surface s0.ply --sphere sphere.ply --weights ODD --max-degree 2 -o m",
            "fit --surface s0.ply --sphere sphere.ply --mask ODD --max-degree 2 -o m",
            "fit --moments ODD --max-degree 2 -o m",
            "moments --samples ODD --values value --max-degree 2 -o m.moments",
            "parametrize --surface ODD -o m.ply",
            "reconstruct --model ODD -o m.ply",
            "reconstruct --model models/s0.spharm.npz --sphere ODD -o m.ply",
            "compare ODD s0.ply",
            "picture ODD -o m.png",
            "picture s0.ply --map ODD -o m.png",
            "export ODD --to ktch -o m",
            "import ODD -o m.npz",
            "report ODD -o m.html",
            "status ODD",
            "status log.tsv --manifest ODD",
            "study ODD",
            "study OF",
            "study init m.toml --table ODD",
            "volumes ODD --max-degree 2 -o m",
            "basis-build --sphere ODD --store m --max-degree 2",
        ] {
            let line = line.replace("ODD", name).replace("OF", of);
            let output = finish(&mut site.run(&line));
            let code = output.status.code();
            assert!(code == Some(1) || code == Some(2), "{line}: {}", text(&output));
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert!(stderr.lines().any(|line| line.starts_with("error: ")), "{line}: {stderr}");
            assert!(stderr.contains(name) && !stderr.contains("panicked"), "{line}: {stderr}");
            // If the verb wrote a table, the table names the volumes that failed.
            let table = site.path("m/volumes.tsv");
            if table.exists() {
                let rows = std::fs::read_to_string(table).expect("a table");
                assert!(rows.contains("expected a regular file"), "{rows}");
                std::fs::remove_dir_all(site.path("m")).expect("removed");
            }
            assert!(!site.path("m").exists() && !site.path("m.npz").exists(), "{line}");
        }
    }
}

/// A limit on the size of files gives an error that names the file being written.
#[test]
fn a_limit_on_the_size_of_files_is_an_error() {
    let site = Site::new();
    for line in ["shape mean models -o mean.npz", "shape measure models -o m.csv", "picture s0.ply -o p.png"] {
        let mut shell = Command::new("sh");
        shell.args(["-c", "ulimit -f 0; exec \"$@\"", "sh"]).arg(tool("").get_program()).args(line.split(' '));
        let output = finish(shell.current_dir(site.path("")));
        assert_eq!(output.status.code(), Some(1), "{line}: {}", text(&output));
        assert!(text(&output).contains("File too large"), "{line}: {}", text(&output));
    }
}

/// Ids that spreadsheets would evaluate are guarded in tables, and still found when read back.
#[test]
fn ids_that_are_formulas_are_text_in_tables() {
    let site = Site::new();
    std::fs::write(site.path("f.tsv"), "id\tsurface\n=1+1\ts0.ply\n@SUM(1)\ts1.ply\n").expect("written");
    let fit = "fit --manifest f.tsv --sphere sphere.ply --max-degree 2 -q --status f.status.tsv -o fitted";
    succeed(&mut site.run(fit));
    let status = std::fs::read_to_string(site.path("f.status.tsv")).expect("a table");
    assert!(
        status.lines().skip(1).all(|line| line.starts_with("'=1+1\t") || line.starts_with("'@SUM(1)\t")),
        "{status}"
    );
    let found = succeed(&mut site.run("status f.status.tsv --manifest f.tsv --json"));
    let found: serde_json::Value = serde_json::from_str(&found).expect("JSON");
    assert_eq!((&found["done"], &found["not_started"]), (&2.into(), &0.into()), "{found}");
    succeed(&mut site.run("shape measure fitted --names -o measures.csv -q"));
    let measures = std::fs::read_to_string(site.path("measures.csv")).expect("a table");
    assert!(measures.contains("\n'=1+1,") && measures.contains("\n'@SUM(1),"), "{measures}");
}

/// Outputs keep names that aren't UTF-8 exactly; reports show such names as well as JSON allows.
#[test]
fn names_that_are_not_text_are_kept() {
    let site = Site::new();
    let odd = |name: &str| -> OsString {
        let bytes: Vec<u8> = name.bytes().map(|byte| if byte == b'?' { 0xff } else { byte }).collect();
        OsStr::from_bytes(&bytes).to_owned()
    };
    for (from, to) in
        [("s0.ply", "x?.ply"), ("models/s0.spharm.npz", "models/x?.spharm.npz"), ("s1.ply", "y?.surf.ply")]
    {
        std::fs::copy(site.path(from), site.path(odd(to))).expect("a copy");
    }
    for (line, outputs) in [
        (
            "fit --surface x?.ply --max-degree 2 -o o?.spharm.npz --report f.json",
            &["o?.spharm.npz", "o?.sphere.surf.gii", "f.json"][..],
        ),
        ("fit --surface x?.ply --max-degree 2 --json", &["x?.spharm.npz", "x?.sphere.surf.gii"]),
        (
            "fit --surface x?.ply y?.surf.ply --sphere sphere.ply --max-degree 2 -o several --report g.json --coefficients-csv",
            &["several/x?.spharm.npz", "several/y?.surf.spharm.npz", "several/x?.spharm.csv"],
        ),
        (
            "fit --surface y?.surf.ply --sphere sphere.ply --max-degree 2 -o parents --name-template {parent}.{stem}",
            &[],
        ),
        ("parametrize --surface x?.ply -o p?.sphere.surf.gii --report p.json --json", &["p?.sphere.surf.gii"]),
        ("reconstruct --model models/x?.spharm.npz models/s1.spharm.npz -o shapes --format ply", &["shapes/x?.ply"]),
        ("compare x?.ply s1.ply -o e?.ply --json", &["e?.ply"]),
        ("picture x?.ply -o p?.png --size 64", &["p?.png"]),
        ("export models/x?.spharm.npz models/s1.spharm.npz --to ktch -o exported", &["exported/x?.ktch.npy"]),
        ("report models/x?.spharm.npz --surface x?.ply -o r?.html", &["r?.html"]),
        (
            "shape measure models/x?.spharm.npz models/s1.spharm.npz --maps maps -o m?.csv --json",
            &["m?.csv", "maps/x?.mean-curvature.shape.gii"],
        ),
        ("shape describe models/x?.spharm.npz --json -o d?.csv", &["d?.csv"]),
        ("shape smooth models/x?.spharm.npz models/s1.spharm.npz --fwhm 9 -o smooth --json", &["smooth/x?.spharm.npz"]),
        (
            "shape rotate models/x?.spharm.npz models/s1.spharm.npz --object 10,20,30 -o turned --json",
            &["turned/x?.spharm.npz"],
        ),
        (
            "shape align models --group -o aligned --mean mean?.npz --transforms t?.json --json",
            &["aligned/x?.spharm.npz", "t?.json", "mean?.npz"],
        ),
        ("shape align models/x?.spharm.npz --to models/s1.spharm.npz -o one?.npz --json", &["one?.npz"]),
        ("shape mean models -o mean?2.npz --json", &["mean?2.npz"]),
        ("shape pca aligned -o g?.shape-model.npz --scores s?.csv --json", &["g?.shape-model.npz", "s?.csv"]),
        (
            "shape quality aligned --samples 10 --bands 2 --icosphere 2 -o q?.json --curves q?.png --json",
            &["q?.json", "q?.png"],
        ),
        ("shape sample g?.shape-model.npz --mode 1=1 -o w?.npz --json", &["w?.npz"]),
        ("shape morph models/x?.spharm.npz models/s1.spharm.npz --steps 2 -o path? --json", &["path?/step1.ply"]),
        (
            "shape remesh models/x?.spharm.npz models/s1.spharm.npz --icosphere 1 -o meshes --json",
            &["meshes/x?.surf.gii"],
        ),
        (
            "shape compress models/x?.spharm.npz models/s1.spharm.npz --tolerance 1e-2 -o small --json",
            &["small/x?.sphz"],
        ),
        ("shape expand small/x?.sphz small/s1.sphz -o large --json", &["large/x?.spharm.npz"]),
        ("shape match models/x?.spharm.npz --among models --json -o q?.csv", &["q?.csv"]),
        (
            "shape test --a models/x?.spharm.npz models/s1.spharm.npz --b models/s0.spharm.npz models/s2.spharm.npz --permutations 0 --icosphere 1 -o t? --json",
            &["t?/test.json"],
        ),
        ("basis-build --sphere sphere.ply --store store? --max-degree 3 --json", &["store?"]),
        ("fit --store store? --sphere sphere.ply --surface x?.ply --max-degree 3 -o b?.npz --json", &["b?.npz"]),
        ("store list store?", &[]),
        ("generate --subdivisions 1 --surface g?.ply --sphere g?.sphere.ply", &["g?.ply", "g?.sphere.ply"]),
    ] {
        let output = finish(&mut site.run_words(line.split(' ').map(odd)));
        assert!(output.status.success(), "{line}: {}", text(&output));
        for name in outputs {
            assert!(
                site.path(odd(name)).exists(),
                "{line}: {name} isn't there: {:?}",
                std::fs::read_dir(site.path(odd(name)).parent().expect("a folder"))
                    .map(|found| found.filter_map(|entry| entry.ok().map(|e| e.file_name())).collect::<Vec<_>>())
            );
        }
        let stdout = String::from_utf8(output.stdout).expect("text");
        if line.contains("--json") {
            serde_json::from_str::<serde_json::Value>(&stdout)
                .unwrap_or_else(|error| panic!("{line}: {error}: {stdout}"));
        }
    }
    // An argument that must be UTF-8 is refused with a message that says so.
    std::fs::create_dir(site.path(odd("d?"))).expect("a folder");
    std::fs::write(site.path(odd("d?/s.toml")), "[subjects]\ntable = \"t.tsv\"\n[fit]\nmax_degree = 2\n")
        .expect("written");
    for line in ["study d?/s.toml", "bids d? out participant --max-degree 2"] {
        let output = finish(&mut site.run_words(line.split(' ').map(odd)));
        assert_eq!(output.status.code(), Some(1), "{line}: {}", text(&output));
        assert!(text(&output).contains("expected a path in UTF-8"), "{line}: {}", text(&output));
    }
}
