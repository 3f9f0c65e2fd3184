//! What can go wrong with shapes.

use spharm_harmonics::HarmonicsError;
use spharm_monitor::Interrupted;
use spharm_transform::TransformError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShapeError {
    /// Stopped by the monitor.
    #[error("{0}")]
    Interrupted(#[from] Interrupted),
    /// A model of a signal, where a surface is needed.
    #[error("expected a surface, whose coefficients have 3 columns, found a signal of {channels} channels")]
    NotASurface {
        /// Channels found.
        channels: usize,
    },
    /// A coefficient that is NaN or infinite.
    #[error("coefficient {row} of channel {channel} is {value}; it must be finite")]
    NotFinite {
        /// Row of the coefficients, `l^2 + l + m`.
        row: usize,
        /// Channel, counted from 0.
        channel: usize,
        /// The value.
        value: f64,
    },
    /// A model that is no surface: a point, or a curve on a line.
    #[error(
        "the model is {found}, not a surface: the degrees from 1 on have a coordinate rank of {rank}, at least 2 is needed"
    )]
    NoExtent {
        /// `a point` or `a line`.
        found: &'static str,
        /// Rank of the coefficients without degree 0.
        rank: usize,
    },
    /// A setting out of its range.
    #[error("{name} is {found}; {expected}")]
    Setting {
        /// What it is called.
        name: &'static str,
        /// Its value.
        found: String,
        /// What it has to be.
        expected: &'static str,
    },
    /// Models, or descriptors, that don't have the same shape.
    #[error("{what}: expected {expected}, found {found}")]
    Differ {
        /// What differs.
        what: &'static str,
        /// What the others have.
        expected: usize,
        /// What this one has.
        found: usize,
    },
    /// Directions or coefficients that are refused.
    #[error("{0}")]
    Harmonics(#[from] HarmonicsError),
    /// A transform that can't be made.
    #[error("{0}")]
    Transform(#[from] TransformError),
}
