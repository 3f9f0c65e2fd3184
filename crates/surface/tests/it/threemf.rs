//! Tests that 3MF files are read as they are placed, and that archives that lie are refused.

use std::fs;
use std::io::{Cursor, Read, Write};

use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::{Mesh, SurfaceError};
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

/// Reads an archive with these parts.
fn read(parts: &[(&str, &[u8])]) -> Result<Mesh, SurfaceError> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in parts {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    read_bytes(&zip.finish().unwrap().into_inner())
}

fn read_bytes(bytes: &[u8]) -> Result<Mesh, SurfaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.3mf");
    fs::write(&path, bytes).unwrap();
    read_mesh(&path)
}

fn read_model(model: &str) -> Result<Mesh, SurfaceError> {
    read(&[("3D/3dmodel.model", model.as_bytes())])
}

/// Returns a model of objects and a build.
fn model(objects: &str, build: &str) -> String {
    format!(
        "<model xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\"><resources>{objects}</resources>\
         <build>{build}</build></model>"
    )
}

const TRIANGLE: &str = "<object id=\"1\"><mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" \
                        z=\"0\"/><vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles><triangle v1=\"0\" v2=\"1\" \
                        v3=\"2\"/></triangles></mesh></object>";

#[test]
fn the_same_mesh_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a.3mf", "b.3mf"].map(|name| {
        let path = folder.path().join(name);
        write_mesh(&path, &icosphere(2), &WriteOptions::default()).unwrap();
        fs::read(path).unwrap()
    });
    assert_eq!(a, b);
    let mut archive = ZipArchive::new(Cursor::new(a)).unwrap();
    let mut text = String::new();
    archive.by_name("3D/3dmodel.model").unwrap().read_to_string(&mut text).unwrap();
    assert!(text.contains("unit=\"millimeter\"") && text.contains("<item objectid=\"1\"/>"), "{}", &text[..300]);
}

#[test]
fn objects_in_objects_are_placed_from_the_inside_out() {
    let inner = "<object id=\"2\"><components><component objectid=\"1\" transform=\"2 0 0 0 2 0 0 0 2 1 0 0\"/>\
                 </components></object>";
    let mesh = read_model(&model(
        &format!("{TRIANGLE}{inner}"),
        "<item objectid=\"2\" transform=\"0 1 0 -1 0 0 0 0 1 0 0 5\"/><item objectid=\"1\"/>",
    ));
    let mesh = mesh.unwrap();
    // Doubled and shifted along x, then turned by 90 degrees about z and raised.
    assert_eq!(mesh.vertices[..3], [[0.0, 1.0, 5.0], [0.0, 3.0, 5.0], [-2.0, 1.0, 5.0]]);
    assert_eq!(mesh.vertices[3..], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(mesh.faces, [[0, 1, 2], [3, 4, 5]]);
    // A model without a build has its meshes.
    assert_eq!(read_model(&model(TRIANGLE, "")).unwrap().faces, [[0, 1, 2]]);
}

#[test]
fn what_is_missing_or_wrong_is_named() {
    let item = "<item objectid=\"1\"/>";
    for (text, what) in [
        (model(TRIANGLE, "<item objectid=\"9\"/>"), "expected object 9 in 3D/3dmodel.model"),
        (model(TRIANGLE, "<item/>"), "an attribute objectid in the element item"),
        (model(TRIANGLE, "<item objectid=\"1\" transform=\"1 0 0\"/>"), "12 numbers in a transform"),
        (model(TRIANGLE, "<item objectid=\"1\" path=\"/3D/other.model\"/>"), "the part 3D/other.model"),
        (model(&TRIANGLE.replace("v3=\"2\"", "v3=\"3\""), item), "a vertex number below 3"),
        (model(&TRIANGLE.replace("v3=\"2\"", ""), item), "v1, v2 and v3"),
        (model(&TRIANGLE.replacen("x=\"0\"", "x=\"a\"", 1), item), "a number as x of a vertex"),
        (model(&TRIANGLE.replacen("x=\"0\"", "", 1), item), "x, y and z of each vertex"),
        ("<other/>".to_owned(), "a model element"),
        ("<model>".to_owned(), "closing tag"),
    ] {
        let error = read_model(&text).unwrap_err();
        assert!(matches!(error, SurfaceError::Malformed { .. }), "{error}");
        assert!(error.to_string().contains(what), "{what}: {error}");
    }
    let slices = model(TRIANGLE, item).replace(
        "<model ",
        "<model requiredextensions=\"s\" xmlns:s=\"http://schemas.microsoft.com/3dmanufacturing/slice/2015/07\" ",
    );
    let error = read_model(&slices).unwrap_err();
    assert!(matches!(error, SurfaceError::Unsupported { .. }) && error.to_string().contains("slice"), "{error}");
    let utf16: Vec<u8> = [0xff, 0xfe].into_iter().chain(slices.bytes().flat_map(|b| [b, 0])).collect();
    let error = read(&[("3D/3dmodel.model", &utf16)]).unwrap_err();
    assert!(error.to_string().contains("UTF-16"), "{error}");
    assert!(read(&[("other", b"")]).unwrap_err().to_string().contains("3D/3dmodel.model"));
    assert!(read_bytes(b"solid").unwrap_err().to_string().contains("a zip archive"));
}

#[test]
fn objects_in_themselves_and_archives_that_swell_are_refused() {
    let object = |id: usize, parts: &str| format!("<object id=\"{id}\"><components>{parts}</components></object>");
    let part = |id: usize| format!("<component objectid=\"{id}\"/>");
    let error = read_model(&model(&object(1, &part(1)), "<item objectid=\"1\"/>")).unwrap_err();
    assert!(error.to_string().contains("inside itself"), "{error}");
    // Each object has the one before it twice: 2^30 triangles, or as many objects of nothing.
    for first in [TRIANGLE.to_owned(), object(1, "")] {
        let doubled: String = (2..=30).map(|id| object(id, &part(id - 1).repeat(2))).collect();
        let error = read_model(&model(&format!("{first}{doubled}"), "<item objectid=\"30\"/>")).unwrap_err();
        assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
    }
    let swelling = format!("<model>{}</model>", " ".repeat(100 << 20));
    let error = read_model(&swelling).unwrap_err();
    assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
}

/// A check sum guards the parts of an archive, so that bytes changed in the archive never reach the XML's parser.
#[test]
fn changed_bytes_of_a_model_never_panic() {
    let inner = "<object id=\"2\"><components><component objectid=\"1\" transform=\"2 0 0 0 2 0 0 0 2 1 0 0\"/>\
                 </components></object>";
    let text = model(&format!("{TRIANGLE}{inner}"), "<item objectid=\"2\"/><item objectid=\"1\"/>").into_bytes();
    let whole = read(&[("3D/3dmodel.model", &text)]).unwrap();
    assert_eq!(whole.faces.len(), 2);
    let mut random = crate::Random(7);
    for _ in 0..400 {
        let mut bent = text.clone();
        for _ in 0..1 + random.below(3) {
            let at = random.below(bent.len());
            bent[at] = b"0123456789-.<>\"/ =&\xff"[random.below(20)];
        }
        let _ = read(&[("3D/3dmodel.model", &bent)]);
    }
    for length in 0..text.len() {
        assert!(read(&[("3D/3dmodel.model", &text[..length])]).is_err(), "{length}");
    }
}
