//! Settings of a registration.

/// Settings of a stage of the drift: the kernel's width and stiffness, and the number of points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftStage {
    /// Standard deviation of the Gaussian kernel, as a fraction of the square root of the template's area.
    pub width: f64,
    /// Weight of the displacements' energy, lambda, with the square root of the template's area as the unit of lengths.
    pub stiffness: f64,
    /// Number of points that are spread over the template, and also over the subject. The number is limited to half the
    /// number of the template's vertices.
    pub points: usize,
}

/// Settings of a registration. The unit of lengths is the square root of the template's area.
#[derive(Debug, Clone, PartialEq)]
pub struct RegisterParams {
    /// Stages of the drift, the widest kernel first. An empty list suits surfaces that are already close.
    pub drift: Vec<DriftStage>,
    /// If the root mean square distance between template and subject, in both directions, is below this value, the
    /// drift is skipped and vertices are only projected onto the subject, because the drift would scatter points along
    /// surfaces that coincide. The drift isn't skipped if a distance reaches `reach` or landmarks are given.
    pub near: f64,
    /// Initial sigma of the drift. Sigma is the standard deviation of the Gaussians around the points of the template.
    pub sigma: f64,
    /// Weight of the normals in the drift's responsibilities, `exp(kappa (n_x . n_y - 1))`.
    pub kappa: f64,
    /// Fraction of outliers that the drift expects.
    pub outliers: f64,
    /// Maximum number of iterations of a stage of the drift.
    pub drift_rounds: usize,
    /// A stage of the drift ends when sigma changes by less than this fraction.
    pub drift_tolerance: f64,
    /// Weights of the thin plate's bending energy, one for each round of the closest-point iteration.
    pub stiffness: Vec<f64>,
    /// Total weight of the pairs that join points of the subject to the nearest points of the template. The pairs that
    /// join vertices of the template to the nearest points of the subject have the total weight 1.
    pub back: f64,
    /// Weight of distances within the surface, relative to distances along its normal.
    pub tangential: f64,
    /// Distance that is equivalent to a unit difference between normals in the search for nearest points.
    pub normal: f64,
    /// Distance beyond which the weight of a pair of points decreases markedly.
    pub robust: f64,
    /// Distance beyond which a vertex of the template has no counterpart on the subject, and a point of the subject
    /// isn't reached by the template.
    pub reach: f64,
    /// Weight of a landmark, relative to a single point during the drift, and to a single vertex afterwards.
    pub landmark: f64,
    /// Maximum number of rounds that move the vertices around turned-over triangles towards their neighbours.
    pub untangle_rounds: usize,
}

impl Default for RegisterParams {
    /// Returns the defaults. The widths and weights come from prototypes on vertebrae, hippocampi and cortices, and
    /// aren't tuned to a particular group.
    fn default() -> Self {
        let stage = |width, stiffness, points| DriftStage { width, stiffness, points };
        Self {
            drift: vec![stage(0.3, 5000.0, 3000), stage(0.15, 2500.0, 3000), stage(0.08, 1250.0, 3000)],
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
