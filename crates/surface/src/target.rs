//! Defines targets, the surfaces or signals to be fitted over a sphere, and checks them against the sphere.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::error::SurfaceError;
use crate::hemisphere::Hemisphere;
use crate::io::{mesh_with_gaps, read_input, read_input_with_gaps, signal_with_gaps};
use crate::mesh::{Input, Kind, Mesh, Meta, Signal};
use crate::sphere::Sphere;
use crate::topology::{Topology, different_triangles, signed_volume, signed_volume_of};

/// A surface or a signal: c values for each vertex of a [`Sphere`].
#[derive(Debug, Clone)]
pub struct Target {
    /// Path of the target's file, or `None` if the target was made in memory.
    pub path: Option<PathBuf>,
    /// The positions or signal values (n, c), row-major. They are finite, except at vertices that a fit ignores.
    pub values: Vec<f64>,
    /// Number of channels, c; 3 for a surface.
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
    /// The triangles face outwards on the surface but inwards on the sphere, or vice versa. The model is then inside
    /// out.
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

impl Target {
    /// Returns a surface as a target. Its vertices must correspond to those of the sphere, in the same order.
    ///
    /// # Errors
    ///
    /// [`Empty`](SurfaceError::Empty) if the surface has no vertices or triangles;
    /// [`NonFinite`](SurfaceError::NonFinite) if a position isn't finite;
    /// [`IndexOutOfRange`](SurfaceError::IndexOutOfRange) if a triangle refers to a missing vertex;
    /// [`VertexCount`](SurfaceError::VertexCount) if the sphere has another number of vertices;
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
    /// isn't finite; [`VertexCount`](SurfaceError::VertexCount) if the sphere has another number of vertices.
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
    /// The errors of these two functions.
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

    /// Checks that the values are finite at all vertices, except those for which `unread` (n) is true.
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

/// Returns whether a sphere reverses the orientation of a closed surface with the same triangles: the volumes that the
/// triangles enclose on the surface and on the sphere have opposite signs. The surface's triangles are used for
/// both, because the sphere's may wind the other way. If a position isn't finite, the result is false.
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
/// The errors of [`read_input`] if the file can't be read; the errors of [`Target::from_mesh`] and
/// [`Target::from_signal`].
pub fn read_target(path: impl AsRef<Path>, sphere: &Sphere) -> Result<Target, SurfaceError> {
    let path = path.as_ref();
    target_of(read_input(path)?, path, sphere)
}

/// Reads a target, like [`read_target`], but allows values that aren't finite. A fit gives their vertices weight 0 and
/// ignores the values.
///
/// # Errors
///
/// The errors of [`read_target`], except [`NonFinite`](SurfaceError::NonFinite).
pub fn read_target_with_gaps(path: impl AsRef<Path>, sphere: &Sphere) -> Result<Target, SurfaceError> {
    let path = path.as_ref();
    target_of(read_input_with_gaps(path)?, path, sphere)
}

fn target_of(input: Input, path: &Path, sphere: &Sphere) -> Result<Target, SurfaceError> {
    let target = match input {
        Input::Mesh(mesh) => Target::of_mesh(mesh, sphere, Some(path))?,
        Input::Signal(signal) => Target::of_signal(signal, sphere, Some(path))?,
    };
    Ok(Target { path: Some(path.to_owned()), ..target })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Cortex, cortex};

    #[test]
    fn a_surface_has_the_vertices_and_triangles_of_its_sphere() {
        let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
        let sphere = Sphere::from_mesh(&sphere).unwrap();
        let target = Target::from_mesh(&surface, &sphere).unwrap();
        assert_eq!((target.channels, target.kind, target.values.len()), (3, Kind::Surface, 3 * 162));
        assert!(target.warnings.is_empty());
        assert_eq!(target.meta, surface.meta);

        let mut other = surface.clone();
        other.faces[0] = other.faces[1];
        let error = Target::from_mesh(&other, &sphere).unwrap_err();
        assert!(matches!(error, SurfaceError::OtherTriangles { differ: 2, .. }), "{error}");
        let error = Target::from_mesh(&surface, &Sphere::icosphere(1)).unwrap_err();
        assert!(matches!(error, SurfaceError::VertexCount { expected: 42, found: 162, .. }), "{error}");
        let mut broken = surface;
        broken.vertices[7][1] = f64::NAN;
        let error = Target::from_mesh(&broken, &sphere).unwrap_err();
        assert!(matches!(error, SurfaceError::NonFinite { vertex: 7, .. }), "{error}");
        let target = Target::from_mesh_with_gaps(&broken, &sphere).unwrap();
        let unread: Vec<bool> = (0..162).map(|vertex| vertex == 7).collect();
        assert!(target.check_finite(Some(&unread)).is_ok());
        for unread in [None, Some(&vec![false; 162][..])] {
            let error = target.check_finite(unread).unwrap_err();
            assert!(matches!(error, SurfaceError::NonFinite { vertex: 7, .. }), "{error}");
        }
    }

    #[test]
    fn an_open_surface_is_a_warning() {
        let mut mesh = crate::generate::icosphere(2);
        mesh.faces.truncate(300);
        let sphere = Sphere::from_mesh(&mesh).unwrap();
        let target = Target::from_mesh(&mesh, &sphere).unwrap();
        assert!(target.warnings[0].to_string().starts_with("not a closed surface of genus zero: "));
    }

    #[test]
    fn hemispheres_are_compared() {
        let (mut surface, mut sphere) = cortex(&Cortex { subdivisions: 1, variant: 0 });
        surface.meta.anatomical_structure_primary = Some("CortexLeft".to_owned());
        for (structure, differ) in [("CortexRight", true), ("CortexLeft", false), ("Cortex", false)] {
            sphere.meta.anatomical_structure_primary = Some(structure.to_owned());
            let sphere = Sphere::from_mesh(&sphere).unwrap();
            let warnings = Target::from_mesh(&surface, &sphere).unwrap().warnings;
            let expected = TargetWarning::OtherHemisphere { target: Hemisphere::Left, sphere: Hemisphere::Right };
            assert_eq!(warnings, if differ { vec![expected] } else { Vec::new() }, "{structure}");
        }
    }

    #[test]
    fn a_sphere_that_turns_a_surface_inside_out_is_a_warning() {
        let (surface, outward) = cortex(&Cortex { subdivisions: 2, variant: 0 });
        let mirrored = outward.with_vertices(outward.vertices.iter().map(|&[x, y, z]| [-x, y, z]).collect());
        let inside_out = surface.with_vertices(surface.vertices.iter().map(|&[x, y, z]| [x, -y, z]).collect());
        let warnings = |surface: &Mesh, sphere: &Mesh| {
            let sphere = Sphere { path: Some("rh.sphere".into()), ..Sphere::from_mesh(sphere).unwrap() };
            Target::from_mesh(surface, &sphere).unwrap().warnings
        };
        let expected = vec![TargetWarning::Reversed { sphere: Some("rh.sphere".into()) }];
        assert_eq!(warnings(&surface, &mirrored), expected);
        assert_eq!(warnings(&inside_out, &outward), expected);
        assert!(expected[0].to_string().starts_with("the sphere rh.sphere reverses the orientation of the surface; "));
        assert!(warnings(&surface, &outward).is_empty());
        assert!(warnings(&inside_out, &mirrored).is_empty(), "both wind inwards");
        // The winding of the surface's own triangles doesn't matter, only that of the map.
        let mut rewound = surface;
        rewound.faces.iter_mut().for_each(|face| face.swap(0, 1));
        assert!(warnings(&rewound, &outward).is_empty());
    }

    #[test]
    fn the_name_of_a_file_determines_the_hemisphere_of_its_contents() {
        let (mesh, sphere) = cortex(&Cortex { subdivisions: 1, variant: 0 });
        let sphere = Sphere { path: Some("rh.sphere".into()), ..Sphere::from_mesh(&sphere).unwrap() };
        let signal = Signal::new(vec![f64::NAN; 42], 42, 1);
        for input in [Input::Mesh(mesh), Input::Signal(signal)] {
            let target = Target::with_gaps(input, Some(Path::new("lh.x")), &sphere).unwrap();
            let expected = TargetWarning::OtherHemisphere { target: Hemisphere::Left, sphere: Hemisphere::Right };
            assert_eq!((target.warnings, target.path), (vec![expected], Some("lh.x".into())));
        }
    }

    #[test]
    fn signals_count_too() {
        let sphere = Sphere::icosphere(0);
        let target = Target::from_signal(Signal::new(vec![0.5; 24], 12, 2), &sphere).unwrap();
        assert_eq!((target.channels, target.kind), (2, Kind::Signal));
        let error = Target::from_signal(Signal::new(vec![0.5; 10], 10, 1), &sphere).unwrap_err();
        assert!(error.to_string().contains("10 vertices, but the sphere has 12"), "{error}");
    }
}
