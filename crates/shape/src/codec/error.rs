//! What can go wrong with compressed models.

use spharm_monitor::Interrupted;
use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

use crate::error::ShapeError;

/// Errors of compressing and expanding.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CodecError {
    /// A parameter out of its range.
    #[error("{what}: expected {expected}, found {found}")]
    Parameter {
        /// The parameter.
        what: &'static str,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A coefficient that isn't finite, or a surface that is a point or a line.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A surface in a plane.
    #[error(
        "the surface lies in a plane: expected one whose bounding box has a volume, by which distances are measured"
    )]
    Flat,
    /// A model that the format has no room for.
    #[error("{what}: at most {most}, found {found}")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// The most that there may be.
        most: usize,
        /// What there is.
        found: usize,
    },
    /// A step so fine that a coefficient has more of them than the format can count.
    #[error("the step {step:e} is too fine: a coefficient of {value:e} has more than {most:e} of them")]
    TooFine {
        /// The step, in the model's unit.
        step: f64,
        /// The coefficient.
        value: f64,
        /// The most steps.
        most: f64,
    },
    /// A number of bytes that not even the coarsest step comes down to.
    #[error("{wanted} bytes are too few: the coarsest file has {least}, {of_which} of them its head")]
    TooFewBytes {
        /// Bytes asked for.
        wanted: usize,
        /// Bytes of the smallest file.
        least: usize,
        /// Bytes of its head, which has the provenance.
        of_which: usize,
    },
    /// Not a compressed model.
    #[error("not a compressed model: expected the bytes {expected} at its start, found {found}")]
    Magic {
        /// What the format starts with.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A version of the format that isn't read.
    #[error("version {found} of the format; version {expected} is read: expand it with the program that made it")]
    Version {
        /// The version that is read.
        expected: u8,
        /// The file's version.
        found: u8,
    },
    /// Bytes that break the rules of the format, or changed since they were written.
    #[error("damaged: {what}: expected {expected}, found {found}; compress the model again, or take another copy")]
    Damaged {
        /// The part of the file.
        what: &'static str,
        /// What the format demands.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A file that ends too early.
    #[error("cut off: expected {expected} bytes, found {found}; {}", beginning(.level))]
    CutOff {
        /// Bytes of the whole file, or, where a beginning was asked for, of the first that holds a model.
        expected: usize,
        /// Bytes that are there.
        found: usize,
        /// Highest degree of the coarser model that is there whole, where there is one.
        level: Option<usize>,
    },
    /// The model's surface can't be measured.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The model's surface can't be evaluated.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// Stopped by the monitor.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}

fn beginning(level: &Option<usize>) -> String {
    match level {
        Some(degree) => format!("what is there holds a model of degree {degree}, which has to be asked for"),
        None => "what is there holds no model".to_owned(),
    }
}

impl CodecError {
    pub(super) fn damaged(what: &'static str, expected: impl ToString, found: impl ToString) -> Self {
        Self::Damaged { what, expected: expected.to_string(), found: found.to_string() }
    }
}
