//! Reports on fits: on each target, on each batch, and on a whole call.

use serde::Serialize;
use spharm_solver::lsq::{Denoise, Gcv};
use spharm_solver::{LsqReport, ResidualNorms};
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::{Kind, Meta};

use crate::assess::{Distances, HeldOut, SurfaceDistances};
use crate::warning::FitWarning;

/// Report on the fit of one target.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct FitReport {
    /// Number of channels, c.
    pub channels: usize,
    /// Cube root of the bounding box's volume, in the target's unit; `None` for targets without volume.
    pub scale: Option<f64>,
    /// Mean squared distance between target and model at the vertices, with the bounding box scaled to volume 1; `None`
    /// for targets without volume.
    #[serde(skip)]
    pub msd: Option<f64>,
    /// Maximum squared distance between target and model at the vertices, with the bounding box scaled to volume 1;
    /// `None` for targets without volume.
    #[serde(skip)]
    pub xsd: Option<f64>,
    /// Mean squared distance at the centres of some triangles, with the bounding box scaled to volume 1; `None` for
    /// targets without volume or triangles.
    #[serde(skip)]
    pub off_vertex: Option<f64>,
    /// Distances at the vertices after each sweep; the last entry is for the final model.
    pub passes: Vec<Distances>,
    /// Distances from the model to its surface and from the surface to the model, if a surface was fitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_distance: Option<SurfaceDistances>,
    /// Distances at the centres of some of the triangles, for a surface over a sphere with triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub between: Option<Distances>,
    /// Distances at the held-out vertices and at the fitted vertices.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOut>,
    /// The noise that was estimated and removed: one entry for a surface, or one per channel. Empty without denoising.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub denoise: Vec<Denoised>,
    /// Smoothness penalty lambda; zero for the methods without a penalty. If each channel has a separate lambda, this
    /// is the largest one.
    #[serde(skip)]
    pub smoothness: f64,
    /// Smoothness penalty lambda of each channel, if it was chosen by cross-validation for each channel; else empty.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub smoothness_by_channel: Vec<f64>,
    /// Optimality reached by the full least squares.
    #[serde(skip)]
    pub optimality: Option<f64>,
    /// Possible problems with the fit.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<FitWarning>,
    /// Settings of the fit, for a model's provenance.
    #[serde(skip)]
    pub settings: Settings,
}

/// The noise that was removed from a surface, or from a channel of a signal.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Denoised {
    /// The removed noise, and the gain by which denoising multiplies the coefficients of each degree.
    #[serde(flatten)]
    pub noise: Denoise,
    /// Rms of the detail beyond the fit's degree, per channel, in the target's unit, estimated at held-out vertices;
    /// `None` if there are too few vertices for an estimate.
    pub left_out: Option<f64>,
    /// Power of the noise in the coefficients of degree 1 before denoising, divided by the power that the same noise
    /// would have there if the sampling were even.
    #[serde(skip)]
    pub relative_noise: f64,
}

/// Settings with which a target was fitted.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Settings {
    /// The method and its settings.
    pub method: crate::Method,
    /// Objective of the fit: [`Surface`](crate::Objective::Surface) or [`Vertices`](crate::Objective::Vertices).
    pub objective: crate::Objective,
    /// Allowed area distortion of the map of a mesh without a sphere, if it was given.
    pub area: Option<f64>,
    /// Name of the penalty: `default`, `fixed`, `auto` or `denoise`.
    pub penalty: &'static str,
    /// Name of the weights: `uniform`, `area`, or the name given with the values.
    pub weights: String,
    /// Hash of given weights; see [`Weights::hash`](crate::Weights::hash).
    pub weights_hash: Option<String>,
    /// Fraction of the vertices that was held out.
    pub hold_out: Option<f64>,
    /// Requested optimality.
    pub tolerance: f64,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// Requested preconditioner.
    pub preconditioner: crate::Preconditioner,
    /// Key of the sampling scheme.
    pub scheme: SchemeKey,
    /// Scalar type of the basis.
    pub scalar: Scalar,
    /// Whether the target is a surface or a signal.
    pub kind: Kind,
    /// Metadata of the target's file.
    pub meta: Meta,
}

/// Report on targets that were fitted together, by the kind of method that fitted them.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
#[non_exhaustive]
pub enum BatchReport {
    /// Report of a method over a store.
    Streamed(spharm_solver::IrfReport),
    /// Report of the full least squares.
    LeastSquares {
        /// The solver's report.
        #[serde(flatten)]
        report: LsqReport,
        /// The search for the smoothness, if it was chosen by cross-validation.
        #[serde(skip_serializing_if = "Option::is_none")]
        gcv: Option<Gcv>,
    },
    /// Report of quadrature.
    Quadrature {
        /// Highest degree, L.
        max_degree: usize,
        /// Numbers of rings and azimuths of the grid.
        grid: [usize; 2],
        /// Mean and maximum over the vertices of each target's squared residual, in the square of the target's unit.
        residuals: Vec<ResidualNorms>,
    },
}

impl BatchReport {
    /// Returns the optimality that the full least squares reached.
    pub fn optimality(&self) -> Option<f64> {
        match self {
            Self::LeastSquares { report, .. } => Some(report.optimality),
            _ => None,
        }
    }

    /// Returns the smoothness penalty lambda, or zero for the methods without a penalty.
    pub fn smoothness(&self) -> f64 {
        match self {
            Self::LeastSquares { report, .. } => report.smoothness,
            _ => 0.0,
        }
    }

    /// Returns the smoothness penalty lambda of each channel, if each channel has its own; else an empty list.
    pub fn smoothness_by_channel(&self) -> &[f64] {
        match self {
            Self::LeastSquares { gcv: Some(gcv), .. } => &gcv.by_channel,
            _ => &[],
        }
    }
}

/// Wall time of a call in seconds, by kind of work.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Seconds {
    /// Wall time of reading targets.
    pub read: f64,
    /// Wall time of checking the weights, computing the sampling's key, planning memory and preparing transforms.
    pub plan: f64,
    /// Wall time of solving.
    pub solve: f64,
    /// Wall time of assessing fits and passing them on.
    pub write: f64,
}

/// Report on a call that fitted many targets over one sphere.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ManyReport {
    /// Key of the sampling scheme.
    pub scheme: SchemeKey,
    /// Scalar type of the basis.
    pub scalar: Scalar,
    /// Reports on the batches of targets that were fitted together, in order.
    pub batches: Vec<BatchReport>,
    /// Indices of the targets of each batch, in the order of `batches`.
    pub targets: Vec<Vec<usize>>,
    /// Wall time of the call.
    pub seconds: Seconds,
}
