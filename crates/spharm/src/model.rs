//! From a fit to a model, with how it was made.

use spharm_model::{FileRecord, Model, Provenance, Versions};
use spharm_store::format::VERSION as STORE_FORMAT;
use spharm_surface::{Kind, Sphere};

use crate::Fit;

/// Returns the versions of this build.
pub fn versions() -> Versions {
    Versions {
        spharm: env!("CARGO_PKG_VERSION").to_owned(),
        store_format: STORE_FORMAT,
        platform: (std::env::consts::OS.to_owned(), std::env::consts::ARCH.to_owned()),
    }
}

/// Returns the model of a fit over a sphere; `input` is the target's file, where it has one.
pub fn model_of(sphere: &Sphere, fit: &Fit, input: Option<&FileRecord>) -> Model {
    let (report, settings) = (&fit.report, &fit.report.settings);
    let mut provenance = Provenance {
        tool: Some("fit".to_owned()),
        versions: Some(versions()),
        input: input.cloned(),
        sphere: sphere.path.as_deref().map(|path| path.to_string_lossy().into_owned()),
        parametrized: sphere.parametrized,
        settings: Some(spharm_model::Settings {
            method: settings.method.name().to_owned(),
            passes: settings.method.passes(),
            granularity: settings.method.granularity(),
            start_degree: settings.method.start_degree(),
            accelerate: settings.method.accelerated(),
            weights: settings.weights.clone(),
            hold_out: settings.hold_out,
            tolerance: Some(settings.tolerance),
            smoothness_choice: Some(settings.smoothness.name().to_owned()),
            smoothness: report.smoothness,
            dtype: settings.scalar.name().to_owned(),
        }),
        surface: Some(settings.kind == Kind::Surface),
        scale: report.scale,
        distances: report.passes.last().copied(),
        ..Provenance::default()
    };
    provenance.set_meta(&settings.meta);
    Model {
        coefficients: fit.coefficients.clone(),
        sphere: Some(sphere.clone()),
        scheme_key: Some(settings.scheme.to_string()),
        provenance,
    }
}
