//! Tests that VRML scenes are read as they are placed.

use std::fs;

use spharm_surface::io::read_mesh;
use spharm_surface::{Mesh, SurfaceError};

fn read(text: &str) -> Result<Mesh, SurfaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wrl");
    fs::write(&path, format!("#VRML V2.0 utf8\n{text}")).unwrap();
    read_mesh(&path)
}

const SET: &str = "Shape { appearance Appearance { material DEF m Material { diffuseColor 1 0 0 } } geometry \
                   IndexedFaceSet { coord DEF c Coordinate { point [0 0 0, 1 0 0, 0 1 0, 0 0 1] } coordIndex \
                   [0, 2, 1, -1, 0, 1, 3, -1, 1, 2, 3, -1, 2, 0, 3] } }";

#[test]
fn sets_that_use_the_same_points_share_vertices() {
    let second = "Shape { geometry IndexedFaceSet { ccw FALSE coordIndex [0 1 2 3 -1] coord USE c } }";
    let mesh = read(&format!("{SET} {second}")).unwrap();
    assert_eq!(mesh.vertices, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_eq!(mesh.faces, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1], [0, 3, 2]]);
    // Within another Transform they are other vertices.
    let mesh = read(&format!("{SET} Transform {{ translation 5 0 0 children {second} }}")).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.vertices[4]), (8, [5.0, 0.0, 0.0]));
    assert_eq!(mesh.faces[4], [4, 6, 5]);
}

#[test]
fn transforms_turn_scale_and_repeat_what_is_in_them() {
    let text = format!(
        "DEF t Transform {{ translation 10 0 0 rotation 0 0 2 1.5707963267948966 scale 2 2 2 center 1 0 0 \
         children [ Group {{ children {SET} }} ] }}\n# again, mirrored\nTransform {{ children USE t scale -1 1 1 }}"
    );
    let mesh = read(&text).unwrap();
    // (0, 0, 0) is (-1, 0, 0) from the centre: doubled, turned to (0, -2, 0), and put back with the shift.
    let wanted = [[11.0, -2.0, 0.0], [11.0, 0.0, 0.0], [9.0, -2.0, 0.0], [11.0, -2.0, 2.0]];
    for (k, wanted) in wanted.iter().enumerate() {
        for (found, sign) in [(mesh.vertices[k], 1.0), (mesh.vertices[k + 4], -1.0)] {
            let wanted = [sign * wanted[0], wanted[1], wanted[2]];
            assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-14), "{found:?} {wanted:?}");
        }
    }
    assert_eq!((mesh.faces[1], mesh.faces[5]), ([0, 1, 3], [4, 7, 5]), "the mirror image is turned");
}

#[test]
fn nodes_that_are_no_meshes_are_refused_or_skipped() {
    for (node, what) in [
        ("Switch { whichChoice 0 choice [] }", "Switch"),
        ("LOD { level [] }", "LOD"),
        ("Shape { geometry Sphere { radius 2 } }", "Sphere"),
        ("PROTO p [ ] { Group { } }", "PROTO"),
        ("Inline { url \"other.wrl\" }", "Inline"),
    ] {
        let error = read(&format!("{SET} {node}")).unwrap_err();
        assert!(matches!(error, SurfaceError::Unsupported { .. }) && error.to_string().contains(what), "{error}");
    }
    let more = "DEF v Viewpoint { description \"a } b\" } NavigationInfo { type [\"EXAMINE\"] } Shape { geometry \
                IndexedLineSet { coord USE c coordIndex [0, 1, -1] } } ROUTE v.isBound TO v.set_bind";
    assert_eq!(read(&format!("{SET} {more}")).unwrap().faces.len(), 4);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.wrl");
    fs::write(&path, "#VRML V1.0 ascii\nSeparator { }").unwrap();
    assert!(read_mesh(&path).unwrap_err().to_string().contains("VRML 97"));
}

#[test]
fn errors_name_their_line_and_repeats_are_bounded() {
    for (from, to, what) in [
        ("0 0 1]", "0 0 x]", "a coordinate on line 2"),
        ("0 0 1]", "0 0]", "three coordinates per point"),
        ("[0, 2, 1,", "[0, 2, 9,", "indices below 4"),
        ("[0, 2, 1,", "[0, 2, -3,", "indices below 4"),
        ("[0, 2, 1,", "[0, 2,", "polygons of at least three corners"),
        ("DEF c Coordinate", "USE c", "the name of an earlier node"),
        ("coord DEF c", "coord USE", "the name of an earlier node"),
        ("Shape {", "Shape { }}", "closing braces"),
    ] {
        assert!(SET.contains(from), "{from}");
        let error = read(&SET.replace(from, to)).unwrap_err();
        assert!(matches!(error, SurfaceError::Malformed { .. }), "{error}");
        assert!(error.to_string().contains(what), "{what}: {error}");
    }
    let mut text = format!("DEF a0 Group {{ children {SET} }}\n");
    for k in 1..40 {
        text += &format!("DEF a{k} Group {{ children [ USE a{0} USE a{0} ] }}\n", k - 1);
    }
    let error = read(&text).unwrap_err();
    assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
    let error = read(&"Group { children ".repeat(100_000)).unwrap_err();
    assert!(error.to_string().contains("deep"), "{error}");
}
