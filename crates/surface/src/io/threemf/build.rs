//! Places the objects listed in a model's build section, and the objects that they contain.

use std::collections::HashMap;

use super::super::flaw::Flaw;
use super::super::placement::Placement;
use super::model::{Model, Placed, parse};
use super::package::Package;
use crate::mesh::Mesh;

/// Largest depth to which objects may be nested.
const DEEPEST: usize = 32;
/// Number of bytes that the budget is charged for a placed object, in addition to its vertices and triangles. It limits
/// the time spent on objects that contain other objects many times over.
const OBJECT: u64 = 64;

/// The archive, and its parts that have been parsed so far, by their paths.
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

/// An object that is still to be placed: the path of its part, its number, its placement, and its nesting depth.
struct Open {
    path: String,
    object: u32,
    placement: Placement,
    depth: usize,
}

impl Open {
    /// Returns the object that `placed`, an item or a component, refers to. `path` is the path of the part that
    /// contains `placed`.
    fn of(placed: &Placed, path: &str, outer: &Placement, depth: usize) -> Self {
        let path = placed.path.as_deref().unwrap_or(path).trim_start_matches('/').to_owned();
        Self { path, object: placed.object, placement: outer.after(&placed.placement), depth }
    }
}

/// Reads all objects of the build, in the order of its items. If the build has no items, all meshes of the model are
/// read.
pub(super) fn read(mut package: Package<'_>) -> Result<Mesh, Flaw> {
    let root = package.model_path()?.trim_start_matches('/').to_owned();
    let mut parts = Parts { package, models: HashMap::new() };
    parts.load(&root)?;
    // The next object to be placed is at the end.
    let mut open: Vec<Open> =
        items(&parts, &root).iter().rev().map(|item| Open::of(item, &root, &Placement::IDENTITY, 0)).collect();
    let mut mesh = Mesh::default();
    while let Some(next) = open.pop() {
        parts.load(&next.path)?;
        let object = parts.models.get(&next.path).and_then(|model| model.objects.get(&next.object));
        let object = object.ok_or_else(|| Flaw::new(format!("object {} in {}", next.object, next.path), "none"))?;
        if next.depth > DEEPEST {
            return Err(Flaw::new(
                format!("objects nested at most {DEEPEST} deep"),
                "deeper nesting, or an object inside itself",
            ));
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

/// Returns the items of a part's build. If the build has no items, returns an item for each mesh of the part.
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

/// Adds a copy of an object's mesh, moved by `placement`.
fn add(part: &Mesh, placement: &Placement, mesh: &mut Mesh) -> Result<(), Flaw> {
    let (vertices, faces) = (mesh.vertices.len(), mesh.faces.len());
    if u32::try_from(vertices + part.vertices.len()).is_err() {
        return Err(Flaw::new("fewer than 2^32 vertices", "more"));
    }
    mesh.vertices.extend_from_slice(&part.vertices);
    // The sums can't overflow, because an object's vertex indices are below its number of vertices.
    mesh.faces.extend(part.faces.iter().map(|face| face.map(|corner| corner + vertices as u32)));
    placement
        .place(mesh.vertices.get_mut(vertices..).unwrap_or_default(), mesh.faces.get_mut(faces..).unwrap_or_default());
    Ok(())
}
