//! Draws pictures of meshes with a small z-buffer renderer that needs no window or graphics card.
//!
//! [`render`] draws panels, each a mesh with a caption, in a grid with an orthographic camera, and [`write_png`] saves
//! the picture. [`render_curves`] draws curves with bands.
//!
//! ```
//! use spharm_surface::generate::icosphere;
//! use spharm_render::{Paint, Panel, Settings, render};
//!
//! let ball = icosphere(4);
//! let height: Vec<f64> = ball.vertices.iter().map(|v| v[2]).collect();
//! let paint = Paint::Scalar { values: &height, range: (-1.0, 1.0), label: "height" };
//! let settings = Settings { width: 120, height: 120, ..Settings::default() };
//! let picture = render(&[Panel::new(&ball, "a ball"), Panel { paint, ..Panel::new(&ball, "z") }], &settings)?;
//! assert_eq!(picture.width, 2 * 120);
//! # Ok::<(), spharm_render::RenderError>(())
//! ```

#![forbid(unsafe_code)]

mod animation;
mod bar;
mod camera;
mod curves;
mod error;
mod image;
mod layout;
mod raster;
mod scale;
mod svg;
mod text;

use spharm_surface::Mesh;
use spharm_surface::metrics::{colors_by, diverging, viridis};

pub use animation::{render_frames, write_gif};
use bar::Bar;
use camera::Camera;
pub use camera::View;
pub use curves::{Curve, CurvePanel, render_curves};
pub use error::RenderError;
pub use image::{Image, encode_png, write_png, write_thumbnail};
use layout::Layout;
use raster::Raster;
pub use scale::{fit_into, is_probability, scale_label, significance, symmetric_range};
pub use svg::write_svg;
use text::{draw_lines, lines_of, smallest_size, step};

/// Colours of a mesh.
#[derive(Clone, Copy, Debug)]
pub enum Paint<'a> {
    /// One colour (sRGB) for the whole mesh.
    Plain([u8; 3]),
    /// One value per vertex, with a colour bar beneath the mesh. Values are mapped to colours by [`diverging`] if the
    /// range is symmetric about 0, otherwise by [`viridis`].
    Scalar {
        /// One value per vertex.
        values: &'a [f64],
        /// Values at the ends of the colour bar.
        range: (f64, f64),
        /// Label of the colour bar.
        label: &'a str,
    },
    /// One colour per vertex (sRGB), without a colour bar.
    Vertices(&'a [[u8; 3]]),
}

/// A mesh in a picture.
#[derive(Clone, Copy, Debug)]
pub struct Panel<'a> {
    /// Mesh of the panel.
    pub mesh: &'a Mesh,
    /// Text beneath the mesh; may be empty.
    pub caption: &'a str,
    /// Colours of the mesh.
    pub paint: Paint<'a>,
    /// Position of the camera for this panel. `None` means the position in [`Settings`].
    pub view: Option<View>,
    /// Contour of a map on the mesh, if any.
    pub contour: Option<Contour<'a>>,
}

/// Line on a mesh along which a map, linear on each triangle, has a given value.
#[derive(Clone, Copy, Debug)]
pub struct Contour<'a> {
    /// Values of the map, one per vertex. The contour line has gaps in triangles with a NaN value.
    pub values: &'a [f64],
    /// Value of the map along the line.
    pub level: f64,
}

impl<'a> Panel<'a> {
    /// Returns a panel with the mesh in a plain warm grey.
    #[must_use]
    pub fn new(mesh: &'a Mesh, caption: &'a str) -> Self {
        Self { mesh, caption, paint: Paint::Plain([222, 208, 196]), view: None, contour: None }
    }
}

/// Layout and camera of a picture, common to all panels.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Width of a panel in pixels.
    pub width: usize,
    /// Height of a panel in pixels, including caption and colour bar. With `dpi`, panels are higher if text of 7 pt
    /// needs more room.
    pub height: usize,
    /// Number of panels per row; 0 for a single row.
    pub columns: usize,
    /// Position of the camera.
    pub view: View,
    /// Whether all meshes, in all views, are drawn at one scale around one centre, so that they can be compared.
    /// Otherwise each mesh fills its panel.
    pub common_scale: bool,
    /// Lowest and highest corner of the box that each panel shows; by default the bounding box of the meshes.
    pub frame: Option<[[f64; 3]; 2]>,
    /// Whether text is stored for [`write_svg`] instead of drawn. Default false.
    pub keep_text: bool,
    /// Resolution in dots per inch, which determines the picture's size on paper. Text is then at least 7 pt high, and
    /// is broken into lines if it is wider than its panel. Default none.
    pub dpi: Option<u16>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            width: 480,
            height: 480,
            columns: 0,
            view: View::LEFT,
            common_scale: true,
            frame: None,
            keep_text: false,
            dpi: None,
        }
    }
}

/// Maximum width and height of a picture in pixels.
const LARGEST: usize = 1 << 14;
const BACKGROUND: [u8; 3] = [255; 3];
const INK: [u8; 3] = [40; 3];

impl Settings {
    /// Returns the number of bytes that [`render`] and [`encode_png`] use for `panels` panels with meshes of at most
    /// `vertices` vertices, including the picture.
    ///
    /// The number is a sum. Each pixel of the picture takes 3 bytes, 3 more for the compressed copy, and 4 more if this
    /// copy is embedded as text in an SVG. Each pixel of one panel takes 80 bytes, because panels are drawn one after
    /// another, in linear light, at twice the resolution and with their depth. Each vertex of a panel's mesh takes 128
    /// bytes. With a resolution in dots per inch, labels and captions are assumed to be of maximum length.
    #[must_use]
    pub fn bytes(&self, panels: usize, vertices: usize) -> u64 {
        const BYTES_PER_VERTEX: u64 = 128;
        let columns = if self.columns == 0 { panels } else { self.columns.min(panels) };
        // An incomplete last row takes as much memory as a complete one.
        let places = columns as u64 * panels.div_ceil(columns.max(1)) as u64;
        let pixels = |height: usize| (self.width as u64).saturating_mul(height as u64);
        let stored = if self.keep_text { 10 } else { 6 };
        let picture = pixels(Layout::highest(self).panel_height).saturating_mul(stored * places);
        let panel = pixels(self.height).saturating_mul(raster::BYTES_PER_PIXEL);
        picture.saturating_add(panel).saturating_add(BYTES_PER_VERTEX * vertices as u64)
    }
}

/// Draws the panels row by row on a white background.
///
/// # Errors
///
/// [`RenderError`] if there are no panels, the picture has fewer than 16 or more than 16,384 pixels on a side, the
/// number of values or colours differs from the mesh's number of vertices, or a range isn't finite.
pub fn render(panels: &[Panel<'_>], settings: &Settings) -> Result<Image, RenderError> {
    check(panels, settings)?;
    let columns = match settings.columns {
        0 => panels.len(),
        n => n.min(panels.len()),
    };
    let rows = panels.len().div_ceil(columns);
    let Layout { type_size, line, mesh_height, bar_height, panel_height } = Layout::of(panels, settings);
    let (width, height) = (columns * settings.width, rows * panel_height);
    if [width, height].iter().any(|side| !(16..=LARGEST).contains(side)) {
        return Err(RenderError::Size { width, height });
    }

    let mut picture = Image::filled(width, height, BACKGROUND);
    (picture.dpi, picture.texts) = (settings.dpi, settings.keep_text.then(Vec::new));
    // Panels often show one mesh from several sides, or several meshes from one side. Therefore each mesh is listed
    // only once, and, with a common scale or frame, panels with the same view share a camera. The view with the largest
    // extent then determines the scale of all views.
    let mut meshes: Vec<&Mesh> = Vec::new();
    for panel in panels {
        if !meshes.iter().any(|mesh| std::ptr::eq(*mesh, panel.mesh)) {
            meshes.push(panel.mesh);
        }
    }
    let view_of = |panel: &Panel<'_>| panel.view.unwrap_or(settings.view);
    let framing = |view: View| match settings.frame {
        Some(corners) => Camera::framing(view, &box_corners(corners), settings.width, mesh_height),
        None => {
            let points = meshes.iter().flat_map(|mesh| &mesh.vertices);
            Camera::framing(view, points, settings.width, mesh_height)
        }
    };
    let mut common: Vec<(View, Camera)> = Vec::new();
    if settings.common_scale || settings.frame.is_some() {
        for view in panels.iter().map(view_of) {
            if common.iter().all(|(of, _)| *of != view) {
                common.push((view, framing(view)));
            }
        }
        let zoom = common.iter().map(|(_, camera)| camera.zoom).fold(f64::INFINITY, f64::min);
        common.iter_mut().for_each(|(_, camera)| camera.zoom = zoom);
    }
    for (i, panel) in panels.iter().enumerate() {
        let (x, y) = ((i % columns) * settings.width, (i / columns) * panel_height);
        let view = view_of(panel);
        let camera = match common.iter().find(|(of, _)| *of == view) {
            Some((_, camera)) => *camera,
            None => Camera::framing(view, &panel.mesh.vertices, settings.width, mesh_height),
        };
        let painted = match panel.paint {
            Paint::Plain(color) => vec![color; panel.mesh.vertices.len()],
            Paint::Scalar { values, range, .. } => colors_by(map_of(range), values, range.0, range.1),
            Paint::Vertices(colors) => colors.to_vec(),
        };
        let mut raster = Raster::new(settings.width, mesh_height);
        raster.draw(panel.mesh, &painted, panel.contour, &camera);
        raster.paint_on(&mut picture, x, y);
        if let Some(bar) = Bar::of(panel, settings.width, line, settings.dpi) {
            bar.draw(&mut picture, x, y + mesh_height);
        }
        let caption = lines_of(panel.caption, type_size, settings.width, settings.dpi);
        let at = [x + settings.width / 2, y + mesh_height + bar_height];
        draw_lines(&mut picture, &caption, type_size, at, INK);
    }
    Ok(picture)
}

/// Returns the colour with which [`Paint::Scalar`] draws a value in a range.
#[must_use]
pub fn color_of(value: f64, range: (f64, f64)) -> [u8; 3] {
    colors_by(map_of(range), &[value], range.0, range.1)[0]
}

/// Returns a picture with a single colour bar for all panels beneath it.
#[must_use]
pub fn with_bar(picture: Image, range: (f64, f64), label: &str) -> Image {
    let line = line_of(&picture);
    let (width, length) = (picture.width, picture.width.min(24 * line));
    let bar = Bar::new(range, label, length, line, picture.dpi);
    let height = Bar::height(line, bar.lines(), picture.dpi);
    let (mut picture, top) = extended(picture, line / 2 + height);
    bar.draw(&mut picture, (width - length) / 2, top + line / 4);
    picture
}

/// Returns a picture with a line of text beneath it.
#[must_use]
pub fn with_note(picture: Image, note: &str) -> Image {
    let line = line_of(&picture);
    let size = 0.7 * line as f64;
    let lines = lines_of(note, size, picture.width, picture.dpi);
    let (mut picture, top) = extended(picture, 5 * line / 4 + lines.len().saturating_sub(1) * step(size));
    let middle = picture.width / 2;
    draw_lines(&mut picture, &lines, size, [middle, top + line / 4], INK);
    picture
}

/// Returns the height in pixels of a line of text that is added beneath the panels of a picture.
fn line_of(picture: &Image) -> usize {
    // The smallest text has 0.6 of a line's height.
    (picture.width / 40).clamp(14, 40).max((smallest_size(picture.dpi) / 0.6).ceil() as usize)
}

/// Extends a picture by `more` rows of background at the bottom. Also returns the index of the first new row.
fn extended(mut picture: Image, more: usize) -> (Image, usize) {
    let top = picture.height;
    picture.height += more;
    picture.pixels.resize(picture.width * picture.height, BACKGROUND);
    (picture, top)
}

/// Returns the colour map for values in a range.
fn map_of((low, high): (f64, f64)) -> fn(f64) -> [u8; 3] {
    if low < 0.0 && low == -high { diverging } else { viridis }
}

/// Returns the eight corners of a box.
fn box_corners([low, high]: [[f64; 3]; 2]) -> [[f64; 3]; 8] {
    std::array::from_fn(|corner| {
        std::array::from_fn(|axis| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] })
    })
}

fn check(panels: &[Panel<'_>], settings: &Settings) -> Result<(), RenderError> {
    if panels.is_empty() {
        return Err(RenderError::NoPanels);
    }
    // Width and height are limited first, so that their products with the numbers of panels can't overflow.
    if settings.width > LARGEST || settings.height > LARGEST {
        return Err(RenderError::Size { width: settings.width, height: settings.height });
    }
    for panel in panels {
        let expected = panel.mesh.vertices.len();
        if let Some(found) = panel.contour.map(|contour| contour.values.len()).filter(|found| *found != expected) {
            return Err(RenderError::ValueCount { expected, found });
        }
        let (found, range) = match panel.paint {
            Paint::Plain(_) => continue,
            Paint::Scalar { values, range, .. } => (values.len(), range),
            Paint::Vertices(colors) => (colors.len(), (0.0, 1.0)),
        };
        if found != expected {
            return Err(RenderError::ValueCount { expected, found });
        }
        if !(range.0.is_finite() && range.1.is_finite()) {
            return Err(RenderError::Range { low: range.0, high: range.1 });
        }
    }
    Ok(())
}
