//! Tests that a scheme is opened only if its files belong to it and fit together, and that errors name missing files.

use std::os::unix::net::UnixListener;
use std::path::Path;

use rustix::fs::{CWD, FileType, Mode, mknodat};
use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_store::catalog::{degrees, summarize};
use spharm_store::factor::{factors, open_factor};
use spharm_store::{BuildParams, Codec, DegreeFile, FactorSpec, Scalar, Scheme, SchemeKey, StoreError, build};

use crate::{MAX_DEGREE, ROWS, directions, params, path_of, spec, store, write_factor};

fn open(store: &Path, key: SchemeKey, rows: usize, max_degree: usize) -> Result<Scheme, StoreError> {
    Scheme::open(store, key, rows, max_degree)
}

#[test]
fn a_scheme_knows_its_key_and_degree() {
    let (folder, key) = store(&params());
    for degree in 0..=MAX_DEGREE {
        let scheme = open(folder.path(), key, ROWS, degree).expect("a scheme");
        assert_eq!((scheme.key(), scheme.max_degree(), scheme.files().len()), (key, degree, degree + 1));
    }
}

#[test]
fn a_degree_that_is_missing_is_named() {
    let (folder, key) = store(&BuildParams { scalar: Scalar::F32, ..params() });
    let missing = |max_degree| match open(folder.path(), key, ROWS, max_degree) {
        Err(StoreError::DegreeMissing { scalar, complete_to, missing, wanted, .. }) => {
            (scalar, complete_to, missing, wanted)
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(missing(5), (Some(Scalar::F32), Some(MAX_DEGREE), MAX_DEGREE + 1, 5));
    std::fs::remove_file(path_of(folder.path(), key, "A_0")).expect("a removal");
    assert_eq!(missing(1), (None, None, 0, 1));
    assert!(matches!(open(folder.path(), key, ROWS, 2001), Err(StoreError::Harmonics(_))));
    assert!(matches!(open(folder.path(), key, ROWS, 2000), Err(StoreError::DegreeMissing { .. })));
    let other = SchemeKey([7; 32]);
    let error = open(folder.path(), other, ROWS, 1).expect_err("no such scheme");
    assert!(matches!(&error, StoreError::NoSuchScheme { available, .. } if *available == [key]), "{error}");
}

#[test]
fn directions_that_differ_by_rounding_are_named() {
    let (folder, key) = store(&BuildParams { scalar: Scalar::F32, ..params() });
    let open = |by: f64| {
        let moved: Vec<[f64; 3]> = directions().as_slice().iter().map(|&[x, y, z]| [x, y + by, z]).collect();
        Scheme::open_at(folder.path(), &Directions::from_vertices(&moved).expect("directions"), None, MAX_DEGREE)
    };
    match &open(1e-9) {
        Err(error @ StoreError::NearScheme { found, rows: ROWS, difference, .. }) => {
            assert!(*found == key && *difference < 1e-6, "{difference}");
            assert!(
                error.to_string().contains(&format!("scheme {} has the same 18 directions", key.short())),
                "{error}"
            );
        }
        other => panic!("{other:?}"),
    }
    assert!(matches!(open(1e-3), Err(StoreError::NoSuchScheme { .. })));
}

/// A scheme isn't opened if one of its files is replaced by an intact file of another length, scalar type, degree,
/// scheme or chunk size.
#[test]
fn files_that_do_not_fit_together_are_not_opened() {
    let (folder, key) = store(&params());
    assert!(matches!(open(folder.path(), key, ROWS + 1, MAX_DEGREE), Err(StoreError::Corrupt { .. })));
    let place = path_of(folder.path(), key, "A_1");
    let sound = std::fs::read(&place).expect("a file");
    let put = |from: &Path| std::fs::copy(from, &place).expect("a copy");
    let contents = |error: StoreError| assert!(error.to_string().contains("contents"), "{error}");

    put(&path_of(folder.path(), key, "A_2"));
    contents(open(folder.path(), key, ROWS, MAX_DEGREE).expect_err("another degree"));
    let listed = degrees(folder.path(), key).expect("a folder");
    assert_eq!(
        listed.iter().map(|(degree, file)| (*degree, file.is_ok())).collect::<Vec<_>>(),
        [(0, true), (1, false), (2, true)]
    );

    let (other, single) = store(&BuildParams { scalar: Scalar::F32, ..params() });
    put(&path_of(other.path(), single, "A_1"));
    contents(open(folder.path(), key, ROWS, MAX_DEGREE).expect_err("another scheme"));
    assert_eq!(summarize(folder.path(), key).expect("a folder").damaged, 1);
    let report = build(folder.path(), &directions(), &params(), &Silent).expect("a build");
    assert_eq!((report.built, report.warnings.len()), (1, 1));
    assert!(std::fs::read(&place).expect("a file") == sound);

    let (wide, _) = store(&BuildParams { chunk_rows: 16, ..params() });
    put(&path_of(wide.path(), key, "A_1"));
    let differs =
        |error| assert!(matches!(error, StoreError::ChunkRowsDiffer { expected: 8, found: 16, .. }), "{error}");
    differs(open(folder.path(), key, ROWS, MAX_DEGREE).expect_err("other chunks"));
    differs(build(folder.path(), &directions(), &params(), &Silent).expect_err("other chunks"));
}

/// File names that resemble the names of basis files are ignored.
#[test]
fn only_names_of_degrees_are_taken_for_degrees() {
    let (folder, key) = store(&params());
    for name in ["A_", "A_01", "A_+1", "A_1.tmp", "a_1", "B_1"] {
        std::fs::write(path_of(folder.path(), key, name), "something else").expect("a file");
    }
    let listed: Vec<usize> = degrees(folder.path(), key).expect("a folder").into_iter().map(|(at, _)| at).collect();
    assert_eq!(listed, [0, 1, 2]);
}

#[test]
fn what_is_no_regular_file_is_named_and_not_waited_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("file"), "text").expect("a file");
    std::os::unix::fs::symlink(at("file"), at("link")).expect("a link");
    std::fs::create_dir(at("folder")).expect("a folder");
    mknodat(CWD, at("fifo"), FileType::Fifo, Mode::RWXU, 0).expect("a FIFO");
    let _listener = UnixListener::bind(at("socket")).expect("a socket");
    let device = Path::new("/dev/null").to_owned();
    for (path, what) in [
        (at("link"), "a symbolic link"),
        (at("folder"), "a folder"),
        (at("fifo"), "a FIFO"),
        (at("socket"), "a socket or device"),
        (device, "a device"),
    ] {
        match DegreeFile::open(&path) {
            Err(StoreError::NotAFile { found, .. }) => assert_eq!(found, what),
            other => panic!("{}: {other:?}", path.display()),
        }
    }
    assert!(matches!(DegreeFile::open(&at("file")), Err(StoreError::Corrupt { .. })));
    assert!(matches!(DegreeFile::open(&at("nothing")), Err(StoreError::Io { .. })));
}

#[test]
fn a_file_says_what_it_holds() {
    for (scalar, codec) in [(Scalar::F64, Codec::Raw), (Scalar::F32, Codec::Raw), (Scalar::F64, Codec::Zstd)] {
        let (folder, key) = store(&BuildParams { scalar, codec, ..params() });
        // The harmonic of degree 0 is constant, so its full chunks compress well.
        let path = path_of(folder.path(), key, "A_0");
        let file = DegreeFile::open(&path).expect("a file");
        let direct = scalar == Scalar::F64 && codec == Codec::Raw;
        assert_eq!((file.path(), file.is_direct()), (&*path, direct));
        assert_eq!(file.file_len(), std::fs::metadata(&path).expect("a file").len());
        let window = file.window(1..3).expect("a window");
        assert_eq!(window.chunks(), 1..3);
        let raw = 8 * scalar.size();
        assert!(if codec == Codec::Raw { file.stored_len(1) == raw } else { file.stored_len(1) < raw });
        let in_place = |chunk| window.in_place(chunk).expect("values").map(<[f64]>::len);
        assert_eq!(in_place(1), direct.then_some(8));
        // The last chunk has two values, which compression doesn't make smaller: it is stored raw with every codec.
        assert_eq!(in_place(2), (scalar == Scalar::F64).then_some(2));
        assert_eq!(file.stored_len(2), 2 * scalar.size());
    }
}

#[test]
fn a_factor_is_found_by_what_it_is_of() {
    let (folder, key) = store(&params());
    let missing = |scalar| match open_factor(folder.path(), &spec(key), scalar) {
        Err(StoreError::FactorMissing { wanted, available, .. }) => (wanted, available),
        other => panic!("{other:?}"),
    };
    let text = "degree 2, weights ones, smoothness 0";
    assert_eq!(missing(None), (text.to_owned(), vec![]));
    let single = write_factor(folder.path(), key, Scalar::F32);
    assert_eq!(single.file_len(), std::fs::metadata(single.path()).expect("a file").len());
    assert_eq!(missing(Some(Scalar::F64)), (format!("{text} in f64"), vec![spec(key).file_name(Scalar::F32)]));
    let found = |scalar| open_factor(folder.path(), &spec(key), scalar).expect("a factor").header().scalar;
    assert_eq!(found(None), Scalar::F32);
    let double = write_factor(folder.path(), key, Scalar::F64);
    assert_eq!((found(None), found(Some(Scalar::F32))), (Scalar::F64, Scalar::F32));
    // Copy the f32 factor to the file name of the f64 factor.
    std::fs::copy(single.path(), double.path()).expect("a copy");
    let error = open_factor(folder.path(), &spec(key), None).expect_err("another scalar type");
    assert!(error.to_string().contains("scalar type"), "{error}");
    let damaged: Vec<bool> =
        factors(folder.path(), key).expect("a folder").into_iter().map(|(_, file)| file.is_err()).collect();
    assert_eq!(damaged, [false, true]);
    let other = FactorSpec { smoothness: 0.5, ..spec(key) };
    std::fs::copy(single.path(), path_of(folder.path(), key, &other.file_name(Scalar::F64))).expect("a copy");
    assert!(matches!(open_factor(folder.path(), &other, None), Err(StoreError::FactorDiffers { .. })));
}
