//! Tests that tables of all formats with the same samples give the same moments.

mod parquet;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::parquet::file::properties::WriterProperties;
use arrow_array::{ArrayRef, Float32Array, Float64Array, Int32Array, RecordBatch, StringArray};
use spharm_moments::{Moments, Request, Shard, accumulate, merge};
use spharm_monitor::Silent;

const ROWS: usize = 1_000;

/// Returns x, y, z and f of each sample, rounded to single precision, so that all formats represent the same numbers.
fn rows() -> Vec<[f64; 4]> {
    let directions = spharm_harmonics::Directions::fibonacci(ROWS).unwrap();
    let row = |(i, v): (usize, &[f64; 3])| [v[0], v[1], v[2], (i as f64).sin()].map(|x| f64::from(x as f32));
    directions.as_slice().iter().enumerate().map(row).collect()
}

fn column(c: usize) -> Vec<f64> {
    rows().iter().map(|row| row[c]).collect()
}

fn read(path: &Path, shard: Shard) -> Moments {
    let mut request = Request::new(vec![path.to_owned()], 8);
    request.columns.values = vec!["f".to_owned()];
    request.shard = shard;
    accumulate(&request, &Silent).unwrap().moments
}

/// Checks that the moments of a table, read as a whole and in shards, equal the moments of the text table.
fn is_the_same(folder: &Path, path: &Path) {
    let text = folder.join("expected.csv");
    let lines = rows().iter().fold("x,y,z,f\n".to_owned(), |text, [x, y, z, f]| text + &format!("{x},{y},{z},{f}\n"));
    std::fs::write(&text, lines).unwrap();
    let expected = read(&text, Shard::WHOLE);
    let parts = (0..3).map(|index| read(path, Shard { index, of: 3 })).collect();
    for found in [read(path, Shard::WHOLE), merge(parts, false).unwrap()] {
        let sums = [&expected, &found].map(|m| m.sums.moments.iter().chain(&m.sums.right_sides));
        let [a, b] = sums;
        let off = a.zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-12 * expected.sums.moments[0], "{}: {off:e}", path.display());
        assert_eq!(found.rows, ROWS as u64);
    }
}

fn npy(descr: &str, shape: &str, values: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), values].concat()
}

#[test]
fn archives_of_numpy() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    for method in [zip::CompressionMethod::Stored, zip::CompressionMethod::Deflated] {
        let path = folder.path().join(format!("{method}.npz"));
        let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        for (c, name) in ["x", "y", "z", "f"].iter().enumerate() {
            archive.start_file(format!("{name}.npy"), options).unwrap();
            let values: Vec<u8> = column(c).iter().flat_map(|x| (*x as f32).to_le_bytes()).collect();
            archive.write_all(&npy("'<f4'", &format!("({ROWS},)"), &values)).unwrap();
        }
        archive.finish().unwrap();
        is_the_same(folder.path(), &path);
    }
    let ragged = folder.path().join("ragged.npz");
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&ragged).unwrap());
    for (name, rows) in [("x", 2), ("y", 3)] {
        archive.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(&npy("'<u1'", &format!("({rows},)"), &[0, 0, 0][..rows])).unwrap();
    }
    archive.finish().unwrap();
    refused(&ragged, &["ragged.npz", "3 rows in y, but 2 rows in the arrays before it"]);
}

fn refused(path: &Path, expected: &[&str]) {
    let mut request = Request::new(vec![path.to_owned()], 8);
    request.columns.values = vec!["f".to_owned()];
    let error = accumulate(&request, &Silent).unwrap_err().to_string();
    assert!(expected.iter().all(|word| error.contains(word)), "{error}");
}

#[test]
fn point_clouds_in_ply() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, head: &str, body: Vec<u8>| -> PathBuf {
        let path = folder.path().join(name);
        let properties =
            "property float x\nproperty float y\nproperty uchar red\nproperty float z\nproperty double f\n";
        let head = format!("ply\n{head}\ncomment made up\nelement vertex {ROWS}\n{properties}");
        std::fs::write(&path, [head.as_bytes(), &body].concat()).unwrap();
        path
    };
    for (name, order) in [("little.ply", "little"), ("big.ply", "big")] {
        let mut body = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n".to_vec();
        for [x, y, z, f] in rows() {
            let (x, y, z) = (x as f32, y as f32, z as f32);
            body.extend(match order {
                "little" => [&x.to_le_bytes()[..], &y.to_le_bytes(), &[7], &z.to_le_bytes(), &f.to_le_bytes()].concat(),
                _ => [&x.to_be_bytes()[..], &y.to_be_bytes(), &[7], &z.to_be_bytes(), &f.to_be_bytes()].concat(),
            });
        }
        body.extend([3; 13]);
        is_the_same(folder.path(), &write(name, &format!("format binary_{order}_endian 1.0"), body.clone()));
        body.truncate(body.len() / 2);
        let short = write(&format!("short-{name}"), &format!("format binary_{order}_endian 1.0"), body);
        refused(&short, &["short-", "1000 vertices of 21 bytes", "bytes in total"]);
    }
    let lines = rows().iter().fold("end_header\n".to_owned(), |t, [x, y, z, f]| t + &format!("{x} {y} 7 {z} {f}\n"));
    is_the_same(folder.path(), &write("text.ply", "format ascii 1.0", lines.into_bytes()));
    refused(
        &write("none.ply", "format ascii 1.0", b"property list uchar int v\nend_header\n".to_vec()),
        &["none.ply", "not lists"],
    );
}

#[test]
fn tables_by_columns() {
    let folder = tempfile::tempdir().unwrap();
    let single = |c: usize| Arc::new(Float32Array::from_iter_values(column(c).iter().map(|x| *x as f32))) as ArrayRef;
    let names = Arc::new(StringArray::from_iter_values((0..ROWS).map(|i| i.to_string())));
    let all = RecordBatch::try_from_iter([
        ("name", names as ArrayRef),
        ("f", Arc::new(Float64Array::from(column(3)))),
        ("z", single(2)),
        ("x", single(0)),
        ("y", single(1)),
        ("gaps", Arc::new(Int32Array::from_iter((0..ROWS as i32).map(|i| (i != 5).then_some(i))))),
    ])
    .unwrap();
    let ipc = folder.path().join("a.arrow");
    let mut arrow =
        arrow_ipc::writer::FileWriter::try_new(std::fs::File::create(&ipc).unwrap(), &all.schema()).unwrap();
    // Write several batches of 300 rows.
    for first in (0..ROWS).step_by(300) {
        let batch = all.slice(first, 300.min(ROWS - first));
        arrow.write(&batch).unwrap();
    }
    arrow.finish().unwrap();
    let parquet = folder.path().join("a.parquet");
    parquet::write(&parquet, &parquet::table(), 300, WriterProperties::default());
    for (path, text) in [(&parquet, "type BYTE_ARRAY (String)"), (&ipc, "type Utf8")] {
        is_the_same(folder.path(), path);
        for (column, expected) in
            [("gaps", "row 6: gaps: expected a finite number"), ("name", text), ("g", "no column g")]
        {
            let mut request = Request::new(vec![path.clone()], 2);
            request.columns.values = vec![column.to_owned()];
            let error = accumulate(&request, &Silent).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let bytes = std::fs::read(path).unwrap();
        let half = folder.path().join(format!("half.{}", path.extension().unwrap().display()));
        std::fs::write(&half, &bytes[..bytes.len() / 2]).unwrap();
        refused(&half, &["half.", "expected a table of numbers"]);
    }
}

/// The sizes that a compressed Arrow file declares for its buffers and blocks are checked before memory is allocated.
#[test]
fn sizes_in_arrow_files_are_held_against_the_file() {
    use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
    let folder = tempfile::tempdir().unwrap();
    let column = |c: usize| Arc::new(Float64Array::from(column(c))) as ArrayRef;
    let all = [("x", column(0)), ("y", column(1)), ("z", column(2)), ("f", column(3))];
    let all = RecordBatch::try_from_iter(all).unwrap();
    for codec in [arrow_ipc::CompressionType::LZ4_FRAME, arrow_ipc::CompressionType::ZSTD] {
        let path = folder.path().join("whole.arrow");
        let options = IpcWriteOptions::default().try_with_compression(Some(codec)).unwrap();
        let file = std::fs::File::create(&path).unwrap();
        let mut writer = FileWriter::try_new_with_options(file, &all.schema(), options).unwrap();
        writer.write(&all).unwrap();
        writer.finish().unwrap();
        is_the_same(folder.path(), &path);
        let bytes = std::fs::read(&path).unwrap();
        let tail = bytes.len() - 10;
        let length = arrow_ipc::reader::read_footer_length(bytes[tail..].try_into().unwrap()).unwrap();
        let footer_at = tail - length;
        let footer = arrow_ipc::root_as_footer(&bytes[footer_at..tail]).unwrap();
        let block = *footer.recordBatches().unwrap().get(0);
        let body = (block.offset() + i64::from(block.metaDataLength())) as usize;
        let message = arrow_ipc::root_as_message(&bytes[block.offset() as usize + 8..body]).unwrap();
        let buffers = message.header_as_record_batch().unwrap().buffers().unwrap();
        let buffer = buffers.iter().find(|buffer| buffer.length() > 8).unwrap();
        let changed = |name: &str, at: usize, value: i64| {
            let mut bytes = bytes.clone();
            bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        };
        // Falsify the declared uncompressed size of a buffer.
        let at = body + buffer.offset() as usize;
        refused(&changed("expands.arrow", at, 1 << 46), &["expands.arrow", "a buffer that expands from"]);
        refused(&changed("less.arrow", at, -2), &["less.arrow", "negative number of bytes"]);
        // Falsify the length of a block, as declared in the footer.
        let own = block.bodyLength().to_le_bytes();
        let at = footer_at + bytes[footer_at..tail].windows(8).rposition(|found| found == own).unwrap();
        for length in [i64::MAX, -1, 1 << 46] {
            refused(&changed("block.arrow", at, length), &["block.arrow", "outside the file"]);
        }
    }
}

#[test]
fn point_clouds_of_scanners() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let scale = 1e-4;
    let header = las::raw::Header {
        point_data_record_length: 20,
        number_of_point_records: ROWS as u32,
        offset_to_point_data: 227,
        x_scale_factor: scale,
        y_scale_factor: scale,
        z_scale_factor: scale,
        x_offset: 100.0,
        ..Default::default()
    };
    let mut bytes = Vec::new();
    header.write_to(&mut bytes).unwrap();
    bytes.resize(227, 0);
    for (i, [x, y, z, _]) in rows().into_iter().enumerate() {
        for value in [x, y, z] {
            bytes.extend(((value / scale).round() as i32).to_le_bytes());
        }
        bytes.extend((i as u16).to_le_bytes());
        bytes.extend([0; 6]);
    }
    std::fs::write(&path, &bytes).unwrap();
    let mut request = Request::new(vec![path], 4);
    request.columns.values = vec!["intensity".to_owned(), "radius".to_owned()];
    request.columns.centre = [100.0, 0.0, 0.0];
    let found = accumulate(&request, &Silent).unwrap().moments;
    let square: f64 = (0..ROWS).map(|i| (i * i) as f64).sum();
    assert_eq!((found.rows, found.sums.squares[0]), (ROWS as u64, square));
    assert!((found.sums.squares[1] / ROWS as f64 - 1.0).abs() < 1e-3);
    let short = folder.path().join("short.las");
    std::fs::write(&short, &bytes[..bytes.len() - 1]).unwrap();
    refused(&short, &["short.las", "1000 points of 20 bytes"]);
    bytes[104] |= 0x80;
    std::fs::write(&short, &bytes).unwrap();
    refused(&short, &["short.las", "LAZ"]);
}
