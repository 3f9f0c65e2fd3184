//! Which format a file is in: by its name, or else by its first bytes.

use std::path::Path;

use super::flaw::shown;
use crate::error::SurfaceError;

/// The formats known here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Gifti,
    FreeSurferSurface,
    FreeSurferCurv,
    Obj,
    Ply,
    Off,
    Stl,
    Vtk,
    Csv,
    Tsv,
}

const READABLE: &str = "GIfTI (.surf.gii, .func.gii, .gii.gz), .obj, .ply, .off, .stl, .vtk, .csv, .tsv, \
                        or a FreeSurfer surface or curv file";
const MESH_NAMES: &str = "a name that ends in .surf.gii, .gii, .gii.gz, .obj, .ply, .off, .stl, .vtk, \
                          or starts with lh. or rh. (FreeSurfer)";
const SIGNAL_NAMES: &str = "a name that ends in .func.gii, .shape.gii, .gii.gz, .csv, .tsv, \
                            or starts with lh. or rh. (FreeSurfer)";

/// Endings that FreeSurfer gives its surfaces, beside the hemisphere's prefix.
const FREESURFER_SURFACES: [&str; 7] = ["pial", "white", "sphere", "inflated", "orig", "smoothwm", "reg"];
/// Endings that FreeSurfer gives its values on vertices.
const FREESURFER_CURVS: [&str; 5] = ["curv", "sulc", "thickness", "area", "volume"];

impl Format {
    /// As it stands in messages.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Gifti => "a GIfTI file",
            Self::FreeSurferSurface => "a FreeSurfer surface",
            Self::FreeSurferCurv => "a FreeSurfer curv file",
            Self::Obj => "an OBJ file",
            Self::Ply => "a PLY file",
            Self::Off => "an OFF file",
            Self::Stl => "an STL file",
            Self::Vtk => "a legacy VTK file",
            Self::Csv => "a CSV table",
            Self::Tsv => "a TSV table",
        }
    }

    /// Whether what is written holds every bit of an f64.
    pub(super) fn holds_double(self, double: bool) -> bool {
        match self {
            Self::Gifti | Self::Ply => double,
            Self::FreeSurferSurface | Self::FreeSurferCurv | Self::Stl => false,
            Self::Obj | Self::Off | Self::Vtk | Self::Csv | Self::Tsv => true,
        }
    }

    /// The format of a file that is there.
    pub(super) fn of_file(path: &Path, bytes: &[u8]) -> Result<Self, SurfaceError> {
        let name = lower_name(path);
        if let Some((format, _)) = by_extension(&name) {
            return Ok(format);
        }
        by_magic(bytes).ok_or_else(|| SurfaceError::UnknownFormat {
            path: path.to_owned(),
            expected: READABLE,
            found: match bytes {
                [] => "the file is empty".to_owned(),
                _ => format!("it starts with {}", shown(bytes)),
            },
        })
    }

    /// The format a surface's output name asks for, and whether the file as a whole is to be gzipped.
    pub(super) fn to_write_mesh(path: &Path) -> Result<(Self, bool), SurfaceError> {
        let name = lower_name(path);
        match by_extension(&name) {
            Some((Self::Csv | Self::Tsv, _)) => {}
            Some(found) => return Ok(found),
            None if is_freesurfer(&name, &FREESURFER_SURFACES) => {
                return Ok((Self::FreeSurferSurface, false));
            }
            None => {}
        }
        Err(no_format(path, &name, MESH_NAMES))
    }

    /// The format a signal's output name asks for, and whether the file as a whole is to be gzipped.
    pub(super) fn to_write_signal(path: &Path) -> Result<(Self, bool), SurfaceError> {
        let name = lower_name(path);
        match by_extension(&name) {
            Some(found @ (Self::Gifti | Self::Csv | Self::Tsv, _)) => return Ok(found),
            None if is_freesurfer(&name, &FREESURFER_CURVS) => {
                return Ok((Self::FreeSurferCurv, false));
            }
            _ => {}
        }
        Err(no_format(path, &name, SIGNAL_NAMES))
    }
}

fn no_format(path: &Path, name: &str, expected: &'static str) -> SurfaceError {
    SurfaceError::UnknownFormat {
        path: path.to_owned(),
        expected,
        found: format!("the name is {}", shown(name.as_bytes())),
    }
}

fn lower_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().to_lowercase()
}

fn by_extension(name: &str) -> Option<(Format, bool)> {
    let table = [
        (".gii", Format::Gifti),
        (".obj", Format::Obj),
        (".ply", Format::Ply),
        (".off", Format::Off),
        (".stl", Format::Stl),
        (".vtk", Format::Vtk),
        (".csv", Format::Csv),
        (".tsv", Format::Tsv),
    ];
    if name.ends_with(".gii.gz") {
        return Some((Format::Gifti, true));
    }
    let found = table.iter().find(|(ending, _)| name.ends_with(ending))?;
    Some((found.1, false))
}

fn is_freesurfer(name: &str, endings: &[&str]) -> bool {
    name.starts_with("lh.")
        || name.starts_with("rh.")
        || name.rsplit_once('.').is_some_and(|(_, ending)| endings.contains(&ending))
}

fn by_magic(bytes: &[u8]) -> Option<Format> {
    match bytes {
        [0xff, 0xff, 0xfe, ..] => Some(Format::FreeSurferSurface),
        // Also the magic of FreeSurfer's old surfaces of quadrangles; the reader tells them apart by their length.
        [0xff, 0xff, 0xff, ..] => Some(Format::FreeSurferCurv),
        [0x1f, 0x8b, ..] => Some(Format::Gifti),
        _ if bytes.starts_with(b"ply") => Some(Format::Ply),
        _ if bytes.starts_with(b"OFF") => Some(Format::Off),
        _ if bytes.starts_with(b"# vtk") => Some(Format::Vtk),
        _ if bytes.starts_with(b"solid") => Some(Format::Stl),
        _ if bytes.get(..512).unwrap_or(bytes).windows(6).any(|w| w == b"<GIFTI") => Some(Format::Gifti),
        _ => None,
    }
}
