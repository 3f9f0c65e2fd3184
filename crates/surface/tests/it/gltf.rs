//! Tests that scenes are read as they are placed, and that a GLB file of ours keeps the vertices.

use std::fs;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
use spharm_surface::{Mesh, SurfaceError};

/// Returns a binary file of JSON and bytes.
fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut file = b"glTF".to_vec();
    let whole = 12 + 8 + json.len() + 8 + bin.len();
    for number in [2, whole, json.len()] {
        file.extend((number as u32).to_le_bytes());
    }
    file.extend(b"JSON");
    file.extend(json.as_bytes());
    file.extend((bin.len() as u32).to_le_bytes());
    file.extend(b"BIN\0");
    file.extend(&bin);
    file
}

fn read_as(name: &str, file: &[u8]) -> Result<Mesh, SurfaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, file).unwrap();
    read_mesh(&path)
}

fn read(json: &str, bin: &[u8]) -> Result<Mesh, SurfaceError> {
    read_as("a.glb", &glb(json, bin))
}

/// Positions of a tetrahedron as 32-bit floats, then its triangles as 16-bit indices.
fn tetrahedron() -> Vec<u8> {
    let positions: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let indices: [u16; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];
    let mut bin: Vec<u8> = positions.iter().flat_map(|x| x.to_le_bytes()).collect();
    bin.extend(indices.iter().flat_map(|i| i.to_le_bytes()));
    bin
}

const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
const VERTICES: [[f64; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Arrays of [`tetrahedron`], and one mesh.
const PARTS: &str = r#""asset":{"version":"2.0"},"buffers":[{"byteLength":72}],
    "bufferViews":[{"buffer":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":24}],
    "accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},
                 {"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}]"#;

#[test]
fn a_file_of_ours_keeps_number_and_order_of_its_vertices() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    let mut mesh = icosphere(3);
    // Two vertices at one position and one without triangles stay apart, too.
    mesh.vertices.push(mesh.vertices[5]);
    mesh.vertices.push([9.0; 3]);
    mesh.faces[0][1] = mesh.vertices.len() as u32 - 2;
    write_mesh(&path, &mesh, &WriteOptions::default()).unwrap();
    let back = read_mesh(&path).unwrap();
    let rounded: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.map(|x| f64::from(x as f32))).collect();
    assert_eq!((back.vertices, back.faces), (rounded, mesh.faces));
}

#[test]
fn vertices_split_by_an_exporter_are_one_again() {
    // The same triangles, each with its own corners.
    let positions: Vec<u8> =
        FACES.iter().flatten().flat_map(|&v| VERTICES[v as usize]).flat_map(|x| (x as f32).to_le_bytes()).collect();
    let json = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":144}],"bufferViews":[{"buffer":0,
        "byteLength":144}],"accessors":[{"bufferView":0,"componentType":5126,"count":12,"type":"VEC3"}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]}"#;
    let mesh = read(json, &positions).unwrap();
    assert_eq!(mesh.vertices, [VERTICES[0], VERTICES[2], VERTICES[1], VERTICES[3]]);
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]]);
}

#[test]
fn nodes_place_their_meshes_and_a_mirror_image_keeps_its_outer_side() {
    // The child is turned by 90 degrees about z and shifted; its parent doubles it; the root mirrors x.
    let nodes = r#""scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"children":[1],"scale":[-1,1,1]},
        {"children":[2],"matrix":[2,0,0,0,0,2,0,0,0,0,2,0,0,0,7,1]},
        {"mesh":0,"translation":[1,0,0],"rotation":[0,0,0.5,0.5]},{"mesh":0}]"#;
    let mesh = read(&format!("{{{PARTS},{nodes}}}"), &tetrahedron()).unwrap();
    let expected = [[-2.0, 0.0, 7.0], [-2.0, 2.0, 7.0], [0.0, 0.0, 7.0], [-2.0, 0.0, 9.0]];
    for (found, wanted) in mesh.vertices.iter().zip(expected) {
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-14), "{found:?} {wanted:?}");
    }
    assert_eq!(mesh.faces, FACES.map(|[a, b, c]| [a, c, b]), "node 3 isn't in the scene");
    let volume: f64 = mesh.faces.iter().map(|f| determinant(f.map(|v| mesh.vertices[v as usize]))).sum();
    assert!((volume - 8.0).abs() < 1e-12, "the normals point outwards: {volume}");
}

/// Six times the signed volume of a tetrahedron with the origin.
fn determinant([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
    a.iter().zip(cross).map(|(x, y)| x * y).sum()
}

#[test]
fn text_with_its_data_inside_is_read_and_data_outside_are_named() {
    let data = STANDARD.encode(tetrahedron());
    let uri = format!("\"buffers\":[{{\"uri\":\"data:application/octet-stream;base64,{data}\",");
    let json = format!("{{{}}}", PARTS.replace("\"buffers\":[{", &uri));
    let mesh = read_as("a.gltf", json.as_bytes()).unwrap();
    assert_eq!((mesh.vertices.as_slice(), mesh.faces.as_slice()), (&VERTICES[..], &FACES[..]));
    let json = format!("{{{}}}", PARTS.replace("\"buffers\":[{", "\"buffers\":[{\"uri\":\"mesh.bin\","));
    let error = read_as("a.gltf", json.as_bytes()).unwrap_err();
    assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
    assert!(error.to_string().contains("mesh.bin") && error.to_string().contains("one file"), "{error}");
}

#[test]
fn sparse_and_quantized_positions_are_read() {
    // Zeros, of which the last three are replaced by positions 1 to 3.
    let mut bin = tetrahedron();
    bin.extend([1, 2, 3]);
    let json = format!("{{{PARTS}}}")
        .replace(
            "{\"bufferView\":0,\"componentType\":5126,\"count\":4,",
            "{\"componentType\":5126,\"count\":4,\"sparse\":{\"count\":3,\"indices\":{\"bufferView\":2,\
             \"componentType\":5121},\"values\":{\"bufferView\":0,\"byteOffset\":12}},",
        )
        .replace("\"byteLength\":24}", "\"byteLength\":24},{\"buffer\":0,\"byteOffset\":72,\"byteLength\":3}")
        .replace("[{\"byteLength\":72}]", "[{\"byteLength\":75}]");
    assert_eq!(read(&json, &bin).unwrap().vertices, VERTICES);
    bin[74] = 4;
    assert!(read(&json, &bin).unwrap_err().to_string().contains("sparse indices below 4, found 4"));

    // Normalised 16-bit integers in rows of 8 bytes, the last without its padding.
    let rows: [i16; 15] = [0, 0, 0, 9, 32767, 0, 0, 9, 0, -32768, 0, 9, 0, 0, 32767];
    let mut bin: Vec<u8> = rows.iter().flat_map(|x| x.to_le_bytes()).collect();
    bin.resize(48, 0);
    bin.extend(&tetrahedron()[48..]);
    let json = format!("{{{PARTS}}}")
        .replace("\"byteLength\":48}", "\"byteLength\":30,\"byteStride\":8}")
        .replace("5126,\"count\":4,", "5122,\"normalized\":true,\"count\":4,");
    let error = read(&json, &bin).unwrap_err().to_string();
    assert!(
        error.contains("expected positions of three 32-bit floats each, found VEC3 of componentType 5122"),
        "{error}"
    );
    let json = json.replacen('{', "{\"extensionsRequired\":[\"KHR_mesh_quantization\"],", 1);
    let wanted = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    assert_eq!(read(&json, &bin).unwrap().vertices, wanted);
}

#[test]
fn what_a_reader_cannot_take_is_named_with_a_way_out() {
    let whole = format!("{{{PARTS}}}");
    let required = |name: &str| whole.replacen('{', &format!("{{\"extensionsRequired\":[\"{name}\"],"), 1);
    let node = |node: &str| format!("{{{PARTS},\"nodes\":[{node}]}}");
    for (json, what) in [
        (required("KHR_draco_mesh_compression"), "without mesh compression"),
        (required("EXT_meshopt_compression"), "without mesh compression"),
        (required("ABC_new"), "the extension ABC_new"),
        (whole.replace("\"2.0\"", "\"1.0\""), "version 1.0"),
        (node("{\"mesh\":0,\"skin\":0}"), "bones"),
        (node("{\"mesh\":0,\"weights\":[0.5]}"), "shape keys"),
    ] {
        let error = read(&json, &tetrahedron()).unwrap_err();
        assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains(what), "{error}");
    }
    // Extensions of materials don't matter.
    read(&required("KHR_materials_unlit"), &tetrahedron()).unwrap();
}

#[test]
fn lies_about_arrays_and_nodes_are_placed() {
    let whole = format!("{{{PARTS}}}");
    let with = |from: &str, to: &str| {
        assert!(whole.contains(from), "{from}");
        whole.replace(from, to)
    };
    let nodes = |nodes: &str| format!("{{{PARTS},\"nodes\":[{nodes}]}}");
    for (json, what) in [
        (with("5126,\"count\":4", "5126,\"count\":5"), "expected 5 elements in buffer view 0"),
        (with("5126,\"count\":4", "5126,\"count\":18446744073709551615"), "arrays of more than 64"),
        (with("5126,\"count\":4", "5126,\"count\":2000000"), "expected 2000000 elements"),
        (with("5126,\"count\":4", "5126,\"count\":3"), "expected indices below 3"),
        (with("5123,\"count\":12", "5123,\"count\":11"), "expected three corners"),
        (with("\"byteOffset\":48", "\"byteOffset\":18446744073709551615"), "a buffer view of"),
        (with("\"byteLength\":48", "\"byteLength\":48,\"byteStride\":0"), "byteStride"),
        (with("\"byteLength\":48", "\"byteLength\":48,\"byteStride\":252"), "elements in buffer view 0"),
        (with("{\"byteLength\":72}", "{\"byteLength\":9000}"), "9000 bytes in buffer 0"),
        (with("\"POSITION\":0", "\"POSITION\":7"), "an existing accessor"),
        (with("\"indices\":1", "\"indices\":0"), "unsigned whole numbers as indices"),
        (with("\"indices\":1", "\"indices\":1,\"mode\":9"), "mode from 0 to 6"),
        (with("\"bufferView\":0,", ""), "data for each accessor"),
        (nodes("{\"children\":[1]},{\"children\":[0]}") + " ", "at least one triangle"),
        (with("\"indices\":1", "\"indices\":1,\"mode\":1"), "at least one triangle in the scene, found none"),
        (format!("{{{PARTS},\"scenes\":[{{\"nodes\":[0]}}],\"nodes\":[{{\"children\":[0]}}]}}"), "one parent each"),
        (nodes("{\"children\":[5]}"), "a node number below the number of nodes, 1"),
        (nodes("{\"mesh\":3}"), "a mesh number below the number of meshes, 1"),
        (format!("{{{PARTS},\"scene\":4,\"nodes\":[{{\"mesh\":0}}]}}"), "a scene number below the number of scenes, 0"),
    ] {
        let error = read(&json, &tetrahedron()).unwrap_err().to_string();
        assert!(error.contains(what), "{what}: {error}");
    }
}

/// 60,000 nodes of a few bytes each show one mesh of 40,000 triangles.
#[test]
fn a_mesh_shown_too_often_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    write_mesh(&path, &icosphere(5), &WriteOptions::default()).unwrap();
    let file = fs::read(&path).unwrap();
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let json = std::str::from_utf8(&file[20..20 + length]).unwrap().trim_end();
    let json = json.replace("\"scenes\":[{\"nodes\":[0]}],", "").replace("\"scene\":0,", "");
    let json = json.replace("\"nodes\":[{\"mesh\":0}]", &format!("\"nodes\":[{}{{}}]", "{\"mesh\":0},".repeat(60_000)));
    let error = read(&json, &file[28 + length..]).unwrap_err();
    assert!(error.to_string().contains("more than"), "{error}");
    assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
}

#[test]
fn a_name_without_ending_is_read_by_its_first_bytes() {
    let file = glb(&format!("{{{PARTS}}}"), &tetrahedron());
    assert_eq!(read_as("scene", &file).unwrap().faces, FACES);
    assert!(Path::new("a.gltf").extension().is_some());
    let folder = tempfile::tempdir().unwrap();
    let error = write_mesh(folder.path().join("a.gltf"), &icosphere(0), &WriteOptions::default()).unwrap_err();
    assert!(matches!(error, SurfaceError::UnknownFormat { .. }), "{error}");
}
