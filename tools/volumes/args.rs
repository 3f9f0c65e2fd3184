//! Arguments of `volumes`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT, RESOURCES};
use spharm_cli::size::Size;
use spharm_cli::surfaces::Labels;
use spharm_cli::threads::Threads;
use spharm_cli::volumes::{LabelSurfaceArgs, VolumeArgs};

use super::names::ImageTemplate;

/// Make a model of every label in label volumes, and one table of all labels
///
/// Each label's surface is mapped to its own sphere and fitted. The model, the surface and the sphere are written to
/// --output. The table gets a row for each label, with voxels, volume, area, residual and rotation-invariant
/// descriptors. A label that fails doesn't affect the others: its row states the reason, and the exit status is 1.
#[derive(Debug, Args)]
#[command(mut_arg("voxel_size", |size| size.hide_short_help(false)))]
#[command(after_long_help = help::examples(
    &[
        "spharm volumes aseg/*.mgz --label 17 53 --max-degree 15 -o hippocampi",
        "spharm volumes cells.ome.tif --max-degree 12 --fix --skip-border --min-voxels 100 -o cells",
        "spharm volumes stacks --voxel-size 0.2,0.2,0.6 --max-degree 12 -o cells --skip-existing",
    ],
    &[help::VOLUMES],
))]
pub(crate) struct Cli {
    /// Label volumes
    ///
    /// Give files, folders (for all volumes in them), or @LIST for a file LIST with one path per line.
    #[arg(value_name = "LABELS", required = true, help_heading = INPUT)]
    pub(super) volumes: Vec<PathBuf>,
    /// Labels to model; 0 is the background
    #[arg(long, value_name = "N|all", num_args = 1.., default_value = "all", allow_negative_numbers = true, help_heading = INPUT)]
    pub(super) label: Vec<Labels>,
    #[command(flatten, next_help_heading = INPUT)]
    pub(super) volume: VolumeArgs,
    #[command(flatten, next_help_heading = INPUT)]
    pub(super) label_surface: LabelSurfaceArgs,
    /// Repair labels whose surface isn't of genus zero
    ///
    /// Keeps the largest piece, fills cavities and removes handles, instead of refusing the label. A warning is given
    /// if the repair drops, adds or removes more than 5 % of the label's voxels.
    #[arg(long, help_heading = INPUT)]
    pub(super) fix: bool,
    /// Cut the handles of labels along short loops, and fill both sides of each cut
    ///
    /// The model and its row describe the cut surface, NAME.cut.surf.gii. The model records the seams, so that
    /// reconstruct can restore the original surface. A warning is given if the cuts change the volume by more than 5 %.
    #[arg(long, help_heading = INPUT)]
    pub(super) cut_handles: bool,
    /// Skip labels with fewer than N voxels
    #[arg(long, value_name = "N", default_value_t = 1, hide_default_value = true, help_heading = INPUT)]
    pub(super) min_voxels: usize,
    /// Skip labels that touch the border of their volume and may therefore be cut off
    ///
    /// With --fix, only the piece that the repair keeps is considered.
    #[arg(long, help_heading = INPUT)]
    pub(super) skip_border: bool,
    /// Highest degree, inclusive [default: chosen by the labels' size in voxels]
    ///
    /// The default is between 4 and 60. The default is chosen for the label of median size in the first volume that has
    /// any of the labels: the model of this label resolves one and a half voxels. With --skip-existing, the default is
    /// the degree of the existing table.
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    /// Folder of the models
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Table to write, .tsv or .csv [default: volumes.tsv in the folder of the models]
    #[arg(long, value_name = "OUT.tsv|OUT.csv", help_heading = OUTPUT)]
    pub(super) table: Option<PathBuf>,
    /// Print the table as JSON
    #[arg(long, help_heading = OUTPUT)]
    pub(super) json: bool,
    /// Template for the names of the models
    ///
    /// Placeholders are replaced by parts of each volume's path, after links have been resolved: {stem} is the file's
    /// name without folder and format, {label} the label, {parent} the folder that contains the file, {parent2} the
    /// folder above {parent}, {channel} and {time} the numbers given by --channel and --time.
    #[arg(long, value_name = "TEMPLATE", default_value = "{stem}", help_heading = OUTPUT)]
    pub(super) name_template: ImageTemplate,
    /// Keep existing models that were made from the same file and label with the same settings
    ///
    /// Files are compared by their contents: if one label of a file was edited, the models of all labels in this file
    /// are refused. --force replaces these models.
    #[arg(long, conflicts_with = "force", help_heading = OUTPUT)]
    pub(super) skip_existing: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    /// Memory of a fit [default: half of the free memory]
    #[arg(long, value_name = "SIZE", help_heading = RESOURCES)]
    pub(super) memory: Option<Size>,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}
