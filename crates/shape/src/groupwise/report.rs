//! Holds the report of a refinement: costs, steps and distortions of each stage.

use crate::groupwise::elastic::Elastic;
use crate::groupwise::params::StageParams;
use crate::groupwise::state::State;

/// Change of areas on the sphere under the refinement's maps of the sphere to itself, one map for each member.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distortion {
    /// Root mean square of the logarithm of the change of area, over the sphere's area and all members.
    pub rms: f64,
    /// Largest absolute value of the logarithm of a triangle's change of area, over all triangles of the sphere and all
    /// members.
    pub most: f64,
    /// Fraction of the sphere's triangles whose area the maps change by at most a factor of 8.
    pub within_eight: f64,
}

/// Report of one stage of a refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageReport {
    /// Settings of the stage, with the degree of models limited to the members' degree.
    pub stage: StageParams,
    /// Number of steps taken.
    pub steps: usize,
    /// Number of evaluations of the objective.
    pub evaluations: usize,
    /// Value of the objective before and after the stage. Values of different stages can't be compared.
    pub cost: [f64; 2],
    /// Variance of the group before and after the stage, in the square of the models' unit. It is the mean squared
    /// distance from the mean, over the surface's area, at the stage's degree. It covers all channels, including the
    /// weighted normals.
    pub variance: [f64; 2],
    /// Change of areas under the maps at the end of the stage.
    pub distortion: Distortion,
    /// Whether the stage ended because its last steps barely decreased the objective, and not because it reached its
    /// maximum number of steps.
    pub converged: bool,
}

/// Report of a refinement.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GroupwiseReport {
    /// Reports of the stages, in the order in which they ran.
    pub stages: Vec<StageReport>,
    /// Root mean square angle by which each member's directions were moved, in radians.
    pub moved: Vec<f64>,
}

impl Distortion {
    pub(super) fn of(state: &State, elastic: &Elastic<'_>) -> Self {
        let (mut squares, mut most, mut within, mut count) = (0.0, 0.0_f64, 0_usize, 0_usize);
        for at in &state.at {
            for (s, share) in elastic.logarithms(at).zip(elastic.shares()) {
                squares += share * s * s;
                most = most.max(s.abs());
                within += usize::from(s.abs() <= 8.0_f64.ln());
                count += 1;
            }
        }
        Self { rms: (squares / state.at.len() as f64).sqrt(), most, within_eight: within as f64 / count as f64 }
    }
}
