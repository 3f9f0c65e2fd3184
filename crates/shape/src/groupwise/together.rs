//! Aligns members rigidly to their mean in every step of the refinement.
//!
//! Directions are weighted by their area on the mean surface. Rotations are found by Kabsch's method, starting from
//! each member's pose in the last step. These motions minimise the variance, and therefore nearly minimise the
//! description length. The gradient is computed as if the motions were constant.

use ndarray::{Array2, Axis};
use rayon::prelude::*;
use spharm_surface::geometry::{Vec3, dot, face_normal};

use crate::groupwise::objective::{Objective, corners};
use crate::matrix3::{IDENTITY, Matrix3, product};
use spharm_surface::kabsch::kabsch;

/// Rotation of each member in space; empty if members aren't aligned in every step.
pub(super) type Turns = Vec<Matrix3>;

/// Number of iterations, each of which computes the mean and then moves the members to the mean.
const ROUNDS: usize = 2;

/// Moves the members' values (N, n C) rigidly to the mean, and returns the members' rotations. `turning` holds the
/// first channel of each triple of channels that rotates with the surface. The triple that starts at channel 0 is the
/// position, which is also translated. `last` holds the rotations of the previous step, from which the iterations
/// start.
pub(super) fn bring_together(
    values: &mut Array2<f64>,
    turning: &[usize],
    objective: &Objective<'_>,
    last: &Turns,
) -> Turns {
    let directions = objective.mask.len();
    let channels = values.ncols() / directions;
    let mut turns = if last.is_empty() { vec![IDENTITY; values.nrows()] } else { last.clone() };
    let rows = values.axis_iter_mut(Axis(0)).into_par_iter().zip(&turns);
    rows.for_each(|(mut row, turn)| turn_channels(row.as_slice_mut().unwrap_or_default(), channels, turning, turn));
    for _ in 0..ROUNDS {
        let mut mean = vec![0.0; values.ncols()];
        for row in values.rows() {
            mean.iter_mut().zip(row).for_each(|(m, x)| *m += x / values.nrows() as f64);
        }
        let weights = areas(&mean, objective);
        let centre = centroid(&mean, &weights);
        let rows = values.axis_iter_mut(Axis(0)).into_par_iter().zip(&mut turns);
        rows.for_each(|(mut row, turn)| {
            let row = row.as_slice_mut().unwrap_or_default();
            let from = centroid(row, &weights);
            let mut moment = [[0.0; 3]; 3];
            for ((x, m), w) in row.chunks_exact(channels).zip(mean.chunks_exact(channels)).zip(&weights) {
                for (i, j) in (0..9).map(|k| (k / 3, k % 3)) {
                    moment[i][j] += w * (m[i] - centre[i]) * (x[j] - from[j]);
                }
            }
            let by = kabsch(&moment, false);
            for row in row.chunks_exact_mut(channels) {
                (0..3).for_each(|k| row[k] -= from[k]);
            }
            turn_channels(row, channels, turning, &by);
            for row in row.chunks_exact_mut(channels) {
                (0..3).for_each(|k| row[k] += centre[k]);
            }
            *turn = product(&by, turn);
        });
    }
    turns
}

/// Rotates the triples of channels that start at the channels `first`, at every direction.
pub(super) fn turn_channels(row: &mut [f64], channels: usize, first: &[usize], by: &Matrix3) {
    for row in row.chunks_exact_mut(channels) {
        for &first in first {
            let x = [row[first], row[first + 1], row[first + 2]];
            (0..3).for_each(|k| row[first + k] = by[k][0] * x[0] + by[k][1] * x[1] + by[k][2] * x[2]);
        }
    }
}

/// Returns each direction's fraction of the surface's area inside the mask; 0 for directions outside the mask.
fn areas(row: &[f64], objective: &Objective<'_>) -> Vec<f64> {
    let at = corners(row, objective.mask.len());
    let mut found = vec![0.0; objective.mask.len()];
    for face in objective.faces {
        let normal = face_normal(face.map(|v| at(v as usize)));
        face.iter().for_each(|&v| found[v as usize] += dot(normal, normal).sqrt() / 6.0);
    }
    found.iter_mut().zip(objective.mask).for_each(|(area, mask)| *area *= mask);
    let total: f64 = found.iter().sum();
    found.iter_mut().for_each(|area| *area /= total);
    found
}

fn centroid(row: &[f64], weights: &[f64]) -> Vec3 {
    let at = corners(row, weights.len());
    let mut found = [0.0; 3];
    for (v, w) in weights.iter().enumerate() {
        let x = at(v);
        (0..3).for_each(|k| found[k] += w * x[k]);
    }
    found
}
