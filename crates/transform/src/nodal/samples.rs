//! Input samples that are linear in values at nodes.

/// Samples whose values are weighted sums of the values at three nodes each.
#[derive(Debug, Clone, Copy)]
pub struct NodalSamples<'a> {
    /// Unit vectors (n, 3).
    pub directions: &'a [[f64; 3]],
    /// Weights (n), finite and at least 0.
    pub weights: &'a [f64],
    /// Indices (n, 3) of the three nodes of each sample.
    pub nodes: &'a [[u32; 3]],
    /// Weights (n, 3) of the three nodes of each sample. The sample's value is the sum of the nodes' values multiplied
    /// by these weights.
    pub shares: &'a [[f64; 3]],
}
