//! Computes sums over samples that are linear in values at nodes, as samples of a surface are linear in the values at
//! its vertices.
//!
//! Sample i lies in a triangle, and has the value `f_i = sum_k lambda_ik X_{v_ik}`, where `lambda_ik` are its
//! barycentric coordinates and X the values at the triangle's three corners `v_ik`. With the sample's weight `w_i` and
//! the harmonics `S(x_i)` at its direction, the right-hand sides of a least-squares fit are linear in X as well:
//!
//! ```text
//! A^T W f = sum_v X_v h_v,   h_v = sum_i w_i lambda_iv S(x_i)
//! ```
//!
//! On the oversampled grid of an [adjoint synthesis](crate::Transform::adjoint_synthesis) `h_v` is a *patch*: the sum
//! of the kernels of the samples around a node, which covers a few grid points more than a single kernel. With three
//! samples per triangle, a node with six triangles has 18 kernels but only one patch. Therefore spreading values at
//! nodes takes a quarter of the products needed for spreading samples. The samples' values are never computed. Patches
//! don't depend on the values: [`NodalSums::keep`] computes them once for many surfaces over one sphere. Without this
//! call, patches are computed when they are added to the grid, and then discarded. The results are bit-identical in
//! both cases, and depend neither on other channels nor on the number of threads.
//!
//! # Cost
//!
//! Each channel costs a fused product for each value of a patch. A patch has about 400 values if the node's triangles
//! are smaller than the kernel. With kernels of w by w grid points, computing patches takes `3 w^2` products per
//! sample. Memory: 48 bytes per sample and 120 per triangle, 8 bytes for each value of a patch that is kept, and a
//! grid.

mod incidence;
mod kernels;
mod patches;
mod samples;
mod spread;

use std::ops::Range;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use self::incidence::{Element, Incidence};
use self::patches::{Patches, ROWS};
pub use self::samples::NodalSamples;
use self::spread::add_patches;
use crate::grid::Layout;
use crate::gridding::Gridding;
use crate::{Accumulator, FINEST, SampleSums, Transform, TransformError, TransformParams};

/// Number of pieces of patches computed together, if patches aren't kept.
const TOGETHER: usize = 128;

/// Number of channels transformed together. With more channels, the grid doesn't fit in the caches; with fewer, patches
/// are read more often.
const CHANNELS: usize = 32;

/// Number of elements (triangles) whose samples' squares are summed by one task.
const ELEMENTS: usize = 4096;

/// Collects the samples of a [`NodalSums`].
#[derive(Debug)]
pub struct NodalSumsBuilder {
    nodes: usize,
    /// Sums of the weights alone.
    weights: Accumulator,
    incidence: Incidence,
}

/// Samples over a sphere, prepared for computing the sums for any values at the nodes; see the [module](self).
#[derive(Debug)]
pub struct NodalSums {
    nodes: usize,
    /// The sums of the weights alone, that is, with zero channels.
    plain: SampleSums,
    transform: Transform,
    incidence: Incidence,
    /// The patches (see the [module](self)) of each strip of the grid; `None` if every call of
    /// [`sums`](NodalSums::sums) computes them anew.
    kept: Option<Vec<Patches>>,
}

impl NodalSumsBuilder {
    /// Creates a builder without samples, for fits to degree L = `max_degree` of values at `nodes` nodes. `triangles`
    /// and `samples` are the expected numbers of triangles and samples.
    ///
    /// # Errors
    ///
    /// The errors of [`Accumulator::new`].
    pub fn new(max_degree: usize, nodes: usize, triangles: usize, samples: usize) -> Result<Self, TransformError> {
        let gridding = Gridding::choose(max_degree, nodes, FINEST)?;
        let weights = Accumulator::new(max_degree, 0)?;
        Ok(Self { nodes, weights, incidence: Incidence::new(gridding, max_degree, triangles, samples) })
    }

    /// Adds samples. Samples of the same triangle should follow each other.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if an array doesn't have n rows, or a node's index is out of range.
    pub fn add(&mut self, samples: NodalSamples<'_>) -> Result<(), TransformError> {
        let NodalSamples { directions, weights, nodes, shares } = samples;
        let n = directions.len();
        for (what, found) in [("nodes of samples", nodes.len()), ("shares of samples", shares.len())] {
            if found != n {
                return Err(TransformError::Shape { what, expected: n, found });
            }
        }
        if let Some(&node) = nodes.iter().flatten().find(|&&node| node as usize >= self.nodes) {
            return Err(TransformError::Shape { what: "nodes", expected: node as usize + 1, found: self.nodes });
        }
        self.weights.add(directions, Some(weights), Array2::zeros((n, 0)).view())?;
        self.incidence.add(samples);
        Ok(())
    }

    /// Sorts the samples by their nodes and sums their weights.
    ///
    /// # Errors
    ///
    /// Errors of planning transforms, which can't occur once [`new`](Self::new) has accepted the degree.
    pub fn finish(self) -> Result<NodalSums, TransformError> {
        let Self { nodes, weights, mut incidence } = self;
        let max_degree = weights.max_degree();
        incidence.sort(nodes);
        let plain = weights.finish()?.sums;
        let params = TransformParams { max_degree, accuracy: FINEST, channels: CHANNELS };
        let transform = Transform::on(incidence.gridding(), &[], &params)?;
        Ok(NodalSums { nodes, plain, transform, incidence, kept: None })
    }
}

impl NodalSums {
    /// Returns the peak memory in bytes for `samples` samples on `triangles` triangles, including their preparation and
    /// the computation of sums for c = `channels` channels. Patches stored by [`keep`](Self::keep) aren't included.
    #[must_use]
    pub fn bytes(max_degree: usize, nodes: usize, triangles: usize, samples: usize, channels: usize) -> usize {
        // Bytes for the place and the shares of each sample, for the data of each triangle and its entries in the lists
        // of its nodes, and for the starts of each node's list and patches.
        let own = 48 * samples + (size_of::<Element>() + 24) * triangles + 128 * nodes;
        let scratch = (1 << 20) * rayon::current_num_threads();
        let params = TransformParams { max_degree, accuracy: FINEST, channels: CHANNELS };
        let transform = Transform::bytes(&params, nodes, channels).unwrap_or(usize::MAX / 4);
        own + scratch + Accumulator::bytes(max_degree, 0).max(transform)
    }

    /// Returns the size of all patches in bytes.
    #[must_use]
    pub fn patch_bytes(&self) -> usize {
        8 * self.incidence.patch_values()
    }

    /// Computes the patches once, for all later calls of [`sums`](Self::sums).
    pub fn keep(&mut self) {
        let strips = 0..self.incidence.strips();
        let of_strip = |strip: usize| {
            let mut patches = Patches::default();
            self.incidence.patches(strip, self.incidence.pieces(strip), &mut patches);
            patches
        };
        self.kept = Some(strips.into_par_iter().with_max_len(1).map(of_strip).collect());
    }

    /// Computes the sums over all samples for `values` (nodes, c) at the nodes.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if the number of rows isn't the number of nodes.
    pub fn sums(&self, values: ArrayView2<'_, f64>) -> Result<SampleSums, TransformError> {
        if values.nrows() != self.nodes {
            return Err(TransformError::Shape { what: "values at nodes", expected: self.nodes, found: values.nrows() });
        }
        let channels = values.ncols();
        let values = values.as_standard_layout();
        let values = values.as_slice().unwrap_or_default();
        let right_sides = self.transform.adjoint_of_grid(channels, |layout, columns, grid| {
            self.spread(layout, columns.start, values, channels, grid);
        });
        Ok(SampleSums { right_sides, squares: self.squares(values, channels), ..self.plain.clone() })
    }

    /// Writes to a grid the sum of all nodes' patches, each multiplied by its node's values. `first` is the channel of
    /// `values` that becomes the grid's first channel.
    fn spread(&self, layout: Layout, first: usize, values: &[f64], channels: usize, grid: &mut [f64]) {
        let strips = grid.par_chunks_mut(ROWS * layout.row()).enumerate().with_max_len(1);
        strips.for_each_init(Patches::default, |scratch, (strip, grid)| {
            grid.fill(0.0);
            if let Some(kept) = &self.kept {
                if let Some(patches) = kept.get(strip) {
                    add_patches(layout, grid, patches, &values[first..], channels);
                }
                return;
            }
            for pieces in self.incidence.pieces(strip).chunks(TOGETHER) {
                self.incidence.patches(strip, pieces, scratch);
                add_patches(layout, grid, scratch, &values[first..], channels);
            }
        });
    }

    /// Returns `sum_i w_i f_i^2` of each channel.
    fn squares(&self, values: &[f64], channels: usize) -> Vec<f64> {
        let row = |node: u32| -> &[f64] {
            let row: Range<usize> = node as usize * channels..(node as usize + 1) * channels;
            &values[row]
        };
        let of_some = |elements: &[Element]| {
            let mut sums = vec![0.0; channels];
            for Element { nodes: [a, b, c], products: p, .. } in elements {
                for (((sum, a), b), c) in sums.iter_mut().zip(row(*a)).zip(row(*b)).zip(row(*c)) {
                    *sum +=
                        a * (p[0] * a + 2.0 * (p[1] * b + p[3] * c)) + b * (p[2] * b + 2.0 * p[4] * c) + p[5] * c * c;
                }
            }
            sums
        };
        let parts: Vec<Vec<f64>> = self.incidence.elements().par_chunks(ELEMENTS).map(of_some).collect();
        let mut squares = vec![0.0; channels];
        for part in parts {
            squares.iter_mut().zip(part).for_each(|(square, part)| *square += part);
        }
        // Only rounding errors can make a sum of squares negative.
        squares.iter_mut().for_each(|square| *square = square.max(0.0));
        squares
    }
}

#[cfg(test)]
mod tests {
    use spharm_harmonics::Directions;

    use super::*;

    /// Test data: nodes in any order, with samples near the nodes and far away, at both poles and on the seam. Some
    /// samples have weight 0.
    struct Problem {
        directions: Vec<[f64; 3]>,
        weights: Vec<f64>,
        nodes: Vec<[u32; 3]>,
        shares: Vec<[f64; 3]>,
    }

    fn problem(nodes: u32, samples: usize) -> Problem {
        let mut vertices = Directions::fibonacci(samples - 4).unwrap().as_slice().to_vec();
        vertices.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, -1e-12, 0.2], [1.0, 0.0, 0.2]]);
        let directions = Directions::from_vertices(&vertices).unwrap().as_slice().to_vec();
        // A sample's nodes are neighbours along a spiral, so that patches near the poles go around the sphere.
        let nodes = |i: usize| {
            let near = (i as u64 * u64::from(nodes) / samples as u64) as u32;
            [near, (near + 1) % nodes, if i % 50 == 7 { (near * 7 + 3) % nodes } else { (near + 2) % nodes }]
        };
        let share = |i: usize| [(i as f64).sin().abs(), 0.25, 0.5 - 0.1 * (i as f64).cos()];
        Problem {
            weights: (0..samples).map(|i| if i % 13 == 4 { 0.0 } else { 1.0 + (i as f64 * 0.7).sin() }).collect(),
            nodes: (0..samples).map(nodes).collect(),
            shares: (0..samples).map(share).collect(),
            directions,
        }
    }

    impl Problem {
        fn sums(&self, max_degree: usize, nodes: u32) -> NodalSums {
            let mut builder = NodalSumsBuilder::new(max_degree, nodes as usize, 10, self.weights.len()).unwrap();
            let half = self.weights.len() / 2;
            for rows in [0..half, half..self.weights.len()] {
                builder.add(self.samples(rows)).unwrap();
            }
            builder.finish().unwrap()
        }

        fn samples(&self, rows: Range<usize>) -> NodalSamples<'_> {
            NodalSamples {
                directions: &self.directions[rows.clone()],
                weights: &self.weights[rows.clone()],
                nodes: &self.nodes[rows.clone()],
                shares: &self.shares[rows],
            }
        }

        fn values(&self, at_nodes: &Array2<f64>) -> Array2<f64> {
            Array2::from_shape_fn((self.weights.len(), at_nodes.ncols()), |(i, c)| {
                (0..3).map(|k| self.shares[i][k] * at_nodes[[self.nodes[i][k] as usize, c]]).sum()
            })
        }
    }

    fn at_nodes(nodes: u32, channels: usize) -> Array2<f64> {
        Array2::from_shape_fn((nodes as usize, channels), |(v, c)| ((v * (c + 2)) as f64 * 0.31).cos())
    }

    fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
        values.into_iter().fold(0.0, |a: f64, b| a.max(b.abs()))
    }

    #[test]
    fn sums_are_those_of_the_samples() {
        for (max_degree, nodes, samples, channels) in
            [(0, 3, 10, 1), (1, 12, 60, 2), (7, 200, 2_000, 3), (30, 900, 5_000, 7), (90, 3_000, 9_000, 1)]
        {
            let problem = problem(nodes, samples);
            let at_nodes = at_nodes(nodes, channels);
            let found = problem.sums(max_degree, nodes).sums(at_nodes.view()).unwrap();
            let mut expected = Accumulator::new(max_degree, channels).unwrap();
            let values = problem.values(&at_nodes);
            expected.add(&problem.directions, Some(&problem.weights), values.view()).unwrap();
            let expected = expected.finish().unwrap().sums;
            let scale = largest(expected.moments.iter().copied());
            let off = largest((&found.right_sides - &expected.right_sides).iter().copied());
            assert!(off < 2e-13 * scale, "degree {max_degree}: right-hand sides off by {:.1e}", off / scale);
            let off = largest(found.moments.iter().zip(&expected.moments).map(|(a, b)| a - b));
            assert!(off < 2e-13 * scale, "degree {max_degree}: moments off by {:.1e}", off / scale);
            for (found, expected) in found.squares.iter().zip(&expected.squares) {
                assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
            }
            assert_eq!((found.count, found.max_degree), (expected.count, max_degree));
            assert!((found.weight / expected.weight - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn bits_depend_on_neither_channels_nor_threads_nor_what_is_kept() {
        let (max_degree, nodes) = (24, 700);
        let problem = problem(nodes, 4_000);
        let at_nodes = at_nodes(nodes, 9);
        let on = |threads: usize, keep: bool| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut sums = problem.sums(max_degree, nodes);
                if keep {
                    sums.keep();
                }
                sums.sums(at_nodes.view()).unwrap()
            })
        };
        let one = on(1, false);
        assert!(on(3, false) == one && on(2, true) == one);
        let alone = problem.sums(max_degree, nodes);
        for channel in 0..9 {
            let found = alone.sums(at_nodes.slice(ndarray::s![.., channel..=channel])).unwrap();
            assert_eq!(found.right_sides.column(0), one.right_sides.column(channel));
            assert_eq!(found.squares[0].to_bits(), one.squares[channel].to_bits());
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let problem = problem(20, 40);
        let mut builder = NodalSumsBuilder::new(2, 20, 40, 40).unwrap();
        let samples = problem.samples(0..40);
        assert!(builder.add(NodalSamples { nodes: &samples.nodes[1..], ..samples }).is_err());
        assert!(builder.add(NodalSamples { shares: &samples.shares[1..], ..samples }).is_err());
        assert!(builder.add(NodalSamples { weights: &samples.weights[1..], ..samples }).is_err());
        assert!(NodalSumsBuilder::new(2, 19, 40, 40).unwrap().add(samples).is_err());
        assert!(problem.sums(2, 20).sums(at_nodes(19, 1).view()).is_err());
        assert!(NodalSumsBuilder::new(spharm_harmonics::MAX_DEGREE + 1, 1, 1, 1).is_err());
    }
}
