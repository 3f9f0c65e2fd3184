//! Errors that end a row or an entire run.

use std::fmt::Display;
use std::io::ErrorKind;
use std::path::PathBuf;

use spharm::parametrize::ParametrizeError;
use spharm::{Error, Interrupted, ModelError, SurfaceError};

use crate::CohortError;
use crate::rerun::Refusal;

/// Errors of a row, or of all rows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// A surface that can't be read, mapped or fitted, or a model that can't be written.
    #[error(transparent)]
    Fit(#[from] Error),
    /// A table that can't be read, or a status file that can't be written.
    #[error(transparent)]
    Table(#[from] CohortError),
    /// An output that exists.
    #[error(transparent)]
    Output(#[from] Refusal),
    /// An output with the name of an input.
    #[error("{}: the input; choose another name for the output", .path.display())]
    OutputIsInput {
        /// The file.
        path: PathBuf,
    },
    /// A label of a mesh, or of a surface over a sphere.
    #[error("{}: a label is for volumes without a sphere (.nii, .mgz, .nrrd, .tif, .npy)", .path.display())]
    LabelOfMesh {
        /// The surface's file.
        path: PathBuf,
    },
    /// An allowed area distortion for the map of a label's surface, which always has equal areas.
    #[error("{input}: area is for meshes; the quadrangles around a label are mapped with equal areas")]
    AreaOfLabel {
        /// The volume and its label.
        input: String,
    },
    /// Weights that aren't a file.
    #[error("column weights: expected uniform, area or a file, found {}, which isn't there", .path.display())]
    NoWeights {
        /// The cell of the table.
        path: PathBuf,
    },
    /// No vertex is left by a mask or by missing values.
    #[error("{}: no vertex is left to read", .path.display())]
    NothingToRead {
        /// The surface's file.
        path: PathBuf,
    },
    /// A warning, in a strict run.
    #[error("{0}")]
    Strict(String),
    /// The error of all rows over one sphere, as text.
    #[error("{0}")]
    Sphere(String),
    /// A file that is missing.
    #[error("{}: no such file", .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// An error of a caller's check.
    #[error("{0}")]
    Check(String),
    /// An error with its context.
    #[error("{context}")]
    Of {
        /// The row, or its file.
        context: String,
        /// The error.
        source: Box<RunError>,
    },
}

impl RunError {
    /// Adds the context to an error.
    #[must_use]
    pub fn of(self, context: impl Display) -> Self {
        Self::Of { context: context.to_string(), source: Box::new(self) }
    }

    /// Returns the error of the fit, if it is one.
    fn fit(&self) -> Option<&Error> {
        match self {
            Self::Fit(error) => Some(error),
            Self::Of { source, .. } => source.fit(),
            _ => None,
        }
    }

    /// Returns whether the error is an interruption: the run stopped because it was asked to.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        match self {
            Self::Fit(error) => error.is_interrupted(),
            Self::Of { source, .. } => source.is_interrupted(),
            _ => false,
        }
    }

    /// Returns whether every other row would fail for the same reason: no space for models, or no permission to write
    /// them.
    #[must_use]
    pub fn concerns_all(&self) -> bool {
        concerns_all(self)
    }

    /// Returns the messages of the error and its sources as one line, without repetitions.
    #[must_use]
    pub fn line(&self) -> String {
        chained(self).replace(char::is_control, " ")
    }
}

/// Joins the messages of an error and its sources. Skips repeated messages, and file names with which the next message
/// begins.
#[must_use]
pub fn chained(error: &(dyn std::error::Error + 'static)) -> String {
    let mut parts: Vec<String> = Vec::new();
    let causes = std::iter::successors(Some(error), |&error| error.source());
    for text in causes.map(ToString::to_string) {
        if parts.iter().any(|part| part.contains(&text)) {
            continue;
        }
        if parts.last().is_some_and(|last| text.starts_with(&format!("{last}: "))) {
            parts.pop();
        }
        parts.push(text);
    }
    parts.join(": ")
}

impl From<SurfaceError> for RunError {
    fn from(error: SurfaceError) -> Self {
        Self::Fit(error.into())
    }
}

impl From<ParametrizeError> for RunError {
    fn from(error: ParametrizeError) -> Self {
        Self::Fit(error.into())
    }
}

impl From<ModelError> for RunError {
    fn from(error: ModelError) -> Self {
        Self::Fit(error.into())
    }
}

impl From<Interrupted> for RunError {
    fn from(error: Interrupted) -> Self {
        Self::Fit(error.into())
    }
}

/// Returns whether an error, or one of its sources, is a lack of disk space, or of permission to write files.
#[must_use]
pub fn concerns_all(error: &(dyn std::error::Error + 'static)) -> bool {
    use ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    // None of these occurs when reading.
    let io_of =
        |error: &SurfaceError| if let SurfaceError::Io { cause, .. } = error { Some(cause.kind()) } else { None };
    let of_fit = |error: &Error| match error {
        Error::Surface(error) | Error::Model(ModelError::Surface(error)) => io_of(error),
        _ => None,
    };
    let kind = |cause: &(dyn std::error::Error + 'static)| {
        let fit = match cause.downcast_ref() {
            Some(error) => RunError::fit(error),
            None => cause.downcast_ref(),
        };
        let io = || cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        fit.and_then(of_fit).or_else(|| cause.downcast_ref().and_then(io_of)).or_else(io)
    };
    std::iter::successors(Some(error), |&error| error.source())
        .filter_map(kind)
        .any(|kind| matches!(kind, StorageFull | QuotaExceeded | ReadOnlyFilesystem | FileTooLarge))
}
