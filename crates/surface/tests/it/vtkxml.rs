//! Tests that VTK's XML files are read by their declared layout, and that false declarations are refused.

use std::fs;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::{Mesh, SurfaceError};

fn read(text: &[u8]) -> Result<Mesh, SurfaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtp");
    fs::write(&path, text).unwrap();
    read_mesh(&path)
}

/// Returns a file of a tetrahedron with text arrays.
fn tetrahedron() -> String {
    "<?xml version=\"1.0\"?><VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"4\" NumberOfPolys=\"4\">\
     <PointData><DataArray type=\"String\" Name=\"names\" format=\"ascii\">a b c d</DataArray></PointData>\
     <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 0 1 0 0 0 1\
     <InformationKey>7 8</InformationKey></DataArray></Points>\
     <Polys><DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">0 2 1 0 1 3 1 2 3 2 0 3</DataArray>\
     <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">3 6 9 12</DataArray></Polys></Piece></PolyData>\
     </VTKFile>"
        .to_owned()
}

#[test]
fn a_large_mesh_in_several_blocks_survives_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.vtp");
    let mut mesh = icosphere(6);
    mesh.vertices.iter_mut().for_each(|v| *v = v.map(|x| x / 3.0));
    write_mesh(&path, &mesh, &WriteOptions::default()).unwrap();
    assert_eq!(read_mesh(&path).unwrap(), mesh);
    assert!(fs::metadata(&path).unwrap().len() < 24 * mesh.vertices.len() as u64 * 2, "it is compressed");
}

#[test]
fn text_beside_the_numbers_is_left_alone() {
    let mesh = read(tetrahedron().as_bytes()).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.faces.len()), (4, 4));
    assert_eq!(mesh.faces[3], [2, 0, 3]);
}

#[test]
fn false_declarations_are_placed() {
    for (from, to, what) in [
        ("NumberOfPoints=\"4\"", "NumberOfPoints=\"5\"", "expected 5 points of three numbers"),
        ("NumberOfPolys=\"4\"", "NumberOfPolys=\"99999999999\"", "expected 99999999999 polygons"),
        ("NumberOfPolys=\"4\"", "NumberOfPolys=\"many\"", "the attribute NumberOfPolys of the element Piece"),
        ("2 0 3<", "2 0 3 3<", "expected 13 as the last offset, found 12"),
        ("3 6 9 12<", "3 6 9 15<", "expected increasing offsets of at most 12"),
        ("3 6 9 12<", "6 3 9 12<", "expected increasing offsets of at most 12"),
        ("3 6 9 12<", "2 6 9 12<", "polygons of at least three corners"),
        (">0 2 1", ">0 2 4", "expected indices below 4"),
        (">0 2 1", ">0 2 -1", "vertex indices from 0"),
        ("NumberOfComponents=\"3\"", "NumberOfComponents=\"2\"", "3 as the NumberOfComponents"),
        ("type=\"Float64\"", "type=\"String\"", "a number type"),
        ("format=\"ascii\">0 0 0", "format=\"appended\" offset=\"9\">0 0 0", "AppendedData"),
        ("</VTKFile>", "", "closing tag"),
    ] {
        let text = tetrahedron();
        assert!(text.contains(from), "{from}");
        let error = read(text.replace(from, to).as_bytes()).unwrap_err();
        assert!(matches!(error, SurfaceError::Malformed { .. }), "{error}");
        assert!(error.to_string().contains(what), "{what}: {error}");
    }
    for (from, to, what) in [
        ("\"PolyData\"", "\"ImageData\"", "save the surface as PolyData"),
        ("\"PolyData\"", "\"PolyData\" compressor=\"vtkLZMADataCompressor\"", "ZLib"),
    ] {
        let error = read(tetrahedron().replace(from, to).as_bytes()).unwrap_err();
        assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains(what), "{what}: {error}");
    }
}

/// Points whose header promises more than the bytes behind it can hold.
#[test]
fn headers_of_arrays_are_compared_with_their_bytes() {
    let array = |words: &[u64], data: &[u8]| {
        let head: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        STANDARD.encode(head) + &STANDARD.encode(data)
    };
    let file = |compressor: &str, data: &str| {
        let text = tetrahedron().replace("0 0 0 1 0 0 0 1 0 0 0 1", data).replace(
            "\"PolyData\">",
            &format!("\"PolyData\" header_type=\"UInt64\" compressor=\"vtk{compressor}DataCompressor\">"),
        );
        read(text.replacen("\"3\" format=\"ascii\"", "\"3\" format=\"binary\"", 1).as_bytes())
    };
    let zeros = |bytes: usize| {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut encoder, &vec![0; bytes]).unwrap();
        encoder.finish().unwrap()
    };
    let packed = zeros(96);
    let size = packed.len() as u64;
    for (data, what) in [
        (array(&[u64::MAX, 96, 0, size], &packed), "blocks of an array"),
        (array(&[1, 96, 0, u64::MAX], &packed), "bytes of a block"),
        (array(&[1, u64::MAX, 0, size], &packed), "bytes, as stated in the array's header"),
        (array(&[1, 95, 0, size], &packed), "95 bytes in a block, as stated in the array's header, found more"),
        (array(&[1, 97, 0, size], &packed), "97 bytes in a block, as stated in the array's header, found 96"),
        (array(&[1, 96, 0, size], &[7; 20]), "a valid zlib stream"),
        ("AAA".to_owned(), "8 more bytes of base64 data"),
        ("....AAAA".to_owned(), "base64"),
    ] {
        let error = file("ZLib", &data).unwrap_err().to_string();
        assert!(error.contains(what), "{what}: {error}");
    }
    let error = file("LZ4", &array(&[1, 96, 0, 20], &[0xff; 20])).unwrap_err().to_string();
    assert!(error.contains("LZ4"), "{error}");
    assert!(file("ZLib", &array(&[1, 96, 0, size], &packed)).is_ok());
    // A block of zeros of 100 MB in 100 kB.
    let packed = zeros(100 << 20);
    let error = file("ZLib", &array(&[1, 100 << 20, 0, packed.len() as u64], &packed)).unwrap_err();
    assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
}
