//! Decides what happens to existing outputs when a fit is run again.

mod changes;

use std::path::{Path, PathBuf};

use spharm::model::Settings;
use spharm::store::{Scalar, SchemeKey};
use spharm::{FileRecord, FitParams, Method, Model, Objective, Preparation, Smoothness, Sphere};

pub use self::changes::Difference;
use self::changes::unprepared;
use crate::files::{ModelFiles, Replace};

/// Treatment of existing outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IfExists {
    /// Refuse the fit if any output exists.
    Refuse,
    /// Skip the fit if the existing model is the requested one; refuse the fit if the model has another input or other
    /// settings.
    Skip,
    /// Skip the fit if the existing model is the requested one; replace the model if it has another input or other
    /// settings.
    Update,
    /// Replace all existing outputs.
    Replace,
}

impl IfExists {
    /// Returns whether an existing model that matches the request is kept.
    #[must_use]
    pub fn keeps(self) -> bool {
        matches!(self, Self::Skip | Self::Update)
    }
}

/// A requested fit, for comparison with existing outputs.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Id of the target, if it is from a table.
    pub id: Option<&'a str>,
    /// Record of the target's file.
    pub input: &'a FileRecord,
    /// Sphere over which to fit, or `None` if the surface is to be mapped to a sphere first.
    pub sphere: Option<&'a Sphere>,
    /// Settings of the fit. If the settings don't name a scalar type, existing models of either type are kept.
    pub params: &'a FitParams,
    /// Record of the region's file, if a signal is read only within a region. Values outside the region are
    /// extrapolated from its edge.
    pub region: Option<&'a FileRecord>,
    /// Changes to be made to the surface before the fit. A surface over a given sphere isn't changed.
    pub preparation: Preparation,
    /// Path of the model.
    pub output: &'a Path,
    /// Paths of the requested files beside the model.
    pub beside: &'a [PathBuf],
    /// Treatment of existing outputs.
    pub if_exists: IfExists,
}

/// The decision about a requested fit.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// Skip the fit: the model and the files beside it exist.
    Skip,
    /// Run the fit.
    Fit {
        /// Existing outputs that the fit may replace.
        replace: Replace,
        /// With [`IfExists::Replace`], the input of the existing model if it differs from the requested input. `None`
        /// in all other cases.
        replaces: Option<FileRecord>,
    },
}

/// Reason for refusing a fit because of an existing output.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The output exists.
    #[error("{}: the output exists", .path.display())]
    Exists {
        /// Path of the file.
        path: PathBuf,
    },
    /// The existing model was made from another input.
    #[error("{}: the existing model was made from {}, not from {}", .path.display(), .recorded, .input)]
    OtherInput {
        /// Path of the model.
        path: PathBuf,
        /// The input recorded in the model.
        recorded: String,
        /// The requested input.
        input: String,
    },
    /// The existing model was made from an earlier version of the input's file.
    #[error("{}: the existing model was made from an earlier version of {input}", .path.display())]
    Changed {
        /// Path of the model.
        path: PathBuf,
        /// The input, which has changed since.
        input: String,
    },
    /// The existing model was made from the same input with other settings.
    #[error("{}: the existing model was fitted with other settings: {}", .path.display(), list(.differences))]
    OtherSettings {
        /// Path of the model.
        path: PathBuf,
        /// The settings that differ.
        differences: Vec<Difference>,
    },
    /// The existing sphere, or the existing surface around a label, wasn't made from the input.
    #[error("{}: the existing file wasn't made from {input}, or doesn't record its input", .path.display())]
    OtherSphere {
        /// Path of the sphere or surface.
        path: PathBuf,
        /// The input to be mapped.
        input: String,
    },
    /// The existing model can't be read, or doesn't record its input.
    #[error("{}: the existing file isn't a model, or doesn't record its input", .path.display())]
    Unknown {
        /// Path of the model.
        path: PathBuf,
    },
}

/// Returns whether two regions have the same contents, regardless of the names of their files.
fn same_region(found: Option<&FileRecord>, wanted: Option<&FileRecord>) -> bool {
    match (found, wanted) {
        (Some(found), Some(wanted)) => found.same_contents(wanted),
        (found, wanted) => found.is_none() && wanted.is_none(),
    }
}

fn list(differences: &[Difference]) -> String {
    differences.iter().map(Difference::to_string).collect::<Vec<_>>().join("; ")
}

impl Request<'_> {
    /// Decides whether to fit, depending on the existing outputs and the provenance of the existing model.
    ///
    /// With [`IfExists::Skip`], a model of the same input with the same settings is kept. The model is recomputed only
    /// if a requested file beside it is missing. Inputs are the same if the contents of their files are equal. If no
    /// model exists, files left by an earlier run are replaced, except a sphere made from another input. If the
    /// existing model has another input or other settings, [`IfExists::Update`] replaces it, and [`IfExists::Skip`]
    /// refuses the fit.
    ///
    /// # Errors
    ///
    /// [`Refusal`], which names the output that prevents the fit.
    pub fn decide(&self) -> Result<Decision, Refusal> {
        self.decide_by(&|| false)
    }

    /// Decides as [`decide`](Self::decide) does. `is_sound` returns whether repairing and cutting would leave the
    /// surface unchanged. `is_sound` has to read the surface, so it is called only if the request has repairs or cuts
    /// that the existing model was made without.
    ///
    /// # Errors
    ///
    /// The errors of [`decide`](Self::decide).
    pub fn decide_by(&self, is_sound: &dyn Fn() -> bool) -> Result<Decision, Refusal> {
        if self.if_exists == IfExists::Update {
            use Refusal::{Changed, OtherInput, OtherSettings, OtherSphere};
            return match (Request { if_exists: IfExists::Skip, ..*self }).decide_by(is_sound) {
                Err(Changed { .. } | OtherInput { .. } | OtherSettings { .. } | OtherSphere { .. }) => {
                    Ok(Decision::Fit { replace: Replace::ALL, replaces: None })
                }
                decided => decided,
            };
        }
        let path = || self.output.to_owned();
        let exists = self.output.exists();
        if !exists || self.if_exists == IfExists::Refuse {
            let in_the_way = std::iter::once(self.output).chain(self.beside.iter().map(PathBuf::as_path));
            let in_the_way = in_the_way.into_iter().find(|path| path.exists());
            // If no model exists now, `replace.model` stays false: a model that appears before this fit is written
            // belongs to another process and is kept.
            let replace = match (self.if_exists, in_the_way) {
                (IfExists::Replace, _) => Replace::ALL,
                (_, None) => Replace::default(),
                (IfExists::Refuse, Some(path)) => return Err(Refusal::Exists { path: path.to_owned() }),
                // Files left by an interrupted fit are replaced, so that the fit can be run again.
                (IfExists::Skip | IfExists::Update, Some(_)) => {
                    self.check_sphere()?;
                    Replace { model: false, beside: true }
                }
            };
            return Ok(Decision::Fit { replace, replaces: None });
        }
        let model = Model::read(self.output).ok();
        let recorded = model.as_ref().and_then(|model| Some((model, model.provenance.input.clone()?)));
        let other = |recorded: &FileRecord| !recorded.same_contents(self.input);
        match (self.if_exists, recorded) {
            (IfExists::Replace, recorded) => {
                let replaces = recorded.map(|(_, input)| input).filter(other);
                Ok(Decision::Fit { replace: Replace::ALL, replaces })
            }
            (_, None) => Err(Refusal::Unknown { path: path() }),
            (_, Some((_, recorded))) if other(&recorded) => {
                let (recorded, input) = (recorded.to_string(), self.input.to_string());
                Err(match recorded == input {
                    true => Refusal::Changed { path: path(), input },
                    false => Refusal::OtherInput { path: path(), recorded, input },
                })
            }
            (_, Some((model, _))) => {
                let mut differences = self.differences(model);
                differences.extend(unprepared(
                    self.preparation,
                    self.input.label.is_some(),
                    &model.provenance,
                    is_sound,
                ));
                if !differences.is_empty() {
                    return Err(Refusal::OtherSettings { path: path(), differences });
                }
                if self.beside.iter().all(|file| file.exists()) {
                    return Ok(Decision::Skip);
                }
                self.check_sphere()?;
                Ok(Decision::Fit { replace: Replace::ALL, replaces: None })
            }
        }
    }

    /// Refuses the fit if the file of the sphere, or of the surface around a label, already exists beside the model,
    /// unless it was made from this input.
    fn check_sphere(&self) -> Result<(), Refusal> {
        let files = ModelFiles { model: self.output.to_owned() };
        let own = [files.sphere(), files.surface()];
        let there = own.into_iter().find(|path| self.beside.contains(path) && path.exists());
        match there.filter(|_| !files.has_sphere_of(self.input)) {
            Some(path) => Err(Refusal::OtherSphere { path, input: self.input.to_string() }),
            None => Ok(()),
        }
    }

    fn differences(&self, model: &Model) -> Vec<Difference> {
        let params = self.params;
        let provenance = &model.provenance;
        let recorded = provenance.settings.as_ref();
        let mut differences = Vec::new();
        let mut check = |setting: &'static str, found: String, wanted: String| {
            if found != wanted {
                differences.push(Difference { setting, found, wanted });
            }
        };
        let text = |field: fn(&Settings) -> String| recorded.map_or("none".to_owned(), field);
        fn option(value: Option<usize>) -> String {
            value.map_or("none".to_owned(), |value| value.to_string())
        }
        if let (Some(found), Some(wanted)) = (&provenance.id, self.id) {
            check("id", found.clone(), wanted.to_owned());
        }
        let single = recorded.is_some_and(|settings| settings.dtype == Scalar::F32.name());
        let scalar = if single { Scalar::F32 } else { Scalar::F64 };
        if !same_region(provenance.region.as_ref(), self.region) {
            let found = provenance.region.as_ref().map_or("none".to_owned(), ToString::to_string);
            check("region", found, self.region.map_or("none".into(), |file| format!("the current contents of {file}")));
        }
        let wanted = self.sphere.map(|sphere| SchemeKey::of(&sphere.directions, scalar).to_string());
        let recorded_key = sphere_name(model.scheme_key.as_ref().filter(|_| !provenance.parametrized));
        check("sphere", recorded_key, sphere_name(wanted.as_ref()));
        check("dtype", scalar.name().to_owned(), params.scalar.unwrap_or(scalar).name().to_owned());
        check("max_degree", model.coefficients.max_degree().to_string(), params.max_degree.to_string());
        let method = &params.method;
        check("method", text(|s| s.method.clone()), method.name().to_owned());
        let triangles = self.sphere.is_none_or(|sphere| !sphere.faces.is_empty());
        let objective =
            if params.fits_surface(model.kind(), triangles) { Objective::Surface } else { Objective::Vertices };
        let recorded_objective = recorded.and_then(|settings| settings.objective.clone());
        check("objective", recorded_objective.unwrap_or("vertices".to_owned()), objective.name().to_owned());
        if self.sphere.is_none() {
            let area = |area: Option<f64>| area.map_or("the default".to_owned(), |area| area.to_string());
            check("area", area(recorded.and_then(|settings| settings.area)), area(params.area));
        }
        check("passes", text(|s| s.passes.to_string()), method.passes().to_string());
        check("granularity", text(|s| option(s.granularity)), option(method.granularity()));
        check("start_degree", text(|s| option(s.start_degree)), option(method.start_degree()));
        check("accelerate", text(|s| s.accelerate.to_string()), method.accelerated().to_string());
        let hash = params.weights.hash();
        let recorded_hash = recorded.and_then(|settings| settings.weights_blake3.clone());
        // Weights from files are compared by their values, regardless of the names of the files.
        if hash.is_none() || hash != recorded_hash {
            let name = text(|s| s.weights.clone());
            check("weights", weights_name(&name, recorded_hash), weights_name(params.weights.name(), hash));
        }
        let iterated = *method == Method::Lsq;
        check("max_iterations", text(|s| option(s.max_iterations)), option(iterated.then_some(params.max_iterations)));
        let preconditioner = iterated.then(|| params.preconditioner.to_string());
        let name = |name: Option<String>| name.unwrap_or_else(|| "unknown".to_owned());
        check("preconditioner", name(recorded.and_then(|s| s.preconditioner.clone())), name(preconditioner));
        if let (true, Some(Settings { converged: Some(false), optimality, .. })) = (params.strict, recorded) {
            let found = optimality.map_or("unknown".to_owned(), |optimality| format!("{optimality:.1e}"));
            check("optimality", found, format!("{:e}", params.tolerance));
        }
        let choice = recorded.and_then(|settings| settings.smoothness_choice.as_deref()).unwrap_or("none");
        check("smoothness", choice.to_owned(), params.penalty_name().to_owned());
        let fixed = match params.smoothness {
            Smoothness::Fixed(lambda) if choice == "fixed" => Some(lambda),
            _ => None,
        };
        for (setting, found, wanted) in [
            ("smoothness", fixed.and_then(|_| recorded.map(|settings| settings.smoothness)), fixed),
            ("hold_out", recorded.and_then(|settings| settings.hold_out), params.hold_out),
            // Ignore a tolerance recorded for a method without iterations: earlier versions recorded it for all
            // methods.
            (
                "tolerance",
                recorded.and_then(|settings| settings.tolerance.filter(|_| iterated)),
                iterated.then_some(params.tolerance),
            ),
        ] {
            // Compare with a tolerance, because writing and reading a number may change its last bit.
            let same = match (found, wanted) {
                (Some(found), Some(wanted)) => (found - wanted).abs() <= 1e-14 * wanted.abs(),
                (found, wanted) => found.is_none() && wanted.is_none(),
            };
            let text = |value: Option<f64>| value.map_or("none".to_owned(), |value| value.to_string());
            if !same {
                check(setting, text(found), text(wanted));
            }
        }
        differences
    }
}

fn weights_name(name: &str, hash: Option<String>) -> String {
    match hash {
        Some(hash) => format!("{name} ({})", hash.chars().take(12).collect::<String>()),
        None => name.to_owned(),
    }
}

fn sphere_name(scheme_key: Option<&String>) -> String {
    // Show the first 12 digits of the key, like messages about stores.
    scheme_key.map_or("made for the surface".to_owned(), |key| key.chars().take(12).collect())
}
