//! Defines the error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The operating system refused to open or read a file.
    #[error("{}: cannot open the model: {source}", .path.display())]
    Open {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A file from which a model was made can't be read.
    #[error("{}: {source}", .path.display())]
    Input {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file isn't an archive, or doesn't contain a valid model.
    #[error(
        "{}: not a SPHARM model: {problem}; expected a NumPy archive (.npz) with an array `coefficients`",
        .path.display()
    )]
    Invalid {
        /// Path of the file.
        path: PathBuf,
        /// Description of the problem.
        problem: String,
    },
    /// The file is a compressed model, which has to be expanded first.
    #[error("{}: the file is a compressed model (.sphz); expected a NumPy archive (.npz)", .path.display())]
    Compressed {
        /// Path of the file.
        path: PathBuf,
    },
    /// A coefficient is NaN or infinite. Models with such a coefficient can be neither read nor written.
    #[error("{}: coefficient {row} of channel {channel} is {value}; it must be finite", .path.display())]
    NonFinite {
        /// Path of the file.
        path: PathBuf,
        /// Row of the coefficients, `l^2 + l + m`.
        row: usize,
        /// Channel, from 0.
        channel: usize,
        /// Value of the coefficient.
        value: f64,
    },
    /// The operation needs the sphere of the model, but the model has no sphere.
    #[error("the model has no sphere of its own")]
    NoSphere,
    /// The requested degree exceeds the degree of the model.
    #[error("degree {degree} exceeds the highest degree of the model, {max_degree}")]
    DegreeTooHigh {
        /// The requested degree.
        degree: usize,
        /// Highest degree of the model.
        max_degree: usize,
    },
    /// A surface was requested, but the model is a model of a signal.
    #[error("expected a model of a surface, found a model of a signal with {channels} channels")]
    NotASurface {
        /// Number of channels of the model.
        channels: usize,
    },
    /// A surface was requested over a sphere without triangles.
    #[error("the directions have no triangles; give a sphere with triangles")]
    NoTriangles,
    /// The record of the surface's cuts contradicts the sphere.
    #[error("the model's record of the seams doesn't match its sphere: {0}; fit the surface again")]
    Seam(String),
    /// The harmonics can't be evaluated.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// The file can't be written.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
}
