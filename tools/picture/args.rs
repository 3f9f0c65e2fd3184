//! Arguments of `picture`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_render::View;

/// Draw surfaces side by side, and show the distance between them in colour
///
/// All panels show the same region of space at the same scale. --centre and --fit-each move the surfaces into this
/// region.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm picture bunny.ply bunny60.ply --error -o bunny.png",
        "spharm picture bunny.ply bunny60.ply --sphere bunny.sphere.surf.gii -o map.png",
        "spharm picture a.ply b.ply c.ply d.ply --columns 2 --view top -o four.png",
        "spharm picture --test study/tests/group --view left right top bottom --dpi 300 -o group.svg",
        "spharm picture cells --centre --colour-by cells/volumes.tsv:sphericity --size 96 -o montage.png",
    ],
    &[help::MESHES],
))]
pub(crate) struct Cli {
    /// Surfaces, in the order of the panels: meshes or models
    ///
    /// Give files, folders (for all models in them), or @LIST for a file LIST with one path per line.
    #[arg(required_unless_present = "test", value_name = "SURFACE")]
    pub(super) surfaces: Vec<PathBuf>,
    /// Show the result of `spharm shape test` in a folder: mean, effect, statistic and p values
    ///
    /// A line separates the vertices whose p values are at most the test's level from the other vertices. The text
    /// beneath the picture states the number of vertices with such p values. The p values are family-wise, from TFCE if
    /// the test included TFCE. For a test without relabellings, false-discovery rates are shown instead.
    #[arg(
        long,
        value_name = "FOLDER",
        conflicts_with_all = ["surfaces", "sphere", "map", "contour", "contour_level", "range", "colour_by", "error"],
        help_heading = INPUT
    )]
    pub(super) test: Option<PathBuf>,
    /// Add a panel with the sphere of the first surface
    ///
    /// The panel comes after the panel of the first surface. The sphere is coloured by the logarithm of the area that
    /// the map to the sphere assigns to each part of the surface.
    #[arg(long, value_name = "SPHERE", help_heading = INPUT)]
    pub(super) sphere: Option<PathBuf>,
    /// Add a panel with the last surface coloured by its distance from the first
    ///
    /// The colours show the distance of each vertex from the corresponding vertex of the first surface or, if the
    /// triangles differ, from the nearest point of the first surface. The label of the colour scale states which
    /// distance is shown.
    #[arg(long, help_heading = OUTPUT)]
    pub(super) error: bool,
    /// For each map, add a panel with the first surface coloured by values on its vertices
    ///
    /// A map is a file of one value per vertex, such as `spharm shape measure` and `spharm shape test` write. If any
    /// value is negative, the colours are symmetric about 0, from blue to red. Values beyond twice the 99th percentile
    /// then have the colours at the ends of the scale, and the label of the scale states their number. Otherwise, the
    /// colours range from the minimum to the maximum of the values. --range overrides these ranges. For p values, in
    /// files called p, q or p-NAME, the picture shows -log10 of each value. Significant values then have the colours at
    /// the upper end of the scale.
    #[arg(long, value_name = "MAP", num_args = 1.., help_heading = INPUT)]
    pub(super) map: Vec<PathBuf>,
    /// Map whose contour line at --contour-level is drawn on the first surface and on its maps
    #[arg(long, value_name = "MAP", help_heading = INPUT)]
    pub(super) contour: Option<PathBuf>,
    /// Value along the contour [default: 0.05 for p values, in files called p, q or p-NAME]
    #[arg(long, value_name = "LEVEL", allow_negative_numbers = true, requires = "contour", help_heading = INPUT)]
    pub(super) contour_level: Option<f64>,
    /// Values at the lower and the upper end of the colour scale, for maps or for --colour-by
    #[arg(long, value_name = "LOW,HIGH", allow_hyphen_values = true, value_parser = range, help_heading = OUTPUT)]
    pub(super) range: Option<(f64, f64)>,
    /// Colour each surface by its value in a numeric column of a table, such as a table written by `spharm volumes`
    /// or `spharm shape measure`
    ///
    /// The surfaces' paths or names are in the column `model` or, if there is no such column, in the first column. A
    /// warning is given if the column contains the paths of other files with the same names.
    #[arg(long, value_name = "TABLE:COLUMN", value_parser = column, conflicts_with = "map", help_heading = INPUT)]
    pub(super) colour_by: Option<(PathBuf, String)>,
    /// Move the centres of all surfaces to the centre of the first surface
    #[arg(long, conflicts_with = "error", help_heading = OUTPUT)]
    pub(super) centre: bool,
    /// Move the centres of all surfaces to that of the first surface, and scale all surfaces to its size
    #[arg(long, conflicts_with_all = ["centre", "error"], help_heading = OUTPUT)]
    pub(super) fit_each: bool,
    /// Text beneath each panel, in order [default: the files' names]
    #[arg(long, value_name = "TEXT", help_heading = OUTPUT)]
    pub(super) caption: Vec<String>,
    /// Sides from which to look; with several, each panel becomes a row of views
    ///
    /// The sides are axes of the coordinates: left is -x, front +y, top +z, as in RAS.
    #[arg(long, value_enum, num_args = 1.., default_values_t = [Side::Left], help_heading = OUTPUT)]
    pub(super) view: Vec<Side>,
    /// Number of panels in a row [default: 0 for up to 6 panels, otherwise about as many as rows]
    ///
    /// 0 puts all panels in one row. With several sides, the default is 0, which puts the views of each surface in one
    /// row.
    #[arg(long, value_name = "N", help_heading = OUTPUT)]
    pub(super) columns: Option<usize>,
    /// Width and height of a panel in pixels
    ///
    /// With --dpi, panels are higher if their text needs more space.
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = 480,
        value_parser = clap::value_parser!(u16).range(64..=4096),
        help_heading = OUTPUT
    )]
    pub(super) size: u16,
    /// Resolution in dots per inch, which determines the picture's size on paper
    ///
    /// At 300 dpi, 1063 pixels are 90 mm. The picture's width in pixels is --size times the number of panels in a row.
    /// Text is at least 7 pt high on paper. Text that is wider than its panel is broken into lines. If a text has more
    /// than six lines, its middle is omitted.
    #[arg(long, value_name = "DPI", value_parser = clap::value_parser!(u16).range(30..=2400), help_heading = OUTPUT)]
    pub(super) dpi: Option<u16>,
    /// Picture to write
    ///
    /// In an SVG file, captions and numbers are text that can be edited, and the surfaces are an embedded PNG image.
    #[arg(short, long, value_name = "OUT.png|OUT.svg", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Replace an existing output
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) common: Common,
}

/// Parses `TABLE:COLUMN`.
fn column(text: &str) -> Result<(PathBuf, String), String> {
    match text.rsplit_once(':') {
        Some((table, column)) if !table.is_empty() && !column.is_empty() => Ok((table.into(), column.to_owned())),
        _ => Err("expected a table and a column, such as volumes.tsv:sphericity".to_owned()),
    }
}

fn range(text: &str) -> Result<(f64, f64), String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
    match numbers[..] {
        [low, high] if low < high && low.is_finite() && high.is_finite() => Ok((low, high)),
        _ => Err("expected two numbers, LOW,HIGH, the lower one first".to_owned()),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Side {
    Left,
    Right,
    Front,
    Back,
    Top,
    Bottom,
    Corner,
}

impl Side {
    /// Returns the name of the side as an axis of the coordinates, because after an alignment sides have no anatomical
    /// meaning.
    pub(super) fn axis(self) -> &'static str {
        match self {
            Self::Left => "from -x",
            Self::Right => "from +x",
            Self::Front => "from +y",
            Self::Back => "from -y",
            Self::Top => "from +z",
            Self::Bottom => "from -z",
            Self::Corner => "from a corner",
        }
    }

    pub(super) fn view(self) -> View {
        match self {
            Self::Left => View::LEFT,
            Self::Right => View::RIGHT,
            Self::Front => View::FRONT,
            Self::Back => View::BACK,
            Self::Top => View::TOP,
            Self::Bottom => View::BOTTOM,
            Self::Corner => View::CORNER,
        }
    }
}
