//! The result of a method: the map, and a report on it.

use std::time::Instant;

use serde::{Serialize, Serializer};
use spharm_surface::Mesh;
use spharm_surface::metrics::SurfaceDistance;

use crate::error::ParametrizeError;
use crate::quality::Quality;

/// A surface and its map to the sphere.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Parametrization {
    /// The surface: the given mesh, or the new one if the method makes one (volumes, [`deform`](crate::deform()),
    /// [`resample`](crate::resample())).
    pub surface: Mesh,
    /// The sphere: the surface's triangles over unit vectors, one per vertex of the surface, in the same order.
    pub sphere: Mesh,
    /// Report on the method's work and the quality of the map.
    pub report: Report,
    /// Distance of a surface on a new sampling from the given one; `None` if the surface is the given one.
    pub resampling: Option<Resampling>,
}

impl Parametrization {
    /// Returns a map made elsewhere, for a surface and a sphere with the same triangles.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::NotBijective`] if it is not one to one.
    ///
    /// # Panics
    ///
    /// When the numbers of vertices differ, or a triangle's vertex number is out of range.
    pub fn given(surface: Mesh, sphere: Mesh) -> Result<Self, ParametrizeError> {
        Self::checked("given", surface, sphere, Instant::now(), "map the surface again")
    }

    /// Returns a map after verifying that it is one to one.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::NotBijective`] if it is not, with `remedy` as its advice.
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

    /// Returns orientation and distortion of the map.
    #[must_use]
    pub fn quality(&self) -> &Quality {
        &self.report.quality
    }

    /// Checks that rounding the sphere's coordinates to 32-bit numbers, as some file formats do, would flip no
    /// triangle.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::SinglePrecision`], with the number of triangles.
    pub fn check_single_precision(&self) -> Result<(), ParametrizeError> {
        let rounded = self.sphere.vertices.iter().map(|p| p.map(|x| f64::from(x as f32))).collect();
        let quality = Quality::of(&self.surface, &self.sphere.with_vertices(rounded));
        if quality.is_bijective() {
            return Ok(());
        }
        Err(ParametrizeError::SinglePrecision { flipped: quality.flipped + quality.degenerate })
    }

    /// Merges in the report of the map that this one was made from.
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
    /// The method: `cald`, `conformal`, `stretch`, `equal-area`, `deform` or `resample`; `given` for a map made
    /// elsewhere.
    pub method: &'static str,
    /// Number of vertices.
    pub vertices: usize,
    /// Orientation and distortion.
    pub quality: Quality,
    /// Optimisation steps over the whole mesh, summed over all levels.
    pub iterations: usize,
    /// Whether the optimisation met its tolerance; `false` when it stopped at its limit of steps.
    pub converged: bool,
    /// Elapsed seconds from the mesh to the map.
    pub seconds: f64,
    /// For equal-area: the largest relative deviation of a quadrangle's area on the sphere from its target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quad_area_deviation: Option<f64>,
    /// Facts about the map that the other fields don't contain; serialised as sentences.
    pub notes: Vec<Note>,
    /// Possible reasons why the map is unfit for its purpose; serialised as sentences.
    pub warnings: Vec<Warning>,
}

/// Distance between the given surface and the one on a new sampling.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Resampling {
    /// From the given surface (first) to the new one (second), in the given surface's unit.
    pub distance: SurfaceDistance,
    /// Pairs of the new surface's triangles that intersect; `None` if this wasn't checked.
    pub self_intersections: Option<usize>,
}

/// A fact about a map. `Display` gives it as a phrase.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Note {
    /// cald adapted the target areas to the residual of a model.
    AreasAdapted {
        /// Degree of the model.
        degree: usize,
        /// The largest factor by which a triangle's target area grew.
        factor: f64,
    },
    /// Agreement of the quadrangles' areas with their targets.
    QuadAreas {
        /// The largest relative deviation.
        deviation: f64,
    },
    /// The map was made from another one.
    MadeFrom {
        /// The method of that map.
        method: &'static str,
        /// Its number of vertices.
        vertices: usize,
    },
    /// Distance of the new surface from the given one.
    Distance(SurfaceDistance),
}

impl std::fmt::Display for Note {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::AreasAdapted { degree, factor } => write!(
                f,
                "areas are adapted to the residual of a model of degree {degree}, by factors up to {factor:.2}"
            ),
            Self::QuadAreas { deviation } => {
                write!(f, "the areas of the quadrangles are within {:.3} % of their targets", 100.0 * deviation)
            }
            Self::MadeFrom { method, vertices } => write!(f, "made from the {method} map of {vertices} vertices"),
            Self::Distance(distance) => write!(
                f,
                "distance from the given surface: mean {:.3e}, Hausdorff {:.3e}, in its unit; {:.3e} and {:.3e} once \
                 its bounding box has volume 1",
                distance.mean,
                distance.hausdorff,
                distance.mean / distance.scale,
                distance.hausdorff / distance.scale
            ),
        }
    }
}

impl Serialize for Note {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A possible reason why a map is unfit for its purpose. `Display` gives it as a phrase.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// The first method failed, and the map was made by another one.
    FellBack {
        /// The method that failed.
        method: &'static str,
        /// Its error.
        cause: String,
    },
    /// The Moebius transformation of least area distortion would have flipped triangles; a smaller one was applied.
    CentringStopped,
    /// Vertices were moved off the given surface, where triangles intersected.
    Smoothed {
        /// Number of these vertices.
        vertices: usize,
    },
    /// Triangles of the new surface intersect.
    SelfIntersections {
        /// Number of intersecting pairs.
        pairs: usize,
    },
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::FellBack { method, cause } => write!(f, "{method} was tried first and failed: {cause}"),
            Self::CentringStopped => {
                f.write_str("the last centring stopped early: going further would have flipped triangles")
            }
            Self::Smoothed { vertices: 1 } => f.write_str("1 vertex was smoothed where triangles intersected"),
            Self::Smoothed { vertices } => write!(f, "{vertices} vertices were smoothed where triangles intersected"),
            Self::SelfIntersections { pairs } => {
                let pairs = if *pairs == 1 {
                    "1 pair of triangles still intersects"
                } else {
                    &format!("{pairs} pairs of triangles still intersect")
                };
                write!(f, "{pairs}: take more subdivisions, unless the given surface intersects itself")
            }
        }
    }
}

impl Serialize for Warning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
