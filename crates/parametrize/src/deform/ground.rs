//! The surface onto which the icosphere is deformed, and the map of that surface.

use spharm_monitor::Monitor;
use spharm_surface::Mesh;
use spharm_surface::locator::SphereLocator;
use spharm_surface::nearest::TriangleTree;

use crate::error::ParametrizeError;
use crate::geometry::{Vec3, add, area, norm, scale, sub, unit};
use crate::resample::{self, CHUNK, locator, unit_vectors};

/// The surface onto which the icosphere is deformed, and the map of that surface to the sphere.
pub(super) struct Ground<'a> {
    tree: TriangleTree,
    surface: &'a Mesh,
    /// The map: a unit vector for each vertex of the surface.
    sphere: Vec<Vec3>,
    locator: SphereLocator,
    /// Square root of the ratio of the surface's area to that of the unit sphere: the mean length on the surface that
    /// corresponds to one radian.
    pub(super) scale: f64,
}

impl<'a> Ground<'a> {
    /// Builds the search structures for a surface and its sphere.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::NotBijective`] for a sphere with folds, [`ParametrizeError::Argument`] for a sphere with a
    /// vertex at the origin.
    pub(super) fn new(surface: &'a Mesh, sphere: &Mesh) -> Result<Self, ParametrizeError> {
        let total: f64 = surface.faces.iter().map(|face| area(face.map(|v| surface.vertices[v as usize]))).sum();
        Ok(Self {
            tree: TriangleTree::new(surface),
            surface,
            sphere: unit_vectors(sphere)?,
            locator: locator(sphere)?,
            scale: (total / (4.0 * std::f64::consts::PI)).sqrt(),
        })
    }

    /// Returns, for each of the given directions, the point of the surface that the map sends to this direction.
    pub(super) fn points(&self, directions: &[Vec3], monitor: &dyn Monitor) -> Result<Vec<Vec3>, ParametrizeError> {
        let mut points = Vec::with_capacity(directions.len());
        for chunk in directions.chunks(CHUNK) {
            monitor.check()?;
            points.extend(resample::points(&self.locator, self.surface, chunk)?);
        }
        Ok(points)
    }

    /// Returns the point of the surface that the map sends to a direction; `None` if no triangle contains the
    /// direction.
    fn point(&self, direction: Vec3) -> Option<Vec3> {
        let place = self.locator.locate(direction)?;
        let corners = self.locator.corners(&place).into_iter().zip(place.barycentric);
        Some(corners.fold([0.0; 3], |at, (v, w)| add(at, scale(self.surface.vertices[v as usize], w))))
    }

    /// Measures the path on the surface whose image is the arc between two directions. The path is approximated by
    /// `pieces` straight pieces. Returns the path's length times its initial direction. `ends` are the two directions,
    /// and `from` and `to` are the corresponding points of the surface.
    pub(super) fn path(&self, ends: [Vec3; 2], [from, to]: [Vec3; 2], pieces: u32) -> Vec3 {
        let (mut last, mut length, mut first) = (from, 0.0, None);
        for k in 1..=pieces {
            let t = f64::from(k) / f64::from(pieces);
            let between = || self.point(unit(add(scale(ends[0], 1.0 - t), scale(ends[1], t))));
            let Some(next) = (if k == pieces { Some(to) } else { between() }) else { continue };
            let step = sub(next, last);
            let long = norm(step);
            if long > 0.0 {
                first.get_or_insert(scale(step, 1.0 / long));
            }
            length += long;
            last = next;
        }
        scale(first.unwrap_or([0.0; 3]), length)
    }

    /// Returns the point of the surface nearest to `point`, and the direction to which the map sends this point.
    pub(super) fn nearest(&self, point: Vec3) -> Option<(Vec3, Vec3)> {
        let found = self.tree.nearest(point)?;
        let corners = self.surface.faces[found.triangle as usize];
        let weighed = |points: &[Vec3]| {
            let sum = |at: Vec3, (v, w): (u32, f64)| add(at, scale(points[v as usize], w));
            corners.into_iter().zip(found.barycentric).fold([0.0; 3], sum)
        };
        Some((weighed(&self.surface.vertices), unit(weighed(&self.sphere))))
    }
}
