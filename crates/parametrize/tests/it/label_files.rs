//! Tests that label volumes are read from files whose contents aren't trusted.

use std::path::PathBuf;

use spharm_monitor::Silent;
use spharm_parametrize::ParametrizeError;
use spharm_parametrize::volume::LabelVolume;

use crate::label_formats::nifti2;

/// Returns a NIfTI-1 file of 8-bit values.
pub(crate) fn nifti(size: [i16; 3], values: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 352];
    bytes[..4].copy_from_slice(&348_i32.to_le_bytes());
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    for (k, n) in [3, size[0], size[1], size[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * k, &n.to_le_bytes());
    }
    put(70, &2_i16.to_le_bytes());
    put(72, &8_i16.to_le_bytes());
    for (k, x) in [1.0_f32, 1.0, 2.0, 3.0].into_iter().enumerate() {
        put(76 + 4 * k, &x.to_le_bytes());
    }
    put(108, &352.0_f32.to_le_bytes());
    put(344, b"n+1\0");
    bytes.extend(values);
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

#[test]
fn nifti_files_are_read_and_distrusted() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, bytes: &[u8]| {
        let path: PathBuf = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        LabelVolume::read(&path, &Silent)
    };
    let values = [0, 5, 5, 0, 9, 0, 0, 0];
    let plain = nifti([2, 2, 2], &values);
    for (name, bytes) in [("a.nii", plain.clone()), ("a.nii.gz", gzip(&plain))] {
        let volume = read(name, &bytes).unwrap();
        assert_eq!(volume.labels().into_iter().collect::<Vec<_>>(), [(5, 2), (9, 1)]);
        assert_eq!(volume.affine.apply([1.0; 3]), [1.0, 2.0, 3.0], "the voxels' sizes, without a form");
    }
    // The sform takes precedence over the qform. The qform here is a half turn about z, with a reversed third axis.
    let mut formed = plain.clone();
    formed[252..254].copy_from_slice(&1_i16.to_le_bytes());
    formed[264..268].copy_from_slice(&1.0_f32.to_le_bytes());
    formed[76..80].copy_from_slice(&(-1.0_f32).to_le_bytes());
    formed[268..272].copy_from_slice(&10.0_f32.to_le_bytes());
    assert_eq!(read("q.nii", &formed).unwrap().affine.apply([1.0; 3]), [9.0, -2.0, -3.0]);
    formed[254..256].copy_from_slice(&1_i16.to_le_bytes());
    for (row, scale) in [4.0_f32, 5.0, 6.0].into_iter().enumerate() {
        let at = 280 + 16 * row + 4 * row;
        formed[at..at + 4].copy_from_slice(&scale.to_le_bytes());
    }
    assert_eq!(read("s.nii", &formed).unwrap().affine.apply([1.0; 3]), [4.0, 5.0, 6.0]);

    // Rejected: every truncation, sizes that the file can't hold, other types and formats.
    for length in 0..plain.len() {
        assert!(matches!(read("t.nii", &plain[..length]), Err(ParametrizeError::NotAVolume { .. })), "{length}");
    }
    let zipped = gzip(&plain);
    for length in 0..zipped.len() - 8 {
        assert!(read("t.nii.gz", &zipped[..length]).is_err(), "{length}");
    }
    let huge = nifti([32767, 32767, 32767], &values);
    let error = read("huge.nii", &huge).unwrap_err().to_string();
    assert!(error.contains("a file too short for the"), "{error}");
    assert!(read("huge.nii.gz", &gzip(&huge)).is_err());
    let mut bad = plain.clone();
    bad[48..50].copy_from_slice(&5_i16.to_le_bytes());
    bad[40..42].copy_from_slice(&4_i16.to_le_bytes());
    let error = read("4d.nii", &bad).unwrap_err();
    assert!(matches!(error, ParametrizeError::SeveralImages { channels: 1, times: 5, .. }), "{error}");
    let mut float = nifti([1, 1, 1], &0.5_f32.to_le_bytes());
    float[70..72].copy_from_slice(&16_i16.to_le_bytes());
    float[72..74].copy_from_slice(&32_i16.to_le_bytes());
    assert!(matches!(read("f.nii", &float), Err(ParametrizeError::NotLabels { .. })));
    // Changing any byte of the header gives a volume or an error, never a panic.
    for at in 0..352 {
        for value in [0, 0x7f, 0xff] {
            let mut changed = plain.clone();
            changed[at] = value;
            let _ = read("c.nii", &changed);
        }
    }
    assert!(matches!(LabelVolume::read(folder.path(), &Silent), Err(ParametrizeError::NotAVolume { .. })));
    assert!(matches!(LabelVolume::read(folder.path().join("none.nii"), &Silent), Err(ParametrizeError::Io { .. })));
}

#[test]
fn doubtful_positions_in_nifti_files_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let warnings = |bytes: &[u8]| {
        let path = folder.path().join("a.nii");
        std::fs::write(&path, bytes).unwrap();
        LabelVolume::read(&path, &Silent).unwrap().warnings()
    };
    let mut values = vec![0; 8 * 8 * 8];
    values[9] = 1;
    let plain = nifti([8, 8, 8], &values);
    let [none] = &warnings(&plain)[..] else { panic!("one warning") };
    assert!(none.contains("a.nii: the header has neither an sform nor a qform"), "{none}");

    let float = |bytes: &mut [u8], at: usize, x: f32| bytes[at..at + 4].copy_from_slice(&x.to_le_bytes());
    // A half turn about z; voxels are 1 x 2 x 3 mm.
    let mut turned = plain;
    turned[252] = 1;
    float(&mut turned, 264, 1.0);
    assert_eq!(warnings(&turned), Vec::<String>::new(), "a qform alone");
    turned[254] = 1;
    for (row, scale) in [-1.0, -2.0, 3.0].into_iter().enumerate() {
        float(&mut turned, 280 + 20 * row, scale);
    }
    assert_eq!(warnings(&turned), Vec::<String>::new(), "the same positions");
    // Rounding to 32 bits changes the angle of a half turn by up to 7e-4.
    float(&mut turned, 264, 1.0 - f32::EPSILON / 2.0);
    assert_eq!(warnings(&turned), Vec::<String>::new(), "rounded");
    // The sform has an offset of 40 mm, which the qform lacks.
    float(&mut turned, 280 + 12, 40.0);
    let [apart] = &warnings(&turned)[..] else { panic!("one warning") };
    assert!(apart.contains("sform and the qform") && apart.contains("40.0"), "{apart}");
    assert!(apart.contains("the sform is used"), "{apart}");
    let used = LabelVolume::read(folder.path().join("a.nii"), &Silent).unwrap().affine.apply([0.0; 3]);
    assert_eq!(used, [40.0, 0.0, 0.0]);
    // Forms with different codes describe different spaces, such as MNI space and the scanner's.
    for (sform, qform, count) in [(2, 1, 0), (4, 1, 0), (1, 2, 0), (4, 4, 1)] {
        (turned[254], turned[252]) = (sform, qform);
        assert_eq!(warnings(&turned).len(), count, "codes {sform} and {qform}");
    }
    // In NIfTI-2, the sform has voxels of 1 mm, unlike the qform.
    let mut second = nifti2([2, 2, 3], &[1; 12]);
    for row in 0..3 {
        second[400 + 40 * row..408 + 40 * row].copy_from_slice(&1.0_f64.to_le_bytes());
    }
    second[344] = 1;
    for (sform, count) in [(1, 1), (2, 0)] {
        second[348] = sform;
        assert_eq!(warnings(&second).len(), count, "codes {sform} and 1");
    }
}

/// Returns a FreeSurfer volume of 8-bit values; its voxels are 1 x 2 x 3 mm, and its axes are rotated about z.
fn mgh(size: [i32; 3], values: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 284];
    for (k, n) in [1, size[0], size[1], size[2], 1, 0].into_iter().enumerate() {
        bytes[4 * k..4 * k + 4].copy_from_slice(&n.to_be_bytes());
    }
    bytes[28..30].copy_from_slice(&1_i16.to_be_bytes());
    let axes = [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let floats = [1.0, 2.0, 3.0].into_iter().chain(axes).chain([10.0, 20.0, 30.0]);
    for (k, x) in floats.enumerate() {
        bytes[30 + 4 * k..34 + 4 * k].copy_from_slice(&f32::to_be_bytes(x));
    }
    bytes.extend(values);
    bytes
}

#[test]
fn freesurfer_volumes_are_read_and_distrusted() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        LabelVolume::read(&path, &Silent)
    };
    let plain = mgh([2, 2, 4], &[0, 5, 5, 0, 9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for (name, bytes) in [("a.mgh", plain.clone()), ("a.mgz", gzip(&plain))] {
        let volume = read(name, &bytes).unwrap();
        assert_eq!(volume.labels().into_iter().collect::<Vec<_>>(), [(5, 2), (9, 1)]);
        // The centre, voxel (1, 1, 2), is at the header's position. The first voxel axis is along y, the second along
        // -x.
        assert_eq!(volume.affine.apply([1.0, 1.0, 2.0]), [10.0, 20.0, 30.0]);
        assert_eq!(volume.affine.apply([2.0, 2.0, 3.0]), [8.0, 21.0, 33.0]);
    }
    for length in 0..plain.len() {
        assert!(matches!(read("t.mgh", &plain[..length]), Err(ParametrizeError::NotAVolume { .. })), "{length}");
    }
    let error = read("huge.mgz", &gzip(&mgh([65535; 3], &[0]))).unwrap_err().to_string();
    assert!(error.contains("a file too short for the"), "{error}");
    for size in [[163_842, 1, 1], [1, 1, 12]] {
        let error = read("lh.thickness.mgz", &gzip(&mgh(size, &[0; 12]))).unwrap_err();
        assert!(matches!(error, ParametrizeError::VertexMap { vertices: 163_842 | 12, .. }), "{error}");
    }
    let mut frames = plain.clone();
    frames[19] = 2;
    let error = read("f.mgh", &frames).unwrap_err();
    assert!(matches!(error, ParametrizeError::SeveralImages { channels: 1, times: 2, .. }), "{error}");
    for at in 0..92 {
        for value in [0, 0x7f, 0xff] {
            let mut changed = plain.clone();
            changed[at] = value;
            let _ = read("c.mgh", &changed);
        }
    }
}
