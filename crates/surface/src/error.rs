//! Defines the error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_harmonics::HarmonicsError;

/// An error that occurred while a surface was read, checked, compared, drawn or written.
///
/// Each message is one line with the file's path, what was expected, what was found and, if possible, what to do.
/// For surfaces made in memory, "the surface" or "the sphere" stands in place of the path.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SurfaceError {
    /// The operating system reported an error.
    #[error("{}: cannot {action}: {cause}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The action that failed, as a verb: "open", "write".
        action: &'static str,
        /// The operating system's error.
        cause: io::Error,
    },

    /// The path is a directory, FIFO or device instead of a regular file.
    #[error("{}: expected a regular file, found {found}: give a file's path", path.display())]
    NotAFile {
        /// The path that isn't a regular file.
        path: PathBuf,
        /// What exists at the path instead, such as "a directory".
        found: &'static str,
    },

    /// The file is empty, and its name doesn't imply a format.
    #[error("{}: the file is empty", path.display())]
    EmptyFile {
        /// Path of the file.
        path: PathBuf,
    },

    /// Neither the name nor the first bytes match a known format.
    #[error("{}: unknown format ({found}): expected {expected}", path.display())]
    UnknownFormat {
        /// Path of the file.
        path: PathBuf,
        /// The supported names and formats.
        expected: String,
        /// The file's first bytes, or the extension of its name.
        found: String,
    },

    /// The format of the output doesn't preserve the order of the vertices, which this surface requires.
    #[error(
        "{}: {format} doesn't preserve the order of the vertices, which a surface and its sphere must share; write \
         .surf.gii, .ply or .obj",
        path.display()
    )]
    LosesOrder {
        /// Path of the file.
        path: PathBuf,
        /// The format implied by the file's name.
        format: &'static str,
    },

    /// The file holds a volume or an image instead of a surface or values on vertices.
    #[error("{}: expected a surface or values on vertices, found a volume ({format})", path.display())]
    VolumeInput {
        /// Path of the file.
        path: PathBuf,
        /// Name of the volume's format.
        format: &'static str,
    },

    /// The file's contents violate its format.
    #[error(
        "{}: damaged or not {format}: expected {expected}, found {found}; copy or export the file again",
        path.display()
    )]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// The format that the file was read as.
        format: &'static str,
        /// The format's requirement, with the position in the file.
        expected: String,
        /// The contents found at that position.
        found: String,
    },

    /// The file uses an unsupported feature of its format.
    #[error("{}: {format} with {found} is not supported: {remedy}", path.display())]
    Unsupported {
        /// Path of the file.
        path: PathBuf,
        /// The format that the file was read as.
        format: &'static str,
        /// The unsupported feature.
        found: String,
        /// Advice on how to avoid the unsupported feature.
        remedy: &'static str,
    },

    /// Reading the file needs more memory than is free.
    #[error("{}: the contents need {room}; make more memory available, or make the file smaller", path.display())]
    NoRoom {
        /// Path of the file.
        path: PathBuf,
        /// Number of bytes needed and number of bytes free.
        room: crate::room::NoRoom,
    },

    /// A surface is expected, but the file holds values on vertices.
    #[error(
        "{}: expected a surface, found values on {vertices} vertices ({channels} per vertex): \
         give a surface file, such as .surf.gii, .obj or lh.pial; to fit values, also give the sphere of their surface",
        path.display()
    )]
    NotAMesh {
        /// Path of the file.
        path: PathBuf,
        /// Number of vertices of the signal.
        vertices: usize,
        /// Number of values per vertex.
        channels: usize,
    },

    /// Values on vertices are expected, but the file holds a surface.
    #[error(
        "{}: expected values on vertices, found a surface ({vertices} vertices, {faces} triangles): \
         give a file of values, such as .func.gii, .shape.gii, .csv or lh.curv",
        path.display()
    )]
    NotASignal {
        /// Path of the file.
        path: PathBuf,
        /// Number of vertices of the surface.
        vertices: usize,
        /// Number of triangles of the surface.
        faces: usize,
    },

    /// The surface has no vertices or triangles, or the signal has no values.
    #[error("{}: expected at least one {what}, found none; export the file again", path.display())]
    Empty {
        /// Path of the file.
        path: PathBuf,
        /// The missing item: "vertex", "triangle" or "value".
        what: &'static str,
    },

    /// A coordinate or value is NaN or infinite.
    #[error(
        "{}: expected finite numbers, found {value} at vertex {vertex} (counted from 0); correct the value, or leave \
         the vertex out with a mask",
        path.display()
    )]
    NonFinite {
        /// Path of the file.
        path: PathBuf,
        /// Index of the first vertex with a NaN or infinite number, counted from 0.
        vertex: usize,
        /// The value found: NaN or an infinity.
        value: f64,
    },

    /// A triangle refers to a vertex that doesn't exist.
    #[error(
        "{}: triangle {face} refers to vertex {index} (both counted from 0), but there are only {vertices} vertices; \
         the file is damaged, or its vertices and triangles belong to different surfaces",
        path.display()
    )]
    IndexOutOfRange {
        /// Path of the file.
        path: PathBuf,
        /// Index of the triangle, counted from 0 after polygons were split into triangles.
        face: usize,
        /// The vertex index that is out of range, counted from 0.
        index: u32,
        /// Number of vertices of the surface.
        vertices: usize,
    },

    /// The surface has more vertices or triangles than this crate supports.
    #[error("{}: found {found} {what}, expected at most {limit}; simplify the surface", path.display())]
    TooLarge {
        /// Path of the file.
        path: PathBuf,
        /// "vertices" or "triangles".
        what: &'static str,
        /// Number of vertices or triangles found.
        found: usize,
        /// Largest supported number.
        limit: usize,
    },

    /// The output file already exists, and overwriting wasn't requested.
    #[error("{}: the file exists", path.display())]
    OutputExists {
        /// Path of the file.
        path: PathBuf,
    },

    /// The output format can't represent a number.
    #[error(
        "{}: {value:?} at vertex {vertex} does not fit the 32-bit floats of this format: {remedy}",
        path.display()
    )]
    NotRepresentable {
        /// Path of the file.
        path: PathBuf,
        /// Index, counted from 0, of the first vertex with a number that is too large. If all numbers are too small,
        /// index of the vertex with the largest number.
        vertex: usize,
        /// The number that can't be represented.
        value: f64,
        /// The option or format with which the number can be written.
        remedy: &'static str,
    },

    /// Two arrays that belong together have different lengths.
    #[error("number of {what}: expected {expected}, found {found}; all data must belong to the same surface")]
    LengthMismatch {
        /// Description of the elements, such as "vertices".
        what: &'static str,
        /// Number of elements that the array needs to match the other array.
        expected: usize,
        /// Number of elements found.
        found: usize,
    },

    /// Two surfaces that must have the same triangles have different triangles.
    #[error(
        "the surfaces' triangles differ, first at triangle {face} (counted from 0): expected {expected:?}, \
         found {found:?}; compare surfaces that have the same triangles"
    )]
    TopologyDiffers {
        /// Index of the first triangle that differs.
        face: usize,
        /// Vertices of that triangle in the first surface.
        expected: [u32; 3],
        /// Vertices of that triangle in the second surface.
        found: [u32; 3],
    },

    /// The surface's bounding box has no volume, so the surface can't be scaled to volume 1.
    #[error(
        "the surface's bounding box is {x} x {y} x {z}: expected three finite lengths above 0, \
         so that the box can be scaled to volume 1; give a surface that isn't flat"
    )]
    FlatBox {
        /// Extent along x.
        x: f64,
        /// Extent along y.
        y: f64,
        /// Extent along z.
        z: f64,
    },

    /// Some directions meet no triangle of a sphere.
    #[error(
        "{missed} of {directions} directions (first: direction {first}, counted from 0) meet no triangle of the sphere \
         ({flipped} of its triangles are flipped): give a closed sphere around the origin whose triangles don't overlap"
    )]
    NotCovered {
        /// Number of directions that meet no triangle.
        missed: usize,
        /// Total number of directions.
        directions: usize,
        /// Index of the first direction that meets no triangle.
        first: usize,
        /// Number of the sphere's triangles that are flipped or have no area.
        flipped: usize,
    },

    /// A vertex of a sphere has no direction: it is at the origin or not finite.
    #[error("{}: {cause}", path.display())]
    NoDirection {
        /// Path of the sphere's file.
        path: PathBuf,
        /// A message that names the vertex and states why it has no direction.
        cause: HarmonicsError,
    },

    /// A table of directions doesn't have two columns.
    #[error("{}: expected two columns (theta and phi, in radians), found {columns}", path.display())]
    NotAngles {
        /// Path of the table.
        path: PathBuf,
        /// Number of columns.
        columns: usize,
    },

    /// A colatitude or latitude is out of range.
    #[error("{}: row {row} (counted from 0): {column} must be {expected}, found {found}", path.display())]
    Colatitude {
        /// Path of the table.
        path: PathBuf,
        /// The row of the angle, counted from 0.
        row: usize,
        /// Name of the column.
        column: String,
        /// Description of the valid range, with its unit.
        expected: &'static str,
        /// The angle found, in the column's unit.
        found: f64,
    },

    /// A sphere's mesh is closed but doesn't enclose the origin.
    #[error(
        "{}: the origin lies outside this sphere; centre the sphere at the origin, and check that the file is a \
         sphere, not the surface itself",
        path.display()
    )]
    OriginOutside {
        /// Path of the sphere's file.
        path: PathBuf,
    },

    /// A sphere's mesh winds around the origin more than once.
    #[error("{}: not a sphere: the mesh winds around the origin {turns} times instead of once", path.display())]
    SeveralTurns {
        /// Path of the sphere's file.
        path: PathBuf,
        /// Number of times that the mesh winds around the origin.
        turns: u64,
    },

    /// A surface or signal doesn't have the sphere's number of vertices.
    #[error(
        "{}: found {found} vertices, but {} has {expected}; both must have the same vertices",
        path.display(), named(sphere.as_ref())
    )]
    VertexCount {
        /// Path of the surface's or signal's file.
        path: PathBuf,
        /// Path of the sphere's file, if it has one.
        sphere: Option<PathBuf>,
        /// The sphere's number of vertices.
        expected: usize,
        /// Number of vertices of the surface or signal.
        found: usize,
    },

    /// A mask excludes every vertex.
    #[error("{}: all vertices are excluded by the mask", path.display())]
    NothingKept {
        /// Path of the mask's file.
        path: PathBuf,
    },

    /// A surface doesn't have the sphere's triangles.
    #[error(
        "{}: {} between this surface and {}; both must have the same triangles",
        path.display(), differing(*differ), named(sphere.as_ref())
    )]
    OtherTriangles {
        /// Path of the surface's file.
        path: PathBuf,
        /// Path of the sphere's file, if it has one.
        sphere: Option<PathBuf>,
        /// Number of triangles that only one of the two meshes has.
        differ: usize,
    },

    /// The seam recorded in a sphere's file is inconsistent with the sphere.
    #[error("{}: the recorded seams don't match the sphere: {found}; map the surface again", path.display())]
    Seam {
        /// Path of the sphere's file.
        path: PathBuf,
        /// Description of the inconsistency.
        found: String,
    },

    /// The monitor asked to stop.
    #[error("interrupted")]
    Interrupted(#[from] spharm_monitor::Interrupted),

    /// An argument is invalid.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// Name of the argument.
        what: &'static str,
        /// Description of the accepted values.
        expected: &'static str,
        /// The value given.
        found: String,
    },
}

/// Returns the phrase "N triangles differ", or "1 triangle differs".
fn differing(triangles: usize) -> String {
    if triangles == 1 { "1 triangle differs".to_owned() } else { format!("{triangles} triangles differ") }
}

/// Returns "the sphere", followed by its path if it has one.
fn named(sphere: Option<&PathBuf>) -> String {
    sphere.map_or("the sphere".to_owned(), |path| format!("the sphere {}", path.display()))
}
