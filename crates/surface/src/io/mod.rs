//! Reads and writes surfaces and signals, with one file of source code per format.
//!
//! | format | names | read | written |
//! |---|---|---|---|
//! | FreeSurfer | `lh.pial`, `rh.curv`, ... | triangle surfaces, new-format curv | as read |
//! | FreeSurfer | `.mgh`, `.mgz` | signals: a frame per channel | as read |
//! | GIfTI | `.gii`, `.surf.gii`, `.func.gii`, `.shape.gii` | all encodings except external files | GZipBase64Binary |
//! | Wavefront | `.obj` | polygons, negative indices, continued lines | ASCII |
//! | Stanford | `.ply` | ASCII, binary of both byte orders, polygons, strips | little-endian binary |
//! | Geomview | `.off` | ASCII, polygons, with colours or normals | ASCII |
//! | STL | `.stl` | ASCII, binary; equal vertices welded | binary |
//! | VTK legacy | `.vtk` | PolyData, grids of surface cells, ASCII and binary, up to version 5.1 | ASCII |
//! | VTK XML | `.vtp`, `.vtu` | PolyData, grids of surface cells, all encodings but LZMA | `.vtp`: zlib, 64 bits |
//! | MetaMesh | `.meta` | SPHARM-PDM's text: triangles and polygons | - |
//! | glTF 2.0 | `.glb`, `.gltf` | triangles of the scene; equal vertices welded | `.glb` with normals, for viewers |
//! | 3MF | `.3mf` | objects of the build | one object |
//! | VRML 97 | `.wrl` | IndexedFaceSets of the scene | - |
//! | NumPy | `.npy` | signals: arrays with one or two axes | - |
//! | table | `.csv`, `.tsv` | signals: a row per vertex, a column per channel | as read |
//!
//! Landmarks have their own formats, see [`landmarks`].
//!
//! 3D Slicer writes the axes of a mesh to the title or a comment of VTK, PLY, STL and OBJ files, as `SPACE=LPS` or
//! `SPACE=RAS`. The axes are kept as metadata and written again. Positions aren't converted.
//!
//! A file of any of these formats may be gzipped (`.gz`). [`FORMATS`] is the table of formats; [`check_output`] checks
//! whether an output's name implies a suitable format.
//!
//! A polygon is cut into a fan of triangles. If the fan would have folds, as for concave polygons, a polygon of at most
//! 512 corners is cut by ear clipping instead. A byte order mark at the start of a file is skipped.
//!
//! A count in a header is compared with the size of the file before memory is allocated for it. A file is read
//! completely. In memory, its contents take at most a few times the size of the file. The size of decompressed data is
//! compared with [`most_expanded`] and the free memory, before and during decoding.

mod annotation;
mod atomic;
mod axes;
mod budget;
mod bytes;
mod check;
mod choose;
mod flaw;
mod formats;
mod freesurfer;
mod gifti;
mod glb;
pub mod landmarks;
mod leftovers;
mod load;
mod mask;
mod memory;
mod metamesh;
mod mgh;
mod numpy;
mod obj;
mod off;
mod painted;
mod placement;
mod ply;
mod polygon;
mod rounding;
mod scalar;
mod spec;
mod stl;
mod table;
mod text;
mod threemf;
mod volume;
mod vrml;
mod vtk;
mod vtkxml;
mod weld;
mod xml;

use std::io;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::error::SurfaceError;
use crate::mesh::{Input, Mesh, Signal};

pub use crate::room::{NoRoom, ask_for_free_memory, check_room, most_expanded};
pub use annotation::{Annotation, read_annotation};
pub use atomic::write_new;
pub use check::mesh as check_mesh;
pub(crate) use check::{indices as check_indices, mesh_with_gaps, signal as check_signal, signal_with_gaps};
pub(crate) use choose::name_without_gz;
pub use choose::{
    Output, check_output, is_named_mesh, is_named_signal, may_hold_signal, to_write_mesh, to_write_signal,
};
pub use formats::FORMATS;
pub use gifti::{gifti_metadata, read_gifti_metadata};
pub use leftovers::remove_leftovers;
pub use load::MOST_EXPANSION;
pub use mask::read_mask;
pub use memory::bytes_to_read;
pub use painted::{PAINTED, write_painted, write_ply};
pub use ply::PlyAttributes;
pub use rounding::CoarseNumbers;
pub use scalar::Scalar;
use spec::{Context, Writer};
pub use spec::{FormatSpec, Precision};
pub(crate) use table::Columns;

/// Options for writing a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// Whether to replace an existing file. If false, an existing file is an error.
    pub overwrite: bool,
    /// Whether to write 64-bit numbers in formats that support both 32 and 64 bits (GIfTI, PLY). Text formats always
    /// write all digits; FreeSurfer and STL only support 32 bits.
    pub double: bool,
}

/// Reads a surface.
///
/// # Errors
///
/// [`Io`](SurfaceError::Io) if the file can't be read; [`NotAFile`](SurfaceError::NotAFile) if the path isn't a regular
/// file; [`NotAMesh`](SurfaceError::NotAMesh) if the file holds a signal; [`VolumeInput`](SurfaceError::VolumeInput) if
/// it holds a volume; [`EmptyFile`](SurfaceError::EmptyFile) or [`UnknownFormat`](SurfaceError::UnknownFormat) if its
/// format can't be determined; [`Malformed`](SurfaceError::Malformed) if it violates its format;
/// [`Unsupported`](SurfaceError::Unsupported) if it uses an unsupported feature of its format;
/// [`NoRoom`](SurfaceError::NoRoom) if memory is insufficient; [`Empty`](SurfaceError::Empty),
/// [`NonFinite`](SurfaceError::NonFinite), [`IndexOutOfRange`](SurfaceError::IndexOutOfRange) or
/// [`TooLarge`](SurfaceError::TooLarge) if the contents aren't a valid surface. [`Topology`](crate::topology::Topology)
/// checks whether the surface is closed.
pub fn read_mesh(path: impl AsRef<Path>) -> Result<Mesh, SurfaceError> {
    let path = path.as_ref();
    mesh_of(path, read_input(path)?)
}

/// Returns the surface that was read from a file.
fn mesh_of(path: &Path, input: Input) -> Result<Mesh, SurfaceError> {
    match input {
        Input::Mesh(mesh) => Ok(mesh),
        Input::Signal(Signal { vertices, channels, .. }) => {
            Err(SurfaceError::NotAMesh { path: path.to_owned(), vertices, channels })
        }
    }
}

/// Reads values on vertices.
///
/// # Errors
///
/// The errors of [`read_input`]; [`NotASignal`](SurfaceError::NotASignal) if the file holds a surface.
pub fn read_signal(path: impl AsRef<Path>) -> Result<Signal, SurfaceError> {
    let path = path.as_ref();
    signal_of(path, read_input(path)?)
}

/// Returns the signal that was read from a file.
pub(crate) fn signal_of(path: &Path, input: Input) -> Result<Signal, SurfaceError> {
    match input {
        Input::Signal(signal) => Ok(signal),
        Input::Mesh(mesh) => Err(SurfaceError::NotASignal {
            path: path.to_owned(),
            vertices: mesh.vertices.len(),
            faces: mesh.faces.len(),
        }),
    }
}

/// Reads a file that may hold a surface or a signal.
///
/// # Errors
///
/// The errors of [`read_mesh`], except [`NotAMesh`](SurfaceError::NotAMesh).
pub fn read_input(path: impl AsRef<Path>) -> Result<Input, SurfaceError> {
    let path = path.as_ref();
    Ok(read_columns(path)?.0)
}

/// Reads a surface or a signal and, if the file is a table, the facts about its columns.
pub(crate) fn read_columns(path: &Path) -> Result<(Input, Columns), SurfaceError> {
    let (input, columns) = parse(path)?;
    check::input(path, &input)?;
    Ok((input, columns))
}

/// Reads a surface or a signal, like [`read_columns`], but allows values that are NaN or infinite.
pub(crate) fn read_columns_with_gaps(path: &Path) -> Result<(Input, Columns), SurfaceError> {
    let (input, columns) = parse(path)?;
    match &input {
        Input::Mesh(mesh) => mesh_with_gaps(path, mesh)?,
        Input::Signal(signal) => signal_with_gaps(path, signal)?,
    }
    Ok((input, columns))
}

/// Reads a surface whose positions may be NaN or infinite, for fits that ignore the vertices with such positions.
///
/// # Errors
///
/// The errors of [`read_mesh`], except those for positions.
pub fn read_mesh_with_gaps(path: impl AsRef<Path>) -> Result<Mesh, SurfaceError> {
    let path = path.as_ref();
    mesh_of(path, read_columns_with_gaps(path)?.0)
}

/// Reads values on vertices. Missing values are allowed and are stored as NaN.
///
/// # Errors
///
/// The errors of [`read_signal`], except that NaN is allowed.
pub fn read_signal_with_gaps(path: impl AsRef<Path>) -> Result<Signal, SurfaceError> {
    let path = path.as_ref();
    let (Input::Signal(signal), _) = parse(path)? else { return read_signal(path) };
    let filled = signal.values.iter().map(|&x| if x.is_nan() { 0.0 } else { x }).collect();
    check::signal(path, &Signal { values: filled, ..signal })?;
    Ok(signal)
}

/// Returns the number of vertices of a FreeSurfer surface, a curv file or a PLY file, from the file's first bytes.
/// Returns `None` for other formats, and for gzipped files, which must be read completely to get this number.
///
/// # Errors
///
/// The errors of [`read_input`], if the file is empty or can't be opened.
pub fn declared_vertices(path: impl AsRef<Path>) -> Result<Option<u64>, SurfaceError> {
    let path = path.as_ref();
    let head = load::head(path)?;
    if head.is_empty() {
        parse(path)?;
    }
    Ok(freesurfer::declared(&head).or_else(|| ply::declared(&head)))
}

/// Reads a file without checking that its numbers are finite and its indices in range.
fn parse(path: &Path) -> Result<(Input, Columns), SurfaceError> {
    let mut bytes = load::load(path)?;
    if load::is_gzip(&bytes) {
        bytes = load::gunzip(&bytes).map_err(|flaw| flaw.at(path, "a gzipped file"))?;
    }
    // In every format, the decoded contents need at least as much memory as the file's bytes, which are still in
    // memory.
    check_room(bytes.len() as u64).map_err(|room| SurfaceError::NoRoom { path: path.to_owned(), room })?;
    if let Some(header) = numpy::header(&bytes) {
        let signal = numpy::read(&bytes, &header).map_err(|flaw| flaw.at(path, numpy::NAME))?;
        return Ok((Input::Signal(signal), Columns::default()));
    }
    if let Some(format) = volume::kind(&bytes) {
        return Err(SurfaceError::VolumeInput { path: path.to_owned(), format });
    }
    // Spreadsheets and programs for Windows write a byte order mark before text in UTF-8.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let format = choose::of_file(path, bytes)?;
    let contents = match table::separator(format) {
        Some(separator) => table::read_columns(bytes, separator).map(|(signal, facts)| (Input::Signal(signal), facts)),
        None => (format.read)(bytes).map(|input| (input, Columns::default())),
    };
    contents.map_err(|flaw| flaw.at(path, format.name))
}

/// Writes a surface in the format implied by the output's name, completely or not at all.
///
/// Names that begin with `lh.` or `rh.`, or end like FreeSurfer's (`.pial`, `.white`, `.sphere`, ...), imply
/// FreeSurfer's format.
///
/// # Errors
///
/// Returns an error if the name implies no format, if the file exists and `overwrite` is false, or if writing fails.
/// After an error, an existing file is unchanged.
pub fn write_mesh(path: impl AsRef<Path>, mesh: &Mesh, options: &WriteOptions) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    let format = to_write_mesh(path)?;
    check::mesh(path, mesh)?;
    if !format.holds_double(options.double) {
        check::fits_f32(path, &mesh.vertices, format)?;
    }
    write_as(path, options, format.write_mesh, mesh, None)
}

/// Writes values on vertices in the format implied by the name: `.gii` (float32 unless `double`), `.mgz`, `.csv`,
/// `.tsv`, or, for one channel, FreeSurfer's curv (`lh.*`, `rh.*`, `.curv`, `.thickness`, ...). Values may be NaN,
/// which marks vertices without a value.
///
/// # Errors
///
/// The errors of [`write_mesh`], with [`NonFinite`](SurfaceError::NonFinite) only for infinities;
/// [`Argument`](SurfaceError::Argument) for several channels in a curv file.
pub fn write_signal(path: impl AsRef<Path>, signal: &Signal, options: &WriteOptions) -> Result<(), SurfaceError> {
    write_signal_of(path, signal, None, options)
}

/// Writes values on the vertices of an anatomical structure, such as `CortexLeft`. GIfTI stores the structure as
/// `AnatomicalStructurePrimary`, which Workbench requires. Other formats don't store the structure. See
/// [`write_signal`].
///
/// # Errors
///
/// The errors of [`write_signal`].
pub fn write_signal_of(
    path: impl AsRef<Path>,
    signal: &Signal,
    structure: Option<&str>,
    options: &WriteOptions,
) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    let format = to_write_signal(path)?;
    check::written_signal(path, signal)?;
    if signal.channels > format.most_channels {
        return Err(SurfaceError::Argument {
            what: "channels of a FreeSurfer curv file",
            expected: "1 (write several channels to .func.gii, .mgz or .csv)",
            found: signal.channels.to_string(),
        });
    }
    if !format.holds_double(options.double) {
        check::values_fit_f32(path, signal, format)?;
    }
    write_as(path, options, format.write_signal, signal, structure)
}

/// Writes a file with a format's `writer`, compressed by gzip if the file's name ends in `.gz`.
fn write_as<T>(
    path: &Path,
    options: &WriteOptions,
    writer: Option<Writer<T>>,
    contents: &T,
    structure: Option<&str>,
) -> Result<(), SurfaceError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = choose::without_ending(&name, ".gz").unwrap_or(&name);
    let context = Context { double: options.double, name, structure };
    write_new(path, options.overwrite, |out| {
        let writer = writer.ok_or(io::ErrorKind::Unsupported)?;
        if !choose::is_gzipped(path) {
            return writer(out, contents, &context);
        }
        let mut packed = GzEncoder::new(out, Compression::default());
        writer(&mut packed, contents, &context)?;
        packed.finish().map(drop)
    })
}
