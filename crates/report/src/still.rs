//! Draws the pictures that a page shows instead of views if scripts or WebGL aren't available.

use spharm_render::{Panel, Settings, encode_png, render};

use crate::ReportError;

/// Side of a panel in pixels: three panels fill a narrow page, and a picture takes a few tens of kilobytes.
const SIDE: usize = 280;

/// Draws panels in a row; returns the bytes of a PNG.
pub(crate) fn still(panels: &[Panel<'_>]) -> Result<Vec<u8>, ReportError> {
    let picture = render(panels, &Settings { width: SIDE, height: SIDE, ..Settings::default() })?;
    let mut bytes = Vec::new();
    encode_png(&picture, &mut bytes).map_err(ReportError::Picture)?;
    Ok(bytes)
}
