//! Reads nodes. A node consists of a type, and fields in braces; fields hold values or nodes. DEF names a node. USE
//! repeats a named node: the node's text is read again from its position in the file.

use std::collections::HashMap;
use std::ops::Range;

use super::super::budget::Budget;
use super::super::flaw::{Flaw, shown};
use super::super::placement::Placement;
use super::face_set::FaceSet;
use super::token::{Token, Tokens};
use crate::mesh::Mesh;

/// Largest depth to which nodes may be nested.
const DEEPEST: usize = 64;
/// Number of bytes that the budget is charged for a repeated node, in addition to its text.
const REPEATED: u64 = 64;

/// Unsupported types of nodes, which hold surfaces or parts of the scene.
const REFUSED: [&[u8]; 11] = [
    b"Switch",
    b"LOD",
    b"Inline",
    b"PROTO",
    b"EXTERNPROTO",
    b"Box",
    b"Cone",
    b"Cylinder",
    b"Sphere",
    b"ElevationGrid",
    b"Extrusion",
];

/// Reads all nodes of a file.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut scene = Scene {
        tokens: Tokens::new(bytes),
        names: HashMap::new(),
        budget: Budget::of_file(bytes.len()),
        mesh: Mesh::default(),
        shared: HashMap::new(),
        transforms: 0,
    };
    let mut top = Node::new(b"", 0);
    while scene.field(&mut top, 0)? {}
    Ok(scene.mesh)
}

struct Scene<'a> {
    tokens: Tokens<'a>,
    /// The text of each named node, from its type to its closing brace.
    names: HashMap<&'a [u8], Range<usize>>,
    budget: Budget,
    mesh: Mesh,
    /// Index of the first vertex and number of vertices of each Coordinate node that has been read. The keys are the
    /// start of the node's text and the number of the Transform around the node. Face sets that use the same points
    /// share vertices.
    shared: HashMap<(usize, usize), (usize, usize)>,
    /// Number of Transform nodes so far.
    transforms: usize,
}

/// The fields of a node that is being read.
struct Node<'a> {
    kind: &'a [u8],
    /// Number of the innermost Transform around the node.
    transform: usize,
    set: FaceSet,
    /// Points of a Coordinate node.
    points: Vec<[f64; 3]>,
    translation: [f64; 3],
    center: [f64; 3],
    scale: [f64; 3],
    rotation: [f64; 4],
    scale_orientation: [f64; 4],
}

impl<'a> Node<'a> {
    fn new(kind: &'a [u8], transform: usize) -> Self {
        Self {
            kind,
            transform,
            set: FaceSet::new(),
            points: Vec::new(),
            translation: [0.0; 3],
            center: [0.0; 3],
            scale: [1.0; 3],
            rotation: [0.0, 0.0, 1.0, 0.0],
            scale_orientation: [0.0, 0.0, 1.0, 0.0],
        }
    }

    /// Returns the affine map of a Transform node (section 6.52).
    fn placement(&self) -> Placement {
        let [x, y, z, angle] = self.scale_orientation;
        Placement::shift(self.translation)
            .after(&Placement::shift(self.center))
            .after(&turn(self.rotation))
            .after(&turn(self.scale_orientation))
            .after(&Placement::scale(self.scale))
            .after(&turn([x, y, z, -angle]))
            .after(&Placement::shift(self.center.map(|x| -x)))
    }
}

/// Returns the rotation by an angle around an axis. An axis of length 0 gives the identity.
fn turn([x, y, z, angle]: [f64; 4]) -> Placement {
    let length = (x * x + y * y + z * z).sqrt();
    if length == 0.0 || angle == 0.0 {
        return Placement::IDENTITY;
    }
    let (sin, cos) = (angle / 2.0).sin_cos();
    let part = sin / length;
    Placement::rotation([x * part, y * part, z * part, cos])
}

impl<'a> Scene<'a> {
    /// Reads the next field, or part of a field, of a node. Returns `false` if the node has no more fields.
    fn field(&mut self, node: &mut Node<'a>, depth: usize) -> Result<bool, Flaw> {
        let token = self.tokens.next();
        let word = match token {
            Some(Token::Word(word)) => word,
            Some(Token::Close) if depth > 0 => return Ok(false),
            None if depth == 0 => return Ok(false),
            // Values of fields that aren't used are skipped.
            Some(Token::Text | Token::ListStart | Token::ListEnd) => return Ok(true),
            other => return Err(Flaw::new("fields and closing braces", self.tokens.found(other))),
        };
        if REFUSED.contains(&word) && (word.ends_with(b"PROTO") || self.tokens.peek() == Some(Token::Open)) {
            return Err(Flaw::unsupported(
                format!("a node {}", shown(word)),
                "save the surface alone, as .ply or .stl",
            ));
        }
        match word {
            b"DEF" => {
                let name = self.tokens.word("a node's name after DEF")?;
                let start = self.tokens.at;
                let kind = self.tokens.word("a node's type")?;
                self.child(node, kind, start, depth)?;
                // The name is added only after the node has been read, so that a node can't refer to itself.
                self.names.insert(name, start..self.tokens.at);
            }
            b"USE" => {
                let name = self.tokens.word("a node's name after USE")?;
                let text = self.names.get(name).cloned();
                let text = text.ok_or_else(|| Flaw::new("the name of an earlier node", shown(name)))?;
                self.budget.spend(text.len() as u64 + REPEATED, "repeated nodes of")?;
                let after = std::mem::replace(&mut self.tokens.at, text.start);
                let kind = self.tokens.word("a node's type")?;
                self.child(node, kind, text.start, depth)?;
                self.tokens.at = after;
            }
            kind if self.tokens.peek() == Some(Token::Open) => {
                let start = self.tokens.at - kind.len();
                self.child(node, kind, start, depth)?;
            }
            name => self.value(node, name)?,
        }
        Ok(true)
    }

    /// Reads a node within another node, starting at the inner node's opening brace. The inner node's text starts at
    /// position `start`.
    fn child(&mut self, outer: &mut Node<'a>, kind: &'a [u8], start: usize, depth: usize) -> Result<(), Flaw> {
        if depth >= DEEPEST {
            return Err(Flaw::new(format!("nodes nested at most {DEEPEST} deep"), "deeper nesting"));
        }
        let open = self.tokens.next();
        if open != Some(Token::Open) {
            return Err(Flaw::new(format!("{{ after {}", shown(kind)), self.tokens.found(open)));
        }
        let is_transform = kind == b"Transform";
        self.transforms += usize::from(is_transform);
        let mut node = Node::new(kind, if is_transform { self.transforms } else { outer.transform });
        let (vertices, faces) = (self.mesh.vertices.len(), self.mesh.faces.len());
        while self.field(&mut node, depth + 1)? {}
        match kind {
            b"Transform" => node.placement().place(
                self.mesh.vertices.get_mut(vertices..).unwrap_or_default(),
                self.mesh.faces.get_mut(faces..).unwrap_or_default(),
            ),
            b"Coordinate" if outer.kind == b"IndexedFaceSet" => {
                let mesh = &mut self.mesh;
                let place = self.shared.entry((start, node.transform)).or_insert_with(|| {
                    let first = mesh.vertices.len();
                    mesh.vertices.extend_from_slice(&node.points);
                    (first, node.points.len())
                });
                outer.set.points = Some(*place);
            }
            b"IndexedFaceSet" => node.set.add_to(&mut self.mesh)?,
            _ => {}
        }
        Ok(())
    }

    /// Reads the value of a field that a surface needs. Values of other fields are skipped token by token.
    fn value(&mut self, node: &mut Node<'a>, name: &[u8]) -> Result<(), Flaw> {
        match (node.kind, name) {
            (b"Coordinate", b"point") => {
                let mut numbers = Vec::new();
                self.tokens.numbers("a coordinate", |x: f64| numbers.push(x))?;
                let (points, rest) = numbers.as_chunks::<3>();
                if !rest.is_empty() {
                    return Err(Flaw::new("three coordinates per point", format!("{} numbers", numbers.len())));
                }
                node.points = points.to_vec();
            }
            (b"IndexedFaceSet", b"coordIndex") => {
                let indices = &mut node.set.indices;
                self.tokens.numbers("an index of a point, or -1", |index: i64| indices.push(index))?;
            }
            (b"IndexedFaceSet", b"ccw") => node.set.ccw = self.tokens.word("TRUE or FALSE")? != b"FALSE",
            (b"Transform", b"translation") => self.tuple(&mut node.translation)?,
            (b"Transform", b"center") => self.tuple(&mut node.center)?,
            (b"Transform", b"scale") => self.tuple(&mut node.scale)?,
            (b"Transform", b"rotation") => self.tuple(&mut node.rotation)?,
            (b"Transform", b"scaleOrientation") => self.tuple(&mut node.scale_orientation)?,
            _ => {}
        }
        Ok(())
    }

    fn tuple(&mut self, numbers: &mut [f64]) -> Result<(), Flaw> {
        for x in numbers {
            *x = self.tokens.number("a number in a Transform")?;
        }
        Ok(())
    }
}
