//! `shape test` with blocks, variance groups, TFCE and clusters.

use std::fs;
use std::path::Path;

use ndarray::Array2;
use spharm::{Coefficients, Kind};
use spharm_model::Model;
use spharm_surface::io::read_signal;

use crate::common::{error_line, finish, succeed, text, tool};
use crate::shape_means::{growing, report, test};

/// Writes a table with two rows per subject: the models of both years.
fn visits(site: &Path) {
    let row = |(subject, year): (usize, usize)| {
        format!("year{year}/s{subject}.spharm.npz,p{subject},{year},{}\n", if subject < 5 { "x" } else { "y" })
    };
    let rows: String = (0..10).flat_map(|subject| [(subject, 1), (subject, 2)]).map(row).collect();
    fs::write(site.join("visits.csv"), format!("model,subject,year,scanner\n{rows}")).expect("a table");
}

pub(crate) fn map(site: &Path, folder: &str, name: &str) -> Vec<f64> {
    read_signal(site.join(folder).join(format!("{name}.shape.gii"))).expect("a map").values
}

#[test]
fn visits_in_blocks_are_the_paired_test() {
    let site = growing();
    let site = site.path();
    visits(site);
    let table = ["--table", "visits.csv", "--effect", "year", "--covariates", "subject"];
    let blocks = report(site, &[&table[..], &["--blocks", "subject"]].concat(), "blocks");
    let paired = report(site, &["--table", "t.csv", "--models", "year2", "--minus", "year1", "--mean"], "paired");
    assert_eq!((&blocks["relabellings"], &blocks["resampling"]), (&1024.into(), &"permutations".into()), "{blocks}");
    assert_eq!((&blocks["blocks"], &blocks["whole_blocks"]), (&"subject".into(), &false.into()));
    assert!(!blocks["warnings"].to_string().contains("rows"), "{blocks}");
    assert_eq!(paired["relabellings"], 1024);
    for name in ["statistic", "p-fwe", "effect"] {
        let (a, b) = (map(site, "blocks", name), map(site, "paired", name));
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs().max(1e-3)), "{name}: {a:?} {b:?}");
    }
    // The subjects contain the effect of the scanner, but not the scanner's interaction with the year.
    let nested =
        ["--table", "visits.csv", "--effect", "scanner:year", "--covariates", "subject", "--blocks", "subject"];
    let output = finish(test(site, &nested).args(["-o", "nested"]));
    let printed = text(&output);
    assert!(output.status.success() && printed.contains("scanner is left out of the design"), "{printed}");
    assert!(printed.contains("20 in 10 blocks"), "{printed}");
    let wrong = ["--table", "visits.csv", "--effect", "scanner", "--blocks", "subject", "-o", "wrong"];
    let error = error_line(&finish(&mut test(site, &wrong)));
    assert!(error.contains("in these blocks"), "{error}");
    let whole = report(site, &[&wrong[..6], &["--whole-blocks"]].concat(), "whole");
    assert_eq!(whole["relabellings"], 252, "{whole}");
    let v = ["--table", "visits.csv", "--effect", "year", "--variance-groups", "scanner"];
    let positions = [&v[..], &["--signal", "position", "-o", "wrong"]].concat();
    let output = finish(&mut test(site, &positions));
    let error = text(&output);
    assert!(output.status.code() == Some(2) && error.contains("--variance-groups needs `--signal normal`"), "{error}");
    let welch = [&v[..2], &["--effect", "scanner", "--covariates", "year", "--welch", "-o", "wrong"]].concat();
    let error = error_line(&finish(&mut test(site, &welch)));
    assert!(error.contains("--variance-groups COLUMN"), "{error}");
    let v = report(site, &v, "v");
    assert_eq!((&v["variance_groups"], &v["resampling"]), (&"scanner".into(), &"sign flips".into()), "{v}");
}

#[test]
fn regions_get_maps_and_a_table() {
    let site = growing();
    let site = site.path();
    let table = ["--table", "t.csv", "--models", "year2", "--minus", "year1", "--mean", "--tfce", "--cluster", "0.01"];
    let found = report(site, &table, "regions");
    assert_eq!(found["summary"]["clusters"]["significant"], 1, "{found}");
    let (tfce, p, statistic) =
        (map(site, "regions", "tfce"), map(site, "regions", "p-tfce"), map(site, "regions", "statistic"));
    assert!(tfce.iter().zip(&statistic).all(|(tfce, t)| tfce * t >= 0.0) && p.iter().all(|p| *p < 0.01), "{p:?}");
    let clusters = fs::read_to_string(site.join("regions/clusters.csv")).expect("a table");
    let mut lines = clusters.lines();
    assert_eq!(lines.next(), Some("cluster,vertices,area,p_fwe,peak,ux,uy,uz,x,y,z,statistic,effect,unit"));
    let first = lines.next().and_then(|line| line.strip_suffix(",length^2")).expect("a cluster with its area's unit");
    let first: Vec<f64> = first.split(',').map(|cell| cell.parse().expect("a number")).collect();
    let numbers = map(site, "regions", "cluster");
    assert_eq!(first[1] as usize, numbers.iter().filter(|number| **number == 1.0).count());
    assert!((first[11] - statistic[first[4] as usize]).abs() < 1e-4 * first[11].abs(), "{clusters}");
    // A later test without clusters and TFCE removes the results of the earlier one.
    let again = [&table[..7], &["-o", "regions", "--force", "-q"]].concat();
    assert!(finish(&mut test(site, &again)).status.success());
    assert!(!site.join("regions/clusters.csv").exists() && !site.join("regions/tfce.shape.gii").exists());
    for (more, expected) in [
        (&["--tfce", "--permutations", "0"][..], "need relabellings"),
        (&["--cluster", "2"], "above 0 and below 1"),
        (&["--errors", "normal"], "exchangeable, symmetric or both"),
        (&["--errors", "exchangeable"], "leave the statistics"),
    ] {
        let output = finish(&mut test(site, &[&table[..7], more, &["-o", "wrong"]].concat()));
        let error = text(&output);
        assert!(!output.status.success() && error.contains(expected), "{error}");
    }
}

/// Measures are tested with the same design as the vertices. The expected numbers of a two-sample t test are SciPy's
/// (`ttest_ind([1, 2, 3, 5], [2, 4, 6, 9])` and its `confidence_interval`).
#[test]
fn measures_are_tested_like_vertices() {
    let site = growing();
    let site = site.path();
    let rows = [[1, 2], [2, 4], [3, 6], [5, 9]].into_iter().enumerate();
    let rows: String = rows.map(|(k, [a, b])| format!("s{k},{a},7,x\ns{},{b},7,y\n", k + 4)).collect();
    fs::write(site.join("measures.csv"), format!("model,size,degree,kind\n{rows}")).expect("a table");
    let models = |from: usize| (from..from + 4).map(|k| format!("year1/s{k}.spharm.npz")).collect::<Vec<_>>();
    let (a, b) = (models(0), models(4));
    let mut groups = vec!["--a"];
    groups.extend(a.iter().map(String::as_str).chain(["--b"]).chain(b.iter().map(String::as_str)));
    let found = report(site, &[&groups[..], &["--measures", "measures.csv"]].concat(), "found");
    let [size] = &found["measures"].as_array().expect("measures")[..] else { panic!("{}", found["measures"]) };
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let expected = [
        (number(&size["statistic"]), -1.453_504_749_334_528),
        (number(&size["p"]), 0.196_306_860_229_298),
        (number(&size["effect"]["estimate"]), 2.75 - 5.25),
        (number(&size["effect"]["interval"][0]), -6.708_640_962_929_898),
        (number(&size["effect"]["interval"][1]), 1.708_640_962_929_898_4),
        (number(&size["levels"]["a"]["mean"]), 2.75),
        (number(&size["levels"]["b"]["sd"]), (26.75_f64 / 3.0).sqrt()),
    ];
    for (found, expected) in expected {
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
    let table = fs::read_to_string(site.join("found/summary.csv")).expect("a table");
    assert!(table.contains("\nsize,8,4,2.6186"), "{table}");
    // Units of columns that another program wrote aren't known.
    assert!(table.lines().next().is_some_and(|header| header.ends_with(",p-fwe,unit")), "{table}");
    assert!(table.lines().nth(1).is_some_and(|row| row.ends_with(',')), "{table}");
    // A later test without measures removes the earlier table of measures.
    report(site, &[&groups[..], &["--force"]].concat(), "found");
    assert!(!site.join("found/summary.csv").exists());
    // Numbers may be missing for subjects that aren't tested. If no columns of a table are named, a column with a
    // number missing for a tested subject is skipped.
    let with_age = rows.replacen("s0,1,", "s0,,", 1);
    fs::write(site.join("gaps.csv"), format!("model,gap,degree,kind\n{with_age}")).expect("a table");
    fs::write(site.join("more.csv"), format!("model,size,degree,kind\n{rows}other,n/a,7,x\n")).expect("a table");
    let both = [&groups[..], &["--measures", "gaps.csv", "--measures", "more.csv:size"]].concat();
    let output = finish(test(site, &both).args(["-o", "both"]));
    let said = text(&output);
    assert!(
        output.status.success() && said.contains("measure \"gap\": expected a number for s0, found \"\""),
        "{said}"
    );
    let table = fs::read_to_string(site.join("both/summary.csv")).expect("a table");
    assert!(table.contains("\nsize,") && !table.contains("\ngap,"), "{table}");
    for (given, expected) in [
        ("gaps.csv:gap", "exclude the subject or the measure"),
        ("measures.csv:kind", "expected a number for s0, found \"x\""),
        ("measures.csv:volume", "no column \"volume\""),
        ("other.csv", "other.csv"),
    ] {
        let output = finish(test(site, &[&groups[..], &["--measures", given]].concat()).args(["-o", "refused"]));
        assert!(!output.status.success() && error_line(&output).contains(expected), "{}", text(&output));
    }
    fs::write(site.join("few.csv"), "model,size\ns0,1\n").expect("a table");
    let output = finish(test(site, &[&groups[..], &["--measures", "few.csv"]].concat()).args(["-o", "refused"]));
    assert!(error_line(&output).contains("no row for \"s1\""), "{}", text(&output));
}

#[test]
fn tables_of_a_test_have_units() {
    let site = growing();
    let site = site.path();
    let run = |line: &str| succeed(tool("shape").args(line.split(' ')).current_dir(site));
    run("measure year1 --names -o measured.csv -q");
    run("pca year1 --modes 2 --scores scores.csv -o group.shape-model.npz -q");
    let table = ["--table", "t.csv", "--models", "year1", "--effect", "age", "--permutations", "0"];
    report(site, &[&table[..], &["--measures", "measured.csv", "scores.csv"]].concat(), "units");
    let summary = fs::read_to_string(site.join("units/summary.csv")).expect("a table");
    let unit = |measure: &str| {
        let row = summary.lines().find(|line| line.split(',').next() == Some(measure));
        row.and_then(|row| row.rsplit(',').next()).unwrap_or_else(|| panic!("{measure}: {summary}"))
    };
    let found = ["measure", "area", "volume", "centroid_x", "sphericity", "mode_2"].map(unit);
    assert_eq!(found, ["unit", "length^2", "length^3", "length", "1", "length"], "{summary}");
    // Clusters of a signal without a surface have their area on the unit sphere.
    fs::create_dir(site.join("values")).expect("a folder");
    for subject in 0..10 {
        let values =
            Array2::from_shape_fn((4, 1), |(k, _)| if k == 0 { 3.0 } else { 0.01 * ((subject * k) % 11) as f64 });
        let model = Model::without_sphere(Coefficients::new(values).expect("coefficients"), Kind::Signal);
        model.write(site.join(format!("values/s{subject}.spharm.npz"))).expect("a model");
    }
    let signal = ["--table", "t.csv", "--models", "values", "--mean", "--signal", "value", "--cluster", "0.01"];
    report(site, &signal, "signal");
    let clusters = fs::read_to_string(site.join("signal/clusters.csv")).expect("a table");
    let mut lines = clusters.lines();
    assert_eq!(lines.next(), Some("cluster,vertices,area,p_fwe,peak,ux,uy,uz,statistic,effect,unit"));
    assert!(lines.next().is_some_and(|row| row.starts_with("1,42,") && row.ends_with(",1")), "{clusters}");
}

#[test]
fn maps_are_also_written_for_freesurfer() {
    let site = growing();
    let site = site.path();
    visits(site);
    let table = ["--table", "visits.csv", "--effect", "year", "--permutations", "0"];
    report(site, &table, "maps");
    let gifti = map(site, "maps", "p");
    let header = fs::read_to_string(site.join("maps/p-permutation.shape.gii")).unwrap_or_default();
    assert!(header.is_empty(), "no relabellings");
    let header = fs::read_to_string(site.join("maps/p.shape.gii")).expect("a map");
    assert!(header.contains("<MD><Name>Name</Name><Value>p</Value></MD>"), "{header}");
    report(site, &[&table[..], &["--maps", "mgh", "--force"]].concat(), "maps");
    assert_eq!(read_signal(site.join("maps/p.mgh")).expect("a map").values, gifti);
    assert!(!site.join("maps/p.shape.gii").exists());
}
