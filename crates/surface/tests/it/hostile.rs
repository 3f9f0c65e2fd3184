//! Tests that damaged and hostile files give one-line errors, never a panic, a hang or a large allocation.

use std::fs;
use std::path::Path;

use spharm_surface::io::read_input;
use spharm_surface::{Input, SurfaceError};

use crate::{Random, fixture_files};

/// Reads bytes as if they were in a file with a fixture's name.
fn read(folder: &Path, name: &Path, bytes: &[u8]) -> Result<Input, SurfaceError> {
    let path = folder.join(name.file_name().unwrap());
    fs::write(&path, bytes).unwrap();
    let result = read_input(&path);
    if let Err(error) = &result {
        let text = error.to_string();
        assert!(!text.contains('\n') && text.len() < 600, "one line: {text:?}");
        assert!(text.contains(name.file_name().unwrap().to_str().unwrap()), "names the file: {text}");
    }
    result
}

fn size(input: &Input) -> usize {
    match input {
        Input::Mesh(mesh) => mesh.vertices.len() + mesh.faces.len(),
        Input::Signal(signal) => signal.values.len(),
    }
}

#[test]
fn every_truncation_is_an_error_or_a_shorter_file() {
    let folder = tempfile::tempdir().unwrap();
    for path in fixture_files() {
        let bytes = fs::read(&path).unwrap();
        let whole = size(&read(folder.path(), &path, &bytes).unwrap());
        let mut refused = 0;
        for length in 0..bytes.len() {
            match read(folder.path(), &path, &bytes[..length]) {
                Ok(input) => assert!(size(&input) <= whole, "{path:?} at {length}"),
                Err(_) => refused += 1,
            }
        }
        // Only formats without counts may accept a truncated file. Every format rejects an empty file.
        assert!(refused > 0);
        let counted = path.to_str().unwrap();
        if counted.contains(".gii") {
            // White space after the last tag may be missing.
            let end = bytes.trim_ascii_end().len();
            assert!(refused >= end.min(bytes.len()), "{path:?}: {refused} of {end}");
        }
        if counted.ends_with("binary.stl") || counted.ends_with(".ply") && !counted.contains("ascii") {
            assert_eq!(refused, bytes.len(), "{path:?}");
        }
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(2024);
    for path in fixture_files() {
        let bytes = fs::read(&path).unwrap();
        for _ in 0..150 {
            let mut bent = bytes.clone();
            for _ in 0..1 + random.below(4) {
                let at = random.below(bent.len());
                bent[at] = match random.below(3) {
                    0 => random.below(256) as u8,
                    1 => bent[at] ^ (1 << random.below(8)),
                    _ => b"0123456789-. \n\xff"[random.below(15)],
                };
            }
            let _ = read(folder.path(), &path, &bent);
        }
    }
}

#[test]
fn garbage_is_refused_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(5);
    let garbage: Vec<u8> = (0..4096).map(|_| random.below(256) as u8).collect();
    for path in fixture_files() {
        for bytes in [&garbage[..], &[], b"\n", b"\0\0\0\0\0\0\0\0", b" "] {
            assert!(read(folder.path(), &path, bytes).is_err(), "{path:?}");
        }
    }
    let mut error = read(folder.path(), Path::new("notes.txt"), b"hello").unwrap_err();
    assert!(matches!(error, SurfaceError::UnknownFormat { .. }), "{error}");
    error = read(folder.path(), Path::new("empty"), b"").unwrap_err();
    assert!(error.to_string().contains("empty"), "{error}");
}

/// The headers claim billions of items in a few bytes. Allocating memory for the items would exhaust the memory.
#[test]
fn headers_that_promise_too_much_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut curv = b"\xff\xff\xff".to_vec();
    curv.extend([i32::MAX.to_be_bytes(), 0_i32.to_be_bytes(), i32::MAX.to_be_bytes()].concat());
    let mut surface = b"\xff\xff\xfeby\n\n".to_vec();
    surface.extend([i32::MAX.to_be_bytes(), i32::MAX.to_be_bytes()].concat());
    let mut negative = b"\xff\xff\xfeby\n\n".to_vec();
    negative.extend([(-1_i32).to_be_bytes(), 5_i32.to_be_bytes()].concat());
    let mut stl = vec![b' '; 80];
    stl.extend(u32::MAX.to_le_bytes());
    let gifti = |encoding: &str, data: &str| {
        format!(
            "<GIFTI><DataArray Intent=\"NIFTI_INTENT_SHAPE\" DataType=\"NIFTI_TYPE_FLOAT64\" \
             ArrayIndexingOrder=\"RowMajorOrder\" Dimensionality=\"2\" Dim0=\"4611686018427387904\" Dim1=\"2\" \
             Encoding=\"{encoding}\" Endian=\"LittleEndian\"><Data>{data}</Data></DataArray></GIFTI>"
        )
        .into_bytes()
    };
    let ply = "element vertex 3000000000\nproperty float x\nproperty float y\nproperty float z\n\
               element face 18446744073709551615\nproperty list uint int vertex_indices\nend_header\n0 0 0\n";
    let list = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                element face 1\nproperty list uint int vertex_indices\nend_header\n";
    let mut long_list = format!("ply\nformat binary_little_endian 1.0\n{list}").into_bytes();
    long_list.extend([0_u8; 12]);
    long_list.extend(u32::MAX.to_le_bytes());
    let vtk = |kind: &str| format!("# vtk DataFile Version 3.0\nt\n{kind}\nDATASET POLYDATA\n");
    for (name, bytes) in [
        ("curv", curv),
        ("surface", surface),
        ("negative", negative),
        ("a.stl", stl),
        ("ascii.gii", gifti("ASCII", "1 2")),
        ("base64.gii", gifti("Base64Binary", "AAAA")),
        ("gzip.gii", gifti("GZipBase64Binary", "eJwDAAAAAAE=")),
        ("a.off", b"OFF\n4000000000 4000000000 0\n0 0 0\n".to_vec()),
        ("b.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4000000000 0 1 2\n".to_vec()),
        ("ascii.ply", format!("ply\nformat ascii 1.0\n{ply}").into_bytes()),
        ("binary.ply", format!("ply\nformat binary_big_endian 1.0\n{ply}").into_bytes()),
        ("list.ply", long_list),
        ("points.vtk", (vtk("BINARY") + "POINTS 99999999999 double\n0").into_bytes()),
        ("polygons.vtk", (vtk("ASCII") + "POINTS 1 float 0 0 0 POLYGONS 9999999999 9999999999999 3").into_bytes()),
        (
            "offsets.vtk",
            (vtk("ASCII")
                + "POINTS 1 float 0 0 0 POLYGONS 2 3 OFFSETS vtktypeint64 0 99 CONNECTIVITY vtktypeint64 0 0 0")
                .into_bytes(),
        ),
        ("field.vtk", (vtk("ASCII") + "FIELD f 99999999999999 a 99999999999 99999999999 float 1").into_bytes()),
    ] {
        let error = read(folder.path(), Path::new(name), &bytes).unwrap_err();
        assert!(matches!(error, SurfaceError::Malformed { .. }), "{name}: {error}");
    }
}

#[test]
fn text_with_other_values_than_its_dimensions_say_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let gifti = |data_type: &str, data: &str| {
        let text = format!(
            "<GIFTI><DataArray Intent=\"NIFTI_INTENT_SHAPE\" DataType=\"NIFTI_TYPE_{data_type}\" \
             ArrayIndexingOrder=\"RowMajorOrder\" Dimensionality=\"1\" Dim0=\"3\" Encoding=\"ASCII\" \
             Endian=\"LittleEndian\"><Data>{data}</Data></DataArray></GIFTI>"
        );
        read(folder.path(), Path::new("a.shape.gii"), text.as_bytes())
    };
    for (data_type, data, what) in [
        ("FLOAT32", "1.000 2.000", "expected 3 values, as given by the array's dimensions, found 2"),
        ("FLOAT32", "1", "expected data for 3 values (at least 2 bytes each)"),
        ("FLOAT64", "1 2 3 4", "expected 3 values, as given by the array's dimensions, found more"),
        ("INT32", "1 2.5 3", "values, found"),
        ("UINT8", "1 2 256", "values, found"),
        ("FLOAT64", "1 2 x", "values, found"),
    ] {
        let error = gifti(data_type, data).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
    for data_type in ["FLOAT32", "FLOAT64", "INT32", "UINT8"] {
        let Ok(Input::Signal(signal)) = gifti(data_type, " 1\n2 255 ") else { panic!("{data_type}") };
        assert_eq!(signal.values, [1.0, 2.0, 255.0], "{data_type}");
    }
}

#[test]
fn deep_documents_bombs_and_foreign_entities_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let deep = format!("<GIFTI>{}", "<a>".repeat(100_000));
    assert!(read(folder.path(), Path::new("deep.gii"), deep.as_bytes()).is_err());
    let laughs = "<!DOCTYPE GIFTI [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;\">]><GIFTI><MetaData><MD>\
                  <Name>x</Name><Value>&b;&b;</Value></MD></MetaData></GIFTI>";
    let error = read(folder.path(), Path::new("laughs.gii"), laughs.as_bytes()).unwrap_err();
    assert!(error.to_string().contains("entities"), "{error}");
    // This is a gzip file of 128 KiB that contains 128 MiB of blanks.
    let mut bomb = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..128 {
        std::io::Write::write_all(&mut bomb, &[b' '; 1 << 20]).unwrap();
    }
    let error = read(folder.path(), Path::new("bomb.gii.gz"), &bomb.finish().unwrap()).unwrap_err();
    assert!(matches!(error, SurfaceError::Unsupported { .. }), "{error}");
}

#[test]
fn numbers_and_indices_that_cannot_be_are_placed() {
    let folder = tempfile::tempdir().unwrap();
    let obj = |text: &str| read(folder.path(), Path::new("a.obj"), text.as_bytes()).unwrap_err();
    let three = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let error = obj(&format!("{three}f 1 2 3\nf 1 2 4\n"));
    assert!(matches!(error, SurfaceError::IndexOutOfRange { face: 1, index: 3, vertices: 3, .. }), "{error}");
    let error = obj(&format!("{three}v 0 nan 0\nf 1 2 3\n"));
    assert!(matches!(error, SurfaceError::NonFinite { vertex: 3, .. }), "{error}");
    let error = obj(three);
    assert!(matches!(error, SurfaceError::Empty { what: "triangle", .. }), "{error}");
    assert!(matches!(obj("f 1 2 3\n"), SurfaceError::Empty { what: "vertex", .. }));
    for (bad, line) in [("f 1 2\n", 4), ("f 0 1 2\n", 4), ("f -4 1 2\n", 4), ("v 1 2\n", 4), ("f 1 2 x\n", 4)] {
        let error = obj(&format!("{three}{bad}"));
        assert!(error.to_string().contains(&format!("line {line}")), "{error}");
    }
    let error = read(folder.path(), Path::new("a.csv"), b"1,2\n3,inf\n").unwrap_err();
    assert!(matches!(error, SurfaceError::NonFinite { vertex: 1, .. }), "{error}");
    let error = read(folder.path(), Path::new("a.csv"), b"a,b\n1,2\n3\n").unwrap_err();
    assert!(error.to_string().contains("line 3"), "{error}");
}

#[cfg(unix)]
#[test]
fn pipes_and_directories_are_refused_without_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.gii");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    let error = read_input(&pipe).unwrap_err();
    assert!(matches!(error, SurfaceError::NotAFile { found: "a pipe", .. }), "{error}");
    let error = read_input(folder.path()).unwrap_err();
    assert!(matches!(error, SurfaceError::NotAFile { found: "a directory", .. }), "{error}");
    let error = read_input(folder.path().join("none.gii")).unwrap_err();
    assert!(matches!(error, SurfaceError::Io { action: "open", .. }), "{error}");
}
