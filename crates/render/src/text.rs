//! Draws text in pictures.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

use crate::image::{Image, Text};

/// Smallest size of text in a picture with a known size on paper, in points of 1/72 inch.
const POINTS: f64 = 7.0;
/// Maximum number of lines of a caption or label.
pub(crate) const LINES: usize = 6;
/// Fraction of a panel's width that text may take. The rest is a margin, because SVG files may be shown in a font with
/// wider letters.
const SHARE: f64 = 0.9;

/// A line of text with a font and a size.
pub(crate) struct Label<'a> {
    text: &'a str,
    scale: PxScale,
    font: Option<FontRef<'static>>,
}

/// Returns the font Ubuntu Light, which is part of a crate, so that no font has to be installed. If the font couldn't
/// be parsed, pictures would have no text.
fn font() -> Option<FontRef<'static>> {
    FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok()
}

/// Returns the ratio of the em to the height of a line. The em is SVG's font size, and the height of a line is the size
/// of a [`Label`].
fn em(font: &FontRef<'_>) -> f32 {
    font.units_per_em().unwrap_or(1000.0) / font.height_unscaled()
}

/// Returns the smallest size of labels in a picture with this resolution in dots per inch; 0 without a resolution.
pub(crate) fn smallest_size(dpi: Option<u16>) -> f64 {
    let Some(dpi) = dpi else { return 0.0 };
    font().map_or(0.0, |font| (POINTS / 72.0 * f64::from(dpi)).ceil() / f64::from(em(&font)))
}

/// Returns the width in pixels that text may take in a panel of a given width.
pub(crate) fn room(width: usize) -> f64 {
    SHARE * width as f64
}

/// Returns the distance in pixels between lines of text.
pub(crate) fn step(size: f64) -> usize {
    size.ceil() as usize
}

/// Breaks text into lines that fit into a panel of `width` pixels. Lines break between words; a word that is wider than
/// the panel is broken itself. If there are more than [`LINES`] lines, the middle of the text is left out. Without a
/// resolution in dots per inch, returns the text as a single line.
pub(crate) fn lines_of(text: &str, size: f64, width: usize, dpi: Option<u16>) -> Vec<String> {
    if dpi.is_none() {
        return vec![text.to_owned()];
    }
    let label = Label::new("", size);
    let fits = |line: &str| f64::from(label.width_of(line)) <= room(width);
    let (mut lines, mut line) = (Vec::new(), String::new());
    for word in text.split_whitespace() {
        let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
        if fits(&longer) {
            line = longer;
            continue;
        }
        lines.push(std::mem::take(&mut line));
        for c in word.chars() {
            line.push(c);
            if line.len() > c.len_utf8() && !fits(&line) {
                line.pop();
                lines.push(std::mem::replace(&mut line, c.to_string()));
            }
        }
    }
    lines.push(line);
    lines.retain(|line| !line.is_empty());
    if lines.len() > LINES {
        let end = lines.split_off(lines.len() - 1);
        lines.truncate(LINES - 1);
        if let Some(line) = lines.last_mut() {
            while !line.is_empty() && !fits(&format!("{line}\u{2026}")) {
                line.pop();
            }
            line.push('\u{2026}');
        }
        lines.extend(end);
    }
    lines
}

/// Draws lines of text centred on x, the first line with its top at y.
pub(crate) fn draw_lines(picture: &mut Image, lines: &[String], size: f64, [x, y]: [usize; 2], color: [u8; 3]) {
    for (index, line) in lines.iter().enumerate() {
        Label::new(line, size).centred(picture, x, y + index * step(size), color);
    }
}

impl<'a> Label<'a> {
    /// Creates a label; `size` is the line's height in pixels.
    pub(crate) fn new(text: &'a str, size: f64) -> Self {
        Self { text, scale: PxScale::from(size as f32), font: font() }
    }

    /// Returns the label's width in pixels.
    pub(crate) fn width(&self) -> f32 {
        self.width_of(self.text)
    }

    /// Returns the width in pixels of a string in the label's font and size.
    fn width_of(&self, text: &str) -> f32 {
        let Some(font) = &self.font else { return 0.0 };
        let font = font.as_scaled(self.scale);
        text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
    }

    /// Draws the label centred on x, with its top at y.
    pub(crate) fn centred(&self, picture: &mut Image, x: usize, y: usize, color: [u8; 3]) {
        self.put(picture, "middle", [x, y], color);
    }

    /// Draws the label with its left end at x and its top at y.
    pub(crate) fn starting(&self, picture: &mut Image, x: usize, y: usize, color: [u8; 3]) {
        self.put(picture, "start", [x, y], color);
    }

    /// Draws the label with its right end at x and its top at y.
    pub(crate) fn ending(&self, picture: &mut Image, x: usize, y: usize, color: [u8; 3]) {
        self.put(picture, "end", [x, y], color);
    }

    /// Draws the label, or stores it if the picture stores its text.
    fn put(&self, picture: &mut Image, anchor: &'static str, at: [usize; 2], color: [u8; 3]) {
        let ([x, y], Some(font)) = (at.map(|x| x as f32), &self.font) else { return };
        if let Some(texts) = picture.texts.as_mut() {
            if !self.text.is_empty() {
                let (at, size) = ([x, y + font.as_scaled(self.scale).ascent()], self.scale.y * em(font));
                texts.push(Text { text: self.text.to_owned(), at, anchor, size, color });
            }
            return;
        }
        let left = match anchor {
            "middle" => x - self.width() / 2.0,
            "end" => x - self.width(),
            _ => x,
        };
        self.draw(picture, left, y, color);
    }

    fn draw(&self, picture: &mut Image, x: f32, y: f32, color: [u8; 3]) {
        let Some(font) = &self.font else { return };
        let scaled = font.as_scaled(self.scale);
        let mut pen = point(x, y + scaled.ascent());
        for c in self.text.chars() {
            let glyph = scaled.glyph_id(c).with_scale_and_position(self.scale, pen);
            pen.x += scaled.h_advance(glyph.id);
            let Some(outline) = font.outline_glyph(glyph) else {
                continue;
            };
            let corner = outline.px_bounds().min;
            outline.draw(|dx, dy, coverage| {
                let (px, py) = (corner.x + dx as f32, corner.y + dy as f32);
                if px >= 0.0 && py >= 0.0 {
                    picture.blend(px as usize, py as usize, color, coverage.into());
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_break_between_words_and_lose_at_most_the_middle() {
        let lines = |text: &str| lines_of(text, 34.0, 354, Some(300));
        assert_eq!(lines("statistic, from -x"), ["statistic, from -x"]);
        let label = lines("statistic, clipped: 102 of 10242 beyond");
        assert_eq!((label.len(), label.join(" ").as_str()), (2, "statistic, clipped: 102 of 10242 beyond"));
        let name = "sub-0123_ses-02_hemi-L_surf-white";
        assert_eq!((lines(name).len(), lines(name).concat().as_str()), (2, name));
        let long = lines(&format!("{}end", "word ".repeat(60)));
        assert_eq!(long.len(), LINES);
        assert!(long[0].starts_with("word word") && long[LINES - 2].ends_with('\u{2026}'), "{long:?}");
        assert!(long[LINES - 1].ends_with("end"), "{long:?}");
        assert!(long.iter().all(|line| f64::from(Label::new(line, 34.0).width()) <= room(354)), "{long:?}");
        assert_eq!(lines_of("a  b", 34.0, 5, None), ["a  b"], "one line without a resolution");
    }
}
