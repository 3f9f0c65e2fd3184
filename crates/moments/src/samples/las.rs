//! Reads point clouds from laser scanners (LAS): x, y, z and intensity of each point. The crate `las` reads the header.
//! This module reads the points itself, because the crate's point reader can't be sent between threads.
//!
//! Source: ASPRS, "LAS specification 1.4 R15": in all point formats, a record begins with X, Y and Z as scaled 32-bit
//! integers, followed by the intensity as a 16-bit integer.

use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};
use std::path::Path;

use las::raw::Header;
use spharm_surface::io::Scalar;

use super::records::{Field, Kind, Records, Stream};
use super::table::Table;
use crate::MomentsError;
use crate::moments::Shard;

const FORMAT: &str = "LAS";
const COLUMNS: [&str; 4] = ["x", "y", "z", "intensity"];
/// Smallest length of a point record in bytes: X, Y, Z and intensity.
const LEAST: u16 = 14;
/// Bit of the point format that marks a compressed file.
const COMPRESSED: u8 = 0x80;
const BUFFER: usize = 1 << 18;

/// A shard of a point cloud.
pub(super) struct Points {
    records: Records,
    /// Scale and offset of each column: value = scale * integer + offset.
    linear: [[f64; 2]; 4],
    selected: Vec<usize>,
}

/// Opens a LAS file. Returns the shard's points as a table, and the number of points.
pub(super) fn open(path: &Path, file: File, bytes: u64, shard: Shard) -> Result<(Points, u64), MomentsError> {
    let malformed = |expected: String, found: String| MomentsError::Malformed {
        path: path.to_owned(),
        format: FORMAT,
        expected,
        found,
    };
    let mut input = BufReader::with_capacity(BUFFER, file);
    let header = Header::read_from(&mut input).map_err(|e| malformed("a LAS header".to_owned(), e.to_string()))?;
    let row = header.point_data_record_length;
    if header.point_data_record_format & COMPRESSED != 0 {
        return Err(malformed(
            "uncompressed points".to_owned(),
            "compressed points (LAZ); decompress the file first".to_owned(),
        ));
    }
    if row < LEAST {
        return Err(malformed(format!("points of at least {LEAST} bytes"), format!("{row} bytes")));
    }
    let large = header.large_file.map(|large| large.number_of_point_records);
    let points = large.unwrap_or_else(|| header.number_of_point_records.into());
    let first = u64::from(header.offset_to_point_data);
    let least = points.checked_mul(row.into()).and_then(|values| values.checked_add(first));
    if least.is_none_or(|least| least > bytes) {
        let expected =
            format!("{first} bytes before the points and {points} points of {row} bytes, as the header states");
        return Err(malformed(expected, format!("{bytes} bytes in total")));
    }
    let rows = shard.range(points);
    input.seek(SeekFrom::Start(first + rows.start * u64::from(row))).map_err(MomentsError::io(path, "read"))?;
    let field = |at: usize, kind| Field { at, kind: Kind::Number(kind), little: true };
    let fields = vec![field(0, Scalar::I32), field(4, Scalar::I32), field(8, Scalar::I32), field(12, Scalar::U16)];
    let stream = Stream { input: Box::new(input), row: row.into(), fields };
    let left = rows.end - rows.start;
    let names = COLUMNS.map(str::to_owned).to_vec();
    let records = Records::new(path.to_owned(), FORMAT, names, vec![stream], rows);
    let linear = [
        [header.x_scale_factor, header.x_offset],
        [header.y_scale_factor, header.y_offset],
        [header.z_scale_factor, header.z_offset],
        [1.0, 0.0],
    ];
    Ok((Points { records, linear, selected: Vec::new() }, left))
}

impl Table for Points {
    fn columns(&self) -> &[String] {
        self.records.columns()
    }

    fn select(&mut self, columns: Vec<usize>) {
        self.selected.clone_from(&columns);
        self.records.select(columns);
    }

    fn read(&mut self, most: usize, out: &mut Vec<f64>) -> Result<usize, MomentsError> {
        let start = out.len();
        let rows = self.records.read(most, out)?;
        for row in out[start..].chunks_exact_mut(self.selected.len().max(1)) {
            for (value, &column) in row.iter_mut().zip(&self.selected) {
                let [scale, offset] = self.linear[column];
                *value = *value * scale + offset;
            }
        }
        Ok(rows)
    }

    fn number_of(&self, row: u64) -> u64 {
        self.records.number_of(row)
    }
}
