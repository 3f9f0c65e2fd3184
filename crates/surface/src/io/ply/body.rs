//! Reads the data that follow the header of a PLY file.

use super::super::bytes::Cursor;
use super::super::flaw::{Flaw, bounded, shown};
use super::super::polygon::Triangles;
use super::super::scalar::Scalar;
use super::super::text::number;
use super::header::{Element, Encoding, Header, Kind};
use crate::mesh::Mesh;

/// Reads positions, polygons and strips, and skips all other data.
pub(super) fn read(header: &Header, cursor: Cursor<'_>) -> Result<Mesh, Flaw> {
    let mut values = Values { cursor, encoding: header.encoding };
    let (mut positions, mut triangles) = (Vec::new(), Triangles::default());
    let (mut seen_faces, mut seen_strips) = (false, false);
    for element in &header.elements {
        match element.name.as_slice() {
            b"vertex" if positions.is_empty() => positions = vertices(element, &mut values)?,
            b"face" if !seen_faces => {
                seen_faces = true;
                faces(element, &mut values, &mut triangles)?;
            }
            b"tristrips" if !seen_strips => {
                seen_strips = true;
                strips(element, &mut values, &mut triangles)?;
            }
            _ => skip(element, &mut values)?,
        }
    }
    Ok(triangles.into_mesh(positions))
}

fn vertices(element: &Element, values: &mut Values<'_>) -> Result<Vec<[f64; 3]>, Flaw> {
    let axes: Vec<Option<usize>> =
        element.properties.iter().map(|p| [b"x", b"y", b"z"].iter().position(|axis| p.name == **axis)).collect();
    for axis in 0..3 {
        if axes.iter().filter(|&&a| a == Some(axis)).count() != 1 {
            return Err(Flaw::new("exactly one vertex property for each of x, y and z", "other properties"));
        }
    }
    let count = values.bounded(element)?;
    let mut positions = Vec::with_capacity(count);
    for _ in 0..count {
        let mut position = [0.0; 3];
        for (property, axis) in element.properties.iter().zip(&axes) {
            match property.kind {
                Kind::Scalar(scalar) => {
                    let x = values.float(scalar)?;
                    if let Some(slot) = axis.and_then(|a| position.get_mut(a)) {
                        *slot = x;
                    }
                }
                Kind::List { .. } => values.skip(property.kind)?,
            }
        }
        positions.push(position);
    }
    Ok(positions)
}

/// Reads polygons, and adds their triangles to `faces`.
fn faces(element: &Element, values: &mut Values<'_>, faces: &mut Triangles) -> Result<(), Flaw> {
    let count = values.bounded(element)?;
    faces.reserve(count);
    let mut corners = Vec::new();
    lists(element, count, values, |values, n, item| {
        corners.clear();
        // `n` isn't checked, because every corner read takes bytes: if `n` is too large, the end of the file is
        // reported as an error.
        for _ in 0..n {
            corners.push(values.index(item)?);
        }
        if faces.polygon(&corners) { Ok(()) } else { Err(Flaw::new("faces of at least three corners", n.to_string())) }
    })
}

/// Reads lists of strips, and adds their triangles to `faces`. In a list, -1 separates strips.
///
/// Source: files of the library trimesh2 (Rusinkiewicz); the description of PLY doesn't define strips.
fn strips(element: &Element, values: &mut Values<'_>, faces: &mut Triangles) -> Result<(), Flaw> {
    let count = values.bounded(element)?;
    let mut corners = Vec::new();
    lists(element, count, values, |values, n, item| {
        corners.clear();
        for _ in 0..n {
            match values.index_or_end(item)? {
                Some(corner) => corners.push(corner),
                None => {
                    faces.strip(&corners);
                    corners.clear();
                }
            }
        }
        faces.strip(&corners);
        Ok(())
    })
}

/// For each instance of an element, passes the length and the number type of its list of corners to `list`, which reads
/// the list. Skips the other properties.
fn lists<'a>(
    element: &Element,
    count: usize,
    values: &mut Values<'a>,
    mut list: impl FnMut(&mut Values<'a>, u32, Scalar) -> Result<(), Flaw>,
) -> Result<(), Flaw> {
    let is_corners = |name: &[u8]| name == b"vertex_indices" || name == b"vertex_index";
    if element.properties.iter().filter(|p| is_corners(&p.name)).count() != 1 {
        let name = String::from_utf8_lossy(&element.name);
        return Err(Flaw::new(format!("one property vertex_indices in the element {name}"), "none or several"));
    }
    for _ in 0..count {
        for property in &element.properties {
            match property.kind {
                Kind::List { count, item } if is_corners(&property.name) => {
                    let n = values.index(count)?;
                    list(values, n, item)?;
                }
                Kind::Scalar(_) if is_corners(&property.name) => {
                    return Err(Flaw::new("vertex_indices as a list", "one number"));
                }
                kind => values.skip(kind)?,
            }
        }
    }
    Ok(())
}

fn skip(element: &Element, values: &mut Values<'_>) -> Result<(), Flaw> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for _ in 0..values.bounded(element)? {
        for property in &element.properties {
            values.skip(property.kind)?;
        }
    }
    Ok(())
}

/// Reads the numbers of the data one by one. In text files, newlines and blanks separate numbers.
struct Values<'a> {
    cursor: Cursor<'a>,
    encoding: Encoding,
}

impl Values<'_> {
    fn bounded(&self, element: &Element) -> Result<usize, Flaw> {
        // One byte is added, because the last number in a text file needs no separator after it.
        let remaining = self.cursor.remaining() + 1;
        let what = String::from_utf8_lossy(&element.name);
        bounded(element.count, element.least_size(self.encoding).max(1), remaining, &what)
    }

    fn float(&mut self, scalar: Scalar) -> Result<f64, Flaw> {
        let Encoding::Binary(e) = self.encoding else {
            let word = self.cursor.token();
            return number(word).ok_or_else(|| Flaw::new("a number", shown(word)));
        };
        scalar.read(&mut self.cursor, e)
    }

    /// Reads a number that is a count or a vertex index.
    fn index(&mut self, scalar: Scalar) -> Result<u32, Flaw> {
        let Encoding::Binary(e) = self.encoding else {
            let word = self.cursor.token();
            return number(word).ok_or_else(|| Flaw::new("a non-negative whole number", shown(word)));
        };
        // Fast path for the two types that nearly all files use.
        match scalar {
            Scalar::U8 => return Ok(self.cursor.u8(e)?.into()),
            Scalar::U32 => return self.cursor.u32(e),
            _ => {}
        }
        let x = self.float(scalar)?;
        let i = x as u32;
        if f64::from(i) == x { Ok(i) } else { Err(Flaw::new("a non-negative whole number", x.to_string())) }
    }

    /// Reads a vertex index, or -1, which ends a strip and is returned as `None`.
    fn index_or_end(&mut self, scalar: Scalar) -> Result<Option<u32>, Flaw> {
        let x = self.float(scalar)?;
        let i = x as u32;
        match x {
            -1.0 => Ok(None),
            _ if f64::from(i) == x => Ok(Some(i)),
            _ => Err(Flaw::new("a non-negative whole number or -1", x.to_string())),
        }
    }

    fn skip(&mut self, kind: Kind) -> Result<(), Flaw> {
        let (scalar, count) = match kind {
            Kind::Scalar(scalar) => (scalar, 1),
            Kind::List { count, item } => (item, self.index(count)? as usize),
        };
        match self.encoding {
            Encoding::Binary(_) => {
                let size = count.saturating_mul(scalar.size());
                self.cursor.take(size)?;
            }
            Encoding::Ascii => {
                for _ in 0..count {
                    if self.cursor.token().is_empty() {
                        return Err(Flaw::new("a number", "the end of the file"));
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::read;

    #[test]
    fn an_element_without_properties_takes_no_room_however_many_there_are() {
        let text = "ply\nformat binary_little_endian 1.0\nelement void 99999999999999999\n\
                    element vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
        assert!(read(text.as_bytes()).unwrap().vertices.is_empty());
    }

    #[test]
    fn lists_of_faces_that_are_no_corners_are_stepped_over() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 2\nproperty list uchar int tags\nproperty list uchar int vertex_indices\n\
                    property list uchar float texcoord\nend_header\n\
                    0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 1 1 2 3 0 1 2 0\n0 3 0 3 1 2 0.5 0.5\n";
        assert_eq!(read(text.as_bytes()).unwrap().faces, [[0, 1, 2], [0, 3, 1]]);
    }

    #[test]
    fn strips_are_separated_by_minus_one_and_follow_faces() {
        let head = "element vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 1\nproperty list uchar int vertex_indices\n\
                    element tristrips 1\nproperty list int int vertex_indices\nend_header\n";
        let text =
            format!("ply\nformat ascii 1.0\n{head}0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 0 1\n3 4 1 0\n8 0 1 2 3 -1 2 3 4\n");
        let wanted = [[4, 1, 0], [0, 1, 2], [2, 1, 3], [2, 3, 4]];
        assert_eq!(read(text.as_bytes()).unwrap().faces, wanted);
        let mut binary = format!("ply\nformat binary_big_endian 1.0\n{head}").into_bytes();
        binary.extend([0; 60]);
        binary.push(3);
        binary.extend([4, 1, 0, 8, 0, 1, 2, 3, -1, 2, 3, 4].map(i32::to_be_bytes).as_flattened());
        assert_eq!(read(&binary).unwrap().faces, wanted);
        let wrong = read(text.replace("-1", "-2").as_bytes()).unwrap_err();
        assert!(format!("{wrong:?}").contains("or -1"), "{wrong:?}");
    }

    #[test]
    fn properties_in_any_order_and_foreign_lists_are_stepped_over() {
        let text = "ply\nformat ascii 1.0\ncomment x\nelement vertex 3\nproperty list uchar int tags\nproperty float z\n\
                    property float x\nproperty uchar red\nproperty double y\nelement edge 1\nproperty int a\n\
                    element face 1\nproperty uchar flag\nproperty list uchar int vertex_index\nend_header\n\
                    2 8 9 3 1 255 2\n0 6 4 0 5\n1 7 9 7 0 8\n77\n1 3 2 1 0";
        let mesh = read(text.as_bytes()).unwrap();
        assert_eq!(mesh.vertices, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
        assert_eq!(mesh.faces, [[2, 1, 0]]);
    }
}
