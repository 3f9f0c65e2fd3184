//! Settings of the experiments: size, memory and number of threads.

/// Size of the experiments.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    /// Subdivisions of the generated cortex.
    pub(crate) subdivisions: u32,
    /// Degree of the grid, and of the bases in the store.
    pub(crate) max_degree: usize,
    /// Figure 5: degrees of the SIRF fits.
    pub(crate) sirf: &'static [usize],
    /// Figures 6 and 7: values of g and the largest p.
    pub(crate) granularities: &'static [usize],
    pub(crate) passes: usize,
    /// Table 1: the degree above which NLSF is only planned, not run.
    pub(crate) nlsf: usize,
    /// Figure 3: degrees at the cortex's number of vertices, and icospheres at one degree.
    pub(crate) basis_degrees: &'static [usize],
    pub(crate) basis_degree: usize,
    pub(crate) basis_subdivisions: &'static [u32],
    /// Degrees at which least squares and quadrature are compared.
    pub(crate) families: &'static [usize],
}

/// The paper's size.
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

/// Seconds rather than minutes, to check that everything works.
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
    /// Whether to use a small surface and low degrees, to check within a few seconds that everything works.
    pub quick: bool,
    /// Memory limit of each build and each fit in bytes, including mapped files.
    pub memory: usize,
    /// Number of threads, at least 1.
    pub threads: usize,
}

impl Settings {
    /// Returns the size of the experiments.
    pub(crate) fn extent(&self) -> &'static Extent {
        if self.quick { &QUICK } else { &FULL }
    }
}
