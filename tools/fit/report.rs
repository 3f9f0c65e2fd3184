//! What is told of a fit: in the report, in each model, and as a table.

use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;
use spharm_cli::console::Console;
use spharm_cli::inputs::stem;
use spharm_cli::machine::{Memory, Versions, memory, versions};
use spharm_cli::output::{print, print_json, table, write_json};
use spharm_solver::lsq::{Gcv, LsqReport};
use spharm_solver::report::Residual;
use spharm_solver::{FitReport, Method};
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Kind, Target};

use super::hold_out::HeldOut;
use super::{Cli, How};

/// g, where the method has one that isn't infinite.
pub(crate) fn granularity_of(how: How) -> Option<usize> {
    match how {
        How::Streamed(Method::Irf { granularity, .. }) if granularity < usize::MAX => Some(granularity),
        _ => None,
    }
}

/// s, where the method has one.
pub(crate) fn start_degree_of(how: How) -> Option<usize> {
    match how {
        How::Streamed(Method::Sirf { start_degree } | Method::Mirf { start_degree, .. }) => Some(start_degree),
        _ => None,
    }
}

#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(crate) struct Seconds {
    pub(crate) read: f64,
    pub(crate) parametrize: f64,
    pub(crate) plan: f64,
    pub(crate) solve: f64,
    pub(crate) write: f64,
    pub(crate) total: f64,
}

/// A fitted surface, as the report shows it.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Fitted {
    pub(crate) input: PathBuf,
    pub(crate) output: PathBuf,
    pub(crate) channels: usize,
    /// Cube root of the bounding box's volume, in the input's unit; none for what has no volume.
    pub(crate) scale: Option<f64>,
    pub(crate) passes: Vec<Distances>,
    /// At the centres of some of the triangles, of a surface whose sphere has such.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) between: Option<Distances>,
    /// With --hold-out: apart for the vertices that the fit saw and didn't see.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) held_out: Option<HeldOut>,
    /// Without --sphere: the sphere that was made, and how.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) parametrization: Option<Mapped>,
}

/// How a surface came by its sphere.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Mapped {
    /// The file.
    pub(crate) sphere: PathBuf,
    #[serde(flatten)]
    pub(crate) report: spharm_parametrize::Report,
}

/// Distances after one sweep; msd and xsd with the bounding box scaled to volume 1.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct Distances {
    /// Whether this sweep came after the passes asked for, to remove what rounding had left.
    pub(crate) refinement: bool,
    pub(crate) msd: Option<f64>,
    pub(crate) xsd: Option<f64>,
    pub(crate) msd_raw: f64,
    pub(crate) xsd_raw: f64,
}

/// What is kept of a target while its values are being fitted.
pub(crate) struct About {
    pub(crate) surface: bool,
    pub(crate) scale: Option<f64>,
    pub(crate) anatomical_structure: Option<String>,
}

impl About {
    pub(crate) fn of(target: &Target) -> Self {
        let surface = target.kind == Kind::Surface;
        let scale = surface.then(|| {
            let vertices: Vec<[f64; 3]> = target.values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
            // A flat surface has no volume to scale to.
            bounding_box_scale(&vertices).ok()
        });
        Self { surface, scale: scale.flatten(), anatomical_structure: target.meta.anatomical_structure_primary.clone() }
    }

    /// From the mean and the maximum of the squared distances.
    pub(crate) fn of_residual(&self, mean_square: f64, max_square: f64, refinement: bool) -> Distances {
        let normalised = |value: f64| self.scale.map(|scale| value / (scale * scale));
        Distances {
            refinement,
            msd: normalised(mean_square),
            xsd: normalised(max_square),
            msd_raw: mean_square,
            xsd_raw: max_square,
        }
    }
}

/// What each way of fitting tells of a batch.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(crate) enum BatchReport {
    Streamed(FitReport),
    LeastSquares {
        #[serde(flatten)]
        report: LsqReport,
        /// The search for the smoothness.
        #[serde(skip_serializing_if = "Option::is_none")]
        gcv: Option<Gcv>,
    },
    Quadrature {
        max_degree: usize,
        /// Rings and azimuths.
        grid: [usize; 2],
        residuals: Vec<Residual>,
    },
}

impl BatchReport {
    /// Smoothness penalty, lambda; zero by the methods that have none.
    pub(crate) fn smoothness(&self) -> f64 {
        match self {
            Self::LeastSquares { report, .. } => report.smoothness,
            _ => 0.0,
        }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct Provenance<'a> {
    pub(crate) tool: &'static str,
    pub(crate) versions: Versions,
    pub(crate) input: Option<String>,
    pub(crate) sphere: Option<String>,
    pub(crate) method: &'static str,
    pub(crate) passes: usize,
    pub(crate) granularity: Option<usize>,
    pub(crate) start_degree: Option<usize>,
    pub(crate) weights: &'a str,
    /// Smoothness penalty, lambda.
    pub(crate) smoothness: f64,
    pub(crate) dtype: &'static str,
    pub(crate) surface: bool,
    pub(crate) scale: Option<f64>,
    pub(crate) distances: Option<Distances>,
    pub(crate) anatomical_structure_primary: Option<&'a str>,
}

#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) tool: &'static str,
    pub(crate) versions: Versions,
    pub(crate) method: &'static str,
    pub(crate) store: Option<PathBuf>,
    pub(crate) sphere: Option<PathBuf>,
    /// Of the sphere that all surfaces share.
    pub(crate) scheme_key: Option<String>,
    pub(crate) dtype: &'static str,
    pub(crate) weights: String,
    pub(crate) granularity: Option<usize>,
    pub(crate) start_degree: Option<usize>,
    pub(crate) openblas: String,
    pub(crate) surfaces: Vec<Fitted>,
    pub(crate) batches: Vec<BatchReport>,
    pub(crate) seconds: Seconds,
    pub(crate) memory: Memory,
}

pub(crate) fn finish(
    cli: &Cli,
    console: &Console,
    how: How,
    scheme: Option<(SchemeKey, Scalar)>,
    fits: (Vec<Fitted>, Vec<BatchReport>),
    seconds: Seconds,
) -> Result<()> {
    let (surfaces, batches) = fits;
    let report = Report {
        tool: "fit",
        versions: versions(),
        method: how.name(),
        store: cli.store.clone(),
        sphere: cli.sphere.clone(),
        scheme_key: scheme.map(|(key, _)| key.to_string()),
        dtype: scheme.map_or(Scalar::F64, |(_, scalar)| scalar).name(),
        weights: cli.weights.clone(),
        granularity: granularity_of(how),
        start_degree: start_degree_of(how),
        openblas: spharm_solver::dense::openblas(),
        surfaces,
        batches,
        seconds,
        memory: memory(),
    };
    let blocks = match report.batches.first() {
        Some(BatchReport::Streamed(report)) => &report.blocks[..],
        _ => &[],
    };
    for block in blocks.iter().filter(|block| block.rank < block.columns) {
        console.warn(format!(
            "degrees {} to {}: rank {} of {} columns; the sampling doesn't determine them, the solution of least norm was taken",
            block.first_degree, block.last_degree, block.rank, block.columns
        ));
    }
    if let Some(path) = &cli.report {
        write_json(path, cli.force, &report)?;
    }
    if cli.json {
        return print_json(&report);
    }
    let mut rows = vec![["surface", "msd", "xsd", "rms", "max", "between", "model"].map(str::to_owned).to_vec()];
    if cli.hold_out.is_some() {
        rows[0].insert(6, "msd held out".to_owned());
    }
    for fitted in &report.surfaces {
        let Some(last) = fitted.passes.last() else { continue };
        let normalised = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4e}"));
        let mut row = vec![
            stem(&fitted.input),
            normalised(last.msd),
            normalised(last.xsd),
            format!("{:.4e}", last.msd_raw.sqrt()),
            format!("{:.4e}", last.xsd_raw.sqrt()),
            fitted.between.map_or("-".to_owned(), |between| format!("{:.4e}", between.msd_raw.sqrt())),
            fitted.output.display().to_string(),
        ];
        if let Some(held_out) = &fitted.held_out {
            row.insert(6, normalised(held_out.held_out.msd.or(Some(held_out.held_out.msd_raw))));
        }
        rows.push(row);
    }
    let units =
        "msd, xsd: bounding box scaled to volume 1; rms, max: in the input's unit; between: rms at triangles' centres";
    print(&format!("{}\n{units}\n{:.2} s", table(&rows), seconds.total))
}
