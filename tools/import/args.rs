//! Arguments of `import`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_exchange::{Format, Normalization};

use crate::export::{FORMATS, normalization};

/// Make a model from coefficients of another package
///
/// The format is detected from the contents. Give --from for arrays of ktch and FlowShape and for matrices of weighted
/// SPHARM, because their contents resemble other formats. The model has its own sphere only if --sphere is given or the
/// file is a SPHARM-MAT file. Evaluate a model without a sphere with `spharm reconstruct --icosphere N`.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm import a01_l_hippo.coef -o a01_l.spharm.npz",
        "spharm import earth.sh --normalization 4pi -o earth.spharm.npz",
        "spharm import body.x.sh body.y.sh body.z.sh -o body.spharm.npz",
        "spharm import shape.npy --from flowshape --sphere sphere.ply -o shape.spharm.npz",
    ],
    &[FORMATS],
))]
pub(crate) struct Cli {
    /// File of another package, or several files if each holds one channel
    #[arg(value_name = "FILE", required = true, help_heading = INPUT)]
    pub(super) files: Vec<PathBuf>,
    /// Format of the files [default: detected from the contents]
    #[arg(long, value_name = "FORMAT", help_heading = INPUT)]
    pub(super) from: Option<Format>,
    /// Sphere of the model: a mesh at whose vertices the model is evaluated
    #[arg(long, value_name = "SPHERE", help_heading = INPUT)]
    pub(super) sphere: Option<PathBuf>,
    /// Normalisation of pyshtools' harmonics: ortho, 4pi (pyshtools' own default), schmidt or unnorm
    #[arg(long, value_name = "NAME", default_value = "ortho", value_parser = normalization, help_heading = METHOD)]
    pub(super) normalization: Normalization,
    /// Condon-Shortley phase of pyshtools' harmonics: 1 without the phase (pyshtools' own default), -1 with it
    #[arg(
        long, value_name = "PHASE", default_value = "1", value_parser = csphase, allow_negative_numbers = true,
        help_heading = METHOD
    )]
    pub(super) csphase: i8,
    /// Treat three channels as a signal, not as x, y and z of a surface
    #[arg(long, help_heading = METHOD)]
    pub(super) signal: bool,
    /// Model to write
    #[arg(short, long, value_name = "MODEL.spharm.npz", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) common: Common,
}

/// Parses the value of `--csphase`.
fn csphase(text: &str) -> Result<i8, String> {
    match text {
        "1" => Ok(1),
        "-1" => Ok(-1),
        _ => Err("expected 1 or -1".to_owned()),
    }
}
