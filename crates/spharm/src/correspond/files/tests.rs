use std::fs;
use std::path::Path;

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_surface::{Kind, Similarity, Sphere};

use super::*;
use crate::correspond::{CorrespondReport, Group, GroupTemplate, NewMember};

/// Returns a group of two members of degree 2 over twelve directions.
fn group() -> Group {
    let sphere = Sphere::icosphere(0);
    let coefficients = |seed: f64| {
        Coefficients::new(Array2::from_shape_fn((9, 3), |(i, j)| (seed + i as f64 / 3.0 + j as f64).sin())).unwrap()
    };
    let report = |rms| MemberReport {
        pose_distance: 0.1,
        cover_rms: rms,
        cover_most: 0.3,
        cover_farthest: 1.0 / 3.0,
        unreached: 0.01,
        without_counterpart: 2,
        turned: 0,
        model_rms: 1e-3,
        area: 2.0,
        volume: 1.0 / 3.0,
    };
    let places = |seed: f64| (0..12).map(|v| [seed, f64::from(v).sqrt(), 0.1]).collect::<Vec<_>>();
    let moved = Similarity { scale: 1.1, translation: [0.1, 1.0 / 3.0, 1e-9], ..Similarity::default() };
    let mut masked = vec![false; 12];
    masked[7] = true;
    let mut reached = vec![true; 12];
    reached[3] = false;
    Group {
        models: [1.0, 2.0].map(|seed| Model::new(sphere.clone(), coefficients(seed), Kind::Surface)).to_vec(),
        similarities: vec![Similarity::default(), moved],
        places: vec![places(1.0), places(2.0)],
        reached: vec![vec![true; 12], reached],
        template: GroupTemplate { sphere, mean: coefficients(1.5), masked, spread: 0.7, refined: false },
        report: CorrespondReport {
            template: Some(1),
            changes: vec!["a hole was filled".to_owned()],
            members: vec![report(0.1), report(0.2)],
            warnings: Vec::new(),
            axes: None,
            guide: None,
            refinement: None,
            seconds: vec![("poses", 0.25), ("fits", 1.5)],
        },
    }
}

fn origins() -> Vec<MemberOrigin> {
    ["a", "b"].map(|name| MemberOrigin { name: name.to_owned(), ..MemberOrigin::default() }).to_vec()
}

fn listed(folder: &Path) -> usize {
    let count = |folder: &Path| {
        fs::read_dir(folder).map_or(0, |entries| entries.filter(|e| e.as_ref().unwrap().path().is_file()).count())
    };
    count(folder) + count(&folder.join("places")) + count(&folder.join("members"))
}

#[test]
fn groups_return_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let group = group();
    group.write(folder.path(), &origins(), false).unwrap();
    let files = GroupFiles::open(folder.path()).unwrap();
    assert_eq!(files.names(), ["a", "b"]);
    let read = files.group().unwrap();
    assert_eq!(read.similarities, group.similarities);
    assert_eq!((&read.places, &read.reached), (&group.places, &group.reached));
    assert_eq!(read.template.mean, group.template.mean);
    assert_eq!(read.template.masked, group.template.masked);
    assert_eq!(read.template.sphere.faces, group.template.sphere.faces);
    assert_eq!((read.template.spread, read.report.template), (0.7, Some(1)));
    assert_eq!((&read.report.changes, &read.report.seconds), (&group.report.changes, &group.report.seconds));
    for (found, own) in read.models.iter().zip(&group.models) {
        assert_eq!(found.coefficients, own.coefficients);
    }
    let point = [[0.9, 1.2, 0.1]];
    assert_eq!(read.carry(&point, 0, 1).unwrap(), group.carry(&point, 0, 1).unwrap());
    let one = files.members(&[1]).unwrap();
    assert_eq!((one.places, one.report.template), (vec![group.places[1].clone()], Some(0)));
    assert!(files.members(&[2]).is_err());
}

#[test]
fn what_exists_stays_and_nothing_is_left_half_written() {
    let folder = tempfile::tempdir().unwrap();
    let group = group();
    fs::create_dir_all(folder.path().join("places")).unwrap();
    fs::write(folder.path().join("places/b.npz"), "somebody's").unwrap();
    assert!(group.write(folder.path(), &origins(), false).is_err());
    assert_eq!(listed(folder.path()), 1);
    assert_eq!(fs::read(folder.path().join("places/b.npz")).unwrap(), b"somebody's");
    group.write(folder.path(), &origins(), true).unwrap();
    group.write(folder.path(), &origins(), true).unwrap();
    assert!(group.write(folder.path(), &origins(), false).unwrap_err().to_string().contains("exists"));
    // A folder already has the name of one of the files, so writing fails, and the files written before are removed.
    let other = tempfile::tempdir().unwrap();
    fs::create_dir_all(other.path().join("b.spharm.npz")).unwrap();
    assert!(group.write(other.path(), &origins(), true).is_err());
    assert_eq!(listed(other.path()), 0);
    for bad in ["", "mean", "a/b", "a", ".b"] {
        let mut names = origins();
        names[1].name = bad.to_owned();
        assert!(group.write(&other.path().join("x"), &names, false).is_err(), "{bad}");
    }
    assert!(group.write(&other.path().join("x"), &origins()[..1], false).is_err() && !other.path().join("x").exists());
}

#[test]
fn members_are_added_beside_a_group() {
    let folder = tempfile::tempdir().unwrap();
    let mut group = group();
    group.template.begin_folder(folder.path()).unwrap();
    group.template.begin_folder(folder.path()).unwrap();
    assert_eq!(GroupFiles::open(folder.path()).unwrap().names().len(), 0);
    let member = NewMember {
        model: group.models[1].clone(),
        similarity: group.similarities[1],
        places: group.places[1].clone(),
        reached: group.reached[1].clone(),
        report: group.report.members[1],
        warnings: Vec::new(),
    };
    let origin = &MemberOrigin { axes: Some("zyx".to_owned()), ..origins()[1].clone() };
    assert_eq!(GroupFiles::origin(folder.path(), "b").unwrap(), None);
    member.write(folder.path(), origin, false).unwrap();
    assert_eq!(GroupFiles::origin(folder.path(), "b").unwrap().as_ref(), Some(origin));
    assert!(member.write(folder.path(), origin, false).is_err());
    let read = GroupFiles::open(folder.path()).unwrap().group().unwrap();
    assert_eq!(read.places, [group.places[1].clone()]);
    group.template.masked[0] = true;
    let error = group.template.begin_folder(folder.path()).unwrap_err().to_string();
    assert!(error.contains("group.json") && error.contains("another group"), "{error}");
    // Records of earlier versions lack the axes.
    let path = folder.path().join("members/b.json");
    let mut record: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    record.as_object_mut().unwrap().remove("axes").unwrap();
    fs::write(&path, record.to_string()).unwrap();
    assert_eq!(GroupFiles::origin(folder.path(), "b").unwrap().unwrap().axes, None);
}

#[test]
fn records_state_whether_members_are_mirror_images() {
    let folder = tempfile::tempdir().unwrap();
    let mut group = group();
    group.similarities[1] = Similarity::reflection().then(&group.similarities[1]);
    group.write(folder.path(), &origins(), false).unwrap();
    let path = folder.path().join("members/b.json");
    let mut record: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    assert_eq!((&record["mirrored"], &record["mirrored_first"]), (&true.into(), &false.into()));
    let first = || GroupFiles::origin(folder.path(), "b").unwrap().unwrap().mirrored;
    assert!(!first());
    // In records of earlier versions, `mirrored` states whether the surface was mirrored first.
    record.as_object_mut().unwrap().remove("mirrored_first").unwrap();
    fs::write(&path, record.to_string()).unwrap();
    assert!(first());
}

#[test]
fn what_is_damaged_is_named() {
    let group = group();
    let changed = |file: &str, change: &dyn Fn(&Path)| {
        let folder = tempfile::tempdir().unwrap();
        group.write(folder.path(), &origins(), false).unwrap();
        change(&folder.path().join(file));
        let found = GroupFiles::open(folder.path()).and_then(|files| files.group());
        let error = found.expect_err(file).to_string();
        assert!(error.contains(file.rsplit('/').next().unwrap()), "{file}: {error}");
        error
    };
    for file in ["group.json", "mean.spharm.npz", "a.spharm.npz", "places/b.npz", "members/b.json"] {
        changed(file, &|path| fs::remove_file(path).unwrap());
        changed(file, &|path| {
            let bytes = fs::read(path).unwrap();
            fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        });
        changed(file, &|path| fs::write(path, "").unwrap());
    }
    let text = |from: &'static str, to: &'static str| {
        move |path: &Path| {
            let text = fs::read_to_string(path).unwrap();
            assert!(text.contains(from), "{text}");
            fs::write(path, text.replacen(from, to, 1)).unwrap();
        }
    };
    let error = changed("group.json", &text("\"version\": 1", "\"version\": 2"));
    assert!(error.contains("version 1, found 2"), "{error}");
    changed("group.json", &text("    7\n", "    12\n"));
    changed("group.json", &text("\"a\"", "\"../a\""));
    changed("members/b.json", &text("\"scale\": 1.1", "\"scale\": -1.1"));
    changed("members/b.json", &text("\"name\": \"b\"", "\"name\": \"c\""));
    // The array `places` has 3 rows instead of 12.
    let error = changed("places/b.npz", &|path| {
        let few = Array2::<f64>::zeros((3, 3));
        let entries = [("places", spharm_model::arrays::Entry::Matrix(few.view())); 1];
        let reached = Array2::<f64>::zeros((12, 1));
        let both = [entries[0], ("reached", spharm_model::arrays::Entry::Matrix(reached.view()))];
        spharm_model::arrays::write_arrays(path, true, &both).unwrap();
    });
    assert!(error.contains("(12, 3)") && error.contains("(3, 3)"), "{error}");
    let degree = Model::without_sphere(Coefficients::new(Array2::ones((4, 3))).unwrap(), Kind::Surface);
    let error = changed("a.spharm.npz", &|path| degree.write_with(path, true).unwrap());
    assert!(error.contains("degree 2"), "{error}");
}
