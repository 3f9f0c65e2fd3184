//! The error type for compressing and expanding models.

use spharm_monitor::Interrupted;
use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

use crate::error::ShapeError;

/// Errors that occur when models are compressed or expanded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CodecError {
    /// A parameter that is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Parameter {
        /// Name of the parameter.
        what: &'static str,
        /// Allowed values.
        expected: String,
        /// The value found.
        found: String,
    },
    /// A coefficient that isn't finite, or a surface that is a point or a line.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A surface that lies in a plane.
    #[error(
        "the surface lies in a plane: distances are relative to the volume of its bounding box, which must be above 0"
    )]
    Flat,
    /// A model that exceeds a limit of the format.
    #[error("{what}: expected at most {most}, found {found}")]
    TooLarge {
        /// The quantity that exceeds its limit.
        what: &'static str,
        /// Largest value allowed.
        most: usize,
        /// The value found.
        found: usize,
    },
    /// A step so small that a coefficient exceeds the format's largest number of steps.
    #[error("the step {step:e} is too fine: a coefficient of {value:e} spans more than {most:e} steps")]
    TooFine {
        /// The step, in the model's unit.
        step: f64,
        /// Value of the coefficient.
        value: f64,
        /// Largest number of steps that the format allows.
        most: f64,
    },
    /// A requested size below the size of the smallest file. Only files whose surface is neither a point nor a line are
    /// considered.
    #[error(
        "{wanted} bytes are too few: the smallest possible file has {least} bytes, including {of_which} bytes of header"
    )]
    TooFewBytes {
        /// Number of bytes requested.
        wanted: usize,
        /// Size of the smallest file, in bytes.
        least: usize,
        /// Size of the smallest file's header in bytes, including the provenance.
        of_which: usize,
    },
    /// Data that isn't a compressed model.
    #[error("not a compressed model: expected the bytes {expected} at the start of the file, found {found}")]
    Magic {
        /// Expected first bytes.
        expected: String,
        /// The bytes found.
        found: String,
    },
    /// An unsupported version of the format.
    #[error(
        "the file has format version {found}, but this program reads version {expected}; expand the file with the \
         version of the program that made the file"
    )]
    Version {
        /// The supported version.
        expected: u8,
        /// The file's version.
        found: u8,
    },
    /// Bytes that violate the format, or that were changed after the file was written.
    #[error(
        "damaged file: {what}: expected {expected}, found {found}; compress the model again, or use another copy of the file"
    )]
    Damaged {
        /// Name of the damaged part of the file.
        what: &'static str,
        /// Expected content.
        expected: String,
        /// The content found.
        found: String,
    },
    /// A truncated file.
    #[error("truncated file: expected {expected} bytes, found {found}; {}", beginning(.level))]
    CutOff {
        /// Size of the complete file, or, if a prefix was allowed, of the shortest prefix that contains a model.
        expected: usize,
        /// Number of bytes found.
        found: usize,
        /// Highest degree of the coarser model that the bytes contain completely, if any.
        level: Option<usize>,
    },
    /// The model's surface can't be measured.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The model's surface can't be evaluated.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// Interrupted by the monitor.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}

fn beginning(level: &Option<usize>) -> String {
    match level {
        Some(degree) => format!("the bytes present contain a complete model of degree {degree}"),
        None => "the bytes present don't contain a complete model".to_owned(),
    }
}

impl CodecError {
    pub(super) fn damaged(what: &'static str, expected: impl ToString, found: impl ToString) -> Self {
        Self::Damaged { what, expected: expected.to_string(), found: found.to_string() }
    }
}
