//! Settings of a registration.

/// Settings of a stage of the drift: the kernel's width and stiffness, and the number of points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftStage {
    /// Standard deviation of the Gaussian kernel, as a share of the square root of the template's area.
    pub width: f64,
    /// Weight of the displacements' energy, lambda.
    pub stiffness: f64,
    /// Number of points on the template and number of points on the subject, each at most half the number of the
    /// template's vertices.
    pub points: usize,
}

/// Settings of a registration. The unit of lengths is the square root of the template's area.
#[derive(Debug, Clone, PartialEq)]
pub struct RegisterParams {
    /// Stages of the drift, the widest kernel first. Empty for surfaces that are already close.
    pub drift: Vec<DriftStage>,
    /// Root mean square distance between template and subject, in both directions, below which vertices are only
    /// projected, provided that no distance exceeds `reach`. The drift is skipped then, because it would scatter points
    /// along surfaces that coincide.
    pub near: f64,
    /// Standard deviation of the distances at the start of the drift.
    pub sigma: f64,
    /// Weight of the normals in the drift's responsibilities, `exp(kappa (n_x . n_y - 1))`.
    pub kappa: f64,
    /// Share of outliers that the drift expects.
    pub outliers: f64,
    /// Maximum number of iterations of a stage of the drift.
    pub drift_rounds: usize,
    /// Relative change of sigma below which a stage of the drift ends.
    pub drift_tolerance: f64,
    /// Weights of the thin plate's bending energy, one for each round of the closest-point iteration.
    pub stiffness: Vec<f64>,
    /// Weight of the subject's points that pull the template, relative to weight 1 of the template's own points.
    pub back: f64,
    /// Weight of distances along the surface, relative to distances across it.
    pub tangential: f64,
    /// Length that corresponds to a unit difference of normals in a search for nearest points.
    pub normal: f64,
    /// Distance from which the weight of a pair of points decreases.
    pub robust: f64,
    /// Distance beyond which a vertex of the template has no counterpart on the subject, and a point of the subject
    /// isn't reached by the template.
    pub reach: f64,
    /// Weight of a guiding landmark, relative to a single point in the drift, and relative to a single vertex after the
    /// drift.
    pub landmark: f64,
    /// Maximum number of rounds that move vertices around turned triangles towards their neighbours.
    pub untangle_rounds: usize,
}

impl Default for RegisterParams {
    /// The widths and weights come from prototypes on vertebrae, hippocampi and cortices; none is tuned to one group.
    fn default() -> Self {
        let stage = |width, stiffness, points| DriftStage { width, stiffness, points };
        Self {
            drift: vec![stage(0.3, 2.0, 3000), stage(0.15, 1.0, 3000), stage(0.08, 0.5, 3000)],
            near: 0.005,
            sigma: 0.06,
            kappa: 2.0,
            outliers: 0.01,
            drift_rounds: 60,
            drift_tolerance: 1e-3,
            stiffness: vec![10.0, 3.0, 1.0, 0.3, 0.1, 0.03],
            back: 0.5,
            tangential: 0.05,
            normal: 0.06,
            robust: 0.05,
            reach: 0.03,
            landmark: 10.0,
            untangle_rounds: 30,
        }
    }
}
