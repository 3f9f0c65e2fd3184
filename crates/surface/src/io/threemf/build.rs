//! Places the objects of a build, and the objects in them.

use std::collections::HashMap;

use super::super::flaw::Flaw;
use super::super::placement::Placement;
use super::model::{Model, Placed, parse};
use super::package::Package;
use crate::mesh::Mesh;

/// Largest depth of objects in objects.
const DEEPEST: usize = 32;
/// Number of bytes that a placed object costs in addition to its vertices and triangles. It bounds the time for objects
/// that contain others many times over.
const OBJECT: u64 = 64;

/// The parts that have been parsed, by their paths.
struct Parts<'a> {
    package: Package<'a>,
    models: HashMap<String, Model>,
}

impl Parts<'_> {
    /// Parses a part, unless it has been parsed before.
    fn load(&mut self, path: &str) -> Result<(), Flaw> {
        if !self.models.contains_key(path) {
            let model = parse(&self.package.part(path)?)?;
            self.models.insert(path.to_owned(), model);
        }
        Ok(())
    }
}

/// An object that is still to be placed: its path and number, its placement, and its depth in other objects.
struct Open {
    path: String,
    object: u32,
    placement: Placement,
    depth: usize,
}

impl Open {
    /// Returns an object that another places, whose part has the path `path`.
    fn of(placed: &Placed, path: &str, outer: &Placement, depth: usize) -> Self {
        let path = placed.path.as_deref().unwrap_or(path).trim_start_matches('/').to_owned();
        Self { path, object: placed.object, placement: outer.after(&placed.placement), depth }
    }
}

/// Reads all objects of the build, in the order of its items. A model without items is read as if its meshes were in
/// its build.
pub(super) fn read(mut package: Package<'_>) -> Result<Mesh, Flaw> {
    let root = package.model_path()?.trim_start_matches('/').to_owned();
    let mut parts = Parts { package, models: HashMap::new() };
    parts.load(&root)?;
    // The next object is the last.
    let mut open: Vec<Open> =
        items(&parts, &root).iter().rev().map(|item| Open::of(item, &root, &Placement::IDENTITY, 0)).collect();
    let mut mesh = Mesh::default();
    while let Some(next) = open.pop() {
        parts.load(&next.path)?;
        let object = parts.models.get(&next.path).and_then(|model| model.objects.get(&next.object));
        let object = object.ok_or_else(|| Flaw::new(format!("object {} in {}", next.object, next.path), "none"))?;
        if next.depth > DEEPEST {
            return Err(Flaw::new(format!("objects at most {DEEPEST} deep"), "deeper ones, or one in itself"));
        }
        if object.is_support {
            continue;
        }
        let (vertices, faces) = (object.mesh.vertices.len(), object.mesh.faces.len());
        parts.package.budget.spend(vertices as u64 * 24 + faces as u64 * 12 + OBJECT, "objects of")?;
        add(&object.mesh, &next.placement, &mut mesh)?;
        open.extend(
            object.components.iter().rev().map(|placed| Open::of(placed, &next.path, &next.placement, next.depth + 1)),
        );
    }
    Ok(mesh)
}

/// Returns the items of a part's build, or one for each of its meshes if there are none.
fn items(parts: &Parts<'_>, path: &str) -> Vec<Placed> {
    let Some(model) = parts.models.get(path) else { return Vec::new() };
    if !model.items.is_empty() {
        return model.items.clone();
    }
    let meshes = model
        .order
        .iter()
        .filter(|object| model.objects.get(object).is_some_and(|object| !object.mesh.faces.is_empty()));
    meshes.map(|&object| Placed { path: None, object, placement: Placement::IDENTITY }).collect()
}

/// Adds a copy of an object's mesh at its place.
fn add(part: &Mesh, placement: &Placement, mesh: &mut Mesh) -> Result<(), Flaw> {
    let (vertices, faces) = (mesh.vertices.len(), mesh.faces.len());
    if u32::try_from(vertices + part.vertices.len()).is_err() {
        return Err(Flaw::new("fewer than 2^32 vertices", "more"));
    }
    mesh.vertices.extend_from_slice(&part.vertices);
    // The sums can't overflow: an object's corners are below the number of its vertices.
    mesh.faces.extend(part.faces.iter().map(|face| face.map(|corner| corner + vertices as u32)));
    placement
        .place(mesh.vertices.get_mut(vertices..).unwrap_or_default(), mesh.faces.get_mut(faces..).unwrap_or_default());
    Ok(())
}
