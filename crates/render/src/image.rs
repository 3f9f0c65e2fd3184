//! Defines images, and writes them as PNG files.

use std::io::{self, Write};
use std::path::Path;

use color_quant::NeuQuant;
use spharm_surface::io::{Output, WriteOptions, check_output, write_new};

use crate::RenderError;

/// A picture in RGB colours.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Colours of the pixels, (height, width), row-major from the upper left: red, green and blue (sRGB).
    pub pixels: Vec<[u8; 3]>,
    /// Resolution in dots per inch, which determines the picture's size on paper.
    pub(crate) dpi: Option<u16>,
    /// Lines of text that are stored instead of drawn; `None` if text is drawn.
    pub(crate) texts: Option<Vec<Text>>,
}

/// A line of text in a picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Text {
    pub(crate) text: String,
    /// Position of the anchor on the baseline, in pixels.
    pub(crate) at: [f32; 2],
    /// Value of SVG's `text-anchor`: `start`, `middle` or `end`.
    pub(crate) anchor: &'static str,
    /// Font size in pixels.
    pub(crate) size: f32,
    pub(crate) color: [u8; 3],
}

impl Image {
    pub(crate) fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![color; width * height], dpi: None, texts: None }
    }

    fn index(&self, x: usize, y: usize) -> Option<usize> {
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    /// Returns the colour of a pixel; black for a position outside of the image.
    pub(crate) fn get(&self, x: usize, y: usize) -> [u8; 3] {
        self.index(x, y).map_or([0; 3], |i| self.pixels[i])
    }

    /// Sets the colour of a pixel; a position outside of the image is ignored.
    pub(crate) fn set(&mut self, x: usize, y: usize, color: [u8; 3]) {
        if let Some(i) = self.index(x, y) {
            self.pixels[i] = color;
        }
    }

    /// Blends a colour over a pixel, with `coverage` from 0 to 1.
    pub(crate) fn blend(&mut self, x: usize, y: usize, color: [u8; 3], coverage: f64) {
        let below = self.get(x, y);
        let mixed = std::array::from_fn(|i| {
            let (a, b) = (f64::from(below[i]), f64::from(color[i]));
            (a + coverage.clamp(0.0, 1.0) * (b - a)).round() as u8
        });
        self.set(x, y, mixed);
    }
}

/// Writes a picture as a PNG file, atomically. The name must end in `.png`.
///
/// # Errors
///
/// The errors of [`check_output`] and [`write_new`].
pub fn write_png(path: impl AsRef<Path>, image: &Image, options: &WriteOptions) -> Result<(), RenderError> {
    let path = path.as_ref();
    check_output(path, Output::Ending(&[".png"]))?;
    Ok(write_new(path, options.overwrite, |out| encode_png(image, out))?)
}

/// Number of colours of a thumbnail.
const THUMBNAIL_COLOURS: usize = 64;

/// Writes a picture as a PNG file with 64 colours, atomically. The file is about a third of the size of a file written
/// by [`write_png`]. The name must end in `.png`.
///
/// # Errors
///
/// The errors of [`check_output`] and [`write_new`].
pub fn write_thumbnail(path: impl AsRef<Path>, image: &Image, options: &WriteOptions) -> Result<(), RenderError> {
    let path = path.as_ref();
    check_output(path, Output::Ending(&[".png"]))?;
    let rgba: Vec<u8> = image.pixels.iter().flat_map(|[red, green, blue]| [*red, *green, *blue, 255]).collect();
    let quantised = NeuQuant::new(1, THUMBNAIL_COLOURS, &rgba);
    let indices: Vec<u8> = rgba.chunks_exact(4).map(|pixel| quantised.index_of(pixel) as u8).collect();
    Ok(write_new(path, options.overwrite, |out| {
        let mut encoder = encoder(image, out)?;
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_palette(quantised.color_map_rgb());
        encoder.set_compression(png::Compression::High);
        encoder.set_filter(png::Filter::NoFilter);
        write_pixels(encoder, &indices)
    })?)
}

/// Encodes a picture as PNG, and writes the bytes to `out`.
///
/// # Errors
///
/// An error if `out` fails, or if the picture has more than 2^32 - 1 pixels on a side.
pub fn encode_png(image: &Image, out: &mut dyn Write) -> io::Result<()> {
    let mut encoder = encoder(image, out)?;
    encoder.set_pixel_dims(image.dpi.map(|dpi| {
        let per_metre = (f64::from(dpi) / 0.0254).round() as u32;
        png::PixelDimensions { xppu: per_metre, yppu: per_metre, unit: png::Unit::Meter }
    }));
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    write_pixels(encoder, image.pixels.as_flattened())
}

/// Returns an encoder for pictures of this size, with eight bits per value.
fn encoder<'a>(image: &Image, out: &'a mut dyn Write) -> io::Result<png::Encoder<'a, &'a mut dyn Write>> {
    let size = |n: usize| u32::try_from(n).map_err(io::Error::other);
    let mut encoder = png::Encoder::new(out, size(image.width)?, size(image.height)?);
    encoder.set_depth(png::BitDepth::Eight);
    Ok(encoder)
}

fn write_pixels(encoder: png::Encoder<'_, &mut dyn Write>, values: &[u8]) -> io::Result<()> {
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(values).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)
}
