//! Defines the settings of the experiments: the sizes of surfaces and fits, the memory limit, and the number of
//! threads.

/// Sizes of the surfaces and fits in the experiments.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    /// Number of subdivisions of the generated cortex.
    pub(crate) subdivisions: u32,
    /// Highest degree of the fits in figures 6 and 7, and of the bases in the store.
    pub(crate) max_degree: usize,
    /// Degrees of the SIRF fits in figure 5.
    pub(crate) sirf: &'static [usize],
    /// Granularities g in figures 6 and 7.
    pub(crate) granularities: &'static [usize],
    /// Largest number of passes p in figures 6 and 7.
    pub(crate) passes: usize,
    /// Highest degree at which NLSF is run for table 1. For higher degrees, only its memory is planned.
    pub(crate) nlsf: usize,
    /// Degrees of the bases in the first part of figure 3, which have as many directions as the cortex has vertices.
    pub(crate) basis_degrees: &'static [usize],
    /// Degree of the bases in the second part of figure 3.
    pub(crate) basis_degree: usize,
    /// Numbers of subdivisions of the icospheres in the second part of figure 3.
    pub(crate) basis_subdivisions: &'static [u32],
    /// Degrees at which least squares and quadrature are compared.
    pub(crate) families: &'static [usize],
}

/// Sizes as in the paper.
const FULL: Extent = Extent {
    subdivisions: 6,
    max_degree: 100,
    sirf: &[10, 20, 60, 100],
    granularities: &[1, 100, 200, 400],
    passes: 8,
    nlsf: 60,
    basis_degrees: &[10, 20, 40, 60, 80, 100],
    basis_degree: 60,
    basis_subdivisions: &[4, 5, 6],
    families: &[20, 40, 60, 80, 100, 150, 200],
};

/// Small sizes for a quick check that the experiments work. They take seconds instead of minutes.
const QUICK: Extent = Extent {
    subdivisions: 4,
    max_degree: 20,
    sirf: &[5, 10, 20],
    granularities: &[1, 50, 100, 200],
    passes: 8,
    nlsf: 10,
    basis_degrees: &[5, 10, 20],
    basis_degree: 10,
    basis_subdivisions: &[2, 3, 4],
    families: &[5, 10, 20],
};

/// Settings of the experiments.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Whether to use small surfaces and low degrees, to check within seconds that the experiments work.
    pub quick: bool,
    /// Memory limit of each build and of each fit in bytes, including mapped files.
    pub memory: usize,
    /// Number of threads, at least 1.
    pub threads: usize,
}

impl Settings {
    /// Returns the sizes of the surfaces and fits.
    pub(crate) fn extent(&self) -> &'static Extent {
        if self.quick { &QUICK } else { &FULL }
    }
}
