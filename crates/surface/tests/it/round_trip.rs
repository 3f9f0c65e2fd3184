//! Tests that written files read back: exactly in text and 64-bit formats, rounded once to 32 bits in other formats.

use proptest::prelude::*;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{
    PlyAttributes, WriteOptions, read_mesh, read_signal, read_signal_with_gaps, write_mesh, write_ply, write_signal,
};
use spharm_surface::{CoordinateSystem, Mesh, Signal, SurfaceError};

use crate::fixtures;

/// Returns a mesh with coordinates that short decimal fractions and 32-bit floats can't represent.
fn awkward() -> Mesh {
    let mut mesh = read_mesh(fixtures().join("double.surf.gii")).unwrap();
    for (i, v) in mesh.vertices.iter_mut().enumerate() {
        *v = [v[0] / 3.0, v[1] * 1e-7 + 1e-300 * i as f64, -v[2] * 1e5 / 7.0];
    }
    mesh
}

fn rounded(mesh: &Mesh) -> Vec<[f64; 3]> {
    mesh.vertices.iter().map(|v| v.map(|x| f64::from(x as f32))).collect()
}

#[test]
fn meshes() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = awkward();
    for (name, double, exact) in [
        ("a.surf.gii", false, false),
        ("b.surf.gii", true, true),
        ("c.surf.gii.gz", true, true),
        ("lh.d", false, false),
        ("e.inflated", false, false),
        ("f.obj", false, true),
        ("g.off", false, true),
        ("h.ply", false, false),
        ("i.ply", true, true),
        ("j.vtk", false, true),
        ("K.OBJ", false, true),
        ("l.glb", false, false),
        ("m.vtp", false, true),
        ("n.3mf", false, true),
        ("o.vtp.gz", false, true),
    ] {
        let path = folder.path().join(name);
        let options = WriteOptions { double, ..WriteOptions::default() };
        write_mesh(&path, &mesh, &options).unwrap();
        let back = read_mesh(&path).unwrap();
        assert_eq!(back.vertices, if exact { mesh.vertices.clone() } else { rounded(&mesh) }, "{name}");
        assert_eq!(back.faces, mesh.faces, "{name}");
        if name.contains(".gii") {
            assert_eq!(back.meta, mesh.meta, "{name}");
        }
    }
}

#[test]
fn stl_keeps_triangles_and_welds_them_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = awkward();
    let path = folder.path().join("a.stl");
    write_mesh(&path, &mesh, &WriteOptions::default()).unwrap();
    let back = read_mesh(&path).unwrap();
    assert_eq!(back.vertices.len(), mesh.vertices.len());
    let rounded = rounded(&mesh);
    for (found, wanted) in back.faces.iter().zip(&mesh.faces) {
        assert_eq!(found.map(|i| back.vertices[i as usize]), wanted.map(|i| rounded[i as usize]));
    }
}

#[test]
fn a_freesurfer_file_survives_to_the_byte() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["lh.pial", "rh.white"] {
        let path = folder.path().join(name);
        write_mesh(&path, &read_mesh(fixtures().join(name)).unwrap(), &WriteOptions::default()).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(fixtures().join(name)).unwrap());
    }
}

#[test]
fn signals() {
    let folder = tempfile::tempdir().unwrap();
    let signal = Signal::new((0..21).map(|i| f64::from(i) / 7.0 - 1e-9).collect(), 7, 3);
    let single = Signal::new(signal.values.iter().map(|&x| f64::from(x as f32)).collect(), 7, 3);
    for (name, double, wanted) in [
        ("a.func.gii", false, &single),
        ("b.func.gii", true, &signal),
        ("c.csv", false, &signal),
        ("d.tsv", false, &signal),
    ] {
        let path = folder.path().join(name);
        let options = WriteOptions { double, ..WriteOptions::default() };
        write_signal(&path, &signal, &options).unwrap();
        assert_eq!(&read_signal(&path).unwrap(), wanted, "{name}");
    }
    let curv = folder.path().join("lh.curv");
    let error = write_signal(&curv, &signal, &WriteOptions::default()).unwrap_err();
    assert!(matches!(error, SurfaceError::Argument { .. }), "{error}");
    let one = Signal::new(vec![0.5, -2.0], 2, 1);
    write_signal(&curv, &one, &WriteOptions::default()).unwrap();
    assert_eq!(read_signal(&curv).unwrap(), one);
}

/// NaN marks vertices without a value.
#[test]
fn signals_with_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let signal = Signal::new(vec![0.5, f64::NAN, -2.0], 3, 1);
    let options = WriteOptions::default();
    for name in ["a.shape.gii", "b.csv", "c.tsv", "d.mgz", "lh.thickness"] {
        let path = folder.path().join(name);
        write_signal(&path, &signal, &options).unwrap();
        assert!(matches!(read_signal(&path), Err(SurfaceError::NonFinite { vertex: 1, .. })), "{name}");
        let found = read_signal_with_gaps(&path).unwrap();
        assert!(found.values[1].is_nan() && [found.values[0], found.values[2]] == [0.5, -2.0], "{name}");
    }
    let infinite = Signal::new(vec![0.5, f64::INFINITY], 2, 1);
    let error = write_signal(folder.path().join("e.csv"), &infinite, &options).unwrap_err();
    assert!(matches!(error, SurfaceError::NonFinite { vertex: 1, .. }), "{error}");
}

#[test]
fn a_surface_too_small_for_32_bits_is_refused_rather_than_written_as_zeros() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, double) = (awkward(), WriteOptions { double: true, ..WriteOptions::default() });
    let tiny = mesh.with_vertices(mesh.vertices.iter().map(|v| v.map(|x| 1e-100 * x)).collect());
    for name in ["a.gii", "lh.b", "c.ply", "d.stl", "e.glb"] {
        let error = write_mesh(folder.path().join(name), &tiny, &WriteOptions::default()).unwrap_err();
        assert!(matches!(error, SurfaceError::NotRepresentable { .. }), "{name}: {error}");
        let remedy = if name.ends_with("gii") || name.ends_with("ply") { "--double" } else { ".surf.gii" };
        assert!(error.to_string().contains(remedy), "{name}: {error}");
    }
    let signal = |value: f64| Signal::new(vec![value, 0.0, -value], 3, 1);
    assert!(write_signal(folder.path().join("a.func.gii"), &signal(1e-100), &WriteOptions::default()).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing was written");
    write_mesh(folder.path().join("a.gii"), &tiny, &double).unwrap();
    write_signal(folder.path().join("a.func.gii"), &signal(0.0), &WriteOptions::default()).unwrap();
}

#[test]
fn a_number_beyond_32_bits_is_refused_rather_than_written_as_infinity() {
    let folder = tempfile::tempdir().unwrap();
    let mut mesh = awkward();
    mesh.vertices[5][1] = 1e39;
    for name in ["a.gii", "lh.b", "c.ply", "d.stl", "e.glb"] {
        let error = write_mesh(folder.path().join(name), &mesh, &WriteOptions::default()).unwrap_err();
        assert!(matches!(error, SurfaceError::NotRepresentable { vertex: 5, .. }), "{name}: {error}");
    }
    let options = WriteOptions { double: true, ..WriteOptions::default() };
    write_mesh(folder.path().join("a.gii"), &mesh, &options).unwrap();
    assert!(write_mesh(folder.path().join("lh.b"), &mesh, &options).is_err(), "FreeSurfer has no 64 bits");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else was written");
}

#[test]
fn ply_attributes_must_fit_the_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = awkward();
    let write = |attributes: &PlyAttributes<'_>| {
        let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
        write_ply(folder.path().join("a.ply"), &mesh, attributes, &options)
    };
    let values = vec![0.25; 12];
    let colors = vec![[1, 2, 3]; 12];
    write(&PlyAttributes { scalar: Some(("error", &values)), colors: Some(&colors) }).unwrap();
    let back = read_mesh(folder.path().join("a.ply")).unwrap();
    assert_eq!(back.vertices, rounded(&mesh));
    let short = write(&PlyAttributes { scalar: Some(("error", &values[1..])), colors: None }).unwrap_err();
    assert!(matches!(short, SurfaceError::LengthMismatch { expected: 12, found: 11, .. }), "{short}");
    assert!(write(&PlyAttributes { scalar: None, colors: Some(&colors[..3]) }).is_err());
    for name in ["", "two words", "x", "a\nproperty"] {
        assert!(write(&PlyAttributes { scalar: Some((name, &values)), colors: None }).is_err(), "{name:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Any positions, also equal ones, and any triangles, also degenerate ones, come back in their order.
    #[test]
    fn any_mesh(
        mut vertices in prop::collection::vec(prop::array::uniform3(-1e30..1e30), 3..40),
        corners in prop::collection::vec(prop::array::uniform3(0_usize..1000), 1..60),
    ) {
        vertices.push(vertices[0]);
        vertices.push([-0.0, 5e-324, 1.0 / 3.0]);
        let count = vertices.len();
        let mesh = Mesh::new(vertices, corners.iter().map(|face| face.map(|v| (v % count) as u32)).collect());
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.vtp", "b.3mf", "c.glb", "d.vtk", "e.obj", "f.off", "g.ply"] {
            let path = folder.path().join(name);
            write_mesh(&path, &mesh, &WriteOptions { double: true, ..WriteOptions::default() }).unwrap();
            let back = read_mesh(&path).unwrap();
            let wanted = if name == "c.glb" { rounded(&mesh) } else { mesh.vertices.clone() };
            prop_assert_eq!(&back.vertices, &wanted, "{}", name);
            prop_assert_eq!(&back.faces, &mesh.faces, "{}", name);
        }
    }
}

/// 3D Slicer takes files that don't state their axes as LPS.
#[test]
fn stated_axes_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let stated = |mesh: &Mesh| mesh.meta.file_metadata.clone();
    let has = |name: &str, statement: &str| {
        let bytes = std::fs::read(path(name)).unwrap();
        bytes.windows(statement.len()).any(|window| window == statement.as_bytes())
    };
    let names = ["a.vtk", "a.ply", "a.stl", "a.obj"];
    let ball = icosphere(1);
    for axes in ["LPS", "RAS"] {
        let text = [
            "# vtk DataFile Version 4.2\n3D Slicer output. SPACE=LPS\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n\
             0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2\n",
            "ply\nformat ascii 1.0\ncomment VTK generated PLY File\ncomment SPACE=LPS\nelement vertex 3\n\
             property float x\nproperty float y\nproperty float z\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
            "solid 3D Slicer output. SPACE=LPS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
             vertex 0 1 0\nendloop\nendfacet\nendsolid\n",
            "# 3D Slicer output. SPACE=LPS\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        ];
        let expected = vec![("SPACE".to_owned(), axes.to_owned())];
        for (name, text) in names.into_iter().zip(text) {
            std::fs::write(path(name), text.replace("SPACE=LPS", &format!("SPACE={axes}"))).unwrap();
            let read = read_mesh(path(name)).unwrap();
            assert_eq!(stated(&read), expected, "{name}");
            assert_eq!(read.vertices[1], [1.0, 0.0, 0.0], "{name}: positions are read as stored");
            for other in names {
                let other = format!("of-{other}");
                let mut mesh = ball.clone();
                mesh.meta = read.meta.clone();
                write_mesh(path(&other), &mesh, &WriteOptions { overwrite: true, double: false }).unwrap();
                assert_eq!(stated(&read_mesh(path(&other)).unwrap()), expected, "{name} {other}");
            }
        }
    }
    // NIfTI defines the axes of the known spaces as RAS.
    let space = |name: &str| CoordinateSystem {
        data_space: name.to_owned(),
        transformed_space: name.to_owned(),
        matrix: std::array::from_fn(|k| f64::from(u8::from(k % 5 == 0))),
    };
    let spaces = ["NIFTI_XFORM_SCANNER_ANAT", "NIFTI_XFORM_MNI_152", "NIFTI_XFORM_UNKNOWN"];
    for (system, known) in spaces.into_iter().map(|name| (Some(space(name)), name != spaces[2])).chain([(None, false)])
    {
        let mut mesh = ball.clone();
        mesh.meta.coordinate_system = system;
        for name in names {
            write_mesh(path(name), &mesh, &WriteOptions { overwrite: true, double: false }).unwrap();
            assert_eq!([has(name, "SPACE=RAS"), has(name, "SPACE=")], [known; 2], "{name}");
        }
    }
}
