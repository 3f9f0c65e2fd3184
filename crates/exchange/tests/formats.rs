//! Tests round trips in every format, the formulas of each format's convention, and malformed files.

use std::io::Write;
use std::path::{Path, PathBuf};

use ndarray::Array2;
use proptest::prelude::*;
use spharm_exchange::{
    ExchangeError, ExportOptions, Format, ImportOptions, Imported, Normalization, convert, export, import,
};
use spharm_harmonics::index::degree_order;
use spharm_harmonics::{Coefficients, Directions};
use spharm_model::Model;
use spharm_surface::{Kind, Sphere};

fn coefficients(degree: usize, channels: usize) -> Coefficients {
    let value = |(k, c): (usize, usize)| ((k * 7 + c * 3 + 1) as f64 * 0.37).sin() * 10f64.powi(k as i32 % 5 - 2);
    Coefficients::new(Array2::from_shape_fn(((degree + 1).pow(2), channels), value)).unwrap()
}

fn model(degree: usize, channels: usize) -> Model {
    Model::without_sphere(coefficients(degree, channels), if channels == 3 { Kind::Surface } else { Kind::Signal })
}

fn read(path: &Path, format: Format) -> Result<Imported, ExchangeError> {
    import(&[path], &ImportOptions { format: Some(format), ..ImportOptions::default() })
}

/// Writes one file for each format that stores a model in a single file and can be read. Returns the formats and paths.
fn files(folder: &Path, degree: usize) -> Vec<(Format, PathBuf)> {
    let formats = Format::ALL.into_iter().filter(|format| *format != Format::Aics && !format.file_a_channel());
    let write = |format: Format| {
        let path = folder.join(format!("m.{format}"));
        export(&model(degree, 3), format, &path, &ExportOptions::default()).unwrap();
        (format, path)
    };
    formats.map(write).collect()
}

#[test]
fn any_degree_and_number_of_channels_returns() {
    let folder = tempfile::tempdir().unwrap();
    for (degree, channels) in [(0, 1), (1, 2), (2, 3), (7, 1), (20, 3)] {
        for format in Format::ALL {
            let path = folder.path().join(format!("{degree}.{channels}.{format}"));
            let model = model(degree, channels);
            let written = match export(&model, format, &path, &ExportOptions::default()) {
                Ok(written) => written.files,
                Err(error) => {
                    let only_surfaces = matches!(format, Format::Pdm | Format::Mat) && channels != 3;
                    assert!(only_surfaces || (format == Format::Aics && channels != 1), "{error}");
                    continue;
                }
            };
            let options = ImportOptions { format: Some(format), ..ImportOptions::default() };
            match import(&written, &options) {
                Ok(found) => {
                    let (found, known) = (found.coefficients.values(), model.coefficients.values());
                    assert_eq!(found.dim(), known.dim(), "{format}");
                    let largest = known.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
                    let off = found.iter().zip(known).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
                    assert!(off <= 1e-15 * largest, "{format} {degree} {channels}: {off}");
                }
                Err(error) => assert!(format == Format::Aics, "{format}: {error}"),
            }
        }
    }
}

/// Checks every conversion against the formulas in docs/conventions.md.
#[test]
fn conventions_are_those_of_the_documentation() {
    let a = coefficients(3, 1);
    let value = |l: usize, m: isize| a.values()[[l * l + (l as isize + m) as usize, 0]];
    let sign = |m: isize| if m % 2 == 0 { 1.0 } else { -1.0 };
    let (pdm, pyshtools, s2fft) = (convert::to_pdm(&a), convert::to_pyshtools(&a), convert::to_s2fft(&a));
    let (flowshape, beta, (alm, at)) =
        (convert::with_phase(a.values()), convert::to_beta(&a, 0), convert::to_healpy(&a));
    let root = 2f64.sqrt();
    for row in 0..16 {
        let (l, m) = degree_order(row);
        let n = m.unsigned_abs();
        assert_eq!(flowshape[[row, 0]], sign(m) * value(l, m));
        assert_eq!(pyshtools[[0, usize::from(m < 0), l, n]], value(l, m));
        if m == 0 {
            assert_eq!(pdm[[l * l, 0]], value(l, 0));
            assert_eq!(beta[[l, 0]], value(l, 0));
            continue;
        }
        let (c, s) = (value(l, n as isize), value(l, -(n as isize)));
        assert!((pdm[[l * l + 2 * n - 1, 0]] - root * sign(m) * c).abs() < 1e-15);
        assert!((pdm[[l * l + 2 * n, 0]] - root * sign(m) * s).abs() < 1e-15);
        assert_eq!((beta[[l, n]], beta[[l, l + n]]), (sign(m) * c, sign(m) * s));
        let complex = s2fft[[0, l, 3 + n]];
        assert!((complex.re - sign(m) * c / root).abs() < 1e-15 && (complex.im + sign(m) * s / root).abs() < 1e-15);
        assert!((s2fft[[0, l, 3 - n]] - sign(m) * complex.conj()).norm() < 1e-15);
        assert_eq!(alm[[0, at.iter().position(|&place| place == (l, n)).unwrap()]], complex);
    }
    // healpy sorts coefficients by order, then by degree: all degrees of order 0, then all degrees of order 1, ...
    assert_eq!(at[..6], [(0, 0), (1, 0), (2, 0), (3, 0), (1, 1), (2, 1)]);
}

#[test]
fn geodesys_scale_is_another() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("earth.sh");
    let normalization = Normalization::FourPi;
    export(&model(4, 1), Format::Pyshtools, &path, &ExportOptions { normalization, overwrite: false }).unwrap();
    let first = std::fs::read_to_string(&path).unwrap();
    let degree_0: f64 = first.lines().next().unwrap().split(", ").nth(2).unwrap().parse().unwrap();
    let known = model(4, 1).coefficients.values()[[0, 0]] / (4.0 * std::f64::consts::PI).sqrt();
    assert!((degree_0 - known).abs() < 1e-16, "{degree_0} {known}");
    let found = import(&[&path], &ImportOptions { normalization, ..ImportOptions::default() }).unwrap();
    assert_eq!(found.format, Format::Pyshtools);
    assert!((found.coefficients.values() - model(4, 1).coefficients.values()).iter().all(|d| d.abs() < 1e-14));
}

/// aics-shparam evaluates a radius at the longitude phi + pi, with harmonics normalised to 4 pi.
#[test]
fn aics_azimuths_begin_at_minus_x() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("radius.csv");
    let known = model(3, 1);
    export(&known, Format::Aics, &path, &ExportOptions::default()).unwrap();
    let table = std::fs::read_to_string(&path).unwrap();
    let (names, values) = table.trim_end().split_once('\n').unwrap();
    let mut found = Array2::zeros((16, 1));
    for (name, value) in names.split(',').zip(values.split(',')) {
        let (l, order) = name.trim_start_matches("shcoeffs_L").split_once('M').unwrap();
        let (m, part) = order.split_at(order.len() - 1);
        let (l, m): (usize, usize) = (l.parse().unwrap(), m.parse().unwrap());
        if m <= l && (m > 0 || part == "C") {
            let row = if part == "C" { l * l + l + m } else { l * l + l - m };
            found[[row, 0]] = value.parse::<f64>().unwrap() * (4.0 * std::f64::consts::PI).sqrt();
        }
    }
    let theirs = Model::without_sphere(Coefficients::new(found).unwrap(), Kind::Signal);
    let at = |turn: f64| {
        let direction = |(theta, phi): (f64, f64)| {
            let longitude = phi + turn;
            [theta.sin() * longitude.cos(), theta.sin() * longitude.sin(), theta.cos()]
        };
        Directions::from_vertices(&[(0.4, 0.3), (1.2, 2.0), (1.9, -2.5), (2.8, -0.7)].map(direction)).unwrap()
    };
    let theirs = theirs.evaluate(&at(std::f64::consts::PI), 3).unwrap();
    let ours = known.evaluate(&at(0.0), 3).unwrap();
    assert!((&theirs - &ours).iter().all(|d| d.abs() < 1e-10), "{theirs} {ours}");
}

#[test]
fn files_of_whole_models_are_not_joined() {
    let folder = tempfile::tempdir().unwrap();
    for (format, path) in files(folder.path(), 2) {
        let options = ImportOptions { format: Some(format), ..ImportOptions::default() };
        let error = import(&[&path, &path], &options).unwrap_err();
        assert!(matches!(error, ExchangeError::SeveralModels { channels: 3, .. }), "{format}: {error}");
        assert!(error.to_string().contains("import each file by itself"), "{error}");
    }
    // Files of one channel each are joined in any format.
    let path = folder.path().join("one.csv");
    export(&model(2, 1), Format::Csv, &path, &ExportOptions::default()).unwrap();
    let found = import(&[&path, &path], &ImportOptions::default()).unwrap();
    assert_eq!(found.coefficients.channels(), 2);
}

#[test]
fn what_else_a_file_holds_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    // pyshtools writes six columns with errors.
    let errors = write("errors.sh", b"0, 0, 1, 0, 9, 0\n1, 0, 2, 0, 9, 0\n1, 1, 3, 4, 9, 9\n");
    let found = import(&[errors], &ImportOptions::default()).unwrap();
    assert!(found.errors_left_out && found.format == Format::Pyshtools);
    assert_eq!(found.coefficients.values().column(0).to_vec(), [1.0, 4.0, 2.0, 3.0]);
    let plain = write("plain.sh", b"0, 0, 1, 0\n1, 0, 2, 0\n1, 1, 3, 4\n");
    assert!(!import(&[plain], &ImportOptions::default()).unwrap().errors_left_out);
    let refused = |path: PathBuf, format: Option<Format>, why: &str| {
        let error = import(&[&path], &ImportOptions { format, ..ImportOptions::default() }).unwrap_err();
        assert!(matches!(error, ExchangeError::OtherContents { .. }), "{error}");
        assert!(error.to_string().contains(why) && !error.to_string().contains("damaged"), "{error}");
    };
    let gravity = write("p.gfc", b"product_type gravity_field\nend_of_head\ngfc 0 0 1.0 0.0\ngfc 1 0 0.5 0.0\n");
    refused(gravity.clone(), None, "read_icgem_gfc");
    refused(gravity, Some(Format::Pyshtools), "read_icgem_gfc");
    // SPHARM-MAT's surfaces before the fit have no fvec.
    let surface = Model::new(Sphere::icosphere(1), coefficients(1, 3), Kind::Surface);
    let whole = folder.path().join("des.mat");
    export(&surface, Format::Mat, &whole, &ExportOptions::default()).unwrap();
    let mut bytes = std::fs::read(&whole).unwrap();
    let rename = |bytes: &mut [u8], from: &[u8], to: &[u8]| {
        let at = bytes.windows(from.len()).position(|name| name == from).unwrap();
        bytes[at..at + from.len()].copy_from_slice(to);
    };
    rename(&mut bytes, b"fvec", b"else");
    refused(write("smo.mat", &bytes), None, "spharm fit --surface SURFACE --sphere SPHERE");
    rename(&mut bytes, b"sph_verts", b"something");
    refused(write("obj.mat", &bytes), None, "spharm fit MESH");
}

/// The harmonic of degree 1, order 1 is a multiple of x: sqrt(3 / 4 pi), sqrt 3, 1 and 1 times x.
#[test]
fn every_normalisation_returns() {
    let folder = tempfile::tempdir().unwrap();
    let (known, whole) = (model(5, 1), 4.0 * std::f64::consts::PI);
    let expected = [1.0, 1.0 / whole.sqrt(), (3.0 / whole).sqrt(), (3.0 / whole).sqrt()];
    for (normalization, factor) in Normalization::ALL.into_iter().zip(expected) {
        let path = folder.path().join(normalization.name());
        export(&known, Format::Pyshtools, &path, &ExportOptions { normalization, overwrite: false }).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let c11: f64 = text.lines().nth(2).unwrap().split(", ").nth(2).unwrap().parse().unwrap();
        assert!((c11 - factor * known.coefficients.values()[[3, 0]]).abs() < 1e-13, "{normalization:?}: {c11}");
        for condon_shortley in [false, true] {
            let options = ImportOptions { normalization, condon_shortley, ..ImportOptions::default() };
            let found = import(&[&path], &options).unwrap().coefficients;
            let phase = if condon_shortley { convert::with_phase(found.values()) } else { found.values().clone() };
            assert!((&phase - known.coefficients.values()).iter().all(|d| d.abs() < 1e-12), "{normalization:?}");
        }
    }
}

#[test]
fn text_of_other_programs_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    // The text has a header, Fortran's exponents, errors in further columns, and no degree 0.
    let path = write("gravity.txt", "1738.0, 4902.8, 1\n1 0 1.0D+00 0 9 9\n1 1 2.5d-1, 3 9 9\n\n");
    let found = read(&path, Format::Pyshtools).unwrap();
    assert_eq!(found.coefficients.values().column(0).to_vec(), [0.0, 3.0, 1.0, 0.25]);
    let path = write("beta.1D", "# of AFNI\n 1 0 0\n\n2 3 4 # degree 1\n");
    let found = read(&path, Format::Afni).unwrap();
    assert_eq!(found.coefficients.values().column(0).to_vec(), [1.0, -4.0, 2.0, -3.0]);
    let path = write("c.json", "{\"coefficients\": [[1, 2]]}");
    assert_eq!(read(&path, Format::Json).unwrap().coefficients.values().dim(), (1, 2));
    for (name, format, text, why) in [
        ("a.sh", Format::Pyshtools, "0 0 1 0\n9999 0 1 0\n", "lines up to degree 9999"),
        ("b.sh", Format::Pyshtools, "0 0 1 0\n1 2 1 0\n", "order up to this degree"),
        (
            "d.sh",
            Format::Pyshtools,
            "0 0 1 0\n1 0 1 0\n",
            "no coefficient of degree 1, order 1; the file may be truncated",
        ),
        ("e.sh", Format::Pyshtools, "0 0 1 0\n1 1 1 0\n", "no coefficient of degree 1, order 0"),
        ("f.sh", Format::Pyshtools, "0 0 1 0\n1 0 1 0\n1 1 1 0\n1 0 2 0\n", "degree 1, order 0 twice"),
        ("c.sh", Format::Pyshtools, "0 0 nan 0\n", "a number on line 1"),
        ("a.1D", Format::Afni, "1 0\n2 3\n", "L + 1 rows"),
        ("b.1D", Format::Afni, "1 0 0\n2 3\n", "3 numbers on line 2"),
        ("a.coef", Format::Pdm, "{ 99999999999999999999,{1,2,3}}", "number of rows"),
        ("b.coef", Format::Pdm, "{ 2,{1,2,3},{1,2,3}}", "(L + 1)^2 rows"),
        ("a.csv", Format::Csv, "l,m,x\n0,0,1\n1,0,2\n", "degree 1, order -1 on line 3"),
        ("b.csv", Format::Csv, "l,m,x_re\n0,0,1\n", "NAME_re and NAME_im"),
        ("a.json", Format::Json, "{\"convention\": \"other\", \"coefficients\": [[1]]}", "convention"),
        ("b.json", Format::Json, "{\"coefficients\": [[1], [2, 3]]}", "1 number in row 1 (counted from 0), found 2"),
    ] {
        let error = read(&write(name, text), format).unwrap_err().to_string();
        assert!(error.contains(why) && error.contains(name) && !error.contains('\n'), "{name}: {error}");
    }
}

#[test]
fn what_is_cut_short_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    for (format, path) in files(folder.path(), 3) {
        let whole = std::fs::read(&path).unwrap();
        let last = whole.trim_ascii_end().len();
        for length in (0..last).filter(|length| length % 7 == 0 || *length > last - 9) {
            std::fs::write(&path, &whole[..length]).unwrap();
            match read(&path, format) {
                // Truncation can't be detected within the last number of a table, because the remaining digits are
                // still a number. It can't be detected either if the last tables of a FITS file or the last degrees of
                // a CSV table are completely missing.
                Ok(found) => assert!(
                    length > last - 40
                        || (format == Format::Healpy && length >= 6000)
                        || (format == Format::Csv && found.coefficients.max_degree() < 3),
                    "{format} {length}"
                ),
                Err(error) => assert!(error.to_string().len() < 500, "{error}"),
            }
        }
    }
}

/// Returns a MAT file with one compressed matrix of zeros, whose tags declare `claimed` bytes, but which inflates to
/// `there` bytes.
fn compressed(claimed: u32, there: usize) -> Vec<u8> {
    let number = u32::to_le_bytes;
    let mut matrix: Vec<u8> = [14, claimed, 6, 8, 6, 0, 5, 8].into_iter().flat_map(number).collect();
    matrix.extend([(claimed - 56) / 8, 1, 1, 4].into_iter().flat_map(number));
    matrix.extend(b"fvec\0\0\0\0");
    matrix.extend([9, claimed - 56].into_iter().flat_map(number));
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(&matrix).unwrap();
    (0..there >> 20).for_each(|_| packed.write_all(&[0; 1 << 20]).unwrap());
    let packed = packed.finish().unwrap();
    let mut file = format!("{:<124}", "MATLAB 5.0 MAT-file").into_bytes();
    file.extend([0, 1, b'I', b'M']);
    file.extend([15, packed.len() as u32].into_iter().flat_map(number));
    [file, packed].concat()
}

#[test]
fn bombs_and_lying_headers_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x");
    let refused = |bytes: &[u8], format: Format, why: &str| {
        std::fs::write(&path, bytes).unwrap();
        let error = read(&path, format).unwrap_err().to_string();
        assert!(error.contains(why), "{error}");
    };
    refused(&compressed(1 << 31, 64 << 20), Format::Mat, "a matrix of at most");
    refused(&compressed(200 << 20, 1 << 20), Format::Mat, "a compressed matrix of 209715200 bytes");
    let mut newer = compressed(64, 0);
    newer[..10].copy_from_slice(b"MATLAB 7.3");
    refused(&newer, Format::Mat, "save -v7");
    let npy = |shape: &str| {
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n");
        [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), &[0; 8]].concat()
    };
    refused(&npy("(3, 999999999999)"), Format::Ktch, "a shape that needs 23999999999976 bytes");
    refused(&npy("(99999999999, 99999999999)"), Format::Flowshape, "a shape with more values than any file can hold");
    refused(&npy("(1,)"), Format::S2fft, "shape (c, L + 1, 2 L + 1)");
    let fits = std::fs::read(&files(folder.path(), 2).iter().find(|(f, _)| *f == Format::Healpy).unwrap().1).unwrap();
    let changed = |from: &str, to: &str| {
        let text = String::from_utf8_lossy(&fits[..5760]).into_owned();
        assert!(text.contains(from));
        [text.replacen(from, to, 1).as_bytes(), &fits[5760..]].concat()
    };
    refused(&changed("NAXIS2  =                    6", "NAXIS2  = 99999999999999999999"), Format::Healpy, "NAXIS2");
    refused(
        &changed("NAXIS2  =                    6", "NAXIS2  =           9999999999"),
        Format::Healpy,
        "bytes of data",
    );
    refused(&changed("TFORM1  = 'K       '", "TFORM1  = 'A       '"), Format::Healpy, "numbers in column 1");
    // The index belongs to degree 1000, but the table has only enough rows for degree 2.
    let mut far = fits.clone();
    far[5760..5768].copy_from_slice(&1_001_001_i64.to_be_bytes());
    refused(&far, Format::Healpy, "rows up to degree 1000");
}

#[test]
fn a_sphere_goes_to_matlab_and_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.mat");
    let sphere = Sphere::icosphere(1);
    let known = Model::new(sphere.clone(), coefficients(3, 3), Kind::Surface);
    assert_eq!(export(&known, Format::Mat, &path, &ExportOptions::default()).unwrap().warnings, []);
    let found = import(&[&path], &ImportOptions::default()).unwrap().sphere.unwrap();
    assert_eq!(found.faces, sphere.faces);
    for (a, b) in found.directions.as_slice().iter().zip(sphere.directions.as_slice()) {
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-15));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Files with changed bytes are read as coefficients or cause an error, but never a panic.
    #[test]
    fn changed_bytes_never_panic(changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        thread_local! {
            static FILES: Vec<(Format, Vec<u8>)> = {
                let folder = tempfile::tempdir().unwrap();
                files(folder.path(), 2).into_iter().map(|(f, path)| (f, std::fs::read(path).unwrap())).collect()
            };
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        FILES.with(|files| {
            for (format, bytes) in files {
                let mut bytes = bytes.clone();
                for (at, value) in &changes {
                    let at = at.index(bytes.len());
                    bytes[at] = *value;
                }
                std::fs::write(&path, &bytes).unwrap();
                let _ = read(&path, *format);
                let _ = import(&[&path], &ImportOptions::default());
            }
        });
    }
}
