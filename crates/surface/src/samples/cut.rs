//! Divides a triangle into cells, and places the samples in the cells. The parent module explains the rules.

use crate::geometry::{Vec3, add, dot, sub};

/// A triangle, and the number of layers into which it is cut.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    /// The vertex opposite the shortest edge (the apex), then the ends of that edge.
    pub(super) corners: [u32; 3],
    layers: u32,
    /// Length of the shortest edge, in units of the spacing.
    width: f64,
}

impl Cut {
    pub(super) fn new(unit: &[Vec3], face: [u32; 3], spacing: f64) -> Self {
        let length = |k: usize| {
            let edge = sub(unit[face[(k + 1) % 3] as usize], unit[face[k] as usize]);
            dot(edge, edge).sqrt()
        };
        let lengths = [length(0), length(1), length(2)];
        let shortest = (0..3).fold(0, |least, k| if lengths[k] < lengths[least] { k } else { least });
        let longest = lengths.into_iter().fold(0.0, f64::max);
        let spacing = spacing * deepest(face.map(|v| unit[v as usize]));
        Self {
            corners: [face[(shortest + 2) % 3], face[shortest], face[(shortest + 1) % 3]],
            layers: (longest / spacing).ceil().max(1.0) as u32,
            width: lengths[shortest] / spacing,
        }
    }

    /// Returns the number of cells in a layer.
    fn cells(&self, layer: u32) -> u32 {
        let middle = (f64::from(layer) + 0.5) / f64::from(self.layers);
        (middle * self.width).ceil().max(1.0) as u32
    }

    /// Returns whether the triangle is small enough for the three-point rule.
    fn is_small(&self) -> bool {
        self.layers == 1 && self.width <= 1.0
    }

    pub(super) fn samples(&self) -> usize {
        if self.is_small() {
            return 3;
        }
        (0..self.layers).map(|layer| 4 * self.cells(layer) as usize).sum()
    }

    /// Passes each sample to `take`: its barycentric coordinates, in the order of `corners`, and its share of the flat
    /// triangle's area.
    pub(super) fn for_each(&self, mut take: impl FnMut(Vec3, f64)) {
        if self.is_small() {
            let (near, far) = (2.0 / 3.0, 1.0 / 6.0);
            for at in [[near, far, far], [far, near, far], [far, far, near]] {
                take(at, 1.0 / 3.0);
            }
            return;
        }
        for layer in 0..self.layers {
            let at = |edge: u32| f64::from(edge) / f64::from(self.layers);
            let down = gauss_down(at(layer), at(layer + 1));
            let cells = self.cells(layer);
            for cell in 0..cells {
                for (down, part) in down {
                    for node in [-GAUSS, GAUSS] {
                        let across = (f64::from(cell) + 0.5 + 0.5 * node) / f64::from(cells);
                        take([1.0 - down, down * (1.0 - across), down * across], part / f64::from(cells));
                    }
                }
            }
        }
    }
}

/// Estimates, from a few points of a large triangle, how near the triangle comes to the centre of the unit sphere.
/// Samples of such a triangle are farther apart on the sphere than on the triangle. Returns at least 0.1, and 1 for
/// triangles that aren't large.
fn deepest([a, b, c]: [Vec3; 3]) -> f64 {
    /// A triangle is large if it comes nearer to the sphere's centre than this distance. Triangles with edges of about
    /// 50 degrees reach this distance.
    const LARGE: f64 = 0.9;
    let mean = |points: &[Vec3]| {
        let sum = points.iter().fold([0.0; 3], |sum, p| add(sum, *p));
        dot(sum, sum).sqrt() / points.len() as f64
    };
    let depth = [mean(&[a, b]), mean(&[b, c]), mean(&[c, a]), mean(&[a, b, c])].into_iter().fold(1.0, f64::min);
    if depth < LARGE { depth.max(0.1) } else { 1.0 }
}

/// The nodes of Gauss's two-point rule on [-1, 1] are -1 / sqrt(3) and 1 / sqrt(3).
const GAUSS: f64 = 0.577_350_269_189_625_8;

/// Returns the nodes and weights of Gauss's two-point rule on `from..to`. The weight function is 2 s, with s the
/// distance from the apex, because the triangle's width is proportional to s. The nodes are the roots of the polynomial
/// `s^2 + b s + c` that is orthogonal to 1 and s. Half of each weight is returned, because each node gives two samples.
fn gauss_down(from: f64, to: f64) -> [(f64, f64); 2] {
    // m_k is the integral of s u^k du over u from -1 to 1, where s = middle + half u. These moments about the layer's
    // middle avoid cancellation. In terms of u, the polynomial is u^2 + b u + c.
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let (m0, m1, m2, m3) = (2.0 * middle, 2.0 * half / 3.0, 2.0 * middle / 3.0, 2.0 * half / 5.0);
    let det = m0 * m2 - m1 * m1;
    let (b, c) = ((m1 * m2 - m0 * m3) / det, (m1 * m3 - m2 * m2) / det);
    let root = (0.25 * b * b - c).sqrt();
    let (first, second) = (-0.5 * b - root, -0.5 * b + root);
    let of_second = (m1 - first * m0) / (second - first);
    // Weights are shares of the triangle's area, which is the integral of 2 s ds from 0 to 1, with s the distance from
    // the apex. Each node gives two samples, and each sample gets half of 2 s ds, so the factor 2 cancels.
    let part = |weight: f64| half * weight;
    [(middle + half * first, part(m0 - of_second)), (middle + half * second, part(of_second))]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integral of the monomial `v^i w^j` over a triangle of area 1 is `2 i! j! / (i + j + 2)!`.
    #[test]
    fn polynomials_are_integrated_exactly() {
        let shapes = [
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[1.0, 0.0, 0.0], [0.999, 0.04, 0.0], [0.0, 0.0, 1.0]],
            [[1.0, 0.0, 0.0], [0.99, 0.1, 0.0], [0.99, 0.0, 0.1]],
        ];
        for unit in shapes {
            for spacing in [3.0, 0.7, 0.21, 0.03] {
                let cut = Cut::new(&unit, [0, 1, 2], spacing);
                let mut count = 0;
                let mut sums = [0.0; 10];
                let powers = [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3]];
                cut.for_each(|[u, v, w], share| {
                    assert!([u, v, w].iter().all(|x| *x > 0.0 && *x < 1.0) && (u + v + w - 1.0).abs() < 1e-14);
                    count += 1;
                    for (sum, [i, j]) in sums.iter_mut().zip(powers) {
                        *sum += share * v.powi(i) * w.powi(j);
                    }
                });
                assert_eq!(count, cut.samples());
                let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
                let degree = if cut.is_small() { 2 } else { 3 };
                for (sum, [i, j]) in sums.into_iter().zip(powers).filter(|(_, [i, j])| i + j <= degree) {
                    let exact = 2.0 * factorial(i) * factorial(j) / factorial(i + j + 2);
                    assert!((sum - exact).abs() < 1e-13, "{spacing} v^{i} w^{j}: {sum}, {exact}");
                }
            }
        }
    }

    /// With n layers, a sliver has one cell in each layer, n cells in all. An equilateral triangle has about n^2 / 2
    /// cells.
    #[test]
    fn slivers_take_few_samples() {
        let at = |angle: f64| [angle.cos(), angle.sin(), 0.0];
        let apex = |angle: f64| [angle.cos(), 0.0, angle.sin()];
        let unit = [at(0.0), at(0.5), apex(0.5), at(0.001)];
        assert_eq!(Cut::new(&unit, [0, 3, 2], 0.005).samples(), 4 * 99);
        let even = Cut::new(&unit, [0, 1, 2], 0.005).samples();
        assert!((24_000..32_000).contains(&even), "{even}");
        // This flat sliver spans a quarter of a circle, so its middle is at only 0.71 of the sphere's radius. Its
        // layers are thinner by this factor.
        let long = [at(0.0), at(0.001), apex(std::f64::consts::FRAC_PI_2)];
        assert_eq!(Cut::new(&long, [0, 1, 2], 0.01).samples(), 4 * 200);
    }
}
