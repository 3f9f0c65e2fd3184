//! Volumes of several time points: which one is fitted, recorded, kept and refused.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use ndarray_npy::WriteNpyExt;
use spharm::Model;

use crate::common::{fail, finish, succeed, text, tool};

/// Writes a NIfTI-1 file of 16^3 labels at two time points: a ball of radius 4, and one of radius 6.
fn write_times(path: &Path) {
    let mut bytes = vec![0; 352];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(0, &348_i32.to_le_bytes());
    for (axis, count) in [4_i16, 16, 16, 16, 2, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * axis, &count.to_le_bytes());
    }
    // Type and number of bits of a value: unsigned, 8 bits.
    put(70, &2_i16.to_le_bytes());
    put(72, &8_i16.to_le_bytes());
    for axis in 0..4 {
        put(76 + 4 * axis, &1_f32.to_le_bytes());
    }
    put(108, &352_f32.to_le_bytes());
    put(344, b"n+1\0");
    for radius in [4.0_f64, 6.0] {
        for at in 0..16_usize.pow(3) {
            let [x, y, z] = [at % 16, at / 16 % 16, at / 256].map(|x| x as f64 - 7.4);
            bytes.push(u8::from(x * x + y * y + z * z <= radius * radius));
        }
    }
    fs::write(path, bytes).unwrap();
}

#[test]
fn one_time_of_several_is_fitted_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_times(&at("v.nii"));
    let run = |arguments: &[&str]| {
        let mut command = tool(arguments[0]);
        command.args(&arguments[1..]).current_dir(folder.path());
        command
    };
    let fit = |more: &[&str]| run(&[&["fit", "v.nii", "--max-degree", "6", "-o", "m.spharm.npz"][..], more].concat());
    let refused = fail(&mut fit(&[]));
    assert!(refused.contains("give --time N from 1 to 2"), "{refused}");
    assert!(fail(&mut fit(&["--time", "3"])).contains("time 3"));
    let zero = finish(&mut fit(&["--time", "0"]));
    assert!(zero.status.code() == Some(2) && text(&zero).contains("expected a whole number of at least 1"));
    succeed(&mut fit(&["--time", "1"]));
    let input = Model::read(at("m.spharm.npz")).unwrap().provenance.input.unwrap();
    assert_eq!((input.label, input.channel, input.time), (Some(1), None, Some(1)));
    succeed(&mut fit(&["--time", "1", "--skip-existing"]));
    // The model of another time is another model.
    let other = fail(&mut fit(&["--time", "2", "--skip-existing"]));
    assert!(other.contains("m.spharm.npz"), "{other}");
    succeed(&mut fit(&["--time", "2", "--update"]));
    let input = Model::read(at("m.spharm.npz")).unwrap().provenance.input.unwrap();
    assert_eq!(input.time, Some(2));
    for (time, name) in [("1", "one"), ("2", "two")] {
        succeed(&mut run(&["volumes", "v.nii", "--time", time, "--max-degree", "6", "-o", name]));
    }
    let voxels = |name: &str| -> f64 {
        let table = fs::read_to_string(at(name).join("volumes.tsv")).unwrap();
        let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split('\t').collect()).collect();
        let column = rows[0].iter().position(|head| *head == "voxels").unwrap();
        rows[1][column].parse().unwrap()
    };
    let balls = voxels("two") / voxels("one");
    assert!((balls / 1.5_f64.powi(3) - 1.0).abs() < 0.05, "{balls}");
}

/// Models of two times share a folder and a table only under names that differ, and models of an earlier run that
/// remain in the folder are named.
#[test]
fn times_in_one_folder_are_kept_apart() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_times(&at("v.nii"));
    let run = |time: &str, more: &[&str]| {
        let mut command = tool("volumes");
        command.current_dir(folder.path()).args(["v.nii", "--time", time, "--max-degree", "4", "-o", "s"]).args(more);
        command
    };
    let column = |name: &str| -> Vec<String> {
        let table = fs::read_to_string(at("s/volumes.tsv")).unwrap();
        let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split('\t').collect()).collect();
        let column = rows[0].iter().position(|head| *head == name).unwrap();
        rows[1..].iter().map(|row| row[column].to_owned()).collect()
    };
    succeed(&mut run("1", &[]));
    assert_eq!(column("time"), ["1"]);
    let template = ["--skip-existing", "--name-template", "{stem}.t{time}"];
    for refused in [fail(&mut run("2", &[])), fail(&mut run("2", &["--skip-existing"]))] {
        assert!(refused.contains("--skip-existing --name-template '{stem}.t{time}'"), "{refused}");
    }
    succeed(&mut run("2", &template));
    assert_eq!(column("time"), ["2", "1"]);
    assert_eq!(column("model"), ["s/v.t2.1.spharm.npz", "s/v.1.spharm.npz"]);
    // Without --time the table has other columns, and the template lacks a number.
    let mut without = tool("volumes");
    without.current_dir(folder.path()).args(["v.nii", "--max-degree", "4", "-o", "s"]).args(template);
    let without = finish(&mut without);
    assert!(
        without.status.code() == Some(2) && text(&without).contains("so --time must be given"),
        "{}",
        text(&without)
    );
    // A new table names the models that it lacks.
    let output = finish(run("1", &["--force", "-q"]).args(["--name-template", "{stem}.t{time}"]));
    let warned =
        "s: 2 models are not in s/volumes.tsv (v.1.spharm.npz, v.t2.1.spharm.npz), perhaps from an earlier run";
    assert!(output.status.success() && text(&output).contains(warned), "{}", text(&output));
}

/// Two time points of one file are different subjects: quality control doesn't call them equal, and all stages read
/// the chosen one.
#[test]
fn time_points_of_one_file_form_a_group() {
    let folder = tempfile::tempdir().unwrap();
    let site = folder.path();
    write_times(&site.join("v.nii"));
    let run = |arguments: &[&str]| {
        let mut command = tool(arguments[0]);
        command.args(&arguments[1..]).current_dir(site);
        command
    };
    for time in ["1", "2"] {
        let model = format!("models/t{time}.spharm.npz");
        fs::create_dir_all(site.join("models")).unwrap();
        succeed(&mut run(&["fit", "v.nii", "--time", time, "--max-degree", "6", "-o", &model]));
    }
    fs::copy(site.join("models/t2.spharm.npz"), site.join("models/t3.spharm.npz")).unwrap();
    let output = run(&["shape", "check", "models", "-o", "check.tsv"]).output().unwrap();
    let table = fs::read_to_string(site.join("check.tsv")).unwrap_or_else(|_| panic!("{}", text(&output)));
    let row = |id: &str| table.lines().find(|line| line.starts_with(id)).unwrap().to_owned();
    assert!(!row("t1").contains("same input") && row("t3").contains("same input"), "{table}");
    let correspond =
        |time: &str| run(&["shape", "correspond", "v.nii", "--to", "group", "--time", time, "-o", "joined"]);
    let group = ["a.nii", "b.nii", "c.nii"];
    for name in group {
        fs::copy(site.join("v.nii"), site.join(name)).unwrap();
    }
    let all = [&["shape", "correspond"][..], &group, &["--time", "1", "--max-degree", "6", "-o", "group"]].concat();
    succeed(&mut run(&all));
    succeed(&mut correspond("1"));
    let present = succeed(&mut correspond("1"));
    let other = fail(&mut correspond("2"));
    assert!(other.contains("made from another file"), "{present} {other}");
    // A member made with another order of the axes isn't accepted.
    let ball = fs::read(site.join("v.nii")).unwrap()[352..352 + 16_usize.pow(3)].to_vec();
    let ball = Array3::from_shape_vec((16, 16, 16), ball).unwrap();
    ball.write_npy(fs::File::create(site.join("w.npy")).unwrap()).unwrap();
    let of_array = |axes: &str| {
        let size = ["--voxel-size", "1,1,1", "--axes", axes, "-o", "joined"];
        run(&[&["shape", "correspond", "w.npy", "--to", "group"][..], &size].concat())
    };
    succeed(&mut of_array("xyz"));
    succeed(&mut of_array("xyz"));
    let other = fail(&mut of_array("zyx"));
    assert!(other.contains("the existing member w was made with --axes xyz, not zyx"), "{other}");
}
