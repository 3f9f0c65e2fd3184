//! Study files written by `study init`, filled in for tables without paths.

use std::fs;
use std::path::Path;

use crate::common::{fail, finish, succeed, text, tool};

fn write(site: &Path, name: &str) {
    let path = site.join(name);
    fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    fs::write(path, "").expect("a file");
}

fn init(site: &Path, table: &str) -> String {
    let output = finish(tool("study").args(["init", "--force", "--table", table]).current_dir(site));
    assert!(output.status.success(), "{}", text(&output));
    text(&output)
}

fn has_lines(site: &Path, lines: &[&str]) {
    let written = fs::read_to_string(site.join("study.toml")).expect("a study");
    for line in lines {
        assert!(written.lines().any(|found| found == *line), "{line}\n{written}");
    }
}

/// Problem of first-time users, row 11: the table of a BIDS dataset is enough for a study.
#[test]
fn a_study_of_a_bids_dataset_runs_as_it_was_written() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let mut table = "participant_id\tage\tgroup\n".to_owned();
    for (number, id) in ["sub-1", "sub-2", "sub-3", "sub-4", "sub-5", "sub-10"].into_iter().enumerate() {
        let surface = format!("derivatives/{id}/anat/{id}_hemi-L_pial.surf.gii");
        write(site, &surface);
        write(site, &format!("{id}/anat/{id}_T1w.nii.gz"));
        let variant = number.to_string();
        let mut generate = tool("generate");
        generate.args(["--subdivisions", "2", "--variant", &variant, "--force", "-q", "--surface", &surface]);
        succeed(generate.current_dir(site));
        table += &format!("{id}\t{}\t{}\n", 30 + number, ["a", "b"][number % 2]);
    }
    // A few subjects also have another surface.
    write(site, "other/sub-3/lh.pial");
    fs::write(site.join("participants.tsv"), table).expect("a table");
    let said = init(site, "participants.tsv");
    assert!(said.contains("(6 of 6 subjects have such a file)") && said.contains("tested: group, a minus b"), "{said}");
    has_lines(
        site,
        &[
            "id = \"participant_id\"",
            "surface = \"derivatives/{id}/anat/{id}_hemi-L_pial.surf.gii\"",
            "# or, for 1 subject: surface = \"other/{id}/lh.pial\"",
            "effect = \"group\"",
        ],
    );
    succeed(tool("study").args(["study.toml", "--dry-run"]).current_dir(site));
}

#[test]
fn the_subjects_of_freesurfer_have_spheres() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    for id in ["bert", "ernie"] {
        ["lh.pial", "lh.white", "lh.sphere.reg"].iter().for_each(|name| write(site, &format!("fs/{id}/surf/{name}")));
    }
    fs::write(site.join("t.csv"), "who,dx\nbert,x\nernie,y\n").expect("a table");
    init(site, "t.csv");
    has_lines(
        site,
        &[
            "id = \"who\"",
            "surface = \"fs/{id}/surf/lh.pial\"",
            "sphere = \"fs/{id}/surf/lh.sphere.reg\"",
            "effect = \"dx\"",
        ],
    );
}

#[test]
fn a_table_whose_subjects_have_no_files_says_what_to_fill_in() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    fs::write(site.join("t.tsv"), "participant_id\tage\ns1\t1\ns2\t2\ns3\t4\n").expect("a table");
    let said = init(site, "t.tsv");
    assert!(said.contains("an id such as \"s1\"") && said.contains("tested: age"), "{said}");
    let error = fail(tool("study").args(["init", "--force", "--table", "gone.tsv"]).current_dir(site));
    assert!(error.contains("gone.tsv"), "{error}");
}

/// The subject whose header states voxels ten times too wide is the first in the table of the quality control.
#[test]
fn a_generated_study_of_labels_names_its_wrong_header() {
    let site = tempfile::tempdir().expect("a folder");
    let site = site.path();
    let made = succeed(tool("generate").args(["--volumes", "labels", "--subjects", "8"]).current_dir(site));
    assert!(made.contains("8 label volumes") && made.contains("the header of a04"), "{made}");
    let large = finish(tool("generate").args(["--volumes", "more", "--bump", "2000"]).current_dir(site));
    assert!(!large.status.success() && text(&large).contains("from -100 to 100 mm"), "{}", text(&large));
    succeed(tool("study").args(["init", "--table", "labels/study.csv"]).current_dir(site));
    let written = fs::read_to_string(site.join("study.toml")).expect("a study");
    fs::write(site.join("study.toml"), written.replace("[align]", "[align]\nmethod = \"joint\"")).expect("a study");
    let output = finish(tool("study").args(["study.toml", "-q"]).current_dir(site));
    assert!(output.status.success() && !text(&output).contains("the sform and the qform"), "{}", text(&output));
    let quality = fs::read_to_string(site.join("study/quality.tsv")).expect("a table");
    let first = quality.lines().nth(1).expect("a row");
    assert!(first.starts_with("a04\t") && first.contains("another unit: about 10 times"), "{quality}");
    assert!(quality.lines().skip(2).all(|row| !row.contains("another unit: about")), "{quality}");
    // The numbers of voxels are those of the generated bodies.
    let at = quality.lines().next().and_then(|head| head.split('\t').position(|name| name == "voxels"));
    let voxels =
        |line: &str| line.split('\t').nth(at.expect("a column")).map(|cell| cell.parse::<f64>().expect("a number"));
    let counts: Vec<f64> = quality.lines().skip(1).filter_map(voxels).collect();
    assert!(counts.len() == 8 && counts.iter().all(|count| (6e3..9e3).contains(count)), "{counts:?}");
}
