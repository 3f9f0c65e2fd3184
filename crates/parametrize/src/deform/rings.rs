//! Lists each vertex's neighbours in cyclic order.

use spharm_surface::Mesh;

/// Each vertex's neighbours, counter-clockwise seen from outside.
pub(super) struct Rings {
    pub(super) starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Rings {
    /// Lists the neighbours of every vertex of a closed, consistently wound mesh.
    pub(super) fn new(mesh: &Mesh) -> Self {
        // In triangle (v, a, b), b follows a around v.
        let mut pairs: Vec<[u32; 3]> =
            mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b, c], [b, c, a], [c, a, b]]).collect();
        pairs.sort_unstable();
        let mut starts = vec![0];
        let mut neighbours = Vec::with_capacity(pairs.len());
        for fan in pairs.chunk_by(|x, y| x[0] == y[0]) {
            let mut next = fan[0][1];
            for _ in fan {
                neighbours.push(next);
                next = fan.binary_search_by_key(&next, |pair| pair[1]).map_or(next, |at| fan[at][2]);
            }
            starts.push(neighbours.len() as u32);
        }
        Self { starts, neighbours }
    }

    pub(super) fn of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}
