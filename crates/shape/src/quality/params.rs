//! Settings of the measures, and a measure over the modes.

/// Settings of [`group_quality`](super::group_quality).
#[derive(Debug, Clone, PartialEq)]
pub struct QualityParams {
    /// Most modes, m; at most n - 1 are there.
    pub modes: usize,
    /// Random shapes for the specificity.
    pub samples: usize,
    /// Bootstrap samples for the bands; 0 for none.
    pub bands: usize,
    /// Subdivisions of the icosphere; 4 are 2,562 directions.
    pub subdivisions: u32,
    /// Whether members are brought rigidly together first, by area, at equal directions.
    pub rigid: bool,
    /// Whether distances between surfaces are measured, too, which takes most of the time.
    pub surfaces: bool,
    /// Of random shapes and of the bootstrap.
    pub seed: u64,
    /// Directions of the icosphere that are compared, (V); all by default.
    pub mask: Option<Vec<bool>>,
}

impl Default for QualityParams {
    fn default() -> Self {
        Self {
            modes: 10,
            samples: 1000,
            bands: 200,
            subdivisions: 4,
            rigid: false,
            surfaces: true,
            seed: 0,
            mask: None,
        }
    }
}

/// A measure of the first k modes, k = 1 to m.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curve {
    /// The measure, (m).
    pub values: Vec<f64>,
    /// Lower end of its 95 % band, (m), or empty.
    pub low: Vec<f64>,
    /// Upper end, (m), or empty.
    pub high: Vec<f64>,
}
