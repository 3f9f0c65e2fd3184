//! Draws text in pictures.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

use crate::image::{Image, Text};

/// A line of text with a font and a size.
pub(crate) struct Label<'a> {
    text: &'a str,
    scale: PxScale,
    font: Option<FontRef<'a>>,
}

impl<'a> Label<'a> {
    /// Creates a label; `size` is the line's height in pixels.
    pub(crate) fn new(text: &'a str, size: f64) -> Self {
        Self {
            text,
            scale: PxScale::from(size as f32),
            // The font Ubuntu Light is part of a crate, so that no font has to be installed. If it couldn't be
            // parsed, pictures would have no text.
            font: FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok(),
        }
    }

    fn width(&self) -> f32 {
        let Some(font) = &self.font else { return 0.0 };
        let font = font.as_scaled(self.scale);
        self.text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
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

    /// Draws the label, or stores it as text if the picture keeps texts.
    fn put(&self, picture: &mut Image, anchor: &'static str, at: [usize; 2], color: [u8; 3]) {
        let ([x, y], Some(font)) = (at.map(|x| x as f32), &self.font) else { return };
        if let Some(texts) = picture.texts.as_mut() {
            if !self.text.is_empty() {
                // The label's scale is the height of a line, whereas SVG's font size is the size of an em.
                let em = font.units_per_em().unwrap_or(1000.0) / font.height_unscaled();
                let (at, size) = ([x, y + font.as_scaled(self.scale).ascent()], self.scale.y * em);
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
