//! Arguments of `generate`.

use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValuesParser;
use spharm_cli::Common;
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_surface::generate::Family;

/// Write test data: a folded surface and its sphere, a study of two groups, or a group with known correspondence
///
/// A smooth map bends an icosphere into a closed surface with folds like those of a cortex, about 140 mm long and not
/// star-shaped. Vertex i of the surface corresponds to vertex i of the sphere. The same arguments always give identical
/// files.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm generate --surface cortex.surf.gii --sphere sphere.surf.gii",
        "spharm generate --variant 1 --subdivisions 4 --surface small.ply",
        "spharm generate --study meshes --subjects 12 --bump 2",
        "spharm generate --volumes labels --subjects 20",
        "spharm generate --group rods --members 20 --output-dir rods",
    ],
    &[help::MESHES],
))]
pub(crate) struct Cli {
    /// Number N of subdivisions of the icosphere, for 10 * 4^N + 2 vertices [default: 6, for a group 5, for a study 4]
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(0..=10),
        help_heading = METHOD
    )]
    pub(super) subdivisions: Option<u32>,
    /// Number that selects a surface from the family, or the seed of a study or a group
    #[arg(long, value_name = "SEED", default_value_t = 0, help_heading = METHOD)]
    pub(super) variant: u64,
    /// Surface to write
    #[arg(long, value_name = "OUT", help_heading = OUTPUT)]
    pub(super) surface: Option<PathBuf>,
    /// Sphere to write
    #[arg(long, value_name = "OUT", required_unless_present_any = ["surface", "study", "volumes", "group"], help_heading = OUTPUT)]
    pub(super) sphere: Option<PathBuf>,
    /// Folder for the meshes of a study, with study.csv
    ///
    /// The subjects of two groups, a and b, are bodies of 40 mm in random poses, without spheres. The bodies of group b
    /// have a bump.
    #[arg(long, value_name = "DIR", group = "subjects_of", conflicts_with_all = ["surface", "sphere"], help_heading = OUTPUT)]
    pub(super) study: Option<PathBuf>,
    /// Folder for the label volumes of a study, ID.nii.gz, with study.csv
    ///
    /// Writes the same bodies as --study, in voxels of 1 mm. The header of the last subject of group a wrongly states
    /// voxels of 10 mm; `spharm study` flags this subject in quality control.
    #[arg(long, value_name = "DIR", group = "subjects_of", conflicts_with_all = ["surface", "sphere", "subdivisions", "double"], help_heading = OUTPUT)]
    pub(super) volumes: Option<PathBuf>,
    /// Number of subjects in a study, half of them in each group
    #[arg(long, value_name = "N", default_value_t = 12, requires = "subjects_of", value_parser = clap::value_parser!(u64).range(2..=10_000), help_heading = METHOD)]
    pub(super) subjects: u64,
    /// Height of the bump, in mm
    #[arg(long, value_name = "MM", default_value_t = 2.0, requires = "subjects_of", help_heading = METHOD)]
    pub(super) bump: f64,
    /// Family of shapes from which to write a group with known correspondence
    ///
    /// The families are moving-bump, sharp-bump, growing-bump, ellipsoids, rods and tori. Each family has one or two
    /// parameters. Every member has its own mesh and a random pose.
    #[arg(
        long,
        value_name = "FAMILY",
        value_parser = PossibleValuesParser::new(Family::ALL.map(Family::name)),
        conflicts_with_all = ["surface", "sphere", "study", "volumes"],
        requires = "output_dir",
        help_heading = METHOD
    )]
    pub(super) group: Option<String>,
    /// Number of members of a group
    #[arg(long, value_name = "N", default_value_t = 16, requires = "group", value_parser = clap::value_parser!(u64).range(2..=10_000), help_heading = METHOD)]
    pub(super) members: u64,
    /// Leave the members of a group in the coordinates of their family, without random poses
    #[arg(long, requires = "group", help_heading = METHOD)]
    pub(super) upright: bool,
    /// Folder for a group: meshes, their landmarks, and truth.csv with parameters and poses
    #[arg(long, value_name = "DIR", requires = "group", help_heading = OUTPUT)]
    pub(super) output_dir: Option<PathBuf>,
    /// Write 64-bit positions if the format supports them
    #[arg(long, help_heading = OUTPUT)]
    pub(super) double: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) common: Common,
}
