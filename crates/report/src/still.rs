//! Pictures that a page shows where it can't draw: without scripts, or without WebGL.

use spharm_render::{Panel, Settings, encode_png, render};

use crate::ReportError;

/// Pixels of a panel's sides: three fill a narrow page, and take a few tens of kilobytes.
const SIDE: usize = 280;

/// Draws panels in a row; the PNG's bytes.
pub(crate) fn still(panels: &[Panel<'_>]) -> Result<Vec<u8>, ReportError> {
    let picture = render(panels, &Settings { width: SIDE, height: SIDE, ..Settings::default() })?;
    let mut bytes = Vec::new();
    encode_png(&picture, &mut bytes).map_err(ReportError::Picture)?;
    Ok(bytes)
}
