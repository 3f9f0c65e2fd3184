//! Checks whether equal directions denote corresponding points on all members of a group, whose maps to the sphere may
//! have been made separately.
//!
//! Each member is compared with the typical member, which is the member nearest to the mean. Two distances between
//! their surfaces are computed: the distance at the same directions of an icosphere, and the distance to the nearest
//! points of the other surface. If the distance at equal directions exceeds the distance between the surfaces by a
//! factor above [`FAR_FROM_A_MEMBER`], means, modes and tests reflect differences between the maps.
//!
//! Cost: about 10 ms per member on one thread, for at most [`MOST`] members. Poses are checked by
//! [`surface_poses`](crate::surface_poses()).

use rayon::prelude::*;
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::Monitor;
use spharm_surface::Mesh;
use spharm_surface::generate::{icosphere, icosphere_counts};
use spharm_surface::geometry::{Vec3, dot, sub};
use spharm_surface::nearest::TriangleTree;
use spharm_transform::{Transform, TransformParams};

use crate::error::ShapeError;
use crate::mean::mean;
use crate::surface_poses::{FAR_FROM_A_MEMBER, SurfacePoseWarning};

/// Maximum number of members that are compared with the typical member. In a larger group, evenly spaced members are
/// compared.
pub const MOST: usize = 64;
/// Numbers of subdivisions of two icospheres. The triangles of the first icosphere make up the surfaces. The vertices
/// of the second icosphere are the query points.
const LEVELS: [u32; 2] = [4, 3];
const ACCURACY: f64 = 1e-6;

/// Returns whether all models are defined over the same sphere, given the keys of their sampling schemes: all keys must
/// be known and equal. Only then do equal directions correspond before an alignment. Returns false if there are no
/// models.
#[must_use]
pub fn one_key<'a>(keys: impl IntoIterator<Item = Option<&'a str>>) -> bool {
    let mut keys = keys.into_iter();
    keys.next().flatten().is_some_and(|first| keys.all(|key| key == Some(first)))
}

/// Returns a warning if equal directions don't correspond in a group of surfaces (K, 3) of one degree. The surfaces
/// must be in the same pose, but they needn't be registered. Returns `None` if equal directions correspond, and for
/// fewer than two surfaces.
///
/// # Errors
///
/// [`ShapeError::Differ`] if a member's degree is below the first member's; [`ShapeError::Transform`] if the transform
/// fails; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn places_differ(group: &[Coefficients], monitor: &dyn Monitor) -> Result<Option<SurfacePoseWarning>, ShapeError> {
    if group.len() < 2 {
        return Ok(None);
    }
    let mean = mean(group)?;
    let off = |member: &Coefficients| -> f64 {
        let rows = member.values().rows().into_iter().zip(mean.values().rows()).skip(1);
        rows.map(|(a, b)| (&a - &b).mapv(|v| v * v).sum()).sum()
    };
    let from_mean: Vec<f64> = group.par_iter().map(off).collect();
    let typical = (1..group.len()).fold(0, |best, i| if from_mean[i] < from_mean[best] { i } else { best });
    let sphere = icosphere(LEVELS[0]);
    let params = TransformParams { max_degree: mean.max_degree(), accuracy: ACCURACY, channels: 3 };
    let synthesis = Transform::new(&Directions::from_vertices(&sphere.vertices)?, &params)?;
    let surface = |member: &Coefficients| -> Result<Mesh, ShapeError> {
        let mut centred = member.values().to_owned();
        centred.row_mut(0).fill(0.0);
        let rows = synthesis.synthesis(centred.view())?;
        Ok(sphere.with_vertices(rows.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect()))
    };
    let typical_surface = surface(&group[typical])?;
    let tree = TriangleTree::new(&typical_surface);
    let looking = icosphere_counts(LEVELS[1])[0] as usize;
    let others: Vec<usize> = (0..group.len()).filter(|member| *member != typical).collect();
    let taken = others.len().min(MOST);
    let squares = |k: usize| -> Result<[f64; 2], ShapeError> {
        monitor.check()?;
        let own = surface(&group[others[k * others.len() / taken]])?;
        let own_tree = TriangleTree::new(&own);
        let nearest = |tree: &TriangleTree, p: Vec3| tree.nearest(p).map_or(0.0, |found| found.distance.powi(2));
        let mut sums = [0.0; 2];
        for (a, b) in own.vertices.iter().zip(&typical_surface.vertices).take(looking) {
            let apart = sub(*a, *b);
            sums[0] += dot(apart, apart);
            sums[1] += 0.5 * (nearest(&tree, *a) + nearest(&own_tree, *b));
        }
        Ok(sums.map(|sum| sum / looking as f64))
    };
    let found: Vec<Result<[f64; 2], ShapeError>> = (0..taken).into_par_iter().map(squares).collect();
    let mut sums = [0.0; 2];
    for found in found {
        let found = found?;
        (0..2).for_each(|i| sums[i] += found[i]);
    }
    let [rmsd, distance] = sums.map(|sum| (sum / taken as f64).sqrt());
    let warning = SurfacePoseWarning::PlacesDiffer { rmsd, distance, from: "the most typical member" };
    Ok((rmsd > FAR_FROM_A_MEMBER * distance).then_some(warning))
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use spharm_monitor::Silent;

    use super::*;
    use crate::Transform as Pose;
    use crate::rotation::Rotation;
    use crate::samples::blob;

    #[test]
    fn models_without_a_key_may_be_of_any_sphere() {
        assert!(one_key([Some("a"), Some("a"), Some("a")]));
        assert!(!one_key([None, None]) && !one_key([Some("a"), Some("b")]) && !one_key([Some("a"), None]));
        assert!(!one_key([]));
    }

    /// Checks slightly different blobs whose spheres are rotated by an angle in degrees about different axes.
    fn turned_by(degrees: f64) -> Option<SurfacePoseWarning> {
        let common = blob(6, 1);
        let member = |n: usize| {
            let values = common.values() + &(0.04 * (blob(6, 20 + n as u32).values() - common.values()));
            let turn = Rotation::from_axis_angle([1.0, n as f64, 0.5], degrees.to_radians()).unwrap();
            let pose = Pose { rotation: turn, ..Pose::default() };
            pose.apply(&Coefficients::new(values).unwrap(), &Silent).unwrap()
        };
        places_differ(&(0..8).map(member).collect::<Vec<_>>(), &Silent).unwrap()
    }

    #[test]
    fn directions_that_are_no_places_are_noticed() {
        assert_eq!(turned_by(0.0), None);
        let found = turned_by(40.0).unwrap();
        assert!(found.to_string().contains("equal directions don't correspond"), "{found}");
    }

    #[test]
    fn points_have_no_places() {
        let points = [(); 3].map(|()| Coefficients::new(Array2::zeros((4, 3))).unwrap());
        assert_eq!(places_differ(&points, &Silent).unwrap(), None);
        assert_eq!(places_differ(&points[..1], &Silent).unwrap(), None);
    }
}
