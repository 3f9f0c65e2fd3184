use super::*;
use crate::generate::icosphere;
use crate::mesh::Mesh;
use spharm_testdata::shared;

fn read(name: &str, text: &str) -> Result<Landmarks, SurfaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    Landmarks::read(path)
}

const MARKUPS: &str = r#"{"@schema": "x", "markups": [
  {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": [
    {"id": "1", "label": "tip", "position": [1.5, -2, 3e1], "positionStatus": "defined"},
    {"id": "2", "label": "", "position": [0.1, 0.2, 0.3]},
    {"id": "3", "label": "later", "positionStatus": "undefined"}]},
  {"type": "Fiducial", "coordinateSystem": "RAS", "controlPoints": [{"id": "1", "label": "notch", "position": [4, 5, 6]}]}]}"#;

#[test]
fn every_format_is_read() {
    let slicer = read("a.mrk.json", MARKUPS).unwrap();
    assert_eq!(slicer.names, ["tip", "2", "notch"]);
    assert_eq!(slicer.points, [[1.5, -2.0, 30.0], [0.1, 0.2, 0.3], [-4.0, -5.0, 6.0]]);
    assert_eq!(slicer.frame, Some(Frame::Lps));
    assert_eq!(slicer.in_frame(Frame::Ras).points[0], [-1.5, 2.0, 30.0]);
    assert_eq!(slicer.in_frame(Frame::Ras).in_frame(Frame::Lps), slicer);

    let head = "# Markups fiducial file version = 4.10\n# CoordinateSystem = 0\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,\
                lock,label,desc,associatedNodeID\n";
    let rows = "vtkMRMLMarkupsFiducialNode_0,1,2,3,0,0,0,1,1,1,0,\"tip, left\",,\r\nF_1,4,5,6,0,0,0,1,1,1,0,,,\n";
    let fiducials = read("a.fcsv", &format!("{head}{rows}")).unwrap();
    assert_eq!((fiducials.names, fiducials.frame), (vec!["tip, left".to_owned(), "F_1".to_owned()], Some(Frame::Ras)));
    assert_eq!(fiducials.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(read("a.fcsv", &format!("{head}{rows}").replace("= 0", "= LPS")).unwrap().frame, Some(Frame::Lps));

    let named = read("a.csv", "\u{feff}Label,z,y,x,note\nA,3,2,1,\nB,6,5,4,far\n").unwrap();
    for (name, text) in [
        ("a.csv", "A,1,2,3\nB,4,5,6\n"),
        ("a.tsv", "name\tx\ty\tz\r\nA\t1\t2\t3\r\n\r\nB\t4\t5\t6"),
        ("a.csv", "name;x;y;z\r\nA ;1;2;3\r\nB;4;5;6\r\n"),
        ("a.csv", "A;1;2;3\nB;4;5;6\n"),
        ("a.csv", "name,x,y,z\nA,1,2,3\nC,NA,NA,NA\nB,4,5,6\nD,,,\n,,,\n"),
        ("a.tsv", "E\tnan\tNaN\tNA\nA\t1\t2\t3\nB\t4\t5\t6\n"),
        ("a.json", r#"[{"id": "A", "coordinates": [1, 2, 3]}, {"name": "B", "coordinates": [4, 5, 6]}]"#),
    ] {
        assert_eq!(read(name, text).unwrap(), named, "{name}");
    }
    assert_eq!(named.frame, None);
}

#[test]
fn what_is_written_returns() {
    let folder = tempfile::tempdir().unwrap();
    let points = vec![[0.1, -1e-7, 1.0 / 3.0], [1e9, 2.0, 3.0], [0.0, 1.0, 2.0]];
    let names = ["F-1", "a \"b\", c", "x"].map(str::to_owned).to_vec();
    for frame in [None, Some(Frame::Lps), Some(Frame::Ras)] {
        let landmarks = Landmarks { names: names.clone(), points: points.clone(), frame };
        for name in ["a.mrk.json", "a.fcsv", "a.json", "a.csv", "a.tsv"] {
            let path = folder.path().join(name);
            landmarks.write(&path, true).unwrap();
            let back = Landmarks::read(&path).unwrap();
            assert_eq!((&back.names, &back.points), (&names, &points), "{name}");
            if name.starts_with("a.mrk") || name.starts_with("a.f") {
                assert_eq!(back.frame, frame.or(Some(Frame::Lps)));
            }
            assert!(matches!(landmarks.write(&path, false), Err(SurfaceError::OutputExists { .. })));
        }
    }
}

#[test]
fn what_is_no_landmark_is_named_by_its_place() {
    let nested = "[".repeat(10_000);
    for (name, text, expected) in [
        ("a.csv", "A,1,2,3\nA,1,2,4\n", "each name only once, found \"A\" again in line 2"),
        ("a.csv", "A,1,2,3\nB,1,2\n", "4 cells on line 2, found 3"),
        ("a.csv", "1,2,3\n", "4 cells on line 1, found 3"),
        ("a.csv", "A,1,2,3\nB,1,x,3\n", "a coordinate in cell 3 of line 2, found \"x\""),
        ("a.csv", "A,1,2,nan\n", "finite coordinates in line 1, found NaN"),
        ("a.csv", "A,1,NA,\n", "a coordinate in cell 3 of line 1, found \"NA\""),
        ("a.csv", "A,NA,NA,NA\n", "at least one landmark"),
        ("a.csv", "name;x;y;z\nA;1,5;2;3\n", "a coordinate in cell 2 of line 2, found \"1,5\""),
        ("a.csv", "name,x,y\nA,1,2\n", "a column named z on line 1"),
        ("a.csv", ",1,2,3\n", "a name in line 1"),
        ("a.csv", "\n\n", "at least one landmark"),
        ("a.fcsv", "# CoordinateSystem = XYZ\n", "LPS, RAS, 0 or 1 as the CoordinateSystem on line 1, found \"XYZ\""),
        ("a.fcsv", "1,2,3\n", "14 cells on line 1, found 3"),
        ("a.json", "[{\"id\": \"A\"}]", "coordinates with 3 numbers in entry 0"),
        ("a.json", "[{\"id\": \"A\", \"coordinates\": [1, 2]}]", "entry 0 (counted from 0), found 2"),
        ("a.json", "[{\"id\": \"A\", \"coordinates\": [1, 2, null]}]", "found null"),
        ("a.json", "[{\"coordinates\": [1, 2, 3]}]", "id or name or label in entry 0"),
        ("a.json", "[7]", "an object as entry 0"),
        ("a.json", "[]", "at least one landmark"),
        ("a.json", "{}", "\"markups\""),
        ("a.json", "[{\"id\": \"A\", \"coordinates\": [1, 2, 1e999]}]", "JSON, found number out of range at line 1"),
        ("a.json", nested.as_str(), "JSON, found recursion limit"),
        (
            "a.mrk.json",
            &MARKUPS.replace("\"RAS\"", "\"RSA\""),
            "LPS or RAS as the coordinateSystem of markups 1, found \"RSA\"",
        ),
        ("a.mrk.json", &MARKUPS.replace("\"mm\"", "\"m\""), "coordinateUnits \"m\" is not supported"),
        ("a.mrk.json", &MARKUPS.replace("notch", "tip"), "\"tip\" again in control point 0 of markups 1"),
        ("a.mrk.json", &MARKUPS.replace("\"defined\"", "\"undefined\"").replace("\"tip\"", "\"\\u001b[2J\""), ""),
        ("a.txt", "A,1,2,3\n", ".mrk.json, .fcsv"),
    ] {
        match read(name, text) {
            Ok(_) => assert!(expected.is_empty(), "{name} {text}"),
            Err(error) => {
                let error = error.to_string();
                assert!(!expected.is_empty() && error.contains(expected) && error.contains(name), "{error}");
                assert!(!error.contains(['\n', '\u{1b}']), "{error}");
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sparse.json");
    std::fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
    assert!(Landmarks::read(&path).unwrap_err().to_string().contains("16777216"));
}

#[test]
fn landmarks_in_memory_are_checked_too() {
    let named = |names: &[&str], x: f64| {
        Landmarks::new(names.iter().map(|name| (*name).to_owned()).collect(), vec![[x, 0.0, 0.0]; 2], None)
    };
    assert_eq!(named(&["a", "b"], 1.0).unwrap().points.len(), 2);
    for (names, x, expected) in [
        (&["a", "a"][..], 1.0, "\"a\" again in landmark 1"),
        (&["a", ""], 1.0, "a name"),
        (&["a", "b"], f64::NAN, "NaN"),
    ] {
        let error = named(names, x).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(matches!(named(&["a"], 1.0), Err(SurfaceError::LengthMismatch { expected: 1, found: 2, .. })));
}

#[test]
fn subjects_are_matched_by_names() {
    let subject = |text: &str| read("a.csv", text).unwrap();
    let subjects = [subject("A,1,0,0\nB,2,0,0\nC,3,0,0\n"), subject("C,30,0,0\nA,10,0,0\nD,40,0,0\n")];
    let matched = Landmarks::matched(&subjects);
    assert_eq!(matched.names, ["A", "C"]);
    assert_eq!(matched.points, [[[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]], [[10.0, 0.0, 0.0], [30.0, 0.0, 0.0]]]);
    assert_eq!(matched.alone, [vec!["B".to_owned()], vec!["D".to_owned()]]);
    assert_eq!(Landmarks::matched(&[]).names.len(), 0);
}

#[test]
fn landmarks_of_another_frame_are_turned_onto_the_surface() {
    let sphere = icosphere(3);
    let far =
        Mesh::new(sphere.vertices.iter().map(|&[x, y, z]| [x + 40.0, y - 80.0, z]).collect(), sphere.faces.clone());
    let points = vec![[-40.0, 80.0, 1.0], [-41.0, 80.0, 0.0]];
    let names = vec!["top".to_owned(), "side".to_owned()];
    let said = Landmarks { names, points, frame: Some(Frame::Lps) };
    let placed = said.laid_on(&far);
    assert!(placed.turned && placed.distances.iter().all(|distance| *distance < 1e-9), "{:?}", placed.distances);
    assert_eq!(placed.landmarks.frame, Some(Frame::Ras));
    let unsaid = Landmarks { frame: None, ..said };
    assert!(!unsaid.laid_on(&far).turned && unsaid.laid_on(&far).distances[0] > 100.0);
}

#[test]
fn another_unit_is_named_by_its_factor() {
    let sphere = icosphere(3);
    let body = Mesh::new(sphere.vertices.iter().map(|v| v.map(|x| 50.0 * x)).collect(), sphere.faces.clone());
    let points: Vec<Vec3> = body.vertices.iter().step_by(100).copied().collect();
    let times = |factor: f64| points.iter().map(|point| point.map(|x| factor * x)).collect::<Vec<_>>();
    assert_eq!(unit_factor(&points, &body), None);
    assert_eq!(unit_factor(&times(0.001), &body), Some(1000.0));
    assert_eq!(unit_factor(&times(0.1), &body), Some(10.0));
    assert_eq!(unit_factor(&times(100.0), &body), Some(0.01));
    // No unit is inferred from landmarks in a wrong place, or from too few landmarks.
    assert_eq!(unit_factor(&times(0.3), &body), None);
    assert_eq!(unit_factor(&times(0.1)[..2], &body), None);
}

#[test]
fn landmarks_of_vertebrae_lie_on_their_surfaces() {
    let Some(folder) = shared("vertebrae") else { return };
    for name in ["v010", "v023"] {
        let landmarks = Landmarks::read(folder.join(format!("{name}.json"))).unwrap();
        let mesh = crate::io::read_mesh(folder.join(format!("{name}.ply"))).unwrap();
        assert_eq!(landmarks.names.len(), 10);
        assert!(landmarks.laid_on(&mesh).distances.iter().all(|distance| *distance < 3.0));
    }
}
