//! Samples of all points of a sphere's triangles, for least squares over a surface in place of over its vertices.
//!
//! A mesh over a sphere is a function on it: linear on each triangle, from the triangle on the sphere (projected from the
//! centre) to that of the surface. An integral over the sphere of a function that a model of degree L can be compared with
//! is a sum over samples that are no further apart than the model resolves, pi / L, each weighted by its solid angle:
//!
//! ```text
//! integral f(u) du  =  sum_t sum_i  w_ti f(u_ti),   u = p / |p|,   w = share det(a, b, c) / (2 |p|^3)
//! ```
//!
//! with p the sample's place on the flat triangle (a, b, c) on the sphere and `share` its part of that triangle's area.
//!
//! # Places
//!
//! A triangle whose edges are below the spacing has the three points of the symmetric rule that is exact for polynomials of
//! degree 2 (G. Strang and G. J. Fix, "An analysis of the finite element method", 1973, section 4.3): a distance to a surface
//! that is linear there is squared exactly. A larger one is cut parallel to its shortest edge into layers that are no
//! thicker than the spacing, measured along its sides, and each layer into cells that are no wider. A cell has 2 x 2
//! points of Gauss's rule, across and down with the cell's width as weight, which is exact for degree 3. Triangles that come
//! near the sphere's centre, whose points lie further apart on the sphere than on themselves, have smaller cells. Slivers get a single
//! row of cells, where a grid of similar triangles would spend the square of it.
//!
//! With a spacing of 3 / L the points are about as dense as midpoints 1.5 / L apart would be, and the fit is that of twice as
//! many to a thousandth: docs/algorithms/least-squares.md has what was measured.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, ArrayViewMut, ArrayViewMut1, ArrayViewMut2, Axis, Dimension};
use rayon::prelude::*;
use spharm_harmonics::Directions;

use crate::error::SurfaceError;
use crate::geometry::{Vec3, add, cross, dot, scale, sub};

/// Size of the cells for models of degree L, times L: docs/algorithms/least-squares.md has what it leaves.
const CELLS_OF_DEGREE: f64 = 3.0;

/// Triangles that a task takes at a time.
const RUN: usize = 1024;

/// How each triangle of a sphere is cut. The samples themselves are made for as many triangles at a time as memory allows.
#[derive(Debug, Clone)]
pub struct SphereSampling {
    cuts: Vec<Cut>,
    /// The number of each triangle's first sample, and that of all samples.
    first: Vec<usize>,
}

/// Samples of some of a sphere's triangles.
#[derive(Debug, Clone)]
pub struct SphereSamples {
    /// Their directions, (samples, 3).
    pub directions: Directions,
    /// The solid angle that each stands for, in steradians, (samples). Those of a sphere that is covered once sum to 4 pi, to
    /// the accuracy that the spacing allows for.
    pub weights: Vec<f64>,
}

/// A triangle, and into how many layers it is cut.
#[derive(Debug, Clone, Copy)]
struct Cut {
    /// The vertex opposite the shortest edge, and the ends of that edge.
    corners: [u32; 3],
    layers: u32,
    /// The shortest edge's length in units of the spacing.
    width: f64,
}

impl Cut {
    fn new(unit: &[Vec3], face: [u32; 3], spacing: f64) -> Self {
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

    /// Cells of a layer.
    fn cells(&self, layer: u32) -> u32 {
        let middle = (f64::from(layer) + 0.5) / f64::from(self.layers);
        (middle * self.width).ceil().max(1.0) as u32
    }

    /// Whether it has the three points of small triangles.
    fn is_small(&self) -> bool {
        self.layers == 1 && self.width <= 1.0
    }

    fn samples(&self) -> usize {
        if self.is_small() {
            return 3;
        }
        (0..self.layers).map(|layer| 4 * self.cells(layer) as usize).sum()
    }

    /// Each sample's barycentric coordinates, for `corners`, and its part of the flat triangle's area.
    fn for_each(&self, mut take: impl FnMut(Vec3, f64)) {
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

/// How near a triangle comes to the sphere's centre where it is so large that its samples are further apart on the sphere than
/// on itself; 1 for others.
fn deepest([a, b, c]: [Vec3; 3]) -> f64 {
    /// Of triangles with edges of about 50 degrees.
    const LARGE: f64 = 0.9;
    let mean = |points: &[Vec3]| {
        let sum = points.iter().fold([0.0; 3], |sum, p| add(sum, *p));
        dot(sum, sum).sqrt() / points.len() as f64
    };
    let depth = [mean(&[a, b]), mean(&[b, c]), mean(&[c, a]), mean(&[a, b, c])].into_iter().fold(1.0, f64::min);
    if depth < LARGE { depth.max(0.1) } else { 1.0 }
}

/// The nodes of Gauss's rule of two points on -1 to 1 are at plus and minus 1 / sqrt 3.
const GAUSS: f64 = 0.577_350_269_189_625_8;

/// Nodes and weights of Gauss's rule of two points for the weight s on `from..to`: a layer's width grows from the apex. The
/// nodes are the roots of `s^2 + b s + c`, orthogonal to 1 and s; a weight is half of the layer's part of the area.
fn gauss_down(from: f64, to: f64) -> [(f64, f64); 2] {
    // About the layer's middle, where moments don't cancel: s = middle + half u, with weight (middle + half u) du.
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let (m0, m1, m2, m3) = (2.0 * middle, 2.0 * half / 3.0, 2.0 * middle / 3.0, 2.0 * half / 5.0);
    let det = m0 * m2 - m1 * m1;
    let (b, c) = ((m1 * m2 - m0 * m3) / det, (m1 * m3 - m2 * m2) / det);
    let root = (0.25 * b * b - c).sqrt();
    let (first, second) = (-0.5 * b - root, -0.5 * b + root);
    let of_second = (m1 - first * m0) / (second - first);
    // A triangle's area is the integral of 2 s ds over 0 to 1, half of it for each of the points across.
    let part = |weight: f64| half * weight;
    [(middle + half * first, part(m0 - of_second)), (middle + half * second, part(of_second))]
}

impl SphereSampling {
    /// Plans samples that are as dense as models of a degree need, in cells of 3 / L.
    ///
    /// # Errors
    ///
    /// Those of [`new`](Self::new).
    pub fn for_degree(directions: &Directions, faces: &[[u32; 3]], max_degree: usize) -> Result<Self, SurfaceError> {
        Self::new(directions, faces, CELLS_OF_DEGREE / max_degree.max(1) as f64)
    }

    /// Plans samples of a sphere's triangles in cells no larger than `spacing`, in radians: 3 / L for models of degree L.
    ///
    /// # Errors
    ///
    /// [`Argument`](SurfaceError::Argument) where there are no triangles, or one names a vertex that isn't there.
    pub fn new(directions: &Directions, faces: &[[u32; 3]], spacing: f64) -> Result<Self, SurfaceError> {
        let unit = directions.as_slice();
        let wrong = |found| {
            let (what, expected) = ("triangles to sample", "at least one, over the sphere's vertices");
            Err(SurfaceError::Argument { what, expected, found })
        };
        if faces.is_empty() {
            return wrong("none".to_owned());
        }
        if let Some(vertex) = faces.iter().flatten().find(|&&v| v as usize >= unit.len()) {
            return wrong(format!("vertex {vertex} of {}", unit.len()));
        }
        let cuts: Vec<Cut> = faces.par_iter().map(|&face| Cut::new(unit, face, spacing)).collect();
        let mut end = 0;
        let ends = cuts.iter().map(|cut| {
            end += cut.samples();
            end
        });
        let first = std::iter::once(0).chain(ends).collect();
        Ok(Self { cuts, first })
    }

    /// Returns the number of triangles.
    #[must_use]
    pub fn triangles(&self) -> usize {
        self.cuts.len()
    }

    /// Returns the number of samples of some of the triangles.
    #[must_use]
    pub fn samples(&self, triangles: Range<usize>) -> usize {
        self.first[triangles.end] - self.first[triangles.start]
    }

    /// Returns the numbers of each triangle's samples, triangle after triangle.
    pub fn of_triangles(&self) -> impl Iterator<Item = Range<usize>> {
        self.first.windows(2).map(|pair| pair[0]..pair[1])
    }

    /// Returns runs of triangles that have at most so many samples together, or one triangle with more.
    #[must_use]
    pub fn runs(&self, most: usize) -> Vec<Range<usize>> {
        let (mut runs, mut start) = (Vec::new(), 0);
        while start < self.triangles() {
            let within = self.first[start..].partition_point(|&first| first - self.first[start] <= most);
            let end = (start + within.saturating_sub(1)).clamp(start + 1, self.triangles());
            runs.push(start..end);
            start = end;
        }
        runs
    }

    /// Returns the samples of some of the triangles, over the directions that they were planned for. Triangles that face
    /// inwards count like the others.
    ///
    /// # Errors
    ///
    /// [`NoDirection`](SurfaceError::NoDirection) where there are none.
    pub fn at(&self, directions: &Directions, triangles: Range<usize>) -> Result<SphereSamples, SurfaceError> {
        let unit = directions.as_slice();
        let samples = self.samples(triangles.clone());
        let mut found = vec![([0.0; 3], 0.0); samples];
        self.parts(triangles, ArrayViewMut1::from(&mut found[..])).into_par_iter().for_each(|(cuts, mut found)| {
            let mut out = found.iter_mut();
            for cut in cuts {
                let [a, b, c] = cut.corners.map(|v| unit[v as usize]);
                let volume = dot(a, cross(b, c)).abs();
                cut.for_each(|[u, v, w], share| {
                    let Some(out) = out.next() else { return };
                    let p = add(scale(a, u), add(scale(b, v), scale(c, w)));
                    let radius = dot(p, p).sqrt();
                    // A triangle through the centre has no directions, and no solid angle of its own either.
                    *out =
                        if radius > 1e-9 { (p, 0.5 * share * volume / (radius * radius * radius)) } else { (a, 0.0) };
                });
            }
        });
        let (places, weights): (Vec<Vec3>, Vec<f64>) = found.into_iter().unzip();
        let directions = Directions::from_vertices(&places)
            .map_err(|cause| SurfaceError::NoDirection { path: "the samples of the sphere".into(), cause })?;
        Ok(SphereSamples { directions, weights })
    }

    /// Returns values on the vertices, (n, c), at the samples of some of the triangles, (samples, c): linear on each.
    ///
    /// # Panics
    ///
    /// If there are fewer rows than a triangle names.
    #[must_use]
    pub fn interpolate(&self, values: ArrayView2<'_, f64>, triangles: Range<usize>) -> Array2<f64> {
        let mut samples = Array2::zeros((self.samples(triangles.clone()), values.ncols()));
        self.interpolate_to(values, triangles, samples.view_mut());
        samples
    }

    /// Writes what [`interpolate`](Self::interpolate) returns to `samples`, (samples, c), which may be some of an array's
    /// columns.
    ///
    /// # Panics
    ///
    /// If there are fewer rows of `values` than a triangle names, or fewer of `samples` than there are samples.
    pub fn interpolate_to(
        &self,
        values: ArrayView2<'_, f64>,
        triangles: Range<usize>,
        samples: ArrayViewMut2<'_, f64>,
    ) {
        self.parts(triangles, samples).into_par_iter().for_each(|(cuts, mut samples)| {
            let mut out = samples.rows_mut().into_iter();
            for cut in cuts {
                let rows = cut.corners.map(|v| values.row(v as usize));
                cut.for_each(|[u, v, w], _| {
                    let Some(mut out) = out.next() else { return };
                    for (k, out) in out.iter_mut().enumerate() {
                        *out = u * rows[0][k] + v * rows[1][k] + w * rows[2][k];
                    }
                });
            }
        });
    }

    /// Runs of triangles, each with its samples' rows of an array.
    fn parts<'a, T, D: Dimension>(
        &'a self,
        triangles: Range<usize>,
        mut rows: ArrayViewMut<'a, T, D>,
    ) -> Vec<(&'a [Cut], ArrayViewMut<'a, T, D>)> {
        let mut parts = Vec::with_capacity(triangles.len().div_ceil(RUN));
        let mut start = triangles.start;
        while start < triangles.end {
            let end = (start + RUN).min(triangles.end);
            let (part, rest) = rows.split_at(Axis(0), self.samples(start..end));
            parts.push((&self.cuts[start..end], part));
            (rows, start) = (rest, end);
        }
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::geometry::solid_angle;
    use crate::sphere::Sphere;

    /// Of monomials `v^i w^j` over a triangle of area 1: `2 i! j! / (i + j + 2)!`.
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

    /// A sliver takes a row of cells, an even triangle about half the square of that.
    #[test]
    fn slivers_take_few_samples() {
        let at = |angle: f64| [angle.cos(), angle.sin(), 0.0];
        let apex = |angle: f64| [angle.cos(), 0.0, angle.sin()];
        let unit = [at(0.0), at(0.5), apex(0.5), at(0.001)];
        assert_eq!(Cut::new(&unit, [0, 3, 2], 0.005).samples(), 4 * 99);
        let even = Cut::new(&unit, [0, 1, 2], 0.005).samples();
        assert!((24_000..32_000).contains(&even), "{even}");
        // A long one's middle lies at 0.71 of the radius: its layers are as much thinner.
        let long = [at(0.0), at(0.001), apex(std::f64::consts::FRAC_PI_2)];
        assert_eq!(Cut::new(&long, [0, 1, 2], 0.01).samples(), 4 * 200);
    }

    #[test]
    fn weights_are_solid_angles() {
        let sphere = Sphere::icosphere(1);
        let sampling = SphereSampling::new(&sphere.directions, &sphere.faces, 0.05).unwrap();
        let unit = sphere.directions.as_slice();
        for (t, face) in sphere.faces.iter().enumerate() {
            let samples = sampling.at(&sphere.directions, t..t + 1).unwrap();
            let (sum, exact) = (samples.weights.iter().sum::<f64>(), solid_angle(face.map(|v| unit[v as usize])));
            assert!((sum / exact - 1.0).abs() < 1e-6, "{sum} {exact}");
        }
    }

    /// Any runs of triangles give the samples of all.
    #[test]
    fn samples_dont_depend_on_the_runs() {
        let sphere = Sphere::from_mesh(&icosphere(2)).unwrap();
        let sampling = SphereSampling::new(&sphere.directions, &sphere.faces, 0.1).unwrap();
        let values = Array2::from_shape_fn((162, 2), |(v, k)| ((3 * v + k) as f64).sin());
        let all = sampling.at(&sphere.directions, 0..320).unwrap();
        let at_all = sampling.interpolate(values.view(), 0..320);
        for most in [1, 7, 100, 100_000] {
            let runs = sampling.runs(most);
            assert_eq!((runs[0].start, runs[runs.len() - 1].end), (0, 320));
            let (mut weights, mut at, mut places) = (Vec::new(), Vec::new(), Vec::new());
            for run in runs {
                assert!(run.len() == 1 || sampling.samples(run.clone()) <= most);
                let samples = sampling.at(&sphere.directions, run.clone()).unwrap();
                weights.extend(samples.weights);
                places.extend_from_slice(samples.directions.as_slice());
                at.extend(sampling.interpolate(values.view(), run));
            }
            assert_eq!((weights, places), (all.weights.clone(), all.directions.as_slice().to_vec()));
            assert_eq!(at, at_all.iter().copied().collect::<Vec<_>>());
        }
    }

    #[test]
    fn triangles_are_checked() {
        let sphere = Sphere::icosphere(0);
        for faces in [vec![], vec![[0, 1, 12]]] {
            let error = SphereSampling::new(&sphere.directions, &faces, 0.1).unwrap_err();
            assert!(error.to_string().contains("triangles to sample"), "{error}");
        }
    }
}
