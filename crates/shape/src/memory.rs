//! Estimates the memory that analyses of groups need. A model has K = (L + 1)^2 coefficients per column.

use spharm_harmonics::basis_size;
use spharm_transform::{FINEST, Transform, TransformParams};

use crate::geometry::run_length;

/// Dimensions of a group of models.
#[derive(Debug, Clone, Copy)]
pub struct GroupSizes {
    /// Number of models, n.
    pub models: usize,
    /// Highest degree of the models, L.
    pub max_degree: usize,
    /// Number of columns of a model, c.
    pub channels: usize,
}

impl GroupSizes {
    /// Returns the number of coefficients of the group, `n K c`.
    fn values(self) -> u64 {
        let of_model = basis_size(self.max_degree).saturating_mul(self.channels);
        (self.models as u64).saturating_mul(of_model as u64)
    }

    /// Returns the number of bytes for the group's coefficients and for their copies at a common degree, `16 n K c`.
    #[must_use]
    pub fn coefficients(self) -> u64 {
        self.values().saturating_mul(16)
    }

    /// Returns the number of bytes for aligning the group, in addition to the coefficients. The members in their poses
    /// take `96 n K`. The surfaces of the mean and of one member are stored once. Each thread needs the larger of
    /// [`align_bytes`] and the memory of a surface with its search tree.
    #[must_use]
    pub fn procrustes(self, threads: usize) -> u64 {
        let members = (96 * self.models as u64).saturating_mul(basis_size(self.max_degree) as u64);
        let surface = 2_u64 << 20;
        let evaluated = evaluating(2_562, self.max_degree, 3, usize::MAX).saturating_add(surface);
        let of_thread = align_bytes(self.max_degree).max(evaluated);
        members.saturating_add(of_thread.saturating_mul(threads as u64)).saturating_add(2 * surface)
    }

    /// Returns the number of bytes for the modes of the group, in addition to the coefficients: `40 n K c + 64 n^2` for
    /// members as columns, their singular vectors and modes, and the workspace of the decomposition. Computing the
    /// quality with `samples` random shapes adds `24 n^2` for leave-one-out scores, `24 n^2` in each thread, and `8 n`
    /// per shape.
    #[must_use]
    pub fn modes(self, samples: usize, threads: usize) -> u64 {
        let n = self.models as u64;
        let squares = n.saturating_mul(n);
        let quality = if samples > 0 { squares.saturating_mul(24 * (1 + threads as u64)) } else { 0 };
        let decomposition = self.values().saturating_mul(40).saturating_add(squares.saturating_mul(64));
        decomposition.saturating_add(quality).saturating_add((8 * n).saturating_mul(samples as u64))
    }

    /// Returns the number of bytes for computing the quality measures with `modes` modes (m) at `directions` directions
    /// (V), in addition to the coefficients:
    ///
    /// - `48 n V` for two copies of the members' points, and `360 n V` for their search trees;
    /// - `64 n^2` for inner products, and `48 n^2` per thread for decompositions;
    /// - `1600 n m` for the nearest shapes of 200 members, and `40 m` per random shape, both for the group and for a
    ///   bootstrap draw in each thread;
    /// - in each thread, the transform of one member at `4 V` directions, which landmarks need.
    #[must_use]
    pub fn quality(self, directions: u64, modes: usize, samples: usize, threads: usize) -> u64 {
        let (n, m) = (self.models as u64, (modes.min(self.models)) as u64);
        let points = n.saturating_mul(408).saturating_mul(directions);
        let squares = n.saturating_mul(n).saturating_mul(64 + 48 * threads as u64);
        let shapes = (samples as u64).saturating_mul(40 * m).saturating_add(n.saturating_mul(1600 * m));
        let evaluated = evaluating(directions.saturating_mul(4), self.max_degree, 3, usize::MAX)
            .saturating_add(directions.saturating_mul(4 * 400));
        points
            .saturating_add(squares)
            .saturating_add(shapes.saturating_mul(1 + threads as u64))
            .saturating_add(evaluated.saturating_mul(threads as u64))
    }

    /// Returns the number of bytes for a test at `vertices` vertices, V, with `relabellings` relabellings, in addition
    /// to the coefficients:
    ///
    /// - `32 n V d` for the samples of all models with d components per vertex, for their residuals, and for a second
    ///   copy of both, which Welch's test and the computation use;
    /// - 8 per vertex and thread, 24 per relabelling, and 1200 per vertex for maps and their table;
    /// - the larger of the transform of one model and the geometry of the mean.
    #[must_use]
    pub fn test(self, vertices: u64, components: usize, relabellings: usize, threads: usize) -> u64 {
        let of_models = (32 * (self.models * components) as u64).saturating_mul(vertices);
        let counts = (8 * threads as u64 + 1200).saturating_mul(vertices);
        let relabelled = (relabellings as u64).saturating_mul(24);
        let evaluated = evaluating(vertices, self.max_degree, self.channels, usize::MAX);
        let geometry = local_geometry_bytes(vertices, self.max_degree);
        of_models.saturating_add(counts).saturating_add(relabelled).saturating_add(evaluated.max(geometry))
    }
}

/// Returns the number of bytes for the statistics of regions in a test at `vertices` vertices. Each thread holds the
/// maps of a batch of relabellings and a forest of regions; all threads share the graph of the surface.
#[must_use]
pub fn regions_bytes(vertices: u64, threads: usize) -> u64 {
    vertices.saturating_mul((64 * 8 + 72) * threads as u64 + 200)
}

/// Returns the number of bytes for one alignment at degree L with at most 8 starts and a grid of bandwidth 8, in
/// addition to the coefficients; see [`align`](mod@crate::align).
#[must_use]
pub fn align_bytes(max_degree: usize) -> u64 {
    (12 + 8 * 240) * basis_size(max_degree) as u64 + 11 * 8_u64.pow(4)
}

/// Returns the number of bytes that [`local_geometry`](crate::local_geometry) uses for `directions` directions,
/// including the result. The number has two parts: 368 bytes per direction while the result is collected, and the
/// transform of 30 columns with its output for the directions evaluated at a time.
#[must_use]
pub fn local_geometry_bytes(directions: u64, max_degree: usize) -> u64 {
    directions.saturating_mul(368).saturating_add(evaluating(directions, max_degree, 30, run_length(max_degree)))
}

/// Returns the maximum number of bytes that [`measure`](crate::measure) uses. A transform evaluates 12 columns, at a
/// limited number of a grid's directions at a time. The grid has 1,024 or 2 L + 2 rings, whichever is larger.
#[must_use]
pub fn measure_bytes(max_degree: usize) -> u64 {
    let rings = 1024.max(2 * max_degree + 2);
    evaluating(2 * (rings * rings) as u64, max_degree, 12, run_length(max_degree))
}

/// Returns the number of bytes for directions, transform and values, if at most `most` directions are evaluated at a
/// time.
fn evaluating(directions: u64, max_degree: usize, channels: usize, most: usize) -> u64 {
    let run = usize::try_from(directions).unwrap_or(usize::MAX / 1024).min(most);
    let params = TransformParams { max_degree, accuracy: FINEST, channels: channels.min(3) };
    let transform = Transform::bytes(&params, run, channels).unwrap_or(usize::MAX);
    (transform as u64).saturating_add((96 + 8 * channels as u64).saturating_mul(run as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_grow_with_every_size_and_never_wrap() {
        let group = GroupSizes { models: 1000, max_degree: 29, channels: 3 };
        // The members in their poses take 86 MB, as stated in procrustes.rs; the rest is for surfaces with their
        // search trees.
        let surfaces = group.procrustes(1) - 96 * 1000 * 900;
        assert!(surfaces > 6 << 20 && surfaces < 16 << 20, "{surfaces}");
        let more = GroupSizes { models: 2000, ..group };
        assert!(more.coefficients() == 2 * group.coefficients() && more.modes(0, 1) > 2 * group.modes(0, 1));
        assert!(group.modes(2000, 2) > group.modes(0, 2));
        assert!(group.quality(2_562, 10, 1000, 2) > group.quality(2_562, 10, 1000, 1));
        assert!(group.test(40_962, 3, 0, 1) > 2 * group.test(40_962, 1, 0, 1));
        assert!(group.test(10, 1, 1 << 40, 1) > 24 << 40);
        let all = GroupSizes { models: usize::MAX >> 8, max_degree: 1000, channels: 3 };
        assert_eq!(all.modes(usize::MAX, 64), u64::MAX);
        assert_eq!(all.coefficients(), u64::MAX);
        assert_eq!(all.quality(2_562, 10, usize::MAX, 64), u64::MAX);
    }
}
