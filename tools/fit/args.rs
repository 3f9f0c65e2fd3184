//! The arguments of `fit`.

use std::path::PathBuf;

use clap::ValueEnum;
use spharm::{Accuracy, Objective, Preconditioner, Smoothness, defaults};
use spharm_cli::names::NameTemplate;
use spharm_cli::size::Size;
use spharm_cli::surfaces::Labels;
use spharm_cli::threads::Threads;
use spharm_cli::values::{self, Dtype, percent, voxels};
use spharm_cli::volumes::{LabelSurfaceArgs, VolumeArgs};
use spharm_cli::{Common, help};

use crate::rows::CohortArgs;

/// Fit surfaces, or any signals on the sphere, with spherical harmonics
///
/// Without --store, surfaces are fitted by full least squares with fast transforms. With --store, surfaces are fitted
/// by iterative residual fitting in bounded memory, with a basis that basis-build made for the same sphere. All
/// surfaces of one call are fitted together, in as few sweeps over the basis as the memory allows.
#[derive(Debug, clap::Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm fit bunny.ply --max-degree 60",
        "spharm fit --sphere lh.sphere.reg --surface sub-*/surf/lh.pial --max-degree 80 -o models \\",
        "    --name-template '{parent2}.{stem}' --skip-existing",
        "spharm fit --manifest subjects.tsv --max-degree 80 -o models --shard 0/10 --keep-going --status status/0.tsv",
        "spharm fit --moments topography.moments --max-degree 300 --smoothness auto -o models",
        "spharm fit --store basis --sphere sphere.surf.gii --surface @subjects.txt --max-degree 100 --passes 2 -o models",
    ],
    &[help::MESHES, help::VOLUMES, help::SIGNALS],
))]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(super) input: Input,
    #[command(flatten)]
    pub(super) method: MethodArgs,
    #[command(flatten)]
    pub(super) solver: Solver,
    #[command(flatten)]
    pub(super) output: Output,
    #[command(flatten)]
    pub(super) cohort: CohortArgs,
    #[command(flatten)]
    pub(super) resources: Resources,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = help::INPUT)]
pub(super) struct Input {
    /// Surfaces, or signals on the sphere's vertices
    ///
    /// A folder is replaced by the meshes in it, except spheres and surfaces written by fits. Subfolders are ignored.
    /// @LIST reads paths from the file LIST, one per line, relative to the folder of LIST. In LIST, # begins a comment.
    /// A file given twice is fitted once.
    #[arg(value_name = "FILE", required_unless_present_any = ["surface", "moments", "manifest"])]
    pub(super) files: Vec<PathBuf>,
    /// Another way to give FILE
    #[arg(long, value_name = "FILE", num_args = 1.., hide_short_help = true)]
    pub(super) surface: Vec<PathBuf>,
    /// Table of surfaces and their ids, in place of --surface
    ///
    /// The table has the columns id and surface, and optionally sphere, weights, output and label. It is tab-separated,
    /// or comma-separated if its name ends in .csv. Paths are relative to the table. A model's file is named after the
    /// column `output` or, without this column, after the id. The model records the id. Other columns are ignored. Rows
    /// without a sphere use --sphere, and volumes without a label use --label.
    #[arg(long, value_name = "TABLE.tsv", conflicts_with_all = ["files", "surface", "moments", "name_template"])]
    pub(super) manifest: Option<PathBuf>,
    /// Moments of samples, in place of surfaces
    ///
    /// A file written by `spharm moments` or `spharm moments merge`. Models can have any degree up to the degree of
    /// this file. The printed table has a row for each channel. Its column rms is the root mean square residual. Its
    /// column explained is 1 - sum w r^2 / sum w f^2, for values f with weights w and residuals r.
    #[arg(
        long,
        value_name = "ALL.moments",
        conflicts_with_all = ["files", "surface", "sphere", "label", "fix", "wrap", "cut_handles", "method", "hold_out", "dtype", "verify", "skip_existing", "update", "shard", "keep_going", "status", "dry_run", "log"]
    )]
    pub(super) moments: Option<PathBuf>,
    /// Sphere of the surfaces [default: one for each surface]
    ///
    /// A mesh centred at the origin, or a CSV of theta,phi. Without this option, each surface is first mapped to a
    /// sphere, as by parametrize, and this sphere is written next to the model.
    #[arg(long, value_name = "SPHERE", conflicts_with_all = ["LabelSurfaceArgs", "VolumeArgs"])]
    pub(super) sphere: Option<PathBuf>,
    /// Labels of a volume, or all: one model per label
    ///
    /// Surfaces can also be given as label volumes (.nii, .mgz, .nrrd, .tif, .npy). A label must be given only if a
    /// volume has several labels. The surfaces of the labels are written next to the models.
    #[arg(long, value_name = "N|all", num_args = 1.., allow_negative_numbers = true, conflicts_with = "sphere")]
    pub(super) label: Vec<Labels>,
    /// Repair labels and meshes instead of refusing them
    ///
    /// For a label, this option keeps the largest piece, fills cavities and removes handles. For a mesh, it welds
    /// coincident vertices, drops repeated and degenerate triangles, fins, unused vertices and all pieces except the
    /// largest, orients all triangles outwards, separates parts that touch, and fills holes of up to 500 edges. Large
    /// holes are filled by surfaces of least bending. The repaired mesh is written next to the model, as
    /// NAME.fixed.surf.gii.
    #[arg(long, group = "mending", conflicts_with = "sphere")]
    pub(super) fix: bool,
    /// Raise the limits of --fix and --wrap to this percentage of a mesh's area
    ///
    /// The default limits, in per cent, are 5 for the area lost by welding, 5 for dropped pieces, 25 for filled holes,
    /// 5 for parts that --wrap leaves out, and 25 for the part of the wrap that spans holes.
    #[arg(long, value_name = "PERCENT", requires = "mending", value_parser = percent, hide_short_help = true)]
    pub(super) largest_repair: Option<f64>,
    /// Replace each mesh by the closed surface around it, computed on a grid with this number of voxels along the
    /// longest side
    ///
    /// Use this option for meshes that --fix can't close: meshes with double walls, meshes that intersect themselves,
    /// and meshes whose parts overlap, lie inside each other or lack large pieces. The closed surface, the wrap, spans
    /// holes and has no handles. Vertices of the wrap within a voxel of the mesh are moved onto the mesh. Walls and
    /// gaps thinner than a voxel are lost. An open sheet is refused. A wrap is also refused if it leaves out more than
    /// 5 % of the mesh, or if more than 25 % of its area spans holes. 128 voxels suit most meshes. The range is 16 to
    /// 512 voxels. The wrap is written next to the model, as NAME.fixed.surf.gii.
    #[arg(long, value_name = "VOXELS", group = "mending", conflicts_with_all = ["sphere", "fix", "cut_handles"], value_parser = voxels, hide_short_help = true)]
    pub(super) wrap: Option<usize>,
    #[command(flatten)]
    pub(super) label_surface: LabelSurfaceArgs,
    #[command(flatten)]
    pub(super) volume: VolumeArgs,
    /// Cut the handles of surfaces along short loops, and fill both sides of each cut
    ///
    /// The cut surface is fitted, and written next to the model, as NAME.cut.surf.gii. The model records the seams, so
    /// that reconstruct can restore the original surface.
    #[arg(long, conflicts_with = "sphere", hide_short_help = true)]
    pub(super) cut_handles: bool,
    /// Folder of the basis store [env: SPHARM_STORE, see --help]
    ///
    /// Without this option, --method irf, sirf, mirf and nlsf use the folder named by the environment variable
    /// SPHARM_STORE. The variable doesn't change the method or the objective.
    #[arg(long, value_name = "DIR")]
    pub(super) store: Option<PathBuf>,
    /// Weights of the vertices
    ///
    /// uniform, area (each vertex's share of the sphere), or a file with one value per vertex. Vertices of weight 0
    /// are ignored.
    #[arg(long, value_name = "uniform|area|FILE", default_value = "uniform")]
    pub(super) weights: String,
    /// File that selects the vertices to fit
    ///
    /// The file has a value for each vertex, 0 for vertices to ignore, or is a FreeSurfer label. A surface is fitted on
    /// the triangles whose three corners are selected. Least squares without --store also ignores vertices at which a
    /// signal has no value (NaN). The model still covers the whole sphere.
    #[arg(long, value_name = "FILE", requires = "sphere", hide_short_help = true)]
    pub(super) mask: Option<PathBuf>,
    /// Refuse doubtful inputs and fits that don't reach the tolerance
    ///
    /// Doubtful inputs are surfaces that have holes or a genus other than zero, spheres that are off centre, and
    /// spheres or masks that belong to the other hemisphere.
    #[arg(long)]
    pub(super) strict: bool,
}

impl Input {
    /// Returns the paths given as positional arguments and by --surface.
    pub(super) fn paths(&self) -> Vec<PathBuf> {
        [&self.files[..], &self.surface].concat()
    }
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = help::METHOD)]
pub(super) struct MethodArgs {
    /// Highest degree, inclusive [default: chosen, see --accuracy]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", conflicts_with = "accuracy")]
    #[arg(required_if_eq_any = [("dry_run", "true")])]
    pub(super) max_degree: Option<usize>,
    /// Use the lowest degree with at most this error [default: 0.2%]
    ///
    /// The error is the root mean square distance between model and surface: a length in the unit of the input, or a
    /// percentage of the surface's size. This size is the cube root of the volume of the bounding box. All models of a
    /// call have the same degree, at most 256. This common degree is the highest that the first, the middle or the last
    /// surface needs. If a model exists and isn't replaced, its degree is used instead. Without --accuracy, the degree
    /// for labels of a volume is 4 to 60, chosen by the labels' median size in voxels.
    #[arg(long, value_name = "RMS|PERCENT%", conflicts_with_all = ["store", "shard", "moments"])]
    pub(super) accuracy: Option<Accuracy>,
    /// Method of the fit [default: irf with --store, else lsq]
    #[arg(long, value_enum)]
    pub(super) method: Option<MethodName>,
    /// Objective of the fit (lsq) [default: surface for meshes]
    ///
    /// surface: fit samples on all triangles. The samples are as dense as the degree requires, and each is weighted by
    /// its share of the sphere. vertices: fit only the vertices. This is the default for signals, and the only choice
    /// with --store.
    #[arg(long, value_name = "surface|vertices", alias = "target")]
    pub(super) objective: Option<Objective>,
    /// Allowed area distortion when meshes are mapped to the sphere, 0 to 1 [default: 0.8]
    ///
    /// This option is for meshes without a sphere. The value has the same meaning as --area of parametrize, but areas
    /// are distorted only as far as the distortion improves the model. Use 0 for groups, so that the maps of two
    /// surfaces differ no more than the surfaces themselves.
    #[arg(long, value_name = "RMS", conflicts_with_all = ["sphere", "label", "moments"], hide_short_help = true)]
    pub(super) area: Option<f64>,
    /// Passes, p [default: irf 1, mirf 4; with --accelerate 16]
    ///
    /// Further passes bring a model closer to the least-squares solution. One pass reaches this solution only if the
    /// functions of different blocks are nearly orthogonal on the sampling, as on an icosphere with many more vertices
    /// than coefficients.
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) passes: Option<u32>,
    /// Basis functions per block, g (irf) [default: 100]
    #[arg(long, value_name = "G", value_parser = values::at_least_one)]
    pub(super) granularity: Option<usize>,
    /// Use conjugate gradients over pairs of passes (irf, mirf)
    ///
    /// Each step is one pass forward and one pass backward. On irregular samplings, conjugate gradients reach the
    /// least-squares solution in far fewer passes. With --accelerate, --passes is the maximum number of passes. The
    /// iteration ends early if further passes bring no improvement.
    #[arg(long)]
    pub(super) accelerate: bool,
    /// Last degree of the first block, s (sirf, mirf) [default: 0]
    #[arg(long, value_name = "S", hide_short_help = true)]
    pub(super) start_degree: Option<usize>,
    /// Smoothness penalty (lsq) [default: 0]
    ///
    /// Adds LAMBDA sum (l (l + 1))^2 a^2, over all coefficients a of degree l, to the weighted sum of squared
    /// distances. Weights are used as given: if all weights are a tenth as large, a tenth of LAMBDA has the same
    /// effect. With --objective surface, the weights of the samples have the same sum as the weights of the vertices.
    /// auto chooses LAMBDA for each surface, or each channel of a signal, by generalised cross-validation. With
    /// --objective vertices and without --sphere, the default is a small penalty that keeps the model from oscillating
    /// between vertices. At the highest degree, this penalty has a hundredth of the weight of the vertices.
    #[arg(long, value_name = "LAMBDA|auto")]
    pub(super) smoothness: Option<Smoothness>,
    /// Remove noise, degree by degree (lsq)
    ///
    /// This option suits surfaces and signals whose vertices have independent noise of equal size. The size of the
    /// noise and its effect on each degree are estimated from the residual and from fits of random noise. The fit is
    /// then repeated, damping the degrees that are mostly noise. Detail above --max-degree is treated as noise, so give
    /// a degree that is high enough.
    #[arg(long, conflicts_with = "smoothness")]
    pub(super) denoise: bool,
    /// Don't measure the distance between model and surface
    ///
    /// By default, the distances from the model to the surface and from the surface to the model are measured after a
    /// fit, which takes about a second for each surface.
    #[arg(long, hide_short_help = true)]
    pub(super) no_surface_distance: bool,
    /// Fraction of the vertices to hold out, to measure the error
    #[arg(long, value_name = "FRACTION", value_parser = values::fraction)]
    pub(super) hold_out: Option<f64>,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = help::SOLVER)]
pub(super) struct Solver {
    /// Optimality to reach (lsq)
    ///
    /// Optimality is the size of the gradient, relative to its size at zero coefficients.
    #[arg(long, value_name = "T", default_value = "1e-10", value_parser = values::fraction)]
    pub(super) tolerance: f64,
    /// Maximum number of iterations (lsq)
    #[arg(long, value_name = "N", default_value_t = defaults::MAX_ITERATIONS, hide_short_help = true)]
    pub(super) max_iterations: usize,
    /// Preconditioner of the iterations (lsq)
    ///
    /// auto: for unevenly spread samples, use their density if computing the moments of the samples pays off; use a
    /// Cholesky factor if iterations are slow. density: always compute the moments of the samples and use the density.
    /// none: use no preconditioner. factor: use a Cholesky factor from the start. With fewer vertices than coefficients
    /// and no penalty, no preconditioner is used.
    #[arg(long, value_name = "auto|none|density|factor", default_value = "auto", hide_short_help = true)]
    pub(super) preconditioner: Preconditioner,
    /// Scalar type of the basis [default: the type in the store, f64 if the store has both]
    #[arg(long, value_enum, hide_short_help = true)]
    pub(super) dtype: Option<Dtype>,
    /// Before the fit, check every byte of the basis against its hash
    #[arg(long, hide_short_help = true)]
    pub(super) verify: bool,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = help::OUTPUT)]
pub(super) struct Output {
    /// Folder for the models [default: the current folder, or the manifest's folder]
    ///
    /// Each model is NAME.spharm.npz. For one surface, OUT may also be a file whose name ends in .npz.
    #[arg(short, long, value_name = "OUT")]
    pub(super) output: Option<PathBuf>,
    /// Template for the names of the models
    ///
    /// Placeholders are replaced by parts of each input's path, after links have been resolved: {stem} is the file's
    /// name without folder and format, {label} the label in a volume, {parent} the folder that contains the file,
    /// {parent2} the folder above {parent}.
    #[arg(long, value_name = "TEMPLATE", default_value = "{stem}")]
    pub(super) name_template: NameTemplate,
    /// Also write complex coefficients, NAME.spharm.csv
    #[arg(long)]
    pub(super) coefficients_csv: bool,
    /// Also write standard errors, NAME.spharm.stderr.npy (lsq)
    #[arg(long)]
    pub(super) stderr: bool,
    /// Write a report to a JSON file
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    /// Print the report as JSON instead of the table
    #[arg(long)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long)]
    pub(super) force: bool,
    /// Skip surfaces whose model exists
    ///
    /// The model must have been made from the same input with the same settings. A sphere that an earlier call wrote
    /// without a model is reused if it was made from the same input for the same degree.
    #[arg(long, conflicts_with = "force")]
    pub(super) skip_existing: bool,
    /// Like --skip-existing, but refit surfaces that have changed
    ///
    /// A model that was made from another input or with other settings is replaced, not refused.
    #[arg(long, conflicts_with_all = ["force", "skip_existing"])]
    pub(super) update: bool,
    /// Don't print the note that models don't correspond, because the caller aligns the models
    #[arg(long, hide = true)]
    pub(super) aligned_later: bool,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = help::RESOURCES)]
pub(super) struct Resources {
    /// Memory to use [default: 256MiB with a store, else half of the free memory]
    ///
    /// Memory-mapped files are included.
    #[arg(long, value_name = "SIZE")]
    pub(super) memory: Option<Size>,
    #[command(flatten)]
    pub(super) threads: Threads,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum MethodName {
    /// Full least squares by fast transforms
    Lsq,
    /// Iterative residual fitting with a basis store
    Irf,
    /// One pass, one degree per block (Shen and Chung 2006)
    Sirf,
    /// Several passes, one degree per block (Shen and Chung 2006)
    Mirf,
    /// Full least squares with a basis store (Shen and Chung 2006)
    Nlsf,
    /// Quadrature on a resampled grid
    Quadrature,
}

impl MethodName {
    /// Returns whether the method reads a basis store.
    pub(super) fn is_streamed(self) -> bool {
        !matches!(self, Self::Lsq | Self::Quadrature)
    }
}
