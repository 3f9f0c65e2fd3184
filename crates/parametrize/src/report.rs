//! Defines the result of a method: the map, and a report on it.

use std::time::Instant;

use serde::{Serialize, Serializer};
use spharm_monitor::number;
use spharm_surface::Mesh;
use spharm_surface::metrics::SurfaceDistance;

use crate::error::ParametrizeError;
use crate::quality::Quality;

/// A surface and its map to the sphere.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Parametrization {
    /// The given surface. Methods that make a new surface (equal-area, [`deform`](crate::deform()),
    /// [`resample`](crate::resample())) store the new surface here.
    pub surface: Mesh,
    /// The sphere: the surface's triangles, with a unit vector for each vertex of the surface in the same order.
    pub sphere: Mesh,
    /// Report on the method's work and the quality of the map.
    pub report: Report,
    /// Distance between the given surface and the resampled surface; `None` if the surface wasn't resampled.
    pub resampling: Option<Resampling>,
}

impl Parametrization {
    /// Returns a map that was made elsewhere, after checking that it is one to one. The surface and the sphere must
    /// have the same triangles.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::NotBijective`] if the map is not one to one.
    ///
    /// # Panics
    ///
    /// When the numbers of vertices differ, or a triangle's vertex index is out of range.
    pub fn given(surface: Mesh, sphere: Mesh) -> Result<Self, ParametrizeError> {
        Self::checked("given", surface, sphere, Instant::now(), "map the surface again")
    }

    /// Verifies that a map is one to one, and returns it with a report.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::NotBijective`] with the advice `remedy` if the map is not one to one.
    pub(crate) fn checked(
        method: &'static str,
        surface: Mesh,
        sphere: Mesh,
        started: Instant,
        remedy: &'static str,
    ) -> Result<Self, ParametrizeError> {
        let quality = Quality::of(&surface, &sphere);
        if !quality.is_bijective() {
            let Quality { flipped, degenerate, triangles, .. } = quality;
            return Err(ParametrizeError::NotBijective { method, flipped, degenerate, triangles, remedy });
        }
        let report = Report {
            method,
            vertices: surface.vertices.len(),
            quality,
            iterations: 0,
            converged: false,
            seconds: started.elapsed().as_secs_f64(),
            quad_area_deviation: None,
            notes: Vec::new(),
            warnings: Vec::new(),
        };
        Ok(Self { surface, sphere, report, resampling: None })
    }

    /// Returns the orientation and distortion of the map.
    #[must_use]
    pub fn quality(&self) -> &Quality {
        &self.report.quality
    }

    /// Checks that rounding the sphere's coordinates to 32-bit numbers, as some file formats do, keeps the map one to
    /// one.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::SinglePrecision`], with the number of triangles that would be flipped or without area.
    pub fn check_single_precision(&self) -> Result<(), ParametrizeError> {
        let rounded = self.sphere.vertices.iter().map(|p| p.map(|x| f64::from(x as f32))).collect();
        let quality = Quality::of(&self.surface, &self.sphere.with_vertices(rounded));
        if quality.is_bijective() {
            return Ok(());
        }
        Err(ParametrizeError::SinglePrecision { flipped: quality.flipped + quality.degenerate })
    }

    /// Merges the report of the map from which this map was made into this map's report.
    pub(crate) fn after(mut self, first: &Report) -> Self {
        let report = &mut self.report;
        report.seconds += first.seconds;
        report.iterations += first.iterations;
        let source = Note::MadeFrom { method: first.method, vertices: first.vertices };
        report.notes.splice(0..0, std::iter::once(source).chain(first.notes.iter().cloned()));
        report.warnings.splice(0..0, first.warnings.iter().cloned());
        self
    }
}

/// Report on a method's work, and the quality of its map.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Name of the method: `cald`, `conformal`, `stretch`, `equal-area`, `deform` or `resample`; `given` for a map made
    /// elsewhere.
    pub method: &'static str,
    /// Number of vertices of the surface.
    pub vertices: usize,
    /// Orientation and distortion of the map.
    pub quality: Quality,
    /// Number of optimisation steps over the whole mesh, summed over all levels.
    pub iterations: usize,
    /// Whether the optimisation met its tolerance; `false` if it reached its largest number of steps first.
    pub converged: bool,
    /// Time taken to compute the map, in seconds.
    pub seconds: f64,
    /// For equal-area: the largest relative deviation of a quadrangle's area on the sphere from its target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quad_area_deviation: Option<f64>,
    /// Facts about the map that the other fields don't contain; serialised as sentences.
    pub notes: Vec<Note>,
    /// Possible reasons why the map is unfit for its purpose; serialised as sentences.
    pub warnings: Vec<Warning>,
}

/// Distance between the given surface and its resampled version.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Resampling {
    /// Distance between the given surface (first) and the resampled surface (second), in the given surface's unit.
    pub distance: SurfaceDistance,
    /// Number of pairs of intersecting triangles of the resampled surface; `None` if the method doesn't search for
    /// intersections.
    pub self_intersections: Option<usize>,
}

/// A fact about a map. `Display` formats the fact as a phrase.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Note {
    /// The method `cald` adapted the target areas to the residual of a model.
    AreasAdapted {
        /// Degree of the model.
        degree: usize,
        /// The largest factor by which a triangle's target area grew.
        factor: f64,
    },
    /// How closely the quadrangles' areas on the sphere agree with their targets.
    QuadAreas {
        /// The largest relative deviation of an area from its target.
        deviation: f64,
    },
    /// The map was made from another map, for example by resampling.
    MadeFrom {
        /// Name of the method that made the other map.
        method: &'static str,
        /// Number of vertices of the other map.
        vertices: usize,
    },
    /// Distance between the given surface and the resampled surface.
    Distance(SurfaceDistance),
}

impl std::fmt::Display for Note {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::AreasAdapted { degree, factor } => write!(
                f,
                "target areas were adapted to the residual of a model of degree {degree}, by factors up to {factor:.2}"
            ),
            Self::QuadAreas { deviation } => {
                write!(f, "the areas of the quadrangles are within {:.3} % of their targets", 100.0 * deviation)
            }
            Self::MadeFrom { method, vertices } => {
                write!(f, "made from the {method} map, which has {vertices} vertices")
            }
            Self::Distance(distance) => write!(
                f,
                "distance from the given surface: mean {}, Hausdorff {}, in the surface's unit; mean {}, Hausdorff {} \
                 with the bounding box scaled to volume 1",
                number(distance.mean),
                number(distance.hausdorff),
                number(distance.mean / distance.scale),
                number(distance.hausdorff / distance.scale)
            ),
        }
    }
}

impl Serialize for Note {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A possible reason why a map is unfit for its purpose. `Display` formats the reason as a phrase.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// The first method failed, so another method made the map.
    FellBack {
        /// Name of the method that failed.
        method: &'static str,
        /// Error message of the method that failed.
        cause: String,
    },
    /// The Moebius transformation of least area distortion would have flipped triangles, so a smaller transformation
    /// was applied.
    CentringStopped,
    /// Vertices were moved off the given surface because the triangles around them intersected.
    Smoothed {
        /// Number of moved vertices.
        vertices: usize,
    },
    /// Triangles of the resampled surface intersect.
    SelfIntersections {
        /// Number of pairs of intersecting triangles.
        pairs: usize,
    },
    /// The triangles of the given mesh wind inwards, so its volume is negative. The map is correct, but surfaces with
    /// these triangles, such as reconstructions over the map's sphere, are inside out.
    Inward,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::FellBack { method, cause } => write!(f, "the method {method} was tried first and failed: {cause}"),
            Self::CentringStopped => f.write_str(
                "the final centring (a Moebius transformation) stopped early, because a larger step would have \
                 flipped triangles",
            ),
            Self::Smoothed { vertices: 1 } => {
                f.write_str("the surface was smoothed at 1 vertex, where triangles intersected")
            }
            Self::Smoothed { vertices } => {
                write!(f, "the surface was smoothed at {vertices} vertices, where triangles intersected")
            }
            Self::SelfIntersections { pairs } => {
                let pairs = if *pairs == 1 {
                    "1 pair of triangles still intersects"
                } else {
                    &format!("{pairs} pairs of triangles still intersect")
                };
                write!(f, "{pairs}: use more subdivisions, unless the given surface intersects itself")
            }
            Self::Inward => f.write_str(
                "the triangles wind inwards (negative volume), so reconstructions over the model's own sphere are \
                 inside out; the option `fix` reverses the triangles",
            ),
        }
    }
}

impl Serialize for Warning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
