//! Arguments of `compare`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;
use spharm_surface::metrics::SurfaceDistanceParams;

/// Measure the distance of a reconstruction from the original surface
///
/// Prints the mean and the maximal squared distance between corresponding vertices (msd, xsd). Each is given in the
/// input's unit, and for surfaces scaled so that the original's bounding box has volume 1 (Shen and Chung 2006, section
/// 4.2). With --surface-distance, also prints the distances between nearest points of the surfaces, for which the
/// triangles may differ. A model in place of a mesh is evaluated at 163,842 vertices, and always compared by surface
/// distance. Two models whose surfaces were mapped separately are compared by surface distance alone.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm compare bunny.ply bunny60.ply",
        "spharm compare bunny.ply lod.ply --surface-distance --json",
        "spharm compare bunny.ply bunny.spharm.npz",
        "spharm compare bunny.ply bunny60.ply -o error.glb --range 0.5",
        "spharm compare lh.white lh.white60.gii --mask label/lh.cortex.label",
    ],
    &[help::MESHES],
))]
pub(crate) struct Cli {
    /// The original surface, or a model
    pub(super) original: PathBuf,
    /// The reconstruction of the original surface, or a model
    ///
    /// A mesh must have the same triangles as the original, unless --surface-distance is given.
    pub(super) reconstruction: PathBuf,
    /// Also measure the distance between the surfaces
    ///
    /// Mean, root mean square, 95th percentile and Hausdorff distance, measured from points spread over both surfaces.
    #[arg(long, help_heading = METHOD)]
    pub(super) surface_distance: bool,
    /// File that selects the vertices of the original to compare: one value per vertex, nonzero at the vertices to
    /// compare, or a FreeSurfer label
    ///
    /// The reconstruction must have the same triangles as the original. With --surface-distance, points are placed on
    /// the triangles whose three corners are selected. Their distances are measured to the complete other surface.
    #[arg(long, value_name = "FILE", help_heading = METHOD)]
    pub(super) mask: Option<PathBuf>,
    /// Approximate number of points on each surface in addition to its vertices, with --surface-distance
    ///
    /// The points are spread evenly.
    #[arg(long, value_name = "COUNT", default_value_t = SurfaceDistanceParams::default().samples, help_heading = METHOD)]
    pub(super) samples: usize,
    /// Write the reconstruction coloured by distance
    ///
    /// Files .ply and .glb contain the reconstruction with the distances as values and as colours, .vtk and .vtp the
    /// reconstruction with the distances as values, .shape.gii and .func.gii only the values. Distances are measured to
    /// the corresponding vertex or, with --surface-distance, to the original surface.
    #[arg(short, long, value_name = "OUT.glb", help_heading = OUTPUT)]
    pub(super) output: Option<PathBuf>,
    /// Distance at the upper end of the colour scale [default: the largest distance]
    ///
    /// In the input's unit.
    #[arg(long, value_name = "DISTANCE", help_heading = OUTPUT)]
    pub(super) range: Option<f64>,
    /// Write the distances to a JSON file
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    pub(super) report: Option<PathBuf>,
    /// Print JSON in place of the table
    #[arg(long, help_heading = OUTPUT)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}
