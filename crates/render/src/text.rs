//! Draws text in pictures.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

use crate::image::Image;

/// A line of text of a given size.
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
            // Ubuntu Light comes with a crate, so that no font has to be installed. The font is valid; if parsing ever
            // failed, pictures would be drawn without text.
            font: FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok(),
        }
    }

    fn width(&self) -> f32 {
        let Some(font) = &self.font else { return 0.0 };
        let font = font.as_scaled(self.scale);
        self.text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
    }

    /// Draws the label centred on x, its top at y.
    pub(crate) fn centred(&self, picture: &mut Image, x: usize, y: usize, color: [u8; 3]) {
        self.draw(picture, x as f32 - self.width() / 2.0, y as f32, color);
    }

    /// Draws the label with its left end at x, its top at y.
    pub(crate) fn starting(&self, picture: &mut Image, x: usize, y: usize, color: [u8; 3]) {
        self.draw(picture, x as f32, y as f32, color);
    }

    /// Draws the label with its right end at x, its top at y.
    pub(crate) fn ending(&self, picture: &mut Image, x: usize, y: usize, color: [u8; 3]) {
        self.draw(picture, x as f32 - self.width(), y as f32, color);
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
