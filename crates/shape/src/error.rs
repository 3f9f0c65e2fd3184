//! What can go wrong with shapes.

use spharm_harmonics::HarmonicsError;
use spharm_monitor::Interrupted;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShapeError {
    /// Stopped by the monitor.
    #[error("{0}")]
    Interrupted(#[from] Interrupted),
    /// Directions or coefficients that the harmonics refuse.
    #[error("{0}")]
    Harmonics(#[from] HarmonicsError),
    /// Something else was given for a rotation.
    #[error("not a rotation: {problem}")]
    NotARotation {
        /// What is wrong.
        problem: String,
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
    /// Coefficients of a signal where a surface is needed.
    #[error("expected a surface, whose coefficients have 3 columns, found a signal of {channels} channels")]
    NotASurface {
        /// Channels found.
        channels: usize,
    },
    /// Models that don't have the same shape.
    #[error("{what}: expected {expected}, found {found}")]
    Differ {
        /// What differs.
        what: &'static str,
        /// What the others have.
        expected: usize,
        /// What this one has.
        found: usize,
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
    /// A group that is too small for what was asked.
    #[error("the group has {found} members, at least {least} are needed")]
    TooFewMembers {
        /// Members found.
        found: usize,
        /// Members needed.
        least: usize,
    },
    /// An error in one member of a group.
    #[error("member {index}: {source}")]
    Member {
        /// Its place in the group, counted from 0.
        index: usize,
        /// What is wrong.
        source: Box<ShapeError>,
    },
}
