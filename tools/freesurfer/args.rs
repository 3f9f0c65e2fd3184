//! The arguments of `freesurfer`.

use std::path::PathBuf;
use std::str::FromStr;

use spharm::Smoothness;
use spharm_cli::freesurfer::Hemi;
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_cli::{Common, help};

use crate::rows::CohortArgs;

/// Fit the surfaces of FreeSurfer's subjects, each on its own registered sphere
///
/// Each surface is fitted over the sphere.reg of its hemisphere. A direction on this sphere has the same anatomical
/// position in every subject, whatever the number of vertices, so coefficients of different subjects correspond.
/// Subjects that lack a file, or whose sphere doesn't match the surface, are listed at the end and don't stop the fits
/// of other subjects.
#[derive(Debug, clap::Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm freesurfer $SUBJECTS_DIR --surface pial white --max-degree 80 -o models",
        "spharm freesurfer $SUBJECTS_DIR --surface white --signal thickness curv --max-degree 40 -o models \\",
        "    --evaluate-on icosphere:6 --status status.tsv --skip-existing",
    ],
    &[],
))]
pub(crate) struct Cli {
    /// Folder of the subjects, SUBJECTS_DIR
    #[arg(value_name = "SUBJECTS_DIR", help_heading = help::INPUT)]
    pub(super) subjects_dir: PathBuf,
    /// Subjects to fit [default: all except fsaverage*]
    #[arg(long, value_name = "NAME", num_args = 1.., help_heading = help::INPUT)]
    pub(super) subject: Vec<String>,
    /// Surfaces to fit: lh.NAME and rh.NAME in each subject's surf/
    #[arg(long, value_name = "NAME", num_args = 1.., help_heading = help::INPUT, required_unless_present = "signal")]
    pub(super) surface: Vec<String>,
    /// Values on the vertices, such as thickness, curv or sulc, with one model for each
    #[arg(long, value_name = "NAME", num_args = 1.., help_heading = help::INPUT)]
    pub(super) signal: Vec<String>,
    /// Label of the vertices whose values are read: lh.NAME.label in each subject's label/; `none` reads all vertices
    ///
    /// Outside the label, values are extrapolated from the edge of the label, because FreeSurfer's zeros on the medial
    /// wall aren't measurements. The extrapolated values are fitted like data, and change the model next to the wall.
    /// At degree 20, for values with a standard deviation of 0.4 mm and a wall of 5 % of the vertices, the model
    /// changes by at most 0.07 mm (rms 0.003 mm). `spharm fit --mask` omits the vertices outside the label instead, but
    /// at high degrees the remaining data don't determine the model on the wall. Surfaces are always read at all
    /// vertices. [default: cortex, if it exists]
    #[arg(long, value_name = "NAME|none", requires = "signal", help_heading = help::INPUT)]
    pub(super) mask: Option<String>,
    /// Hemispheres to fit
    #[arg(long, value_enum, num_args = 1.., default_values = ["lh", "rh"], hide_possible_values = true, value_name = "lh|rh", help_heading = help::INPUT)]
    pub(super) hemi: Vec<Hemi>,
    /// Sphere of each hemisphere: lh.NAME and rh.NAME in each subject's surf/
    #[arg(long, value_name = "NAME", default_value = "sphere.reg", help_heading = help::INPUT)]
    pub(super) sphere: String,
    /// Refuse doubtful inputs and fits that don't reach the tolerance
    #[arg(long, help_heading = help::INPUT)]
    pub(super) strict: bool,
    /// Highest degree, inclusive
    #[arg(short = 'L', long, alias = "degree", value_name = "L", default_value_t = 80, help_heading = help::METHOD)]
    pub(super) max_degree: usize,
    /// Smoothness penalty [default: 0]
    #[arg(long, value_name = "LAMBDA|auto", help_heading = help::METHOD)]
    pub(super) smoothness: Option<Smoothness>,
    /// Don't measure the distance between model and surface, which takes about a second for each surface
    #[arg(long, help_heading = help::METHOD)]
    pub(super) no_surface_distance: bool,
    /// Folder for the models, SUBJECT.HEMI.NAME.spharm.npz
    #[arg(short, long, value_name = "DIR", help_heading = help::OUTPUT)]
    pub(super) output: PathBuf,
    /// Also write each model's values at the vertices of one sphere
    ///
    /// icosphere:6 has 40,962 vertices. A name such as fsaverage5 selects the spheres of this subject, in SUBJECTS_DIR
    /// or in FREESURFER_HOME/subjects. Alternatively, give the file of a sphere; the sphere of the other hemisphere
    /// must be in the same folder. Surfaces are written to files SUBJECT.HEMI.NAME.ico6.surf.gii, and values to files
    /// that end in .shape.gii. Each vertex has the same anatomical position in every subject.
    #[arg(long, value_name = "icosphere:N|NAME|SPHERE", help_heading = help::OUTPUT)]
    pub(super) evaluate_on: Option<On>,
    /// Write a report to a JSON file
    #[arg(long, value_name = "FILE", help_heading = help::OUTPUT)]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON instead of the table
    #[arg(long, help_heading = help::OUTPUT)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = help::OUTPUT)]
    pub(super) force: bool,
    /// Skip surfaces that have a model of the same input with the same settings
    #[arg(long, conflicts_with = "force", help_heading = help::OUTPUT)]
    pub(super) skip_existing: bool,
    #[command(flatten)]
    pub(super) cohort: CohortArgs,
    /// Memory to use [default: half of the free memory]
    #[arg(long, value_name = "SIZE", help_heading = help::RESOURCES)]
    pub(super) memory: Option<Size>,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}

/// Value of `--evaluate-on`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum On {
    Icosphere(u32),
    /// The file of a sphere, or the name of a subject.
    Named(PathBuf),
}

/// Largest number of subdivisions of an icosphere.
const MOST: u32 = 9;

impl FromStr for On {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = format!("expected icosphere:N, with N from 0 to {MOST}, a sphere's file, or a subject's name");
        match text.strip_prefix("icosphere:").map(str::parse) {
            Some(Ok(subdivisions)) if subdivisions <= MOST => Ok(Self::Icosphere(subdivisions)),
            None if !text.is_empty() => Ok(Self::Named(text.into())),
            _ => Err(expected),
        }
    }
}
