//! Checks whether landmarks lie on a surface, and in which of two frames.

use super::Landmarks;
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;

/// Factor by which landmarks must be nearer to the surface after half a turn than before, to be converted. The frames
/// differ by a reflection of two axes, so landmarks of a scan are a hundred millimetres off in the wrong one.
const NEARER: f64 = 4.0;

/// Landmarks and their distances from a surface.
#[derive(Debug, Clone)]
pub struct Placed {
    /// The landmarks, converted if `turned`.
    pub landmarks: Landmarks,
    /// Distance of each landmark from the surface, (n), in its unit.
    pub distances: Vec<f64>,
    /// Whether they were converted from LPS to RAS, or back, since their median distance from the surface is then at
    /// least four times smaller. Callers should report it: the surface's file and the landmarks' are in different
    /// frames.
    pub turned: bool,
}

impl Landmarks {
    /// Measures the distances of landmarks from their subject's surface, and converts them to the other frame if they
    /// lie much nearer to it there. Landmarks whose file doesn't specify a frame aren't converted.
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
