//! Limits on the number of voxels along the longest side of a wrap.

/// Range of the number of voxels along the longest side of a mesh that [`wrap`](super::wrap()) accepts.
pub const VOXELS: std::ops::RangeInclusive<usize> = 16..=512;
/// Number of voxels along the longest side of a mesh that suits most meshes.
pub const USUAL_VOXELS: usize = 128;
