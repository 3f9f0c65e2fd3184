//! Arguments of `parametrize`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::names::NameTemplate;
use spharm_cli::surfaces::Labels;
use spharm_cli::threads::Threads;
use spharm_cli::values::{percent, voxels};
use spharm_cli::volumes::{LabelSurfaceArgs, VolumeArgs};
use spharm_parametrize::Sampling;

/// Map closed surfaces onto the sphere, one to one, for fits
///
/// The sphere has radius 1, a vertex for each vertex of the surface, and the same triangles. With every method, an
/// exact test checks that no triangle of the sphere is flipped or degenerate. If this test fails, the verb fails
/// without writing a file.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm parametrize bunny.ply -o bunny.sphere.surf.gii",
        "spharm parametrize cells.nii.gz --label all --fix -o spheres",
        "spharm parametrize torus.ply --cut-handles -o torus.sphere.surf.gii",
        "spharm parametrize s*.ply --resample-to icosphere:6 -o spheres --surface-output surfaces",
    ],
    &[help::MESHES, help::VOLUMES],
))]
pub(crate) struct Cli {
    /// Surfaces: closed meshes of genus zero, or label volumes
    ///
    /// In a label volume, the surface around the label is used. @LIST reads the paths from the file LIST, one per
    /// line.
    #[arg(value_name = "MESH_OR_VOLUME", required_unless_present = "surface", help_heading = INPUT)]
    pub(super) files: Vec<PathBuf>,
    /// Another way to give MESH_OR_VOLUME
    #[arg(long, alias = "input", value_name = "MESH_OR_VOLUME", num_args = 1.., help_heading = INPUT)]
    pub(super) surface: Vec<PathBuf>,
    /// Labels of a volume, or all; only needed if the volume has several labels
    #[arg(long, value_name = "N|all", num_args = 1.., allow_negative_numbers = true, help_heading = INPUT)]
    pub(super) label: Vec<Labels>,
    /// Repair labels and meshes instead of refusing them
    ///
    /// For a label, this option keeps the largest piece, fills cavities and removes handles. For a mesh, it welds
    /// coincident vertices, drops repeated and degenerate triangles, fins, unused vertices and all pieces except the
    /// largest, orients all triangles outwards, separates parts that touch, and fills holes of up to 500 edges. Large
    /// holes are filled by surfaces of least bending. The repaired mesh is written to --surface-output.
    #[arg(long, group = "mending", help_heading = INPUT)]
    pub(super) fix: bool,
    /// Raise the limits of --fix and --wrap to this percentage of a mesh's area
    ///
    /// The default limits, in per cent, are 5 for the area lost by welding, 5 for dropped pieces, 25 for filled holes,
    /// 5 for parts that --wrap leaves out, and 25 for the part of the wrap that spans holes.
    #[arg(long, value_name = "PERCENT", requires = "mending", value_parser = percent, hide_short_help = true, help_heading = INPUT)]
    pub(super) largest_repair: Option<f64>,
    /// Replace each mesh by the closed surface around it, computed on a grid with this number of voxels along the
    /// longest side
    ///
    /// Use this option for meshes that --fix can't close: meshes with double walls, meshes that intersect themselves,
    /// and meshes whose parts overlap, lie inside each other or lack large pieces. The closed surface, the wrap, spans
    /// holes and has no handles. Vertices of the wrap within a voxel of the mesh are moved onto the mesh. Walls and
    /// gaps thinner than a voxel are lost. An open sheet is refused. A wrap is also refused if it leaves out more than
    /// 5 % of the mesh, or if more than 25 % of its area spans holes. 128 voxels suit most meshes. The range is 16 to
    /// 512 voxels. The wrap is written to --surface-output.
    #[arg(long, value_name = "VOXELS", group = "mending", conflicts_with_all = ["fix", "cut_handles"], value_parser = voxels, hide_short_help = true, help_heading = INPUT)]
    pub(super) wrap: Option<usize>,
    #[command(flatten, next_help_heading = INPUT)]
    pub(super) label_surface: LabelSurfaceArgs,
    #[command(flatten, next_help_heading = INPUT)]
    pub(super) volume: VolumeArgs,
    /// Cut the handles of surfaces along short loops, and fill both sides of each cut
    ///
    /// The cut surface is mapped, and written to --surface-output. The cut surface consists of the input's vertices and
    /// triangles in their original order, copies of the vertices on the seams, and the fillings. If the sphere is a
    /// GIfTI file, it stores the location of the seams, and models over this sphere can restore the original surface.
    #[arg(long, help_heading = INPUT)]
    pub(super) cut_handles: bool,
    /// Method of parameterisation
    #[arg(long, value_enum, default_value_t = MethodName::Auto, help_heading = METHOD)]
    pub(super) method: MethodName,
    /// Allowed area distortion, from 0 to 1 (cald) [default: 0.1]
    ///
    /// The distortion is the root mean square of the logarithm of the area ratio. Areas are distorted by at most the
    /// given amount to preserve shape and to adapt to the residual of a model. 0 keeps areas as equal as possible. 0.25
    /// suits a map that is used only for a fit.
    #[arg(long, value_name = "RMS", help_heading = METHOD)]
    pub(super) area: Option<f64>,
    /// Degree of the model whose residual the areas adapt to (cald)
    ///
    /// The degree is limited so that the model has at most two thirds as many functions as the surface has vertices.
    /// Below degree 2, the areas don't adapt. [default: the degree with half as many functions as vertices, at most
    /// 100]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    /// Resample the surface at the vertices of another sphere: icosphere:N or a file
    ///
    /// With this option, the other sphere is written to --output.
    #[arg(long, value_name = "icosphere:N|SPHERE", conflicts_with = "subdivisions", help_heading = METHOD)]
    pub(super) resample_to: Option<Sampling>,
    /// Subdivisions of the icosphere from which deform starts
    ///
    /// The default is the smallest number, at most 7, that gives at least as many vertices as the surface has.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=10), help_heading = METHOD)]
    pub(super) subdivisions: Option<u32>,
    /// Seed of the sphere's initial rotation
    ///
    /// Different seeds give different maps of the same quality.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = METHOD)]
    pub(super) seed: u64,
    /// Sphere to write; for several surfaces, a folder for files NAME.sphere.surf.gii
    ///
    /// The name determines the format (.surf.gii, .ply, .obj, ...). Positions have 64 bits if the format supports them.
    #[arg(short, long, value_name = "SPHERE", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Surface to write, with the same triangles as the sphere; for several surfaces, a folder
    ///
    /// The mapped surface differs from the input for volumes, with --method deform, and with --resample-to, --fix,
    /// --wrap and --cut-handles. In these cases, the mapped surface is by default written next to the sphere:
    /// NAME.surf.gii for NAME.sphere.surf.gii.
    #[arg(long, value_name = "MESH", help_heading = OUTPUT)]
    pub(super) surface_output: Option<PathBuf>,
    /// Template for the names of several outputs
    ///
    /// Placeholders are replaced by parts of each input's path, after links have been resolved: {stem} is the file's
    /// name without folder and format, {label} the label in a volume, {parent} the folder that contains the file,
    /// {parent2} the folder above {parent}.
    #[arg(long, value_name = "TEMPLATE", default_value = "{stem}", help_heading = OUTPUT)]
    pub(super) name_template: NameTemplate,
    /// Write a report to a JSON file
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON in place of the tables
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

impl Cli {
    /// Returns the paths given as positional arguments and by --surface.
    pub(super) fn paths(&self) -> Vec<PathBuf> {
        [&self.files[..], &self.surface].concat()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum MethodName {
    /// cald for meshes, equal-area for volumes; stretch if the first method fails
    Auto,
    /// Equal areas, with little length distortion (Shen and Makedon 2006)
    Cald,
    /// Equal areas, for volumes of voxels (Brechbuehler, Gerig and Kuebler 1995)
    EqualArea,
    /// Least angle distortion (Gu et al. 2004)
    Conformal,
    /// Least stretch (Praun and Hoppe 2003)
    Stretch,
    /// An icosphere deformed onto the surface (Chung and Robbins)
    Deform,
}
