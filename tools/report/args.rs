//! Arguments of `report`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;

/// Make an interactive page of models, modes and tests for the browser
///
/// The page is one self-contained HTML file. The page shows surface, model and distance side by side, at any degree;
/// spectra and provenance; modes of a group with sliders; maps of a test with thresholds; and tables that can be sorted
/// with a click.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm report bunny.spharm.npz --surface bunny.ply -o bunny.html",
        "spharm report models -o models.html --fit-report fit.json",
        "spharm report --modes group.shape-model.npz --test test --status status.tsv -o study.html",
        "spharm report --quality correspond.json plain.json --correspondence group.json -o quality.html",
    ],
    &["Without --surface, each model is compared with the file to which it was fitted, if that file exists unchanged.", help::MESHES],
))]
pub(crate) struct Cli {
    /// Models, as `spharm fit` writes them
    ///
    /// Give files, folders (for all .npz files in them), or @LIST for a file LIST with one path per line.
    #[arg(value_name = "MODEL.spharm.npz", help_heading = INPUT)]
    pub(super) models: Vec<PathBuf>,
    /// Surfaces to compare with the models, in the same order [default: the fitted surfaces]
    #[arg(long, value_name = "SURFACE", num_args = 1.., requires = "models", help_heading = INPUT)]
    pub(super) surface: Vec<PathBuf>,
    /// Reports of `spharm fit --report`, which show the convergence of the fits
    #[arg(long, value_name = "FILE.json", num_args = 1.., requires = "models", help_heading = INPUT)]
    pub(super) fit_report: Vec<PathBuf>,
    /// Modes of groups, as `spharm shape pca` writes them
    #[arg(long, value_name = "FILE.shape-model.npz", num_args = 1.., help_heading = INPUT)]
    pub(super) modes: Vec<PathBuf>,
    /// Folders of maps, as `spharm shape test` writes them
    #[arg(long, value_name = "DIR", num_args = 1.., help_heading = INPUT)]
    pub(super) test: Vec<PathBuf>,
    /// Quality of a group's alignments to show side by side, as `spharm shape quality -o` writes it
    ///
    /// Each alignment is named after its file.
    #[arg(long, value_name = "FILE.json", num_args = 1.., help_heading = INPUT)]
    pub(super) quality: Vec<PathBuf>,
    /// Correspondence of a group, as `spharm shape correspond --report` writes it
    ///
    /// Shows the coverage of each member. The distances of the group's landmarks are shown with the first --quality.
    #[arg(long, value_name = "FILE.json", help_heading = INPUT)]
    pub(super) correspondence: Option<PathBuf>,
    /// Quality control of a group's subjects, as `spharm shape check --report` writes it
    ///
    /// The page begins with this table of subjects, in which the flagged values are marked and the worst subject is at
    /// the top.
    #[arg(long, value_name = "FILE.json", help_heading = INPUT)]
    pub(super) check: Option<PathBuf>,
    /// Folder of the subjects' pictures, as `spharm shape check --thumbnails` writes it
    #[arg(long, value_name = "DIR", requires = "check", help_heading = INPUT)]
    pub(super) thumbnails: Option<PathBuf>,
    /// Status tables, CSV or TSV with a header
    #[arg(long, value_name = "FILE", num_args = 1.., help_heading = INPUT)]
    pub(super) status: Vec<PathBuf>,
    /// Warnings to show at the top, as JSON lists of strings
    #[arg(long, value_name = "FILE.json", num_args = 1.., help_heading = INPUT)]
    pub(super) warnings: Vec<PathBuf>,
    /// Methods paragraph to show, as `spharm study` writes it
    #[arg(long, value_name = "FILE.md", help_heading = INPUT)]
    pub(super) methods: Option<PathBuf>,
    /// Provenance of a study to show, as `spharm study` writes it
    #[arg(long, value_name = "FILE.json", help_heading = INPUT)]
    pub(super) provenance: Option<PathBuf>,
    /// Page to write
    #[arg(short, long, value_name = "OUT.html", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Heading of the page [default: the model's name, or the kind of contents]
    #[arg(long, value_name = "TEXT", help_heading = OUTPUT)]
    pub(super) title: Option<String>,
    /// Maximum number of vertices of a mesh in the page
    ///
    /// A model with more vertices is evaluated on a coarser icosphere; a surface with more vertices isn't shown.
    #[arg(long, value_name = "N", default_value_t = 163_842, value_parser = clap::value_parser!(u32).range(12..=10_000_000), help_heading = OUTPUT)]
    pub(super) max_vertices: u32,
    /// Replace an existing output
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}
