//! Tests that NRRD, TIFF and other formats give the same voxels at the same positions, and that inconsistent headers
//! are rejected.

use std::io::{Cursor, Write};

use spharm_monitor::Silent;
use spharm_parametrize::ParametrizeError;
use spharm_parametrize::volume::{AxisOrder, ImageChoice, LabelVolume, VolumeReading};

/// Values of 3 x 2 x 2 voxels, with x varying fastest.
pub(crate) const VALUES: [u8; 12] = [0, 5, 5, 0, 9, 0, 0, 0, 0, 0, 0, 7];
const SIZE: [f64; 3] = [0.2, 0.3, 0.6];

fn of_size(size: [f64; 3]) -> VolumeReading {
    VolumeReading { voxel_size: Some(size), ..VolumeReading::default() }
}

pub(crate) struct Folder(pub(crate) tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn read(&self, name: &str, bytes: &[u8]) -> Result<LabelVolume, ParametrizeError> {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        LabelVolume::read(&path, &Silent)
    }

    pub(crate) fn refused(&self, name: &str, bytes: &[u8], why: &str) {
        let error = self.read(name, bytes).unwrap_err().to_string();
        assert!(error.contains(why) && error.contains(name) && !error.contains('\n'), "{error}");
    }
}

pub(crate) fn check(volume: &LabelVolume, first: [f64; 3], last: [f64; 3]) {
    assert_eq!(volume.labels().into_iter().collect::<Vec<_>>(), [(5, 2), (7, 1), (9, 1)]);
    let near = |at: [f64; 3], expected: [f64; 3]| {
        let found = volume.affine.apply(at);
        assert!((0..3).all(|k| (found[k] - expected[k]).abs() < 1e-6), "{found:?} {expected:?}");
    };
    near([0.0; 3], first);
    near([2.0, 1.0, 1.0], last);
    // Label 7 is at the last voxel, label 9 in the middle of the second row.
    assert_eq!(volume.mask(7).unwrap().origin, [1, 0, 0]);
    assert_eq!(volume.mask(9).unwrap().origin, [0, 0, -1]);
    assert!([5, 7, 9].iter().all(|&label| volume.touches_border(label)));
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// Returns a NIfTI-2 file of 8-bit values.
pub(crate) fn nifti2(size: [i64; 3], values: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 544];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(0, &540_i32.to_le_bytes());
    put(4, b"n+2\0\r\n\x1a\n");
    put(12, &2_i16.to_le_bytes());
    for (k, n) in [3, size[0], size[1], size[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(16 + 8 * k, &n.to_le_bytes());
    }
    for (k, x) in [1.0, SIZE[0], SIZE[1], SIZE[2]].into_iter().enumerate() {
        put(104 + 8 * k, &f64::to_le_bytes(x));
    }
    put(168, &544_i64.to_le_bytes());
    bytes.extend(values);
    bytes
}

#[test]
fn nifti_2() {
    let (folder, plain) = (Folder::new(), nifti2([3, 2, 2], &VALUES));
    check(&folder.read("a.nii", &plain).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    check(&folder.read("a.nii.gz", &gzip(&plain)).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    // Adds the rows of an sform.
    let mut placed = plain.clone();
    placed[348..352].copy_from_slice(&1_i32.to_le_bytes());
    for (row, offset) in [(400, 10.0), (432, 20.0), (464, 30.0_f64)] {
        let column = (row - 400) / 32;
        placed[row + 8 * column..row + 8 * column + 8].copy_from_slice(&2.0_f64.to_le_bytes());
        placed[row + 24..row + 32].copy_from_slice(&offset.to_le_bytes());
    }
    check(&folder.read("s.nii", &placed).unwrap(), [10.0, 20.0, 30.0], [14.0, 22.0, 32.0]);
    for length in 0..plain.len() {
        assert!(folder.read("t.nii", &plain[..length]).is_err(), "{length}");
    }
    let mut huge = plain.clone();
    huge[24..32].copy_from_slice(&60_000_i64.to_le_bytes());
    folder.refused("huge.nii", &huge, "a file too short for the");
    huge[24..32].copy_from_slice(&i64::MAX.to_le_bytes());
    folder.refused("huge.nii", &huge, "voxels");
    for at in 0..544 {
        for value in [0x7f, 0xff] {
            let mut changed = plain.clone();
            changed[at] = value;
            let _ = folder.read("c.nii", &changed);
        }
    }
}

pub(crate) fn nrrd(fields: &str, values: &[u8]) -> Vec<u8> {
    let head = format!("NRRD0004\n# a comment\ntype: uchar\ndimension: 3\nsizes: 3 2 2\n{fields}\n");
    [head.as_bytes(), values].concat()
}

#[test]
fn nrrd_attached_and_detached() {
    let folder = Folder::new();
    let spacings = "spacings: 0.2 0.3 0.6\n";
    let raw = nrrd(&format!("encoding: raw\n{spacings}"), &VALUES);
    check(&folder.read("a.nrrd", &raw).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    let packed = nrrd(&format!("encoding: gzip\n{spacings}"), &gzip(&VALUES));
    check(&folder.read("b.nrrd", &packed).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    // The header as written by 3D Slicer, in left-posterior-superior axes.
    let lps = "space: left-posterior-superior\nkinds: domain domain domain\nspace directions: (0.2,0,0) (0,0.3,0) \
               (0,0,0.6)\nspace origin: (1,2,3)\n";
    let placed = nrrd(&format!("encoding: raw\n{lps}"), &VALUES);
    check(&folder.read("c.nrrd", &placed).unwrap(), [-1.0, -2.0, 3.0], [-1.4, -2.3, 3.6]);
    std::fs::write(folder.0.path().join("values.raw"), VALUES).unwrap();
    let detached = nrrd(&format!("encoding: raw\n{spacings}data file: values.raw"), &[]);
    check(&folder.read("d.nhdr", &detached).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    for (fields, why) in [
        ("encoding: bzip2\nspacings: 1 1 1\n", "encoding: raw or gzip"),
        ("encoding: raw\n", "doesn't record the voxel size"),
        ("encoding: raw\nspacings: 1 1\n", "doesn't record the voxel size"),
        ("encoding: raw\nspacings: 1 nan 1\n", "voxels of finite, nonzero volume"),
        ("encoding: raw\nspacings: 1 1e20 1\n", "the voxel size [1.0, 1e20, 1.0]; correct the spacing"),
        ("encoding: raw\nspacings: 1 1 1\nline skip: 3\n", "directly after the header"),
        ("encoding: raw\nspacings: 1 1 1\ndata file: ../values.raw\n", "in the header's folder"),
        ("encoding: raw\nspacings: 1 1 1\ndata file: LIST\n", "a single data file"),
        ("encoding: raw\nspace: 4D\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n", "RAS, LPS or LAS"),
        ("encoding: raw\nspacings: 1 1 1\nsizes: 3 2 2 2\n", "three dimensions"),
        (
            "encoding: raw\nspacings: 1 1 1\nsizes: 60000 60000 60000\n",
            "enough values for all voxels given in the header, found at most",
        ),
        (
            "encoding: gzip\nspacings: 1 1 1\nsizes: 60000 60000 60000\n",
            "enough values for all voxels given in the header, found at most",
        ),
        ("encoding: raw\nspacings: 1 1 1\ntype: short\n", "endian"),
        ("encoding: raw\nspacings: 1 1 1\ntype: block\n", "numbers"),
    ] {
        folder.refused("bad.nrrd", &nrrd(fields, &VALUES), why);
    }
    for length in 0..packed.len() - 8 {
        assert!(folder.read("t.nrrd", &packed[..length]).is_err(), "{length}");
    }
}

fn tiff(description: &str, pages: usize) -> Vec<u8> {
    tiff_of(description, VALUES.chunks_exact(6).cycle().take(pages))
}

pub(crate) fn tiff_of<'a>(description: &str, pages: impl Iterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut bytes).unwrap();
    for page in pages {
        let mut image = encoder.new_image::<tiff::encoder::colortype::Gray8>(3, 2).unwrap();
        image.encoder().write_tag(tiff::tags::Tag::ImageDescription, description).unwrap();
        // 5 pixels per micrometre along x, 10 pixels per 3 micrometres along y.
        let rational = |n, d| tiff::encoder::Rational { n, d };
        image.encoder().write_tag(tiff::tags::Tag::XResolution, rational(5, 1)).unwrap();
        image.encoder().write_tag(tiff::tags::Tag::YResolution, rational(10, 3)).unwrap();
        image.write_data(page).unwrap();
    }
    bytes.into_inner()
}

#[test]
fn tiff_stacks() {
    let folder = Folder::new();
    let ome = "<OME><Image><Pixels SizeX=\"3\" SizeY=\"2\" SizeZ=\"2\" SizeC=\"1\" SizeT=\"1\" PhysicalSizeX=\"200\" \
               PhysicalSizeXUnit=\"nm\" PhysicalSizeY=\"0.3\" PhysicalSizeZ=\"0.6\"/></Image></OME>";
    check(&folder.read("a.ome.tif", &tiff(ome, 2)).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    let imagej = "ImageJ=1.53t\nimages=2\nslices=2\nunit=micron\nspacing=0.6\n";
    check(&folder.read("b.tif", &tiff(imagej, 2)).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    let plain = tiff("a stack", 2);
    let error = folder.read("c.tif", &plain).unwrap_err();
    assert!(matches!(error, ParametrizeError::NoVoxelSize { .. }), "{error}");
    let path = folder.0.path().join("c.tif");
    check(&LabelVolume::read_with(&path, of_size(SIZE), &Silent).unwrap(), [0.0; 3], [0.4, 0.3, 0.6]);
    assert!(LabelVolume::read_with(&path, of_size([1.0, 0.0, 1.0]), &Silent).is_err());
    // A warning says if a given size contradicts that of the file, or is unlikely.
    let warnings = |name: &str, size: [f64; 3]| {
        LabelVolume::read_with(folder.0.path().join(name), of_size(size), &Silent).unwrap().warnings()
    };
    assert!(warnings("c.tif", SIZE).is_empty() && warnings("b.tif", [0.2, 0.301, 0.6]).is_empty());
    let replaced = warnings("b.tif", [0.2, 0.2, 0.5]);
    assert!(replaced.len() == 1 && replaced[0].ends_with("0.2 x 0.2 x 0.5 replaces the file's size 0.2 x 0.3 x 0.6"));
    let uneven = warnings("c.tif", [2e-5, 2e-5, 0.5]);
    assert!(
        uneven.len() == 1
            && uneven[0].contains("c.tif: the sides of the voxels differ by a factor of 25000 (0.00002 x")
    );
    folder.refused("g.tif", &tiff(&ome.replace("PhysicalSizeZ", "Other"), 2), "lacks PhysicalSizeZ doesn't record");
    folder.refused("d.tif", &tiff(ome, 3), "one page per slice");
    folder.refused("e.tif", &tiff(&ome.replace("SizeC=\"1\"", "SizeC=\"2\""), 2), "choose one channel (chosen");
    let whole = tiff(imagej, 2);
    for length in (0..whole.len()).step_by(3) {
        let _ = folder.read("t.tif", &whole[..length]);
    }
    for at in (0..whole.len()).step_by(3) {
        let mut changed = whole.clone();
        changed[at] = 0xff;
        let _ = folder.read("f.tif", &changed);
    }
}

/// Checks that the second of three times of the second of two channels is `VALUES`, and which choices are refused.
fn check_images(folder: &Folder, name: &str, bytes: &[u8], last: [f64; 3]) {
    let path = folder.0.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    let read = |channel, time| {
        let image = ImageChoice { channel, time };
        LabelVolume::read_with(&path, VolumeReading { image, ..VolumeReading::default() }, &Silent)
    };
    check(&read(Some(2), Some(2)).unwrap(), [0.0; 3], last);
    assert_eq!(read(Some(1), Some(2)).unwrap().labels().into_iter().collect::<Vec<_>>(), [(1, 12)]);
    for (channel, time) in [(None, None), (Some(2), None), (None, Some(2)), (Some(3), Some(2)), (Some(2), Some(0))] {
        let error = read(channel, time).unwrap_err();
        assert!(matches!(error, ParametrizeError::SeveralImages { channels: 2, times: 3, .. }), "{error}");
    }
}

#[test]
fn one_of_several_channels_and_times() {
    let folder = Folder::new();
    let [first, second] = [&VALUES[..6], &VALUES[6..]];
    let other = [1; 6];
    // The pages of an image with two slices, by channel and time.
    let page = |slice: usize, channel: usize, time: usize| match (slice, channel, time) {
        (0, 1, 1) => first,
        (1, 1, 1) => second,
        _ => &other[..],
    };
    let imagej = "ImageJ=1.53t\nimages=12\nslices=2\nchannels=2\nframes=3\nunit=micron\nspacing=0.6\n";
    let pages = (0..12).map(|at| page(at / 2 % 2, at % 2, at / 4));
    check_images(&folder, "imagej.tif", &tiff_of(imagej, pages), [0.4, 0.3, 0.6]);
    let ome = |order: &str| {
        format!(
            "<OME><Image><Pixels SizeZ=\"2\" SizeC=\"2\" SizeT=\"3\" DimensionOrder=\"{order}\" PhysicalSizeX=\"0.2\" \
             PhysicalSizeY=\"0.3\" PhysicalSizeZ=\"0.6\"/></Image></OME>"
        )
    };
    let pages = (0..12).map(|at| page(at % 2, at / 2 % 2, at / 4));
    check_images(&folder, "zct.ome.tif", &tiff_of(&ome("XYZCT"), pages), [0.4, 0.3, 0.6]);
    let pages = (0..12).map(|at| page(at / 6, at / 3 % 2, at % 3));
    check_images(&folder, "tcz.ome.tif", &tiff_of(&ome("XYTCZ"), pages.clone()), [0.4, 0.3, 0.6]);
    folder.refused("t.ome.tif", &tiff_of(&ome("XYTCZ"), pages.take(9)), "one channel and one time point");
    // Elements TiffData may say the same as the order; another order, and other files, are refused.
    let with = |data: &str| ome("XYZCT").replace("/></Image>", &format!(">{data}</Pixels></Image>"));
    let pages = || (0..12).map(|at| page(at % 2, at / 2 % 2, at / 4));
    let same = "<TiffData IFD=\"0\"/><TiffData IFD=\"7\" FirstZ=\"1\" FirstC=\"1\" FirstT=\"1\"/>";
    check_images(&folder, "same.ome.tif", &tiff_of(&with(same), pages()), [0.4, 0.3, 0.6]);
    let path = folder.0.path().join("other.ome.tif");
    for other in ["<TiffData IFD=\"0\" FirstC=\"1\"/>", "<TiffData IFD=\"3\" FirstZ=\"0\" FirstC=\"1\"/>"] {
        std::fs::write(&path, tiff_of(&with(other), pages())).unwrap();
        let image = ImageChoice { channel: Some(2), time: Some(2) };
        let reading = VolumeReading { image, ..VolumeReading::default() };
        let error = LabelVolume::read_with(&path, reading, &Silent).unwrap_err().to_string();
        assert!(error.contains("another order or in other files"), "{error}");
    }
    // NIfTI has times along the fourth axis, and channels along the fifth.
    let mut nifti = nifti2([3, 2, 2], &VALUES);
    for (axis, count) in [(0, 5_i64), (4, 3), (5, 2)] {
        nifti[16 + 8 * axis..24 + 8 * axis].copy_from_slice(&count.to_le_bytes());
    }
    nifti.truncate(nifti.len() - VALUES.len());
    for image in 0..6 {
        nifti.extend(if image == 4 { VALUES } else { [1; 12] });
    }
    check_images(&folder, "a.nii", &nifti, [0.4, 0.3, 0.6]);
    check_images(&folder, "a.nii.gz", &gzip(&nifti), [0.4, 0.3, 0.6]);
    nifti.truncate(nifti.len() - 15);
    let path = folder.0.path().join("short.nii");
    std::fs::write(&path, nifti).unwrap();
    let last = VolumeReading { image: ImageChoice { channel: Some(2), time: Some(3) }, ..VolumeReading::default() };
    assert!(LabelVolume::read_with(&path, last, &Silent).is_err());
}

fn npy(descr: &str, fortran: &str, shape: &str, values: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), values].concat()
}

#[test]
fn arrays_of_numpy() {
    let folder = Folder::new();
    let read = |bytes: &[u8]| {
        let path = folder.0.path().join("a.npy");
        std::fs::write(&path, bytes).unwrap();
        LabelVolume::read_with(&path, of_size(SIZE), &Silent)
    };
    let last = [0.4, 0.3, 0.6];
    check(&read(&npy("|u1", "True", "(3, 2, 2)", &VALUES)).unwrap(), [0.0; 3], last);
    let mut c_order = Vec::new();
    for x in 0..3 {
        for y in 0..2 {
            (0..2).for_each(|z| c_order.push(VALUES[x + 3 * (y + 2 * z)]));
        }
    }
    check(&read(&npy("|u1", "False", "(3, 2, 2)", &c_order)).unwrap(), [0.0; 3], last);
    let wide: Vec<u8> = c_order.iter().flat_map(|&x| i32::from(x).to_be_bytes()).collect();
    check(&read(&npy(">i4", "False", "(3, 2, 2)", &wide)).unwrap(), [0.0; 3], last);
    folder.refused("b.npy", &npy("|u1", "True", "(3, 2, 2)", &VALUES), "doesn't record the voxel size");
    for (bytes, why) in [
        (npy("|u1", "True", "(12,)", &VALUES), "three dimensions"),
        (npy("<c8", "True", "(3, 2, 2)", &VALUES), "expected booleans, integers, or floats"),
        (npy("|u1", "True", "(3, 2, 99999999999)", &VALUES), "a file too short for the"),
        (npy("|u1", "True", "(3, 2, 1)", &VALUES), "more bytes than the shape allows"),
        (npy("|u1", "True", "(-3, 2, 2)", &VALUES), "a header that can't be parsed"),
    ] {
        let error = read(&bytes).unwrap_err().to_string();
        assert!(error.contains(why), "{error}");
    }
}

#[test]
fn arrays_of_numpy_may_have_the_axes_z_y_x() {
    let folder = Folder::new();
    let read = |name: &str, bytes: &[u8], axes: AxisOrder| {
        let path = folder.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        LabelVolume::read_with(&path, VolumeReading { axes, ..of_size(SIZE) }, &Silent)
    };
    // In C order the last axis, here x, varies fastest.
    let (c_order, last) = (npy("|u1", "False", "(2, 2, 3)", &VALUES), [0.4, 0.3, 0.6]);
    check(&read("a.npy", &c_order, AxisOrder::Zyx).unwrap(), [0.0; 3], last);
    check(&read("a.npy.gz", &gzip(&c_order), AxisOrder::Zyx).unwrap(), [0.0; 3], last);
    let mut z_fastest = Vec::new();
    for x in 0..3 {
        for y in 0..2 {
            (0..2).for_each(|z| z_fastest.push(VALUES[x + 3 * (y + 2 * z)]));
        }
    }
    let fortran = npy("|u1", "True", "(2, 2, 3)", &z_fastest);
    check(&read("f.npy", &fortran, AxisOrder::Zyx).unwrap(), [0.0; 3], last);
    // Other formats have a fixed order.
    let nrrd = nrrd("spacings: 0.2 0.3 0.6\nencoding: raw\n", &VALUES);
    let formats = [("a.nii", nifti2([3, 2, 2], &VALUES)), ("a.nrrd", nrrd), ("a.tif", tiff("a stack", 2))];
    for (name, bytes) in formats {
        read(name, &bytes, AxisOrder::Xyz).unwrap();
        let error = read(name, &bytes, AxisOrder::Zyx).unwrap_err();
        assert!(matches!(error, ParametrizeError::FixedAxes { .. }) && error.to_string().contains(name), "{error}");
    }
    assert_eq!(AxisOrder::named("zyx").unwrap().name(), "zyx");
    assert!(AxisOrder::named("xzy").is_err());
}

#[test]
fn a_label_inside_does_not_touch_the_border() {
    let mut values = vec![0; 5 * 5 * 5];
    values[2 + 5 * (2 + 5 * 2)] = 4;
    values[4 + 5 * (2 + 5 * 2)] = 6;
    let volume = LabelVolume::new([5; 3], values, spharm_parametrize::volume::Affine::IDENTITY);
    assert!(!volume.touches_border(4) && volume.touches_border(6) && !volume.touches_border(1));
}
