//! Interactions and contrasts of `shape test` and of studies.

use std::fs;
use std::path::Path;

use crate::common::{error_line, finish, succeed, text, tool};
use crate::shape_inference::map;
use crate::shape_means::{report, site, test};

/// Group (five subjects in each), sex, age and stage of each subject.
const GROUPS: [&str; 10] = ["a", "a", "a", "a", "a", "b", "b", "b", "b", "b"];
const SEX: [&str; 10] = ["f", "m", "f", "m", "f", "m", "f", "m", "f", "m"];
const AGES: [f64; 10] = [31.0, 42.0, 55.0, 61.0, 70.0, 33.0, 40.0, 52.0, 66.0, 71.0];
const STAGES: [&str; 10] = ["well", "well", "well", "mild", "mild", "mild", "severe", "severe", "severe", "well"];

/// Creates models of balls whose radius has slope 0.02 of the age in group a, and 0.05 in group b, and their table.
fn subjects() -> tempfile::TempDir {
    let slope = |subject: usize| if GROUPS[subject] == "a" { 0.02 } else { 0.05 };
    let site = site(|subject, year| 10.0 + slope(subject) * AGES[subject] + 0.01 * ((subject * 7 + year) % 5) as f64);
    let row = |i: usize| format!("s{i},year1/s{i}.spharm.npz,{},{},{},{}\n", GROUPS[i], SEX[i], AGES[i], STAGES[i]);
    let rows: String = (0..10).map(row).collect();
    fs::write(site.path().join("t.csv"), format!("id,model,group,sex,age,stage\n{rows}")).expect("a table");
    site
}

fn about(site: &Path, folder: &str) -> serde_json::Value {
    let text = fs::read_to_string(site.join(folder).join("test.json")).expect("a description");
    serde_json::from_str(&text).expect("JSON")
}

fn largest(site: &Path, folder: &str, name: &str) -> f64 {
    map(site, folder, name).into_iter().fold(0.0, |most, value| if value.abs() > f64::abs(most) { value } else { most })
}

#[test]
fn an_interaction_is_the_difference_of_slopes() {
    let site = subjects();
    let site = site.path();
    let found = report(site, &["--table", "t.csv", "--effect", "group:age", "--covariates", "sex,age"], "slopes");
    assert_eq!(found["meaning"], "slope of age in a minus slope of age in b", "{found}");
    let covariates = about(site, "slopes")["covariates"].clone();
    assert_eq!(covariates, serde_json::json!(["group (2 levels)", "age", "sex (2 levels)"]));
    assert_eq!((&found["levels"][0]["subjects"], &found["statistic"]["freedom"]), (&5.into(), &5.0.into()), "{found}");
    // The slope of the radius is 0.02 in a, and 0.05 in b.
    assert!((largest(site, "slopes", "effect") + 0.03).abs() < 0.01, "{}", largest(site, "slopes", "effect"));
    let one = report(site, &["--table", "t.csv", "--effect", "group:age", "--contrast", "b:age"], "one");
    assert_eq!(one["meaning"], "b:age");
    assert!((largest(site, "one", "effect") - 0.05).abs() < 0.01);
    let cells = report(site, &["--table", "t.csv", "--effect", "group:sex"], "cells");
    assert_eq!(cells["meaning"], "(a - b at f) - (a - b at m)");
    assert_eq!(cells["levels"][0], serde_json::json!({ "level": "a:f", "subjects": 3 }));
    // As a covariate, the interaction removes the groups' slopes from the difference between the groups.
    let plain = report(site, &["--table", "t.csv", "--effect", "group", "--covariates", "age"], "plain");
    let apart = report(site, &["--table", "t.csv", "--effect", "group", "--covariates", "group:age"], "apart");
    assert_eq!((&plain["statistic"]["freedom"], &apart["statistic"]["freedom"]), (&7.0.into(), &6.0.into()));
    assert!(largest(site, "apart", "statistic").abs() > 1.5 * largest(site, "plain", "statistic").abs());
}

#[test]
fn levels_that_differ_only_in_case_are_warned_about() {
    let site = subjects();
    let site = site.path();
    let table = fs::read_to_string(site.join("t.csv")).expect("a table").replacen(",a,", ",A,", 2);
    fs::write(site.join("case.csv"), table).expect("a table");
    let found = report(site, &["--table", "case.csv", "--effect", "group"], "case");
    let warnings = found["warnings"].to_string();
    assert!(warnings.contains(r#"group: the levels \"A\" and \"a\" differ only in case"#), "{warnings}");
}

#[test]
fn contrasts_are_tested_alone_or_together() {
    let site = subjects();
    let site = site.path();
    let table = ["--table", "t.csv", "--effect", "stage"];
    let any = report(site, &table, "any");
    let rows = ["--contrast", "mild - well", "--contrast", "-1/2 mild + severe - 0.5*well"];
    let both = report(site, &[&table[..], &rows].concat(), "both");
    assert_eq!(both["meaning"], "any of mild - well; -1/2 mild + severe - 0.5*well");
    assert_eq!(any["statistic"], both["statistic"]);
    let [a, b] = ["any", "both"].map(|folder| map(site, folder, "statistic"));
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6 * a.abs().max(1.0)), "one hypothesis: {a:?} {b:?}");
    let one = report(site, &[&table[..], &rows[..2]].concat(), "first");
    let turned = report(site, &[&table[..], &["--contrast", "well - mild"]].concat(), "turned");
    assert_eq!(one["summary"]["p"], turned["summary"]["p"]);
    assert!((largest(site, "first", "effect") + largest(site, "turned", "effect")).abs() < 1e-9);
    assert_eq!(about(site, "first")["columns"], serde_json::json!(["mild", "severe", "well"]));
}

#[test]
fn designs_that_cannot_be_estimated_are_refused() {
    let site = subjects();
    let site = site.path();
    let refused = |more: &[&str], said: &[&str]| {
        let arguments = [&["--table", "t.csv", "-o", "no"], more].concat();
        let error = error_line(&finish(&mut test(site, &arguments)));
        assert!(said.iter().all(|said| error.contains(said)), "{more:?}: {error}");
    };
    refused(&["--effect", "group:stage"], &["group:stage", "\"a\" and \"severe\""]);
    refused(&["--effect", "group:height"], &["no column \"height\"", "stage"]);
    refused(&["--effect", "stage", "--contrast", "mild - patient"], &["mild, severe, well", "\"patient\""]);
    refused(&["--effect", "stage", "--contrast", "mild"], &["\"mild\" tests a mean", "test a difference"]);
    refused(
        &["--effect", "stage", "--contrast", "mild - mild"],
        &["a combination of columns with at least one nonzero weight, found \"mild - mild\""],
    );
    refused(&["--effect", "group", "--covariates", "age,age"], &["age"]);
    refused(&["--effect", "age:sex", "--levels", "m,f,x"], &["sex", "m, f, x"]);
    refused(&["--effect", "stage", "--levels", "mild,well,mild,severe"], &["duplicate level \"mild\"", "\"stage\""]);
    refused(&["--effect", "age:age"], &["age"]);
}

#[test]
fn a_study_takes_interactions_and_contrasts() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    succeed(tool("generate").args(["--study", "meshes", "--subjects", "8", "--bump", "1.5", "-q"]).current_dir(site));
    let table = fs::read_to_string(site.join("meshes/study.csv")).expect("a table");
    let rows = table.lines().enumerate().map(|(at, line)| match at {
        0 => format!("{line},age\n"),
        _ => format!("{line},{}\n", 40 + at * at % 23),
    });
    fs::write(site.join("meshes/study.csv"), rows.collect::<String>()).expect("a table");
    let study = |tests: &str| {
        let text = format!(
            "[subjects]\ntable = \"meshes/study.csv\"\n[fit]\nmax_degree = 4\n[align]\nmethod = \"joint\"\n[modes]\ncount = 2\n{tests}"
        );
        fs::write(site.join("study.toml"), text).expect("a file");
        let mut command = tool("study");
        command.args(["study.toml", "-q"]).current_dir(site);
        command
    };
    let slopes = "[[test]]\nname = \"slopes\"\neffect = \"group:age\"\npermutations = 20\n";
    let groups = "[[test]]\nname = \"groups\"\neffect = \"group\"\ncontrast = \"b - a\"\ncovariates = [\"group:age\"]\npermutations = 20\n";
    let error = text(&finish(&mut study(&format!("{slopes}contrast = [\"c:age\"]\n"))));
    assert!(error.contains("\"c:age\"") && error.contains("a, b, a:age, b:age"), "{error}");
    // Contrasts that the test would refuse are refused before the fits.
    for (more, said) in [
        ("contrast = [\"a:age - b:age\", \"b:age - a:age\"]", "row 2"),
        ("contrast = [1, -1]", "such as \"patient - control\""),
        ("contrast = \"a\"", "tests a mean"),
        ("welch = true", "welch"),
        ("contrast = [\"a:age\", \"b:age\"]\nsignal = \"position\"", "several components"),
    ] {
        let error = text(&finish(&mut study(&format!("{slopes}{more}\n"))));
        assert!(error.contains(said) && !site.join("study/models").exists(), "{more}: {error}");
    }
    let error = text(&finish(&mut study("[[test]]\nname = \"x\"\neffect = \"group:height\"\n")));
    assert!(error.contains("no column \"height\""), "{error}");
    succeed(&mut study(&format!("{slopes}{groups}")));
    for (name, tested) in [("slopes", "slope of age in a minus slope of age in b"), ("groups", "b - a")] {
        assert_eq!(about(&site.join("study/tests"), name)["tested"], tested);
    }
}
