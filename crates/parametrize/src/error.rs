//! Defines the error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_monitor::number;
use spharm_surface::SurfaceError;
use spharm_surface::repair::{MeshRepair, Wrap};

use crate::mending::Mending;
use crate::volume::ImageChoice;
use crate::wrap::limits::VOXELS;

/// Errors of this crate's functions.
///
/// Each message is one line that says what was expected, what was found and, where possible, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParametrizeError {
    /// The mesh isn't a closed surface of genus zero, or has defects.
    #[error(
        "not a closed, clean surface of genus zero: {problems}; {}",
        mending.as_ref().map_or_else(|| (*remedy).to_owned(), ToString::to_string)
    )]
    BadSurface {
        /// The problems with their counts, one phrase each, joined by semicolons.
        problems: String,
        /// Number of handles (the genus) of a closed surface; 0 if the surface isn't closed.
        handles: usize,
        /// Advice to the user if there is no `mending`.
        remedy: &'static str,
        /// The repair that would close the surface, if such a repair exists.
        mending: Option<Box<Mending>>,
    },

    /// The mesh has coordinates that aren't finite or vertex numbers out of range, or a label's surface isn't a single
    /// closed surface of genus zero.
    #[error("not a closed, clean surface of genus zero: {problems}; {remedy}")]
    InvalidMesh {
        /// Description of the problem, including how often it occurs.
        problems: String,
        /// Advice to the user.
        remedy: &'static str,
    },

    /// The map isn't one to one: it has folds.
    #[error(
        "the {method} map to the sphere is not one to one: {flipped} of {triangles} triangles are flipped and \
         {degenerate} have no area; {remedy}"
    )]
    NotBijective {
        /// Name of the method that made the map.
        method: &'static str,
        /// Number of flipped triangles.
        flipped: usize,
        /// Number of triangles without area.
        degenerate: usize,
        /// Number of all triangles.
        triangles: usize,
        /// Advice to the user on how to avoid the folds.
        remedy: &'static str,
    },

    /// A vertex can't be placed on the sphere: the triangles around it are too small for the precision of f64.
    #[error(
        "vertex {vertex} (counted from 0) can't be placed on the sphere: the triangles around it are too small for \
         64-bit numbers; repair the thin triangles there, or remesh the surface"
    )]
    NoPlace {
        /// Index of the vertex.
        vertex: usize,
    },

    /// Some vertices without a value aren't connected by edges to any vertex with a value.
    #[error(
        "{vertices} vertices have no value, and some of these vertices aren't connected to any vertex with a value"
    )]
    Unfilled {
        /// Number of vertices without a value.
        vertices: usize,
    },

    /// The operating system couldn't read a file.
    #[error("{}: cannot read: {cause}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The error reported by the operating system.
        cause: io::Error,
    },

    /// The file isn't a label volume.
    #[error("{}: expected {expected}, found {found}", path.display())]
    NotAVolume {
        /// Path of the file.
        path: PathBuf,
        /// Expected kind or content of the file.
        expected: &'static str,
        /// Actual kind or content of the file.
        found: String,
    },

    /// A voxel's value isn't a label.
    #[error(
        "{}: expected 32-bit integers as labels, found {value} (voxel {voxel} of the file, counted from 0)",
        path.display()
    )]
    NotLabels {
        /// Path of the file.
        path: PathBuf,
        /// Value of the voxel.
        value: f64,
        /// Index of the voxel in the order of the file, from 0.
        voxel: usize,
    },

    /// A voxel's value isn't a probability.
    #[error(
        "{}: expected probabilities from 0 to 1, found {} (voxel {voxel} of the file, counted from 0)",
        path.display(), spharm_monitor::number(*value)
    )]
    NotProbability {
        /// Path of the file.
        path: PathBuf,
        /// Value of the voxel.
        value: f64,
        /// Index of the voxel in the order of the file, from 0.
        voxel: usize,
    },

    /// The file has several images and none is chosen, or the chosen image doesn't exist.
    #[error(
        "{}: the file has {} and {}; choose {} (chosen: {chosen})",
        path.display(), counted(*channels, "channel"), counted(*times, "time point"), to_choose(*channels, *times)
    )]
    SeveralImages {
        /// Path of the file.
        path: PathBuf,
        /// Number of channels in the file.
        channels: usize,
        /// Number of time points in the file.
        times: usize,
        /// The caller's choice.
        chosen: ImageChoice,
    },

    /// The volume's file doesn't specify the size of its voxels.
    #[error("{}: {format} doesn't record the voxel size", path.display())]
    NoVoxelSize {
        /// Path of the file.
        path: PathBuf,
        /// The file's format, with an article: "a NumPy array", for example.
        format: &'static str,
    },

    /// The order of axes z, y, x was given for a file whose format has a fixed order.
    #[error("{}: expected axes in the order xyz, which {format} always has, found zyx", path.display())]
    FixedAxes {
        /// Path of the file.
        path: PathBuf,
        /// The file's format, with an article: "a NIfTI file", for example.
        format: &'static str,
    },

    /// The file has a volume's format but holds values on the vertices of a surface.
    #[error("{}: expected a volume of labels, found values on {vertices} vertices", path.display())]
    VertexMap {
        /// Path of the file.
        path: PathBuf,
        /// Number of vertices: the only dimension of the file that isn't 1.
        vertices: usize,
    },

    /// The volume doesn't contain the chosen label, or it contains several labels and none was chosen.
    #[error(
        "{}: {}; the volume's labels: {there}",
        path.display(),
        label.map_or_else(|| "expected one label".to_owned(), |label| format!("no voxel has label {label}"))
    )]
    NoLabel {
        /// Path of the file.
        path: PathBuf,
        /// The chosen label, if any.
        label: Option<i64>,
        /// List of the volume's labels, with the number of voxels of each.
        there: String,
    },

    /// The label isn't a single ball of voxels: its surface isn't a single closed surface of genus zero.
    #[error(
        "{}: label {label} is not a single ball of voxels: {problems}; {}",
        path.display(),
        if *repairable { "repair or edit the label" } else { "edit the label" }
    )]
    BadVolume {
        /// Path of the file.
        path: PathBuf,
        /// Label whose voxels don't form a ball.
        label: i64,
        /// The problems with their counts, one phrase each, joined by semicolons.
        problems: String,
        /// Number of handles. They can be cut if the label has no other problems.
        handles: usize,
        /// Whether a repair can turn the label into one ball.
        repairable: bool,
    },

    /// An error from the crate `spharm-surface`.
    #[error(transparent)]
    Surface(SurfaceError),

    /// An error from the least-squares fit whose residual determines how areas are adapted.
    #[error(transparent)]
    Solver(#[from] spharm_solver::SolverError),

    /// The sphere would have folds after rounding to 32-bit numbers.
    #[error(
        "rounding to 32-bit numbers would flip {flipped} of the sphere's triangles; use a format with 64-bit numbers"
    )]
    SinglePrecision {
        /// Number of triangles that would be flipped or without area.
        flipped: usize,
    },

    /// The repair of a mesh would drop or add a large part of its surface.
    #[error(
        "a repair would change a large part of the surface, but at most {} % is allowed: {}",
        (1e4 * *most).round() / 1e2, repair.drops_and_fills()
    )]
    LargeRepair {
        /// The repair that wasn't accepted.
        repair: Box<MeshRepair>,
        /// The limit that the repair exceeds: the largest share of the area that it may drop, or that it may add.
        most: f64,
        /// Whether the repaired surface could be mapped to the sphere, perhaps after cutting its handles.
        succeeds: bool,
        /// Whether a wrap of the mesh would succeed instead, see [`would_wrap`](crate::wrap::would_wrap).
        wraps: bool,
    },

    /// The monitor asked to stop.
    #[error("interrupted")]
    Interrupted(#[from] spharm_monitor::Interrupted),

    /// The mesh encloses no voxel of the grid that is laid around it for a wrap.
    #[error(
        "the mesh encloses no voxel of a grid with {voxels} voxels along the longest side; a wrap needs a mesh that \
         encloses a body (the mesh may have holes); if the body is thin, use more voxels"
    )]
    NothingToWrap {
        /// Number of voxels along the longest side.
        voxels: usize,
    },

    /// A mesh to be wrapped has a vertex so far away that the rest of the mesh spans too few voxels of the grid.
    #[error(
        "vertex {vertex} (counted from 0) at ({}) lies far from the rest of the mesh: the rest spans {} of the \
         {voxels} voxels along the longest side, but at least 8 are needed; remove this vertex and its triangles{}",
        position.map(number).join(", "), number(*rest),
        enough.map(|enough| format!(", or use at least {enough} voxels")).unwrap_or_default()
    )]
    FarVertex {
        /// Index of the vertex.
        vertex: usize,
        /// Position of the vertex.
        position: [f64; 3],
        /// Number of voxels along the longest side of the rest of the mesh, without the far vertices.
        rest: f64,
        /// Number of voxels along the longest side of the mesh's bounding box.
        voxels: usize,
        /// Smallest value of `voxels` with which the rest of the mesh would span 8 voxels. `None` if no accepted value
        /// is large enough.
        enough: Option<usize>,
    },

    /// A wrap would leave out a large part of the mesh, or a large part of the wrap would span holes of the mesh.
    #[error("a wrap with {} voxels along the longest side would {}", wrap.voxels, flaw_of_wrap(wrap, *most))]
    LossyWrap {
        /// The wrap that wasn't accepted.
        wrap: Box<Wrap>,
        /// The limit that the wrap exceeds: either for the share of the mesh's area or of the body's voxels that the
        /// wrap leaves out, or for the share of the wrap's own area that spans holes.
        most: f64,
    },

    /// The mesh is an open sheet: closing it gives a surface without volume.
    #[error(
        "not a closed surface: the mesh is an open sheet with a rim as large as the sheet; the filling of the rim \
         would make up {:.0} % of the total area, and the filled surface would enclose no volume; use a surface that \
         encloses a body",
        100.0 * *filled
    )]
    OpenSheet {
        /// Area of the filling, divided by the area of the sheet and its filling together.
        filled: f64,
    },

    /// The mesh isn't orientable.
    #[error(
        "the surface is not orientable: it has one side only, like a Möbius strip or a Klein bottle, and encloses no \
         body; use a surface that has an inside and an outside"
    )]
    OneSided {
        /// Whether the mesh is closed, like a Klein bottle, rather than bounded by a rim, like a Moebius strip. A wrap
        /// around a closed mesh encloses a body.
        closed: bool,
    },

    /// Wrapping a mesh needs more memory than is free.
    #[error("wrapping with {voxels} voxels along the longest side needs {room}; use fewer voxels")]
    NoRoomToWrap {
        /// Number of voxels along the longest side.
        voxels: usize,
        /// The number of bytes needed and the number of bytes free.
        room: spharm_surface::io::NoRoom,
    },

    /// An argument has a value that isn't accepted.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// Name of the argument.
        what: &'static str,
        /// Accepted values.
        expected: &'static str,
        /// The value given.
        found: String,
    },
}

/// Returns a description of the choice that a file of several images requires: a channel, a time point or both.
fn to_choose(channels: usize, times: usize) -> &'static str {
    match (channels, times) {
        (1, 2..) => "one time point",
        (2.., 1) => "one channel",
        _ => "one channel and one time point",
    }
}

fn flaw_of_wrap(wrap: &Wrap, most: f64) -> String {
    let percent = (1e4 * most).round() / 1e2;
    if wrap.loss() > most {
        let (losses, remedy) = (wrap.losses(), remedy_for_losses(wrap, most));
        return format!("leave out a large part of the surface, but at most {percent} % is allowed: {losses}{remedy}");
    }
    let bridged = 100.0 * wrap.bridged_area;
    format!(
        "span large holes, but at most {percent} % is allowed: {bridged:.1} % of the wrap's area is farther than a \
         voxel from the mesh; use a surface that encloses a body, not an open sheet"
    )
}

fn remedy_for_losses(wrap: &Wrap, most: f64) -> &'static str {
    if wrap.left_out > most {
        "; the wrap keeps only one body; put the other bodies into separate files and fit them separately"
    } else if wrap.voxels < *VOXELS.end() {
        "; use more voxels to keep thin parts"
    } else {
        ""
    }
}

fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

impl From<SurfaceError> for ParametrizeError {
    fn from(error: SurfaceError) -> Self {
        match error {
            SurfaceError::Interrupted(interrupted) => Self::Interrupted(interrupted),
            error => Self::Surface(error),
        }
    }
}
