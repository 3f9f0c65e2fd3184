//! Names defined by the GIfTI standard.

/// Intent of an array of positions.
pub(super) const POINTSET: &str = "NIFTI_INTENT_POINTSET";
/// Intent of an array of triangles.
pub(super) const TRIANGLE: &str = "NIFTI_INTENT_TRIANGLE";
/// Intent of an array of values that describe the surface's shape, such as thickness.
pub(super) const SHAPE: &str = "NIFTI_INTENT_SHAPE";
/// Intent of an array of values that don't describe the shape.
pub(super) const NONE: &str = "NIFTI_INTENT_NONE";
/// Name of the metadata entry with the surface's anatomical structure.
pub(super) const STRUCTURE: &str = "AnatomicalStructurePrimary";
/// Name used for an unknown coordinate system.
pub(super) const UNKNOWN_SPACE: &str = "NIFTI_XFORM_UNKNOWN";
