//! Tests that every reader returns the same contents as the reference library of the format.

use serde_json::Value;
use spharm_surface::io::{read_input, read_mesh, read_signal};
use spharm_surface::{Input, Mesh, Signal, SurfaceError};

use crate::{fixture_files, fixtures};

fn expected() -> Value {
    let text = std::fs::read_to_string(fixtures().join("expected.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn numbers<const N: usize>(value: &Value) -> Vec<[f64; N]> {
    let rows = value.as_array().unwrap().iter();
    rows.map(|row| std::array::from_fn(|i| row[i].as_f64().unwrap())).collect()
}

fn faces(value: &Value) -> Vec<[u32; 3]> {
    numbers::<3>(value).iter().map(|f| f.map(|i| i as u32)).collect()
}

/// Rotates a triangle so that its smallest index comes first. Libraries start the triangles of a quadrangle at
/// different corners.
fn rotated(face: [u32; 3]) -> [u32; 3] {
    let mut face = face;
    while face[0] != *face.iter().min().unwrap() {
        face.rotate_left(1);
    }
    face
}

/// Rotates the corners of a triangle so that the least comes first.
fn from_least(corners: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let mut corners = corners;
    for _ in 0..2 {
        if corners.iter().any(|corner| corner < &corners[0]) {
            corners.rotate_left(1);
        }
    }
    corners
}

fn check_mesh(name: &str, mesh: &Mesh, expected: &Value) {
    if let Some(corners) = expected.get("corners") {
        // STL has no shared vertices, and those of scenes are merged. The number of distinct vertices and the corners
        // of each triangle are compared instead.
        assert_eq!(mesh.vertices.len() as u64, expected["unique"].as_u64().unwrap(), "{name}");
        assert_eq!(mesh.faces.len(), corners.as_array().unwrap().len(), "{name}");
        for (face, triangle) in mesh.faces.iter().zip(corners.as_array().unwrap()) {
            let found = face.map(|i| mesh.vertices[i as usize]);
            let wanted: [[f64; 3]; 3] = numbers::<3>(triangle).try_into().unwrap();
            assert_eq!(from_least(found), from_least(wanted), "{name}");
        }
        return;
    }
    assert_eq!(mesh.vertices, numbers::<3>(&expected["vertices"]), "{name}");
    let found: Vec<_> = mesh.faces.iter().copied().map(rotated).collect();
    let wanted: Vec<_> = faces(&expected["faces"]).into_iter().map(rotated).collect();
    assert_eq!(found, wanted, "{name}");
}

#[test]
fn every_file_reads_as_its_own_library_reads_it() {
    let expected = expected();
    for path in fixture_files() {
        let name = path.file_name().unwrap().to_str().unwrap();
        let expected = expected.get(name).unwrap_or_else(|| panic!("{name} has no answer"));
        match read_input(&path).unwrap() {
            Input::Mesh(mesh) => check_mesh(name, &mesh, expected),
            Input::Signal(Signal { values, vertices, channels }) => {
                let rows = expected["signal"].as_array().unwrap();
                assert_eq!((vertices, channels), (rows.len(), rows[0].as_array().unwrap().len()), "{name}");
                let wanted = rows.iter().flat_map(|row| row.as_array().unwrap());
                assert_eq!(values, wanted.map(|x| x.as_f64().unwrap()).collect::<Vec<_>>(), "{name}");
            }
        }
    }
}

#[test]
fn gifti_metadata_and_coordinate_system_are_kept() {
    let expected = expected();
    for path in fixture_files() {
        let name = path.file_name().unwrap().to_str().unwrap();
        if !name.contains(".surf.gii") {
            continue;
        }
        let expected = &expected[name];
        let meta = read_mesh(&path).unwrap().meta;
        assert_eq!(meta.anatomical_structure_primary.as_deref(), expected["structure"].as_str());
        let note = meta.surface_metadata.iter().find(|(n, _)| n == "Note").unwrap();
        assert_eq!(Some(note.1.as_str()), expected["note"].as_str(), "{name}: entities resolved");
        assert!(meta.surface_metadata.iter().all(|(n, _)| n != "AnatomicalStructurePrimary"));
        assert_eq!(meta.file_metadata, [("UserName".to_owned(), "tester".to_owned())], "{name}");
        let system = meta.coordinate_system.unwrap();
        assert_eq!(system.data_space, "NIFTI_XFORM_SCANNER_ANAT");
        assert_eq!(system.transformed_space, "NIFTI_XFORM_TALAIRACH");
        let matrix: Vec<f64> = expected["matrix"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        assert_eq!(system.matrix.to_vec(), matrix);
    }
}

#[test]
fn freesurfer_comment_and_footer_are_kept_byte_for_byte() {
    let expected = expected();
    for name in ["lh.pial", "rh.white"] {
        let meta = read_mesh(fixtures().join(name)).unwrap().meta;
        assert_eq!(meta.freesurfer_stamp.as_deref(), expected[name]["stamp"].as_str());
        let footer = expected[name]["footer"].as_array();
        let footer: Option<Vec<u8>> = footer.map(|f| f.iter().map(|b| b.as_u64().unwrap() as u8).collect());
        assert_eq!(meta.freesurfer_footer, footer);
    }
    assert!(expected["lh.pial"]["footer"].as_array().unwrap().len() > 100, "the footer is there to be kept");
}

#[test]
fn a_signal_is_no_surface_nor_a_surface_a_signal() {
    let error = read_mesh(fixtures().join("series.func.gii")).unwrap_err();
    assert!(matches!(error, SurfaceError::NotAMesh { vertices: 12, channels: 4, .. }), "{error}");
    assert!(read_mesh(fixtures().join("lh.thickness")).is_err());
    let error = read_signal(fixtures().join("lh.pial")).unwrap_err();
    assert!(matches!(error, SurfaceError::NotASignal { vertices: 12, faces: 20, .. }), "{error}");
}
