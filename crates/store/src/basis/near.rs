//! Finds the scheme in a store whose directions equal the given ones up to rounding.

use std::f64::consts::PI;
use std::path::Path;

use spharm_harmonics::Directions;

use crate::basis::reader::DegreeFile;
use crate::basis::writer::file_name;
use crate::error::StoreError;
use crate::folder;
use crate::scheme::SchemeKey;

/// Largest difference between coordinates that is attributed to rounding.
const ROUNDING: f64 = 1e-6;

/// Returns the first of the schemes `keys` whose directions equal `directions` up to rounding, and the largest
/// difference between their coordinates. Schemes that can't be read are skipped.
pub(super) fn near(store: &Path, keys: &[SchemeKey], directions: &Directions) -> Option<(SchemeKey, f64)> {
    keys.iter().find_map(|&key| Some((key, difference(store, key, directions).ok().flatten()?)))
}

/// Returns the largest difference between the coordinates of a scheme's directions and of `directions`, or `None` if it
/// is too large to be a rounding error. The scheme's coordinates are read from its harmonics of degree 1, which are y,
/// z and x times a constant.
fn difference(store: &Path, key: SchemeKey, directions: &Directions) -> Result<Option<f64>, StoreError> {
    let file = DegreeFile::open(&folder::of_scheme(store, key).join(file_name(1)))?;
    let header = file.header();
    if header.key != key || header.degree != 1 || header.rows != directions.len() {
        return Ok(None);
    }
    let factor = (3.0 / (4.0 * PI)).sqrt();
    let (mut scratch, mut largest) = (Vec::new(), 0.0_f64);
    let window = file.window(0..header.chunk_count())?;
    for chunk in 0..header.chunk_count() {
        let rows = header.chunk_range(chunk);
        let values = window.values(chunk, &mut scratch)?;
        for (row, &[x, y, z]) in directions.as_slice()[rows.clone()].iter().enumerate() {
            for (column, coordinate) in [y, z, x].into_iter().enumerate() {
                let difference = (values[column * rows.len() + row] / factor - coordinate).abs();
                if difference >= ROUNDING || difference.is_nan() {
                    return Ok(None);
                }
                largest = largest.max(difference);
            }
        }
    }
    window.check()?;
    Ok(Some(largest))
}
