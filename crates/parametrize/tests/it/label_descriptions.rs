//! Tests that the axes in tifffile's descriptions and the units in NRRD headers are respected.

use spharm_monitor::Silent;
use spharm_parametrize::ParametrizeError;
use spharm_parametrize::volume::{ImageChoice, LabelVolume, VolumeReading};

use crate::label_formats::{Folder, VALUES, check, nrrd, tiff_of};

/// Reads a TIFF stack with a description by tifffile, which has no voxel size.
fn read(folder: &Folder, bytes: &[u8], image: ImageChoice) -> Result<LabelVolume, ParametrizeError> {
    let path = folder.0.path().join("a.tif");
    std::fs::write(&path, bytes).unwrap();
    let reading = VolumeReading { voxel_size: Some([0.2, 0.3, 0.6]), image, ..VolumeReading::default() };
    LabelVolume::read_with(&path, reading, &Silent)
}

#[test]
fn axes_of_tifffile_are_channels_and_times() {
    let folder = Folder::new();
    let [first, second] = [&VALUES[..6], &VALUES[6..]];
    let (other, last) = ([1; 6], [0.4, 0.3, 0.6]);
    let at = |channel, time| ImageChoice { channel, time };
    // Two slices at each of three times; the second time is `VALUES`.
    let pages = || (0..6).map(|page| [&other[..], first, second][if page / 2 == 1 { 1 + page % 2 } else { 0 }]);
    let times = tiff_of("{\"shape\": [3, 2, 2, 3], \"axes\": \"TZYX\"}", pages());
    check(&read(&folder, &times, at(None, Some(2))).unwrap(), [0.0; 3], last);
    for image in [at(None, None), at(None, Some(4)), at(Some(2), Some(2))] {
        let error = read(&folder, &times, image).unwrap_err();
        assert!(matches!(error, ParametrizeError::SeveralImages { channels: 1, times: 3, .. }), "{error}");
    }
    // The channels of each slice; the second channel is `VALUES`.
    let channels = [&other[..], first, &other[..], second];
    let channels = tiff_of("{\"shape\": [2, 2, 2, 3], \"axes\": \"ZCYX\"}", channels.into_iter());
    check(&read(&folder, &channels, at(Some(2), None)).unwrap(), [0.0; 3], last);
    // A file with fewer pages than its shape says isn't read.
    let truncated = tiff_of("{\"shape\": [3, 2, 2, 3], \"axes\": \"TZYX\", \"truncated\": true}", pages().take(1));
    assert!(read(&folder, &truncated, at(None, Some(1))).unwrap_err().to_string().contains("one page per slice"));
    for axes in ["", ", \"axes\": \"ZYX\"", ", \"axes\": \"QZYX\""] {
        let unnamed = tiff_of(&format!("{{\"shape\": [3, 2, 2, 3]{axes}}}"), pages());
        let error = read(&folder, &unnamed, at(None, None)).unwrap_err().to_string();
        assert!(error.contains("expected three dimensions, found shape [3, 2, 2, 3]"), "{error}");
    }
    for description in ["{\"shape\": [2, 2, 3]}", "{\"shape\": [1, 2, 2, 3], \"axes\": \"TZYX\"}"] {
        let stack = tiff_of(description, VALUES.chunks_exact(6));
        check(&read(&folder, &stack, at(None, None)).unwrap(), [0.0; 3], last);
    }
}

#[test]
fn units_of_nrrd_files_are_converted() {
    let folder = Folder::new();
    let read = |fields: &str| {
        let directions = "space: left-posterior-superior\nspace directions: (200,0,0) (0,300,0) (0,0,600)\n\
                          space origin: (1000,2000,3000)\n";
        let fields = format!("encoding: raw\n{}{fields}", if fields.starts_with("spacings") { "" } else { directions });
        folder.read("a.nrrd", &nrrd(&fields, &VALUES)).unwrap()
    };
    let microns = read("space units: \"um\" \"\u{b5}m\" \"microns\"\n");
    check(&microns, [-1.0, -2.0, 3.0], [-1.4, -2.3, 3.6]);
    assert_eq!(microns.warnings(), Vec::<String>::new());
    check(&read("spacings: 200 0.3 6e-4\nunits: \"um\" \"mm\" \"m\"\n"), [0.0; 3], [0.4, 0.3, 0.6]);
    for (fields, count) in [("", 0), ("space units: \"\" \"\" \"\"\n", 0), ("space units: \"px\" \"px\" \"px\"\n", 1)] {
        let found = read(fields);
        check(&found, [-1000.0, -2000.0, 3000.0], [-1400.0, -2300.0, 3600.0]);
        let warnings = found.warnings();
        assert_eq!(warnings.len(), count, "{warnings:?}");
        assert!(
            warnings.iter().all(|text| text.contains("the unit of length in the header is unknown")),
            "{warnings:?}"
        );
    }
}

#[test]
fn nan_as_background_is_named() {
    let folder = Folder::new();
    let mut values = [1.0_f32; 12];
    values[4] = f32::NAN;
    let values: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
    let fields = "encoding: raw\nspacings: 1 1 1\ntype: float\nendian: little\n";
    folder.refused(
        "nan.nrrd",
        &nrrd(fields, &values),
        "found NaN (voxel 4 of the file, counted from 0); if NaN is the",
    );
}
