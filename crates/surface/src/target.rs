//! Defines targets, the surfaces or signals to be fitted over a sphere, and checks them against the sphere.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::error::SurfaceError;
use crate::hemisphere::Hemisphere;
use crate::io::{Columns, mesh_with_gaps, read_columns, read_columns_with_gaps, signal_with_gaps};
use crate::mesh::{Input, Kind, Mesh, Meta, Signal};
use crate::sphere::Sphere;
use crate::topology::{Topology, different_triangles, signed_volume, signed_volume_of};

/// A surface or a signal: c values for each vertex of a [`Sphere`].
#[derive(Debug, Clone)]
pub struct Target {
    /// Path of the target's file, or `None` if the target was made in memory.
    pub path: Option<PathBuf>,
    /// The positions or signal values, a row-major array of shape (n, c). They are finite, except at vertices that a
    /// fit ignores.
    pub values: Vec<f64>,
    /// Number c of channels; 3 for a surface.
    pub channels: usize,
    /// Whether the channels are coordinates x, y, z or other values.
    pub kind: Kind,
    /// Metadata of the target's file; empty for a signal.
    pub meta: Meta,
    /// Possible problems, which the caller may display or reject.
    pub warnings: Vec<TargetWarning>,
}

/// A property of a target that may be a mistake. It doesn't prevent a fit, since the least-squares problem is still
/// well-defined.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum TargetWarning {
    /// The target isn't a closed surface of genus zero.
    NotClosed(Topology),
    /// The target and the sphere belong to different hemispheres, according to their files' metadata or names.
    OtherHemisphere {
        /// The target's hemisphere.
        target: Hemisphere,
        /// The sphere's hemisphere.
        sphere: Hemisphere,
    },
    /// The target and a mask of its vertices belong to different hemispheres, according to their files' metadata or
    /// names.
    OtherMask {
        /// The target's hemisphere.
        target: Hemisphere,
        /// Path of the mask's file.
        mask: PathBuf,
        /// The mask's hemisphere.
        of: Hemisphere,
    },
    /// A column of a table contains row numbers and was left out. This is a note; see [`is_note`](Self::is_note).
    IndexColumn {
        /// Name of the column.
        name: String,
    },
    /// A table without a header may have numbers with decimal commas, each of which was read as two values.
    DecimalCommas {
        /// First row of the table.
        row: String,
    },
    /// The triangles face outwards on the surface but inwards on the sphere, or vice versa. In this case, the model is
    /// inside out.
    Reversed {
        /// Path of the sphere's file, or `None` if the sphere was made in memory.
        sphere: Option<PathBuf>,
    },
}

impl fmt::Display for TargetWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotClosed(topology) => {
                write!(f, "not a closed surface of genus zero: {}", topology.problems().join("; "))
            }
            Self::OtherHemisphere { target, sphere } => {
                write!(
                    f,
                    "this file belongs to the {target} hemisphere, but the sphere belongs to the {sphere} hemisphere"
                )
            }
            Self::OtherMask { target, mask, of } => {
                let mask = mask.display();
                write!(
                    f,
                    "this file belongs to the {target} hemisphere, but the mask {mask} belongs to the {of} hemisphere"
                )
            }
            Self::IndexColumn { name } => {
                write!(f, "the column {name:?} was left out, since it only numbers the rows")
            }
            Self::DecimalCommas { row } => {
                write!(
                    f,
                    "rows such as {row} were read as two channels; if they are single numbers with decimal commas, \
                     write them with decimal points, as {}; if they are two channels, add a first line of column names",
                    row.replacen(',', ".", 1)
                )
            }
            Self::Reversed { sphere } => {
                let name = sphere.as_ref().map_or(String::new(), |path| format!(" {}", path.display()));
                write!(
                    f,
                    "the sphere{name} reverses the orientation of the surface; is this the sphere of the other \
                     hemisphere?"
                )
            }
        }
    }
}

impl TargetWarning {
    /// Returns a warning if the target belongs to the hemisphere `own`, and the mask belongs to the other hemisphere
    /// according to its file's name.
    #[must_use]
    pub fn of_mask(own: Option<Hemisphere>, mask: &Path) -> Option<Self> {
        let (target, of) = (own?, Hemisphere::of(None, Some(mask))?);
        (target != of).then(|| Self::OtherMask { target, mask: mask.to_owned(), of })
    }

    /// Returns whether this warning is only a note about how the file was read. Even a strict fit accepts notes.
    #[must_use]
    pub fn is_note(&self) -> bool {
        matches!(self, Self::IndexColumn { .. })
    }
}

impl Target {
    /// Returns a surface as a target. Its vertices must correspond to those of the sphere, in the same order.
    ///
    /// # Errors
    ///
    /// [`Empty`](SurfaceError::Empty) if the surface has no vertices or triangles;
    /// [`NonFinite`](SurfaceError::NonFinite) if a position isn't finite;
    /// [`IndexOutOfRange`](SurfaceError::IndexOutOfRange) if a triangle refers to a missing vertex;
    /// [`VertexCount`](SurfaceError::VertexCount) if the sphere has a different number of vertices;
    /// [`OtherTriangles`](SurfaceError::OtherTriangles) if the sphere has triangles and the surface's triangles differ
    /// from them.
    pub fn from_mesh(mesh: &Mesh, sphere: &Sphere) -> Result<Self, SurfaceError> {
        let name = Path::new("the surface");
        crate::io::check_mesh(name, mesh)?;
        Self::of_mesh(mesh.clone(), sphere, None)
    }

    /// Returns values at the sphere's vertices as a target.
    ///
    /// # Errors
    ///
    /// [`Empty`](SurfaceError::Empty) if the signal has no values; [`NonFinite`](SurfaceError::NonFinite) if a value
    /// isn't finite; [`VertexCount`](SurfaceError::VertexCount) if the sphere has a different number of vertices.
    pub fn from_signal(signal: Signal, sphere: &Sphere) -> Result<Self, SurfaceError> {
        let name = Path::new("the signal");
        crate::io::check_signal(name, &signal)?;
        Self::of_signal(signal, sphere, None)
    }

    /// Returns a surface as a target, like [`from_mesh`](Self::from_mesh), but allows positions that aren't finite. A
    /// fit gives these vertices weight 0 and ignores their positions.
    ///
    /// # Errors
    ///
    /// The errors of [`from_mesh`](Self::from_mesh), except [`NonFinite`](SurfaceError::NonFinite).
    pub fn from_mesh_with_gaps(mesh: &Mesh, sphere: &Sphere) -> Result<Self, SurfaceError> {
        mesh_with_gaps(Path::new("the surface"), mesh)?;
        Self::of_mesh(mesh.clone(), sphere, None)
    }

    /// Returns a signal as a target, like [`from_signal`](Self::from_signal), but allows values that aren't finite. A
    /// fit gives these vertices weight 0 and ignores their values.
    ///
    /// # Errors
    ///
    /// The errors of [`from_signal`](Self::from_signal), except [`NonFinite`](SurfaceError::NonFinite).
    pub fn from_signal_with_gaps(signal: Signal, sphere: &Sphere) -> Result<Self, SurfaceError> {
        signal_with_gaps(Path::new("the signal"), &signal)?;
        Self::of_signal(signal, sphere, None)
    }

    /// Returns a surface or a signal as a target, like [`from_mesh_with_gaps`](Self::from_mesh_with_gaps) and
    /// [`from_signal_with_gaps`](Self::from_signal_with_gaps). If `path` is given, it is the file that the input was
    /// read from, and its name may determine the target's hemisphere.
    ///
    /// # Errors
    ///
    /// The errors of [`from_mesh_with_gaps`](Self::from_mesh_with_gaps) and
    /// [`from_signal_with_gaps`](Self::from_signal_with_gaps).
    pub fn with_gaps(input: Input, path: Option<&Path>, sphere: &Sphere) -> Result<Self, SurfaceError> {
        let target = match input {
            Input::Mesh(mesh) => {
                mesh_with_gaps(path.unwrap_or(Path::new("the surface")), &mesh)?;
                Self::of_mesh(mesh, sphere, path)?
            }
            Input::Signal(signal) => {
                signal_with_gaps(path.unwrap_or(Path::new("the signal")), &signal)?;
                Self::of_signal(signal, sphere, path)?
            }
        };
        Ok(Self { path: path.map(Path::to_owned), ..target })
    }

    /// Checks that the values are finite at all n vertices, except those for which the array `unread` of length n is
    /// true.
    ///
    /// # Errors
    ///
    /// [`NonFinite`](SurfaceError::NonFinite) if a value isn't finite. The error gives the first such value.
    pub fn check_finite(&self, unread: Option<&[bool]>) -> Result<(), SurfaceError> {
        let channels = self.channels.max(1);
        let is_read = |vertex: usize| unread.is_none_or(|unread| !unread.get(vertex).copied().unwrap_or(false));
        let bad = self.values.iter().enumerate().find(|(i, value)| !value.is_finite() && is_read(i / channels));
        let Some((i, &value)) = bad else { return Ok(()) };
        let name = if self.kind == Kind::Surface { "the surface" } else { "the signal" };
        let path = self.path.clone().unwrap_or_else(|| name.into());
        Err(SurfaceError::NonFinite { path, vertex: i / channels, value })
    }

    /// Adds a warning if a mask of the vertices belongs to the other hemisphere, according to its file's name. If the
    /// target's own hemisphere is unknown, the sphere's hemisphere is used.
    pub fn check_mask(&mut self, mask: &Path, sphere: &Sphere) {
        let own = Hemisphere::of(self.meta.anatomical_structure_primary.as_deref(), self.path.as_deref());
        self.warnings.extend(TargetWarning::of_mask(own.or_else(|| sphere.hemisphere()), mask));
    }

    fn of_mesh(mesh: Mesh, sphere: &Sphere, path: Option<&Path>) -> Result<Self, SurfaceError> {
        let name = path.unwrap_or(Path::new("the surface"));
        check_count(mesh.vertices.len(), sphere, name)?;
        if !sphere.faces.is_empty() && mesh.faces != sphere.faces {
            let differ = different_triangles(&mesh.faces, &sphere.faces);
            if differ > 0 {
                let sphere = sphere.path.clone();
                return Err(SurfaceError::OtherTriangles { path: name.to_owned(), sphere, differ });
            }
        }
        let topology = Topology::of(&mesh);
        let mut warnings = other_hemisphere(mesh.meta.anatomical_structure_primary.as_deref(), path, sphere);
        if !topology.is_sphere() {
            warnings.push(TargetWarning::NotClosed(topology));
        } else if is_reversed(&mesh, sphere) {
            warnings.push(TargetWarning::Reversed { sphere: sphere.path.clone() });
        }
        let values = mesh.vertices.into_flattened();
        Ok(Self { path: None, values, channels: 3, kind: Kind::Surface, meta: mesh.meta, warnings })
    }

    fn of_signal(signal: Signal, sphere: &Sphere, path: Option<&Path>) -> Result<Self, SurfaceError> {
        check_count(signal.vertices, sphere, path.unwrap_or(Path::new("the signal")))?;
        Ok(Self {
            path: None,
            values: signal.values,
            channels: signal.channels,
            kind: Kind::Signal,
            meta: Meta::default(),
            warnings: other_hemisphere(None, path, sphere),
        })
    }
}

fn other_hemisphere(structure: Option<&str>, path: Option<&Path>, sphere: &Sphere) -> Vec<TargetWarning> {
    match (Hemisphere::of(structure, path), sphere.hemisphere()) {
        (Some(target), Some(sphere)) if target != sphere => vec![TargetWarning::OtherHemisphere { target, sphere }],
        _ => Vec::new(),
    }
}

/// Returns whether a sphere reverses the orientation of a closed surface with the same triangles. This is the case if
/// the volumes that the triangles enclose on the surface and on the sphere have opposite signs. The surface's triangles
/// are used for both volumes, because the sphere's triangles may be wound the other way. If a position isn't finite,
/// the result is false.
fn is_reversed(mesh: &Mesh, sphere: &Sphere) -> bool {
    let of_sphere = || signed_volume_of(sphere.directions.as_slice(), &mesh.faces);
    !sphere.faces.is_empty() && signed_volume(mesh) * of_sphere() < 0.0
}

fn check_count(found: usize, sphere: &Sphere, name: &Path) -> Result<(), SurfaceError> {
    let expected = sphere.directions.len();
    if found == expected {
        return Ok(());
    }
    Err(SurfaceError::VertexCount { path: name.to_owned(), sphere: sphere.path.clone(), expected, found })
}

/// Reads a surface or a signal whose vertices correspond to those of a sphere.
///
/// # Errors
///
/// The errors of [`read_input`](crate::io::read_input) if the file can't be read; the errors of [`Target::from_mesh`]
/// and [`Target::from_signal`].
pub fn read_target(path: impl AsRef<Path>, sphere: &Sphere) -> Result<Target, SurfaceError> {
    let path = path.as_ref();
    target_of(read_columns(path)?, path, sphere)
}

/// Reads a target, like [`read_target`], but allows values that aren't finite. A fit gives their vertices weight 0 and
/// ignores the values.
///
/// # Errors
///
/// The errors of [`read_target`], except [`NonFinite`](SurfaceError::NonFinite).
pub fn read_target_with_gaps(path: impl AsRef<Path>, sphere: &Sphere) -> Result<Target, SurfaceError> {
    let path = path.as_ref();
    target_of(read_columns_with_gaps(path)?, path, sphere)
}

fn target_of((input, columns): (Input, Columns), path: &Path, sphere: &Sphere) -> Result<Target, SurfaceError> {
    let mut target = match input {
        Input::Mesh(mesh) => Target::of_mesh(mesh, sphere, Some(path))?,
        Input::Signal(signal) => Target::of_signal(signal, sphere, Some(path))?,
    };
    target.warnings.extend(columns.index.into_iter().map(|name| TargetWarning::IndexColumn { name }));
    target.warnings.extend(columns.decimal_commas.map(|row| TargetWarning::DecimalCommas { row }));
    Ok(Target { path: Some(path.to_owned()), ..target })
}

#[cfg(test)]
mod tests;
