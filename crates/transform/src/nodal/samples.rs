//! Samples that are linear in values at nodes, as they are given.

/// Samples and the nodes that they are linear in.
#[derive(Debug, Clone, Copy)]
pub struct NodalSamples<'a> {
    /// Unit vectors, (n, 3).
    pub directions: &'a [[f64; 3]],
    /// Weights, (n), finite and at least 0.
    pub weights: &'a [f64],
    /// The nodes of each sample's triangle, (n, 3).
    pub nodes: &'a [[u32; 3]],
    /// What the value of each of these counts, (n, 3).
    pub shares: &'a [[f64; 3]],
}
