//! Files with false contents but correct hashes give a typed error. There is no panic, and no memory is allocated for
//! sizes that the file only claims.

use std::path::PathBuf;
use std::process::Command;

use spharm_monitor::Silent;
use spharm_store::{BuildParams, Codec, DegreeFile, Scheme, SchemeKey, StoreError, StoreWarning, build};
use tempfile::TempDir;

use super::forge::{Forged, put32, put64};
use super::{assert_helpful, assert_helpful_line, build_here, directions, write_signal, write_sphere};
use crate::common::{fail, finish, tool};

/// A store to degree 2 with one file to be replaced by forgeries.
struct Victim {
    folder: TempDir,
    key: SchemeKey,
    rows: usize,
    path: PathBuf,
    original: Forged,
}

impl Victim {
    fn new(rows: usize, chunk_rows: usize, codec: Codec) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let params = BuildParams { max_degree: 2, codec, chunk_rows, ..BuildParams::default() };
        let key = build_here(&folder.path().join("store"), rows, &params);
        let path = folder.path().join("store").join(key.to_string()).join("A_1");
        let original = Forged::read(&path);
        Self { folder, key, rows, path, original }
    }

    fn store(&self) -> PathBuf {
        self.folder.path().join("store")
    }

    fn fit(&self) -> Command {
        let mut fit = tool("fit");
        fit.arg("--store").arg(self.store()).args(["--max-degree", "2", "-q", "--threads", "1", "--sphere"]);
        fit.arg(write_sphere(self.folder.path(), self.rows)).arg("--surface");
        fit.arg(write_signal(self.folder.path(), self.rows)).arg("-o").arg(self.folder.path().join("out.spharm.npz"));
        fit
    }
}

/// A test case: words of the expected error, and a function that falsifies an entry of a file with 18 rows in chunks
/// of 8.
type Lie = (&'static str, fn(&mut Forged));

const LIES: &[Lie] = &[
    ("magic number", |f| f.header[0] = 0x88),
    ("store format version", |f| put32(&mut f.header, 8, 0)),
    ("store format version", |f| put32(&mut f.header, 8, 2)),
    ("store format version", |f| put32(&mut f.header, 8, u32::MAX)),
    ("header length", |f| put32(&mut f.header, 12, 8192)),
    ("rows", |f| put64(&mut f.header, 48, 0)),
    ("rows", |f| put64(&mut f.header, 48, u64::MAX)),
    ("rows", |f| put64(&mut f.header, 48, (1 << 40) + 1)),
    ("number of chunks", |f| put64(&mut f.header, 48, 1 << 40)),
    ("number of chunks", |f| put64(&mut f.header, 48, 16)),
    ("number of chunks", |f| put64(&mut f.header, 48, 25)),
    ("decoded length of a chunk", |f| put64(&mut f.header, 48, 17)),
    ("decoded length of a chunk", |f| put64(&mut f.header, 48, 24)),
    ("degree", |f| put32(&mut f.header, 56, 2001)),
    ("degree", |f| put32(&mut f.header, 56, u32::MAX)),
    ("columns", |f| put32(&mut f.header, 56, 2)),
    ("columns", |f| put32(&mut f.header, 60, 0)),
    ("columns", |f| put32(&mut f.header, 60, 5)),
    ("columns", |f| put32(&mut f.header, 60, u32::MAX)),
    ("decoded length of a chunk", |f| (put32(&mut f.header, 56, 2), put32(&mut f.header, 60, 5)).0),
    ("scalar type", |f| put32(&mut f.header, 64, 0)),
    ("scalar type", |f| put32(&mut f.header, 64, 3)),
    ("decoded length of a chunk", |f| put32(&mut f.header, 64, 2)),
    ("codec", |f| put32(&mut f.header, 68, 2)),
    ("codec", |f| put32(&mut f.header, 68, u32::MAX)),
    ("rows per chunk", |f| put64(&mut f.header, 72, 0)),
    ("rows per chunk", |f| put64(&mut f.header, 72, 7)),
    ("rows per chunk", |f| put64(&mut f.header, 72, (1 << 20) + 8)),
    ("rows per chunk", |f| put64(&mut f.header, 72, !7)),
    ("number of chunks", |f| put64(&mut f.header, 72, 16)),
    ("number of chunks", |f| put64(&mut f.header, 72, 1 << 20)),
    // A chunk of 2^20 rows of degree 2,000 would have 33 GB.
    ("chunk size", |f| {
        put64(&mut f.header, 72, 1 << 20);
        put32(&mut f.header, 56, 2000);
        put32(&mut f.header, 60, 4001);
    }),
    ("number of chunks", |f| put64(&mut f.header, 80, 0)),
    ("number of chunks", |f| put64(&mut f.header, 80, 2)),
    ("number of chunks", |f| put64(&mut f.header, 80, 4)),
    ("number of chunks", |f| put64(&mut f.header, 80, u64::MAX)),
    ("number of chunks", |f| {
        put64(&mut f.header, 48, 8 << 22);
        put64(&mut f.header, 80, 1 << 22);
        put64(&mut f.header, 72, 16);
    }),
    // Header and footer agree on more chunks than the file has bytes for.
    ("number of entries in the table", |f| {
        put64(&mut f.header, 48, 8 << 22);
        put64(&mut f.header, 80, 1 << 22);
    }),
    ("offset of the table", |f| {
        put64(&mut f.header, 48, 8 << 22);
        put64(&mut f.header, 80, 1 << 22);
        put64(&mut f.footer, 16, 1 << 22);
    }),
    ("reserved bytes", |f| f.header[88] = 1),
    ("reserved bytes", |f| f.header[4063] = 1),
    ("footer (truncated file?)", |f| f.footer[0] = b's'),
    ("offset of the table", |f| put64(&mut f.footer, 8, 0)),
    ("offset of the table", |f| put64(&mut f.footer, 8, 4095)),
    ("offset of the table", |f| put64(&mut f.footer, 8, u64::MAX)),
    ("offset of the table", |f| put64(&mut f.footer, 8, u64::MAX - 3 * 64 - 128 + 1)),
    ("number of entries in the table", |f| put64(&mut f.footer, 16, 0)),
    ("number of entries in the table", |f| put64(&mut f.footer, 16, 2)),
    ("number of entries in the table", |f| put64(&mut f.footer, 16, u64::MAX)),
    ("length of the file", |f| put64(&mut f.footer, 24, 0)),
    ("length of the file", |f| put64(&mut f.footer, 24, u64::MAX)),
    ("reserved bytes of the footer", |f| f.footer[64] = 1),
    ("reserved bytes of the footer", |f| f.footer[95] = 1),
    // Offsets of chunks before the file's start, overlapping, with a gap, out of order, past the end, and with sums
    // that overflow.
    ("offset of a chunk", |f| put64(&mut f.table, 0, 0)),
    ("offset of a chunk", |f| put64(&mut f.table, 0, 4160)),
    ("offset of a chunk", |f| put64(&mut f.table, 64, 4096)),
    ("offset of a chunk", |f| put64(&mut f.table, 64, 4096 + 128)),
    ("offset of a chunk", |f| put64(&mut f.table, 128, 1 << 40)),
    ("offset of a chunk", |f| put64(&mut f.table, 128, u64::MAX)),
    ("offset of a chunk", |f| f.table.rotate_left(64)),
    ("stored length of a chunk", |f| put64(&mut f.table, 8, 0)),
    ("stored length of a chunk", |f| put64(&mut f.table, 8, 191)),
    ("stored length of a chunk", |f| put64(&mut f.table, 8, 193)),
    ("stored length of a chunk", |f| put64(&mut f.table, 8, u64::MAX)),
    ("stored length of a chunk", |f| put64(&mut f.table, 8 + 128, 1 << 40)),
    ("decoded length of a chunk", |f| put64(&mut f.table, 16, 0)),
    ("decoded length of a chunk", |f| put64(&mut f.table, 16, 184)),
    ("decoded length of a chunk", |f| put64(&mut f.table, 16, u64::MAX)),
    ("codec of a chunk", |f| put32(&mut f.table, 28, 2)),
    ("codec of a chunk", |f| put32(&mut f.table, 28, u32::MAX)),
    // A chunk marked as compressed in a file whose header states that no chunk is.
    ("codec of a chunk", |f| put32(&mut f.table, 28, 1)),
    // Compressed chunks of no bytes, and of as many bytes as the uncompressed chunk has.
    ("stored length of a chunk", |f| {
        put32(&mut f.header, 68, 1);
        put32(&mut f.table, 28, 1);
        put64(&mut f.table, 8, 0);
    }),
    ("stored length of a chunk", |f| {
        put32(&mut f.header, 68, 1);
        put32(&mut f.table, 28, 1);
    }),
    ("offset of the table", |f| {
        f.body.extend([0; 64]);
        f.measure();
    }),
    ("offset of the table", |f| {
        f.body.extend([0; 8]);
        f.measure();
    }),
];

#[test]
fn a_lie_is_refused_by_name() {
    let victim = Victim::new(18, 8, Codec::Raw);
    for (at, (what, lie)) in LIES.iter().enumerate() {
        let mut forged = victim.original.clone();
        lie(&mut forged);
        forged.write(&victim.path);
        let error = DegreeFile::open(&victim.path).expect_err(what);
        assert!(matches!(error, StoreError::Corrupt { .. } | StoreError::Version { .. }), "{at}: {error:?}");
        assert_helpful(&error, &victim.path);
        assert!(error.to_string().contains(what), "{at}: expected {what:?}: {error}");
    }
    let mut honest = victim.original.clone();
    honest.write(&victim.path);
    DegreeFile::open(&victim.path).expect("the forger's tools change nothing by themselves");
}

/// The tools refuse the same files without crashing, waiting, or allocating the memory that the files claim.
#[test]
fn the_tools_refuse_a_lie_in_little_memory() {
    let victim = Victim::new(18, 8, Codec::Raw);
    // Each case runs a process, so only the first case for each error is tested.
    let mut seen = Vec::new();
    for (what, lie) in LIES {
        if seen.contains(what) {
            continue;
        }
        seen.push(what);
        let mut forged = victim.original.clone();
        lie(&mut forged);
        forged.write(&victim.path);
        let line = fail(&mut in_little_memory(&victim.fit()));
        assert_helpful_line(&line, &victim.path);
        assert!(line.contains(what), "{what}: {line}");
    }
    let mut verify = tool("store");
    verify.arg("verify").arg(victim.store());
    assert_helpful_line(&fail(&mut in_little_memory(&verify)), &victim.path);
    // A build replaces the damaged file.
    let mut rebuild = tool("basis-build");
    rebuild.args(["--max-degree", "2", "--sphere"]).arg(write_sphere(victim.folder.path(), 18));
    assert!(finish(rebuild.arg("--store").arg(victim.store())).status.success());
    assert!(finish(&mut victim.fit()).status.success());
}

/// Returns the command with an address space of 2 GiB, most of which is reserved by OpenBLAS and the stacks.
fn in_little_memory(command: &Command) -> Command {
    let mut limited = Command::new("sh");
    limited.args(["-c", "ulimit -v 2097152 && exec \"$@\"", "sh"]).arg(command.get_program()).args(command.get_args());
    limited.env("OPENBLAS_NUM_THREADS", "1").env_remove("SPHARM_STORE");
    limited
}

#[test]
fn a_frame_that_lies_is_refused_when_it_is_read() {
    // A chunk of 4,096 rows has 98,304 bytes in the file A_1.
    let victim = Victim::new(4096, 4096, Codec::Zstd);
    let compress = |len: usize, level: i32| zstd::bulk::compress(&vec![0; len], level).expect("a frame");
    let right = compress(98_304, 1);
    let bomb = compress(1 << 30, 19);
    assert!(bomb.len() < 98_304, "a gigabyte in {} bytes", bomb.len());
    let mut without_length = zstd::stream::Encoder::new(Vec::new(), 1).expect("an encoder");
    std::io::Write::write_all(&mut without_length, &[0; 98_304]).expect("bytes");
    let skippable = [&[0x50, 0x2a, 0x4d, 0x18, 1, 0, 0, 0, 9][..], &right].concat();
    let frames: [(&str, Vec<u8>); 9] = [
        ("a gigabyte", bomb),
        ("a byte less", compress(98_303, 1)),
        ("a byte more", compress(98_305, 1)),
        ("nothing", compress(0, 1)),
        ("two frames", [compress(49_152, 1), compress(49_152, 1)].concat()),
        ("a tail", [&right[..], &[0]].concat()),
        ("half a frame", right[..right.len() / 2].to_vec()),
        ("no length", without_length.finish().expect("a frame")),
        ("a frame to be skipped first", skippable),
    ];
    for (what, frame) in frames.iter().chain([&("noise", vec![0xa5; 1000])]) {
        let mut forged = victim.original.clone();
        forged.one_chunk(frame, 1);
        forged.write(&victim.path);
        let file = DegreeFile::open(&victim.path).expect("nothing wrong with header and table");
        let damaged = |error: StoreError| {
            assert!(
                matches!(error, StoreError::ChunkDamaged { chunk: 0, what: "its zstd frame", .. }),
                "{what}: {error}"
            );
            assert_helpful(&error, &victim.path);
        };
        damaged(file.verify(&Silent).expect_err(what));
        damaged(file.window(0..1).expect("a window").values(0, &mut Vec::new()).expect_err(what));
    }
    let mut forged = victim.original.clone();
    forged.one_chunk(&frames[0].1, 1);
    forged.write(&victim.path);
    assert_helpful_line(&fail(&mut in_little_memory(&victim.fit())), &victim.path);
    assert_helpful_line(&fail(in_little_memory(&victim.fit()).arg("--verify")), &victim.path);
    forged.one_chunk(&right, 1);
    forged.write(&victim.path);
    DegreeFile::open(&victim.path).expect("a file").verify(&Silent).expect("a right frame");
}

/// A wrong checksum or hash of a chunk, under a correct root hash, is found when the chunk is read.
#[test]
fn a_chunk_that_differs_from_the_table_is_refused_when_it_is_read() {
    let victim = Victim::new(18, 8, Codec::Raw);
    let mut forged = victim.original.clone();
    forged.table[24] ^= 1;
    forged.write(&victim.path);
    let file = DegreeFile::open(&victim.path).expect("a file");
    let error = file.window(0..3).expect("a window").values(0, &mut Vec::new()).expect_err("another CRC");
    assert_helpful(&error, &victim.path);
    assert_helpful(&file.verify(&Silent).expect_err("another CRC"), &victim.path);
    let mut forged = victim.original.clone();
    forged.table[64 + 32] ^= 1;
    forged.write(&victim.path);
    let file = DegreeFile::open(&victim.path).expect("a file");
    assert_helpful(&file.verify(&Silent).expect_err("another hash"), &victim.path);
    assert_helpful_line(&fail(victim.fit().arg("--verify")), &victim.path);
}

/// Valid files in the wrong folder or under the wrong name are refused.
#[test]
fn a_file_of_another_scheme_or_degree_is_refused() {
    let victim = Victim::new(18, 8, Codec::Raw);
    let (store, folder) = (victim.store(), victim.path.parent().expect("a folder").to_path_buf());
    let other = tempfile::tempdir().expect("a folder");
    let params = BuildParams { max_degree: 2, chunk_rows: 8, ..BuildParams::default() };
    let key = build_here(other.path(), 19, &params);
    let single = BuildParams { scalar: spharm_store::Scalar::F32, ..params.clone() };
    let single_key = build_here(other.path(), 18, &single);
    let chunked = tempfile::tempdir().expect("a folder");
    build_here(chunked.path(), 18, &BuildParams { chunk_rows: 16, ..params.clone() });
    let cases = [
        ("another scheme", other.path().join(key.to_string()).join("A_1")),
        ("single precision", other.path().join(single_key.to_string()).join("A_1")),
        ("another degree", folder.join("A_2")),
        ("other chunks", chunked.path().join(victim.key.to_string()).join("A_1")),
    ];
    for (what, file) in cases {
        std::fs::copy(&file, &victim.path).expect("a copy");
        assert_helpful(&Scheme::open(&store, victim.key, 18, 2).expect_err(what), &victim.path);
        assert_helpful_line(&fail(&mut victim.fit()), &victim.path);
    }
    // A file in f32 under the key of f64: only its header shows the scalar type, because all hashes are correct.
    let mut forged = victim.original.clone();
    put32(&mut forged.header, 64, 2);
    forged.table.clear();
    forged.body.clear();
    for rows in [8, 8, 2] {
        let len = rows * 3 * 4;
        let offset = 4096 + forged.body.len();
        forged.body.resize((forged.body.len() + len).next_multiple_of(64), 0);
        let mut entry = vec![0; 64];
        put64(&mut entry, 0, offset as u64);
        put64(&mut entry, 8, len as u64);
        put64(&mut entry, 16, len as u64);
        put32(&mut entry, 24, crc32c::crc32c(&vec![0; len]));
        entry[32..].copy_from_slice(blake3::hash(&vec![0; len]).as_bytes());
        forged.table.extend(entry);
    }
    forged.measure();
    forged.write(&victim.path);
    DegreeFile::open(&victim.path).expect("a file that is sound by itself");
    assert_helpful(&Scheme::open(&store, victim.key, 18, 2).expect_err("another scalar"), &victim.path);
    // A build treats the file as damaged and replaces it.
    let report = build(&store, &directions(18), &params, &Silent).expect("a build");
    let [StoreWarning::Replaced(error)] = &report.warnings[..] else { panic!("{:?}", report.warnings) };
    assert_helpful(error, &victim.path);
    Scheme::open(&store, victim.key, 18, 2).expect("a sound scheme");
}

#[test]
fn a_degree_beyond_all_bounds_is_refused() {
    let victim = Victim::new(18, 8, Codec::Raw);
    for degree in ["2001", "1000000000000", "18446744073709551615"] {
        let mut fit = tool("fit");
        fit.arg("--store").arg(victim.store()).args(["--max-degree", degree, "--sphere"]);
        fit.arg(write_sphere(victim.folder.path(), 18)).arg("--surface").arg(write_signal(victim.folder.path(), 18));
        let line = fail(fit.arg("-o").arg(victim.folder.path().join("out.spharm.npz")));
        assert!(line.contains("2000"), "{line}");
        assert!(Scheme::open(&victim.store(), victim.key, 18, degree.parse().expect("a number")).is_err());
    }
}

/// A build refuses to write chunks that no reader would accept.
#[test]
fn chunks_that_the_format_has_no_room_for_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = folder.path().join("store");
    let refuse = |n: usize, params: &BuildParams| {
        let error = build(&store, &directions(n), params, &Silent).expect_err("too much");
        assert!(error.to_string().contains("chunk"), "{error}");
        assert!(!store.exists());
    };
    let params = BuildParams { memory: 1 << 50, allow_large: true, ..BuildParams::default() };
    refuse(10, &BuildParams { max_degree: 2000, chunk_rows: 1 << 20, ..params.clone() });
    refuse(10, &BuildParams { chunk_rows: 12, ..params.clone() });
    refuse(10, &BuildParams { chunk_rows: 0, ..params.clone() });
    refuse(10, &BuildParams { chunk_rows: (1 << 20) + 8, ..params });
}

/// A file claims 2^22 chunks, and has a hole in their place: no more memory is allocated than the bound for tables
/// allows.
#[test]
fn a_file_of_holes_is_refused() {
    let victim = Victim::new(18, 8, Codec::Raw);
    let mut forged = victim.original.clone();
    let chunks = 1u64 << 22;
    put64(&mut forged.header, 48, 8 * chunks);
    put64(&mut forged.header, 80, chunks);
    put64(&mut forged.footer, 8, 4096 + 192 * chunks);
    put64(&mut forged.footer, 16, chunks);
    put64(&mut forged.footer, 24, 4096 + 192 * chunks + 64 * chunks + 128);
    forged.write(&victim.path);
    // The footer moves to the end of the hole.
    let file = std::fs::File::options().write(true).open(&victim.path).expect("a file");
    file.set_len(4096).expect("a truncation");
    file.set_len(4096 + 256 * chunks).expect("a hole");
    std::os::unix::fs::FileExt::write_all_at(&file, &forged.footer, 4096 + 256 * chunks).expect("a write");
    assert_helpful(&DegreeFile::open(&victim.path).expect_err("a table of zeros"), &victim.path);
}
