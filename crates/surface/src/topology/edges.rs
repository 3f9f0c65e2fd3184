//! Counts edges by their number of triangles, and finds vertices with several fans of triangles.

use super::is_degenerate;
use super::union_find::UnionFind;
use crate::mesh::Mesh;

/// Numbers of edges of each kind, and of vertices with several fans of triangles, as returned by [`count`].
#[derive(Debug, Default)]
pub(super) struct EdgeCounts {
    pub(super) edges: usize,
    pub(super) boundary: usize,
    pub(super) non_manifold: usize,
    pub(super) inconsistent: usize,
    pub(super) non_manifold_vertices: usize,
}

/// Returns the half-edge (or corner) that follows h in its triangle. The half-edge with number 3 * face + k runs from
/// corner k of the face to the next corner. The corner with the same number is where the half-edge starts.
fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

/// Items sorted into buckets. Bucket x is `items[starts[x]..starts[x + 1]]`.
struct Buckets {
    starts: Vec<u32>,
    items: Vec<(u32, u32)>,
}

impl Buckets {
    /// Sorts (bucket, item) pairs into buckets by counting. `list` is called twice and must produce the same pairs both
    /// times.
    fn new<I: Iterator<Item = (u32, (u32, u32))>>(buckets: usize, list: impl Fn() -> I) -> Self {
        let mut starts = vec![0_u32; buckets + 1];
        for (bucket, _) in list() {
            starts[bucket as usize + 1] += 1;
        }
        let mut total = 0;
        for start in &mut starts {
            total += *start;
            *start = total;
        }
        let mut items = vec![(0, 0); total as usize];
        let mut free = starts.clone();
        for (bucket, item) in list() {
            let slot = &mut free[bucket as usize];
            items[*slot as usize] = item;
            *slot += 1;
        }
        Self { starts, items }
    }

    /// Sorts the items of each bucket, and calls `f` with the bucket's index and its sorted items.
    fn for_each_sorted(mut self, mut f: impl FnMut(u32, &[(u32, u32)])) {
        for (bucket, range) in self.starts.windows(2).enumerate() {
            let items = &mut self.items[range[0] as usize..range[1] as usize];
            items.sort_unstable();
            f(bucket as u32, items);
        }
    }
}

/// Returns the half-edges of all triangles that aren't degenerate. Each half-edge is given by its lower vertex index,
/// its higher vertex index and its own number.
fn half_edges(faces: &[[u32; 3]]) -> impl Iterator<Item = (u32, (u32, u32))> {
    faces.iter().zip(0_u32..).filter(|(face, _)| !is_degenerate(**face)).flat_map(|(&[a, b, c], f)| {
        [(a, b), (b, c), (c, a)].into_iter().zip(3 * f..).map(|((from, to), h)| (from.min(to), (from.max(to), h)))
    })
}

/// Returns whether a surface has only one side. This is the case if, whichever triangles are turned, the two triangles
/// at some edge have inconsistent windings.
pub(super) fn is_one_sided(mesh: &Mesh) -> bool {
    let faces = &mesh.faces;
    let start = |h: u32| faces[(h / 3) as usize][(h % 3) as usize];
    // In the union-find structure, element f represents triangle f as given, and element f + turned represents triangle
    // f with reversed winding.
    let turned = faces.len() as u32;
    let mut agreeing = UnionFind::new(2 * faces.len());
    Buckets::new(mesh.vertices.len(), || half_edges(faces)).for_each_sorted(|_, bucket| {
        for edge in bucket.chunk_by(|x, y| x.0 == y.0) {
            let &[(_, g), (_, h)] = edge else { continue };
            let (f, [same, other]) = (g / 3, [h / 3, h / 3 + turned]);
            let [same, other] = if start(g) == start(h) { [other, same] } else { [same, other] };
            agreeing.join(f, same);
            agreeing.join(f + turned, other);
        }
    });
    (0..turned).any(|f| agreeing.root(f) == agreeing.root(f + turned))
}

/// Counts edges of each kind, and vertices whose triangles form more than one fan. Degenerate faces are ignored.
pub(super) fn count(mesh: &Mesh) -> EdgeCounts {
    let faces = &mesh.faces;
    let vertices = mesh.vertices.len();
    let start = |h: u32| faces[(h / 3) as usize][(h % 3) as usize];

    let mut counts = EdgeCounts::default();
    let mut corners = UnionFind::new(3 * faces.len());
    Buckets::new(vertices, || half_edges(faces)).for_each_sorted(|low, bucket| {
        for edge in bucket.chunk_by(|x, y| x.0 == y.0) {
            counts.edges += 1;
            match edge {
                [_] => counts.boundary += 1,
                [(_, g), (_, h)] => counts.inconsistent += usize::from(start(*g) == start(*h)),
                _ => counts.non_manifold += 1,
            }
            // At each end of an edge, the corners of the edge's triangles belong to the same fan.
            let ends = |h: u32| {
                if start(h) == low { (h, next(h)) } else { (next(h), h) }
            };
            for pair in edge.windows(2) {
                let (g, h) = (ends(pair[0].1), ends(pair[1].1));
                corners.join(g.0, h.0);
                corners.join(g.1, h.1);
            }
        }
    });

    // A vertex whose corners are in two sets has two fans. Sets are numbered from 1, since 0 means that no set has been
    // seen yet.
    let mut fan = vec![0_u32; vertices];
    let mut several = vec![false; vertices];
    for (face, f) in faces.iter().zip(0_u32..) {
        if is_degenerate(*face) {
            continue;
        }
        for (&v, corner) in face.iter().zip(3 * f..) {
            let root = corners.root(corner) + 1;
            let seen = &mut fan[v as usize];
            if *seen == 0 {
                *seen = root;
            } else if *seen != root {
                several[v as usize] = true;
            }
        }
    }
    counts.non_manifold_vertices = several.iter().filter(|&&s| s).count();
    counts
}

/// Returns the number of triangles that have the same three vertices, in any order, as an earlier triangle.
pub(super) fn duplicate_faces(mesh: &Mesh) -> usize {
    let sorted = || {
        mesh.faces.iter().map(|&face| {
            let mut corners = face;
            corners.sort_unstable();
            let [low, middle, high] = corners;
            (low, (middle, high))
        })
    };
    let mut duplicates = 0;
    Buckets::new(mesh.vertices.len(), sorted).for_each_sorted(|_, bucket| {
        duplicates += bucket.windows(2).filter(|pair| pair[0] == pair[1]).count();
    });
    duplicates
}
