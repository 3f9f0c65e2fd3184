//! Parses a model part: its objects, and the items of its build.

use std::collections::HashMap;

use super::super::flaw::{Flaw, shown};
use super::super::placement::Placement;
use super::super::text::{number, words};
use super::super::xml::{Step, Tag, local, walk};
use crate::mesh::Mesh;

/// The contents of a part.
#[derive(Debug, Default)]
pub(super) struct Model {
    pub(super) objects: HashMap<u32, Object>,
    /// Numbers of the objects, in the order in which the file defines them.
    pub(super) order: Vec<u32>,
    pub(super) items: Vec<Placed>,
}

/// An object: a mesh, or components.
#[derive(Debug, Default)]
pub(super) struct Object {
    pub(super) mesh: Mesh,
    pub(super) components: Vec<Placed>,
    /// Whether the object supports other objects during printing.
    pub(super) is_support: bool,
}

/// A reference to an object, with its placement, in an item of the build or in a component.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    /// Path of the archive's part that contains the object; `None` if the part with this reference contains it.
    pub(super) path: Option<String>,
    pub(super) object: u32,
    pub(super) placement: Placement,
}

/// Parts of the names of the extensions that this reader supports or can ignore.
const KNOWN: [&str; 3] = ["/production/", "/material/", "/trianglesets/"];

#[derive(Default)]
struct State {
    model: Model,
    object: Option<(u32, Object)>,
    /// Whether a mesh element is open. Vertices outside of mesh elements, such as the two-dimensional vertices of
    /// slices, are skipped.
    in_mesh: bool,
    root: bool,
}

/// Parses the text of a part.
pub(super) fn parse(text: &str) -> Result<Model, Flaw> {
    let mut state = State::default();
    walk(text, true, |step| match step {
        Step::Start(tag) => state.start(tag),
        Step::End(name) => {
            state.end(name);
            Ok(())
        }
        Step::Text(_) => Ok(()),
    })?;
    Ok(state.model)
}

impl State {
    fn start(&mut self, tag: &Tag<'_>) -> Result<(), Flaw> {
        if !self.root {
            self.root = true;
            return check_root(tag);
        }
        match (tag.name(), &mut self.object) {
            ("object", _) => {
                let kind = tag.attribute("type")?;
                let is_support = matches!(kind.as_deref(), Some("support" | "solidsupport"));
                self.object = Some((required(tag, "id")?, Object { is_support, ..Object::default() }));
            }
            ("mesh", _) => self.in_mesh = true,
            ("vertex", Some((_, object))) if self.in_mesh => object.mesh.vertices.push(vertex(tag)?),
            ("triangle", Some((_, object))) if self.in_mesh => {
                object.mesh.faces.push(triangle(tag, object.mesh.vertices.len())?);
            }
            ("component", Some((_, object))) => object.components.push(placed(tag)?),
            ("item", None) => self.model.items.push(placed(tag)?),
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self, name: &str) {
        match name {
            "mesh" => self.in_mesh = false,
            "object" => {
                if let Some((number, object)) = self.object.take() {
                    self.model.order.push(number);
                    self.model.objects.insert(number, object);
                }
            }
            _ => {}
        }
    }
}

/// Checks that a part is a model whose required extensions are known.
fn check_root(tag: &Tag<'_>) -> Result<(), Flaw> {
    if tag.name() != "model" {
        return Err(Flaw::new("a model element", shown(tag.name().as_bytes())));
    }
    let (mut needed, mut spaces) = (String::new(), Vec::new());
    tag.attributes(|name, value| {
        match name {
            "requiredextensions" => needed = value.into_owned(),
            _ => spaces.extend(name.strip_prefix("xmlns:").map(|prefix| (prefix.to_owned(), value.into_owned()))),
        }
        Ok(())
    })?;
    for prefix in needed.split_ascii_whitespace() {
        let space = spaces.iter().find(|(found, _)| found == prefix).map_or(prefix, |(_, space)| space);
        if !KNOWN.iter().any(|known| space.contains(known)) {
            return Err(Flaw::unsupported(
                format!("the extension {space}"),
                "export the surface as plain 3MF or as .stl",
            ));
        }
    }
    Ok(())
}

fn required(tag: &Tag<'_>, name: &str) -> Result<u32, Flaw> {
    let found = tag.number(name)?;
    found.ok_or_else(|| Flaw::new(format!("an attribute {name} in the element {}", tag.name()), "none"))
}

fn vertex(tag: &Tag<'_>) -> Result<[f64; 3], Flaw> {
    let mut position = [None; 3];
    tag.attributes(|name, value| {
        if let Some(axis) = ["x", "y", "z"].iter().position(|axis| *axis == name) {
            let x = number::<f64>(value.trim().as_bytes());
            let x = x.ok_or_else(|| Flaw::new(format!("a number as {name} of a vertex"), shown(value.as_bytes())))?;
            if let Some(slot) = position.get_mut(axis) {
                *slot = Some(x);
            }
        }
        Ok(())
    })?;
    match position {
        [Some(x), Some(y), Some(z)] => Ok([x, y, z]),
        _ => Err(Flaw::new("x, y and z of each vertex", "fewer")),
    }
}

fn triangle(tag: &Tag<'_>, vertices: usize) -> Result<[u32; 3], Flaw> {
    let mut corners = [None; 3];
    tag.attributes(|name, value| {
        if let Some(corner) = ["v1", "v2", "v3"].iter().position(|corner| *corner == name) {
            let index = number::<u32>(value.trim().as_bytes()).filter(|&index| (index as usize) < vertices);
            let wrong = || Flaw::new(format!("a vertex number below {vertices}"), shown(value.as_bytes()));
            let index = index.ok_or_else(wrong)?;
            if let Some(slot) = corners.get_mut(corner) {
                *slot = Some(index);
            }
        }
        Ok(())
    })?;
    match corners {
        [Some(a), Some(b), Some(c)] => Ok([a, b, c]),
        _ => Err(Flaw::new("v1, v2 and v3 of each triangle", "fewer")),
    }
}

fn placed(tag: &Tag<'_>) -> Result<Placed, Flaw> {
    let object = required(tag, "objectid")?;
    let (mut path, mut transform) = (None, None);
    tag.attributes(|name, value| {
        match local(name) {
            "path" => path = Some(value.into_owned()),
            "transform" => transform = Some(value.into_owned()),
            _ => {}
        }
        Ok(())
    })?;
    let placement = transform.map_or(Ok(Placement::IDENTITY), |text| placement(&text))?;
    Ok(Placed { path, object, placement })
}

/// Parses a transform: a 4 x 3 matrix, row by row, by which row vectors are multiplied from the right.
fn placement(text: &str) -> Result<Placement, Flaw> {
    let numbers: Option<Vec<f64>> = words(text.as_bytes()).map(number).collect();
    let matrix: Option<[f64; 12]> = numbers.and_then(|numbers| numbers.try_into().ok());
    let [m00, m01, m02, m10, m11, m12, m20, m21, m22, m30, m31, m32] =
        matrix.ok_or_else(|| Flaw::new("12 numbers in a transform", shown(text.as_bytes())))?;
    Ok(Placement([[m00, m10, m20, m30], [m01, m11, m21, m31], [m02, m12, m22, m32]]))
}
