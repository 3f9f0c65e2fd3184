//! Converts the library's errors to exceptions of `spharm_rs.errors`.

use std::io;
use std::path::Path;

use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use spharm::parametrize::ParametrizeError;
use spharm::parametrize::wrap::USUAL_VOXELS;
use spharm::register::RegisterError;
use spharm::shape::codec::CodecError;
use spharm::store::StoreError;
use spharm::{Error, ModelError, MomentsError, ShapeError, percent_to_allow, percent_to_wrap};
use spharm::{SolverError, SurfaceError};

/// Reason why a function failed.
pub(crate) enum Failure {
    /// An error of the library.
    Library(Error),
    /// An error of the library that concerns one of several surfaces.
    Member {
        /// Name of the surface.
        name: String,
        /// The error of the library.
        error: Box<Error>,
    },
    /// An error in the computation of moments.
    Moments(MomentsError),
    /// An error in compressing or expanding a model.
    Codec {
        /// Name of the file that is expanded.
        name: Option<String>,
        /// The error of the library.
        error: Box<CodecError>,
    },
    /// A computation needs more memory than is available.
    Memory {
        /// Description of the computation.
        what: String,
        /// Bytes available.
        budget: u64,
        /// Bytes needed.
        needed: u64,
        /// Whether the caller gave the memory budget. Otherwise the budget is the free memory.
        given: bool,
    },
    /// An argument is invalid. Such errors are found before the library is called.
    Argument(String),
    /// The library panicked, which is a bug.
    Panic,
}

impl<E: Into<Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Library(error.into())
    }
}

/// The exception class for an error, and the data of the exception.
enum Kind<'a> {
    Spharm,
    Mesh,
    Store(Option<&'a Path>),
    Memory { budget: u64, needed: u64 },
    Value,
    Runtime,
    Os { path: &'a Path, cause: &'a io::Error },
    Exists(&'a Path),
    Interrupted,
}

/// Returns the exception for a failure.
pub(crate) fn exception(py: Python<'_>, failure: Failure) -> PyErr {
    match failure {
        Failure::Library(error) => raised(py, &with_advice(&error), of(&error)),
        Failure::Member { name, error } => raised(py, &format!("{name}: {}", with_advice(&error)), of(&error)),
        Failure::Moments(error) => raised(py, &error.to_string(), of_moments(&error)),
        Failure::Codec { name, error } => {
            let file = name.map(|name| format!("{name}: ")).unwrap_or_default();
            let prefix = matches!(*error, CodecError::CutOff { level: Some(_), .. });
            let advice = if prefix { "; `spharm shape expand --prefix` reads this model" } else { "" };
            raised(py, &format!("{file}{error}{advice}"), of_codec(&error))
        }
        Failure::Memory { what, budget, needed, given } => {
            let size = |bytes: u64| format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20));
            let (needs, has) = (size(needed), size(budget));
            let text = if given {
                format!("{what} needs {needs} of memory, but memory= allows only {has}; give a larger memory=")
            } else {
                format!("{what} needs {needs} of memory, but only {has} are free")
            };
            raised(py, &text, Kind::Memory { budget, needed })
        }
        Failure::Argument(text) => PyValueError::new_err(text),
        Failure::Panic => {
            named(py, "SpharmError", "this is a bug in spharm-rs; please report it with the output on stderr")
        }
    }
}

/// Returns the text of an error, followed by advice in terms of the Python functions if any advice exists.
fn with_advice(error: &Error) -> String {
    let setting = |percent: u32| format!("largest_repair={:.2}", 0.01 * f64::from(percent));
    let largest = |repair| percent_to_allow(repair).map(setting);
    let around =
        || format!("spharm_rs.repair(surface, wrap={USUAL_VOXELS}) replaces the mesh by the closed surface around it");
    let advice = match error {
        Error::Parametrize(ParametrizeError::BadSurface { mending: Some(mending), .. }) => {
            let largest = largest(&mending.repair).map(|largest| format!(", {largest}")).unwrap_or_default();
            let cut = if mending.handles > 0 { " and give cut_handles=True" } else { "" };
            let fix = format!("call spharm_rs.repair(surface{largest}){cut}");
            Some(if mending.wraps { format!("{}; alternatively, {fix}", around()) } else { fix })
        }
        Error::Parametrize(ParametrizeError::BadSurface { handles: 1.., .. }) => {
            Some("cut_handles=True cuts the handles".to_owned())
        }
        Error::Parametrize(ParametrizeError::LargeRepair { repair, succeeds, wraps, .. }) => {
            let allow = largest(repair).filter(|_| *succeeds).map(|largest| format!("{largest} allows this repair"));
            let advice: Vec<String> = wraps.then(around).into_iter().chain(allow).collect();
            (!advice.is_empty()).then(|| advice.join("; alternatively, "))
        }
        Error::Parametrize(ParametrizeError::LossyWrap { wrap, .. }) => {
            Some(format!("{} allows this wrap", setting(percent_to_wrap(wrap))))
        }
        Error::Parametrize(
            ParametrizeError::BadSurface { mending: None, .. } | ParametrizeError::OneSided { closed: true },
        ) => Some(around()),
        Error::Shape(ShapeError::NotTwoGroups) => {
            Some("for other designs, except tests of positions, give variance_groups= instead of welch=True".to_owned())
        }
        Error::Model(ModelError::Compressed { .. }) => {
            Some("Model.load reads the file if its name ends in .sphz; `spharm shape expand` restores it".to_owned())
        }
        Error::Model(ModelError::NoSphere) => {
            Some("give a sphere, directions, or the subdivisions of an icosphere, such as 5".to_owned())
        }
        Error::Parametrize(ParametrizeError::NoVoxelSize { .. }) => {
            Some("give spacing= to parametrize_volume or fit_labels, or voxel_size= to fit_cohort".to_owned())
        }
        Error::Parametrize(ParametrizeError::FixedAxes { .. }) => {
            Some("omit axes=; it is for arrays and NumPy files".to_owned())
        }
        _ => None,
    };
    advice.map_or_else(|| error.to_string(), |advice| format!("{error}; {advice}"))
}

fn raised(py: Python<'_>, text: &str, kind: Kind<'_>) -> PyErr {
    match kind {
        Kind::Spharm => named(py, "SpharmError", text),
        Kind::Mesh => named(py, "MeshError", text),
        Kind::Store(path) => with(py, named(py, "StoreError", text), |value| {
            path.map_or(Ok(()), |path| value.setattr("filename", path.to_string_lossy()))
        }),
        Kind::Memory { budget, needed } => with(py, named(py, "MemoryBudgetError", text), |value| {
            value.setattr("budget", budget)?;
            value.setattr("needed", needed)
        }),
        Kind::Value => PyValueError::new_err(text.to_owned()),
        Kind::Runtime => PyRuntimeError::new_err(text.to_owned()),
        Kind::Interrupted => PyKeyboardInterrupt::new_err(()),
        // If called with these three arguments, OSError creates an instance of the subclass for the error code, such as
        // FileNotFoundError.
        Kind::Os { path, cause } => match cause.raw_os_error() {
            Some(code) => {
                let text = cause.to_string();
                let text = text.split(" (os error").next().unwrap_or_default().to_owned();
                PyOSError::new_err((code, text, path.to_string_lossy().into_owned()))
            }
            None if cause.kind() == io::ErrorKind::NotFound => {
                PyOSError::new_err((2, "No such file or directory", path.to_string_lossy().into_owned()))
            }
            None => PyOSError::new_err(text.to_owned()),
        },
        Kind::Exists(path) => {
            let exists = "File exists; overwrite=True replaces it";
            PyOSError::new_err((17, exists, path.to_string_lossy().into_owned()))
        }
    }
}

/// Returns an exception of the given class of `spharm_rs.errors`.
fn named(py: Python<'_>, class: &str, text: &str) -> PyErr {
    let made =
        py.import("spharm_rs.errors").and_then(|module| module.getattr(class)).and_then(|class| class.call1((text,)));
    made.map_or_else(|error| error, PyErr::from_value)
}

fn with(py: Python<'_>, error: PyErr, set: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<()>) -> PyErr {
    match set(error.value(py)) {
        Ok(()) => error,
        Err(other) => other,
    }
}

fn of(error: &Error) -> Kind<'_> {
    match error {
        _ if error.is_interrupted() => Kind::Interrupted,
        Error::Surface(error) => of_surface(error),
        Error::Parametrize(error) => match error {
            ParametrizeError::Surface(error) => of_surface(error),
            ParametrizeError::Solver(error) => of_solver(error),
            ParametrizeError::Io { path, cause, .. } => Kind::Os { path, cause },
            ParametrizeError::Argument { .. } | ParametrizeError::FixedAxes { .. } => Kind::Value,
            _ => Kind::Mesh,
        },
        Error::Store(error) => of_store(error),
        Error::Solver(error) => of_solver(error),
        Error::Model(error) => match error {
            ModelError::Open { path, source } | ModelError::Input { path, source } => Kind::Os { path, cause: source },
            ModelError::Surface(error) => of_surface(error),
            ModelError::Invalid { .. } | ModelError::Compressed { .. } | ModelError::NonFinite { .. } => Kind::Mesh,
            _ => Kind::Value,
        },
        Error::Member { source, .. } => of(source),
        Error::NoArea => Kind::Mesh,
        Error::Register(error) => match error {
            RegisterError::NoArea { .. } | RegisterError::Triangle { .. } => Kind::Mesh,
            RegisterError::Singular => Kind::Spharm,
            _ => Kind::Value,
        },
        Error::Memory { budget, needed } => memory(*budget as u64, *needed as u64),
        Error::Limit { limit, needed, .. } => memory(*limit, *needed),
        Error::Threads { .. } => Kind::Runtime,
        Error::NotConverged(_) => Kind::Spharm,
        _ => Kind::Value,
    }
}

fn memory<'a>(budget: u64, needed: u64) -> Kind<'a> {
    Kind::Memory { budget, needed }
}

fn of_moments(error: &MomentsError) -> Kind<'_> {
    match error {
        MomentsError::Io { path, source, .. } => Kind::Os { path, cause: source },
        MomentsError::Output(error) | MomentsError::Signal(error) => of_surface(error),
        MomentsError::Memory { needed, budget, .. } => memory(*budget as u64, *needed as u64),
        MomentsError::Interrupted(_) => Kind::Interrupted,
        MomentsError::Corrupt { .. } | MomentsError::Version { .. } => Kind::Spharm,
        _ => Kind::Value,
    }
}

fn of_codec(error: &CodecError) -> Kind<'_> {
    match error {
        CodecError::Magic { .. }
        | CodecError::Version { .. }
        | CodecError::Damaged { .. }
        | CodecError::CutOff { .. }
        | CodecError::Flat => Kind::Mesh,
        CodecError::Surface(error) => of_surface(error),
        CodecError::Interrupted(_) => Kind::Interrupted,
        _ => Kind::Value,
    }
}

fn of_surface(error: &SurfaceError) -> Kind<'_> {
    match error {
        SurfaceError::Io { path, cause, .. } => Kind::Os { path, cause },
        SurfaceError::OutputExists { path, .. } => Kind::Exists(path),
        SurfaceError::Argument { .. } | SurfaceError::LengthMismatch { .. } => Kind::Value,
        _ => Kind::Mesh,
    }
}

fn of_solver(error: &SolverError) -> Kind<'_> {
    match error {
        SolverError::Store(error) => of_store(error),
        SolverError::Budget { budget, needed, .. } => memory(*budget as u64, *needed as u64),
        SolverError::NotPositiveDefinite { .. } | SolverError::NoConvergence { .. } => Kind::Spharm,
        _ => Kind::Value,
    }
}

fn of_store(error: &StoreError) -> Kind<'_> {
    match error {
        StoreError::Budget { budget, needed } => memory(*budget as u64, *needed as u64),
        StoreError::Io { path, source, .. } => Kind::Os { path, cause: source },
        StoreError::Harmonics(_) | StoreError::ChunkRows { .. } => Kind::Value,
        StoreError::Space { path, .. } => Kind::Store(Some(path)),
        _ => Kind::Store(None),
    }
}
