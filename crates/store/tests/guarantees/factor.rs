//! A factor holds the tiles that were put, is started once, and is opened only as what it is.

use spharm_monitor::Silent;
use spharm_store::factor::{StartedFactor, TileValues, factors, open_factor, start_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, StoreError, WeightsHash};

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
