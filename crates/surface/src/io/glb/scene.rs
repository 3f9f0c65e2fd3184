//! Places the meshes of a scene by its nodes (section 3.5).
//!
//! Nodes form trees: a node has at most one parent. Each node has a matrix, or a scale, a rotation and a translation,
//! which are applied in this order. The transforms of the node's ancestors are applied afterwards.

use super::super::budget::Budget;
use super::super::flaw::Flaw;
use super::super::placement::Placement;
use super::accessor::Arrays;
use super::container::Buffer;
use super::document::{Document, Node};
use super::primitive;
use crate::mesh::Mesh;

/// Reads all meshes of the default scene, in the order of the nodes. If the file has no default scene, reads its first
/// scene. If it has no scenes, reads all nodes without parents. If it has no nodes, reads all meshes.
pub(super) fn read(document: &Document, buffers: &[Buffer<'_>], budget: &mut Budget) -> Result<Mesh, Flaw> {
    let arrays = Arrays { document, buffers };
    let mut mesh = Mesh::default();
    if document.nodes.is_empty() {
        for number in 0..document.meshes.len() {
            add(&arrays, number, &Node::default(), &Placement::IDENTITY, &mut mesh, budget)?;
        }
        return Ok(mesh);
    }
    let mut seen = vec![false; document.nodes.len()];
    // Nodes to visit, each with the placement of its parent. The node to visit next is at the end of the list.
    let mut open: Vec<(usize, Placement)> =
        roots(document)?.into_iter().rev().map(|node| (node, Placement::IDENTITY)).collect();
    while let Some((number, parent)) = open.pop() {
        let (Some(node), Some(seen)) = (document.nodes.get(number), seen.get_mut(number)) else {
            return Err(Flaw::new(
                format!("a node number below the number of nodes, {}", document.nodes.len()),
                number.to_string(),
            ));
        };
        if std::mem::replace(seen, true) {
            return Err(Flaw::new(
                "nodes with one parent each",
                format!("node {number}, which has several parents or contains itself"),
            ));
        }
        let placement = parent.after(&local(node));
        if let Some(number) = node.mesh {
            add(&arrays, number, node, &placement, &mut mesh, budget)?;
        }
        open.extend(node.children.iter().rev().map(|&child| (child, placement)));
    }
    Ok(mesh)
}

/// Returns the root nodes of the scene to read.
fn roots(document: &Document) -> Result<Vec<usize>, Flaw> {
    if let Some(scene) = document.scenes.get(document.scene.unwrap_or(0)) {
        return Ok(scene.nodes.clone());
    }
    if let Some(scene) = document.scene {
        return Err(Flaw::new(
            format!("a scene number below the number of scenes, {}", document.scenes.len()),
            scene.to_string(),
        ));
    }
    let mut is_child = vec![false; document.nodes.len()];
    for &child in document.nodes.iter().flat_map(|node| &node.children) {
        if let Some(is_child) = is_child.get_mut(child) {
            *is_child = true;
        }
    }
    Ok(is_child.iter().enumerate().filter(|(_, is_child)| !**is_child).map(|(node, _)| node).collect())
}

fn local(node: &Node) -> Placement {
    if let Some(matrix) = &node.matrix {
        return Placement::from_columns(matrix);
    }
    let mut placement = Placement::IDENTITY;
    if let Some(scale) = node.scale {
        placement = Placement::scale(scale);
    }
    if let Some(rotation) = node.rotation {
        placement = Placement::rotation(rotation).after(&placement);
    }
    if let Some(translation) = node.translation {
        placement = Placement::shift(translation).after(&placement);
    }
    placement
}

/// Adds the triangles of a mesh, moved by `placement`.
fn add(
    arrays: &Arrays<'_>,
    number: usize,
    node: &Node,
    placement: &Placement,
    mesh: &mut Mesh,
    budget: &mut Budget,
) -> Result<(), Flaw> {
    let document = arrays.document;
    let found = document.meshes.get(number);
    let found = found.ok_or_else(|| {
        Flaw::new(format!("a mesh number below the number of meshes, {}", document.meshes.len()), number.to_string())
    })?;
    document.check_rigid(node, found)?;
    let (vertices, faces) = (mesh.vertices.len(), mesh.faces.len());
    for primitive in &found.primitives {
        primitive::add(arrays, primitive, mesh, budget)?;
    }
    placement
        .place(mesh.vertices.get_mut(vertices..).unwrap_or_default(), mesh.faces.get_mut(faces..).unwrap_or_default());
    Ok(())
}
