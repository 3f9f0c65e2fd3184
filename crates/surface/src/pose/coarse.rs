//! Measures the distances between two surfaces in thousands of poses, from few points.
//!
//! The nearest piece of a surface is found with a table ([`Grid`]). Points are processed in groups. The arithmetic on a
//! group is a loop over plain arrays, which compilers turn into vector instructions; only the table's entries and the
//! pieces are looked up one by one. A pose takes about 512 searches. The results have the same bits on every processor,
//! because each point's arithmetic and the order of the sum are fixed.

use multiversion::multiversion;

use super::grid::{Grid, LANES, Lanes};
use super::level::Level;
use super::surface::{Density, PoseSurface};
use crate::geometry::Vec3;
use crate::similarity::Similarity;

/// Returns the mean distance between the surfaces, in both directions, after a motion of `moving`. The distance of a
/// point is measured to the disk that stands for the nearest piece, as in [`icp`](super::icp). No distances are
/// trimmed.
pub(super) fn mean_distance(moving: &PoseSurface, fixed: &PoseSurface, motion: &Similarity) -> f64 {
    let (a, b) = (moving.view(Density::Few), fixed.view(Density::Few));
    let there = sum_of_distances(&a.asking.points, motion, 1.0, b.pieces, &fixed.grid);
    let here = sum_of_distances(&b.asking.points, &motion.inverse(), motion.scale, a.pieces, &moving.grid);
    (there + here) / (a.asking.points.len() + b.asking.points.len()) as f64
}

/// Returns the sum of the distances from `points`, after a motion, to the nearest pieces of a surface. The distances
/// are multiplied by `factor`.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2", "aarch64+neon"))]
fn sum_of_distances(points: &[Vec3], motion: &Similarity, factor: f64, pieces: &Level, grid: &Grid) -> f64 {
    let mut sum = 0.0;
    for group in points.chunks(LANES) {
        // The last group is filled up with copies of its first point, whose distances aren't added.
        let mut full = [group[0]; LANES];
        full[..group.len()].copy_from_slice(group);
        let distances = distances(&full, motion, pieces, grid);
        sum = distances[..group.len()].iter().fold(sum, |sum, distance| sum + factor * distance);
    }
    sum
}

/// Returns the distance of each point in a group from the nearest piece of a surface.
#[inline(always)]
fn distances(points: &[Vec3; LANES], motion: &Similarity, pieces: &Level, grid: &Grid) -> Lanes {
    let Similarity { orthogonal: q, scale, translation } = motion;
    let mut place = [[0.0; LANES]; 3];
    for (k, place) in place.iter_mut().enumerate() {
        for i in 0..LANES {
            let p = &points[i];
            place[i] = scale * (q[k][0] * p[0] + q[k][1] * p[1] + q[k][2] * p[2]) + translation[k];
        }
    }
    let found = grid.nearest_of_group(&place);
    let (mut off, mut normal) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    for i in 0..LANES {
        let (point, n) = (&pieces.points[found[i]], &pieces.normals[found[i]]);
        for k in 0..3 {
            off[k][i] = place[k][i] - point[k];
            normal[k][i] = n[k];
        }
    }
    let mut distances = [0.0; LANES];
    for i in 0..LANES {
        let across = off[0][i] * normal[0][i] + off[1][i] * normal[1][i] + off[2][i] * normal[2][i];
        let square = off[0][i] * off[0][i] + off[1][i] * off[1][i] + off[2][i] * off[2][i];
        let along = (square - across * across).max(0.0).sqrt();
        let beyond = (along - pieces.radius).max(0.0);
        distances[i] = (across * across + beyond * beyond).sqrt();
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{SplitMix64, icosphere};
    use crate::geometry::{dot, sub};
    use crate::matrix3::of_quaternion;

    /// Checks that the result has the same bits as a computation of one point after another.
    #[test]
    fn groups_have_the_distances_of_their_points() {
        let ball = icosphere(3);
        let surface = |sides: Vec3| {
            let of = |v: &Vec3| [sides[0] * v[0], sides[1] * v[1] + 0.1 * v[0] * v[0], sides[2] * v[2]];
            PoseSurface::new(&ball.with_vertices(ball.vertices.iter().map(of).collect())).unwrap()
        };
        let (moving, fixed) = (surface([9.0, 3.0, 2.0]), surface([7.0, 4.0, 2.5]));
        let single = |points: &[Vec3], motion: &Similarity, factor: f64, of: &PoseSurface| -> f64 {
            let pieces = &of.levels[1];
            let one = |p: &Vec3| {
                let place = motion.apply(*p);
                let found = of.grid.nearest(place);
                let off = sub(place, pieces.points[found]);
                let across = dot(off, pieces.normals[found]);
                let along = (dot(off, off) - across * across).max(0.0).sqrt();
                let beyond = (along - pieces.radius).max(0.0);
                factor * (across * across + beyond * beyond).sqrt()
            };
            points.iter().map(one).fold(0.0, |sum, distance| sum + distance)
        };
        let mut random = SplitMix64::new(5);
        for scale in [1.0, 0.7, 1e12] {
            for _ in 0..50 {
                let q = [0; 4].map(|_| random.between(-1.0, 1.0));
                let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
                let orthogonal = of_quaternion(q.map(|v| v / norm));
                let translation = [0; 3].map(|_| random.between(-3.0, 3.0));
                let motion = Similarity { orthogonal, scale, translation };
                let (a, b) = (&moving.levels[0].points[..250], &fixed.levels[0].points);
                let expected = single(a, &motion, 1.0, &fixed);
                assert_eq!(sum_of_distances(a, &motion, 1.0, &fixed.levels[1], &fixed.grid), expected);
                let expected = single(b, &motion.inverse(), scale, &moving);
                assert_eq!(sum_of_distances(b, &motion.inverse(), scale, &moving.levels[1], &moving.grid), expected);
            }
        }
    }
}
