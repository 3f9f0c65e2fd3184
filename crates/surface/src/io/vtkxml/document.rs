//! Reads a file's XML, decodes its arrays of points and cells, and joins all pieces into one surface.

use super::super::budget::Budget;
use super::super::bytes::Endian;
use super::super::flaw::{Flaw, shown};
use super::super::polygon::Triangles;
use super::super::scalar::index;
use super::super::vtk::{cell, polygon, triangle_strip};
use super::super::xml::{Step, Tag, walk};
use super::array::{Description, decode};
use super::packed::{Appended, Compression, Layout};
use crate::mesh::Mesh;

/// The part of a piece that an array belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Section {
    Points,
    Polys,
    Strips,
    /// The cells of an unstructured grid.
    Cells,
}

/// The arrays of cells.
#[derive(Debug, Default)]
struct Cells {
    connectivity: Vec<f64>,
    /// For each cell, the position in `connectivity` at which its corners end.
    offsets: Vec<f64>,
    types: Vec<f64>,
}

/// The arrays of a piece.
#[derive(Debug, Default)]
struct Piece {
    /// Number of points in the piece, as declared by its attributes.
    declared_points: Option<u64>,
    /// Number of polygons in the piece, as declared by its attributes.
    declared_polys: Option<u64>,
    points: Vec<f64>,
    polys: Cells,
    strips: Cells,
    cells: Cells,
}

/// A DataArray element that is being read.
struct Open {
    description: Description,
    /// The element's text so far.
    text: String,
    /// Number of open elements inside this one. Their text isn't part of the array.
    inner: usize,
}

struct State<'a> {
    layout: Layout<'a>,
    budget: Budget,
    piece: Piece,
    section: Option<Section>,
    array: Option<Open>,
    root: bool,
    mesh: Mesh,
}

/// Reads a document. If `whole` is false, the text may end within elements, because data follow the XML. `file` is the
/// size of the file in bytes.
pub(super) fn read(text: &str, whole: bool, appended: Appended<'_>, file: usize) -> Result<Mesh, Flaw> {
    let mut state = State {
        layout: Layout { endian: Endian::Little, wide: false, compression: Compression::None, appended },
        budget: Budget::of_file(file),
        piece: Piece::default(),
        section: None,
        array: None,
        root: false,
        mesh: Mesh::default(),
    };
    walk(text, whole, |step| match step {
        Step::Start(tag) => state.start(tag),
        Step::Text(text) => {
            if let Some(array) = state.array.as_mut().filter(|array| array.inner == 0) {
                array.text.push_str(&text);
            }
            Ok(())
        }
        Step::End(name) => state.end(name),
    })?;
    Ok(state.mesh)
}

impl State<'_> {
    fn start(&mut self, tag: &Tag<'_>) -> Result<(), Flaw> {
        if !self.root {
            self.root = true;
            return self.start_root(tag);
        }
        if let Some(array) = &mut self.array {
            array.inner += 1;
            return Ok(());
        }
        match tag.name() {
            "Piece" => {
                self.piece = Piece {
                    declared_points: tag.number("NumberOfPoints")?,
                    declared_polys: tag.number("NumberOfPolys")?,
                    ..Piece::default()
                }
            }
            "Points" => self.section = Some(Section::Points),
            "Polys" => self.section = Some(Section::Polys),
            "Strips" => self.section = Some(Section::Strips),
            "Cells" => self.section = Some(Section::Cells),
            "DataArray" if self.section.is_some() => {
                self.array = Some(Open { description: Description::of(tag)?, text: String::new(), inner: 0 });
            }
            _ => {}
        }
        Ok(())
    }

    fn start_root(&mut self, tag: &Tag<'_>) -> Result<(), Flaw> {
        if tag.name() != "VTKFile" {
            return Err(Flaw::new("a VTKFile element", shown(tag.name().as_bytes())));
        }
        let attribute = |name: &str| Ok::<_, Flaw>(tag.attribute(name)?.unwrap_or_default());
        let kind = attribute("type")?;
        if kind != "PolyData" && kind != "UnstructuredGrid" {
            let found = format!("the dataset {}", shown(kind.as_bytes()));
            return Err(Flaw::unsupported(found, "save the surface as PolyData (.vtp)"));
        }
        self.layout.endian = match attribute("byte_order")?.as_str() {
            "LittleEndian" | "" => Endian::Little,
            "BigEndian" => Endian::Big,
            other => return Err(Flaw::new("byte_order LittleEndian or BigEndian", shown(other.as_bytes()))),
        };
        self.layout.wide = match attribute("header_type")?.as_str() {
            // Files of versions before 1.0 have no header_type.
            "UInt32" | "" => false,
            "UInt64" => true,
            other => return Err(Flaw::new("header_type UInt32 or UInt64", shown(other.as_bytes()))),
        };
        self.layout.compression = match attribute("compressor")?.as_str() {
            "" => Compression::None,
            "vtkZLibDataCompressor" => Compression::Zlib,
            "vtkLZ4DataCompressor" => Compression::Lz4,
            other => {
                let found = format!("the compressor {}", shown(other.as_bytes()));
                return Err(Flaw::unsupported(found, "save the file with ZLib compression or uncompressed"));
            }
        };
        Ok(())
    }

    fn end(&mut self, name: &str) -> Result<(), Flaw> {
        if let Some(array) = self.array.as_mut().filter(|array| array.inner > 0) {
            array.inner -= 1;
            return Ok(());
        }
        match name {
            "DataArray" => {
                if let Some(array) = self.array.take() {
                    self.keep(&array.description, &array.text)?;
                }
            }
            "Points" | "Polys" | "Strips" | "Cells" => self.section = None,
            "Piece" => {
                let piece = std::mem::take(&mut self.piece);
                piece.add_to(&mut self.mesh)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Decodes an array and keeps it if the surface needs it.
    fn keep(&mut self, description: &Description, text: &str) -> Result<(), Flaw> {
        let cells = match self.section {
            Some(Section::Points) => {
                if description.components != Some(3) {
                    let found = description.components.map_or("none".to_owned(), |n| n.to_string());
                    return Err(Flaw::new("3 as the NumberOfComponents of the points", found));
                }
                self.piece.points = decode(description, text, &self.layout, &mut self.budget)?;
                return Ok(());
            }
            Some(Section::Polys) => &mut self.piece.polys,
            Some(Section::Strips) => &mut self.piece.strips,
            Some(Section::Cells) => &mut self.piece.cells,
            None => return Ok(()),
        };
        let array = match description.name.as_str() {
            "connectivity" => &mut cells.connectivity,
            "offsets" => &mut cells.offsets,
            "types" => &mut cells.types,
            // Other arrays aren't needed: they describe the faces of polyhedra, and cells of this type are rejected.
            _ => return Ok(()),
        };
        *array = decode(description, text, &self.layout, &mut self.budget)?;
        Ok(())
    }
}

impl Piece {
    /// Adds the piece's points and triangles to a mesh.
    fn add_to(self, mesh: &mut Mesh) -> Result<(), Flaw> {
        let (points, rest) = self.points.as_chunks::<3>();
        let declared = self.declared_points.unwrap_or(points.len() as u64);
        if !rest.is_empty() || declared != points.len() as u64 {
            return Err(Flaw::new(
                format!("{declared} points of three numbers each"),
                format!("{} numbers", self.points.len()),
            ));
        }
        let polys = self.polys.offsets.len();
        if self.declared_polys.is_some_and(|declared| declared != polys as u64) {
            return Err(Flaw::new(
                format!("{} polygons, as given by NumberOfPolys", self.declared_polys.unwrap_or(0)),
                polys.to_string(),
            ));
        }
        let first =
            u32::try_from(mesh.vertices.len()).ok().filter(|first| first.checked_add(points.len() as u32).is_some());
        let first = first.ok_or_else(|| Flaw::new("fewer than 2^32 points", "more"))?;
        mesh.vertices.extend_from_slice(points);
        let space = Space { first, points: points.len() };
        let mut faces = Triangles::default();
        self.polys.each(&space, |_, corners| polygon(corners, &mut faces))?;
        self.strips.each(&space, |_, corners| triangle_strip(corners, &mut faces))?;
        if !self.cells.offsets.is_empty() && self.cells.types.len() != self.cells.offsets.len() {
            let found = self.cells.types.len().to_string();
            return Err(Flaw::new(format!("{} cell types, one per cell", self.cells.offsets.len()), found));
        }
        self.cells.each(&space, |kind, corners| cell(kind as u64, corners, &mut faces))?;
        mesh.faces.extend(faces.cut(&mesh.vertices));
        Ok(())
    }
}

/// The number of points in a piece (`points`), and the number of points in all earlier pieces (`first`).
struct Space {
    first: u32,
    points: usize,
}

impl Cells {
    /// Passes the type and the corners of each cell to `each`. The type is 0 if the file doesn't state the type.
    fn each(&self, space: &Space, mut each: impl FnMut(f64, &[u32]) -> Result<(), Flaw>) -> Result<(), Flaw> {
        let (mut start, mut corners) = (0, Vec::new());
        let mut types = self.types.iter();
        for &end in &self.offsets {
            let wrong = || {
                let expected = format!("increasing offsets of at most {}", self.connectivity.len());
                Flaw::new(expected, format!("{end} after {start}"))
            };
            let place = index(end)? as usize;
            corners.clear();
            for &corner in self.connectivity.get(start..place).ok_or_else(wrong)? {
                let corner = index(corner)?;
                if corner as usize >= space.points {
                    return Err(Flaw::new(
                        format!("indices below {}, the piece's number of points", space.points),
                        corner.to_string(),
                    ));
                }
                corners.push(space.first + corner);
            }
            start = place;
            each(types.next().copied().unwrap_or_default(), &corners)?;
        }
        if start < self.connectivity.len() {
            return Err(Flaw::new(format!("{} as the last offset", self.connectivity.len()), start.to_string()));
        }
        Ok(())
    }
}
