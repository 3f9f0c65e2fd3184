//! What becomes of outputs that exist when a fit is run again.

use std::fmt;
use std::path::{Path, PathBuf};

use spharm::model::{Provenance, Settings};
use spharm::store::{Scalar, SchemeKey};
use spharm::{FileRecord, FitParams, Method, Model, Objective, Preparation, Smoothness, Sphere};

use crate::files::{ModelFiles, Replace};

/// What to do with outputs that exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IfExists {
    /// Refuse.
    Refuse,
    /// Skip a model that is the one asked for, and refuse another.
    Skip,
    /// Skip a model that is the one asked for, and replace that of another input or of other settings.
    Update,
    /// Replace them.
    Replace,
}

impl IfExists {
    /// Returns whether a model that is the one asked for is kept.
    #[must_use]
    pub fn keeps(self) -> bool {
        matches!(self, Self::Skip | Self::Update)
    }
}

/// The fit that is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// What the target is called, where it is from a table.
    pub id: Option<&'a str>,
    /// The target's file.
    pub input: &'a FileRecord,
    /// The sphere; `None` where the surface is mapped to one of its own.
    pub sphere: Option<&'a Sphere>,
    /// Settings.
    pub params: &'a FitParams,
    /// The file of the vertices whose values are read, where the others are continued from its edge.
    pub region: Option<&'a FileRecord>,
    /// What is done to the surface before the fit; of one over a sphere, nothing.
    pub preparation: Preparation,
    /// The model's file.
    pub output: &'a Path,
    /// Files beside the model that are asked for.
    pub beside: &'a [PathBuf],
    /// What to do where they exist.
    pub if_exists: IfExists,
}

/// What to do about a request.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// Nothing: the model and the files beside it are there.
    Skip,
    /// Fit.
    Fit {
        /// Which outputs that exist are replaced.
        replace: Replace,
        /// The other input whose model is replaced.
        replaces: Option<FileRecord>,
    },
}

/// An output that is in the way.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// It exists.
    #[error("{}: the output exists", .path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// It is the model of another input.
    #[error("{}: the model of {}, not of {}", .path.display(), .recorded, .input)]
    OtherInput {
        /// The model.
        path: PathBuf,
        /// What it is the model of.
        recorded: String,
        /// The input that was to be fitted.
        input: String,
    },
    /// It is the model of what the input's file was before.
    #[error("{}: the model of {input}, whose contents have changed since", .path.display())]
    Changed {
        /// The model.
        path: PathBuf,
        /// The input.
        input: String,
    },
    /// It is a model of the same input with other settings.
    #[error("{}: fitted with other settings: {}", .path.display(), list(.differences))]
    OtherSettings {
        /// The model.
        path: PathBuf,
        /// What differs.
        differences: Vec<Difference>,
    },
    /// It is a sphere, or the surface of a label, that wasn't made of the input.
    #[error("{}: not made of {input}, or it doesn't say so", .path.display())]
    OtherSphere {
        /// The file.
        path: PathBuf,
        /// The input that was to be mapped.
        input: String,
    },
    /// It doesn't record what it was made from.
    #[error("{}: no model, or one that doesn't record what it was made from", .path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
    },
}

/// A setting that differs between a model and a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The field of [`FitParams`], [`Method`] or [`Preparation`], `sphere` or `id`.
    pub setting: &'static str,
    /// What the model was fitted with.
    pub found: String,
    /// What is asked for.
    pub wanted: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}, not {}", self.setting.replace('_', "-"), self.found, self.wanted)
    }
}

/// Whether two regions are the same vertices, whatever their files are called.
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
    /// Decides what to do, from the outputs that exist and what the model among them records.
    ///
    /// With [`IfExists::Skip`] a model of the same input with the same settings is kept, and made again only where a
    /// file beside it is missing. Inputs are the same where their contents are. Without a model, files that an earlier
    /// call left are no obstacle, but for a sphere of another input. With [`IfExists::Update`] models of other inputs
    /// or settings are replaced in place of being refused.
    ///
    /// # Errors
    ///
    /// [`Refusal`] with the output that is in the way.
    pub fn decide(&self) -> Result<Decision, Refusal> {
        self.decide_by(&|| false)
    }

    /// Decides as [`decide`](Self::decide) does. `is_sound` says whether repairing and cutting leave the surface as it
    /// is, and is only asked where its model was made without what is asked for now.
    ///
    /// # Errors
    ///
    /// Those of [`decide`](Self::decide).
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
            // A model that is there by the time that this one is written is another process's, and stays.
            let replace = match (self.if_exists, in_the_way) {
                (IfExists::Replace, _) => Replace::ALL,
                (_, None) => Replace::default(),
                (IfExists::Refuse, Some(path)) => return Err(Refusal::Exists { path: path.to_owned() }),
                // What a broken-off fit left over is no obstacle to going on.
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
                differences.extend(self.unprepared(&model.provenance, is_sound));
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

    /// Refuses the sphere, and the surface of a label, that are beside the model and weren't made of this input.
    fn check_sphere(&self) -> Result<(), Refusal> {
        let files = ModelFiles { model: self.output.to_owned() };
        let own = [files.sphere(), files.surface()];
        let there = own.into_iter().find(|path| self.beside.contains(path) && path.exists());
        match there.filter(|_| !files.has_sphere_of(self.input)) {
            Some(path) => Err(Refusal::OtherSphere { path, input: self.input.to_string() }),
            None => Ok(()),
        }
    }

    /// Differences in what was done to the surface. A model is the same with and without a repair that had nothing to
    /// do.
    fn unprepared(&self, recorded: &Provenance, is_sound: &dyn Fn() -> bool) -> Vec<Difference> {
        let wanted = self.preparation;
        let mut differences = Vec::new();
        let same = match (recorded.voxel_size, wanted.voxel_size) {
            // A number that was written and read again may have lost its last bit.
            (Some(found), Some(wanted)) => found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= 1e-14 * b),
            (found, wanted) => found.is_none() && wanted.is_none(),
        };
        if !same {
            let name = |size: Option<[f64; 3]>| {
                size.map_or("the file's".to_owned(), |size| size.map(|size| size.to_string()).join(","))
            };
            let (found, wanted) = (name(recorded.voxel_size), name(wanted.voxel_size));
            differences.push(Difference { setting: "voxel_size", found, wanted });
        }
        let (repaired, cut) = (recorded.repair.is_some(), recorded.handles.is_some());
        // A label that was taken as it is has nothing to repair or to cut; a mesh may have.
        let as_it_is = self.input.label.is_some() && !repaired && !cut;
        // A repair of a label leaves no handles to cut.
        let without_handles = self.input.label.is_some() && repaired;
        let changed = [
            ("fix", recorded.fix || repaired, wanted.fix, repaired),
            ("cut_handles", recorded.cut_handles || cut, wanted.cut_handles && !without_handles, cut),
        ];
        let changed = changed.into_iter().filter(|&(_, found, wanted, mattered)| match (found, wanted) {
            (true, false) => mattered,
            (false, true) => !as_it_is,
            _ => false,
        });
        let changed: Vec<_> = changed.collect();
        let added = changed.iter().all(|&(_, found, ..)| !found);
        if changed.is_empty() || added && !repaired && !cut && is_sound() {
            return differences;
        }
        let word = |given: bool| if given { "yes" } else { "no" }.to_owned();
        let of = |(setting, found, wanted, _)| Difference { setting, found: word(found), wanted: word(wanted) };
        differences.extend(changed.into_iter().map(of));
        differences
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
            let name = |record: Option<&FileRecord>| record.map_or("none".to_owned(), ToString::to_string);
            check("region", name(provenance.region.as_ref()), format!("{}, as it is", name(self.region)));
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
            let area = |area: Option<f64>| area.map_or("the usual".to_owned(), |area| area.to_string());
            check("area", area(recorded.and_then(|settings| settings.area)), area(params.area));
        }
        check("passes", text(|s| s.passes.to_string()), method.passes().to_string());
        check("granularity", text(|s| option(s.granularity)), option(method.granularity()));
        check("start_degree", text(|s| option(s.start_degree)), option(method.start_degree()));
        check("accelerate", text(|s| s.accelerate.to_string()), method.accelerated().to_string());
        let hash = params.weights.hash();
        let recorded_hash = recorded.and_then(|settings| settings.weights_blake3.clone());
        // Weights from a file are the same where their values are, whatever it is called.
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
            ("tolerance", recorded.and_then(|settings| settings.tolerance), Some(params.tolerance)),
        ] {
            // A number that was written and read again may have lost its last bit.
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
    // As many digits as messages about stores show.
    scheme_key.map_or("of its own".to_owned(), |key| key.chars().take(12).collect())
}
