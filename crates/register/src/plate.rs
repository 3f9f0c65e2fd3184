//! Computes the bending energy of a thin plate over a template's triangles: `|L v|^2` for displacements v of the
//! vertices, where L is the graph Laplacian with each row divided by the vertex's number of neighbours. All neighbours
//! have equal weights, because the triangles have nearly equal sizes.

use spharm_linalg::{MatMut, SparseFactor, SparsePattern};
use spharm_surface::geometry::Vec3;

use crate::error::RegisterError;

/// The pattern of a sparse matrix: `columns` lists the column indices of the entries, row by row. `starts` has the
/// index in `columns` at which each row begins.
pub(crate) struct Rows {
    pub(crate) starts: Vec<u32>,
    pub(crate) columns: Vec<u32>,
}

impl Rows {
    pub(crate) fn row(&self, row: usize) -> &[u32] {
        &self.columns[self.range(row)]
    }

    fn range(&self, row: usize) -> std::ops::Range<usize> {
        self.starts[row] as usize..self.starts[row + 1] as usize
    }

    fn from_pairs(mut pairs: Vec<(u32, u32)>, n: usize) -> Self {
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0u32; n + 1];
        pairs.iter().for_each(|(row, _)| starts[*row as usize + 1] += 1);
        (1..=n).for_each(|row| starts[row] += starts[row - 1]);
        Self { starts, columns: pairs.into_iter().map(|(_, column)| column).collect() }
    }
}

/// The bending energy of a mesh as a quadratic form in the displacements of the mesh's vertices.
pub struct Plate {
    /// The neighbours of each vertex.
    pub(crate) rings: Rows,
    /// The triangles of each vertex.
    of_vertices: Rows,
    /// Pattern of the symmetric matrix `L^T L` with the graph Laplacian L: pairs of vertices at most two edges apart.
    pattern: Rows,
    values: Vec<f64>,
    lower: SparsePattern,
}

/// A symmetric matrix with the sparsity pattern of a plate's bending energy.
pub(crate) struct PlateMatrix<'a> {
    plate: &'a Plate,
    values: Vec<f64>,
}

/// The Cholesky factor of a [`PlateMatrix`], which solves for three columns at once.
pub(crate) struct PlateFactor(SparseFactor);

impl Plate {
    pub(crate) fn new(faces: &[[u32; 3]], n: usize) -> Result<Self, RegisterError> {
        let edges = faces.iter().flat_map(|[a, b, c]| [(*a, *b), (*b, *a), (*b, *c), (*c, *b), (*c, *a), (*a, *c)]);
        let rings = Rows::from_pairs(edges.collect(), n);
        let corners = (0..).zip(faces).flat_map(|(index, face)| face.map(|v| (v, index)));
        let of_vertices = Rows::from_pairs(corners.collect(), n);
        // The row of a vertex in the Laplacian L has -1 on the diagonal, and 1 / k at each of the vertex's k
        // neighbours. An entry (v, w) of L^T L is a sum over the rows of L that have entries in both columns v and w.
        let row = |v: usize| {
            let ring = rings.row(v);
            let weight = 1.0 / ring.len().max(1) as f64;
            let own = if ring.is_empty() { 0.0 } else { -1.0 };
            std::iter::once((v as u32, own)).chain(ring.iter().map(move |w| (*w, weight)))
        };
        let mut pairs = Vec::new();
        for v in 0..n {
            let members: Vec<u32> = row(v).map(|(w, _)| w).collect();
            pairs.extend(members.iter().flat_map(|a| members.iter().map(|b| (*a, *b))));
        }
        let pattern = Rows::from_pairs(pairs, n);
        let mut matrix = vec![0.0; pattern.columns.len()];
        for v in 0..n {
            for (a, of_a) in row(v) {
                for (b, of_b) in row(v) {
                    if let Some(at) = place(&pattern, a, b) {
                        matrix[at] += of_a * of_b;
                    }
                }
            }
        }
        let (mut begins, mut rows) = (vec![0usize], Vec::new());
        for v in 0..n {
            rows.extend(pattern.row(v).iter().map(|w| *w as usize).filter(|w| *w >= v));
            begins.push(rows.len());
        }
        let lower = SparsePattern::new(begins, rows).ok_or(RegisterError::Singular)?;
        Ok(Self { rings, of_vertices, pattern, values: matrix, lower })
    }

    /// Returns the triangles of a vertex.
    pub(crate) fn faces_of(&self, v: usize) -> &[u32] {
        self.of_vertices.row(v)
    }

    /// Returns the matrix `L^T L` of the bending energy, multiplied by a stiffness.
    pub(crate) fn times(&self, stiffness: f64) -> PlateMatrix<'_> {
        PlateMatrix { plate: self, values: self.values.iter().map(|value| stiffness * value).collect() }
    }

    /// Returns `(L v)` at a vertex: the vector from the vertex to the mean of its neighbours.
    pub(crate) fn to_mean(&self, v: usize, of: &[Vec3]) -> Vec3 {
        let ring = self.rings.row(v);
        let share = 1.0 / ring.len().max(1) as f64;
        let mut sum = [0.0; 3];
        for w in ring {
            (0..3).for_each(|k| sum[k] += share * (of[*w as usize][k] - of[v][k]));
        }
        sum
    }
}

/// Returns the index of an entry in the pattern. The columns of each row must be sorted.
fn place(pattern: &Rows, row: u32, column: u32) -> Option<usize> {
    let range = pattern.range(row as usize);
    let at = pattern.columns[range.clone()].binary_search(&column).ok()?;
    Some(range.start + at)
}

impl PlateMatrix<'_> {
    /// Adds a value to an entry. The row and the column of the entry must be the same vertex, or vertices of one
    /// triangle.
    pub(crate) fn add(&mut self, row: u32, column: u32, value: f64) {
        if let Some(at) = place(&self.plate.pattern, row, column) {
            self.values[at] += value;
        }
    }

    /// Adds the product of the matrix and `of` (n, 3) to `out`.
    pub(crate) fn add_product(&self, of: &[Vec3], out: &mut [Vec3]) {
        for (v, out) in out.iter_mut().enumerate() {
            for at in self.plate.pattern.range(v) {
                let (w, value) = (self.plate.pattern.columns[at] as usize, self.values[at]);
                (0..3).for_each(|k| out[k] += value * of[w][k]);
            }
        }
    }

    pub(crate) fn factor(&self) -> Result<PlateFactor, RegisterError> {
        let plate = self.plate;
        let mut lower = Vec::with_capacity(plate.lower.entries());
        for v in 0..plate.pattern.starts.len() - 1 {
            lower.extend(
                plate.pattern.range(v).filter(|at| plate.pattern.columns[*at] as usize >= v).map(|at| self.values[at]),
            );
        }
        plate.lower.factor(&lower).map(PlateFactor).ok_or(RegisterError::Singular)
    }
}

impl PlateFactor {
    pub(crate) fn solve(&self, right: &[Vec3]) -> Vec<Vec3> {
        let n = right.len();
        let mut columns: Vec<f64> = (0..3).flat_map(|k| right.iter().map(move |value| value[k])).collect();
        self.0.solve(MatMut::from_column_major_slice_mut(&mut columns, n, 3));
        (0..n).map(|i| std::array::from_fn(|k| columns[k * n + i])).collect()
    }
}
