//! Computes the heights of panels and of the text beneath their meshes.
//!
//! In a picture with a resolution in dots per inch, text is at least 7 pt high on paper. If the text takes more room,
//! the panels become higher, so that the meshes keep their size.

use crate::bar::Bar;
use crate::text::{LINES, lines_of, smallest_size, step};
use crate::{Panel, Settings};

/// Heights in pixels, common to all panels of a picture.
pub(crate) struct Layout {
    /// Size of the captions' text in pixels.
    pub(crate) type_size: f64,
    /// Height of a line of text.
    pub(crate) line: usize,
    pub(crate) mesh_height: usize,
    pub(crate) bar_height: usize,
    /// Height of a panel, including its text.
    pub(crate) panel_height: usize,
}

impl Layout {
    pub(crate) fn of(panels: &[Panel<'_>], settings: &Settings) -> Self {
        let Settings { width, dpi, .. } = *settings;
        let type_size = type_size(width, dpi);
        let line = line_of(type_size);
        let bars = panels.iter().filter_map(|panel| Bar::of(panel, width, line, dpi)).map(|bar| bar.lines()).max();
        let captions = panels.iter().map(|panel| panel.caption).filter(|caption| !caption.is_empty());
        let captions = captions.map(|caption| lines_of(caption, type_size, width, dpi).len()).max();
        Self::with_lines(settings, bars, captions)
    }

    /// Returns the layout for labels and captions of maximum length, which gives the tallest panels that pictures with
    /// these settings may have.
    pub(crate) fn highest(settings: &Settings) -> Self {
        let lines = Some(settings.dpi.map_or(1, |_| LINES));
        Self::with_lines(settings, lines, lines)
    }

    /// Returns the layout for colour-bar labels of at most `bars` lines and captions of at most `captions` lines.
    /// `None` means that there are no labels, or no captions.
    fn with_lines(settings: &Settings, bars: Option<usize>, captions: Option<usize>) -> Self {
        let heights = |dpi: Option<u16>, bars: Option<usize>, captions: Option<usize>| {
            let type_size = type_size(settings.width, dpi);
            let line = line_of(type_size);
            let caption = |lines: usize| line + line / 4 + lines.saturating_sub(1) * step(type_size);
            [bars.map_or(0, |lines| Bar::height(line, lines, dpi)), captions.map_or(0, caption)]
        };
        let [bar_height, caption_height] = heights(settings.dpi, bars, captions);
        let plain: usize = heights(None, bars.map(|_| 1), captions.map(|_| 1)).iter().sum();
        let type_size = type_size(settings.width, settings.dpi);
        Self {
            type_size,
            line: line_of(type_size),
            mesh_height: settings.height.saturating_sub(plain).max(1),
            bar_height,
            panel_height: settings.height.saturating_add(bar_height + caption_height - plain),
        }
    }
}

/// Returns the size of the captions' text. The size grows with the panel, within legible limits.
fn type_size(width: usize, dpi: Option<u16>) -> f64 {
    (width as f64 / 24.0).clamp(11.0, 36.0).max(smallest_size(dpi))
}

/// Returns the height of a line of text.
fn line_of(type_size: f64) -> usize {
    (1.5 * type_size) as usize
}
