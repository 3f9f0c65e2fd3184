//! Tests the guarantees of the store on small files. The tests in `tests/store` at the root cover the committed store,
//! the programs, builders that are killed or run at the same time, and full disks.

mod basis;
mod builders;
mod catalog;
mod checks;
mod factor;
mod fields;
mod forge;
mod opening;

use std::path::{Path, PathBuf};

use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_store::factor::{Condition, StartedFactor, start_factor};
use spharm_store::{BuildParams, FactorFile, FactorSpec, Scalar, SchemeKey, TileGrid, WeightsHash, build};
use tempfile::TempDir;

/// Number of directions. With 8 rows per chunk, there are two full chunks and one of 2 rows.
const ROWS: usize = 18;
const MAX_DEGREE: usize = 2;

/// Returns directions along a spiral.
fn directions() -> Directions {
    let angles: Vec<[f64; 2]> = (0..ROWS).map(|i| [0.1 + 2.9 * i as f64 / ROWS as f64, 2.4 * i as f64]).collect();
    Directions::from_angles(&angles).expect("directions")
}

fn params() -> BuildParams {
    BuildParams { max_degree: MAX_DEGREE, chunk_rows: 8, ..BuildParams::default() }
}

/// Builds a store with the basis of [`directions`]. Returns its folder and the scheme's key.
fn store(params: &BuildParams) -> (TempDir, SchemeKey) {
    let folder = tempfile::tempdir().expect("a folder");
    let key = build(folder.path(), &directions(), params, &Silent).expect("a build").key;
    (folder, key)
}

fn path_of(store: &Path, key: SchemeKey, name: &str) -> PathBuf {
    store.join(key.to_string()).join(name)
}

fn spec(key: SchemeKey) -> FactorSpec {
    FactorSpec { key, rows: ROWS, max_degree: MAX_DEGREE, weights: WeightsHash::ONES, smoothness: 0.0 }
}

/// Returns the value at a row and column of the factor that [`write_factor`] writes.
fn factor_value(row: usize, column: usize) -> f64 {
    if row < column { 0.0 } else { 1.0 + row as f64 - 0.25 * column as f64 }
}

/// Writes a factor of 9 columns in tiles of 8: three tiles.
fn write_factor(store: &Path, key: SchemeKey, scalar: Scalar) -> FactorFile {
    let spec = spec(key);
    let grid = TileGrid::new(spec.size(), 8).expect("a grid");
    let started = start_factor(store, &spec, scalar, grid, false, &Silent).expect("a start");
    let StartedFactor::New { writer, warnings } = started else { panic!("a new factor") };
    assert!(warnings.is_empty());
    for (row, column) in grid.tiles() {
        let columns = grid.range(column);
        let values: Vec<f64> =
            columns.flat_map(|column| grid.range(row).map(move |row| factor_value(row, column))).collect();
        writer.put(row, column, &values).expect("a tile");
    }
    writer.publish(Condition { norm: 10.0, reciprocal: 0.5 }).expect("a factor").expect("the only one");
    spharm_store::factor::open_factor(store, &spec, Some(scalar)).expect("the factor")
}
