//! Reading and writing surfaces and signals, one file per format.
//!
//! | format | names | read | written |
//! |---|---|---|---|
//! | GIfTI | `.gii`, `.surf.gii`, `.gii.gz` | all encodings but external files | GZipBase64Binary |
//! | FreeSurfer | `lh.pial`, `rh.curv`, ... | triangle surfaces, new-format curv | the same |
//! | Wavefront | `.obj` | polygons, negative indices | ASCII |
//! | Stanford | `.ply` | ASCII, both binaries, polygons | little-endian binary |
//! | Geomview | `.off` | ASCII, polygons, with colours or normals | ASCII |
//! | STL | `.stl` | ASCII, binary; equal vertices welded | binary |
//! | VTK legacy | `.vtk` | PolyData, ASCII and binary, versions to 5.1 | ASCII |
//! | table | `.csv`, `.tsv` | signals: a row per vertex, a column per channel | the same |
//!
//! Files are taken as hostile: a count in a header is held against the bytes that are there before anything is
//! allocated for it. A file is read whole: what it holds takes a few times its bytes in memory at most, and the
//! expansion of compressed ones is bounded.

mod atomic;
mod bytes;
mod check;
mod flaw;
mod format;
mod freesurfer;
mod gifti;
mod load;
mod obj;
mod off;
mod ply;
mod polygon;
mod stl;
mod table;
mod text;
mod vtk;

use std::path::Path;

use crate::error::SurfaceError;
use crate::mesh::{Input, Mesh, Signal};

pub use atomic::write_new;
pub(crate) use check::{indices as check_indices, mesh as check_mesh, signal as check_signal};
use flaw::Flaw;
use format::Format;
pub use ply::PlyAttributes;

/// How to write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// Replace a file that is there. Else its presence is an error.
    pub overwrite: bool,
    /// Write 64-bit positions where the format has a choice (GIfTI, PLY), whose custom is 32 bits. Text formats always
    /// carry every digit; FreeSurfer and STL have no room for more than 32 bits.
    pub double: bool,
}

/// Reads a surface.
///
/// # Errors
///
/// Where the file isn't there, isn't a surface, is damaged, holds a coordinate that isn't finite or a triangle with
/// an index out of range. Whether the surface is closed is [`Topology`](crate::topology::Topology)'s to say.
pub fn read_mesh(path: impl AsRef<Path>) -> Result<Mesh, SurfaceError> {
    let path = path.as_ref();
    match read_input(path)? {
        Input::Mesh(mesh) => Ok(mesh),
        Input::Signal(signal) => {
            Err(SurfaceError::NotAMesh { path: path.to_owned(), vertices: signal.vertices, channels: signal.channels })
        }
    }
}

/// Reads values on vertices.
///
/// # Errors
///
/// As [`read_mesh`], and where the file holds a surface.
pub fn read_signal(path: impl AsRef<Path>) -> Result<Signal, SurfaceError> {
    let path = path.as_ref();
    match read_input(path)? {
        Input::Signal(signal) => Ok(signal),
        Input::Mesh(mesh) => Err(SurfaceError::NotASignal {
            path: path.to_owned(),
            vertices: mesh.vertices.len(),
            faces: mesh.faces.len(),
        }),
    }
}

/// Reads whatever the file holds, a surface or a signal.
///
/// # Errors
///
/// As [`read_mesh`].
pub fn read_input(path: impl AsRef<Path>) -> Result<Input, SurfaceError> {
    let path = path.as_ref();
    let bytes = load::load(path)?;
    let format = Format::of_file(path, &bytes)?;
    let input = parse(format, &bytes).map_err(|flaw| flaw.at(path, format.name()))?;
    drop(bytes);
    check::input(path, &input)?;
    Ok(input)
}

fn parse(format: Format, bytes: &[u8]) -> Result<Input, Flaw> {
    match format {
        Format::Gifti => gifti::read(bytes),
        Format::FreeSurferSurface => freesurfer::read_surface(bytes).map(Input::Mesh),
        Format::FreeSurferCurv => freesurfer::read_curv(bytes).map(Input::Signal),
        Format::Obj => obj::read(bytes).map(Input::Mesh),
        Format::Ply => ply::read(bytes).map(Input::Mesh),
        Format::Off => off::read(bytes).map(Input::Mesh),
        Format::Stl => stl::read(bytes).map(Input::Mesh),
        Format::Vtk => vtk::read(bytes).map(Input::Mesh),
        Format::Csv => table::read(bytes, b',').map(Input::Signal),
        Format::Tsv => table::read(bytes, b'\t').map(Input::Signal),
    }
}

/// Writes a surface in the format its name asks for, whole or not at all.
///
/// `lh.*`, `rh.*` and FreeSurfer's own endings (`.pial`, `.white`, `.sphere`, ...) make FreeSurfer files.
///
/// # Errors
///
/// Where the name asks for no format, the file exists and may not be replaced, or writing fails; the target is then
/// as it was.
pub fn write_mesh(path: impl AsRef<Path>, mesh: &Mesh, options: &WriteOptions) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    let (format, gzip) = Format::to_write_mesh(path)?;
    check::mesh(path, mesh)?;
    let double = options.double;
    if !format.holds_double(double) {
        check::fits_f32(path, &mesh.vertices, format)?;
    }
    write_new(path, options.overwrite, |out| match format {
        Format::Gifti => gifti::write_mesh(out, mesh, double, gzip),
        Format::FreeSurferSurface => freesurfer::write_surface(out, mesh),
        Format::Obj => obj::write(out, mesh),
        Format::Ply => ply::write(out, mesh, &PlyAttributes::default(), double),
        Format::Off => off::write(out, mesh),
        Format::Stl => stl::write(out, mesh),
        Format::Vtk => vtk::write(out, mesh),
        // `to_write_mesh` gives none of these.
        Format::FreeSurferCurv | Format::Csv | Format::Tsv => Err(std::io::ErrorKind::Unsupported.into()),
    })
}

/// Writes values on vertices in the format the name asks for: `.gii` (float32 unless `double`), `.csv`, `.tsv`, or,
/// for one channel, FreeSurfer's curv (`lh.*`, `rh.*`, `.curv`, `.thickness`, ...).
///
/// # Errors
///
/// As [`write_mesh`].
pub fn write_signal(path: impl AsRef<Path>, signal: &Signal, options: &WriteOptions) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    let (format, gzip) = Format::to_write_signal(path)?;
    check::signal(path, signal)?;
    if format == Format::FreeSurferCurv && signal.channels != 1 {
        return Err(SurfaceError::Argument {
            what: "channels of a FreeSurfer curv file",
            expected: "1; write .func.gii or .csv for more",
            found: signal.channels.to_string(),
        });
    }
    if !format.holds_double(options.double) {
        check::values_fit_f32(path, signal, format)?;
    }
    write_new(path, options.overwrite, |out| match format {
        Format::Gifti => gifti::write_signal(out, signal, options.double, gzip),
        Format::FreeSurferCurv => freesurfer::write_curv(out, signal),
        Format::Csv => table::write(out, signal, b','),
        Format::Tsv => table::write(out, signal, b'\t'),
        // `to_write_signal` gives no other.
        _ => Err(std::io::ErrorKind::Unsupported.into()),
    })
}

/// Writes a PLY file with a value or a colour at each vertex, for viewers such as MeshLab and CloudCompare.
///
/// # Errors
///
/// As [`write_mesh`]; also where an attribute's length isn't the number of vertices or its name isn't one word.
pub fn write_ply(
    path: impl AsRef<Path>,
    mesh: &Mesh,
    attributes: &PlyAttributes<'_>,
    options: &WriteOptions,
) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    check::mesh(path, mesh)?;
    attributes.check(mesh)?;
    if !options.double {
        check::fits_f32(path, &mesh.vertices, Format::Ply)?;
    }
    write_new(path, options.overwrite, |out| ply::write(out, mesh, attributes, options.double))
}
