//! Warns about coordinates that lose too many digits in a file.

use std::path::Path;

use anyhow::Result;
use spharm_cli::console::Console;
use spharm_monitor::number;
use spharm_surface::Mesh;
use spharm_surface::geometry::{bounds, sub};
use spharm_surface::io::{Precision, to_write_mesh};

/// A warning is given if the step between adjacent 32-bit coordinates exceeds this fraction of the bounding box's
/// diagonal.
const COARSE: f64 = 1e-4;

/// Warns if the 32-bit numbers of a mesh file are too coarse for a surface that is far from the origin or very small.
/// `double` states whether 64 bits are requested, and is `None` for verbs without `--double`.
///
/// # Errors
///
/// The output's name implies no mesh format.
pub(crate) fn warn_of_rounding(output: &Path, mesh: &Mesh, double: Option<bool>, console: &Console) -> Result<()> {
    let format = to_write_mesh(output)?;
    let (low, high) = bounds(mesh.vertices.iter().copied());
    let size = sub(high, low).into_iter().fold(0.0, f64::hypot);
    let largest = mesh.vertices.as_flattened().iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    // Below the normal range of 32-bit numbers, all steps between numbers are as large as the smallest positive number.
    let step = (largest * f64::from(f32::EPSILON)).max(f64::from(f32::from_bits(1)));
    if format.holds_double(double == Some(true)) || largest == 0.0 || step <= COARSE * size {
        return Ok(());
    }
    console.warn(format!(
        "{}: with coordinates up to {}, 32-bit numbers are too coarse for a surface of size {}: they have steps of up \
         to {}; {}",
        output.display(),
        number(largest),
        number(size),
        number(step),
        match format.precision {
            Precision::Choice if double.is_some() => "give --double",
            _ => "write a format with 64-bit numbers, such as .vtp",
        }
    ));
    Ok(())
}
