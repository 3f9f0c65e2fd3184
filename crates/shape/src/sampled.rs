//! Surfaces with points on them, brought to each other by their nearest points.

use spharm_surface::Mesh;
use spharm_surface::nearest::TriangleTree;

use crate::kabsch::{kabsch, svd};
use crate::matrix3::{Matrix3, cross, determinant, dot, transposed};

/// A rigid motion, `x -> R x + t`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rigid {
    pub(crate) rotation: Matrix3,
    pub(crate) translation: [f64; 3],
}

impl Rigid {
    fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        plus(turned(&self.rotation, p), self.translation)
    }

    fn inverse(&self) -> Self {
        let rotation = transposed(&self.rotation);
        Self { rotation, translation: turned(&rotation, self.translation).map(|v| -v) }
    }
}

/// A surface with points that are spread evenly over its area.
pub(crate) struct Sampled {
    tree: TriangleTree,
    points: Vec<[f64; 3]>,
    centre: [f64; 3],
}

impl Sampled {
    /// Places points at the centroids of the triangles in which equal shares of the area end; none on a surface without
    /// area.
    pub(crate) fn new(mesh: &Mesh, count: usize) -> Self {
        let corners = |face: &[u32; 3]| face.map(|v| mesh.vertices[v as usize]);
        let area = |[a, b, c]: [[f64; 3]; 3]| {
            let normal = cross(&minus(b, a), &minus(c, a));
            0.5 * dot(&normal, &normal).sqrt()
        };
        let areas: Vec<f64> = mesh.faces.iter().map(|face| area(corners(face))).collect();
        let step = areas.iter().sum::<f64>() / count as f64;
        let (mut points, mut sum) = (Vec::with_capacity(count), 0.0);
        for (face, area) in mesh.faces.iter().zip(&areas) {
            sum += area;
            let [a, b, c] = corners(face);
            while step > 0.0 && points.len() < count && (points.len() as f64 + 0.5) * step <= sum {
                points.push(std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0));
            }
        }
        let all = points.len().max(1) as f64;
        let centre = std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / all);
        Self { tree: TriangleTree::new(mesh), points, centre }
    }

    /// The principal axes of the points, longest first, as rows of a rotation.
    pub(crate) fn axes(&self) -> Matrix3 {
        let mut scatter = Matrix3::default();
        for p in &self.points {
            let p = minus(*p, self.centre);
            (0..3).for_each(|i| (0..3).for_each(|j| scatter[i][j] += p[i] * p[j]));
        }
        let mut axes = transposed(&svd(&scatter).u);
        if determinant(&axes) < 0.0 {
            axes[2] = axes[2].map(|v| -v);
        }
        axes
    }

    /// The motion that turns this surface about its centre, which it brings to that of another.
    pub(crate) fn turned_to(&self, other: &Self, turn: &Matrix3) -> Rigid {
        Rigid { rotation: *turn, translation: minus(other.centre, turned(turn, self.centre)) }
    }

    /// The root mean square distance from another surface after a motion, both ways, from every `step`th point.
    pub(crate) fn distance(&self, other: &Self, motion: &Rigid, step: usize) -> f64 {
        let mean_square = |from: &Self, to: &Self, motion: &Rigid| {
            let nearest = from.points.iter().step_by(step).filter_map(|p| to.tree.nearest(motion.apply(*p)));
            let (sum, count) =
                nearest.fold((0.0, 0usize), |(sum, count), found| (sum + found.distance * found.distance, count + 1));
            sum / count.max(1) as f64
        };
        (0.5 * (mean_square(self, other, motion) + mean_square(other, self, &motion.inverse()))).sqrt()
    }

    /// Improves a motion to another surface by nearest points both ways, from every `step`th point, at most `rounds`
    /// times: P. Besl and N. McKay, "A method for registration of 3-D shapes", IEEE Transactions on Pattern Analysis
    /// and Machine Intelligence 14 (1992).
    pub(crate) fn refined(&self, other: &Self, start: Rigid, step: usize, rounds: usize) -> Rigid {
        let (mut motion, mut last) = (start, f64::INFINITY);
        for _ in 0..rounds {
            let pairs = self.pairs(other, &motion, step);
            let square: f64 = pairs.iter().map(|(p, q)| square(minus(motion.apply(*p), *q))).sum();
            if pairs.is_empty() || square > 0.999 * last {
                break;
            }
            last = square;
            motion = nearest_motion(&pairs);
        }
        motion
    }

    /// Points of this surface, as they are, with their nearest ones on another; and those of its points.
    fn pairs(&self, other: &Self, motion: &Rigid, step: usize) -> Vec<([f64; 3], [f64; 3])> {
        let back = motion.inverse();
        let there = self.points.iter().step_by(step);
        let there = there.filter_map(|p| Some((*p, other.tree.nearest(motion.apply(*p))?.point)));
        let here = other.points.iter().step_by(step);
        let here = here.filter_map(|q| Some((self.tree.nearest(back.apply(*q))?.point, *q)));
        there.chain(here).collect()
    }
}

/// The motion that brings the first points of pairs nearest to the second ones.
fn nearest_motion(pairs: &[([f64; 3], [f64; 3])]) -> Rigid {
    let count = pairs.len() as f64;
    let (mut p, mut q) = ([0.0; 3], [0.0; 3]);
    for (a, b) in pairs {
        (p, q) = (plus(p, a.map(|v| v / count)), plus(q, b.map(|v| v / count)));
    }
    let mut cross = Matrix3::default();
    for (a, b) in pairs {
        let (a, b) = (minus(*a, p), minus(*b, q));
        (0..3).for_each(|i| (0..3).for_each(|j| cross[i][j] += b[i] * a[j]));
    }
    let rotation = kabsch(&cross, false);
    Rigid { rotation, translation: minus(q, turned(&rotation, p)) }
}

fn square(a: [f64; 3]) -> f64 {
    dot(&a, &a)
}

fn turned(turn: &Matrix3, p: [f64; 3]) -> [f64; 3] {
    turn.map(|row| dot(&row, &p))
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] + b[k])
}

#[cfg(test)]
mod tests {
    use spharm_surface::generate::icosphere;

    use super::*;
    use crate::rotation::Rotation;

    /// An ellipsoid with a bump, which is no image of itself.
    fn lump() -> Mesh {
        let ball = icosphere(4);
        let bump = |v: &[f64; 3]| 1.0 + 0.4 * (6.0 * (0.6 * v[0] + 0.64 * v[1] + 0.48 * v[2] - 1.0)).exp();
        let place = |v: &[f64; 3]| [9.0 * v[0] * bump(v), 6.0 * v[1] * bump(v), 4.0 * v[2] * bump(v)];
        ball.with_vertices(ball.vertices.iter().map(place).collect())
    }

    #[test]
    fn points_are_even_and_axes_are_those_of_the_shape() {
        let ball = icosphere(4);
        let ellipsoid =
            ball.with_vertices(ball.vertices.iter().map(|v| [2.0 * v[2], 5.0 * v[0], 9.0 * v[1]]).collect());
        let sampled = Sampled::new(&ellipsoid, 2000);
        assert_eq!(sampled.points.len(), 2000);
        assert!(sampled.centre.iter().all(|x| x.abs() < 0.1), "{:?}", sampled.centre);
        // y of the ball lies along z, x along y.
        let axes = sampled.axes();
        assert!(axes[0][2].abs() > 0.999 && axes[1][1].abs() > 0.999 && axes[2][0].abs() > 0.999, "{axes:?}");
        assert!((determinant(&axes) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_moved_surface_returns() {
        let mesh = lump();
        let turn = Rotation::from_euler(0.2, 0.25, -0.15).unwrap().matrix();
        let moved =
            mesh.with_vertices(mesh.vertices.iter().map(|p| plus(turned(&turn, *p), [3.0, -2.0, 1.0])).collect());
        let (a, b) = (Sampled::new(&moved, 2000), Sampled::new(&mesh, 2000));
        let start = a.turned_to(&b, &crate::matrix3::IDENTITY);
        let found = a.refined(&b, start, 4, 100);
        assert!(a.distance(&b, &start, 1) > 0.3);
        assert!(a.distance(&b, &found, 1) < 0.02, "{}", a.distance(&b, &found, 1));
        let back = Rigid { rotation: turn, translation: [3.0, -2.0, 1.0] };
        assert!(a.distance(&b, &back.inverse(), 1) < 1e-9);
        assert!((b.distance(&a, &back, 1) - a.distance(&b, &back.inverse(), 1)).abs() < 1e-9);
    }

    #[test]
    fn a_surface_without_area_has_no_points() {
        let ball = icosphere(1);
        let point = Sampled::new(&ball.with_vertices(vec![[1.0; 3]; 42]), 100);
        assert!(point.points.is_empty());
        let identity = Rigid { rotation: crate::matrix3::IDENTITY, translation: [0.0; 3] };
        assert_eq!(point.distance(&point, &identity, 1), 0.0);
        assert_eq!(point.refined(&point, identity, 1, 9).translation, [0.0; 3]);
    }
}
