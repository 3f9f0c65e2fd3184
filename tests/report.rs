//! Makes pages of models through the program: checks contents, hostile names and bad input.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use spharm_surface::Signal;
use spharm_surface::io::{WriteOptions, write_signal_of};

use crate::common::{fail, finish, shared, succeed, text, tool};

struct Site {
    folder: tempfile::TempDir,
}

impl Site {
    /// Creates a surface, its sphere and its model of degree 6, as `s.ply`, `sphere.surf.gii` and `s.spharm.npz`.
    fn new() -> Self {
        let site = Self { folder: tempfile::tempdir().expect("a folder") };
        site.run(&["generate", "--subdivisions", "3", "--surface", "s.ply", "--sphere", "sphere.surf.gii"]);
        site.run(&[
            "fit",
            "--surface",
            "s.ply",
            "--sphere",
            "sphere.surf.gii",
            "--max-degree",
            "6",
            "-o",
            "s.spharm.npz",
            "--report",
            "fit.json",
        ]);
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, arguments: &[&str]) -> std::process::Command {
        let mut command = tool(arguments[0]);
        command.args(&arguments[1..]).current_dir(self.folder.path());
        command
    }

    fn run(&self, arguments: &[&str]) -> String {
        succeed(self.command(arguments).arg("-q"))
    }

    fn page(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).expect("a page")
    }
}

/// Returns the text of the element with this id.
fn element<'a>(html: &'a str, id: &str) -> &'a str {
    let from = html.find(&format!("id=\"{id}\">")).expect("the element");
    let rest = &html[from..];
    &rest[rest.find('>').expect("its end") + 1..rest.find("</script>").expect("its end")]
}

fn info(html: &str) -> Value {
    serde_json::from_str(element(html, "info")).expect("JSON")
}

/// Checks that a page contains only its own script, and a policy that allows no other.
fn assert_closed(html: &str) {
    assert!(html.contains("content=\"default-src 'none'; script-src 'sha256-"), "no policy");
    // The page has blocks of data, but only one script.
    assert_eq!(html.matches("<script>").count(), 1);
    assert_eq!(html.matches("<script").count(), html.matches("</script>").count());
    assert_eq!(html.matches("<style>").count(), 1);
    let head = &html[..html.find("id=\"info\"").expect("data")];
    let body = &head[head.find("</style>").expect("a style sheet")..];
    for tag in body.split('<').skip(1) {
        let tag = tag.split('>').next().expect("its end");
        // Attribute values are in quotes, and no value contains a quote that would end it.
        let outside: String = tag.split('"').step_by(2).collect();
        assert!(tag.matches('"').count() % 2 == 0, "{tag}");
        for attribute in [" on", " href=", " style="] {
            assert!(!outside.contains(attribute), "{attribute}: {tag}");
        }
    }
}

#[test]
fn a_page_has_the_model_the_surface_and_the_same_bytes_each_time() {
    let site = Site::new();
    let report = ["report", "s.spharm.npz", "--surface", "s.ply", "--fit-report", "fit.json", "-o"];
    let printed = site.run(&[&report[..], &["a.html"]].concat());
    assert!(printed.contains("a.html"), "{printed}");
    site.run(&[&report[..], &["b.html"]].concat());
    let html = site.page("a.html");
    assert_eq!(html, site.page("b.html"));
    assert!(html.len() < 1_200_000, "{} bytes", html.len());
    assert_closed(&html);
    let info = info(&html);
    let item = &info["items"][0];
    assert_eq!((&item["kind"], &item["degree"], &item["name"]), (&"model".into(), &6.into(), &"s".into()));
    assert_eq!((&item["grid"]["icosphere"], &item["grid"]["vertices"]), (&3.into(), &642.into()));
    assert_eq!((&item["reference"]["kind"], &item["reference"]["name"]), (&"vertices".into(), &"s.ply".into()));
    for shown in ["Spectrum", "Truncation error", "Provenance", "BLAKE3", "<title>s</title>", "data:image/png;base64,"]
    {
        assert!(html.contains(shown), "{shown}");
    }
}

#[test]
fn what_was_fitted_is_compared_with_where_it_is_as_it_was() {
    let site = Site::new();
    site.run(&["report", "s.spharm.npz", "-o", "found.html"]);
    assert_eq!(info(&site.page("found.html"))["items"][0]["reference"]["kind"], "vertices");
    site.run(&["generate", "--subdivisions", "3", "--variant", "2", "--surface", "s.ply", "--force"]);
    let output = finish(&mut site.command(&["report", "s.spharm.npz", "-o", "changed.html"]));
    assert!(output.status.success() && String::from_utf8_lossy(&output.stderr).contains("the file has changed"));
    assert_eq!(info(&site.page("changed.html"))["items"][0]["reference"]["kind"], "model");
    // Test a surface with other triangles, and more vertices than permitted, so that the page shows an icosphere
    // instead.
    site.run(&["generate", "--subdivisions", "4", "--surface", "fine.ply"]);
    site.run(&["report", "s.spharm.npz", "--surface", "fine.ply", "--max-vertices", "200", "-o", "few.html"]);
    let item = &info(&site.page("few.html"))["items"][0];
    assert_eq!((&item["reference"]["kind"], &item["reference"]["mesh"]), (&"surface".into(), &Value::Null));
    assert_eq!((&item["grid"]["vertices"], &item["grid"]["icosphere"]), (&162.into(), &2.into()));
}

#[test]
fn names_from_files_are_text() {
    let site = Site::new();
    let name = "<img src=x onerror=alert(1)>'\"&\u{202e}\u{2028}é.spharm.npz";
    fs::copy(site.path("s.spharm.npz"), site.path(name)).expect("a copy");
    fs::write(site.path("status.csv"), "id,<b>state</b>\n\"</script><script>alert(2)</script>\",failed\n")
        .expect("a table");
    let title = "</title><script>alert(3)</script>";
    site.run(&["report", name, "s.spharm.npz", "--status", "status.csv", "--title", title, "-o", "page.html"]);
    let html = site.page("page.html");
    assert_closed(&html);
    assert!(!html.contains("<img src=x") && !html.contains("<script>alert") && !html.contains("<b>state"), "raw names");
    assert!(!element(&html, "info").contains(['<', '>', '\u{2028}']));
    let expected = name.strip_suffix(".spharm.npz").expect("the extension");
    assert_eq!(info(&html)["items"][0]["name"], expected);
    assert!(html.contains("<td class=\"failed\"><bdi>failed</bdi></td>"));
    assert_eq!(html.matches("class=\"sortable models\"").count(), 1);
}

#[test]
fn a_group_has_modes_maps_and_status() {
    let site = Site { folder: tempfile::tempdir().expect("a folder") };
    site.run(&["generate", "--study", "meshes", "--subjects", "6", "--bump", "1.5"]);
    let meshes: Vec<String> = (1..=3)
        .flat_map(|k| ["a", "b"].map(|group| format!("meshes/{group}{k:02}.ply")))
        .filter(|name| site.path(name).exists())
        .collect();
    assert_eq!(meshes.len(), 6, "the study's names");
    let words: Vec<&str> = ["fit", "--max-degree", "4", "-o", "models", "--surface"]
        .into_iter()
        .chain(meshes.iter().map(String::as_str))
        .collect();
    site.run(&words);
    site.run(&["shape", "align", "models", "--group", "-o", "aligned"]);
    site.run(&["shape", "pca", "aligned", "-o", "group.shape-model.npz"]);
    let models = |group: &str| (1..=3).map(|k| format!("aligned/{group}{k:02}.spharm.npz")).collect::<Vec<_>>();
    let (a, b) = (models("a"), models("b"));
    let mut test = vec!["shape", "test", "--icosphere", "2", "--cluster", "0.5", "-o", "test", "--a"];
    test.extend(a.iter().map(String::as_str));
    test.push("--b");
    test.extend(b.iter().map(String::as_str));
    site.run(&test);
    let small = fail(&mut site.command(&["report", "--test", "test", "--max-vertices", "100", "-o", "few.html"]));
    assert!(small.contains("162 vertices") && small.contains("--max-vertices"), "{small}");
    fs::write(site.path("status.tsv"), "\u{feff}id\tstate\tmsd\r\na01\tdone\t1e-5\r\n").expect("a table");
    let page =
        ["report", "--modes", "group.shape-model.npz", "--test", "test", "--status", "status.tsv", "-o", "g.html"];
    site.run(&page);
    let html = site.page("g.html");
    assert_closed(&html);
    // The view opens with the first item: the test.
    let items = info(&html)["items"].clone();
    assert_eq!((&items[0]["kind"], &items[1]["kind"]), (&"maps".into(), &"modes".into()));
    let at = |heading: &str| html.find(&format!("<h2><bdi>{heading}")).expect("a heading");
    assert!(at("test: test") < at("group: modes"));
    assert_eq!(items[1]["members"].as_array().map(Vec::len), Some(6));
    let shares: f64 = items[1]["shares"].as_array().expect("shares").iter().filter_map(Value::as_f64).sum();
    assert!((shares - 1.0).abs() < 1e-9, "five modes hold all of the variance: {shares}");
    let names: Vec<&str> =
        items[0]["maps"].as_array().expect("maps").iter().filter_map(|m| m["name"].as_str()).collect();
    assert!(["effect", "statistic", "p-fwe"].iter().all(|name| names.contains(name)), "{names:?}");
    assert!(html.contains("<bdi>a01</bdi>"));
    // The table of clusters as `shape test` writes it.
    let clusters = table(&html, "test: clusters");
    for heading in ["cluster", "vertices", "area, ", "p-fwe", "peak's vertex", "x on the mean", "statistic", "effect"] {
        let heading = format!("<th scope=\"col\" class=\"number\"><bdi>{}", heading.replace('\'', "&#39;"));
        assert!(clusters.contains(&heading), "{heading}: {clusters}");
    }
    assert!(!clusters.contains("<bdi>ux") && clusters.contains("test/clusters.csv</bdi></p>"), "{clusters}");
}

/// Returns the section of the table with this title.
fn table<'a>(html: &'a str, title: &str) -> &'a str {
    let heading = format!("<section class=\"table\"><h2>{title}</h2>");
    let (_, rest) = html.split_once(&heading).unwrap_or_else(|| panic!("no table {title}"));
    rest.split_once("</section>").expect("its end").0
}

#[test]
fn the_largest_clusters_are_listed_with_the_name_of_their_file() {
    let site = Site { folder: tempfile::tempdir().expect("a folder") };
    let folder = site.path("out/tests/size");
    fs::create_dir_all(&folder).expect("a folder");
    site.run(&["generate", "--subdivisions", "1", "--surface", "out/tests/size/mean.surf.gii"]);
    let statistic = Signal::new((0..42).map(f64::from).collect(), 42, 1);
    write_signal_of(folder.join("statistic.shape.gii"), &statistic, None, &WriteOptions::default()).expect("a map");
    fs::write(folder.join("summary.csv"), "measure,n,p\nvolume,8,0.5\n").expect("a table");
    fs::write(folder.join("test.json"), r#"{"mask": ["cortex.label", "seen.label"]}"#).expect("a description");
    let page = |output: &str| {
        site.run(&["report", "--test", "out/tests/size", "--force", "-o", output]);
        site.page(output)
    };
    let html = page("out/report.html");
    assert!(html.contains("size: measures") && !html.contains("size: clusters"), "results of earlier versions");
    assert!(html.contains("Mask</th><td><bdi>cortex.label, seen.label"), "several masks");
    let measures = "measure,n,mean,n a,mean a,effect,low,high,statistic,p\nvolume,8,5,4,6,2,1,3,2.5,0.01\n";
    fs::write(folder.join("summary.csv"), measures).expect("a table");
    let html = page("out/report.html");
    let cells = |start: &str| -> Vec<String> {
        let pieces = table(&html, "size: measures").split(start).skip(1);
        pieces.filter_map(|cell| Some(cell.split_once("<bdi>")?.1.split_once('<')?.0.to_owned())).collect()
    };
    assert_eq!(cells("<th ").join(","), "measure,effect,low,high,statistic,p,n,mean,n a,mean a");
    assert_eq!(cells("<td").join(","), "volume,2,1,3,2.5,0.01,8,5,4,6");
    let clusters = |count: usize| {
        let row = |k: usize| format!("{},{},1.5,0.01,{k},0,0,1,0,0,2,3.5,0.2,<b>front</b>,mm^2\n", k + 1, 30 - k);
        let header = "cluster,vertices,area,p_fwe,peak,ux,uy,uz,x,y,z,statistic,effect,region,unit\n";
        let rows: String = (0..count).map(row).collect();
        fs::write(folder.join("clusters.csv"), header.to_owned() + &rows).expect("a table");
    };
    for (count, output, rows, note) in [
        (23, "out/report.html", 20, "3 more clusters in tests/size/clusters.csv"),
        (21, "elsewhere/report.html", 20, "1 more cluster in out/tests/size/clusters.csv"),
        (2, "report.html", 2, "All clusters of out/tests/size/clusters.csv"),
        (0, "out/report.html", 0, "No clusters: tests/size/clusters.csv"),
    ] {
        clusters(count);
        let html = page(output);
        let (_, after) = html.split_once("<h2>size: measures").expect("measures");
        assert!(after.contains("<h2>size: clusters"), "{count}");
        let found = table(&html, "size: clusters");
        assert_eq!(found.matches("<tr><td").count(), rows, "{count}: {found}");
        assert!(found.ends_with(&format!("<p class=\"note\"><bdi>{note}</bdi></p>")), "{count}: {found}");
    }
    clusters(1);
    let html = page("out/report.html");
    let found = table(&html, "size: clusters");
    let headings = ["<th scope=\"col\" class=\"number\"><bdi>area, mm²<", "<th scope=\"col\"><bdi>region<"];
    for cell in headings.into_iter().chain(["<td><bdi>&lt;b&gt;front"]) {
        assert!(found.contains(cell), "{cell}: {found}");
    }
    assert!(!found.contains("<bdi>uz") && !found.contains("<bdi>unit"), "{found}");
    // Earlier versions wrote no units; a signal tested on the sphere has directions alone.
    let directions = "cluster,vertices,area,p_fwe,peak,ux,uy,uz,statistic\n1,3,0.1,0.01,4,0,0,1,3\n";
    fs::write(folder.join("clusters.csv"), directions).expect("a table");
    let html = page("out/report.html");
    let found = table(&html, "size: clusters");
    assert!(found.contains("<bdi>uz") && found.contains("<bdi>area on the unit sphere"), "{found}");
}

#[test]
fn what_makes_no_page_is_refused_before_anything_is_written() {
    let site = Site::new();
    let refuse = |arguments: &[&str], expected: &str| {
        let error = fail(&mut site.command(arguments));
        assert!(error.contains(expected), "{error}");
    };
    refuse(&["report", "s.spharm.npz", "-o", "page.htm"], "page.htm");
    refuse(&["report", "missing.npz", "-o", "page.html"], "missing.npz");
    refuse(&["report", "s.ply", "-o", "page.html"], "s.ply");
    refuse(&["report", "s.spharm.npz", "--surface", "s.ply", "s.ply", "-o", "page.html"], "1 model and 2 surfaces");
    refuse(&["report", "s.spharm.npz", "--fit-report", "s.ply", "-o", "page.html"], "s.ply");
    refuse(&["report", "--modes", "s.spharm.npz", "-o", "page.html"], "s.spharm.npz");
    refuse(&["report", "--test", ".", "-o", "page.html"], "mean.surf.gii");
    refuse(&["report", "--quality", "fit.json", "-o", "page.html"], "expected a report of `spharm shape quality -o`");
    let correspondence = ["report", "--correspondence", "fit.json", "-o", "page.html"];
    refuse(&correspondence, "expected a report of `spharm shape correspond --report`");
    fs::write(site.path("odd.csv"), "id,state\na\n").expect("a table");
    refuse(&["report", "--status", "odd.csv", "-o", "page.html"], "odd.csv");
    let values: String = (0..642).map(|k| format!("{}\n", k % 7)).collect();
    fs::write(site.path("thickness.csv"), values).expect("a signal");
    site.run(&[
        "fit",
        "--surface",
        "thickness.csv",
        "--sphere",
        "sphere.surf.gii",
        "--max-degree",
        "4",
        "-o",
        "t.spharm.npz",
    ]);
    refuse(&["report", "t.spharm.npz", "-o", "page.html"], "signal");
    assert_eq!(finish(&mut site.command(&["report", "-o", "page.html"])).status.code(), Some(2));
    assert!(!site.path("page.html").exists());
    site.run(&["report", "s.spharm.npz", "-o", "page.html"]);
    // A report of another model's fit is ignored, with a note.
    let report = fs::read_to_string(site.path("fit.json")).expect("a report");
    fs::write(site.path("other.json"), report.replace("s.spharm.npz", "other.spharm.npz")).expect("a report");
    for (report, noted) in [("fit.json", false), ("other.json", true)] {
        let arguments = ["report", "s.spharm.npz", "--fit-report", report, "-o", "page.html", "--force"];
        let said = text(&finish(&mut site.command(&arguments)));
        assert_eq!(said.contains(&format!("{report}: ignored")), noted, "{said}");
    }
    refuse(&["report", "s.spharm.npz", "-o", "page.html"], "--force");
}

/// Checks the size of a page for a large surface whose sphere is an icosphere with its vertices in another order.
#[test]
fn a_cortex_of_the_papers_size_takes_two_megabytes() {
    let (Some(surface), Some(sphere)) = (shared("cort40962.surf.gii"), shared("cort40962.sphere.surf.gii")) else {
        return;
    };
    let site = tempfile::tempdir().expect("a folder");
    let at = |name: &str| site.path().join(name);
    let path = |path: &Path| path.display().to_string();
    let mut fit = tool("fit");
    fit.args(["--surface", &path(&surface), "--sphere", &path(&sphere), "--max-degree", "60", "-q", "-o"]);
    succeed(fit.arg(at("c.spharm.npz")));
    succeed(tool("report").arg(at("c.spharm.npz")).arg("-o").arg(at("c.html")).arg("-q"));
    let size = fs::metadata(at("c.html")).expect("a page").len();
    assert!(size < 2_000_000, "{size} bytes");
}
