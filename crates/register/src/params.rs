//! The settings of a registration.

/// The width of a kernel of the drift, and how stiff it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftStage {
    /// Standard deviation of the Gaussian kernel, as a share of the square root of the template's area.
    pub width: f64,
    /// Weight of the displacements' energy, lambda.
    pub stiffness: f64,
    /// Points on the template, and on the subject: at most half as many as the template has vertices.
    pub points: usize,
}

/// Settings of a registration. Lengths are shares of the square root of the template's area, which is the unit below.
#[derive(Debug, Clone, PartialEq)]
pub struct RegisterParams {
    /// Stages of the drift, the widest kernel first. None for surfaces that lie together.
    pub drift: Vec<DriftStage>,
    /// Root mean square distance of the surfaces, both ways, below which vertices are only projected, if none is
    /// farther than `reach`: the drift would scatter places along surfaces that coincide.
    pub near: f64,
    /// Standard deviation of the distances at which the drift starts.
    pub sigma: f64,
    /// Weight of the normals in the drift's responsibilities, `exp(kappa (n_x . n_y - 1))`.
    pub kappa: f64,
    /// Share of outliers that the drift expects.
    pub outliers: f64,
    /// Most iterations of a stage of the drift.
    pub drift_rounds: usize,
    /// Change of sigma, as a share of it, below which a stage of the drift ends.
    pub drift_tolerance: f64,
    /// Weights of the thin plate, one a round of nearest points.
    pub stiffness: Vec<f64>,
    /// Weight of the subject's points that pull the template, beside 1 of the template's own.
    pub back: f64,
    /// Weight of distances along the surface beside those across it.
    pub tangential: f64,
    /// Length by which a difference of unit normals counts in a search for nearest points.
    pub normal: f64,
    /// Distance from which pairs of points lose weight.
    pub robust: f64,
    /// Distance from which a vertex of the template has no counterpart on the subject, and a place of the subject isn't
    /// reached by the template.
    pub reach: f64,
    /// Weight of a landmark that guides, beside one of the points in the drift and one of the vertices after it.
    pub landmark: f64,
    /// Most rounds in which vertices around turned triangles are evened.
    pub untangle_rounds: usize,
}

impl Default for RegisterParams {
    /// Widths and weights are those of prototypes on vertebrae, hippocampi and cortices; nothing is tuned to one group.
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
