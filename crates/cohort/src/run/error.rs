//! Defines the errors that end the work on a row, or the whole run.

use std::fmt::Display;
use std::io::ErrorKind;
use std::path::PathBuf;

use spharm::parametrize::ParametrizeError;
use spharm::{Error, Interrupted, ModelError, SurfaceError};

use crate::CohortError;
use crate::rerun::Refusal;

/// Errors that affect one row or all rows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// A surface can't be read, mapped or fitted, or a model can't be written.
    #[error(transparent)]
    Fit(#[from] Error),
    /// A table can't be read, or a status file can't be written.
    #[error(transparent)]
    Table(#[from] CohortError),
    /// An existing output prevents the fit.
    #[error(transparent)]
    Output(#[from] Refusal),
    /// An output has the path of an input.
    #[error(
        "{}: this file is an input, but {what} would be written to it; choose another name for the output",
        .path.display()
    )]
    OutputIsInput {
        /// Path of the file.
        path: PathBuf,
        /// Kind of the output: the model, or a file beside the model.
        what: &'static str,
    },
    /// A label is given for a mesh, or for a surface that is to be fitted over a given sphere.
    #[error(
        "{}: a label can be given only for a volume without a sphere (.nii, .mgz, .nrrd, .tif, .npy)",
        .path.display()
    )]
    LabelOfMesh {
        /// Path of the surface's file.
        path: PathBuf,
    },
    /// An area distortion is given for the surface around a label, but the map of such a surface to the sphere always
    /// preserves areas.
    #[error(
        "{input}: area can be given only for meshes; the quadrangles around a label are always mapped to equal areas"
    )]
    AreaOfLabel {
        /// Description of the volume and its label.
        input: String,
    },
    /// A mask for signals is given for a surface.
    #[error(
        "{}: signal_mask ({}) applies only to signals, but this file is a surface; use --mask to exclude vertices of \
         surfaces",
        .path.display(), .mask.display()
    )]
    MaskedSurface {
        /// Path of the surface's file.
        path: PathBuf,
        /// Path of the mask.
        mask: PathBuf,
    },
    /// The weights given in the table are neither a known name nor an existing file.
    #[error("column weights: expected uniform, area or an existing file, found {}", .path.display())]
    NoWeights {
        /// The cell of the table, interpreted as a path.
        path: PathBuf,
    },
    /// A mask or missing values leave no vertex to fit.
    #[error("{}: all vertices are excluded by the mask or by missing values", .path.display())]
    NothingToRead {
        /// Path of the surface's file.
        path: PathBuf,
    },
    /// A warning, which is an error in a strict run.
    #[error("{0}")]
    Strict(String),
    /// An error that applies to all rows with the same sphere, as text.
    #[error("{0}")]
    Sphere(String),
    /// A file is missing.
    #[error("{}: no such file", .path.display())]
    Missing {
        /// Path of the file.
        path: PathBuf,
    },
    /// The caller's check of a surface failed.
    #[error("{0}")]
    Check(String),
    /// An error with the row or file in which it occurred.
    #[error("{context}")]
    Of {
        /// Name of the row, or path of its file.
        context: String,
        /// The error.
        source: Box<RunError>,
    },
}

impl RunError {
    /// Adds the row or file in which the error occurred.
    #[must_use]
    pub fn of(self, context: impl Display) -> Self {
        Self::Of { context: context.to_string(), source: Box::new(self) }
    }

    /// Returns the error if it is from the fit itself, otherwise `None`.
    pub(super) fn of_fit(&self) -> Option<&Error> {
        match self {
            Self::Fit(error) => Some(error),
            Self::Of { source, .. } => source.of_fit(),
            _ => None,
        }
    }

    /// Returns whether the run ended because it was cancelled.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        match self {
            Self::Fit(error) => error.is_interrupted(),
            Self::Of { source, .. } => source.is_interrupted(),
            _ => false,
        }
    }

    /// Returns whether all other rows would fail for the same reason: a full disk, an exceeded quota or file size, or a
    /// read-only file system.
    #[must_use]
    pub fn concerns_all(&self) -> bool {
        concerns_all(self)
    }

    /// Returns the messages of the error and of its sources as one line, without repetitions.
    #[must_use]
    pub fn line(&self) -> String {
        chained(self).replace(char::is_control, " ")
    }
}

/// Joins the messages of an error and of its sources. A message is skipped if an earlier message contains it. A file
/// name is skipped if the next message begins with it.
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

/// Returns whether an error or one of its sources is due to a full disk, an exceeded quota or file size, or a read-only
/// file system.
#[must_use]
pub fn concerns_all(error: &(dyn std::error::Error + 'static)) -> bool {
    use ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    // These kinds of errors occur only when writing.
    let io_of =
        |error: &SurfaceError| if let SurfaceError::Io { cause, .. } = error { Some(cause.kind()) } else { None };
    let of_fit = |error: &Error| match error {
        Error::Surface(error) | Error::Model(ModelError::Surface(error)) => io_of(error),
        _ => None,
    };
    let kind = |cause: &(dyn std::error::Error + 'static)| {
        let fit = match cause.downcast_ref() {
            Some(error) => RunError::of_fit(error),
            None => cause.downcast_ref(),
        };
        let io = || cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        fit.and_then(of_fit).or_else(|| cause.downcast_ref().and_then(io_of)).or_else(io)
    };
    std::iter::successors(Some(error), |&error| error.source())
        .filter_map(kind)
        .any(|kind| matches!(kind, StorageFull | QuotaExceeded | ReadOnlyFilesystem | FileTooLarge))
}
