//! Limits of the number of voxels of a wrap.

/// Numbers of voxels that [`wrap`](super::wrap()) accepts, along the longest side of a mesh.
pub const VOXELS: std::ops::RangeInclusive<usize> = 16..=512;
/// Suitable number of voxels for most meshes, along the longest side of the mesh.
pub const USUAL_VOXELS: usize = 128;
