//! Settings of the measures, and the curve of a measure over the modes.

/// Settings of [`group_quality`](super::group_quality).
#[derive(Debug, Clone, PartialEq)]
pub struct QualityParams {
    /// Maximum number of modes, m; there are at most n - 1.
    pub modes: usize,
    /// Number of random shapes for the specificity.
    pub samples: usize,
    /// Number of bootstrap samples for the bands; 0 for none.
    pub bands: usize,
    /// Subdivisions of the icosphere; 4 give 2,562 directions.
    pub subdivisions: u32,
    /// Whether members are first aligned rigidly, weighted by area, at equal directions.
    pub rigid: bool,
    /// Whether distances between surfaces are measured too, which takes most of the time.
    pub surfaces: bool,
    /// Seed of the random shapes and of the bootstrap.
    pub seed: u64,
    /// Directions of the icosphere to compare, (V); all by default.
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

/// A measure as a function of the number of modes, k = 1 to m.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curve {
    /// The measure, (m).
    pub values: Vec<f64>,
    /// Lower end of the measure's 95 % band, (m), or empty.
    pub low: Vec<f64>,
    /// Upper end of the measure's 95 % band, (m), or empty.
    pub high: Vec<f64>,
}
