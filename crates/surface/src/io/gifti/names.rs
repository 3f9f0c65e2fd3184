//! Words of the standard that are read or written.

/// The intent of positions.
pub(super) const POINTSET: &str = "NIFTI_INTENT_POINTSET";
/// The intent of triangles.
pub(super) const TRIANGLE: &str = "NIFTI_INTENT_TRIANGLE";
/// The intent of values that describe the surface's shape, such as thickness.
pub(super) const SHAPE: &str = "NIFTI_INTENT_SHAPE";
/// The intent of any other values.
pub(super) const NONE: &str = "NIFTI_INTENT_NONE";
/// Name of the metadata entry for a surface's anatomical structure.
pub(super) const STRUCTURE: &str = "AnatomicalStructurePrimary";
/// An unknown coordinate system.
pub(super) const UNKNOWN_SPACE: &str = "NIFTI_XFORM_UNKNOWN";
