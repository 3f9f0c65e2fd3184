//! Samples a sphere's triangles densely, so that least-squares fits cover a whole surface and not only its vertices.
//!
//! A mesh over a sphere defines a function on the sphere. The function maps each triangle of the sphere (projected from
//! the centre) linearly to a triangle of the surface. To fit a model of degree L, integrals of functions f over the
//! sphere are needed. These integrals are computed as sums over samples u_ti, where t is the triangle and i the sample
//! within it. The samples are no farther apart than the model's resolution, pi / L. Each sample is weighted by its
//! solid angle w_ti:
//!
//! ```text
//! integral f(u) du  =  sum_t sum_i  w_ti f(u_ti),   u = p / |p|,   w = share det(a, b, c) / (2 |p|^3)
//! ```
//!
//! where p is the sample's position on the flat triangle (a, b, c) of the sphere, and `share` is the sample's share of
//! that triangle's area.
//!
//! # Positions of the samples
//!
//! A triangle with edges shorter than the spacing is sampled at the three points of the symmetric rule that is exact
//! for polynomials of degree 2 (G. Strang and G. J. Fix, "An analysis of the finite element method", 1973, section
//! 4.3). The squared distance from a linear function is then integrated exactly. A larger triangle is cut parallel to
//! its shortest edge into layers no thicker than the spacing, measured along its sides. Each layer is cut into cells no
//! wider than the spacing. A cell is sampled at the 2 x 2 points of Gauss's rule, which is exact for degree 3. The two
//! positions between apex and base take the growing width of the cell into account. Triangles that come near the
//! sphere's centre have smaller cells, since their points lie farther apart on the sphere than on the triangle. A
//! sliver gets a single row of n cells, whereas a grid of similar triangles would need n^2 cells.
//!
//! With a spacing of 3 / L, the points are about as dense as the midpoints of cells of size 1.5 / L. A fit agrees to
//! within a thousandth with the fit for twice as many points. docs/algorithms/least-squares.md gives the measurements.

mod cut;

use std::ops::Range;

use ndarray::{Array2, ArrayView2, ArrayViewMut, ArrayViewMut1, ArrayViewMut2, Axis, Dimension};
use rayon::prelude::*;
use spharm_harmonics::Directions;

use self::cut::Cut;
use crate::error::SurfaceError;
use crate::geometry::{Vec3, add, cross, dot, scale};

/// Size of the cells, in radians, multiplied by the degree L of the models. docs/algorithms/least-squares.md gives the
/// resulting error.
const CELLS_OF_DEGREE: f64 = 3.0;

/// Number of triangles per parallel task.
const RUN: usize = 1024;

/// The division of each triangle of a sphere into cells. The samples themselves are computed later, for ranges of
/// triangles that fit in memory.
#[derive(Debug, Clone)]
pub struct SphereSampling {
    cuts: Vec<Cut>,
    /// For each triangle, the number of samples in all triangles before it; then the total number of samples.
    first: Vec<usize>,
}

/// Samples of a range of a sphere's triangles.
#[derive(Debug, Clone)]
pub struct SphereSamples {
    /// Directions of the samples, an array of shape (samples, 3).
    pub directions: Directions,
    /// Solid angle of each sample, in steradians. If the triangles cover the sphere once, all solid angles sum to 4
    /// pi, up to the error of the rule.
    pub weights: Vec<f64>,
}

impl SphereSampling {
    /// Divides a sphere's triangles for models of degree L (`max_degree`), into cells no larger than 3 / L radians.
    ///
    /// # Errors
    ///
    /// The errors of [`new`](Self::new).
    pub fn for_degree(directions: &Directions, faces: &[[u32; 3]], max_degree: usize) -> Result<Self, SurfaceError> {
        Self::new(directions, faces, CELLS_OF_DEGREE / max_degree.max(1) as f64)
    }

    /// Divides a sphere's triangles into cells no larger than `spacing`, in radians. Models of degree L need a spacing
    /// of 3 / L.
    ///
    /// # Errors
    ///
    /// [`Argument`](SurfaceError::Argument) if there are no triangles, or if a triangle's index is out of range.
    pub fn new(directions: &Directions, faces: &[[u32; 3]], spacing: f64) -> Result<Self, SurfaceError> {
        let unit = directions.as_slice();
        let wrong = |found| {
            let (what, expected) = ("triangles to sample", "at least one triangle, and only vertices of the sphere");
            Err(SurfaceError::Argument { what, expected, found })
        };
        if faces.is_empty() {
            return wrong("none".to_owned());
        }
        if let Some(vertex) = faces.iter().flatten().find(|&&v| v as usize >= unit.len()) {
            return wrong(format!("vertex {vertex} (counted from 0), but the sphere has only {} vertices", unit.len()));
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

    /// Returns the number of samples of a range of triangles.
    #[must_use]
    pub fn samples(&self, triangles: Range<usize>) -> usize {
        self.first[triangles.end] - self.first[triangles.start]
    }

    /// Returns, for each triangle in order, the range of its samples' indices.
    pub fn of_triangles(&self) -> impl Iterator<Item = Range<usize>> {
        self.first.windows(2).map(|pair| pair[0]..pair[1])
    }

    /// Divides the triangles into consecutive ranges with at most `most` samples each. A triangle with more samples
    /// gets a separate range.
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

    /// Returns the samples of a range of triangles. `directions` must be the ones given to [`new`](Self::new).
    /// Triangles that face inwards are treated like those that face outwards.
    ///
    /// # Errors
    ///
    /// [`NoDirection`](SurfaceError::NoDirection) if the range has no samples.
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
                    // Near the centre of the sphere, a point has no well-defined direction and almost no solid angle,
                    // so its weight is set to 0.
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

    /// Interpolates values at the vertices, an (n, c) array with c values for each of the n vertices, linearly to the
    /// samples of a range of triangles. Returns an array of shape (samples, c).
    ///
    /// # Panics
    ///
    /// Panics if `values` has fewer rows than the triangles' indices require.
    #[must_use]
    pub fn interpolate(&self, values: ArrayView2<'_, f64>, triangles: Range<usize>) -> Array2<f64> {
        let mut samples = Array2::zeros((self.samples(triangles.clone()), values.ncols()));
        self.interpolate_to(values, triangles, samples.view_mut());
        samples
    }

    /// Interpolates like [`interpolate`](Self::interpolate), but writes the values to `samples`, an array of shape
    /// (samples, c) that may consist of some columns of a larger array.
    ///
    /// # Panics
    ///
    /// Panics if `values` has fewer rows than the triangles' indices require, or `samples` has fewer rows than there
    /// are samples.
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

    /// Returns, for each sample of a range of triangles, the corners of its triangle and its barycentric weights.
    #[must_use]
    pub fn corners(&self, triangles: Range<usize>) -> (Vec<[u32; 3]>, Vec<[f64; 3]>) {
        let samples = self.samples(triangles.clone());
        let (mut corners, mut shares) = (Vec::with_capacity(samples), Vec::with_capacity(samples));
        for cut in &self.cuts[triangles] {
            cut.for_each(|of_corners, _| {
                corners.push(cut.corners);
                shares.push(of_corners);
            });
        }
        (corners, shares)
    }

    /// Divides a range of triangles into parts for parallel tasks. Each part gets those rows of an array that belong to
    /// its samples.
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

    /// Computing the samples range by range gives the same samples as computing all of them at once.
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
                let (corners, shares) = sampling.corners(run.clone());
                let found = sampling.interpolate(values.view(), run);
                for ((corners, shares), found) in corners.iter().zip(&shares).zip(found.rows()) {
                    let expected = (0..3).map(|k| shares[k] * values[[corners[k] as usize, 1]]).sum::<f64>();
                    assert!((found[1] - expected).abs() < 1e-15);
                }
                assert_eq!((corners.len(), shares.len()), (found.nrows(), found.nrows()));
                at.extend(found);
            }
            assert_eq!((weights, places), (all.weights.clone(), all.directions.as_slice().to_vec()));
            assert_eq!(at, at_all.iter().copied().collect::<Vec<_>>());
        }
    }

    #[test]
    fn degrees_ask_for_cells_of_three_over_the_degree() {
        let sphere = Sphere::icosphere(1);
        let of = |degree| SphereSampling::for_degree(&sphere.directions, &sphere.faces, degree).unwrap();
        let with = |spacing| SphereSampling::new(&sphere.directions, &sphere.faces, spacing).unwrap();
        for degree in [1, 10, 40] {
            let (found, wanted) = (of(degree), with(3.0 / degree as f64));
            assert_eq!(found.triangles(), 80);
            assert!(found.of_triangles().eq(wanted.of_triangles()));
        }
        assert!(of(0).of_triangles().eq(of(1).of_triangles()) && of(40).samples(0..80) > 4 * of(10).samples(0..80));
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
