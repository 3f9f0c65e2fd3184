//! Works on rims of holes, which are loops of edges that belong to only one triangle each: welds rims that nearly
//! coincide, and fills small holes.

use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap, HashSet};

use super::MeshRepair;
use super::area_of;
use super::sheets::{by_edge, sides, start};
use crate::geometry::{Vec3, add, bounds, diagonal, dot, face_normal, sub};

/// Largest number of edges of a hole that [`repair`](super::repair) fills.
pub const LARGEST_FAN: usize = 32;
/// Largest distance at which vertices of rims are welded, as a fraction of the mesh's size. The size is the diagonal of
/// the mesh's bounding box, or twice the diagonal of the box around its [`bulk`], if that is smaller.
pub const WELDING_DISTANCE: f64 = 1e-5;
/// Vertices of rims are welded if their distance is at most [`WELDING_DISTANCE`], and at most this fraction of the
/// length of the shortest rim edge. Rim edges no longer than [`WELDING_DISTANCE`] are ignored in this comparison.
/// Welding therefore loses only triangles with edges shorter than [`WELDING_DISTANCE`].
const NEAR_OF_EDGE: f64 = 0.25;
/// Share of the area that may lie beyond each side of the box around the bulk of a mesh.
const OUTSIDE: f64 = 0.01;
/// The size of a mesh is the diagonal of its bounding box, but at most this multiple of the diagonal of the box around
/// the mesh's bulk.
const MOST_OF_BULK: f64 = 2.0;
/// Largest index of a cell along an axis. Indices of cells farther away are clamped, so that they fit into 64 bits.
const FARTHEST: f64 = 1e18;

/// Returns the edges that belong to only one triangle. The direction of each edge is opposite to its direction in the
/// triangle.
fn open_edges(faces: &[[u32; 3]]) -> Vec<(u32, u32)> {
    let sides = sides(faces);
    let open = by_edge(&sides).filter(|edge| edge.len() == 1).map(|edge| {
        let (low, high, side) = edge[0];
        if start(faces, side) == low { (high, low) } else { (low, high) }
    });
    let mut open: Vec<(u32, u32)> = open.collect();
    open.sort_unstable();
    open
}

/// Returns the rims of a mesh as loops of vertices. Each vertex of the mesh must have only one fan of triangles. A
/// rim's edges are directed opposite to their directions in the mesh's triangles. A triangle that fills the hole is
/// therefore wound consistently if it has the two vertices of a rim edge in the rim's order.
#[must_use]
pub fn rims(faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let open = open_edges(faces);
    let next: HashMap<u32, u32> = open.iter().copied().collect();
    let mut left: BTreeSet<u32> = next.keys().copied().collect();
    let mut rims = Vec::new();
    while let Some(first) = left.pop_first() {
        let mut rim = vec![first];
        while let Some(&at) = rim.last().and_then(|last| next.get(last)).filter(|at| left.remove(at)) {
            rim.push(at);
        }
        let closed = rim.last().and_then(|last| next.get(last)) == Some(&first);
        if closed && rim.len() > 2 {
            rims.push(rim);
        }
    }
    rims
}

/// Returns the diagonal of a mesh's bounding box, or twice the diagonal of the box around its [`bulk`], if that is
/// smaller. It is smaller if the mesh has specks far away.
fn size(vertices: &[Vec3], faces: &[[u32; 3]]) -> f64 {
    let whole = diagonal(bounds(faces.as_flattened().iter().map(|&v| vertices[v as usize])));
    let bulk = diagonal(bulk(vertices, faces));
    if bulk > 0.0 { whole.min(MOST_OF_BULK * bulk) } else { whole }
}

/// Returns the lowest and the highest corner of the box around the bulk of a mesh. The box leaves out 1 % of the area
/// on each side. The corners are NaN if the mesh has no area.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn bulk(vertices: &[Vec3], faces: &[[u32; 3]]) -> (Vec3, Vec3) {
    let at = |v: u32| vertices[v as usize];
    let areas: Vec<f64> = faces.iter().map(|face| area_of(vertices, face)).collect();
    let most = OUTSIDE * areas.iter().sum::<f64>();
    // Sums the areas of the triangles in ascending order of the coordinates that `smallest` returns, and returns the
    // coordinate at which the sum exceeds `most`.
    let quantile = |smallest: &dyn Fn(&[u32; 3]) -> f64| {
        let mut ends: Vec<(f64, f64)> = faces.iter().map(smallest).zip(areas.iter().copied()).collect();
        ends.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut before = 0.0;
        let end = ends.iter().find(|(_, area)| {
            before += area;
            before > most
        });
        end.map_or(f64::NAN, |end| end.0)
    };
    let least = |face: &[u32; 3], side: f64, axis: usize| {
        face.iter().map(|&v| side * at(v)[axis]).fold(f64::INFINITY, f64::min)
    };
    let low = [0, 1, 2].map(|axis| quantile(&|face| least(face, 1.0, axis)));
    let high = [0, 1, 2].map(|axis| -quantile(&|face| least(face, -1.0, axis)));
    (low, high)
}

/// Welds vertices on rims that are nearer to each other than [`WELDING_DISTANCE`], as happens if a mesh was written
/// with few digits. Returns the number of vertices merged with others.
pub(super) fn weld(vertices: &[Vec3], faces: &mut [[u32; 3]]) -> usize {
    let open = open_edges(faces);
    if open.is_empty() {
        return 0;
    }
    let at = |v: u32| vertices[v as usize];
    let length = |a: Vec3, b: Vec3| dot(sub(a, b), sub(a, b)).sqrt();
    let most = WELDING_DISTANCE * size(vertices, faces);
    let lengths = open.iter().map(|&(a, b)| length(at(a), at(b))).filter(|length| *length > most);
    let near = most.min(NEAR_OF_EDGE * lengths.fold(f64::INFINITY, f64::min));
    if !(near.is_finite() && near > 0.0) {
        return 0;
    }
    let rim: BTreeSet<u32> = open.into_iter().flat_map(|(a, b)| [a, b]).collect();
    // A vertex within the welding distance is in the same cell of a grid or in an adjacent cell.
    let cell = |v: u32| at(v).map(|x| (x / near).floor().clamp(-FARTHEST, FARTHEST) as i64);
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    let mut place: HashMap<u32, u32> = HashMap::new();
    for v in rim {
        let [x, y, z] = cell(v);
        let around = (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [x + i, y + j, z + k])));
        let others = around.filter_map(|cell| cells.get(&cell)).flatten();
        match others.copied().filter(|&other| length(at(other), at(v)) <= near).min() {
            Some(other) => drop(place.insert(v, other)),
            None => cells.entry([x, y, z]).or_default().push(v),
        }
    }
    for corner in faces.as_flattened_mut() {
        *corner = place.get(corner).copied().unwrap_or(*corner);
    }
    place.len()
}

/// Fills holes, which are bounded by loops of edges that belong to only one triangle each. A loop of three edges is
/// filled by one triangle, a loop of four by two, and a longer loop of up to [`LARGEST_FAN`] edges by a [`fan`] around
/// the mean of its vertices, if the fan is a proper surface.
pub(super) fn fill(vertices: &mut Vec<Vec3>, faces: &mut Vec<[u32; 3]>, found: &mut MeshRepair) {
    let edges: HashSet<(u32, u32)> = faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
    // Rims that meet at a vertex are separated by taking the shortest rim through each edge.
    let open = open_edges(faces);
    let mut next: HashMap<u32, Vec<u32>> = HashMap::new();
    open.iter().for_each(|&(from, to)| next.entry(from).or_default().push(to));
    for (from, to) in open {
        if !next.get(&from).is_some_and(|ends| ends.contains(&to)) {
            continue;
        }
        let Some(rim) = shortest(from, to, &next) else { continue };
        for (a, b) in rim.iter().zip(rim.iter().cycle().skip(1)) {
            if let Some(ends) = next.get_mut(a) {
                ends.retain(|end| end != b);
            }
        }
        let filling = match rim[..] {
            [a, b, c] => vec![[a, b, c]],
            [a, b, c, d] => {
                // A diagonal that is already an edge of the mesh can't be used.
                let taken = |p: u32, q: u32| edges.contains(&(p, q)) || edges.contains(&(q, p));
                quad(vertices, [a, b, c, d], taken)
            }
            _ => {
                let Some((middle, fan)) = fan(vertices, &rim) else { continue };
                vertices.push(middle);
                fan
            }
        };
        found.holes += 1;
        found.filled += filling.len();
        faces.extend(filling);
    }
}

/// Least area of a triangle, as a fraction of its longest edge squared. Thinner triangles have no accurate normal.
pub const LEAST_AREA: f64 = 1e-9;

/// Returns whether the corners of a triangle are on a line, up to rounding errors.
fn has_no_area([a, b, c]: [Vec3; 3]) -> bool {
    let longest = [sub(a, b), sub(b, c), sub(c, a)].map(|edge| dot(edge, edge)).into_iter().fold(0.0, f64::max);
    let normal = face_normal([a, b, c]);
    0.5 * dot(normal, normal).sqrt() <= LEAST_AREA * longest
}

/// Fills a rim of four edges with two triangles. Uses the shorter diagonal, unless this diagonal is `taken` by an edge
/// of the mesh, a triangle would have no area, or the triangles would face each other.
fn quad(vertices: &[Vec3], [a, b, c, d]: [u32; 4], taken: impl Fn(u32, u32) -> bool) -> Vec<[u32; 3]> {
    let length = |p: u32, q: u32| {
        let along = sub(vertices[p as usize], vertices[q as usize]);
        dot(along, along)
    };
    let [by_ac, by_bd] = [[[a, b, c], [a, c, d]], [[b, c, d], [b, d, a]]];
    let is_bad = |faces: &[[u32; 3]; 2]| {
        let [first, second] = faces.map(|face| face.map(|v| vertices[v as usize]));
        has_no_area(first) || has_no_area(second) || dot(face_normal(first), face_normal(second)) < 0.0
    };
    let use_bd = if taken(a, c) {
        true
    } else if taken(b, d) || is_bad(&by_bd) {
        false
    } else {
        length(b, d) < length(a, c) || is_bad(&by_ac)
    };
    (if use_bd { by_bd } else { by_ac }).to_vec()
}

/// Fills a rim with a fan of triangles around the mean of its vertices, and returns the mean and the fan. The mean gets
/// the next vertex number. Returns `None` if a triangle would have no area, or would face in the opposite direction to
/// the other triangles. In this case, the hole remains open.
fn fan(vertices: &[Vec3], rim: &[u32]) -> Option<(Vec3, Vec<[u32; 3]>)> {
    let sum = rim.iter().fold([0.0; 3], |sum, &v| add(sum, vertices[v as usize]));
    let middle = sum.map(|x| x / rim.len() as f64);
    let corners = |[a, b]: [u32; 2]| [vertices[a as usize], vertices[b as usize], middle];
    let ends = rim.iter().zip(rim.iter().cycle().skip(1)).map(|(&a, &b)| [a, b]);
    let normals: Vec<Vec3> = ends.clone().map(|end| face_normal(corners(end))).collect();
    let mean = normals.iter().fold([0.0; 3], |sum, normal| add(sum, *normal));
    let is_bad = |(end, normal): ([u32; 2], &Vec3)| has_no_area(corners(end)) || dot(*normal, mean) < 0.0;
    if ends.clone().zip(&normals).any(is_bad) {
        return None;
    }
    let number = vertices.len() as u32;
    Some((middle, ends.map(|[a, b]| [a, b, number]).collect()))
}

/// Returns the shortest rim that begins with a given edge; `None` if it has more than [`LARGEST_FAN`] edges.
fn shortest(from: u32, to: u32, next: &HashMap<u32, Vec<u32>>) -> Option<Vec<u32>> {
    let mut before = HashMap::from([(to, from)]);
    let mut front = vec![to];
    for _ in 1..LARGEST_FAN {
        let mut further = Vec::new();
        for at in front {
            for &end in next.get(&at).into_iter().flatten() {
                if end == from {
                    let mut rim = vec![at];
                    while rim.last() != Some(&from) {
                        rim.push(*before.get(rim.last()?)?);
                    }
                    rim.reverse();
                    return (rim.len() > 2).then_some(rim);
                }
                if let Entry::Vacant(new) = before.entry(end) {
                    new.insert(at);
                    further.push(end);
                }
            }
        }
        front = further;
    }
    None
}
