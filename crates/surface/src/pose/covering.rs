//! Computes a finite set of rotations such that every rotation is near a rotation in the set.
//!
//! As quaternions, the 60 rotations of an icosahedron are the vertices of the 600-cell (J. Conway and D. Smith, "On
//! Quaternions and Octonions", 2003, chapter 3), so every rotation is within 44.5 degrees of one of the 60. To fill the
//! Voronoi cell of each of these 60 rotations, the rotation is combined with a fixed set of small rotations. The
//! rotation vectors of the small rotations are the points of a body-centred lattice. The result is 3,900 rotations, and
//! every rotation is within 14 degrees of one of these. The set includes the half turns about the three axes and the
//! cyclic permutations of the axes. The other rotations of a cube are added, because they map principal axes onto each
//! other.

use crate::geometry::dot;
use crate::matrix3::{Matrix3, angle_between, exponential, of_quaternion, product};

/// Half of the golden ratio, and half of the golden ratio's inverse.
const GOLDEN: [f64; 2] = [0.809_016_994_374_947_4, 0.309_016_994_374_947_4];

/// Side of the cubes of the lattice of rotation vectors, in radians.
const SIDE: f64 = 0.33;

/// Returns a set of rotations such that every rotation is near a rotation in the set. The rotations of a cube come
/// first.
pub(super) fn covering() -> Vec<Matrix3> {
    let group = group();
    let (cube, icosahedron) = group.split_at(CUBE);
    let icosahedron: Vec<Matrix3> = cube[..SHARED].iter().chain(icosahedron).copied().collect();
    let mut all = group.clone();
    let steps = -3..=3;
    let lattice = steps.clone().flat_map(|i| steps.clone().flat_map(move |j| (-3..=3).map(move |k| [i, j, k])));
    for point in lattice.flat_map(|p| [p.map(f64::from), p.map(|v| f64::from(v) + 0.5)]) {
        let turn = exponential(point.map(|v| SIDE * v));
        let angle = dot(point, point).sqrt() * SIDE;
        // Tests whether the small rotation `turn` is at least as near to the identity as to any other rotation of the
        // icosahedron. A zero rotation is excluded, because its products are already in the list.
        let own = icosahedron.iter().skip(1).all(|other| angle_between(other, &turn) >= angle);
        if angle > 0.0 && angle < std::f64::consts::FRAC_PI_4 && own {
            all.extend(icosahedron.iter().map(|rotation| product(rotation, &turn)));
        }
    }
    all
}

/// Number of rotations of a cube. The first `SHARED` of them are also rotations of an icosahedron.
const CUBE: usize = 24;
const SHARED: usize = 12;

/// Returns the rotations of a cube and of an icosahedron, without repetition. The rotations of the cube come first,
/// starting with those that are also rotations of the icosahedron.
fn group() -> Vec<Matrix3> {
    let mut quaternions: Vec<[f64; 4]> = Vec::with_capacity(72);
    for k in 0..4 {
        quaternions.push(std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 }));
    }
    let sign = |bits: usize, k: usize| if bits >> k & 1 == 1 { -1.0 } else { 1.0 };
    // Only one of each pair of opposite quaternions is generated, since both are the same rotation.
    for bits in 0..8 {
        quaternions.push(std::array::from_fn(|i| if i == 0 { 0.5 } else { 0.5 * sign(bits, i - 1) }));
    }
    for a in 0..4 {
        for b in a + 1..4 {
            for bits in 0..2 {
                let side = std::f64::consts::FRAC_1_SQRT_2;
                quaternions.push(std::array::from_fn(|i| match i {
                    i if i == a => side,
                    i if i == b => side * sign(bits, 0),
                    _ => 0.0,
                }));
            }
        }
    }
    for order in even_permutations() {
        for bits in 0..4 {
            let values = [GOLDEN[0], 0.5 * sign(bits, 0), GOLDEN[1] * sign(bits, 1), 0.0];
            quaternions.push(order.map(|i| values[i]));
        }
    }
    quaternions.into_iter().map(of_quaternion).collect()
}

/// Returns the even permutations of four elements.
fn even_permutations() -> impl Iterator<Item = [usize; 4]> {
    let all = (0..256).map(|n| [n >> 6 & 3, n >> 4 & 3, n >> 2 & 3, n & 3]);
    all.filter(|order: &[usize; 4]| {
        let pairs = || (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j)));
        let swaps = pairs().filter(|(i, j)| order[*i] > order[*j]).count();
        pairs().all(|(i, j)| order[i] != order[j]) && swaps % 2 == 0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::SplitMix64;
    use crate::matrix3::{IDENTITY, determinant};

    #[test]
    fn every_rotation_is_near_to_one_and_none_is_there_twice() {
        let group = group();
        assert_eq!((group.len(), group[0]), (72, IDENTITY));
        for (i, a) in group.iter().enumerate() {
            assert!((determinant(a) - 1.0).abs() < 1e-14);
            assert!(group[..i].iter().all(|b| angle_between(a, b) > 0.2), "{i}");
        }
        let all = covering();
        assert!((3000..5000).contains(&all.len()), "{}", all.len());
        assert_eq!(all[..72], group);
        let mut random = SplitMix64::new(5);
        for _ in 0..1000 {
            let mut q: [f64; 4] = std::array::from_fn(|_| random.between(-1.0, 1.0));
            let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            q = q.map(|v| v / length);
            let nearest =
                all.iter().map(|r| angle_between(r, &of_quaternion(q))).fold(f64::INFINITY, f64::min).to_degrees();
            assert!(nearest < 14.0, "{q:?}: {nearest}");
        }
    }
}
