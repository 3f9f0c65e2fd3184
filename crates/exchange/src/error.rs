//! Defines the error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_model::ModelError;
use spharm_surface::SurfaceError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// The operating system refused to open or read a file.
    #[error("{}: cannot read the file: {source}", .path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The contents violate the format.
    #[error("{}: damaged or not {format}: expected {expected}, found {found}", .path.display())]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Description of a file in the format, beginning with an article.
        format: &'static str,
        /// Content that the format requires.
        expected: String,
        /// Content found instead.
        found: String,
    },
    /// The file is intact, but it holds data other than coefficients, or coefficients in an unsupported format.
    #[error("{}: expected {format} with coefficients, found {found}; {remedy}", .path.display())]
    OtherContents {
        /// Path of the file.
        path: PathBuf,
        /// Description of a file in the format, beginning with an article.
        format: &'static str,
        /// The content found.
        found: &'static str,
        /// Advice on what the user can do with the content.
        remedy: &'static str,
    },
    /// The file's format can't be determined from its contents.
    #[error("{}: the format of the coefficients is ambiguous: found {found}; choose one of {remedy}", .path.display())]
    Unknown {
        /// Path of the file.
        path: PathBuf,
        /// Description of the file's contents.
        found: String,
        /// The formats that the file may have, from which the user has to choose.
        remedy: &'static str,
    },
    /// The format can't represent the model.
    #[error(
        "{format} files can only hold {holds}, but the model has {channels} channel{}{hint}",
        if *.channels == 1 { "" } else { "s" }
    )]
    CannotHold {
        /// Name of the package's format.
        format: &'static str,
        /// Description of the models that the format can represent.
        holds: &'static str,
        /// Number of channels of the model.
        channels: usize,
        /// Suggestion of an alternative, appended to the message.
        hint: &'static str,
    },
    /// The model's degree is too high for the normalisation, whose factors leave the range of 64-bit numbers.
    #[error(
        "normalisation {normalization}: expected a degree up to {highest}, found degree {degree}; choose another \
         normalisation, such as ortho"
    )]
    DegreeTooHigh {
        /// pyshtools' name of the normalisation.
        normalization: &'static str,
        /// Highest degree that the normalisation supports.
        highest: usize,
        /// The model's degree.
        degree: usize,
    },
    /// The format can only be written.
    #[error(
        "{}: files for {package} can be exported, but not imported: they hold one radius per direction, without \
         position and pose",
        .path.display()
    )]
    WrittenOnly {
        /// Path of the file to be read.
        path: PathBuf,
        /// Name of the package.
        package: &'static str,
    },
    /// A file that was to be joined with other files has several channels.
    #[error(
        "{}: the file has {channels} channels, but several files make one model only if each has one channel; import \
         each file by itself",
        .path.display()
    )]
    SeveralModels {
        /// Path of the file.
        path: PathBuf,
        /// Number of channels of the file.
        channels: usize,
    },
    /// The files of one model have different degrees.
    #[error("{}: the file has degree {found}, but {} has degree {expected}; all channels of a model must have the same degree", .path.display(), .first.display())]
    Degrees {
        /// Path of the file whose degree differs.
        path: PathBuf,
        /// Degree of this file.
        found: usize,
        /// Path of the first file of the model.
        first: PathBuf,
        /// Degree of the first file.
        expected: usize,
    },
    /// The files of one model have different formats.
    #[error("{}: the file is {found}, but {} is {expected}; all channels of a model must be in one format", .path.display(), .first.display())]
    Formats {
        /// Path of the file whose format differs.
        path: PathBuf,
        /// Description of this file's format, beginning with an article.
        found: &'static str,
        /// Path of the first file of the model.
        first: PathBuf,
        /// Description of the first file's format, beginning with an article.
        expected: &'static str,
    },
    /// The model can't be evaluated or written.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A file can't be written.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
}
