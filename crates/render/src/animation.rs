//! Draws a sequence of surfaces as an animated GIF.

use std::io;
use std::path::Path;

use gif::{Encoder, Frame, Repeat};
use spharm_surface::Mesh;
use spharm_surface::io::{Output, WriteOptions, check_output, write_new};

use crate::{Image, Panel, RenderError, Settings, render};

/// Draws each surface of a sequence as a picture of `settings.width` by `settings.height` pixels, all at a common
/// scale.
///
/// # Errors
///
/// The errors of [`render`].
pub fn render_frames(meshes: &[Mesh], settings: &Settings) -> Result<Vec<Image>, RenderError> {
    let panels: Vec<Panel<'_>> = meshes.iter().map(|mesh| Panel::new(mesh, "")).collect();
    let columns = (meshes.len() as f64).sqrt().ceil().max(1.0) as usize;
    let sheet = render(&panels, &Settings { columns, common_scale: true, ..*settings })?;
    let frame = |index: usize| {
        let (x, y) = (index % columns * settings.width, index / columns * settings.height);
        let mut frame = Image::filled(settings.width, settings.height, [255; 3]);
        for row in 0..settings.height {
            let from = (y + row) * sheet.width + x;
            let to = row * settings.width;
            frame.pixels[to..to + settings.width].copy_from_slice(&sheet.pixels[from..from + settings.width]);
        }
        frame
    };
    Ok((0..meshes.len()).map(frame).collect())
}

/// Writes pictures of equal size as an animated GIF that repeats endlessly. The file is written atomically. Each
/// picture is shown for `delay` hundredths of a second. The name must end in `.gif`.
///
/// # Errors
///
/// [`RenderError::NoPanels`] if there are no frames; [`RenderError::Size`] if a frame's size differs from the first
/// frame's; the errors of [`check_output`] and [`write_new`].
pub fn write_gif(
    path: impl AsRef<Path>,
    frames: &[Image],
    delay: u16,
    options: &WriteOptions,
) -> Result<(), RenderError> {
    let path = path.as_ref();
    check_output(path, Output::Ending(&[".gif"]))?;
    let Some(first) = frames.first() else { return Err(RenderError::NoPanels) };
    let (width, height) = (first.width, first.height);
    if let Some(other) = frames.iter().find(|frame| (frame.width, frame.height) != (width, height)) {
        return Err(RenderError::Size { width: other.width, height: other.height });
    }
    let side = |n: usize| u16::try_from(n).map_err(|_| RenderError::Size { width, height });
    let (columns, rows) = (side(width)?, side(height)?);
    Ok(write_new(path, options.overwrite, |out| {
        let mut encoder = Encoder::new(out, columns, rows, &[]).map_err(io::Error::other)?;
        encoder.set_repeat(Repeat::Infinite).map_err(io::Error::other)?;
        for image in frames {
            let mut frame = Frame::from_rgb_speed(columns, rows, image.pixels.as_flattened(), 10);
            frame.delay = delay;
            encoder.write_frame(&frame).map_err(io::Error::other)?;
        }
        Ok(())
    })?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_surface::generate::icosphere;

    #[test]
    fn frames_are_of_one_scale_and_return_from_the_file() {
        let sphere = icosphere(2);
        let small = sphere.with_vertices(sphere.vertices.iter().map(|p| p.map(|x| 0.5 * x)).collect());
        let settings = Settings { width: 64, height: 48, ..Settings::default() };
        let frames = render_frames(&[sphere, small], &settings).unwrap();
        let covered = |image: &Image| image.pixels.iter().filter(|pixel| **pixel != [255; 3]).count() as f64;
        let share = covered(&frames[1]) / covered(&frames[0]);
        assert!((share - 0.25).abs() < 0.05, "{share}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        write_gif(&path, &frames, 8, &WriteOptions::default()).unwrap();
        assert!(write_gif(&path, &frames, 8, &WriteOptions::default()).is_err());
        let mut read = gif::DecodeOptions::new().read_info(std::fs::File::open(&path).unwrap()).unwrap();
        assert_eq!((read.width(), read.height()), (64, 48));
        let mut count = 0;
        while let Some(frame) = read.read_next_frame().unwrap() {
            assert_eq!(frame.delay, 8);
            count += 1;
        }
        assert_eq!(count, 2);
        assert!(write_gif(folder.path().join("b.gif"), &[], 8, &WriteOptions::default()).is_err());
    }
}
