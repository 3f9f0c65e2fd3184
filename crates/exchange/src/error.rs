//! The error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_model::ModelError;
use spharm_surface::SurfaceError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// The operating system refused to open or read a file.
    #[error("{}: cannot be read: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The contents violate the format.
    #[error("{}: damaged or not {format}: expected {expected}, found {found}", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format, with its article.
        format: &'static str,
        /// Expected content.
        expected: String,
        /// The content found.
        found: String,
    },
    /// The file's format can't be determined from its contents.
    #[error("{}: cannot tell the format of its coefficients, {found}; expected {remedy}", .path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// Description of its contents.
        found: String,
        /// Formats that it may have.
        remedy: &'static str,
    },
    /// A format that can't hold the model.
    #[error(
        "{format} holds {holds}; the model has {channels} channel{}{hint}",
        if *.channels == 1 { "" } else { "s" }
    )]
    CannotHold {
        /// Name of the package's format.
        format: &'static str,
        /// The models that it can hold.
        holds: &'static str,
        /// Number of channels of the model.
        channels: usize,
        /// Hint at an alternative.
        hint: &'static str,
    },
    /// A format that can only be written.
    #[error(
        "{}: files for {package} are written, not read: they hold one radius per direction, without position and pose",
        .path.display()
    )]
    WrittenOnly {
        /// The file.
        path: PathBuf,
        /// The package.
        package: &'static str,
    },
    /// Files of one model whose degrees differ.
    #[error("{}: degree {found}; {} has degree {expected}", .path.display(), .first.display())]
    Degrees {
        /// The file.
        path: PathBuf,
        /// Its degree.
        found: usize,
        /// The first file.
        first: PathBuf,
        /// The first file's degree.
        expected: usize,
    },
    /// Files of one model whose formats differ.
    #[error("{}: {found}, {} is {expected}; all channels of a model must be in one format", .path.display(), .first.display())]
    Formats {
        /// The file.
        path: PathBuf,
        /// Its format, with its article.
        found: &'static str,
        /// The first file.
        first: PathBuf,
        /// The first file's format.
        expected: &'static str,
    },
    /// The model can't be evaluated or written.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A file can't be written.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
}
