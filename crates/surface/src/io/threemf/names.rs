//! Defines names that occur in 3MF archives.

/// Usual path of the model in an archive.
pub(super) const MODEL: &str = "3D/3dmodel.model";
/// Path of the archive's relationships.
pub(super) const RELATIONSHIPS: &str = "_rels/.rels";
/// Type of the relationship that names the model.
pub(super) const MODEL_TYPE: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";
