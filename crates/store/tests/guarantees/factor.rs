//! Tests that a factor returns the tiles that were written, is started only once, and opens only for its own scheme,
//! degree, weights and smoothness.

use spharm_monitor::Silent;
use spharm_store::factor::{Condition, StartedFactor, TileValues, factors, open_factor, start_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, StoreError, TileGrid, WeightsHash};

use crate::{directions, factor_value, spec, write_factor};

#[test]
fn a_factor_holds_the_tiles_that_were_put() {
    let key = SchemeKey::of(&directions(), Scalar::F64);
    for scalar in [Scalar::F64, Scalar::F32] {
        let folder = tempfile::tempdir().expect("a folder");
        let file = write_factor(folder.path(), key, scalar);
        file.verify(&Silent).expect("a sound file");
        let grid = file.header().grid;
        for (row, column) in grid.tiles() {
            let window = file.window(column).expect("a window");
            let values: Vec<f64> = match window.values(row).expect("values") {
                TileValues::F64(values) => values.to_vec(),
                TileValues::F32(values) => values.iter().map(|&value| f64::from(value)).collect(),
            };
            window.check().expect("an unchanged file");
            let expected: Vec<f64> = grid
                .range(column)
                .flat_map(|column| grid.range(row).map(move |row| factor_value(row, column)))
                .collect();
            assert_eq!(values, expected, "tile ({row}, {column})");
        }
    }
}

/// Tiles are read back in double precision, even from a factor stored in single precision. After publishing, no file
/// except the factor is left. If two writers write the same factor at the same time, the factor published first is
/// kept.
#[test]
fn tiles_are_read_back_while_the_rest_is_written() {
    let key = SchemeKey::of(&directions(), Scalar::F64);
    for scalar in [Scalar::F64, Scalar::F32] {
        let folder = tempfile::tempdir().expect("a folder");
        let grid = TileGrid::new(spec(key).size(), 8).expect("a grid");
        let start = || match start_factor(folder.path(), &spec(key), scalar, grid, true, &Silent).expect("a start") {
            StartedFactor::New { writer, .. } => writer,
            StartedFactor::Present(file) => panic!("{file:?}"),
        };
        let first = start();
        // Removing the lock file lets a second writer start while the first still runs.
        std::fs::remove_file(folder.path().join(key.to_string()).join(".lock")).expect("a removal");
        let second = start();
        assert_eq!(first.grid(), grid);
        let values = |at: usize, len: usize| (0..len).map(|i| at as f64 + i as f64 / 7.0).collect::<Vec<f64>>();
        for (at, (row, column)) in grid.tiles().enumerate() {
            for writer in [&first, &second] {
                writer.put(row, column, &values(at, grid.len(row, column))).expect("a tile");
            }
        }
        for (at, (row, column)) in grid.tiles().enumerate() {
            let mut found = vec![0.0; grid.len(row, column)];
            first.will_need(row, column);
            first.get(row, column, &mut found).expect("a tile");
            assert_eq!(found, values(at, found.len()), "{scalar:?} ({row}, {column})");
        }
        let condition = Condition { norm: 10.0, reciprocal: 0.5 };
        let len = first.publish(condition).expect("a factor").expect("the first");
        assert_eq!(second.publish(condition).expect("another's factor"), None);
        let file = open_factor(folder.path(), &spec(key), Some(scalar)).expect("the factor");
        assert_eq!((file.file_len(), file.header().condition), (len, condition));
        assert_eq!(file.window(1).expect("a window").column(), 1);
        file.verify(&Silent).expect("a sound file");
        let names = std::fs::read_dir(folder.path().join(key.to_string())).expect("a folder");
        let mut names: Vec<_> = names.map(|item| item.expect("a name").file_name()).collect();
        names.sort();
        assert_eq!(names, [".lock".to_owned(), spec(key).file_name(scalar)].map(std::ffi::OsString::from));
    }
}

#[test]
fn a_factor_is_started_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let key = SchemeKey::of(&directions(), Scalar::F64);
    let file = write_factor(folder.path(), key, Scalar::F64);
    let grid = file.header().grid;
    let start = || start_factor(folder.path(), &spec(key), Scalar::F64, grid, false, &Silent).expect("a start");
    assert!(matches!(start(), StartedFactor::Present(_)));
    std::fs::write(file.path(), "no factor").expect("a file");
    let StartedFactor::New { warnings, .. } = start() else { panic!("a damaged one is replaced") };
    assert_eq!(warnings.len(), 1);
}

#[test]
fn a_factor_of_something_else_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let key = SchemeKey::of(&directions(), Scalar::F64);
    let file = write_factor(folder.path(), key, Scalar::F64);
    let others = [
        FactorSpec { smoothness: 1e-3, ..spec(key) },
        FactorSpec { weights: WeightsHash([1; 32]), ..spec(key) },
        FactorSpec { max_degree: 3, ..spec(key) },
        FactorSpec { rows: 7, ..spec(key) },
        FactorSpec { key: SchemeKey([7; 32]), ..spec(key) },
    ];
    for other in others {
        assert!(matches!(file.expect(&other), Err(StoreError::FactorDiffers { .. })), "{other}");
        let refused = matches!(
            open_factor(folder.path(), &other, None),
            Err(StoreError::FactorMissing { .. } | StoreError::FactorDiffers { .. })
        );
        assert!(refused, "{other}");
    }
    assert_eq!(factors(folder.path(), key).expect("a folder").len(), 1);
}
