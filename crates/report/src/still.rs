//! Draws the pictures that a page shows instead of views if scripts or WebGL are unavailable.

use spharm_render::{Panel, Settings, encode_png, render};

use crate::ReportError;

/// Width and height of a panel in pixels. With this size, three panels fill a narrow page, and a picture takes a few
/// tens of kilobytes.
const SIDE: usize = 280;

/// Draws panels in a row, and returns the bytes of a PNG.
pub(crate) fn still(panels: &[Panel<'_>]) -> Result<Vec<u8>, ReportError> {
    let picture = render(panels, &Settings { width: SIDE, height: SIDE, ..Settings::default() })?;
    let mut bytes = Vec::new();
    encode_png(&picture, &mut bytes).map_err(ReportError::Picture)?;
    Ok(bytes)
}
