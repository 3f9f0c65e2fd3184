//! Tests tables over a sampling scheme, which have one row per direction.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use spharm_harmonics::Directions;
use spharm_moments::{Moments, MomentsError, Positions, Request, Shard, accumulate, merge};
use spharm_monitor::Silent;
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::Signal;
use spharm_surface::io::{WriteOptions, write_signal};

const N: usize = 5_000;

fn scheme(n: usize) -> Arc<Directions> {
    Arc::new(Directions::fibonacci(n).unwrap())
}

fn value(i: usize) -> f64 {
    (i as f64 * 0.37).sin() + 2.0
}

fn weight(i: usize) -> f64 {
    (1 + i % 3) as f64
}

/// Writes a table of values and weights. Its first lines are longer than the others, so that shards of equal size in
/// bytes would differ from shards of equal numbers of rows.
fn table(folder: &Path, name: &str, rows: usize) -> PathBuf {
    let mut text = "thickness,w\n".to_owned();
    for i in 0..rows {
        let zeros = if i < rows / 5 { "000000000000" } else { "" };
        writeln!(text, "{:.6}{zeros},{}", value(i), weight(i)).unwrap();
    }
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn request(files: &[&Path], scheme: &Arc<Directions>, shard: Shard) -> Request {
    let mut request = Request::new(files.iter().map(|path| path.to_path_buf()).collect(), 8);
    request.columns.positions = Some(Positions::Scheme(Arc::clone(scheme)));
    request.columns.values = vec!["thickness".to_owned()];
    request.columns.weight = Some("w".to_owned());
    request.shard = shard;
    request
}

fn read(request: &Request) -> Moments {
    accumulate(request, &Silent).unwrap().moments
}

fn refused(request: &Request) -> MomentsError {
    accumulate(request, &Silent).unwrap_err()
}

fn same(a: &Moments, b: &Moments) {
    assert_eq!((a.rows, a.sums.count, &a.occupied), (b.rows, b.sums.count, &b.occupied));
    let pairs = a.sums.moments.iter().zip(&b.sums.moments).chain(a.sums.right_sides.iter().zip(&b.sums.right_sides));
    let off = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-13 * a.sums.moments[0], "{off:e}");
    assert!((a.sums.squares[0] / b.sums.squares[0] - 1.0).abs() < 1e-13);
}

#[test]
fn rows_are_at_the_directions_of_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scheme) = (table(folder.path(), "t.csv", N), scheme(N));
    let found = read(&request(&[&path], &scheme, Shard::WHOLE));
    assert_eq!(found.scheme, Some(SchemeKey::of(&scheme, Scalar::F64)));
    // A table with the same samples, in which the directions are columns.
    let mut text = "x,y,z,thickness,w\n".to_owned();
    for (i, [x, y, z]) in scheme.as_slice().iter().enumerate() {
        writeln!(text, "{x},{y},{z},{:.6},{}", value(i), weight(i)).unwrap();
    }
    let beside = folder.path().join("xyz.csv");
    std::fs::write(&beside, text).unwrap();
    let mut vectors = request(&[&beside], &scheme, Shard::WHOLE);
    vectors.columns.positions = None;
    let vectors = read(&vectors);
    assert_eq!(vectors.scheme, None);
    same(&found, &vectors);
    assert_ne!(found.sources[0].key, vectors.sources[0].key);
}

/// Over a scheme, shards of all tables are ranges of rows, so that each row belongs to exactly one shard. Shards of
/// text tables are otherwise byte ranges.
#[test]
fn shards_are_of_rows_and_make_up_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scheme) = (table(folder.path(), "t.csv", N), scheme(N));
    let whole = read(&request(&[&path], &scheme, Shard::WHOLE));
    for of in [2, 7] {
        let shard = |index| Shard { index, of };
        let parts: Vec<Moments> = (0..of).map(|index| read(&request(&[&path], &scheme, shard(index)))).collect();
        for (index, part) in (0..of).zip(&parts) {
            let rows = shard(index).range(N as u64);
            assert_eq!((part.rows, part.scheme), (rows.end - rows.start, whole.scheme));
        }
        let all = merge(parts, false).unwrap();
        assert_eq!((&all.sources, all.scheme), (&whole.sources, whole.scheme));
        same(&all, &whole);
    }
}

#[test]
fn a_table_has_a_row_for_each_direction() {
    let folder = tempfile::tempdir().unwrap();
    let scheme = scheme(N);
    let good = table(folder.path(), "good.csv", N);
    for rows in [1, N - 1, N + 1, 2 * N] {
        let path = table(folder.path(), "t.csv", rows);
        let mut npy = ndarray::Array1::from_iter((0..rows).map(value));
        npy[0] = f64::NAN;
        let array = folder.path().join("t.npy");
        std::fs::write(&array, npy_bytes(npy.as_slice().unwrap())).unwrap();
        for shard in [Shard::WHOLE, Shard { index: 1, of: 3 }] {
            let mut of_array = request(&[&array], &scheme, shard);
            (of_array.columns.values, of_array.columns.weight) = (vec!["0".to_owned()], None);
            for (request, name) in [
                (request(&[&path], &scheme, shard), &path),
                (request(&[&good, &path], &scheme, shard), &path),
                (of_array, &array),
            ] {
                let error = refused(&request);
                let told = matches!(&error, MomentsError::Rows { path, expected, found }
                    if path == name && (*expected, *found) == (N as u64, rows as u64));
                assert!(told, "{error}");
                assert!(error.to_string().contains("one for each vertex of the sphere"), "{error}");
            }
        }
    }
    // With two tables, the moments are the sums over the samples of both tables.
    let twice = read(&request(&[&good, &good], &scheme, Shard::WHOLE));
    let once = read(&request(&[&good], &scheme, Shard::WHOLE));
    assert_eq!((twice.rows, twice.scheme), (2 * N as u64, once.scheme));
    assert!((twice.sums.squares[0] / once.sums.squares[0] - 2.0).abs() < 1e-14);
}

fn npy_bytes(values: &[f64]) -> Vec<u8> {
    let text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({},), }}\n", values.len());
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(text.len() as u16).to_le_bytes());
    bytes.extend_from_slice(text.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// Values on vertices are read from GIfTI files, and from FreeSurfer's curv files and maps.
#[test]
fn values_on_vertices_are_tables_too() {
    let folder = tempfile::tempdir().unwrap();
    let scheme = scheme(N);
    let values: Vec<f64> = (0..N).map(|i| f64::from(value(i) as f32)).collect();
    let array = folder.path().join("t.npy");
    std::fs::write(&array, npy_bytes(&values)).unwrap();
    let of = |path: &Path| {
        let mut request = request(&[path], &scheme, Shard { index: 1, of: 3 });
        (request.columns.values, request.columns.weight) = (vec!["0".to_owned()], None);
        request
    };
    let expected = read(&of(&array));
    for name in ["t.func.gii", "t.shape.gii.gz", "lh.thickness", "t.mgz"] {
        let path = folder.path().join(name);
        let write = |values: &[f64]| {
            let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
            write_signal(&path, &Signal::new(values.to_vec(), values.len(), 1), &options).unwrap();
        };
        write(&values);
        same(&read(&of(&path)), &expected);
        write(&values[1..]);
        assert!(matches!(refused(&of(&path)), MomentsError::Rows { found, .. } if found == N as u64 - 1), "{name}");
        let mut little = of(&path);
        little.memory = Some(spharm_moments::accumulate::bytes(8, 1));
        assert!(matches!(refused(&little), MomentsError::Memory { .. }), "{name}");
        let mut anywhere = of(&path);
        anywhere.columns.positions = None;
        assert!(matches!(refused(&anywhere), MomentsError::UnknownFormat { .. }), "{name}");
    }
    // A vertex without a value causes an error only if the vertex is used. A curv file has a header of 15 bytes and 4
    // bytes per value.
    let path = folder.path().join("lh.thickness");
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    write_signal(&path, &Signal::new(values, N, 1), &options).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    for vertex in [0, 2_000] {
        bytes[15 + 4 * vertex..][..4].copy_from_slice(&f32::NAN.to_be_bytes());
    }
    std::fs::write(&path, bytes).unwrap();
    let error = refused(&of(&path));
    assert!(matches!(&error, MomentsError::Row { row: 2_001, .. }), "{error}");
    let path = folder.path().join("what");
    std::fs::write(&path, "no format").unwrap();
    let error = refused(&of(&path));
    assert!(error.to_string().contains(".npy") && error.to_string().contains(".mgz"), "{error}");
}

#[test]
fn bad_rows_are_told_by_their_numbers_in_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scheme) = (table(folder.path(), "t.csv", N), scheme(N));
    let bad = std::fs::read_to_string(&path).unwrap().replacen(&format!("{:.6},", value(3_000)), "nan,", 1);
    std::fs::write(&path, bad).unwrap();
    let shard = |index| request(&[&path], &scheme, Shard { index, of: 2 });
    read(&shard(0));
    let error = refused(&shard(1)).to_string();
    assert!(error.contains("row 3001: thickness: expected a finite number, found NaN"), "{error}");
    let mut radius = shard(0);
    radius.columns.values = vec!["radius".to_owned()];
    assert!(matches!(refused(&radius), MomentsError::Columns { .. }));
}

#[test]
fn moments_of_different_schemes_add_up_without_a_key() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a.csv", "b.csv"].map(|name| table(folder.path(), name, N));
    let (first, mut turned) = (scheme(N), scheme(N).as_slice().to_vec());
    turned.reverse();
    let turned = Arc::new(Directions::from_unit_vectors(turned).unwrap());
    let part = |path: &Path, scheme: &Arc<Directions>| read(&request(&[path], scheme, Shard::WHOLE));
    let (one, same_scheme, other) = (part(&a, &first), part(&b, &first), part(&a, &turned));
    assert_ne!((one.scheme, &one.sources), (other.scheme, &other.sources), "the sphere is part of what was asked for");
    let key = |parts: &[&Moments]| {
        let parts = parts.iter().map(|&part| part.clone()).collect();
        merge(parts, false).unwrap().scheme
    };
    assert_eq!(key(&[&one, &same_scheme]), one.scheme);
    let mut anywhere = part(&b, &turned);
    anywhere.scheme = None;
    for parts in [[&one, &same_scheme, &other], [&other, &one, &same_scheme], [&one, &anywhere, &same_scheme]] {
        assert_eq!(key(&parts), None);
    }
    assert_eq!(key(&[&anywhere, &one]), None);
}
