//! Arguments of `export`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_exchange::{Format, Normalization};

/// The formats, listed at the end of `--help`.
pub(crate) const FORMATS: &str = "Formats:
  pdm        SPHARM-PDM, Slicer, SlicerSALT: .coef, surfaces only
  mat        SPHARM-MAT: .mat with fvec, vertices, faces, sph_verts; surfaces only
  pyshtools  SHTOOLS: text, one file per channel; orthonormal, csphase 1
  healpy     healpy, ducc0: alm as FITS, one table per channel
  s2fft      s2fft: .npy (c, L + 1, 2 L + 1), complex; L of s2fft is the degree plus 1
  ktch       ktch: .npy (c, K)
  flowshape  FlowShape: .npy (K, c)
  aics       aics-shparam: .json or .csv of a radius, 1 channel; export only
  afni       weighted SPHARM, AFNI: text (L + 1) x (2 L + 1), one file per channel
  csv, json  coefficients as in the model";

/// Write models in the formats of other packages
///
/// Coefficients are converted to the harmonics and the order of coefficients of the other package. Numbers in text
/// files have 17 digits. A model that the format can't represent is refused.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm export bunny.spharm.npz --to pdm -o bunny.coef",
        "spharm export models --to healpy -o alm",
        "spharm export bunny.spharm.npz --to pyshtools -o bunny.sh    # bunny.x.sh, bunny.y.sh, bunny.z.sh",
    ],
    &[FORMATS],
))]
pub(crate) struct Cli {
    /// Models, as `spharm fit` writes them
    ///
    /// Give files, folders (for all .npz files in them), or @LIST for a file LIST with one path per line.
    #[arg(value_name = "MODEL.spharm.npz", required = true, help_heading = INPUT)]
    pub(super) models: Vec<PathBuf>,
    /// Format: pdm, mat, pyshtools, healpy, s2fft, ktch, flowshape, aics, afni, csv, json
    #[arg(long, value_name = "FORMAT", help_heading = METHOD)]
    pub(super) to: Format,
    /// Normalisation of pyshtools' harmonics: ortho, 4pi (pyshtools' own default), schmidt or unnorm
    #[arg(long, value_name = "NAME", default_value = "ortho", value_parser = normalization, help_heading = METHOD)]
    pub(super) normalization: Normalization,
    /// File to write; for several models, a folder
    ///
    /// The name may have no extension, or the extension of the format: .coef for pdm; .mat for mat; .sh, .txt or .dat
    /// for pyshtools; .fits or .fit for healpy; .npy for s2fft, ktch and flowshape; .json or .csv for aics; .1D or .txt
    /// for afni; .csv for csv; .json for json.
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Print a report as JSON instead of text
    #[arg(long, help_heading = OUTPUT)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) common: Common,
}

/// Parses the value of `--normalization`.
pub(crate) fn normalization(text: &str) -> Result<Normalization, String> {
    let found = Normalization::ALL.into_iter().find(|normalization| normalization.name() == text);
    found.ok_or_else(|| "expected ortho, 4pi, schmidt or unnorm".to_owned())
}
