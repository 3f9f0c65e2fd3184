//! The arguments of `bids`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;
use spharm_cohort::Shard;

/// Fit the cortical surfaces of a BIDS dataset, as a BIDS app
///
/// Surfaces are read from derivatives/smriprep, derivatives/fmriprep, derivatives/freesurfer or sourcedata/freesurfer,
/// or from --freesurfer. Each surface is fitted over its subject's registered sphere, so that coefficients of different
/// subjects correspond. `participant` writes models, spectra, surfaces, errors and a page for each subject. `group`
/// gathers the models of all subjects. --surfaces and --hemi select the surfaces and hemispheres, by default both pial
/// surfaces.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm bids /data/study /data/study/derivatives/spharm participant --max-degree 60",
        "spharm bids /data/study out participant --participant-label 01 02 --surfaces pial white --freesurfer $SUBJECTS_DIR",
        "spharm bids /data/study out participant --shard slurm    # in an array of jobs",
        "spharm bids /data/study out group",
    ],
    &[
        "Names follow BIDS derivatives: sub-01/anat/sub-01_hemi-L_desc-spharm_pial.npz with a .json that describes how \
         it was made, ..._spectrum.tsv, ..._space-SPACE_den-DENSITY_desc-spharm_pial.surf.gii, \
         ..._desc-spharmerror_pial.shape.gii; sub-01.html. Surfaces aren't part of BIDS yet, so .bidsignore lists \
         them.",
    ],
))]
pub(crate) struct Cli {
    /// BIDS dataset to read
    #[arg(value_name = "BIDS_DIR")]
    pub(super) dataset: PathBuf,
    /// Folder of the derivative dataset
    #[arg(value_name = "OUT")]
    pub(super) output: PathBuf,
    /// Level of the analysis
    #[arg(value_enum)]
    pub(super) level: Level,
    /// Subjects, with or without `sub-` [default: all]
    #[arg(long, value_name = "LABEL", num_args = 1.., help_heading = INPUT)]
    pub(super) participant_label: Vec<String>,
    /// FreeSurfer's SUBJECTS_DIR
    #[arg(long, value_name = "DIR", help_heading = INPUT)]
    pub(super) freesurfer: Option<PathBuf>,
    /// Surfaces to fit
    #[arg(long, value_enum, value_name = "SURFACE", num_args = 1.., default_values = ["pial"], help_heading = METHOD)]
    pub(super) surfaces: Vec<Surface>,
    /// Hemispheres to fit
    #[arg(long, value_enum, value_name = "HEMI", num_args = 1.., default_values = ["L", "R"], help_heading = METHOD)]
    pub(super) hemi: Vec<Hemi>,
    /// Degree of the models
    #[arg(short = 'L', long, alias = "degree", value_name = "L", default_value_t = 60, help_heading = METHOD)]
    pub(super) max_degree: usize,
    /// Subdivisions of the icosphere at whose vertices models are evaluated
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(0..=8), help_heading = METHOD)]
    pub(super) icosphere: u32,
    /// Fit only part I of N parts of the surfaces (I from 0, or slurm to take I/N from the job array)
    #[arg(long, value_name = "I/N|slurm", help_heading = METHOD)]
    pub(super) shard: Option<Shard>,
    /// Replace existing models of another degree, and existing surfaces on another icosphere
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    /// Don't write pages
    #[arg(long, help_heading = OUTPUT)]
    pub(super) no_pages: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Level {
    /// Fit each subject
    Participant,
    /// Gather the models of all subjects
    Group,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Surface {
    Pial,
    White,
    Midthickness,
}

impl Surface {
    /// Returns the surface's suffix in BIDS file names. FreeSurfer has the same names for the surfaces, except for the
    /// middle surface.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Pial => "pial",
            Self::White => "white",
            Self::Midthickness => "midthickness",
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "UPPER")]
pub(super) enum Hemi {
    L,
    R,
}

impl Hemi {
    /// Returns the hemisphere's label in BIDS file names.
    pub(super) fn label(self) -> &'static str {
        match self {
            Self::L => "L",
            Self::R => "R",
        }
    }

    /// Returns the hemisphere's prefix in FreeSurfer's file names.
    pub(super) fn prefix(self) -> &'static str {
        match self {
            Self::L => "lh",
            Self::R => "rh",
        }
    }
}
