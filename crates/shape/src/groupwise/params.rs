//! Settings of the groupwise refinement and of its stages.

use spharm_surface::Place;

use crate::error::ShapeError;

/// Settings of a stage: the degree of the models, the degree of the fields along which directions are moved, and the
/// number of steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageParams {
    /// Degree to which models are truncated, at least 1; models of lower degree are unchanged.
    pub max_degree: usize,
    /// Degree D of the harmonic potentials of the tangent fields along which directions are moved, at least 1.
    pub field_degree: usize,
    /// Maximum number of steps.
    pub rounds: usize,
}

impl StageParams {
    /// Returns the stages for models of degree `max_degree`. There are at most four stages. Models are truncated to
    /// degrees 6, 12 and 20 in the first three stages, whose fields have degrees 5, 10 and 14. In the fourth stage,
    /// models have their full degree, and fields have degree 18. The first stage that reaches about 4/5 of the models'
    /// degree is the last one, and uses their full degree.
    #[must_use]
    pub fn up_to(max_degree: usize) -> Vec<Self> {
        let mut stages = Vec::new();
        for (degree, field_degree, rounds) in [(6, 5, 40), (12, 10, 60), (20, 14, 60), (usize::MAX, 18, 60)] {
            // The first stage that reaches about 4/5 of the models' degree is the last one.
            stages.push(Self { max_degree: degree.min(max_degree), field_degree, rounds });
            if max_degree <= degree.saturating_add(degree / 4) {
                break;
            }
        }
        if let Some(last) = stages.last_mut() {
            last.max_degree = max_degree;
        }
        stages
    }
}

/// Settings of [`groupwise`](crate::groupwise::groupwise()).
#[derive(Debug, Clone, PartialEq)]
pub struct GroupwiseParams {
    /// Stages, from coarse to fine. By default the stages that [`StageParams::up_to`] returns for the members' degree.
    pub stages: Option<Vec<StageParams>>,
    /// Constant that is added to the variances before taking their logarithms, as a fraction of the sum of variances at
    /// the start of a stage; above 0. A small value gives weight to small modes, which are mostly noise. With a large
    /// value, small modes have no effect. The default is 0.03. For shapes with a moving bump, the first mode has 0.91
    /// of the variance with a delta of 0.03, and 0.78 with a delta of 0.1. For vertebrae, corresponding landmarks are
    /// equally close to each other with both values.
    pub delta: f64,
    /// Weight mu of the elastic energy, at least 0; by default 0.4.
    pub elasticity: f64,
    /// Weight of the unit normals as channels, as a fraction of the square root of the members' mean area; 0 omits the
    /// normals. Without normals, points slide along the surface to regions in which members agree. The default is 0.12.
    /// Both smaller and larger values increased the distances between points that should correspond, in groups of known
    /// correspondence and for landmarks of vertebrae.
    pub normals: f64,
    /// Points of the sphere to hold fixed, such as landmarks; none by default.
    pub held: Vec<Place>,
    /// Weight of the squared distances, in radians, between fixed points and their images. 1,000 by default: with this
    /// weight, a distance of 0.1 rad adds 10 to the objective.
    pub hold: f64,
    /// Whether members are aligned rigidly to the mean in every step. Intended for groups that aren't aligned yet. Off
    /// by default.
    pub together: bool,
    /// Minimum decrease of the objective per member and step. A stage ends after three consecutive steps with smaller
    /// decreases. The default is 1e-4.
    pub tolerance: f64,
}

impl Default for GroupwiseParams {
    fn default() -> Self {
        Self {
            stages: None,
            delta: 0.03,
            elasticity: 0.4,
            normals: 0.12,
            held: Vec::new(),
            hold: 1e3,
            together: false,
            tolerance: 1e-4,
        }
    }
}

impl GroupwiseParams {
    pub(super) fn check(&self) -> Result<(), ShapeError> {
        let numbers = [
            ("delta", self.delta, f64::MIN_POSITIVE),
            ("the weight of the elastic energy", self.elasticity, 0.0),
            ("the weight of the normals", self.normals, 0.0),
            ("the weight of fixed points", self.hold, 0.0),
            ("the tolerance", self.tolerance, 0.0),
        ];
        for (name, value, least) in numbers {
            if !(value >= least && value.is_finite()) {
                let expected =
                    if least > 0.0 { "it must be finite and above 0" } else { "it must be finite and at least 0" };
                return Err(ShapeError::Setting { name, found: value.to_string(), expected });
            }
        }
        for stage in self.stages.iter().flatten() {
            if stage.max_degree == 0 || stage.field_degree == 0 {
                let name = "the degree of a stage";
                return Err(ShapeError::Setting { name, found: "0".to_owned(), expected: "it must be at least 1" });
            }
        }
        Ok(())
    }
}
