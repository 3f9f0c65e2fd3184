//! Tests that polygons of every format are cut into triangles without folds, and that byte order marks are skipped.

use std::fmt::Write;
use std::fs;

use spharm_surface::io::read_mesh;
use spharm_surface::topology::{Topology, area, signed_volume};

/// The base of a prism of height 3: an L with area 3 and perimeter 8.
const BASE: [[u32; 2]; 6] = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]];

/// Returns the vertices of the prism, and its polygons; the base and the top start at the given corner.
fn prism(start: usize) -> (Vec<[u32; 3]>, Vec<Vec<usize>>) {
    let vertices = [0, 3].into_iter().flat_map(|z| BASE.map(|[x, y]| [x, y, z])).collect();
    let turned = |k: usize| (start + k) % 6;
    let sides = (0..6).map(|k| vec![k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6]);
    let ends: [Vec<usize>; 2] = [(0..6).rev().map(turned).collect(), (0..6).map(|k| turned(k) + 6).collect()];
    (vertices, sides.chain(ends).collect())
}

/// Returns the numbers of each row after `before`, and `after` at the end of each row.
fn rows<T: ToString>(rows: &[impl AsRef<[T]>], before: impl Fn(usize) -> String, after: &str) -> String {
    let mut text = String::new();
    for row in rows {
        let numbers: Vec<String> = row.as_ref().iter().map(T::to_string).collect();
        writeln!(text, "{}{}{after}", before(numbers.len()), numbers.join(" ")).unwrap();
    }
    text
}

/// Returns the name and the text of the prism's file in each format.
fn files(start: usize) -> [(&'static str, String); 6] {
    let (vertices, polygons) = prism(start);
    let from_one: Vec<Vec<usize>> = polygons.iter().map(|corners| corners.iter().map(|v| v + 1).collect()).collect();
    let points = rows(&vertices, |_| String::new(), "");
    let counted = rows(&polygons, |count| format!("{count} "), "");
    let plain = rows(&polygons, |_| String::new(), "");
    let array = |kind: &str, name: &str, text: &str| {
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"3\" format=\"ascii\">{text}</DataArray>"
        )
    };
    let obj = rows(&vertices, |_| "v ".to_owned(), "") + &rows(&from_one, |_| "f ".to_owned(), "");
    let off = format!("OFF\n12 8 0\n{points}{counted}");
    // The polygons come before the vertices.
    let ply = format!(
        "ply\nformat ascii 1.0\nelement face 8\nproperty list uchar int vertex_indices\nelement vertex 12\n\
         property float x\nproperty float y\nproperty float z\nend_header\n{counted}{points}"
    );
    let vtk = format!(
        "# vtk DataFile Version 3.0\nprism\nASCII\nDATASET POLYDATA\nPOINTS 12 float\n{points}POLYGONS 8 44\n{counted}"
    );
    let vtp = format!(
        "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"12\" NumberOfPolys=\"8\"><Points>{}</Points>\
         <Polys>{}{}</Polys></Piece></PolyData></VTKFile>",
        array("Float64", "Points", &points),
        array("Int64", "connectivity", &plain),
        array("Int64", "offsets", "4 8 12 16 20 24 30 36"),
    );
    let vrml = format!(
        "#VRML V2.0 utf8\nShape {{ geometry IndexedFaceSet {{ coord Coordinate {{ point [{points}] }} coordIndex [{}] \
         }} }}",
        rows(&polygons, |_| String::new(), " -1")
    );
    [("a.obj", obj), ("a.off", off), ("a.ply", ply), ("a.vtk", vtk), ("a.vtp", vtp), ("a.wrl", vrml)]
}

#[test]
fn concave_polygons_of_every_format_have_their_area() {
    let folder = tempfile::tempdir().unwrap();
    for start in 0..6 {
        for (name, text) in files(start) {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            let mesh = read_mesh(&path).unwrap();
            assert!(Topology::of(&mesh).is_sphere(), "{name} {start}");
            assert!((area(&mesh) - 30.0).abs() < 1e-12, "{name} {start}: {}", area(&mesh));
            assert!((signed_volume(&mesh) - 9.0).abs() < 1e-12, "{name} {start}: {}", signed_volume(&mesh));
        }
    }
}

#[test]
fn a_byte_order_mark_is_skipped() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files(0) {
        let path = folder.path().join(name);
        fs::write(&path, &text).unwrap();
        let plain = read_mesh(&path).unwrap();
        fs::write(&path, format!("\u{feff}{text}")).unwrap();
        assert_eq!(read_mesh(&path).unwrap(), plain, "{name}");
    }
}
