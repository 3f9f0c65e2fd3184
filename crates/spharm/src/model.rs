//! From a fit to a model, with how it was made.

use serde::Serialize;
use spharm_store::format::VERSION as STORE_FORMAT;
use spharm_surface::{Kind, Model, Sphere};

use crate::Fit;
use crate::assess::Distances;

/// Versions that a result may depend on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Versions {
    /// This library and its programs.
    pub spharm: &'static str,
    /// The store's format.
    pub store_format: u32,
    /// Operating system and processor.
    pub platform: (&'static str, &'static str),
}

impl Versions {
    /// Returns the versions of this build.
    pub fn current() -> Self {
        Self {
            spharm: env!("CARGO_PKG_VERSION"),
            store_format: STORE_FORMAT,
            platform: (std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

#[derive(Debug, Serialize)]
struct Provenance<'a> {
    tool: &'static str,
    versions: Versions,
    input: Option<&'a str>,
    sphere: Option<String>,
    method: &'static str,
    passes: usize,
    granularity: Option<usize>,
    start_degree: Option<usize>,
    weights: &'a str,
    /// Smoothness penalty, lambda.
    smoothness: f64,
    dtype: &'static str,
    surface: bool,
    scale: Option<f64>,
    distances: Option<Distances>,
    anatomical_structure_primary: Option<&'a str>,
}

/// Returns the model of a fit over a sphere; `input` is the name of the target's file, where it has one.
pub fn model_of(sphere: &Sphere, fit: &Fit, input: Option<&str>) -> Model {
    let (report, settings) = (&fit.report, &fit.report.settings);
    let name = |path: &std::path::Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let provenance = Provenance {
        tool: "fit",
        versions: Versions::current(),
        input,
        sphere: sphere.path.as_deref().and_then(name),
        method: settings.method.name(),
        passes: settings.method.passes(),
        granularity: settings.method.granularity(),
        start_degree: settings.method.start_degree(),
        weights: &settings.weights,
        smoothness: report.smoothness,
        dtype: settings.scalar.name(),
        surface: settings.kind == Kind::Surface,
        scale: report.scale,
        distances: report.passes.last().copied(),
        anatomical_structure_primary: settings.meta.anatomical_structure_primary.as_deref(),
    };
    Model {
        coefficients: fit.coefficients.clone(),
        directions: sphere.directions.as_slice().to_vec(),
        faces: sphere.faces.clone(),
        scheme_key: settings.scheme.to_string(),
        provenance: serde_json::to_string(&provenance).unwrap_or_default(),
    }
}
