//! Writes pictures as SVG, with the meshes as an embedded PNG and with text elements that other programs can edit.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use quick_xml::escape::escape;
use spharm_surface::io::{Output, WriteOptions, check_output, write_new};

use crate::RenderError;
use crate::image::{Image, Text, encode_png};

/// Number of millimetres per inch.
const INCH: f64 = 25.4;

/// Writes a picture as an SVG file, atomically. Text becomes text elements if the picture was drawn with
/// [`Settings::keep_text`](crate::Settings::keep_text). If the picture has a resolution in dots per inch, its size is
/// given in mm. The name must end in `.svg`.
///
/// # Errors
///
/// The errors of [`check_output`] and [`write_new`].
pub fn write_svg(path: impl AsRef<Path>, image: &Image, options: &WriteOptions) -> Result<(), RenderError> {
    let path = path.as_ref();
    check_output(path, Output::Ending(&[".svg"]))?;
    Ok(write_new(path, options.overwrite, |out| {
        let (width, height) = (image.width, image.height);
        let length = |pixels: usize| match image.dpi {
            Some(dpi) => format!("{:.3}mm", pixels as f64 * INCH / f64::from(dpi)),
            None => pixels.to_string(),
        };
        let mut png = Vec::new();
        encode_png(image, &mut png)?;
        writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{}\" height=\"{}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"Ubuntu, Helvetica, Arial, sans-serif\" font-weight=\"300\">",
            length(width),
            length(height)
        )?;
        let png = STANDARD.encode(png);
        writeln!(out, "<image width=\"{width}\" height=\"{height}\" xlink:href=\"data:image/png;base64,{png}\"/>")?;
        for Text { text, at: [x, y], anchor, size, color: [red, green, blue] } in image.texts.iter().flatten() {
            let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
            writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"{size:.1}\" \
                 fill=\"#{red:02x}{green:02x}{blue:02x}\">{}</text>",
                escape(&text)
            )?;
        }
        writeln!(out, "</svg>")
    })?)
}
