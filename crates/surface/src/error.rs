//! The one error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_harmonics::HarmonicsError;

/// What can go wrong when a surface is read, checked, compared, drawn or written.
///
/// Each message is one line: the file, what was expected, what was found, what to do. What was made in memory goes by
/// "the surface" or "the sphere" in place of its path.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SurfaceError {
    /// The operating system refused.
    #[error("{}: cannot {action}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried, as a verb: "open", "write".
        action: &'static str,
        /// The system's error.
        cause: io::Error,
    },

    /// A directory, FIFO or device where a file is wanted.
    #[error("{}: expected a regular file, found {found}: give a file's path", path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
        /// What stands there.
        found: &'static str,
    },

    /// Neither the name nor the first bytes are those of a known format.
    #[error("{}: unknown format ({found}): expected {expected}", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// The names and formats that are supported.
        expected: String,
        /// The first bytes, or the extension.
        found: String,
    },

    /// A surface that has to keep the order of its vertices, and a format that doesn't keep it.
    #[error(
        "{}: {format} doesn't keep the order of the vertices, by which a surface and its sphere correspond: \
         write .surf.gii, .ply or .obj",
        path.display()
    )]
    LosesOrder {
        /// The file.
        path: PathBuf,
        /// The format that its name asks for.
        format: &'static str,
    },

    /// A volume or an image where a surface or values on vertices are wanted.
    #[error("{}: expected a surface or values on vertices, found a volume ({format})", path.display())]
    VolumeInput {
        /// The file.
        path: PathBuf,
        /// The volume's format.
        format: &'static str,
    },

    /// The bytes do not follow the format.
    #[error(
        "{}: damaged or not {format}: expected {expected}, found {found}; copy or export the file again",
        path.display()
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format it was read as.
        format: &'static str,
        /// What the format asks for, and where.
        expected: String,
        /// What was there.
        found: String,
    },

    /// A part of the format that is not read here.
    #[error("{}: {format} with {found} is not supported: {remedy}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The format it was read as.
        format: &'static str,
        /// The part in question.
        found: String,
        /// How to get around it.
        remedy: &'static str,
    },

    /// What the file holds takes more memory than is free.
    #[error("{}: what it holds takes {room}; give the program more, or make the file smaller", path.display())]
    NoRoom {
        /// The file.
        path: PathBuf,
        /// What is needed, and what is there.
        room: crate::room::NoRoom,
    },

    /// The file holds values on vertices where a surface is expected.
    #[error(
        "{}: expected a surface, found a signal ({vertices} vertices, {channels} values each): \
         give the surface's file (such as .surf.gii, .obj, lh.pial)",
        path.display()
    )]
    NotAMesh {
        /// The file.
        path: PathBuf,
        /// Vertices of the signal.
        vertices: usize,
        /// Values at each vertex.
        channels: usize,
    },

    /// The file holds a surface where values on vertices are expected.
    #[error(
        "{}: expected values on vertices, found a surface ({vertices} vertices, {faces} triangles): \
         give the signal's file (such as .func.gii, .shape.gii, .csv, lh.curv)",
        path.display()
    )]
    NotASignal {
        /// The file.
        path: PathBuf,
        /// Vertices of the surface.
        vertices: usize,
        /// Triangles of the surface.
        faces: usize,
    },

    /// A surface without vertices or faces, or a signal without values.
    #[error("{}: expected at least one {what}, found none: the file was exported empty", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What is missing: "vertex", "triangle", "value".
        what: &'static str,
    },

    /// NaN or infinity.
    #[error(
        "{}: expected finite numbers, found {value} at vertex {vertex} (counted from 0): \
         mend or mask the value and export again",
        path.display()
    )]
    NonFinite {
        /// The file.
        path: PathBuf,
        /// The first vertex concerned, counted from 0.
        vertex: usize,
        /// The value.
        value: f64,
    },

    /// A triangle names a vertex that isn't there.
    #[error(
        "{}: triangle {face} names vertex {index} (both counted from 0), expected an index below {vertices}: \
         the file is damaged or its parts belong to different surfaces",
        path.display()
    )]
    IndexOutOfRange {
        /// The file.
        path: PathBuf,
        /// The triangle, counted from 0, polygons having been split.
        face: usize,
        /// The index it holds, counted from 0.
        index: u32,
        /// How many vertices there are.
        vertices: usize,
    },

    /// More elements than this crate counts.
    #[error("{}: found {found} {what}, expected at most {limit}: simplify the surface", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// "vertices" or "triangles".
        what: &'static str,
        /// How many.
        found: usize,
        /// The most that are supported.
        limit: usize,
    },

    /// The output is there already.
    #[error("{}: the file exists", path.display())]
    OutputExists {
        /// The file.
        path: PathBuf,
    },

    /// The output cannot hold this number.
    #[error(
        "{}: {value} at vertex {vertex} does not fit a 32-bit float, which is what this format holds: \
         {remedy}",
        path.display()
    )]
    NotRepresentable {
        /// The file.
        path: PathBuf,
        /// The first vertex concerned, counted from 0.
        vertex: usize,
        /// The value.
        value: f64,
        /// Which option or format holds it.
        remedy: &'static str,
    },

    /// Two arrays that must go together have different lengths.
    #[error("{what}: expected {expected}, found {found}: both must come from the same surface")]
    LengthMismatch {
        /// What was counted.
        what: &'static str,
        /// The count that goes with the other array.
        expected: usize,
        /// The count found.
        found: usize,
    },

    /// Two surfaces do not share their triangles.
    #[error(
        "the surfaces' triangles differ, first at triangle {face} (counted from 0): expected {expected:?}, \
         found {found:?}; compare surfaces of one mesh, vertex for vertex"
    )]
    TopologyDiffers {
        /// The first triangle that differs.
        face: usize,
        /// The triangle of the first surface.
        expected: [u32; 3],
        /// The triangle of the second.
        found: [u32; 3],
    },

    /// A bounding box without volume gives no scale.
    #[error(
        "the surface's bounding box is {x} x {y} x {z}: expected three finite lengths above 0, \
         else no scale makes its volume 1; give a surface that isn't flat"
    )]
    FlatBox {
        /// Extent along x.
        x: f64,
        /// Extent along y.
        y: f64,
        /// Extent along z.
        z: f64,
    },

    /// A sphere's triangles leave directions out.
    #[error(
        "{missed} of {directions} directions (first: {first}, counted from 0) meet none of the sphere's triangles, \
         {flipped} of which are flipped: give a closed sphere around the origin whose triangles don't overlap"
    )]
    NotCovered {
        /// How many directions meet no triangle.
        missed: usize,
        /// Of how many.
        directions: usize,
        /// The first of them.
        first: usize,
        /// How many of the sphere's triangles are flipped or without area.
        flipped: usize,
    },

    /// A vertex of a sphere has no direction.
    #[error("{}: {cause}", path.display())]
    NoDirection {
        /// The sphere's file.
        path: PathBuf,
        /// Which vertex, and why.
        cause: HarmonicsError,
    },

    /// A table of directions that hasn't two columns.
    #[error("{}: expected two columns, theta and phi in radians, found {columns}", path.display())]
    NotAngles {
        /// The table.
        path: PathBuf,
        /// How many columns it has.
        columns: usize,
    },

    /// A colatitude outside of 0 to pi.
    #[error(
        "{}: row {row}: theta must be from 0 to pi (radians, from the pole), found {found}",
        path.display()
    )]
    Colatitude {
        /// The table.
        path: PathBuf,
        /// The row, counted from 0.
        row: usize,
        /// The colatitude found, in radians.
        found: f64,
    },

    /// A closed mesh that doesn't enclose the origin.
    #[error(
        "{}: the origin lies outside of this sphere; centre it at the origin, or is it the surface, not its sphere?",
        path.display()
    )]
    OriginOutside {
        /// The sphere's file.
        path: PathBuf,
    },

    /// A closed mesh that goes around the origin more than once.
    #[error("{}: this mesh goes {turns} times around the origin, not once; it is no sphere", path.display())]
    SeveralTurns {
        /// The sphere's file.
        path: PathBuf,
        /// How many times.
        turns: u64,
    },

    /// A surface or a signal with more or fewer vertices than the sphere.
    #[error("{}: {found} vertices, {} has {expected}; they must correspond", path.display(), named(sphere.as_ref()))]
    VertexCount {
        /// The surface's or the signal's file.
        path: PathBuf,
        /// The sphere's file, if it was read from one.
        sphere: Option<PathBuf>,
        /// The sphere's number of vertices.
        expected: usize,
        /// The number found.
        found: usize,
    },

    /// A mask that leaves out every vertex.
    #[error("{}: no vertex is left to read: the mask leaves out all of them", path.display())]
    NothingKept {
        /// The mask's file.
        path: PathBuf,
    },

    /// A surface whose triangles aren't the sphere's.
    #[error(
        "{}: its triangles are not those of {} ({differ} differ); the vertices must correspond",
        path.display(), named(sphere.as_ref())
    )]
    OtherTriangles {
        /// The surface's file.
        path: PathBuf,
        /// The sphere's file, if it was read from one.
        sphere: Option<PathBuf>,
        /// How many triangles one of the two has and the other hasn't.
        differ: usize,
    },

    /// A sphere's record of where its surface was cut doesn't fit the sphere.
    #[error("{}: its record of the seams, where the surface was cut, doesn't fit it: {found}; map the surface again", path.display())]
    Seam {
        /// The sphere's file.
        path: PathBuf,
        /// What doesn't fit.
        found: String,
    },

    /// The monitor asked to stop.
    #[error("interrupted")]
    Interrupted(#[from] spharm_monitor::Interrupted),

    /// An argument that makes no sense.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// Which argument.
        what: &'static str,
        /// Accepted values.
        expected: &'static str,
        /// What it was.
        found: String,
    },
}

/// A sphere as it is named within a sentence.
fn named(sphere: Option<&PathBuf>) -> String {
    sphere.map_or("the sphere".to_owned(), |path| format!("the sphere {}", path.display()))
}
