//! Draws colour bars.

use crate::image::Image;
use crate::text::{Label, draw_lines, lines_of, room, smallest_size, step};
use crate::{INK, Paint, Panel, map_of};

/// A colour bar that takes part of a panel's width. The values at its ends are next to it, and its label is beneath it.
pub(crate) struct Bar {
    range: (f64, f64),
    /// Width of the panel in pixels.
    width: usize,
    /// Length of the bar in pixels.
    length: usize,
    /// Height in pixels of a line of text in the panel.
    line: usize,
    /// Size of the bar's text in pixels; see [`Label`].
    size: f64,
    /// Values at the ends of the bar; `None` if they are part of the label, because the panel is too narrow.
    ends: Option<[String; 2]>,
    label: Vec<String>,
}

impl Bar {
    /// Returns the colour bar of a panel, if the panel has one.
    pub(crate) fn of(panel: &Panel<'_>, width: usize, line: usize, dpi: Option<u16>) -> Option<Self> {
        match panel.paint {
            Paint::Scalar { range, label, .. } => Some(Self::new(range, label, width, line, dpi)),
            _ => None,
        }
    }

    pub(crate) fn new(range: (f64, f64), label: &str, width: usize, line: usize, dpi: Option<u16>) -> Self {
        let size = size_of(line, dpi);
        let ends = [range.0, range.1].map(short);
        let most = width / 2;
        let length = match dpi {
            None => Some(most),
            Some(_) => {
                let widest = ends.iter().map(|end| Label::new(end, size).width()).fold(0.0, f32::max);
                let left = room(width) - 2.0 * (f64::from(widest) + gap(line) as f64);
                (left >= width as f64 / 5.0).then_some(most.min(left as usize))
            }
        };
        let (text, ends) = match length {
            Some(_) => (label.to_owned(), Some(ends)),
            // The range precedes the label, because the middle of a long text is left out.
            None => (format!("{} to {} {label}", ends[0], ends[1]), None),
        };
        let label = lines_of(&text, size, width, dpi);
        Self { range, width, length: length.unwrap_or(most), line, size, ends, label }
    }

    /// Returns the number of lines of the label.
    pub(crate) fn lines(&self) -> usize {
        self.label.len()
    }

    /// Returns the height in pixels of a colour bar whose label has `lines` lines.
    pub(crate) fn height(line: usize, lines: usize, dpi: Option<u16>) -> usize {
        2 * line + lines.saturating_sub(1) * step(size_of(line, dpi))
    }

    /// Draws the bar into a panel, with its top at y. The panel begins at x.
    pub(crate) fn draw(&self, picture: &mut Image, x: usize, y: usize) {
        let Self { range, width, length, line, size, .. } = *self;
        // The bar is at most half as wide as the panel, and shorter if the values at its ends need the room.
        let left = x + width / 4 + (width / 2 - length) / 2;
        for column in 0..length {
            let color = map_of(range)(column as f64 / (length.max(2) - 1) as f64);
            for row in 0..line / 2 {
                picture.set(left + column, y + line / 4 + row, color);
            }
        }
        if let Some([low, high]) = &self.ends {
            let (gap, top) = (gap(line), y + line / 8);
            Label::new(low, size).ending(picture, left.saturating_sub(gap), top, INK);
            Label::new(high, size).starting(picture, left + length + gap, top, INK);
        }
        draw_lines(picture, &self.label, size, [x + width / 2, y + line], INK);
    }
}

/// Returns the size in pixels of a bar's text.
fn size_of(line: usize, dpi: Option<u16>) -> f64 {
    (0.6 * line as f64).max(smallest_size(dpi))
}

/// Returns the distance in pixels between a bar and the values at its ends.
fn gap(line: usize) -> usize {
    line / 3
}

/// Formats a number with up to three significant digits.
fn short(x: f64) -> String {
    if x == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e4).contains(&x.abs()) {
        let decimals = (2 - x.abs().log10().floor() as i32).max(0) as usize;
        let text = format!("{x:.decimals$}");
        match text.contains('.') {
            true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
            false => text,
        }
    } else {
        format!("{x:.1e}")
    }
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn bar_values_have_three_digits() {
        for (x, text) in [
            (0.0, "0"),
            (1.0, "1"),
            (0.012_34, "0.0123"),
            (-2.5, "-2.5"),
            (1234.5, "1234"),
            (120.0, "120"),
            (3.2e-8, "3.2e-8"),
        ] {
            assert_eq!(short(x), text);
        }
    }
}
