//! Masks of directions: files of values, labels, and groups, whose places without a counterpart are left out.

use std::path::Path;

use anyhow::Result;
use spharm::correspond::GroupFiles;
use spharm_surface::Sphere;
use spharm_surface::geometry::Vec3;
use spharm_surface::io::read_mask;

/// Reads the directions of a sphere that are kept, (n); of a group, named by its `group.json`, on whatever sphere.
pub(super) fn read(path: &Path, sphere: &Sphere) -> Result<Vec<bool>> {
    let directions: &[Vec3] = sphere.directions.as_slice();
    if path.file_name().is_some_and(|name| name == "group.json") {
        let folder = path.parent().unwrap_or(Path::new(""));
        return Ok(GroupFiles::open(folder)?.template()?.kept_at(directions));
    }
    Ok(read_mask(path, directions.len())?)
}
