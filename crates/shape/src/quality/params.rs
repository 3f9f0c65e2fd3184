//! Settings of the quality measures, and the curve of a measure over the modes.

/// Settings of [`group_quality`](super::group_quality).
#[derive(Debug, Clone, PartialEq)]
pub struct QualityParams {
    /// Maximum number of modes, m. A group of n members has at most n - 1 modes.
    pub modes: usize,
    /// Number of random shapes for the specificity.
    pub samples: usize,
    /// Number of bootstrap draws for the bands; 0 for no bands.
    pub bands: usize,
    /// Number of subdivisions of the icosphere; 4 subdivisions give 2,562 directions.
    pub subdivisions: u32,
    /// Whether members are first aligned by rigid motions that minimise the area-weighted distances between points at
    /// equal directions.
    pub rigid: bool,
    /// Whether distances between surfaces are also measured, which takes most of the time.
    pub surfaces: bool,
    /// Seed of the random shapes and of the bootstrap.
    pub seed: u64,
    /// Mask (V) of the directions of the icosphere to compare; all directions by default.
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
    /// Values of the measure for k = 1 to m.
    pub values: Vec<f64>,
    /// Lower ends of the measure's 95 % band for k = 1 to m; empty if there is no band.
    pub low: Vec<f64>,
    /// Upper ends of the measure's 95 % band for k = 1 to m; empty if there is no band.
    pub high: Vec<f64>,
}
