//! Tests problems with files that the first users of the program had.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, read_input, read_mask, read_mesh, read_signal, write_mesh, write_signal};
use spharm_surface::{Mesh, Signal, Sphere, SurfaceError, VolumeGeometry, read_sphere, read_target};

use crate::fixtures;

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

#[test]
fn every_format_is_read_gzipped() {
    let folder = tempfile::tempdir().unwrap();
    for path in crate::fixture_files() {
        let name = path.file_name().unwrap().to_str().unwrap();
        if name.ends_with(".gz") {
            continue;
        }
        let packed = folder.path().join(format!("{name}.gz"));
        fs::write(&packed, gzipped(&fs::read(&path).unwrap())).unwrap();
        assert_eq!(read_input(&packed).unwrap(), read_input(&path).unwrap(), "{name}");
    }
}

#[test]
fn a_table_of_angles_is_a_sphere_also_gzipped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("angles.CSV.gz");
    fs::write(&path, gzipped(b"0.5,1\n1.5,2\n2.5,3\n")).unwrap();
    let sphere = read_sphere(&path).unwrap();
    assert_eq!((sphere.directions.len(), sphere.path.as_deref()), (3, Some(&*path)));
    let values = folder.path().join("values.csv");
    fs::write(&values, "1\n2\n4\n").unwrap();
    assert_eq!(read_target(&values, &sphere).unwrap().path, Some(values));
}

#[test]
fn a_name_that_ends_in_gz_is_written_gzipped() {
    let folder = tempfile::tempdir().unwrap();
    let ball = icosphere(1);
    for name in ["a.obj.gz", "a.ply.gz", "lh.a.gz", "a.vtk.gz", "a.surf.gii.gz"] {
        let path = folder.path().join(name);
        write_mesh(&path, &ball, &WriteOptions::default()).unwrap();
        assert!(fs::read(&path).unwrap().starts_with(&[0x1f, 0x8b]), "{name}");
        assert_eq!(read_mesh(&path).unwrap().faces, ball.faces, "{name}");
    }
}

#[test]
fn freesurfer_maps_are_signals() {
    let folder = tempfile::tempdir().unwrap();
    let signal = Signal::new((0..24).map(|i| f64::from(i) / 4.0).collect(), 12, 2);
    for name in ["lh.thickness.fwhm10.mgh", "lh.thickness.mgz", "a.mgh.gz"] {
        let path = folder.path().join(name);
        write_signal(&path, &signal, &WriteOptions::default()).unwrap();
        assert_eq!(fs::read(&path).unwrap().starts_with(&[0x1f, 0x8b]), !name.ends_with(".mgh"), "{name}");
        assert_eq!(read_signal(&path).unwrap(), signal, "{name}");
        let bare = folder.path().join("bare");
        fs::copy(&path, &bare).unwrap();
        assert_eq!(read_signal(&bare).unwrap(), signal, "by its first bytes");
    }
}

/// Returns an MGH file of 4 x 3 x 2 voxels.
fn mgh_volume() -> Vec<u8> {
    let mut bytes: Vec<u8> = [1_i32, 4, 3, 2, 1, 0, 0].iter().flat_map(|n| n.to_be_bytes()).collect();
    bytes.resize(284 + 24, 0);
    bytes
}

#[test]
fn numpy_arrays_with_one_or_two_axes_are_values() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, kind: &str, shape: &str, values: &[u8]| {
        let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let length = (header.len() as u16).to_le_bytes();
        let path = folder.path().join(name);
        fs::write(&path, [b"\x93NUMPY\x01\0", &length[..], header.as_bytes(), values].concat()).unwrap();
        path
    };
    let values: Vec<u8> = (0..24).flat_map(|i| f64::from(i).to_le_bytes()).collect();
    let path = write("d.npy", "<f8", "(12, 2)", &values);
    let expected = Signal::new((0..24).map(f64::from).collect(), 12, 2);
    assert_eq!(read_signal(&path).unwrap(), expected);
    let sphere = Sphere::icosphere(0);
    assert_eq!(read_target(&path, &sphere).unwrap().values, expected.values);
    let error = read_target(&path, &Sphere::icosphere(1)).unwrap_err();
    assert!(matches!(error, SurfaceError::VertexCount { expected: 42, found: 12, .. }), "{error}");
    let error = read_mesh(&path).unwrap_err().to_string();
    assert!(error.contains("found values on 12 vertices") && error.contains("also give the sphere"), "{error}");
    let path = write("mask.npy", "|b1", "(3,)", &[1, 0, 1]);
    assert_eq!(read_mask(&path, 3).unwrap(), [true, false, true]);
    let path = write("volume.npy", "|u1", "(2, 1, 1)", &[1, 0]);
    assert!(matches!(read_input(&path), Err(SurfaceError::VolumeInput { format: "NumPy array", .. })));
}

#[test]
fn volumes_are_recognised() {
    let folder = tempfile::tempdir().unwrap();
    let mut nifti = vec![0; 400];
    nifti[..4].copy_from_slice(&348_i32.to_le_bytes());
    nifti[344..348].copy_from_slice(b"n+1\0");
    let mut nifti2 = vec![0; 600];
    nifti2[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
    let tiff = b"II*\0rest".to_vec();
    for (name, bytes, kind) in [
        ("a.nii", nifti.clone(), "NIfTI-1"),
        ("a.nii.gz", gzipped(&nifti), "NIfTI-1"),
        ("wrongly.surf.gii", nifti, "NIfTI-1"),
        ("b.nii", nifti2, "NIfTI-2"),
        ("aseg.mgz", gzipped(&mgh_volume()), "FreeSurfer MGH"),
        ("aseg.mgh", mgh_volume(), "FreeSurfer MGH"),
        ("cells.tif", tiff, "TIFF"),
        ("cells.npy", b"\x93NUMPY\x01\0".to_vec(), "NumPy array"),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        let error = read_input(&path).unwrap_err();
        let SurfaceError::VolumeInput { format, .. } = error else { panic!("{name}: {error}") };
        assert_eq!(format, kind, "{name}");
    }
}

#[test]
fn gifti_is_written_as_nibabel_writes_it() {
    let folder = tempfile::tempdir().unwrap();
    let surface = folder.path().join("a.surf.gii");
    write_mesh(&surface, &icosphere(0), &WriteOptions::default()).unwrap();
    let text = fs::read_to_string(&surface).unwrap();
    let matrix = text.split_once("<MatrixData>").unwrap().1.split_once("</MatrixData>").unwrap().0;
    assert_eq!(matrix.lines().count(), 4, "{matrix}");
    assert!(matrix.lines().all(|line| line.split_whitespace().count() == 4), "{matrix}");
    for (name, intent) in [("hemi-L_a.shape.gii", "NIFTI_INTENT_SHAPE"), ("hemi-L_a.Func.GII", "NIFTI_INTENT_NONE")] {
        let path = folder.path().join(name);
        write_signal(&path, &Signal::new(vec![1.0, 2.0], 2, 1), &WriteOptions::default()).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(intent) && text.contains("<Value>hemi-L_a</Value>"), "{text}");
    }
}

/// The test is skipped if nibabel isn't installed.
#[test]
fn nibabel_reads_what_is_written() {
    let Some(python) = std::env::var_os("SPHARM_PYTHON") else {
        eprintln!("skipped: no nibabel here (SPHARM_PYTHON is not set)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mesh = read_mesh(fixtures().join("lh.pial")).unwrap();
    write_mesh(path("a.surf.gii"), &mesh, &WriteOptions::default()).unwrap();
    write_mesh(path("lh.again"), &read_mesh(path("a.surf.gii")).unwrap(), &WriteOptions::default()).unwrap();
    let signal = Signal::new(vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 3, 2);
    write_signal(path("a.shape.gii"), &signal, &WriteOptions::default()).unwrap();
    write_signal(path("a.mgz"), &signal, &WriteOptions::default()).unwrap();
    let script = "import sys\n\
        try:\n    import nibabel, numpy as np\n\
        except ImportError:\n    print('skipped: no nibabel'); sys.exit(0)\n\
        g = nibabel.load('a.surf.gii').darrays[0]\n\
        assert g.coordsys.xform.shape == (4, 4), g.coordsys.xform.shape\n\
        assert 'VolGeomC_R' in g.meta, dict(g.meta)\n\
        s = nibabel.load('a.shape.gii').darrays\n\
        assert [a.intent for a in s] == [nibabel.nifti1.intent_codes['NIFTI_INTENT_SHAPE']] * 2\n\
        assert s[1].data.tolist() == [2, 4, 6]\n\
        m = np.asarray(nibabel.load('a.mgz').dataobj)\n\
        assert m.shape == (3, 1, 1, 2) and m[:, 0, 0, 1].tolist() == [2, 4, 6], m.shape\n\
        v, f, info = nibabel.freesurfer.read_geometry('lh.again', read_metadata=True)\n\
        assert abs(float(g.meta['VolGeomC_R']) - info['cras'][0]) < 1e-6, info\n";
    let status = std::process::Command::new(python).args(["-c", script]).current_dir(folder.path()).status().unwrap();
    assert!(status.success());
}

/// Returns a surface, and the geometry of a volume whose centre isn't the origin.
fn placed() -> (Mesh, VolumeGeometry) {
    let geometry = VolumeGeometry {
        filename: Some("../mri/orig.mgz".to_owned()),
        size: [256, 256, 256],
        voxel_size: [1.0; 3],
        axes_and_centre: [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [5.0, -17.5, 18.2]],
    };
    let mut mesh = icosphere(1);
    mesh.meta.freesurfer_footer = Some(geometry.to_footer());
    (mesh, geometry)
}

#[test]
fn the_volumes_geometry_survives_a_change_of_format() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, geometry) = placed();
    let copy = |from: &Mesh, name: &str| -> Mesh {
        let path: PathBuf = folder.path().join(name);
        write_mesh(&path, from, &WriteOptions::default()).unwrap();
        read_mesh(&path).unwrap()
    };
    let freesurfer = copy(&mesh, "lh.pial");
    assert_eq!(VolumeGeometry::of(&freesurfer.meta), Some(geometry.clone()));
    let gifti = copy(&freesurfer, "lh.pial.surf.gii");
    // GIfTI metadata have no entry for the name of the volume's file.
    let unnamed = VolumeGeometry { filename: None, ..geometry };
    assert_eq!(VolumeGeometry::of(&gifti.meta), Some(unnamed.clone()));
    let again = copy(&gifti, "lh.again");
    assert_eq!(VolumeGeometry::of(&again.meta), Some(unnamed));
    assert_eq!(copy(&gifti, "b.surf.gii").meta.surface_metadata, gifti.meta.surface_metadata, "not twice");
}

#[test]
fn a_ply_has_the_ending_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let attributes = spharm_surface::io::PlyAttributes::default();
    let write = |name: &str| {
        let path: &Path = &folder.path().join(name);
        spharm_surface::io::write_ply(path, &icosphere(0), &attributes, &WriteOptions::default())
    };
    let error = write("err.glb").unwrap_err();
    assert!(matches!(error, SurfaceError::UnknownFormat { .. }), "{error}");
    write("err.ply").unwrap();
}
