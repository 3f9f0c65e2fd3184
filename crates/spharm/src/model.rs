//! Makes models from fits, with their provenance.

use serde_json::Value;
use spharm_harmonics::Coefficients;
use spharm_model::Model;
pub use spharm_model::{CONVENTION, Distances, Fitted, Provenance, Settings, Versions, VoxelRecord};
use spharm_shape::smoothing::keep_penalty;
use spharm_store::format::VERSION as STORE_FORMAT;
use spharm_surface::{Kind, Sphere};

use crate::{Fit, FitReport, FitWarning, Method};

/// Returns the versions of this build: the crate, the store format and the platform.
pub fn versions() -> Versions {
    Versions {
        spharm: env!("CARGO_PKG_VERSION").to_owned(),
        store_format: STORE_FORMAT,
        platform: (std::env::consts::OS.to_owned(), std::env::consts::ARCH.to_owned()),
    }
}

/// Name of the provenance field that lists the operations on a model's coefficients after the fit, in order.
pub const TRANSFORM: &str = "transform";

/// Returns a model without a sphere, made by `tool` from coefficients.
#[must_use]
pub fn made(coefficients: Coefficients, kind: Kind, tool: &str) -> Model {
    signed(Model::without_sphere(coefficients, kind), tool)
}

/// Records in a model the tool that made it, and the versions of this build.
#[must_use]
pub fn signed(mut model: Model, tool: &str) -> Model {
    model.provenance.tool = Some(tool.to_owned());
    model.provenance.versions = Some(versions());
    model
}

/// Returns a model of coefficients that were derived from the coefficients of `source`, over the same sphere.
///
/// `transform` describes the operation, and is appended to the list [`TRANSFORM`] in the provenance. The settings and
/// distances of the fit are omitted, since the derived model isn't the result of that fit.
#[must_use]
pub fn transformed(source: &Model, coefficients: Coefficients, tool: &str, transform: Value) -> Model {
    let mut model = signed(Model { coefficients, ..source.clone() }, tool);
    let provenance = &mut model.provenance;
    keep_penalty(provenance.settings.as_ref(), &mut provenance.other);
    (provenance.settings, provenance.distances, provenance.surface_rms) = (None, None, None);
    match provenance.other.get_mut(TRANSFORM) {
        Some(Value::Array(steps)) => steps.push(transform),
        _ => drop(provenance.other.insert(TRANSFORM.to_owned(), Value::Array(vec![transform]))),
    }
    model
}

impl Fit {
    /// Returns the model of a surface or a signal over the sphere of the fit.
    #[must_use]
    pub fn into_model(self, sphere: Sphere) -> Model {
        let kind = self.report.settings.kind;
        Model::new(sphere, self, kind)
    }
}

impl From<Fit> for Fitted {
    fn from(fit: Fit) -> Self {
        let FitReport { settings, smoothness, optimality, scale, passes, surface_distance, warnings, .. } = &fit.report;
        let iterated = settings.method == Method::Lsq;
        let missed = warnings.iter().any(|warning| matches!(warning, FitWarning::NotConverged { .. }));
        let mut provenance = Provenance {
            tool: Some("fit".to_owned()),
            versions: Some(versions()),
            settings: Some(Settings {
                method: settings.method.name().to_owned(),
                objective: Some(settings.objective.name().to_owned()),
                area: settings.area,
                passes: settings.method.passes(),
                granularity: settings.method.granularity(),
                start_degree: settings.method.start_degree(),
                accelerate: settings.method.accelerated(),
                weights: settings.weights.clone(),
                weights_blake3: settings.weights_hash.clone(),
                hold_out: settings.hold_out,
                tolerance: iterated.then_some(settings.tolerance),
                max_iterations: iterated.then_some(settings.max_iterations),
                preconditioner: iterated.then(|| settings.preconditioner.to_string()),
                optimality: *optimality,
                converged: iterated.then_some(!missed),
                smoothness_choice: Some(settings.penalty.to_owned()),
                smoothness: *smoothness,
                dtype: settings.scalar.name().to_owned(),
            }),
            scale: *scale,
            distances: passes.last().copied(),
            surface_rms: surface_distance.map(|found| found.rms_raw),
            ..Provenance::default()
        };
        provenance.set_meta(&settings.meta);
        Self { scheme_key: Some(settings.scheme.to_string()), coefficients: fit.coefficients, provenance }
    }
}
