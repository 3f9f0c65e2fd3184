//! Encodes and decodes the header of a factor; see "Header of a factor" in `store-format.md`.
//!
//! A test compares the encoded header with a committed file byte by byte.

use std::path::Path;

use spharm_harmonics::{MAX_DEGREE, basis_size};

use crate::bytes::{hash_at, put, u32_at, u64_at};
use crate::container::codec::Codec;
use crate::container::frame::{Contents, FIELDS_AT, HeaderBytes, Kind};
use crate::error::StoreError;
use crate::factor::grid::TileGrid;
use crate::factor::spec::{FactorSpec, WeightsHash};
use crate::format::{FACTOR_VERSION, MAX_ROWS, MAX_TILE, MAX_TILES};
use crate::scheme::{Scalar, SchemeKey};

const KEY_AT: usize = FIELDS_AT;
const ROWS_AT: usize = KEY_AT + 32;
const DEGREE_AT: usize = ROWS_AT + 8;
const SCALAR_AT: usize = DEGREE_AT + 4;
const SIZE_AT: usize = SCALAR_AT + 4;
const TILE_AT: usize = SIZE_AT + 8;
const TILE_COLUMNS_AT: usize = TILE_AT + 4;
const TILE_COUNT_AT: usize = TILE_COLUMNS_AT + 4;
const WEIGHTS_AT: usize = TILE_COUNT_AT + 8;
const SMOOTHNESS_AT: usize = WEIGHTS_AT + 32;
const NORM_AT: usize = SMOOTHNESS_AT + 8;
const RCOND_AT: usize = NORM_AT + 8;
const RESERVED_AT: usize = RCOND_AT + 8;

/// Norm and condition number of the normal matrix G of a least-squares problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// 1-norm of G.
    pub norm: f64,
    /// Estimated reciprocal condition number of G, from 0 (singular) to 1: 1 / (1-norm of G times 1-norm of its
    /// inverse).
    pub reciprocal: f64,
}

/// Header of the file of a Cholesky factor.
#[derive(Debug, Clone, PartialEq)]
pub struct FactorHeader {
    /// Identity of the factor: its scheme, degree, weights and smoothness.
    pub spec: FactorSpec,
    /// Scalar type of the values.
    pub scalar: Scalar,
    /// Division of the factor into tiles.
    pub grid: TileGrid,
    /// Norm and condition number of the normal matrix G.
    pub condition: Condition,
}

impl FactorHeader {
    /// Returns the size of a tile in bytes.
    pub fn tile_len(&self, row: usize, column: usize) -> usize {
        self.grid.len(row, column) * self.scalar.size()
    }
}

impl Contents for FactorHeader {
    const KIND: Kind = Kind {
        magic: *b"\x89SPF\r\n\x1a\n",
        version: FACTOR_VERSION,
        reserved_at: RESERVED_AT,
        root_context: "spharm-rs 2026-11 factor file root v1",
        part: "tile",
    };

    fn encode_fields(&self, header: &mut HeaderBytes) {
        // Adding 0 turns -0 into +0.
        let real = |value: f64| (value + 0.0).to_bits().to_le_bytes();
        put(header, KEY_AT, &self.spec.key.0);
        put(header, ROWS_AT, &(self.spec.rows as u64).to_le_bytes());
        put(header, DEGREE_AT, &(self.spec.max_degree as u32).to_le_bytes());
        put(header, SCALAR_AT, &self.scalar.code().to_le_bytes());
        put(header, SIZE_AT, &(self.grid.size() as u64).to_le_bytes());
        put(header, TILE_AT, &(self.grid.tile() as u32).to_le_bytes());
        put(header, TILE_COLUMNS_AT, &(self.grid.columns() as u32).to_le_bytes());
        put(header, TILE_COUNT_AT, &(self.grid.count() as u64).to_le_bytes());
        put(header, WEIGHTS_AT, &self.spec.weights.0);
        put(header, SMOOTHNESS_AT, &real(self.spec.smoothness));
        put(header, NORM_AT, &real(self.condition.norm));
        put(header, RCOND_AT, &real(self.condition.reciprocal));
    }

    fn decode_fields(bytes: &HeaderBytes, path: &Path) -> Result<Self, StoreError> {
        let corrupt = |what, expected: &dyn ToString, found: &dyn ToString| {
            StoreError::corrupt(path, what, expected.to_string(), found.to_string())
        };
        let rows = u64_at(bytes, ROWS_AT);
        if rows == 0 || rows > MAX_ROWS {
            return Err(corrupt("rows", &"1 to 2^40", &rows));
        }
        let max_degree = u32_at(bytes, DEGREE_AT) as usize;
        if max_degree > MAX_DEGREE {
            return Err(corrupt("degree", &format!("at most {}", MAX_DEGREE), &max_degree));
        }
        let scalar = u32_at(bytes, SCALAR_AT);
        let scalar = Scalar::from_code(scalar).ok_or_else(|| corrupt("scalar type", &"1 (f64) or 2 (f32)", &scalar))?;
        let size = u64_at(bytes, SIZE_AT);
        if size != basis_size(max_degree) as u64 {
            return Err(corrupt("columns", &basis_size(max_degree), &size));
        }
        let tile = u32_at(bytes, TILE_AT) as usize;
        let grid = TileGrid::checked(size as usize, tile).ok_or_else(|| {
            let expected =
                format!("a multiple of 8 up to {MAX_TILE} that divides the factor into at most {MAX_TILES} tiles");
            corrupt("size of the tiles", &expected, &tile)
        })?;
        let tile_columns = u32_at(bytes, TILE_COLUMNS_AT);
        if tile_columns as usize != grid.columns() {
            return Err(corrupt("number of tile columns", &grid.columns(), &tile_columns));
        }
        let count = u64_at(bytes, TILE_COUNT_AT);
        if count != grid.count() as u64 {
            return Err(corrupt("number of tiles", &grid.count(), &count));
        }
        let real = |at: usize| f64::from_bits(u64_at(bytes, at));
        let smoothness = real(SMOOTHNESS_AT);
        if !smoothness.is_finite() || smoothness.is_sign_negative() {
            return Err(corrupt("smoothness", &"0 or more", &smoothness));
        }
        let condition = Condition { norm: real(NORM_AT), reciprocal: real(RCOND_AT) };
        if !condition.norm.is_finite() || condition.norm.is_sign_negative() {
            return Err(corrupt("norm", &"0 or more", &condition.norm));
        }
        if !(0.0..=1.0).contains(&condition.reciprocal) {
            return Err(corrupt("reciprocal condition number", &"0 to 1", &condition.reciprocal));
        }
        let spec = FactorSpec {
            key: SchemeKey(hash_at(bytes, KEY_AT)),
            rows: rows as usize,
            max_degree,
            weights: WeightsHash(hash_at(bytes, WEIGHTS_AT)),
            smoothness,
        };
        Ok(Self { spec, scalar, grid, condition })
    }

    fn parts(&self) -> usize {
        self.grid.count()
    }

    fn raw_len(&self, part: usize) -> usize {
        let (row, column) = self.grid.place(part);
        self.tile_len(row, column)
    }

    fn codec(&self) -> Codec {
        Codec::Raw
    }

    fn damaged(&self, path: &Path, part: usize, what: &'static str) -> StoreError {
        let (row, column) = self.grid.place(part);
        StoreError::TileDamaged { path: path.to_path_buf(), row, column, what }
    }
}
