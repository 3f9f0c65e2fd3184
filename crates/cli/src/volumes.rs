//! Defines the arguments for reading volumes and for the surface of a label.

use clap::Args;
use spharm::parametrize::volume::{AxisOrder, ImageChoice, LabelSurface, VolumeReading, VoxelValues};

use crate::Usage;
use crate::surfaces::VoxelSize;

/// Arguments for reading volumes.
#[derive(Debug, Clone, Copy, Args)]
pub struct VolumeArgs {
    /// Size of a volume's voxels, in place of the size in its file
    ///
    /// Needed for arrays, and for TIFF stacks without OME-XML or ImageJ's spacing.
    #[arg(long, value_name = "X,Y,Z", hide_short_help = true)]
    pub voxel_size: Option<VoxelSize>,
    /// Order of the axes of NumPy files: xyz, or zyx for images from scikit-image, tifffile and napari
    ///
    /// NIfTI, FreeSurfer, NRRD and TIFF files have a fixed order of axes, so zyx is refused for them. --voxel-size is
    /// X,Y,Z for both orders.
    #[arg(long, value_name = "xyz|zyx", default_value = "xyz", value_parser = axes, hide_short_help = true)]
    pub axes: AxisOrder,
    /// Read grey values: the body consists of the voxels with values of LEVEL or more
    ///
    /// The surface runs where linear interpolation between voxels reaches LEVEL, and has no detail smaller than a
    /// voxel. Voxels with the value NaN are outside. The body has label 1; --fix keeps its largest piece.
    #[arg(long, value_name = "LEVEL", allow_negative_numbers = true, value_parser = finite, hide_short_help = true)]
    pub threshold: Option<f64>,
    /// Read values from 0 to 1: probabilities, or the share of each voxel that is inside the body
    ///
    /// The body consists of the voxels with values of 0.5 or more. The volume inside the surface equals the sum of the
    /// probabilities of the voxels along the border, plus the voxels farther inside.
    #[arg(long, conflicts_with = "threshold", hide_short_help = true)]
    pub probability: bool,
    /// Channel to read, counted from 1, if the file has several channels
    #[arg(long, value_name = "N", value_parser = number, hide_short_help = true)]
    pub channel: Option<usize>,
    /// Time point to read, counted from 1, if the file has several time points
    #[arg(long, value_name = "N", value_parser = number, hide_short_help = true)]
    pub time: Option<usize>,
    /// Largest distance in voxels between a smooth surface and the voxels' faces, 0.25 to 4 [default: 0.5]
    ///
    /// Larger radii remove ridges between slices that were outlined one by one, and other detail of this size. The
    /// volume doesn't change.
    #[arg(long, value_name = "VOXELS", value_parser = radius, hide_short_help = true)]
    pub smooth_radius: Option<f64>,
}

impl VolumeArgs {
    /// Returns these arguments as the library's settings for reading volumes.
    #[must_use]
    pub fn reading(&self) -> VolumeReading {
        let values = VoxelValues::of(self.threshold, self.probability);
        let image = ImageChoice { channel: self.channel, time: self.time };
        VolumeReading { voxel_size: self.voxel_size.map(|size| size.0), values, image, axes: self.axes }
    }
}

/// Arguments for the surface of a label.
#[derive(Debug, Clone, Args)]
pub struct LabelSurfaceArgs {
    /// Surface of a label: smooth, or with the steps of the voxels
    ///
    /// smooth: the surface of least bending within --smooth-radius of the voxels' faces, with the same volume as the
    /// voxels. voxels: the outer faces of the voxels; the area of a model then grows with its degree.
    #[arg(
        long,
        value_name = "smooth|voxels",
        default_value = "smooth",
        value_parser = ["smooth", "voxels"],
        hide_possible_values = true,
        hide_short_help = true
    )]
    pub label_surface: String,
}

impl LabelSurfaceArgs {
    /// Returns these arguments as the library's setting for the surface of a label.
    ///
    /// # Errors
    ///
    /// [`Usage`] if a smoothing radius is given for a surface that isn't smooth.
    pub fn surface(&self, volume: &VolumeArgs) -> Result<LabelSurface, Usage> {
        LabelSurface::named(&self.label_surface, volume.smooth_radius)
            .map_err(|_| Usage::conflict("--smooth-radius can only be used with --label-surface smooth"))
    }
}

/// Parses a radius of smoothing, in voxels.
fn radius(text: &str) -> Result<f64, String> {
    let radius = finite(text)?;
    LabelSurface::named("smooth", Some(radius)).map(|_| radius).map_err(|_| "expected 0.25 to 4 voxels".to_owned())
}

/// Parses an order of axes.
fn axes(text: &str) -> Result<AxisOrder, String> {
    AxisOrder::named(text).map_err(|_| "expected xyz or zyx".to_owned())
}

/// Parses a whole number of at least 1.
fn number(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|number| *number > 0).ok_or_else(|| "expected a whole number of at least 1".to_owned())
}

fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| "expected a number".to_owned())
}
