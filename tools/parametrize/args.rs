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
/// exact test checks that no triangle of the sphere is flipped or degenerate. If one is, the verb fails without writing
/// a file.
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
    /// Labels: keeps the largest piece, fills cavities and removes handles. Meshes: welds coincident vertices, drops
    /// repeated and degenerate triangles, fins, unused vertices and all pieces except the largest, orients all
    /// triangles outwards, separates parts that touch, and fills holes of up to 500 edges, large ones by surfaces
    /// of least bending; the repaired mesh is written to --surface-output.
    #[arg(long, group = "mending", help_heading = INPUT)]
    pub(super) fix: bool,
    /// Raise the limits of --fix and --wrap to this percentage of a mesh's area; the usual limits are 5 for area lost
    /// by welding, 5 for dropped pieces, 25 for filled holes, 5 for parts that --wrap leaves out, and 25 for the part
    /// of the wrap that spans holes
    #[arg(long, value_name = "PERCENT", requires = "mending", value_parser = percent, hide_short_help = true, help_heading = INPUT)]
    pub(super) largest_repair: Option<f64>,
    /// Replace each mesh by the closed surface around it, computed on a grid with this number of voxels along the
    /// longest side
    ///
    /// For meshes that --fix can't close: parts that overlap, lie inside each other or lack large pieces, double walls,
    /// and surfaces that intersect themselves. Holes are spanned and handles removed; vertices within a voxel of the
    /// mesh are moved onto it. Walls and gaps thinner than a voxel are lost; a wrap that leaves out more than 5 % of
    /// the mesh, or spans holes by more than 25 % of its area, is refused, and so is an open sheet. 128 voxels suit
    /// most meshes; 16 to 512 are allowed. The new mesh is written to --surface-output.
    #[arg(long, value_name = "VOXELS", group = "mending", conflicts_with_all = ["fix", "cut_handles"], value_parser = voxels, hide_short_help = true, help_heading = INPUT)]
    pub(super) wrap: Option<usize>,
    #[command(flatten, next_help_heading = INPUT)]
    pub(super) label_surface: LabelSurfaceArgs,
    #[command(flatten, next_help_heading = INPUT)]
    pub(super) volume: VolumeArgs,
    /// Cut the handles of surfaces along short loops, and fill both sides of each cut
    ///
    /// The cut surface is mapped and written to --surface-output: the input's vertices and triangles in their original
    /// order, copies of the vertices on the seams, and the fillings. Models over the sphere can restore the original
    /// surface if the sphere is a GIfTI file, which stores the location of the seams.
    #[arg(long, help_heading = INPUT)]
    pub(super) cut_handles: bool,
    /// Method of parameterisation
    #[arg(long, value_enum, default_value_t = MethodName::Auto, help_heading = METHOD)]
    pub(super) method: MethodName,
    /// Allowed area distortion, from 0 to 1 (cald) [default: 0.1]
    ///
    /// Largest root mean square of the log area ratio. Areas may deviate from equal areas by this amount to preserve
    /// shape and to adapt to the residual of a model: 0 keeps areas as equal as possible; 0.25 suits a map that is only
    /// used for a fit.
    #[arg(long, value_name = "RMS", help_heading = METHOD)]
    pub(super) area: Option<f64>,
    /// Degree of the model whose residual the areas adapt to (cald)
    ///
    /// At most the degree that two thirds of the vertices determine. Below degree 2, the areas don't adapt. [default:
    /// the degree with half as many functions as vertices, at most 100]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    /// Resample the surface at the vertices of another sphere: icosphere:N or a file
    ///
    /// The other sphere is then written to --output.
    #[arg(long, value_name = "icosphere:N|SPHERE", conflicts_with = "subdivisions", help_heading = METHOD)]
    pub(super) resample_to: Option<Sampling>,
    /// Subdivisions of the icosphere from which deform starts
    ///
    /// The default has as many vertices as the surface, or a few more.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=10), help_heading = METHOD)]
    pub(super) subdivisions: Option<u32>,
    /// Seed of the sphere's initial rotation
    ///
    /// Other seeds give other maps of the same quality.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = METHOD)]
    pub(super) seed: u64,
    /// Sphere to write; for several surfaces, a folder for files NAME.sphere.surf.gii
    ///
    /// The name determines the format (.surf.gii, .ply, .obj, ...). Positions have 64 bits if the format supports them.
    #[arg(short, long, value_name = "SPHERE", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Surface to write, with the same triangles as the sphere; for several surfaces, a folder
    ///
    /// Needed if the mapped surface differs from the input: for volumes, for deform, with --resample-to, --fix, --wrap
    /// and --cut-handles. By default, the surface is then written next to the sphere: NAME.surf.gii for
    /// NAME.sphere.surf.gii.
    #[arg(long, value_name = "MESH", help_heading = OUTPUT)]
    pub(super) surface_output: Option<PathBuf>,
    /// Template for the names of several outputs
    ///
    /// Placeholders stand for parts of each input's path, with links resolved: {stem} is the file's name without folder
    /// and format, {label} the label in a volume, {parent} the folder that contains the file, {parent2} the folder
    /// above {parent}.
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
