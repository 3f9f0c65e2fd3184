//! Evaluates one member of a group during a stage: its channels as functions on the sphere, and their derivatives.
//!
//! If g_c is the derivative of the cost with respect to the value of channel f_c at a direction p, the derivative with
//! respect to p is the tangent vector `sum_c g_c grad f_c`. With `L f = p x grad f`, this vector is `-p x h` for `h =
//! sum_c g_c L f_c`.
//!
//! The unit normals of the surface are channels too. They are projected onto harmonics by quadrature on a
//! Gauss-Legendre grid. Therefore the derivatives of the normals need no second derivatives of the surface, and stages
//! of low degree use normals of low degree.
//!
//! Cost for C channels: a synthesis of C functions for the values, and a synthesis of 3C functions for the contraction
//! with the derivatives g_c.

use ndarray::{Array2, ArrayView2, s};
use spharm_harmonics::index::basis_size;
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, cross, dot, scale, unit};
use spharm_transform::{Transform, TransformParams};

use crate::derivatives::rotational_derivatives;
use crate::error::ShapeError;
use crate::geometry::side_by_side;
use crate::measures::{Columns, Grid};

/// Accuracy of values and gradients, relative to their root mean square.
const ACCURACY: f64 = 1e-8;
/// Number of channels that a transform processes together, with shared kernels.
const TOGETHER: usize = 6;

/// Returns the coefficients (K, 3) of the unit normals up to the degree of the surface, and the surface's area.
pub(super) fn normals(surface: &Coefficients, monitor: &dyn Monitor) -> Result<(Array2<f64>, f64), ShapeError> {
    let degree = surface.max_degree();
    let grid = Grid::new(2 * degree + 2);
    let columns = Columns::new(surface)?;
    let (mut found, mut area) = (Array2::zeros((basis_size(degree), 3)), 0.0);
    for run in grid.runs(degree) {
        monitor.check()?;
        let directions = grid.directions(run.clone());
        let points = columns.at(directions.clone())?;
        let weights = run.flat_map(|ring| std::iter::repeat_n(grid.weight(ring), grid.around()));
        let mut samples = Array2::zeros((points.len(), 3));
        for ((mut row, [_, n]), weight) in samples.rows_mut().into_iter().zip(&points).zip(weights) {
            area += weight * dot(*n, *n).sqrt();
            let n = scale(unit(*n), weight);
            (0..3).for_each(|c| row[c] = n[c]);
        }
        let params = TransformParams { max_degree: degree, ..TransformParams::default() };
        let transform = Transform::new(&Directions::from_unit_vectors(directions)?, &params)?;
        found += &transform.adjoint_synthesis(samples.view())?;
    }
    Ok((found, area))
}

/// Channels of a member, truncated to the degree of a stage.
pub(super) struct Member {
    /// Coefficients (K, C) of the channels f.
    values: Array2<f64>,
    /// Coefficients (K, 3 C) of `L_x f`, `L_y f` and `L_z f`, side by side: the [derivatives](crate::derivatives) of
    /// the channels under rotations.
    derivatives: Array2<f64>,
}

impl Member {
    /// Creates a member from the coefficients (K, C) of all channels, truncated to `max_degree`.
    pub(super) fn new(channels: ArrayView2<'_, f64>, max_degree: usize) -> Result<Self, ShapeError> {
        let values = channels.slice(s![..basis_size(max_degree).min(channels.nrows()), ..]).to_owned();
        let derivatives = side_by_side(&rotational_derivatives(values.view())?);
        Ok(Self { values, derivatives })
    }

    /// Returns the values (n, C) of all channels at the plan's directions.
    pub(super) fn values(&self, plan: &Plan) -> Result<Array2<f64>, ShapeError> {
        Ok(plan.surface.synthesis(self.values.view())?)
    }

    /// Returns the tangent vectors `sum_c g_c grad f_c` at the plan's directions, for the derivatives g (n, C) of the
    /// cost with respect to the channels' values.
    pub(super) fn contract(&self, covectors: &[f64], at: &[Vec3], plan: &Plan) -> Result<Vec<Vec3>, ShapeError> {
        let samples = plan.surface.synthesis(self.derivatives.view())?;
        let channels = self.values.ncols();
        let rows = samples.rows().into_iter().zip(covectors.chunks_exact(channels)).zip(at);
        Ok(rows
            .map(|((row, g), &p)| {
                let h = [0, 1, 2].map(|k| (0..channels).map(|c| g[c] * row[k * channels + c]).sum());
                cross(h, p)
            })
            .collect())
    }
}

/// Two transforms at the same directions: one up to the degree of the surfaces, and one up to the degree of the tangent
/// fields' potentials.
pub(super) struct Plan {
    pub(super) surface: Transform,
    pub(super) field: Transform,
}

impl Plan {
    pub(super) fn new(at: &[Vec3], max_degree: usize, field_degree: usize) -> Result<Self, ShapeError> {
        let params =
            TransformParams { max_degree: max_degree.max(field_degree), accuracy: ACCURACY, channels: TOGETHER };
        let all = Transform::new(&Directions::from_unit_vectors(at.to_vec())?, &params)?;
        Ok(Self { surface: all.to_degree(max_degree, TOGETHER)?, field: all.to_degree(field_degree, TOGETHER)? })
    }
}
