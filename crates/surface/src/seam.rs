//! Relates a surface that was cut open along loops to the original surface.
//!
//! A surface with handles can't be mapped to the sphere. The surface can be mapped after it has been cut open along
//! loops and both sides of each loop have been filled. The vertices of the cut surface are the n vertices of the
//! original in their order, then copies of the vertices on the seams, then the vertices of the fillings. Its triangles
//! are the F triangles of the original in their order, then the triangles of the fillings. On one side of each seam,
//! the triangles of the original use the copied vertices. Therefore n, F and the list of copied vertices suffice to
//! recover the original.
//!
//! The GIfTI file of the sphere stores these data as metadata: `SpharmCutFrom` contains n and F, `SpharmSeam` the list
//! of copied vertices. A model stores the same data in arrays.

use crate::mesh::{Mesh, Meta};

const CUT_FROM: &str = "SpharmCutFrom";
const COPIES: &str = "SpharmSeam";

/// The data that relate a cut surface to the original surface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seam {
    /// Number n of vertices of the original surface.
    pub vertices: usize,
    /// Number F of triangles of the original surface.
    pub faces: usize,
    /// Vertex n + i of the cut surface is a copy of the original's vertex `copies[i]`. The vertices after the copies
    /// belong to fillings.
    pub copies: Vec<u32>,
}

/// A surface reassembled from a cut surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Welded {
    /// The surface, with the vertices and triangles of the original.
    pub mesh: Mesh,
    /// Largest distance between two positions that the cut surface has for one original vertex, in the surface's unit.
    pub gap: f64,
}

impl Seam {
    /// Checks that the seam is consistent with a cut surface of `vertices` vertices and `faces` triangles, and returns
    /// it.
    ///
    /// # Errors
    ///
    /// Returns a description of the inconsistency, if there is one.
    pub fn checked(self, vertices: usize, faces: usize) -> Result<Self, String> {
        if self.vertices.checked_add(self.copies.len()).is_none_or(|known| known > vertices) {
            let copies = self.copies.len();
            return Err(format!(
                "expected at least {} vertices plus {copies} copies, found {vertices} vertices",
                self.vertices
            ));
        }
        if self.faces > faces {
            return Err(format!("expected at least {} triangles, found {faces}", self.faces));
        }
        match self.copies.iter().find(|&&v| v as usize >= self.vertices) {
            Some(v) => Err(format!(
                "expected copies of vertices with an index below {}, found a copy of vertex {v}",
                self.vertices
            )),
            None => Ok(self),
        }
    }

    /// Reassembles a cut surface: drops the fillings, and moves each copied vertex to the mean of its positions.
    ///
    /// # Errors
    ///
    /// Returns a description of the inconsistency, as in [`checked`](Self::checked), or of a triangle of the original
    /// that uses a vertex of a filling.
    pub fn weld(&self, cut: &Mesh) -> Result<Welded, String> {
        let Self { vertices, faces, copies } = self.clone().checked(cut.vertices.len(), cut.faces.len())?;
        let mut places: Vec<(u32, usize)> = copies.iter().copied().zip(vertices..).collect();
        places.sort_unstable();
        let mut welded: Vec<[f64; 3]> = cut.vertices[..vertices].to_vec();
        let mut gap = 0.0_f64;
        for same in places.chunk_by(|a, b| a.0 == b.0) {
            let own = same[0].0 as usize;
            let all: Vec<[f64; 3]> =
                std::iter::once(own).chain(same.iter().map(|&(_, copy)| copy)).map(|v| cut.vertices[v]).collect();
            for (i, a) in all.iter().enumerate() {
                let square = |b: &[f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>();
                gap = all[..i].iter().map(square).fold(gap, f64::max);
            }
            let mean = |axis: usize| all.iter().map(|p| p[axis]).sum::<f64>() / all.len() as f64;
            welded[own] = [mean(0), mean(1), mean(2)];
        }
        let own = |v: u32| match (v as usize).checked_sub(vertices) {
            None => Some(v),
            Some(copy) => copies.get(copy).copied(),
        };
        let triangle = |(face, &[a, b, c]): (usize, &[u32; 3])| {
            let vertices = own(a).zip(own(b)).zip(own(c)).map(|((a, b), c)| [a, b, c]);
            vertices.ok_or_else(|| {
                format!("triangle {face} of the original surface uses a vertex that was added to fill a cut")
            })
        };
        let faces: Result<Vec<[u32; 3]>, String> = cut.faces[..faces].iter().enumerate().map(triangle).collect();
        Ok(Welded { mesh: Mesh { vertices: welded, faces: faces?, meta: cut.meta.clone() }, gap: gap.sqrt() })
    }

    /// Returns the seam in a file's metadata; `None` if the entries are missing or aren't numbers.
    #[must_use]
    pub fn of(meta: &Meta) -> Option<Self> {
        let value = |name: &str| meta.file_metadata.iter().find(|(found, _)| found == name).map(|(_, value)| value);
        let (vertices, faces) = value(CUT_FROM)?.split_once(' ')?;
        let copies: Result<Vec<u32>, _> = value(COPIES)?.split_whitespace().map(str::parse).collect();
        Some(Self { vertices: vertices.parse().ok()?, faces: faces.parse().ok()?, copies: copies.ok()? })
    }

    /// Writes the seam to the metadata of the cut surface's sphere. Earlier entries are replaced.
    pub fn write_to(&self, meta: &mut Meta) {
        meta.file_metadata.retain(|(name, _)| ![CUT_FROM, COPIES].contains(&name.as_str()));
        let copies: Vec<String> = self.copies.iter().map(u32::to_string).collect();
        let pairs = [(CUT_FROM, format!("{} {}", self.vertices, self.faces)), (COPIES, copies.join(" "))];
        meta.file_metadata.extend(pairs.map(|(name, value)| (name.to_owned(), value)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seam() -> Seam {
        Seam { vertices: 3, faces: 1, copies: vec![2, 2] }
    }

    fn cut() -> Mesh {
        let x = |x: f64| [x, 0.0, 0.0];
        Mesh::new(vec![x(0.0), x(1.0), x(2.0), x(5.0), x(8.0), x(9.0)], vec![[0, 1, 4], [3, 4, 5]])
    }

    #[test]
    fn copies_are_welded_at_their_mean_and_fillings_left_out() {
        let Welded { mesh, gap } = seam().weld(&cut()).unwrap();
        assert_eq!(mesh.faces, [[0, 1, 2]]);
        assert_eq!((mesh.vertices.len(), mesh.vertices[2], gap), (3, [5.0, 0.0, 0.0], 6.0));
    }

    #[test]
    fn metadata_return_and_what_does_not_fit_is_refused() {
        let mut meta = Meta { file_metadata: vec![("a".to_owned(), "b".to_owned())], ..Meta::default() };
        assert_eq!(Seam::of(&meta), None);
        for _ in 0..2 {
            seam().write_to(&mut meta);
            assert_eq!((Seam::of(&meta), meta.file_metadata.len()), (Some(seam()), 3));
        }
        let refused = |seam: Seam| seam.weld(&cut()).unwrap_err();
        assert!(refused(Seam { vertices: usize::MAX, ..seam() }).contains("2 copies, found 6 vertices"));
        assert!(refused(Seam { faces: 3, ..seam() }).contains("3 triangles, found 2"));
        assert!(refused(Seam { copies: vec![3], ..seam() }).contains("below 3, found a copy of vertex 3"));
        assert!(
            refused(Seam { faces: 2, ..seam() })
                .contains("triangle 1 of the original surface uses a vertex that was added to fill a cut")
        );
    }
}
