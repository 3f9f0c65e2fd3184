//! Reads masks of directions from files of values, from labels, and from groups. A group masks the places that have no
//! counterpart on its members.

use std::path::Path;

use anyhow::Result;
use spharm::correspond::GroupFiles;
use spharm_surface::Sphere;
use spharm_surface::geometry::Vec3;
use spharm_surface::io::read_mask;

/// Returns for each direction of a sphere whether it is kept. A group is given by its folder or its `group.json`, and
/// can be used with any sphere.
pub(super) fn read(path: &Path, sphere: &Sphere) -> Result<Vec<bool>> {
    let directions: &[Vec3] = sphere.directions.as_slice();
    let of_group = path.file_name().is_some_and(|name| name == "group.json");
    if of_group || path.is_dir() {
        let folder = if of_group { path.parent().unwrap_or(Path::new("")) } else { path };
        return Ok(GroupFiles::open(folder)?.template()?.kept_at(directions));
    }
    Ok(read_mask(path, directions.len())?)
}
