//! Refines a new member's correspondence with a finished group without changing the group.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_surface::Sphere;
use spharm_surface::geometry::Vec3;

use super::descent::descend;
use super::elastic::Elastic;
use super::flow::Flow;
use super::held::Held;
use super::member::{Member, Plan};
use super::objective::Objective;
use super::params::{GroupwiseParams, StageParams};
use super::reference::Reference;
use super::report::GroupwiseReport;
use super::state::Group;
use super::{check, moved, with_normals};
use crate::error::ShapeError;

/// A finished group, prepared so that any number of new members can be refined against it.
pub struct FinishedGroup {
    sphere: Sphere,
    mask: Vec<f64>,
    params: GroupwiseParams,
    stages: Vec<(StageParams, Reference)>,
    /// Length by which the unit normals are multiplied to serve as channels, in the members' unit.
    length: f64,
    /// Number of rows of the members' coefficients.
    rows: usize,
}

impl FinishedGroup {
    /// Prepares a group. `members` are the canonical coefficients (K, 3) of each refined member. The other arguments
    /// must be the same as when [`groupwise`](super::groupwise()) refined the group. Uses 48 bytes per direction,
    /// member and stage.
    ///
    /// # Errors
    ///
    /// The errors of [`groupwise`](super::groupwise()).
    pub fn new(
        members: &[ArrayView2<'_, f64>],
        sphere: &Sphere,
        mask: Option<&[f64]>,
        params: &GroupwiseParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, ShapeError> {
        params.check()?;
        let max_degree = check(members, sphere, mask)?;
        let directions = sphere.directions.as_slice();
        let mask = mask.map_or_else(|| vec![1.0; directions.len()], <[f64]>::to_vec);
        let (channels, length) = with_normals(members, params.normals, None, monitor)?;
        let objective = Objective { faces: &sphere.faces, mask: &mask };
        let stages = params.stages.clone().unwrap_or_else(|| StageParams::up_to(max_degree));
        let cancel = OnlyCancel(monitor);
        let prepared = stages.into_iter().map(|stage| {
            let degree = stage.max_degree.min(max_degree);
            let plan = Plan::new(directions, degree, stage.field_degree)?;
            let mut values = Array2::zeros((members.len(), directions.len() * channels[0].ncols()));
            let rows = values.axis_iter_mut(Axis(0)).into_par_iter().zip(&channels);
            rows.try_for_each(|(mut row, channels)| {
                cancel.check()?;
                let found = Member::new(channels.view(), degree)?.values(&plan)?;
                row.iter_mut().zip(found.iter()).for_each(|(out, value)| *out = *value);
                Ok::<_, ShapeError>(())
            })?;
            let stage = StageParams { max_degree: degree, ..stage };
            Ok((stage, Reference::new(values, &objective, params.delta)?))
        });
        let stages = prepared.collect::<Result<Vec<_>, ShapeError>>()?;
        let (sphere, params, rows) = (sphere.clone(), params.clone(), members[0].nrows());
        Ok(Self { sphere, mask, params, stages, length, rows })
    }

    /// Finds the flow that brings a new member into correspondence with the group, given the member's coefficients
    /// (K, 3). The flow minimises a cost that grows with the member's Mahalanobis distance from the group, plus the
    /// elastic energy.
    ///
    /// Runs on the current rayon pool; the result is bitwise the same on any number of threads.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Differ`] if the member's number of coefficients differs from the group's; the errors of
    /// [`groupwise`](super::groupwise()).
    pub fn refine(
        &self,
        member: ArrayView2<'_, f64>,
        monitor: &dyn Monitor,
    ) -> Result<(Flow, GroupwiseReport), ShapeError> {
        if member.dim() != (self.rows, 3) {
            let (what, expected) = ("coefficients of a surface", 3 * self.rows);
            return Err(ShapeError::Differ { what, expected, found: member.len() });
        }
        let cancel = OnlyCancel(monitor);
        let (channels, _) = with_normals(&[member], self.params.normals, Some(self.length), &cancel)?;
        let directions = self.sphere.directions.as_slice();
        let mut flows = [Flow::default()];
        let mut at: Vec<Vec<Vec3>> = vec![directions.to_vec()];
        let mut report = GroupwiseReport::default();
        for (stage, reference) in &self.stages {
            let group = Group {
                members: vec![Member::new(channels[0].view(), stage.max_degree)?],
                channels: channels[0].ncols(),
                objective: Objective { faces: &self.sphere.faces, mask: &self.mask },
                reference: Some(reference),
                elastic: Elastic::new(&self.sphere.faces, directions),
                elasticity: self.params.elasticity,
                held: Held::new(&self.params.held, directions, self.params.hold),
                turning: None,
                max_degree: stage.max_degree,
                field_degree: stage.field_degree,
            };
            report.stages.push(descend(&group, *stage, &self.params, &mut at, &mut flows, &cancel)?);
        }
        report.moved = vec![moved(directions, &at[0])];
        let [flow] = flows;
        Ok((flow, report))
    }
}
