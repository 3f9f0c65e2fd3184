//! Evaluates a group whose members are mapped by given maps: values, cost, and gradient with respect to tangent fields.
//!
//! ```text
//! C(phi) = log det(G + delta 1) + sum_i (mu E(phi_i) + H(phi_i))
//! ```
//!
//! phi_i is the map of member i, and G and delta are defined in [`objective`](super::objective). E is the elastic
//! energy ([`elastic`](super::elastic)) with the weight mu, and H is the energy of the fixed points
//! ([`held`](super::held)). If members are aligned in every step, each member is moved rigidly to the mean before G is
//! computed, and the member's gradient is rotated back afterwards.
//!
//! Members are evaluated in parallel. For each member, an evaluation creates a plan of the transform at the member's
//! directions, and drops it afterwards.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;
use spharm_surface::geometry::Vec3;

use crate::error::ShapeError;
use crate::groupwise::elastic::Elastic;
use crate::groupwise::field::{adjoint, field};
use crate::groupwise::held::Held;
use crate::groupwise::member::{Member, Plan};
use crate::groupwise::objective::{Covariance, Objective};
use crate::groupwise::reference::Reference;
use crate::groupwise::together::{Turns, bring_together, turn_channels};
use crate::matrix3::transposed;

/// A group's members and the settings of one stage.
pub(super) struct Group<'a> {
    pub(super) members: Vec<Member>,
    pub(super) channels: usize,
    pub(super) objective: Objective<'a>,
    /// A finished group with which a single member is compared, if any.
    pub(super) reference: Option<&'a Reference>,
    pub(super) elastic: Elastic<'a>,
    /// Weight of the elastic energy, mu.
    pub(super) elasticity: f64,
    pub(super) held: Held,
    /// First channel of each triple of channels that rotates with the surface, such as the position; `None` unless
    /// members are aligned rigidly in every step.
    pub(super) turning: Option<Vec<usize>>,
    pub(super) max_degree: usize,
    pub(super) field_degree: usize,
}

/// State of a descent: the mapped directions of every member, and the cost.
pub(super) struct State {
    pub(super) at: Vec<Vec<Vec3>>,
    pub(super) cost: f64,
    measured: Measured,
    turns: Turns,
}

/// Intermediate results from which the gradient is computed.
enum Measured {
    /// Results for all members of a group: the covariance G, and the inverse of `G + delta I` for a constant delta.
    Group(Box<Covariance>, Array2<f64>),
    /// Results for a single member: the derivatives of the cost with respect to the member's values, and the variance
    /// of these values.
    Member(Vec<f64>, f64),
}

impl Group<'_> {
    /// Evaluates all members at the directions `at`. Returns `None` if a triangle is inverted. `delta` computes the
    /// constant delta from the covariance.
    pub(super) fn state(
        &self,
        at: Vec<Vec<Vec3>>,
        delta: impl FnOnce(&Covariance) -> f64,
        turns: &Turns,
    ) -> Result<Option<State>, ShapeError> {
        let energies: Vec<f64> = at.par_iter().map(|at| self.elastic.energy(at)).collect();
        if energies.iter().any(|energy| !energy.is_finite()) {
            return Ok(None);
        }
        let held: f64 = at.iter().map(|at| self.held.energy(at)).sum();
        let energy = self.elasticity * energies.iter().sum::<f64>() + held;
        let mut values = Array2::zeros((at.len(), self.objective.mask.len() * self.channels));
        let rows = values.axis_iter_mut(Axis(0)).into_par_iter().zip(&self.members).zip(&at);
        rows.try_for_each(|((mut row, member), at)| {
            let plan = Plan::new(at, self.max_degree, self.field_degree)?;
            let found = member.values(&plan)?;
            row.iter_mut().zip(found.iter()).for_each(|(out, value)| *out = *value);
            Ok::<_, ShapeError>(())
        })?;
        let turns = match &self.turning {
            Some(turning) => bring_together(&mut values, turning, &self.objective, turns),
            None => turns.clone(),
        };
        let (length, measured) = match self.reference {
            Some(reference) => {
                let (cost, slopes, variance) = reference.cost(values.as_slice().unwrap_or_default());
                (cost, Measured::Member(slopes, variance))
            }
            None => {
                let covariance = self.objective.covariance(values)?;
                let (length, inverse) = covariance.description_length(delta(&covariance))?;
                (length, Measured::Group(Box::new(covariance), inverse))
            }
        };
        let cost = length + energy;
        Ok(cost.is_finite().then_some(State { at, cost, measured, turns }))
    }

    /// Returns the derivatives of the cost C with respect to the potentials of tangent fields, which move the members'
    /// mapped directions further. The result concatenates one array (K, 2) of derivatives per member.
    pub(super) fn gradient(&self, state: &State) -> Result<Vec<f64>, ShapeError> {
        let mut covectors = match &state.measured {
            Measured::Group(covariance, inverse) => self.objective.covectors(covariance, inverse),
            Measured::Member(slopes, _) => {
                ArrayView2::from_shape((1, slopes.len()), slopes).map_err(|_| ShapeError::NoDecomposition)?.to_owned()
            }
        };
        let rows = covectors.axis_iter_mut(Axis(0)).into_par_iter().zip(&self.members).zip(&state.at).enumerate();
        let found: Result<Vec<Vec<f64>>, ShapeError> = rows
            .map(|(i, ((mut row, member), at))| {
                let plan = Plan::new(at, self.max_degree, self.field_degree)?;
                let row = row.as_slice_mut().unwrap_or_default();
                if let (Some(turning), Some(turn)) = (&self.turning, state.turns.get(i)) {
                    turn_channels(row, self.channels, turning, &transposed(turn));
                }
                let mut pulled = member.contract(row, at, &plan)?;
                self.elastic.add_gradient(at, self.elasticity, &mut pulled);
                self.held.add_gradient(at, &mut pulled);
                let mut gradient = adjoint(&pulled, at, &plan.field)?;
                gradient.row_mut(0).fill(0.0);
                Ok(gradient.into_raw_vec_and_offset().0)
            })
            .collect();
        Ok(found?.concat())
    }

    /// Returns the tangent field of each member's potentials (K, 2) at the member's directions.
    pub(super) fn fields(&self, state: &State, potentials: &[Array2<f64>]) -> Result<Vec<Vec<Vec3>>, ShapeError> {
        let pairs = state.at.par_iter().zip(potentials);
        pairs
            .map(|(at, potentials)| {
                let plan = Plan::new(at, self.field_degree, self.field_degree)?;
                field(potentials, at, &plan.field)
            })
            .collect()
    }
}

impl State {
    /// Returns the variance of the group. If a single member is compared with a finished group, returns the member's
    /// variance about the group's mean.
    pub(super) fn variance(&self) -> f64 {
        match &self.measured {
            Measured::Group(covariance, _) => covariance.total(),
            Measured::Member(_, variance) => *variance,
        }
    }

    /// Returns the rotation by which each member was aligned.
    pub(super) fn turns(&self) -> &Turns {
        &self.turns
    }
}
