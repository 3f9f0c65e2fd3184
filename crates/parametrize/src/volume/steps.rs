//! Warns if the degree of a model is so high that the model reproduces the steps between voxels on a label's surface.
//!
//! The surface around a label consists of the faces of voxels. On a body of radius r, a model of degree L resolves
//! lengths of `pi r / L`. If this length is below one and a half voxels, the model follows the steps between voxels,
//! and its area grows with the degree. The area of a ball of radius 10.3 voxels is 0.8 % too large at degree 8, 1.1 %
//! at 12 and 2.1 % at 20. The area of an ellipsoid with semi-axes of 4, 2 and 2 mm and voxels of 0.2 x 0.2 x 0.6 mm is
//! 0.3 %, 5.1 % and 18.1 % too large at these degrees. Sphericity has similar errors.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::surface::VolumeSurface;

/// A model follows the voxels' steps if the length that it resolves is below this number of voxels.
const VOXELS: f64 = 1.5;

/// A label is too small for a shape model if its highest suitable degree is below this value.
const LOWEST: usize = 4;

/// Warning that a model resolves the voxels of the surface that it was fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct VoxelSteps {
    /// The model's degree, L.
    pub max_degree: usize,
    /// Length that the model resolves, in mm: `pi r / L`, with r the radius of a ball of the label's volume.
    pub resolved: f64,
    /// The longest edge of a voxel, in mm.
    pub voxel: f64,
    /// The highest degree of a model that doesn't follow the voxels' steps.
    pub suitable_degree: usize,
}

/// Returns the highest degree of a model that doesn't follow the voxels' steps: the degree that resolves one and a
/// half voxels. `voxels` is the label's number of voxels, and `voxel_size` has the lengths of a voxel's edges.
#[must_use]
pub fn suitable_degree(voxels: usize, voxel_size: [f64; 3]) -> usize {
    (std::f64::consts::PI * radius(voxels, voxel_size) / (VOXELS * longest(voxel_size))) as usize
}

/// Returns the radius of a ball with the volume of a label.
fn radius(voxels: usize, voxel_size: [f64; 3]) -> f64 {
    (0.75 * voxels as f64 * voxel_size.iter().product::<f64>() / std::f64::consts::PI).cbrt()
}

fn longest(edges: [f64; 3]) -> f64 {
    edges.into_iter().fold(0.0, f64::max)
}

impl VolumeSurface {
    /// Returns a warning if the surface has the voxels' steps and a model of the given degree resolves the voxels;
    /// otherwise `None`.
    #[must_use]
    pub fn steps(&self, max_degree: usize) -> Option<VoxelSteps> {
        if self.quads.smooth.is_some() {
            return None;
        }
        let voxel = longest(self.voxel_size);
        let resolved = std::f64::consts::PI * radius(self.voxels, self.voxel_size) / max_degree.max(1) as f64;
        let suitable_degree = suitable_degree(self.voxels, self.voxel_size);
        (resolved < VOXELS * voxel).then_some(VoxelSteps { max_degree, resolved, voxel, suitable_degree })
    }
}

/// Advice given in warnings about labels that are too small.
const LEAVE_OUT: &str = "`spharm volumes --min-voxels N` leaves out small labels";

impl fmt::Display for VoxelSteps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { max_degree, resolved, voxel, suitable_degree } = self;
        let advice = match *suitable_degree {
            ..LOWEST => format!("the label is too small for a shape model: {LEAVE_OUT}"),
            degree => format!("use degrees up to {degree}"),
        };
        let biased = biased(*suitable_degree < LOWEST);
        write!(
            f,
            "a model of degree {max_degree} follows the voxels' steps: it resolves lengths down to {resolved:.3}, \
             less than {VOXELS} voxels of size {voxel:.3}, which biases {biased}; {advice}"
        )
    }
}

/// Returns the names of the measures that are biased by the voxels' steps. `small` states whether labels are too small
/// for a shape model.
fn biased(small: bool) -> &'static str {
    if small { "volume, area and sphericity" } else { "area and sphericity" }
}

/// Returns a single warning for several labels, with the names of at most 5 labels; `None` if `found` is empty.
#[must_use]
pub fn steps_of_labels(found: &[(String, VoxelSteps)]) -> Option<String> {
    const NAMED: usize = 5;
    if let [(name, steps)] = found {
        return Some(format!("{name}: {steps}"));
    }
    let (_, first) = found.first()?;
    let names: Vec<&str> = found.iter().take(NAMED).map(|(name, _)| name.as_str()).collect();
    let more = if found.len() > NAMED { ", ..." } else { "" };
    let small = found.iter().filter(|(_, steps)| steps.suitable_degree < LOWEST).count();
    let lowest = found.iter().map(|(_, steps)| steps.suitable_degree).filter(|degree| *degree >= LOWEST).min();
    let advice = match (lowest, small) {
        (Some(lowest), 0) => format!("use degrees up to {lowest}"),
        (Some(lowest), _) => {
            let few = format!("labels too small for a shape model: {small} ({LEAVE_OUT})");
            format!("{few}; for the others, use degrees up to {lowest}")
        }
        (None, _) => format!("the labels are too small for a shape model: {LEAVE_OUT}"),
    };
    Some(format!(
        "models of degree {} follow the voxels' steps of {} labels ({}{more}): they resolve lengths of less than \
         {VOXELS} voxels, which biases {}; {advice}",
        first.max_degree,
        found.len(),
        names.join(", "),
        biased(small > 0)
    ))
}

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;

    use super::super::{Affine, LabelSurface, LabelVolume, VolumeParams};
    use super::*;

    fn ellipsoid(axes: [f64; 3], voxel: [f64; 3]) -> VolumeSurface {
        let size = [0, 1, 2].map(|k| (2.0 * axes[k] / voxel[k]) as usize + 4);
        let mut values = vec![0; size.iter().product()];
        let inside = |at: [usize; 3]| {
            let x = |k: usize| (at[k] as f64 + 0.5 - 0.5 * size[k] as f64) * voxel[k] / axes[k];
            (0..3).map(|k| x(k) * x(k)).sum::<f64>() < 1.0
        };
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    values[(k * size[1] + j) * size[0] + i] = i32::from(inside([i, j, k]));
                }
            }
        }
        let volume = LabelVolume::new(size, values, Affine::of_voxel_size(voxel));
        let params = VolumeParams { surface: LabelSurface::Voxels, ..VolumeParams::default() };
        volume.surface(&params, &Silent).unwrap()
    }

    #[test]
    fn degrees_that_resolve_voxels_are_found() {
        let ball = ellipsoid([10.3; 3], [1.0; 3]);
        assert!((ball.voxel_size, ball.steps(20)) == ([1.0; 3], None));
        let steps = ball.steps(24).unwrap();
        assert!((steps.resolved - std::f64::consts::PI * 10.3 / 24.0).abs() < 0.03, "{steps:?}");
        assert!(
            (steps.suitable_degree, steps.voxel) == (21, 1.0) && ball.steps(21).is_none() && ball.steps(22).is_some()
        );
        // The longest edge of a voxel determines the suitable degree.
        let thick = ellipsoid([4.0, 2.0, 2.0], [0.2, 0.2, 0.6]);
        assert!(thick.steps(8).is_none() && thick.steps(12).is_some(), "{:?}", thick.steps(8));
        assert!(thick.steps(12).unwrap().to_string().contains("voxels of size 0.600"));
    }

    #[test]
    fn labels_are_named_together() {
        let steps = ellipsoid([4.0, 2.0, 2.0], [0.2, 0.2, 0.6]).steps(12).unwrap();
        assert_eq!(steps_of_labels(&[]), None);
        assert_eq!(steps_of_labels(&[("s1".to_owned(), steps)]).unwrap(), format!("s1: {steps}"));
        let many: Vec<(String, VoxelSteps)> = (0..9).map(|n| (format!("s{n}"), steps)).collect();
        let text = steps_of_labels(&many).unwrap();
        assert!(text.contains("9 labels (s0, s1, s2, s3, s4, ...)") && text.contains("degrees up to 8"), "{text}");
    }

    #[test]
    fn labels_too_small_for_a_shape_get_no_degree() {
        let small = ellipsoid([1.2; 3], [1.0; 3]).steps(8).unwrap();
        assert!(small.suitable_degree < LOWEST, "{small:?}");
        assert!(small.to_string().ends_with(&format!("label is too small for a shape model: {LEAVE_OUT}")), "{small}");
        assert!(small.to_string().contains("which biases volume, area and sphericity"), "{small}");
        let large = ellipsoid([4.0; 3], [1.0; 3]).steps(12).unwrap();
        let text = |found: &[VoxelSteps]| {
            let named: Vec<(String, VoxelSteps)> = found.iter().map(|steps| ("s".to_owned(), *steps)).collect();
            steps_of_labels(&named).unwrap()
        };
        let both = text(&[small, small]);
        assert!(both.contains("the labels are too small") && !both.contains("degrees up to"), "{both}");
        let mixed = text(&[small, large, large]);
        assert!(mixed.contains("too small for a shape model: 1 (") && mixed.ends_with("degrees up to 8"), "{mixed}");
    }
}
