//! The arguments of `shape check`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::help::{self, INPUT, OUTPUT};

use super::super::args::{Models, ReportArgs, Resources};

/// Check the subjects of a group for outliers, duplicates and cut labels, and draw a picture of each
///
/// Flags a subject if the robust z of its volume, area, sphericity or score along a mode exceeds 3.5 in absolute value,
/// or if the robust z of the residual of its fit or of its distance from the mean exceeds 3.5. Also flags subjects that
/// have the same input, model or surface as another subject, a label at the border of the volume, voxels of a different
/// size, or large repairs, and subjects that account for most of a mode. A flag is only a reason to look at the
/// subject's picture.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape check models -o quality.tsv",
        "spharm shape check models --aligned aligned --mean mean.spharm.npz --scores scores.csv -o quality.tsv",
        "spharm shape check models --aligned aligned --mean mean.spharm.npz --frames transforms.json -o quality.tsv \
         --thumbnails thumbnails",
    ],
    &[
        "Robust z is (value - median) / (1.4826 MAD), for groups of five subjects or more. The residual of \
         the fit and the distance from the mean are flagged only if they are unusually large, not if they are small.",
    ],
))]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(super) models: Models,
    /// The given models after alignment to a common pose, under the same names
    ///
    /// These models are written by `spharm shape align --group` and `spharm shape correspond`.
    #[arg(long, value_name = "MODEL.spharm.npz", num_args = 1.., requires = "mean", help_heading = INPUT)]
    pub(super) aligned: Vec<PathBuf>,
    /// Mean of the aligned models, from which distances are measured
    #[arg(long, value_name = "MEAN.spharm.npz", requires = "aligned", help_heading = INPUT)]
    pub(super) mean: Option<PathBuf>,
    /// Scores along the group's modes, as `spharm shape pca --scores` writes them
    #[arg(long, value_name = "FILE.csv", help_heading = INPUT)]
    pub(super) scores: Option<PathBuf>,
    /// Transforms from the surfaces' frames to the aligned models' frames
    ///
    /// The file is written by `spharm shape align --transforms` or `spharm shape correspond --report`. The transforms
    /// are used for the pictures.
    #[arg(long, value_name = "FILE.json", requires = "aligned", help_heading = INPUT)]
    pub(super) frames: Option<PathBuf>,
    /// Files with warnings from other commands
    ///
    /// Each file is a JSON list of strings. A string `NAME: ...` becomes a flag of the subject NAME.
    #[arg(long, value_name = "FILE.json", num_args = 1.., help_heading = INPUT)]
    pub(super) warnings: Vec<PathBuf>,
    /// Table with the columns id, state and error, for the subjects without a model
    ///
    /// The optional column `accepted` gives the reason for accepting a subject's flags. A subject whose flags are
    /// accepted is listed, but not flagged.
    #[arg(long, value_name = "FILE.tsv", help_heading = INPUT)]
    pub(super) status: Option<PathBuf>,
    /// Table to write, with a row for each subject, the worst first
    #[arg(short, long, value_name = "OUT.tsv", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Folder for a picture of each surface, coloured by its distance from the model
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    pub(super) thumbnails: Option<PathBuf>,
    /// Fail if a subject is flagged
    #[arg(long, help_heading = OUTPUT)]
    pub(super) strict: bool,
    #[command(flatten)]
    pub(super) report: ReportArgs,
    #[command(flatten)]
    pub(super) resources: Resources,
}
