//! Computes intermediate shapes between two surfaces.
//!
//! The first surface, with coefficients a, is [aligned](mod@crate::align) to the second one, with coefficients b. The
//! alignment T consists of a similarity of space and, unless its method is [`FixedParameters`], a rotation of the
//! parameters. The shape, without row 0, is interpolated linearly: `(1 - t) T a + t b`. If the pose of the first
//! surface is kept, poses are interpolated along the shortest path. The rotation in space has a constant angular speed
//! (K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985). The scale is interpolated geometrically,
//! and the position linearly. A path between two surfaces that differ only in pose therefore doesn't deform them. If
//! surfaces don't correspond well, the shape at t = 1/2 has a small volume: see [`volume_ratio`].
//!
//! [`FixedParameters`]: crate::Method::FixedParameters

use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_monitor::Monitor;

use crate::align::{AlignParams, Alignment, Method, align};
use crate::matrix3::transposed;
use crate::transform::{SQRT_4_PI, Similarity, transform_object};
use crate::{MeasureParams, Rotation, ShapeError, measure};

/// Minimum volume at t = 1/2, as a fraction of the smaller of the volumes at t = 0 and t = 1. If the volume is below
/// this minimum, the surfaces don't correspond.
pub const LEAST_VOLUME: f64 = 0.8;

/// Returns the default method of alignment for a path between two models. Members of one group keep their parameters,
/// because these already correspond. If mirror images may be matched (`mirror`), the parameters must be searched too.
#[must_use]
pub fn default_method(from: &Model, to: &Model, mirror: bool) -> Method {
    if from.is_in_group_of(to) && !mirror { Method::FixedParameters } else { Method::Joint }
}

/// A path between two surfaces of the same degree.
#[derive(Debug, Clone)]
pub struct Morph {
    /// The first surface, transformed to the second surface's parameters and pose.
    start: Coefficients,
    end: Coefficients,
    /// Similarity from the first surface's pose to the second surface's, as found by the alignment.
    pose: Similarity,
    /// Alignment of the surfaces.
    pub alignment: Alignment,
    keep_pose: bool,
}

impl Morph {
    /// Aligns `from` to `to` and creates the path between them, at the lower of the two degrees. If `keep_pose` is set,
    /// the path starts in the pose of `from`. Otherwise the surfaces at all times t are in the pose of `to`.
    ///
    /// # Errors
    ///
    /// The errors of [`align()`]; [`ShapeError::Setting`] if the pose is kept and the alignment is mirrored, because no
    /// rotation connects the two poses.
    pub fn new(
        from: &Coefficients,
        to: &Coefficients,
        params: &AlignParams,
        keep_pose: bool,
        monitor: &dyn Monitor,
    ) -> Result<Self, ShapeError> {
        let alignment = align(from, to, params, monitor)?;
        let pose = alignment.report.transform.similarity;
        if keep_pose && pose.mirrors() {
            return Err(ShapeError::Setting {
                name: "the alignment",
                found: "mirrored, so the pose can't be kept".to_owned(),
                expected: "morph in the target's pose instead",
            });
        }
        let degree = alignment.coefficients.max_degree().min(to.max_degree());
        let cut = |surface: &Coefficients| Coefficients::new(surface.up_to(degree).to_owned());
        Ok(Self { start: cut(&alignment.coefficients)?, end: cut(to)?, pose, alignment, keep_pose })
    }

    /// Returns the surface at time t: 0 is the first surface, 1 the second one.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Setting`] if t isn't finite.
    pub fn at(&self, t: f64) -> Result<Coefficients, ShapeError> {
        if !t.is_finite() {
            let found = t.to_string();
            return Err(ShapeError::Setting { name: "the time of a morph", found, expected: "it must be finite" });
        }
        let shape = Coefficients::new(self.start.values() * (1.0 - t) + self.end.values() * t)?;
        if !self.keep_pose {
            return Ok(shape);
        }
        // At time t, the pose maps x to Q(t)^T (x - c) / s(t) + c'(t). Here c is the shape's centre, c'(t) is its
        // interpolated position, and Q(t) and s(t) are the parts of the alignment's rotation and scale that remain at
        // time t.
        let rotation = Rotation::from_matrix(self.pose.orthogonal)?;
        let part = portion(&rotation, 1.0 - t)?;
        let scale = self.pose.scale.powf(1.0 - t);
        let centre =
            |surface: &Coefficients| -> [f64; 3] { std::array::from_fn(|k| surface.values()[[0, k]] / SQRT_4_PI) };
        let (first, second, here) = (centre(&self.start), centre(&self.end), centre(&shape));
        // The centre of the first surface before the alignment.
        let back = transposed(&self.pose.orthogonal);
        let before: [f64; 3] = {
            let moved: [f64; 3] = std::array::from_fn(|k| (first[k] - self.pose.translation[k]) / self.pose.scale);
            std::array::from_fn(|i| (0..3).map(|j| back[i][j] * moved[j]).sum())
        };
        let place: [f64; 3] = std::array::from_fn(|k| (1.0 - t) * before[k] + t * second[k]);
        let orthogonal = transposed(&part.matrix());
        let turned: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| orthogonal[i][j] * here[j]).sum::<f64>() / scale);
        let translation = std::array::from_fn(|k| place[k] - turned[k]);
        transform_object(&shape, &Similarity { orthogonal, scale: 1.0 / scale, translation })
    }
}

/// Returns the fraction `share` of a rotation: the rotation about its axis by that fraction of its angle.
fn portion(rotation: &Rotation, share: f64) -> Result<Rotation, ShapeError> {
    let m = rotation.matrix();
    let angle = rotation.angle();
    let axis = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 1e-6 {
        return Rotation::from_axis_angle(axis, share * angle);
    }
    if angle < 1.0 {
        return Ok(Rotation::IDENTITY);
    }
    // R is a half turn, for which 1 + R is twice the projection onto the axis.
    let plus: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| m[i][j] + f64::from(i == j)));
    let longest = (0..3).max_by(|&a, &b| plus[a][a].total_cmp(&plus[b][b])).unwrap_or(0);
    Rotation::from_axis_angle(plus[longest], share * angle)
}

/// Returns the volume at t = 1/2 divided by the smaller of the volumes at t = 0 and t = 1. If the ratio is below
/// [`LEAST_VOLUME`], the surfaces don't correspond.
///
/// # Errors
///
/// The errors of [`measure`].
pub fn volume_ratio(morph: &Morph, monitor: &dyn Monitor) -> Result<f64, ShapeError> {
    let volume =
        |surface: &Coefficients| Ok::<_, ShapeError>(measure(surface, &MeasureParams::default(), monitor)?.volume);
    let middle = Coefficients::new((morph.start.values() + morph.end.values()) * 0.5)?;
    let least = volume(&morph.start)?.abs().min(volume(&morph.end)?.abs());
    Ok(volume(&middle)?.abs() / least)
}

/// Returns a warning if the ratio from [`volume_ratio`] is below [`LEAST_VOLUME`].
#[must_use]
pub fn volume_warning(ratio: f64) -> Option<String> {
    (ratio < LEAST_VOLUME).then(|| {
        format!(
            "halfway between the surfaces, the volume is {ratio:.2} times that of the smaller surface: the surfaces \
             don't correspond, and the shapes between them are unreliable"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix3::product;
    use crate::{Transform, rmsd};
    use ndarray::Array2;
    use spharm_monitor::Silent;

    fn body(degree: usize, seed: f64) -> Coefficients {
        let count = (degree + 1) * (degree + 1);
        let mut values = Array2::from_shape_fn((count, 3), |(k, c)| {
            let l = (k as f64).sqrt().floor();
            0.4 * ((seed + 7.3 * k as f64 + 1.9 * c as f64).sin()) / (1.0 + l * l)
        });
        (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 5.0, 3.0);
        Coefficients::new(values).unwrap()
    }

    #[test]
    fn small_volumes_half_way_are_warned_of() {
        assert_eq!(volume_warning(0.85), None);
        assert!(volume_warning(0.5).is_some_and(|text| text.contains("0.50 times that of the smaller surface")));
    }

    #[test]
    fn ends_are_the_surfaces_and_a_moved_one_keeps_its_shape() {
        let from = body(6, 0.0);
        let rotation = Rotation::from_axis_angle([1.0, 2.0, -0.5], 1.1).unwrap();
        let moved = Transform {
            rotation: Rotation::from_euler(0.3, 1.2, -2.0).unwrap(),
            antipodal: false,
            similarity: Similarity { orthogonal: rotation.matrix(), scale: 2.0, translation: [5.0, -3.0, 1.0] },
        };
        let to = moved.apply(&from, &Silent).unwrap();
        let params = AlignParams { scale: true, ..AlignParams::default() };
        let morph = Morph::new(&from, &to, &params, true, &Silent).unwrap();
        assert!(rmsd(&morph.at(1.0).unwrap(), &to).unwrap() < 1e-9);
        let volume = |surface: &Coefficients| measure(surface, &MeasureParams::default(), &Silent).unwrap().volume;
        let (first, half) = (morph.at(0.0).unwrap(), morph.at(0.5).unwrap());
        assert!((volume(&first) / volume(&from) - 1.0).abs() < 1e-9);
        // The scale goes from 1 to 2, so it is sqrt(2) at t = 1/2.
        assert!((volume(&half) / volume(&from) - 8f64.sqrt()).abs() < 1e-8);
        let place = |surface: &Coefficients| [0, 1, 2].map(|k| surface.values()[[0, k]]);
        for k in 0..3 {
            assert!((place(&first)[k] - from.values()[[0, k]]).abs() < 1e-9);
            let middle = 0.5 * (place(&first)[k] + to.values()[[0, k]]);
            assert!((place(&half)[k] - middle).abs() < 1e-9);
        }
        // The two surfaces differ only in pose. If all surfaces of the path are in the pose of the second surface, they
        // are equal.
        let still = Morph::new(&from, &to, &params, false, &Silent).unwrap();
        assert!(rmsd(&still.at(0.3).unwrap(), &to).unwrap() < 1e-9);
        assert!((volume_ratio(&still, &Silent).unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn portions_of_a_rotation_compose() {
        let half_turn = Rotation::from_axis_angle([0.0, 1.0, 1.0], std::f64::consts::PI).unwrap();
        let other = Rotation::from_axis_angle([1.0, -2.0, 0.5], 2.5).unwrap();
        for rotation in [half_turn, other, Rotation::IDENTITY] {
            let (a, b) = (portion(&rotation, 0.3).unwrap(), portion(&rotation, 0.7).unwrap());
            let (found, expected) = (product(&a.matrix(), &b.matrix()), rotation.matrix());
            assert!((0..9).all(|k| (found[k / 3][k % 3] - expected[k / 3][k % 3]).abs() < 1e-12));
        }
    }
}
