//! What can go wrong with shapes.

use spharm_monitor::Interrupted;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShapeError {
    /// Stopped by the monitor.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
