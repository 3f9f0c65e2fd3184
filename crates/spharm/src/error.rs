//! What can go wrong between reading a surface and writing its model.

use std::path::PathBuf;

use spharm_harmonics::HarmonicsError;
use spharm_model::ModelError;
use spharm_monitor::Interrupted;
use spharm_parametrize::ParametrizeError;
use spharm_register::RegisterError;
use spharm_shape::ShapeError;
use spharm_solver::SolverError;
use spharm_store::StoreError;
use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

/// Errors of this crate. Those of the crates below it are its sources.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that can't be read, or surfaces and spheres that don't belong together.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A surface without a map to the sphere.
    #[error(transparent)]
    Parametrize(#[from] ParametrizeError),
    /// A basis or factor that can't be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A fit that can't be computed.
    #[error(transparent)]
    Solver(SolverError),
    /// Directions or coefficients that are refused.
    #[error(transparent)]
    Harmonics(#[from] HarmonicsError),
    /// A transform that can't be made.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// The computation was asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
    /// A model, or a file that one is made from.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Shapes that can't be analysed.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A template that can't be moved onto a surface.
    #[error(transparent)]
    Register(#[from] RegisterError),
    /// A surface without area, or with coordinates that aren't finite.
    #[error("the surface has no area; expected triangles with finite coordinates and a positive area")]
    NoArea,
    /// What is wrong with one surface of a group.
    #[error("surface {index}: {source}")]
    Member {
        /// The surface, counted from 0.
        index: usize,
        /// What is wrong.
        source: Box<Error>,
    },
    /// A file of a group's folder that isn't what it should be.
    #[error("{}: expected {expected}, found {found}", .path.display())]
    GroupFile {
        /// The file.
        path: PathBuf,
        /// What it should have.
        expected: String,
        /// What it has.
        found: String,
    },
    /// A setting that isn't one of its values, or doesn't go with another.
    #[error("{what} needs {expected}, found {found}")]
    Setting {
        /// The setting.
        what: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// A degree that the harmonics aren't computed to.
    #[error("degree {found} is above {most}, the highest supported degree")]
    Degree {
        /// The degree asked for.
        found: usize,
        /// The highest.
        most: usize,
    },
    /// A method that reads a basis, without a store.
    #[error("method {method} needs a basis store, and none was given")]
    NeedsStore {
        /// The method.
        method: &'static str,
    },
    /// Something that integrates over triangles, on a sphere that has none.
    #[error("{what} needs triangles, and {} has none; give a sphere mesh", .sphere.display())]
    NeedsTriangles {
        /// What needs them: `quadrature`, `density`, `area`.
        what: &'static str,
        /// The sphere.
        sphere: PathBuf,
    },
    /// Weights that aren't one for each vertex.
    #[error("{name}: expected one weight for each of {expected} vertices, found {found}")]
    WeightCount {
        /// The weights' name.
        name: String,
        /// Vertices.
        expected: usize,
        /// Weights.
        found: usize,
    },
    /// A weight that is negative or not finite, or weights that are all zero.
    #[error("{name}: weights must be finite, not negative and not all zero; vertex {vertex} has {found}")]
    Weight {
        /// The weights' name.
        name: String,
        /// Vertex, counted from 0.
        vertex: usize,
        /// Its weight.
        found: f64,
    },
    /// Weights that leave out every triangle of a surface.
    #[error("{name}: no triangle has positive weights at all three corners")]
    NoTriangle {
        /// The weights' name.
        name: String,
    },
    /// A fraction to hold out that leaves no vertex out.
    #[error("a hold-out fraction of {fraction} selects none of {vertices} vertices; choose a larger fraction")]
    HoldOut {
        /// The fraction.
        fraction: f64,
        /// Vertices.
        vertices: usize,
    },
    /// A memory budget below what the fit takes.
    #[error("a memory budget of {} MiB is too small for this fit, which needs {} MiB", .budget >> 20, .needed.div_ceil(1 << 20))]
    Memory {
        /// The budget, bytes.
        budget: usize,
        /// The least that works, bytes.
        needed: usize,
    },
    /// A limit on the process that the computation would exceed.
    #[error("this process's limit on {what} is {} MiB, but {} MiB are needed; raise the limit or use fewer threads", .limit >> 20, .needed.div_ceil(1 << 20))]
    Limit {
        /// Which limit.
        what: &'static str,
        /// Bytes allowed.
        limit: u64,
        /// Bytes needed.
        needed: u64,
    },
    /// With [`FitParams::strict`](crate::FitParams::strict): the iteration ended before the tolerance was met.
    #[error("{0}")]
    NotConverged(crate::FitWarning),
    /// A target whose coefficients leave the range of f64.
    #[error(
        "the coefficient in row {row} of channel {channel} is {found}, which is not finite; divide the target's values by the largest of them"
    )]
    NotFinite {
        /// Row of the coefficients, l^2 + l + m.
        row: usize,
        /// Channel, counted from 0.
        channel: usize,
        /// The coefficient.
        found: f64,
    },
    /// Threads that the system refuses.
    #[error("cannot start {threads} threads: {message}")]
    Threads {
        /// How many were asked for.
        threads: usize,
        /// Why.
        message: String,
    },
}

impl Error {
    /// Says which surface of a group an error is of; that a computation was asked to stop isn't.
    pub(crate) fn of_member(index: usize, error: Self) -> Self {
        if error.is_interrupted() { error } else { Self::Member { index, source: Box::new(error) } }
    }

    /// Returns whether the computation was asked to stop, and did.
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

impl From<SolverError> for Error {
    fn from(error: SolverError) -> Self {
        match error {
            SolverError::Limit { what, limit, needed } => Self::Limit { what, limit, needed },
            error => Self::Solver(error),
        }
    }
}
