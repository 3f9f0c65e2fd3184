//! Defines [`Sphere`], the directions over which surfaces are fitted, and checks spheres before any work starts.

use std::fmt;
use std::path::{Path, PathBuf};

use spharm_harmonics::Directions;

use crate::angles::read_angles;
use crate::error::SurfaceError;
use crate::generate::icosphere;
use crate::geometry::{solid_angle, winding_number};
use crate::hemisphere::Hemisphere;
use crate::io::{name_without_gz, read_mesh};
use crate::mesh::Mesh;
use crate::seam::Seam;
use crate::topology::Topology;

/// The directions of a sampling scheme, with triangles if the scheme was made from a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Sphere {
    /// Path of the sphere's file, or `None` if the sphere was made in memory.
    pub path: Option<PathBuf>,
    /// The n directions as unit vectors, an array of shape (n, 3).
    pub directions: Directions,
    /// Triangles over `directions`; empty if the directions were given without triangles.
    pub faces: Vec<[u32; 3]>,
    /// GIfTI's `AnatomicalStructurePrimary`, such as `CortexLeft`.
    pub anatomical_structure: Option<String>,
    /// The relation to the original surface, if the sphere belongs to a surface that was cut open at its handles.
    pub seam: Option<Seam>,
    /// Whether the sphere was made from a single surface by parametrisation. By default, a fit over such a sphere is
    /// smoothed slightly.
    pub parametrized: bool,
    /// Possible problems, which the caller may display or reject.
    pub warnings: Vec<SphereWarning>,
}

/// A property of a sphere that doesn't prevent a fit but may be a mistake.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SphereWarning {
    /// The vertices' largest and smallest distance from the origin differ by more than the fraction
    /// [`RADIUS_SPREAD`](Self::RADIUS_SPREAD) of the largest. The mesh isn't a sphere, or isn't centred at the origin.
    RadiusSpread {
        /// Smallest distance, in the file's unit.
        min: f64,
        /// Largest distance, in the file's unit.
        max: f64,
    },
    /// The triangles don't form a closed surface of genus zero.
    NotClosed(Topology),
    /// The triangles are wound clockwise seen from outside.
    Inwards,
    /// Some directions equal an earlier direction, bit for bit.
    RepeatedDirections {
        /// Number of directions that equal an earlier one.
        count: usize,
    },
}

impl SphereWarning {
    /// The spread of radii, `(max - min) / max`, above which the warning [`RadiusSpread`](Self::RadiusSpread) is
    /// given.
    pub const RADIUS_SPREAD: f64 = 0.01;
}

impl fmt::Display for SphereWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RadiusSpread { min, max } => {
                let percent = 100.0 * (max - min) / max;
                write!(
                    f,
                    "the radii range from {min:.4} to {max:.4} ({percent:.1} % apart); check that this is a sphere \
                     centred at the origin"
                )
            }
            Self::NotClosed(topology) => write!(f, "not a closed sphere: {}", topology.problems().join("; ")),
            Self::Inwards => f.write_str(
                "the triangles wind inwards: seen from outside, their corners run clockwise, as in a mesh turned \
                 inside out",
            ),
            Self::RepeatedDirections { count: 1 } => f.write_str("1 direction is equal to an earlier direction"),
            Self::RepeatedDirections { count } => write!(f, "{count} directions are equal to earlier directions"),
        }
    }
}

impl Sphere {
    /// Returns the icosphere with `level` subdivisions, which has `10 * 4^level + 2` directions.
    ///
    /// # Panics
    ///
    /// Panics if `level` is above 14, as in [`icosphere`].
    #[must_use]
    pub fn icosphere(level: u32) -> Self {
        let mesh = icosphere(level);
        let directions = Directions::from_vertices(&mesh.vertices).expect("vertices of an icosphere are unit vectors");
        Self { faces: mesh.faces, ..Self::from_directions(directions) }
    }

    /// Returns a sphere that consists of directions only, without triangles.
    ///
    /// Areas, quadrature and reconstruction as a surface require triangles; see [`from_mesh`](Self::from_mesh).
    #[must_use]
    pub fn from_directions(directions: Directions) -> Self {
        let warnings = Self::repeated(&directions).into_iter().collect();
        Self {
            path: None,
            directions,
            faces: Vec::new(),
            anatomical_structure: None,
            seam: None,
            parametrized: false,
            warnings,
        }
    }

    /// Returns the sphere of a mesh, which must be centred at the origin and can have any radius.
    ///
    /// # Errors
    ///
    /// [`NoDirection`](SurfaceError::NoDirection) for a vertex at the origin or not finite;
    /// [`IndexOutOfRange`](SurfaceError::IndexOutOfRange) if a triangle refers to a missing vertex;
    /// [`Seam`](SurfaceError::Seam) if the seam in the metadata doesn't match the mesh;
    /// [`OriginOutside`](SurfaceError::OriginOutside) or [`SeveralTurns`](SurfaceError::SeveralTurns) for a closed mesh
    /// that doesn't wind around the origin exactly once.
    pub fn from_mesh(mesh: &Mesh) -> Result<Self, SurfaceError> {
        Self::check(mesh, Path::new("the sphere"))
    }

    /// Returns each vertex's share of the sphere's area, in steradians: a third of the area of the triangles around it.
    /// The shares sum to 4 pi if the triangles cover the sphere once. Without triangles, all shares are zero.
    #[must_use]
    pub fn areas(&self) -> Vec<f64> {
        let unit = self.directions.as_slice();
        let mut areas = vec![0.0; unit.len()];
        for face in &self.faces {
            let share = solid_angle(face.map(|v| unit[v as usize])).abs() / 3.0;
            face.iter().for_each(|&v| areas[v as usize] += share);
        }
        areas
    }

    /// Returns the sphere as a mesh of radius 1.
    #[must_use]
    pub fn to_mesh(&self) -> Mesh {
        let mut mesh = Mesh::new(self.directions.as_slice().to_vec(), self.faces.clone());
        mesh.meta.anatomical_structure_primary.clone_from(&self.anatomical_structure);
        mesh
    }

    /// Returns the hemisphere of the brain to which the sphere belongs, according to its metadata or its file's name.
    #[must_use]
    pub fn hemisphere(&self) -> Option<Hemisphere> {
        Hemisphere::of(self.anatomical_structure.as_deref(), self.path.as_deref())
    }

    /// Returns the name used in messages: the path of the sphere's file, or "the sphere".
    #[must_use]
    pub fn name(&self) -> &Path {
        self.path.as_deref().unwrap_or(Path::new("the sphere"))
    }

    fn check(mesh: &Mesh, name: &Path) -> Result<Self, SurfaceError> {
        let path = || name.to_owned();
        let directions = Directions::from_vertices(&mesh.vertices)
            .map_err(|cause| SurfaceError::NoDirection { path: path(), cause })?;
        crate::io::check_indices(name, mesh)?;
        let mut warnings = Vec::new();
        let radii = directions.radii();
        if radii.spread() > SphereWarning::RADIUS_SPREAD {
            warnings.push(SphereWarning::RadiusSpread { min: radii.min, max: radii.max });
        }
        let topology = Topology::of(mesh);
        if topology.is_sphere() {
            let turns = winding_number(directions.as_slice(), &mesh.faces);
            match turns.abs().round() as u64 {
                0 => return Err(SurfaceError::OriginOutside { path: path() }),
                1 if turns < 0.0 => warnings.push(SphereWarning::Inwards),
                1 => {}
                turns => return Err(SurfaceError::SeveralTurns { path: path(), turns }),
            }
        } else {
            warnings.push(SphereWarning::NotClosed(topology));
        }
        warnings.extend(Self::repeated(&directions));
        let seam = Seam::of(&mesh.meta).map(|seam| seam.checked(directions.len(), mesh.faces.len())).transpose();
        let seam = seam.map_err(|found| SurfaceError::Seam { path: path(), found })?;
        Ok(Self {
            seam,
            path: None,
            directions,
            faces: mesh.faces.clone(),
            anatomical_structure: mesh.meta.anatomical_structure_primary.clone(),
            parametrized: false,
            warnings,
        })
    }

    fn repeated(directions: &Directions) -> Option<SphereWarning> {
        let count = directions.duplicates();
        (count > 0).then_some(SphereWarning::RepeatedDirections { count })
    }
}

/// Reads a sphere from a mesh or a table. A mesh may have any supported format and any radius, and must be centred at
/// the origin. A table (`.csv`, `.tsv`, also gzipped) has one direction per row: colatitude and azimuth in radians. If
/// the table has a header, the names in it determine the columns and their units. `theta` or `colatitude` and `phi` or
/// `azimuth` are in radians, `lat` and `lon` are in degrees, and the suffixes `_deg` and `_rad` specify other units.
///
/// # Errors
///
/// The errors of [`read_mesh`] or [`read_signal`](crate::io::read_signal) if the file can't be read; the errors of
/// [`Sphere::from_mesh`]; [`NotAngles`](SurfaceError::NotAngles) if a table doesn't have two columns;
/// [`Unsupported`](SurfaceError::Unsupported) if its header has other names, or if angles in degrees without the suffix
/// `_deg` look like radians; [`Colatitude`](SurfaceError::Colatitude) if a colatitude or latitude is out of range.
pub fn read_sphere(path: impl AsRef<Path>) -> Result<Sphere, SurfaceError> {
    let path = path.as_ref();
    let name = name_without_gz(path);
    let sphere = if name.ends_with(".csv") || name.ends_with(".tsv") {
        Sphere::from_directions(read_angles(path)?)
    } else {
        Sphere::check(&read_mesh(path)?, path)?
    };
    Ok(Sphere { path: Some(path.to_owned()), ..sphere })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moved(by: [f64; 3]) -> Mesh {
        let ball = icosphere(2);
        ball.with_vertices(ball.vertices.iter().map(|&v| crate::geometry::add(v, by)).collect())
    }

    #[test]
    fn areas_sum_to_the_whole_sphere() {
        let sphere = Sphere::icosphere(3);
        assert_eq!(sphere.directions.len(), 642);
        assert!(sphere.warnings.is_empty());
        assert!((sphere.areas().iter().sum::<f64>() - 4.0 * std::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn a_sphere_off_the_origin_is_warned_of_and_one_beside_it_refused() {
        let near = Sphere::from_mesh(&moved([0.3, 0.0, 0.0])).unwrap();
        let [SphereWarning::RadiusSpread { min, max }] = near.warnings[..] else { panic!("{:?}", near.warnings) };
        assert!((min - 0.7).abs() < 0.01 && (max - 1.3).abs() < 0.01, "{min} {max}");
        assert!(near.warnings[0].to_string().contains(" % apart"), "{}", near.warnings[0]);
        let beside = Sphere::from_mesh(&moved([3.0, 0.0, 0.0])).unwrap_err();
        assert!(matches!(beside, SurfaceError::OriginOutside { .. }), "{beside}");
        assert!(beside.to_string().starts_with("the sphere: the origin lies outside"), "{beside}");
    }

    #[test]
    fn holes_winding_and_repetitions_are_warned_of() {
        let mut mesh = icosphere(1);
        mesh.faces.iter_mut().for_each(|face| face.swap(0, 1));
        assert_eq!(Sphere::from_mesh(&mesh).unwrap().warnings, [SphereWarning::Inwards]);
        mesh.faces.truncate(70);
        mesh.vertices[1] = mesh.vertices[0];
        let warnings = Sphere::from_mesh(&mesh).unwrap().warnings;
        assert!(
            matches!(&warnings[..], [SphereWarning::NotClosed(_), SphereWarning::RepeatedDirections { count: 1 }]),
            "{warnings:?}"
        );
        mesh.faces[0][0] = 4000;
        let error = Sphere::from_mesh(&mesh).unwrap_err();
        assert!(matches!(error, SurfaceError::IndexOutOfRange { face: 0, index: 4000, .. }), "{error}");
    }
}
