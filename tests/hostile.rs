//! Runs the program on untrusted files: whatever the files claim or expand to, the result is one line of text with the
//! file's name, exit code 1, and memory within a limit enforced by the system. Stores have separate tests.

use std::fs::File;
use std::io::{Cursor, Write};
use std::path::PathBuf;
use std::process::{Command, Output};

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, write_mesh};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::common::{finish, root, text, tool};

/// A folder with a surface, its sphere, and the files that a test adds.
struct Site(tempfile::TempDir);

impl Site {
    fn new() -> Self {
        let site = Self(tempfile::tempdir().expect("a folder"));
        let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
        for (name, mesh) in [("surface.ply", &surface), ("sphere.ply", &sphere)] {
            write_mesh(site.path(name), mesh, &WriteOptions { double: true, overwrite: false }).expect("written");
        }
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("written");
    }

    /// Runs a verb within a data limit of 192 MiB, part of which threads' stacks and OpenBLAS's buffers take.
    fn run(&self, arguments: &[&str]) -> Output {
        let program = tool(arguments[0]);
        let mut limited = Command::new("sh");
        limited.args(["-c", "ulimit -d 196608 && exec \"$@\"", "sh"]).arg(program.get_program()).args(arguments);
        limited.env("OPENBLAS_NUM_THREADS", "1").env("RAYON_NUM_THREADS", "1").env_remove("SPHARM_STORE");
        finish(limited.current_dir(self.0.path()))
    }

    /// Returns the single line that refuses a file of this name.
    fn refused(&self, name: &str, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {}", text(&output));
        let lines: Vec<&str> = stderr.lines().collect();
        let [line] = lines[..] else { panic!("{arguments:?}: one line: {stderr}") };
        assert!(line.starts_with("error: ") && line.contains(name), "{line}");
        assert!(line.len() < 600 && !line.contains(char::is_control), "{line:?}");
        assert!(!line.contains("unexpected failure"), "{line}");
        line.to_owned()
    }

    fn refused_surface(&self, name: &str) -> String {
        self.refused(name, &["compare", name, "surface.ply", "-q"])
    }

    fn refused_model(&self, name: &str) -> String {
        self.refused(name, &["reconstruct", "--model", name, "-q", "-o", "out.ply"])
    }

    fn refused_volume(&self, name: &str) -> String {
        let size = ["--voxel-size", "1,1,1"];
        self.refused(name, &[&["parametrize", "--surface", name, "-q", "-o", "o.sphere.ply"][..], &size].concat())
    }
}

/// Returns a NumPy array file with this header.
fn npy(header: &str, values: &[u8]) -> Vec<u8> {
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), values].concat()
}

fn plain(descr: &str, shape: &str) -> String {
    format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n")
}

/// Returns an archive with correct checksums.
fn npz(entries: &[(&str, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let method = if deflated { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
    for (name, bytes) in entries {
        zip.start_file(format!("{name}.npy"), SimpleFileOptions::default().compression_method(method))
            .expect("a start");
        zip.write_all(bytes).expect("written");
    }
    zip.finish().expect("an archive").into_inner()
}

fn gzip(pieces: impl IntoIterator<Item = Vec<u8>>) -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    pieces.into_iter().for_each(|piece| packed.write_all(&piece).expect("packed"));
    packed.finish().expect("packed")
}

/// Returns bytes that can't be compressed.
fn noise(count: usize) -> Vec<u8> {
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    (0..count).map(|_| next()).collect()
}

#[test]
fn models_that_lie_are_refused() {
    let site = Site::new();
    let coefficients = || npy(&plain("<f8", "(4, 3)"), &[0; 96]);
    let whole = [("coefficients", coefficients()), ("max_degree", npy(&plain("<i8", "()"), &1_i64.to_le_bytes()))];
    site.put("whole.npz", &npz(&whole, false));
    assert!(
        site.run(&["reconstruct", "--model", "whole.npz", "--icosphere", "1", "-q", "-o", "o.ply"]).status.success()
    );
    let twice = "{'descr': '<f8', 'fortran_order': False, 'shape': (4, 3), 'shape': (1099511627776, 3), }\n";
    let escape = "{'descr': '<f8\x1b[2J\x07\n\n', 'fortran_order': False, 'shape': (4, 3), }\n";
    for (name, header, expected) in [
        ("twice.npz", twice.to_owned(), "twice"),
        ("escape.npz", escape.to_owned(), "\\u{1b}[2J\\u{7}"),
        ("huge.npz", plain("<f8", "(1099511627776, 3)"), "26388279066624 bytes"),
        ("more.npz", plain("<f8", "(9223372036854775807, 9223372036854775807)"), "more values than any file can hold"),
        ("deep.npz", format!("{{'descr': {}", "[(".repeat(20_000)), "expected"),
        ("object.npz", plain("|O", "(4, 3)"), "expected a type"),
    ] {
        site.put(name, &npz(&[("coefficients", npy(&header, &[0; 96]))], false));
        let line = site.refused_model(name);
        assert!(line.contains(expected), "{line}");
    }
    let scalar = npy(&plain("<i8", "(1099511627776,)"), &[0; 8]);
    site.put("degree.npz", &npz(&[("coefficients", coefficients()), ("max_degree", scalar)], false));
    assert!(site.refused_model("degree.npz").contains("max_degree"));
    // The file has 85 KB and expands to 85 MB of zeros; reading them would take 250 MB.
    let zeros = npy(&plain("<f8", "(10600000, 1)"), &vec![0; 84_800_000]);
    let bomb = npz(&[("coefficients", zeros)], true);
    assert!(bomb.len() < 1 << 18);
    site.put("bomb.npz", &bomb);
    assert!(site.refused_model("bomb.npz").contains(" of memory, "), "no room");
    File::create(site.path("sparse.npz")).expect("a file").set_len(1 << 40).expect("a sparse file");
    site.refused_model("sparse.npz");
}

#[test]
fn surfaces_that_expand_or_claim_too_much_are_refused() {
    let site = Site::new();
    // Returns gzipped GIfTI with zlib data in base64. The header claims `count` values, but only `there` values exist.
    let gifti = |count: u64, there: usize| {
        let mut zlib = ZlibEncoder::new(Vec::new(), Compression::fast());
        zlib.write_all(&vec![0; there]).expect("packed");
        let data = base64(&zlib.finish().expect("packed"));
        let head = "<?xml version=\"1.0\"?><GIFTI Version=\"1.0\" NumberOfDataArrays=\"1\"><DataArray \
                    Intent=\"NIFTI_INTENT_NONE\" DataType=\"NIFTI_TYPE_UINT8\" ArrayIndexingOrder=\"RowMajorOrder\" \
                    Dimensionality=\"1\" Encoding=\"GZipBase64Binary\" Endian=\"LittleEndian\" ";
        format!("{head}Dim0=\"{count}\"><Data>{data}</Data></DataArray></GIFTI>").into_bytes()
    };
    site.put("bomb.shape.gii.gz", &gzip([gifti(3 << 30, 1 << 20)]));
    assert!(site.refused_surface("bomb.shape.gii.gz").contains("3.0 GiB"));
    // The array is within the permitted expansion, but needs more memory than available.
    site.put("large.shape.gii", &gifti(60 << 20, 60 << 20));
    assert!(site.refused_surface("large.shape.gii").contains(" of memory, "));
    // The text exceeds the permitted expansion, which is reported while the file is decoded.
    site.put("text.ply.gz", &gzip((0..96).map(|_| vec![b' '; 1 << 20])));
    assert!(site.refused_surface("text.ply.gz").contains("MiB"));
    File::create(site.path("sparse.ply")).expect("a file").set_len(1 << 40).expect("a sparse file");
    assert!(site.refused_surface("sparse.ply").contains("GiB of memory"));
    let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 4611686018427387904\nproperty float x\nproperty \
               float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    site.put("claim.ply", ply.as_bytes());
    site.put("claim.off", b"OFF\n18446744073709551615 18446744073709551615 0\n");
    site.put("claim.stl", &[&[0; 80][..], &u32::MAX.to_le_bytes()].concat());
    site.put(
        "claim.vtk",
        b"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 9223372036854775807 double\n",
    );
    site.put("lh.claim", &[&b"\xff\xff\xfex\n\n"[..], &[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]].concat());
    let mgh: Vec<u8> = [1, i32::MAX, 1, 1, i32::MAX, 3, 0].iter().flat_map(|n: &i32| n.to_be_bytes()).collect();
    site.put("claim.mgh", &[mgh, vec![0; 300]].concat());
    site.put("deep.gii", "<GIFTI>".repeat(100_000).as_bytes());
    for name in ["claim.ply", "claim.off", "claim.stl", "claim.vtk", "lh.claim", "claim.mgh", "deep.gii"] {
        site.refused_surface(name);
    }
}

#[test]
fn volumes_that_expand_or_claim_too_much_are_refused() {
    let site = Site::new();
    let nifti = |n: i16| {
        let mut header = vec![0; 352];
        header[..4].copy_from_slice(&348_i32.to_le_bytes());
        for (k, size) in [3, n, n, n, 1, 1, 1, 1].iter().enumerate() {
            header[40 + 2 * k..42 + 2 * k].copy_from_slice(&size.to_le_bytes());
        }
        header[70] = 2;
        header[72] = 8;
        (0..4).for_each(|k| header[76 + 4 * k..80 + 4 * k].copy_from_slice(&1.0_f32.to_le_bytes()));
        header[108..112].copy_from_slice(&352.0_f32.to_le_bytes());
        header[344..348].copy_from_slice(b"n+1\0");
        header
    };
    // A header claims 4 GiB of voxels in a file of 5 MB, the size to which a real volume may compress.
    site.put("bomb.nii.gz", &[gzip([nifti(1625)]), noise(5 << 20)].concat());
    assert!(site.refused_volume("bomb.nii.gz").contains("GiB of memory"));
    site.put("lie.nii.gz", &gzip([nifti(1625)]));
    site.refused_volume("lie.nii.gz");
    // A volume contains only background, for which no memory is kept.
    let zeros = |n: usize| std::iter::repeat_n(vec![0; n * n], n);
    site.put("zeros.nii.gz", &gzip([nifti(256)].into_iter().chain(zeros(256))));
    assert!(site.refused_volume("zeros.nii.gz").contains("only 0"));
    // A label in every other voxel is the worst case, because each voxel is a separate run.
    let checks = |n: usize| (0..n).map(move |z| (0..n * n).map(|i| ((i + i / n + z) % 2) as u8).collect());
    site.put("checks.nii.gz", &gzip([nifti(256)].into_iter().chain(checks(256))));
    assert!(site.refused_volume("checks.nii.gz").contains(" of memory, "));
    let mgh: Vec<u8> = [1, 1625, 1625, 1625, 1, 0, 0].iter().flat_map(|n: &i32| n.to_be_bytes()).collect();
    site.put("bomb.mgz", &[gzip([[mgh, vec![0; 300]].concat()]), noise(5 << 20)].concat());
    let nrrd = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 1625 1625 1625\nspacings: 1 1 1\nencoding: gzip\n\n";
    site.put("bomb.nrrd", &[nrrd.as_bytes().to_vec(), gzip([vec![0; 100]]), noise(5 << 20)].concat());
    site.put("bomb.npy.gz", &[gzip([npy(&plain("|u1", "(1625, 1625, 1625)"), &[0; 100])]), noise(5 << 20)].concat());
    site.put("claim.npy", &npy(&plain("<f8", "(4194304, 4194304, 4194304)"), &[0; 8]));
    for name in ["bomb.mgz", "bomb.nrrd", "bomb.npy.gz"] {
        assert!(site.refused_volume(name).contains(" of memory, "), "{name}");
    }
    site.refused_volume("claim.npy");
    site.put("claim.tif", &tiff(40_000, 40_000));
    site.refused_volume("claim.tif");
    File::create(site.path("sparse.nii")).expect("a file").set_len(1 << 40).expect("a sparse file");
    assert!(site.refused_volume("sparse.nii").contains("GiB of memory"));
}

/// Returns a TIFF page of bytes that claims this size, in one strip.
fn tiff(width: u32, height: u32) -> Vec<u8> {
    let tags: [(u16, u32); 8] =
        [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 200), (278, height), (279, u32::MAX)];
    let mut bytes = [&b"II*\0"[..], &8_u32.to_le_bytes(), &(tags.len() as u16).to_le_bytes()].concat();
    for (tag, value) in tags {
        bytes.extend(
            [&tag.to_le_bytes()[..], &4_u16.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()].concat(),
        );
    }
    bytes.resize(400, 0);
    bytes
}

#[test]
fn tables_and_settings_that_lie_are_refused() {
    let site = Site::new();
    let samples = |name: &str| {
        let moments =
            ["moments", "--samples", name, "--vectors", "0", "1", "2", "--values", "3", "--max-degree", "2", "-q"];
        site.refused(name, &[&moments[..], &["-o", "o.moments"]].concat())
    };
    site.put("claim.npy", &npy(&plain("<f8", "(1152921504606846976, 4)"), &[0; 64]));
    site.put("twice.npy", &npy("{'descr': '<f8', 'descr': '<f4', 'fortran_order': False, 'shape': (1, 4)}", &[0; 32]));
    site.put("claim.npz", &npz(&[("a", npy(&plain("<f8", "(18446744073709551615, 65536)"), &[0; 8]))], false));
    for name in ["claim.npy", "twice.npy", "claim.npz"] {
        samples(name);
    }
    // Test an Arrow buffer of 85 bytes that claims 8 TiB and as many rows, and Parquet pages of 20 bytes that claim 2
    // GiB (with few rows and with as many rows), more values than the column, negative sizes, and columns missing from
    // the file. The last byte of a file of the corpus selects the way of reading it.
    for (file, expected) in [
        ("rows.arrow", "expands from 85 to 8796093022272 bytes"),
        ("pages-expands.parquet", "to 2147483647 bytes"),
        ("pages-rows.parquet", "pages that need 2.0 GiB of memory"),
        ("pages-long.parquet", "a page of 2147483647 bytes"),
        ("pages-less.parquet", "a page with a negative number of bytes"),
        ("pages-column.parquet", "outside the file"),
        ("pages-before.parquet", "outside the file"),
    ] {
        let bytes = std::fs::read(root().join("tests/data/hostile/tables").join(file)).expect("a file of the corpus");
        site.put(file, &bytes[..bytes.len() - 1]);
        let moments = ["moments", "--samples", file, "--values", "f", "--max-degree", "1", "-q", "-o", "o.moments"];
        let line = site.refused(file, &moments);
        assert!(line.contains(expected), "{line}");
    }
    let import = |name: &str| site.refused(name, &["import", name, "-q", "-o", "o.npz"]);
    site.put("claim.flm.npy", &npy(&plain("<c16", "(1099511627776, 3)"), &[0; 64]));
    site.put("deep.json", "[".repeat(1 << 20).as_bytes());
    site.put("claim.fits", b"SIMPLE  =                    T");
    File::create(site.path("sparse.json")).expect("a file").set_len(1 << 40).expect("a sparse file");
    for name in ["claim.flm.npy", "deep.json", "claim.fits", "sparse.json"] {
        import(name);
    }
    site.put("deep.toml", format!("a = {}", "[".repeat(1 << 19)).as_bytes());
    site.refused("deep.toml", &["study", "deep.toml"]);
    site.put("bomb.sphz", &[b"SPHZ".to_vec(), noise(1000)].concat());
    site.refused("bomb.sphz", &["shape", "expand", "bomb.sphz", "-q", "-o", "o.npz"]);
    site.put("claim.moments", &[0xff; 300]);
    site.refused("claim.moments", &["fit", "--moments", "claim.moments", "--max-degree", "2", "-q", "-o", "o.npz"]);
}

/// Escape sequences, bells and line breaks in file names and file contents are escaped on terminals and in logs.
#[test]
fn what_a_terminal_obeys_is_shown() {
    let site = Site::new();
    let name = "a\u{1b}[2J\u{7}\u{9b}5m\u{202e}b\n\rc.ply";
    std::fs::copy(site.path("surface.ply"), site.path(name)).expect("a copy");
    let shown = "a\\u{1b}[2J\\u{7}\\u{9b}5m\\u{202e}b \\rc.ply";
    site.put("list.txt", "x\u{1b}]0;y\u{7}.ply\n".as_bytes());
    let quiet = |output: &Output| {
        for stream in [&output.stdout, &output.stderr] {
            let text = String::from_utf8(stream.clone()).expect("UTF-8");
            assert!(!text.contains(|c: char| c != '\n' && c.is_control() || c == '\u{202e}'), "{text:?}");
        }
        String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
    };
    // Check errors, names from a list, and arguments that clap refuses.
    let said = quiet(&site.run(&["parametrize", "--surface", name, "-o", name]));
    assert!(said.contains(shown) && said.contains("an input"), "{said}");
    assert!(
        quiet(&site.run(&["fit", "--surface", "@list.txt", "--max-degree", "2"])).contains("x\\u{1b}]0;y\\u{7}.ply")
    );
    let said = quiet(&site.run(&["fit", "--no\u{202e}\u{7}\u{1b}[1m", name]));
    assert!(said.contains("--no\\u{202e}"), "{said}");
    // Successful runs print the name in tables, notes and progress, in JSON on standard output, and in a JSON log.
    let fit = ["fit", "--sphere", "sphere.ply", "--surface", name, "--max-degree", "2", "--force", "-o", "made"];
    for more in [&["-v"][..], &["--json"], &["--log", "json", "-v"], &["--report", "-"]] {
        let output = site.run(&[&fit[..], more].concat());
        assert!(output.status.success(), "{}", text(&output));
        let said = quiet(&output);
        let both = if more.contains(&"--json") || more.contains(&"-") { "\\u001b[2J\\u0007\\u009b5m" } else { "[2J" };
        assert!(said.contains(both), "{said}");
        if both != "[2J" {
            let value: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
            assert!(value["surfaces"][0]["file"].as_str().is_none_or(|file| file == name), "{value}");
        }
    }
    // Check the table of outcomes.
    site.put("rows.tsv", "id\tsurface\tsphere\nq\u{1b}[5m\tnone\u{1b}[7m.ply\tsphere.ply\n".as_bytes());
    let rows = ["fit", "--manifest", "rows.tsv", "--max-degree", "2", "-o", "out", "--keep-going", "--status", "s.tsv"];
    quiet(&site.run(&rows));
    quiet(&site.run(&["status", "s.tsv"]));
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let number = chunk.iter().fold(0_u32, |n, &byte| n << 8 | u32::from(byte)) << (8 * (3 - chunk.len()));
        let digits = (0..4).map(|k| char::from(DIGITS[(number >> (18 - 6 * k) & 63) as usize]));
        text.extend(digits.take(chunk.len() + 1));
        text.extend(std::iter::repeat_n('=', 3 - chunk.len()));
    }
    text
}
