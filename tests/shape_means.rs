//! Tests of means, differences of paired models, and groups of unequal variance, through the program.

use std::fs;
use std::path::Path;

use ndarray::Array2;
use serde_json::Value;
use spharm::{Coefficients, Kind};
use spharm_model::Model;
use spharm_surface::io::read_signal;

use crate::common::{error_line, fail, finish, succeed, text, tool};

/// Creates models of balls of radius `radius(subject, year)` in `year1` and `year2`, and the table `t.csv` of the
/// subjects.
pub(crate) fn site(radius: impl Fn(usize, usize) -> f64) -> tempfile::TempDir {
    let site = tempfile::tempdir().expect("a folder");
    for year in [1, 2] {
        let folder = site.path().join(format!("year{year}"));
        fs::create_dir(&folder).expect("a folder");
        for subject in 0..10 {
            let size = radius(subject, year) * (4.0 * std::f64::consts::PI / 3.0).sqrt();
            let mut values = Array2::zeros((9, 3));
            (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (size, 0.9 * size, 0.8 * size);
            // Shapes differ between subjects, so that positions vary in all directions.
            values.iter_mut().skip(12).enumerate().for_each(|(k, value)| {
                *value += 0.02 * (((subject * 31 + year * 17 + k * k * 7) % 23) as f64 - 11.0);
            });
            let model = Model::without_sphere(Coefficients::new(values).expect("coefficients"), Kind::Surface);
            model.write(folder.join(format!("s{subject}.spharm.npz"))).expect("a model");
        }
    }
    let row = |subject: usize| {
        let site = 1 + subject % 3;
        format!(
            "s{subject},year1/s{subject}.spharm.npz,year2/s{subject}.spharm.npz,{},{site}\n",
            40 + subject * subject
        )
    };
    let rows: String = (0..10).map(row).collect();
    fs::write(site.path().join("t.csv"), format!("id,first,second,age,site\n{rows}")).expect("a table");
    site
}

/// Creates models of balls that differ between subjects and grow by 0.5 from one year to the next.
pub(crate) fn growing() -> tempfile::TempDir {
    site(|subject, year| 10.0 + 0.3 * subject as f64 + 0.5 * (year as f64 - 1.0))
}

pub(crate) fn test(site: &Path, arguments: &[&str]) -> std::process::Command {
    let mut command = tool("shape");
    command.arg("test").args(arguments).args(["--icosphere", "1"]).current_dir(site);
    command
}

pub(crate) fn report(site: &Path, arguments: &[&str], name: &str) -> Value {
    succeed(test(site, arguments).args(["-q", "-o", name, "--report"]).arg(format!("{name}.json")));
    serde_json::from_str(&fs::read_to_string(site.join(format!("{name}.json"))).expect("a report")).expect("JSON")
}

#[test]
fn a_mean_change_is_found_whatever_columns_are_beside_it() {
    let site = growing();
    let site = site.path();
    let table = ["--table", "t.csv", "--models", "year2", "--minus", "year1"];
    let of = |more: &[&str], name: &str| report(site, &[&table[..], more].concat(), name);
    for (more, name) in [(&["--mean"][..], "plain"), (&["--mean", "--covariates", "age"], "age")] {
        let found = of(more, name);
        assert_eq!((&found["resampling"], &found["relabellings"]), (&"sign flips".into(), &1024.into()), "{found}");
        assert_eq!(found["meaning"], "mean of year2 - year1");
        assert!(found["assumption"].as_str().expect("text").contains("symmetric"), "{found}");
        let p = read_signal(site.join(name).join("p-fwe.shape.gii")).expect("a map").values;
        let effect = read_signal(site.join(name).join("effect.shape.gii")).expect("a map").values;
        assert!(p.iter().all(|p| *p < 0.01), "{p:?}");
        assert!(effect.iter().all(|effect| (0.3..0.7).contains(effect)), "{effect:?}");
    }
    let columns = ["--table", "t.csv", "--model-column", "second", "--minus", "first", "--mean"];
    let by_columns = report(site, &columns, "columns");
    assert_eq!(by_columns["meaning"], "mean of second - first");
    let map = |folder: &str| fs::read(site.join(folder).join("test.csv")).expect("a table");
    assert!(map("columns") == map("plain"));
    let paired = report(site, &["--a", "year2", "--b", "year1", "--paired"], "paired");
    assert_eq!(paired["meaning"], "mean of a - b");
    assert!(map("paired") == map("plain"));
    // A test of a slope exchanges subjects instead of flipping signs.
    let slope = of(&["--effect", "age", "--signal", "position"], "slope");
    assert_eq!((&slope["resampling"], &slope["statistic"]["name"]), (&"permutations".into(), &"T2".into()));
}

#[test]
fn models_smoothed_differently_are_noticed() {
    let site = growing();
    let site = site.path();
    let found = report(site, &["--a", "year2", "--b", "year1"], "alike")["warnings"].to_string();
    assert!(!found.contains("smoothed"), "{found}");
    let smooth = ["smooth", "year2/s3.spharm.npz", "--fwhm", "10", "-q", "-o", "smooth.spharm.npz"];
    succeed(tool("shape").args(smooth).current_dir(site));
    fs::rename(site.join("smooth.spharm.npz"), site.join("year2/s3.spharm.npz")).expect("replaced");
    let found = report(site, &["--a", "year2", "--b", "year1"], "mixed")["warnings"].to_string();
    let [plain, smoothed] = ["19 not smoothed (first: year2/s0.", "1 smoothed by a heat kernel with an FWHM of 10.00"];
    assert!(found.contains(plain) && found.contains(smoothed) && found.contains("year2/s3."), "{found}");
}

#[test]
fn questions_that_mean_nothing_are_refused() {
    let site = site(|subject, year| 10.0 + (subject + year) as f64);
    let site = site.path();
    for (arguments, words) in [
        (&["--table", "t.csv", "--models", "year1", "--mean"][..], "--minus"),
        (&["--table", "t.csv", "--models", "year1"], "--effect"),
        (&["--table", "t.csv", "--models", "year1", "--effect", "age", "--categorical", "site"], "--categorical site"),
        (
            &["--table", "t.csv", "--models", "year1", "--effect", "age", "--permutations", "18446744073709551615"],
            "100000000",
        ),
        (
            &["--table", "t.csv", "--models", "year1", "--effect", "age", "--permutations", "9223372036854775807"],
            "100000000",
        ),
    ] {
        let output = finish(test(site, arguments).args(["-o", "out"]));
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output));
        assert!(text(&output).contains(words), "{arguments:?}: {}", text(&output));
    }
    let some = ["year1/s0.spharm.npz", "year1/s1.spharm.npz"];
    for (a, b, paired, words) in [
        (&some[..], &["year2/s0.spharm.npz"][..], true, "expected 2 models in --b, as in --a, found 1"),
        (&some, &["./year1/s1.spharm.npz", "year2/s2.spharm.npz"], false, "in both groups"),
        (&["year1/s0.spharm.npz", "./year1/s0.spharm.npz"], &["year2/s2.spharm.npz"], false, "in the same group twice"),
    ] {
        let groups = [&["--a"][..], a, &["--b"], b, if paired { &["--paired"] } else { &[] }].concat();
        let error = fail(test(site, &groups).args(["-o", "out"]));
        assert!(error.contains(words), "{error}");
    }
    assert!(!site.join("out").exists());
}

#[test]
fn numbers_that_may_be_codes_and_repeated_subjects_are_named() {
    let site = site(|subject, year| 10.0 + (subject * subject + year) as f64);
    let site = site.path();
    let table = ["--table", "t.csv", "--models", "year1", "--effect", "age", "--covariates", "site"];
    let output = finish(test(site, &table).args(["-o", "slope", "--report", "slope.json"]));
    assert!(text(&output).contains("site: the numbers 1, 2, 3 are treated as quantities"), "{}", text(&output));
    let found: Value =
        serde_json::from_str(&fs::read_to_string(site.join("slope.json")).expect("a report")).expect("JSON");
    assert_eq!(found["numbers_that_may_be_codes"][0]["column"], "site");
    let levels = report(site, &[&table[..], &["--categorical", "site"]].concat(), "levels");
    assert_eq!(levels["design"]["columns"].as_array().expect("columns").len(), 4, "{levels}");
    assert_eq!(levels["numbers_that_may_be_codes"], Value::Array(Vec::new()));

    let rows: String =
        (0..10).map(|s| format!("p{},year1/s{s}.spharm.npz,{}\n", s / 2, if s < 4 { "a" } else { "b" })).collect();
    fs::write(site.join("twice.csv"), format!("participant_id,model,group\n{rows}")).expect("a table");
    let found = report(site, &["--table", "twice.csv", "--effect", "group"], "twice");
    let warnings = found["warnings"].to_string();
    assert!(warnings.contains("5 of 5 subjects have more than one row (participant_id p0 has 2)"), "{warnings}");
    let about = fs::read_to_string(site.join("twice/test.json")).expect("a file");
    assert!(about.contains("have more than one row"), "{about}");
    // Columns of subjects have other names, too. A case with two values is a group.
    let table = |name: &str, each: usize| {
        let row = |s: usize| format!("p{},year1/s{s}.spharm.npz,{}\n", s / each, if s < 4 { "a" } else { "b" });
        let rows: String = (0..10).map(row).collect();
        fs::write(site.join("named.csv"), format!("{name},model,group\n{rows}")).expect("a table");
        report(site, &["--table", "named.csv", "--effect", "group"], name)["warnings"].to_string()
    };
    for name in ["Subj", "PTID", "RID", "child", "Patient ID", "id", "ID", "pid"] {
        let warnings = table(name, 2);
        assert!(warnings.contains(&format!("have more than one row ({name} p0 has 2)")), "{warnings}");
    }
    assert!(!table("case", 5).contains("more than one row"));
}

#[test]
fn unequal_groups_are_warned_of_and_tested_by_welch() {
    let wide = |subject: usize| if subject < 3 { 6.0 * (subject as f64 - 1.0) } else { 0.2 * (subject % 4) as f64 };
    let site = site(|subject, _| 20.0 + wide(subject));
    let site = site.path();
    let names: Vec<String> = (0..10).map(|s| format!("year1/s{s}.spharm.npz")).collect();
    let mut groups: Vec<&str> = names.iter().map(String::as_str).collect();
    groups.insert(3, "--b");
    groups.insert(0, "--a");
    let pooled = report(site, &groups, "pooled");
    let warnings = pooled["warnings"].to_string();
    assert!(
        warnings.contains("a (3 subjects)") && warnings.contains("too small") && warnings.contains("--welch"),
        "{warnings}"
    );
    let welch = report(site, &[&groups[..], &["--welch"]].concat(), "welch");
    assert_eq!((&welch["resampling"], &welch["welch"]), (&"sign flips".into(), &true.into()));
    assert!(!welch["warnings"].to_string().contains("Welch"), "{welch}");
    let least = |report: &Value| report["summary"]["p"]["least"].as_f64().expect("a number");
    assert!(least(&welch) > least(&pooled));
    // The positions of three subjects don't determine a covariance.
    let positions = [&groups[..], &["--welch", "--signal", "position", "-o", "few"]].concat();
    let error = error_line(&finish(&mut test(site, &positions)));
    assert!(error.contains("expected 4 subjects or more"), "{error}");
}

#[test]
fn a_mask_leaves_vertices_out_of_all_that_is_corrected() {
    let site = growing();
    let site = site.path();
    let test = ["--table", "t.csv", "--models", "year2", "--minus", "year1", "--mean"];
    let of = |more: &[&str], name: &str| report(site, &[&test[..], more].concat(), name);
    // Every third of the 42 vertices is tested.
    let mask: String = (0..42).map(|v| format!("{}\n", u8::from(v % 3 == 0))).collect();
    fs::write(site.join("mask.csv"), mask).expect("a mask");
    let (whole, part) = (of(&[], "whole"), of(&["--mask", "mask.csv"], "part"));
    let masks = Value::from(vec!["mask.csv"]);
    assert_eq!((&whole["vertices"], &part["vertices"], &part["mask"]), (&42.into(), &14.into(), &masks));
    let map = |folder: &str, name: &str| {
        read_signal(site.join(folder).join(format!("{name}.shape.gii"))).expect("a map").values
    };
    for name in ["statistic", "effect", "p", "p-permutation", "p-fwe", "q"] {
        let left_out = if name.starts_with(['p', 'q']) { 1.0 } else { 0.0 };
        for (v, (whole, part)) in map("whole", name).into_iter().zip(map("part", name)).enumerate() {
            match (v % 3, name) {
                (1 | 2, _) => assert_eq!(part, left_out, "{name} {v}"),
                // The largest statistic over fewer vertices is smaller.
                (_, "p-fwe") => assert!(part <= whole, "{v}: {part} {whole}"),
                (_, "q") => assert!(part <= 1.0, "{v}"),
                _ => assert_eq!(part, whole, "{name} {v}"),
            }
        }
    }
    assert_eq!(fs::read_to_string(site.join("part/test.csv")).expect("a table").lines().count(), 15);
    // With several masks, the vertices within all of them are tested.
    for (name, modulus) in [("odd.csv", 2), ("third.csv", 3)] {
        let mask: String = (0..42).map(|v| format!("{}\n", u8::from(v % modulus == modulus - 1))).collect();
        fs::write(site.join(name), mask).expect("a mask");
    }
    let both = of(&["--mask", "mask.csv", "--mask", "odd.csv"], "both");
    assert_eq!((&both["vertices"], &both["mask"]), (&7.into(), &Value::from(vec!["mask.csv", "odd.csv"])));
    let table = fs::read_to_string(site.join("both/test.csv")).expect("a table");
    let tested: Vec<&str> = table.lines().skip(1).filter_map(|line| line.split(',').next()).collect();
    assert_eq!(tested, ["3", "9", "15", "21", "27", "33", "39"]);
    let about: Value =
        serde_json::from_str(&fs::read_to_string(site.join("both/test.json")).expect("a description")).expect("JSON");
    assert_eq!((&about["map"], &about["without_counterpart"]), (&"p-fwe".into(), &0.into()));

    fs::write(site.join("short.csv"), "1\n1\n").expect("a mask");
    fs::write(site.join("other.label"), "#!ascii label\n1\n50  1 2 3 0.1\n").expect("a label");
    for (masks, expected) in [
        (
            &["short.csv"][..],
            "short.csv: expected a mask for the 42 vertices of an icosphere of 1 subdivision, found one for 2; give the \
             mask's own sphere with --sphere",
        ),
        (
            &["mask.csv", "other.label"],
            "other.label: expected a mask for the 42 vertices of an icosphere of 1 subdivision, found a FreeSurfer \
             label or annotation, whose surface has other vertices; give the mask's own sphere with --sphere",
        ),
        (&["mask.csv", "third.csv"], "mask.csv, third.csv: expected a vertex within all masks, found none"),
    ] {
        let masks = masks.iter().flat_map(|mask| ["--mask", *mask]);
        let arguments: Vec<&str> = test.into_iter().chain(masks).chain(["-o", "x"]).collect();
        let error = fail(&mut self::test(site, &arguments));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn models_in_another_unit_are_named() {
    let site = site(|subject, _| if subject == 3 { 1e4 } else { 10.0 + 0.3 * subject as f64 });
    for arguments in [
        &["pca", "year1", "-o", "modes.npz"][..],
        &["mean", "year1", "-o", "mean.npz"],
        &["align", "year1", "--group", "--method", "fixed", "-o", "aligned"],
    ] {
        let output = finish(tool("shape").args(arguments).current_dir(site.path()));
        let said = text(&output);
        assert!(output.status.success() && said.contains("s3.spharm.npz: the root mean square radius"), "{said}");
        assert!(said.contains("about 1000 times the lengths of the others"), "{said}");
        assert_eq!(said.matches("another unit").count(), 1, "{said}");
    }
}

#[test]
fn printed_tables_name_models_by_file() {
    let site = growing();
    for verb in ["measure", "describe"] {
        let said = succeed(tool("shape").args([verb, "year1", "--names"]).current_dir(site.path()));
        assert!(said.contains("s3") && !said.contains("year1"), "{said}");
    }
}

#[test]
fn tables_by_name_refuse_models_of_the_same_name() {
    let site = growing();
    for arguments in
        [&["measure", "--names"][..], &["describe", "--names"], &["pca", "--scores", "scores.csv", "-o", "modes.npz"]]
    {
        let models = ["year1/s1.spharm.npz", "year1/s2.spharm.npz", "year2/s1.spharm.npz"];
        let said = fail(tool("shape").args(arguments).args(models).current_dir(site.path()));
        let facts = ["different file names", "s1", "year1/s1.spharm.npz", "year2/s1.spharm.npz", "rename"];
        assert!(facts.iter().all(|fact| said.contains(fact)), "{said}");
        assert!(!site.path().join("modes.npz").exists());
    }
}
