use std::io::Cursor;

use spharm_surface::Kind;

use super::*;

fn model() -> Model {
    let values = Array2::from_shape_fn((9, 3), |(k, c)| 0.1 * k as f64 - c as f64);
    let mut sphere = Sphere::from_directions(
        Directions::from_vertices(&[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.8, 0.0]]).unwrap(),
    );
    sphere.faces = vec![[0, 1, 2]];
    let mut model = Model::new(sphere, Coefficients::new(values).unwrap(), Kind::Surface);
    model.scheme_key = Some("ab".repeat(32));
    model.provenance = Provenance::parse("{\"tool\":\"f\u{fc}t\"}");
    model
}

fn bytes_of(model: &Model) -> Vec<u8> {
    let mut bytes = Vec::new();
    model.write_to(&mut bytes).unwrap();
    bytes
}

fn read_bytes(bytes: &[u8]) -> Result<Model, ModelError> {
    read(Path::new("a.npz"), Cursor::new(bytes))
}

/// Creates a `.npz` archive of arrays. Each array is given as name, type, flag for Fortran order, shape and values.
fn archive(method: CompressionMethod, arrays: &[(&str, &str, bool, &str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, descr, fortran, shape, values) in arrays {
        zip.start_file(format!("{name}.npy"), SimpleFileOptions::default().compression_method(method)).unwrap();
        let order = if *fortran { "True" } else { "False" };
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
        zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
        zip.write_all(header.as_bytes()).unwrap();
        zip.write_all(values).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn what_is_written_is_read_and_the_bytes_are_the_same_each_time() {
    let bytes = bytes_of(&model());
    assert_eq!(bytes, bytes_of(&model()));
    assert_eq!(read_bytes(&bytes).unwrap(), model());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spharm.npz");
    model().write(&path).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
    assert_eq!(Model::read(&path).unwrap(), model());
    assert!(matches!(model().write(&path), Err(ModelError::Surface(_))), "an existing file isn't replaced");
    model().write_with(&path, true).unwrap();
}

#[test]
fn the_provenance_is_read_without_the_other_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spharm.npz");
    model().write(&path).unwrap();
    assert_eq!(Model::read_provenance(&path).unwrap(), model().provenance);
    let raw = f64::NAN.to_le_bytes();
    let invalid = archive(CompressionMethod::Stored, &[("coefficients", "<f8", false, "(1, 1)", &raw[..])]);
    std::fs::write(&path, invalid).unwrap();
    assert!(Model::read(&path).is_err());
    assert_eq!(Model::read_provenance(&path).unwrap(), Provenance::default());
    std::fs::write(&path, "no archive").unwrap();
    assert!(matches!(Model::read_provenance(&path), Err(ModelError::Invalid { .. })));
    std::fs::write(&path, b"\x89SPZ\x01").unwrap();
    assert!(matches!(Model::read_provenance(&path), Err(ModelError::Compressed { .. })));
    assert!(matches!(Model::read(&path), Err(ModelError::Compressed { .. })));
    let missing = Model::read_provenance(folder.path().join("b.spharm.npz"));
    assert!(matches!(missing, Err(ModelError::Open { .. })), "{missing:?}");
}

/// A model stores whether its sphere was made for its surface, because fits over such a sphere are smoothed by
/// default.
#[test]
fn a_sphere_is_known_again_as_one_made_for_its_surface() {
    let Model { sphere, coefficients, .. } = model();
    let sphere = Sphere { path: Some("a.sphere.gii".into()), parametrized: true, ..sphere.unwrap() };
    let model = Model::new(sphere, coefficients, Kind::Surface);
    assert_eq!(read_bytes(&bytes_of(&model)).unwrap().sphere, model.sphere);
}

/// The record of a surface's cuts is optional, because models from old versions have no such record. Writing and
/// reading preserve the record. Reading rejects a record that contradicts the sphere.
#[test]
fn where_a_surface_was_cut_returns_and_must_fit() {
    let mut cut = model();
    let without = bytes_of(&cut);
    assert_eq!(read_bytes(&without).unwrap().sphere.unwrap().seam, None);
    cut.sphere.as_mut().unwrap().seam = Some(Seam { vertices: 2, faces: 1, copies: vec![1] });
    let bytes = bytes_of(&cut);
    assert_eq!(read_bytes(&bytes).unwrap(), cut);
    for length in 0..bytes.len() {
        assert!(read_bytes(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
    }
    let directions: Vec<u8> = cut
        .sphere
        .as_ref()
        .unwrap()
        .directions
        .as_slice()
        .as_flattened()
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    let refused = |cut_from: &[i64], shape: &str, seam: Option<i32>| {
        let cut_from: Vec<u8> = cut_from.iter().flat_map(|x| x.to_le_bytes()).collect();
        let seam = seam.map(i32::to_le_bytes);
        let mut arrays = vec![
            ("coefficients", "<f8", false, "(1, 1)", &[0; 8][..]),
            ("directions", "<f8", false, "(3, 3)", &directions),
            ("cut_from", "<i8", false, shape, &cut_from),
        ];
        if let Some(seam) = &seam {
            arrays.push(("seam", "<i4", false, "(1,)", seam));
        }
        read_bytes(&archive(CompressionMethod::Stored, &arrays)).unwrap_err().to_string()
    };
    for (found, expected) in [
        (refused(&[2, 0], "(2,)", None), "no array `seam`"),
        (refused(&[2, 0], "(2,)", Some(2)), "below 2, found a copy of vertex 2"),
        (refused(&[3, 0], "(2,)", Some(0)), "3 vertices plus 1 copies, found 3 vertices"),
        (refused(&[2, 9], "(2,)", Some(0)), "9 triangles, found 0"),
        (refused(&[2, -1], "(2,)", Some(0)), "expected two numbers"),
        (refused(&[2, 0, 0], "(3,)", Some(0)), "expected two numbers"),
    ] {
        assert!(found.contains(expected), "{expected}: {found}");
    }
}

#[test]
fn a_damaged_model_is_an_error_at_any_length() {
    let bytes = bytes_of(&model());
    for length in 0..bytes.len() {
        assert!(read_bytes(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
    }
}

/// The declared shape would take 24 TB. It must be checked against the bytes present before memory is allocated.
#[test]
fn an_array_that_claims_to_be_huge_is_refused() {
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let bytes = archive(method, &[("coefficients", "<f8", false, "(1099511627776, 3)", &[0; 64])]);
        let error = read_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("coefficients: a shape that needs"), "{error}");
    }
}

/// The file is a mean model written by `numpy.savez_compressed` in single precision, with the coefficients as its only
/// array.
#[test]
fn coefficients_alone_are_a_model() {
    let values: Vec<f32> = (0..12).map(|k| 0.5 * k as f32).collect();
    let raw: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
    for fortran in [false, true] {
        let bytes = archive(CompressionMethod::Deflated, &[("coefficients", "<f4", fortran, "(4, 3)", &raw)]);
        let model = read_bytes(&bytes).unwrap();
        assert_eq!(model.coefficients.max_degree(), 1);
        assert_eq!(model.coefficients.values()[[1, 2]], if fortran { 4.5 } else { 2.5 });
        assert_eq!((model.sphere.as_ref(), model.scheme_key.as_ref(), model.kind()), (None, None, Kind::Surface));
        assert_eq!(model.provenance, Provenance::default());
        assert_eq!(model.reconstruct(&Sphere::icosphere(1), 1).unwrap().vertices.len(), 42);
        assert_eq!(read_bytes(&bytes_of(&model)).unwrap().coefficients, model.coefficients);
    }
}

#[test]
fn what_contradicts_the_coefficients_is_refused() {
    let one = 1.0_f64.to_le_bytes();
    let coefficients = ("coefficients", "<f8", false, "(1, 1)", &one[..]);
    let refused = |array: (&str, &str, bool, &str, &[u8]), expected: &str| {
        let error = read_bytes(&archive(CompressionMethod::Stored, &[coefficients, array])).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    };
    refused(("max_degree", "<i8", false, "()", &[2, 0, 0, 0, 0, 0, 0, 0]), "max_degree doesn't match");
    refused(("convention", "<U1", false, "()", b"x\0\0\0"), "convention is \"x\"");
    refused(("directions", "<f8", false, "(1, 3)", &[0; 24]), "directions: ");
    refused(("directions", "<f8", false, "(1, 1)", &one), "three columns");
    let missing = read_bytes(&archive(CompressionMethod::Stored, &[])).unwrap_err().to_string();
    assert!(missing.contains("no array `coefficients`"), "{missing}");
    let eight = archive(CompressionMethod::Stored, &[("coefficients", "<f8", false, "(8,)", &[0; 64])]);
    assert!(read_bytes(&eight).unwrap_err().to_string().contains("(max_degree + 1)^2"));
}

#[test]
fn what_is_not_finite_is_neither_read_nor_written() {
    let mut values = Array2::zeros((4, 3));
    values[[2, 1]] = f64::NAN;
    let model = Model::without_sphere(Coefficients::new(values).unwrap(), Kind::Surface);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let error = model.write(&path).unwrap_err();
    assert!(matches!(error, ModelError::NonFinite { row: 2, channel: 1, .. }), "{error}");
    assert!(!path.exists());
    assert!(model.write_to(&mut Vec::new()).is_err());
    let raw = f64::INFINITY.to_le_bytes();
    let error = read_bytes(&archive(CompressionMethod::Stored, &[("coefficients", "<f8", false, "(1, 1)", &raw)]));
    assert!(matches!(error, Err(ModelError::NonFinite { row: 0, channel: 0, .. })), "{error:?}");
}

/// Tests the exchange of archives with NumPy itself, if it is available.
#[test]
fn archives_by_numpy_are_read_and_ours_are_read_by_numpy() {
    let Some(python) = std::env::var_os("SPHARM_PYTHON") else {
        eprintln!("skipped: no NumPy here (SPHARM_PYTHON is not set; ./run test sets it)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    model().write(folder.path().join("ours.npz")).unwrap();
    let script = "import sys, numpy as np\n\
        m = np.load('ours.npz')\n\
        c = m['coefficients']\n\
        assert c.shape == (9, 3) and c.dtype == np.float64 and m['faces'].dtype == np.int32\n\
        assert int(m['max_degree']) == 2 and m['directions'].shape == (3, 3)\n\
        assert str(m['provenance']) and len(str(m['scheme_key'])) == 64\n\
        np.savez_compressed('alone.npz', coefficients=c.astype('f4'))\n\
        np.savez('fortran.npz', coefficients=np.asfortranarray(c), max_degree=2)\n\
        np.savez_compressed('big.npz', coefficients=c.astype('>f8'), **{k: m[k] for k in m if k != 'coefficients'})\n";
    let status = std::process::Command::new(python).args(["-c", script]).current_dir(folder.path()).status().unwrap();
    assert!(status.success());
    let read = |name: &str| Model::read(folder.path().join(name)).unwrap();
    assert_eq!(read("big.npz"), model());
    assert_eq!(read("fortran.npz").coefficients, model().coefficients);
    let rounded = model().coefficients.values().mapv(|x| f64::from(x as f32));
    assert_eq!(read("alone.npz").coefficients.values(), &rounded);
}
