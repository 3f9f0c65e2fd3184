//! Holds the members of a group during its alignment, and computes their mean.

use crate::half_turn::Workspace;
use crate::matrix3::determinant;
use crate::pair::{Plan, Unit};
use crate::refine::{Fit, Target};
use crate::rotation::Rotation;
use crate::transform::SQRT_4_PI;

/// Pose that aligns a member to the mean.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pose {
    pub(crate) fit: Fit,
    pub(crate) antipodal: bool,
}

impl Pose {
    /// Returns whether the mirror image of the member was aligned to the mean.
    pub(crate) fn mirrors(&self) -> bool {
        determinant(&self.fit.orthogonal) < 0.0
    }
}

/// A member of a group, with its coefficients after its pose was applied.
#[derive(Debug, Clone)]
pub(crate) struct Member {
    pub(crate) pose: Pose,
    /// Coefficients (K, 3) after the pose was applied, with row 0 (the position) set to zero.
    pub(crate) rows: Vec<[f64; 3]>,
}

impl Member {
    /// Applies a pose to a surface of norm 1, and scales the surface by `size`.
    pub(crate) fn new(unit: &Unit, size: f64, pose: Pose, plan: Option<&Plan>) -> Self {
        let other = pose.antipodal.then(|| unit.antipodal());
        let from = &other.as_ref().unwrap_or(unit).rows;
        let mut rows = from.clone();
        if let Some(plan) = plan.filter(|_| pose.fit.rotation != Rotation::IDENTITY) {
            plan.rotator.rotate(from, &pose.fit.rotation, &mut rows, &mut Workspace::default());
        }
        for row in &mut rows {
            let x = *row;
            *row = pose.fit.orthogonal.map(|q| size * (q[0] * x[0] + q[1] * x[1] + q[2] * x[2]));
        }
        Self { pose, rows }
    }
}

/// State of a group after a round of alignment: its members in their poses, and their mean.
#[derive(Debug)]
pub(crate) struct Round {
    pub(crate) members: Vec<Member>,
    /// Mean (K, 3) of the members' rows.
    pub(crate) mean: Vec<[f64; 3]>,
    /// Root mean square distance of the members from their mean.
    pub(crate) spread: f64,
}

impl Round {
    /// Returns the mean, scaled to norm 1; zero if the mean is zero.
    pub(crate) fn target(&self) -> Target {
        let norm = self.norm();
        let scale = if norm > 0.0 { 1.0 / norm } else { 0.0 };
        Target::new(self.mean.iter().map(|row| row.map(|v| v * scale)).collect())
    }

    /// Returns the mean of all members except one, scaled to norm 1; zero if that mean is zero.
    pub(crate) fn without(&self, index: usize) -> Target {
        let (count, without) = (self.members.len() as f64, &self.members[index].rows);
        let rest = |(mean, row): (&[f64; 3], &[f64; 3])| std::array::from_fn(|c| count * mean[c] - row[c]);
        let mut rows: Vec<[f64; 3]> = self.mean.iter().zip(without).map(rest).collect();
        let norm = rows.as_flattened().iter().map(|v| v * v).sum::<f64>().sqrt();
        let scale = if norm > 0.0 { 1.0 / norm } else { 0.0 };
        rows.as_flattened_mut().iter_mut().for_each(|v| *v *= scale);
        Target::new(rows)
    }

    fn norm(&self) -> f64 {
        self.mean.as_flattened().iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// Returns the root mean square distance of the mean surface's points from its centre.
    pub(crate) fn size(&self) -> f64 {
        self.norm() / SQRT_4_PI
    }

    /// Returns the root mean square distance between the mean and a member of norm `size`, given the distance
    /// `distance` between the two after scaling both to norm 1.
    pub(crate) fn rmsd_of(&self, distance: f64, size: f64) -> f64 {
        let norm = self.norm();
        (norm - size).hypot((norm * size).sqrt() * distance) / SQRT_4_PI
    }

    /// Returns the distances of the members from the mean.
    pub(crate) fn distances(&self) -> Vec<f64> {
        self.members.iter().map(|member| square(&member.rows, &self.mean).sqrt() / SQRT_4_PI).collect()
    }

    /// Returns the largest distance by which any member moved since the round `other`, relative to the mean's size.
    pub(crate) fn moved_from(&self, other: &Self) -> f64 {
        let moved = self.members.iter().zip(&other.members).map(|(a, b)| square(&a.rows, &b.rows).sqrt());
        moved.fold(0.0, f64::max) / self.norm().max(f64::MIN_POSITIVE)
    }
}

/// Returns the mean of the members' rows. The sum is taken in the order of the members, so the result is reproducible.
pub(crate) fn mean_of(members: &[Member]) -> Vec<[f64; 3]> {
    let mut mean = vec![[0.0; 3]; members.first().map_or(0, |member| member.rows.len())];
    for member in members {
        for (mean, row) in mean.as_flattened_mut().iter_mut().zip(member.rows.as_flattened()) {
            *mean += row;
        }
    }
    let count = members.len() as f64;
    mean.as_flattened_mut().iter_mut().for_each(|v| *v /= count);
    mean
}

/// Returns the root mean square distance of the members from `mean`.
pub(crate) fn spread_of(members: &[Member], mean: &[[f64; 3]]) -> f64 {
    let total: f64 = members.iter().map(|member| square(&member.rows, mean)).sum();
    (total / members.len() as f64).sqrt() / SQRT_4_PI
}

fn square(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b) * (a - b)).sum()
}
