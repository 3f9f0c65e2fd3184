//! Determines by distances from a surface whether landmarks are in the surface's frame, LPS or RAS.

use super::Landmarks;
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;

/// Landmarks are converted if this makes their median distance from the surface smaller by more than this factor. In
/// the wrong frame the signs of x and y are reversed, so landmarks of a scan are typically a hundred millimetres off.
const NEARER: f64 = 4.0;

/// Landmarks and their distances from a surface.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The landmarks, in the other frame if `turned`.
    pub landmarks: Landmarks,
    /// Distance of each landmark from the surface, (n), in the surface's unit.
    pub distances: Vec<f64>,
    /// Whether the landmarks were converted from LPS to RAS or from RAS to LPS, since this makes their median distance
    /// from the surface at least four times smaller. Callers should report a conversion: the files of surface and
    /// landmarks are then in different frames.
    pub turned: bool,
}

impl Landmarks {
    /// Measures the distances of landmarks from the surface of their subject. Converts the landmarks to the other frame
    /// if they are much nearer to the surface there. Landmarks without a frame aren't converted.
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
