//! Errors of all steps, from reading a surface to writing its model.

use std::path::PathBuf;

use spharm_harmonics::HarmonicsError;
use spharm_model::ModelError;
use spharm_monitor::Interrupted;
use spharm_parametrize::ParametrizeError;
use spharm_register::RegisterError;
use spharm_shape::ShapeError;
use spharm_solver::SolverError;
use spharm_store::StoreError;
use spharm_surface::io::landmarks::FarGuide;
use spharm_surface::{Sphere, SurfaceError};
use spharm_transform::TransformError;

/// Errors of this crate, including the errors of the crates that it calls.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that can't be read, or a surface and a sphere that don't match.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A surface that can't be mapped to the sphere.
    #[error(transparent)]
    Parametrize(#[from] ParametrizeError),
    /// A basis or factor that can't be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A fit that can't be computed.
    #[error(transparent)]
    Solver(SolverError),
    /// Invalid directions or coefficients.
    #[error(transparent)]
    Harmonics(#[from] HarmonicsError),
    /// A transform that can't be planned or computed.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// The computation was asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
    /// An invalid model, or an invalid file that a model is made from.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Shapes that can't be analysed.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A template that can't be registered to a surface.
    #[error(transparent)]
    Register(#[from] RegisterError),
    /// A surface without area, or with coordinates that aren't finite.
    #[error("the surface has no area; expected triangles with finite coordinates and a positive area")]
    NoArea,
    /// An error that concerns one surface of a group.
    #[error("surface {index}: {source}")]
    Member {
        /// Index of the surface, counted from 0.
        index: usize,
        /// Error of the surface.
        source: Box<Error>,
    },
    /// A landmark that can't guide the registration.
    #[error("{0}")]
    FarGuide(FarGuide),
    /// A file in a group's folder with unexpected contents.
    #[error("{}: expected {expected}, found {found}", .path.display())]
    GroupFile {
        /// Path of the file.
        path: PathBuf,
        /// Expected contents.
        expected: String,
        /// Actual contents.
        found: String,
    },
    /// A setting with an invalid value, or a setting that is incompatible with another setting.
    #[error("{what} needs {expected}, found {found}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Valid values of the setting.
        expected: &'static str,
        /// Actual value of the setting.
        found: String,
    },
    /// A degree above the highest degree supported.
    #[error("degree {found} is above {most}, the highest supported degree")]
    Degree {
        /// The requested degree.
        found: usize,
        /// The highest supported degree.
        most: usize,
    },
    /// A method that needs a basis store, called without one.
    #[error("method {method} needs a basis store, but no basis store was given")]
    NeedsStore {
        /// Name of the method.
        method: &'static str,
    },
    /// A computation that integrates over triangles, on a sphere without triangles.
    #[error("{what} needs triangles, but {} has no triangles; give a sphere with triangles", .sphere.display())]
    NeedsTriangles {
        /// Computation that needs triangles, such as `quadrature`.
        what: &'static str,
        /// Path of the sphere's file.
        sphere: PathBuf,
    },
    /// A number of weights that differs from the number of vertices.
    #[error("{name}: expected one weight for each of the {expected} vertices, found {found}")]
    WeightCount {
        /// Name of the weights: a file name, or the name given with the values.
        name: String,
        /// Number of vertices.
        expected: usize,
        /// Number of weights.
        found: usize,
    },
    /// A weight that is negative or not finite, or weights that are all zero.
    #[error("{name}: weights must be finite, not negative and not all zero; vertex {vertex} has weight {found}")]
    Weight {
        /// Name of the weights.
        name: String,
        /// Index of the vertex, counted from 0.
        vertex: usize,
        /// Weight of the vertex.
        found: f64,
    },
    /// Weights that exclude every triangle of a surface.
    #[error("{name}: no triangle has positive weights at all three corners")]
    NoTriangle {
        /// Name of the weights.
        name: String,
    },
    /// A hold-out fraction so small that it selects no vertex.
    #[error("a hold-out fraction of {fraction} selects none of the {vertices} vertices; choose a larger fraction")]
    HoldOut {
        /// Requested fraction.
        fraction: f64,
        /// Number of vertices.
        vertices: usize,
    },
    /// A memory budget that is too small for the fit.
    #[error("a memory budget of {} is too small; at least {}MiB are needed", size(*.budget), .needed.div_ceil(1 << 20))]
    Memory {
        /// The budget in bytes.
        budget: usize,
        /// The smallest sufficient budget in bytes.
        needed: usize,
    },
    /// A resource limit of this process that the computation would exceed.
    #[error("this process's limit on {what} is {} MiB, but {} MiB are needed; raise the limit or use fewer threads", .limit >> 20, .needed.div_ceil(1 << 20))]
    Limit {
        /// Name of the limit.
        what: &'static str,
        /// Bytes allowed by the limit.
        limit: u64,
        /// Bytes needed by the computation.
        needed: u64,
    },
    /// The iteration ended before the tolerance was met. Occurs only if [`FitParams::strict`](crate::FitParams::strict)
    /// is set.
    #[error("{0}")]
    NotConverged(crate::FitWarning),
    /// A target whose coefficients exceed the range of f64.
    #[error(
        "the coefficient in row {row} of channel {channel} is {found}, which is not finite; divide the target's values \
         by the largest value"
    )]
    NotFinite {
        /// Row of the coefficients, l^2 + l + m.
        row: usize,
        /// Index of the channel, counted from 0.
        channel: usize,
        /// Value of the coefficient.
        found: f64,
    },
    /// Threads that the system can't start.
    #[error("cannot start {threads} threads: {message}")]
    Threads {
        /// Requested number of threads.
        threads: usize,
        /// The system's message.
        message: String,
    },
}

impl Error {
    pub(crate) fn area_without_triangles(sphere: &Sphere) -> Self {
        Self::NeedsTriangles { what: "the area of a vertex", sphere: sphere.name().to_owned() }
    }

    /// Adds the index of a group's surface to an error. Interruptions are returned unchanged, since they don't concern
    /// a single surface.
    pub(crate) fn of_member(index: usize, error: Self) -> Self {
        if error.is_interrupted() { error } else { Self::Member { index, source: Box::new(error) } }
    }

    /// Returns whether the error is an interruption, which means that the computation was asked to stop.
    pub fn is_interrupted(&self) -> bool {
        matches!(
            self,
            Self::Interrupted(_)
                | Self::Shape(ShapeError::Interrupted(_))
                | Self::Register(RegisterError::Interrupted(_))
                | Self::Surface(SurfaceError::Interrupted(_))
                | Self::Parametrize(ParametrizeError::Interrupted(_))
                | Self::Solver(SolverError::Interrupted(_) | SolverError::Store(StoreError::Interrupted(_)))
                | Self::Store(StoreError::Interrupted(_))
        )
    }
}

/// Formats a budget in MiB. A budget below 1 MiB is formatted in bytes, because the user has probably forgotten the
/// unit.
fn size(bytes: usize) -> String {
    let hundredths = (bytes as f64 / f64::from(1 << 20) * 100.0).floor();
    if bytes < 1 << 20 { format!("{bytes} bytes") } else { format!("{}MiB", hundredths / 100.0) }
}

impl From<SolverError> for Error {
    fn from(error: SolverError) -> Self {
        match error {
            SolverError::Limit { what, limit, needed } => Self::Limit { what, limit, needed },
            error => Self::Solver(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_shown_as_it_was_given() {
        let text = |budget: usize| Error::Memory { budget, needed: 43 << 20 }.to_string();
        assert_eq!(text(8 << 20), "a memory budget of 8MiB is too small; at least 43MiB are needed");
        assert!(text(10_000_000).contains("budget of 9.53MiB is") && text(1024).contains("budget of 1024 bytes is"));
    }
}
