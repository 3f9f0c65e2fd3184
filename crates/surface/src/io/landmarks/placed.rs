//! Determines whether landmarks and a surface have the same frame (LPS or RAS), from the distances between them.

use spharm_monitor::number;

use super::Landmarks;
use crate::geometry::{Vec3, bounds, diagonal, scale};
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;

/// Landmarks are converted to the other frame only if the conversion reduces their median distance from the surface by
/// more than this factor. In the wrong frame the signs of x and y are reversed, so landmarks of a scan are typically
/// off by a hundred millimetres.
const NEARER: f64 = 4.0;
/// Threshold for the median distance between landmarks and their surface, as a fraction of the surface's extent. Below
/// the threshold, the landmarks are assumed to lie on the surface. Above it, they may be in another unit.
const OFF: f64 = 0.05;
/// Minimum number of landmarks from which a unit is inferred. Fewer landmarks may lie on the surface by chance.
const LEAST: usize = 3;
/// Largest accepted distance between a surface and a landmark that guides its registration, as a fraction of the
/// surface's extent.
const FAR: f64 = 0.5;
/// Ratios between units of length that are in use, such as metres and millimetres.
const FACTORS: [f64; 6] = [10.0, 100.0, 1000.0, 0.1, 0.01, 0.001];

/// Landmarks and their distances from a surface.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The landmarks, converted to the other frame if `turned` is true.
    pub landmarks: Landmarks,
    /// Distance of each of the n landmarks from the surface, in the surface's unit.
    pub distances: Vec<f64>,
    /// Whether the landmarks were converted between LPS and RAS, because their median distance from the surface is at
    /// least four times smaller in the other frame. Callers should report a conversion, since it means that the files
    /// of the surface and the landmarks have different frames.
    pub turned: bool,
}

/// Returns the power of ten by which points must be multiplied to lie on their surface, if they seem to be in another
/// unit than the surface. Returns `None` if the points are near the surface, or far from it in every unit.
#[must_use]
pub fn unit_factor(points: &[Vec3], surface: &Mesh) -> Option<f64> {
    factor(points, &TriangleTree::new(surface), diagonal(bounds(surface.vertices.iter().copied())))
}

/// Returns a hint that landmarks are in another unit, for the end of messages about landmarks far from their surface.
/// Returns an empty text if [`unit_factor`] found no factor.
#[must_use]
pub fn unit_hint(factor: Option<f64>) -> String {
    factor.map_or_else(String::new, |factor| {
        format!("; multiplied by {factor}, the landmarks lie on the surface, so they seem to be in another unit")
    })
}

fn factor(points: &[Vec3], tree: &TriangleTree, extent: f64) -> Option<f64> {
    let off = |factor: f64| {
        let distance = |point: &Vec3| tree.nearest(scale(*point, factor)).map_or(f64::INFINITY, |found| found.distance);
        median(&points.iter().map(distance).collect::<Vec<_>>())
    };
    let least = OFF * extent;
    let stored = off(1.0);
    if points.len() < LEAST || stored <= least {
        return None;
    }
    let best = FACTORS.into_iter().map(|factor| (factor, off(factor))).min_by(|a, b| a.1.total_cmp(&b.1));
    best.filter(|(_, there)| *there <= least && NEARER * there < stored).map(|(factor, _)| factor)
}

/// A landmark that can't guide a registration, because it is far from its surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarGuide {
    /// Index of the farthest landmark, counted from 0.
    pub landmark: usize,
    /// Distance of this landmark from the surface, in the surface's unit.
    pub distance: f64,
    /// Factor by which the landmarks must be multiplied to lie on the surface, if the landmarks are in another unit.
    pub factor: Option<f64>,
}

impl FarGuide {
    /// Returns the landmark that is farthest from a surface if it is farther than half the surface's extent, or if the
    /// landmarks are in another unit.
    #[must_use]
    pub fn of(points: &[Vec3], surface: &Mesh) -> Option<Self> {
        let tree = TriangleTree::new(surface);
        let off = |point: &Vec3| tree.nearest(*point).map(|found| found.distance);
        let distances = points.iter().map(off).collect::<Option<Vec<f64>>>()?;
        let (landmark, distance) = distances.into_iter().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let extent = diagonal(bounds(surface.vertices.iter().copied()));
        // Search for another unit only if a landmark is far from the surface, which is rare.
        let factor = (distance > OFF * extent).then(|| factor(points, &tree, extent)).flatten();
        (factor.is_some() || distance > FAR * extent).then_some(Self { landmark, distance, factor })
    }

    /// Returns the reason why the landmark can't guide a registration. `name` is the landmark's name in the text.
    #[must_use]
    pub fn reason(&self, name: &str) -> String {
        format!(
            "landmarks that guide a registration must lie near the surface, in its unit and frame; {name} is at a \
             distance of {}{}",
            number(self.distance),
            unit_hint(self.factor)
        )
    }
}

impl std::fmt::Display for FarGuide {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.reason(&format!("landmark {} (counted from 0)", self.landmark)))
    }
}

impl Landmarks {
    /// Measures the distances of landmarks from the surface of their subject. Converts the landmarks to the other frame
    /// if they are much nearer to the surface after the conversion. Landmarks without a frame aren't converted.
    #[must_use]
    pub fn laid_on(&self, surface: &Mesh) -> Placed {
        let tree = TriangleTree::new(surface);
        let distances = |landmarks: &Self| -> Vec<f64> {
            let distance = |&point: &_| tree.nearest(point).map_or(f64::INFINITY, |found| found.distance);
            landmarks.points.iter().map(distance).collect()
        };
        let stored = distances(self);
        if let Some(frame) = self.frame {
            let other = self.in_frame(frame.other());
            let there = distances(&other);
            if NEARER * median(&there) < median(&stored) {
                return Placed { landmarks: other, distances: there, turned: true };
            }
        }
        Placed { landmarks: self.clone(), distances: stored, turned: false }
    }
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
