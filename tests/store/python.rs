//! An independent reader, `tests/read_store.py`, was written from `store-format.md` alone, and reads the same bits as
//! the library.

use std::path::{Path, PathBuf};
use std::process::Command;

use spharm_store::{DegreeFile, Scalar, Scheme, SchemeKey, catalog};

use super::only_scheme;
use crate::common::{finish, root, succeed, text, tool};

/// Returns Python with NumPy and zstandard, or `None` with a message if it isn't available.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("SPHARM_PYTHON").map(PathBuf::from);
    if python.is_none() {
        eprintln!("skipped: no Python reader here (SPHARM_PYTHON is not set; ./run test sets it)");
    }
    python
}

fn reader(python: &Path, file: &Path, out: &Path) -> Command {
    let name = file.file_name().and_then(|name| name.to_str()).expect("a basis file or a factor");
    let degree = name.strip_prefix("A_").unwrap_or(name);
    let mut command = Command::new(python);
    // Without -B, Python would write a cache folder into the sources.
    command.arg("-B").arg(root().join("tests/read_store.py"));
    command.arg(file.parent().expect("a folder")).arg(degree).arg(out);
    command
}

/// Returns the bytes of an .npy file after its header; the header must describe a row-major array of this type and
/// shape.
fn npy(path: &Path, scalar: Scalar, rows: usize, columns: usize) -> Vec<u8> {
    let bytes = std::fs::read(path).expect("the array");
    assert_eq!(bytes[..8], *b"\x93NUMPY\x01\x00");
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = String::from_utf8_lossy(&bytes[10..start]).into_owned();
    let size = if scalar == Scalar::F64 { 8 } else { 4 };
    let fields =
        [format!("'descr': '<f{size}'"), "'fortran_order': False".to_owned(), format!("'shape': ({rows}, {columns})")];
    assert!(fields.iter().all(|field| header.contains(field)), "{header}");
    assert_eq!(bytes.len() - start, rows * columns * size);
    bytes[start..].to_vec()
}

/// Returns the values that the library reads, as the bytes of a row-major array.
fn ours(file: &DegreeFile, scalar: Scalar) -> Vec<u8> {
    let header = file.header();
    let window = file.window(0..header.chunk_count()).expect("a window");
    let (mut bytes, mut scratch) = (Vec::new(), Vec::new());
    for chunk in 0..header.chunk_count() {
        let rows = header.chunk_range(chunk).len();
        let values = window.values(chunk, &mut scratch).expect("values");
        assert_eq!(values.len(), rows * header.columns());
        for value in (0..rows).flat_map(|row| values[row..].iter().step_by(rows)) {
            match scalar {
                Scalar::F64 => bytes.extend(value.to_le_bytes()),
                Scalar::F32 => {
                    let narrow = *value as f32;
                    assert_eq!(f64::from(narrow).to_bits(), value.to_bits(), "an f32, widened");
                    bytes.extend(narrow.to_le_bytes());
                }
            }
        }
    }
    window.check().expect("an unchanged file");
    bytes
}

/// Returns whether a chunk of more than one column is compressed, as its length shows.
fn has_compressed(scheme: &Scheme, scalar: Scalar) -> bool {
    let size = if scalar == Scalar::F64 { 8 } else { 4 };
    scheme.files()[1..].iter().any(|file| {
        let raw_len = |chunk| file.header().chunk_range(chunk).len() * file.header().columns() * size;
        (0..file.header().chunk_count()).any(|chunk| file.stored_len(chunk) < raw_len(chunk))
    })
}

/// Checks that both readers read the same bits in every degree of a scheme.
fn assert_same_bits(
    python: &Path,
    store: &Path,
    key: SchemeKey,
    scalar: Scalar,
    rows: usize,
    max_degree: usize,
) -> Scheme {
    let out = tempfile::tempdir().expect("a folder");
    assert_eq!(catalog::degrees(store, key).expect("a folder").len(), max_degree + 1);
    let scheme = Scheme::open(store, key, rows, max_degree).expect("it");
    for (degree, file) in scheme.files().iter().enumerate() {
        assert!(file.header().chunk_count() > 1);
        let path = out.path().join("block.npy");
        succeed(&mut reader(python, file.path(), &path));
        let theirs = npy(&path, scalar, rows, 2 * degree + 1);
        assert!(theirs == ours(file, scalar), "degree {degree} of {}", store.display());
    }
    scheme
}

#[test]
fn a_reader_written_from_the_document_finds_the_same_bits() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let (surface, sphere) = (folder.path().join("s.surf.gii"), folder.path().join("sphere.surf.gii"));
    let mut generate = tool("generate");
    succeed(generate.args(["--subdivisions", "1", "--surface"]).arg(surface).arg("--sphere").arg(&sphere));
    for (scalar, name) in [(Scalar::F64, "f64"), (Scalar::F32, "f32")] {
        for codec in ["none", "zstd"] {
            let store = folder.path().join(format!("{name}-{codec}"));
            let mut build = tool("basis-build");
            build.args(["-q", "--max-degree", "5", "--chunk-rows", "8", "--dtype", name, "--codec", codec]);
            succeed(build.arg("--sphere").arg(&sphere).arg("--store").arg(&store));
            let scheme = assert_same_bits(&python, &store, only_scheme(&store), scalar, 42, 5);
            assert_eq!(has_compressed(&scheme, scalar), codec == "zstd", "{name}");
        }
    }
}

#[test]
fn so_it_does_in_the_golden_store() {
    let Some(python) = python() else { return };
    let store = root().join("tests/data/golden-v1/store");
    let keys = catalog::schemes(&store).expect("a store");
    assert_eq!(keys.len(), 2);
    for key in keys {
        let file = DegreeFile::open(&store.join(key.to_string()).join("A_0")).expect("a file");
        assert_same_bits(&python, &store, key, file.header().scalar, 18, 4);
    }
}

/// The independent reader also reads the factors of the golden store.
#[test]
fn so_it_does_in_factors() {
    let Some(python) = python() else { return };
    let store = root().join("tests/data/golden-v1/store");
    let out = tempfile::tempdir().expect("a folder");
    let mut count = 0;
    for key in catalog::schemes(&store).expect("a store") {
        for (_, file) in spharm_store::factor::factors(&store, key).expect("a folder") {
            let file = file.expect("a factor");
            let (size, scalar) = (file.header().grid.size(), file.header().scalar);
            let path = out.path().join("factor.npy");
            succeed(&mut reader(&python, file.path(), &path));
            let ours: Vec<u8> = match scalar {
                Scalar::F64 => super::factor::lower(&file).into_iter().flat_map(f64::to_le_bytes).collect(),
                Scalar::F32 => {
                    super::factor::lower(&file).into_iter().flat_map(|value| (value as f32).to_le_bytes()).collect()
                }
            };
            assert!(npy(&path, scalar, size, size) == ours, "{}", file.path().display());
            count += 1;
        }
    }
    assert_eq!(count, 2);
}

#[test]
fn it_refuses_what_is_damaged() {
    let Some(python) = python() else { return };
    let golden = root().join("tests/data/golden-v1/store");
    let folder = tempfile::tempdir().expect("a folder");
    for key in catalog::schemes(&golden).expect("a store") {
        let name = Path::new(&key.to_string()).join("A_4");
        let bytes = std::fs::read(golden.join(&name)).expect("a file");
        let copy = folder.path().join(name);
        std::fs::create_dir(copy.parent().expect("a folder")).expect("a folder");
        let footer = bytes.len() - 128;
        // Change the version, a reserved byte, the first chunk, the table's last codec, and the file's length.
        for (at, what) in [
            (8, "version 0, not 1"),
            (100, "header_len or reserved bytes"),
            (4100, "CRC of the chunk at 4096"),
            (footer - 64 + 28 + 1, "codec of chunk 2"),
            (footer + 24, "file_len or entries"),
        ] {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            std::fs::write(&copy, damaged).expect("a file");
            let output = finish(&mut reader(&python, &copy, &folder.path().join("block.npy")));
            assert_eq!(output.status.code(), Some(1), "{}", text(&output));
            assert!(text(&output).contains(what), "{what}: {}", text(&output));
        }
    }
}
