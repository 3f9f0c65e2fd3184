//! Input samples that are linear in values at nodes.

/// Samples whose values are weighted sums of the values at three nodes each.
#[derive(Debug, Clone, Copy)]
pub struct NodalSamples<'a> {
    /// Unit vectors, (n, 3).
    pub directions: &'a [[f64; 3]],
    /// Weights, (n), finite and at least 0.
    pub weights: &'a [f64],
    /// The nodes of each sample's triangle, (n, 3).
    pub nodes: &'a [[u32; 3]],
    /// Weights of the values at the three nodes in the sample's value, (n, 3).
    pub shares: &'a [[f64; 3]],
}
