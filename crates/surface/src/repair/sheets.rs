//! Converts a set of triangles to a surface: drops fins and inner walls, turns triangles that disagree with their
//! neighbours, and separates parts that touch at a vertex or along an edge.
//!
//! Edges of more than two triangles are resolved as by A. Guéziec, G. Taubin, F. Lazarus and B. Horn (Cutting and
//! Stitching, IEEE Trans. Visualization and Computer Graphics 7, 2001): the surface is cut along them, and sides that
//! belong together are joined again.

use std::collections::{BTreeMap, HashMap, HashSet};

use super::area_of;
use crate::geometry::{Vec3, add, cross, dot, face_normal, scale, sub, unit};
use crate::topology::UnionFind;

/// Largest fraction of the area that is dropped as fins and inner walls. Larger parts are unlikely to be defects.
const LARGEST_FINS: f64 = 0.05;
/// Marks a side of a triangle that isn't joined to another side.
const OPEN: u32 = u32::MAX;

/// A side of a triangle: the lower and the higher vertex of its edge, and the side's number. Side k of triangle f runs
/// from corner k to the next corner and has the number 3 f + k.
type Side = (u32, u32, u32);

/// Returns the sides of all triangles, sorted such that sides of the same edge are next to each other.
pub(super) fn sides(faces: &[[u32; 3]]) -> Vec<Side> {
    let of = |(&[a, b, c], f): (&[u32; 3], u32)| {
        [(a, b), (b, c), (c, a)].into_iter().zip(3 * f..).map(|((p, q), side)| (p.min(q), p.max(q), side))
    };
    let mut sides: Vec<Side> = faces.iter().zip(0..).flat_map(of).collect();
    sides.sort_unstable();
    sides
}

/// Groups sorted sides by edge.
pub(super) fn by_edge(sides: &[Side]) -> impl Iterator<Item = &[Side]> {
    sides.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
}

/// Returns the vertex at which a side begins.
pub(super) fn start(faces: &[[u32; 3]], side: u32) -> u32 {
    faces[side as usize / 3][side as usize % 3]
}

/// Returns the pieces that result if the surface is cut along all edges of more than two triangles.
fn pieces(faces: &[[u32; 3]], sides: &[Side]) -> UnionFind {
    let mut pieces = UnionFind::new(faces.len());
    for edge in by_edge(sides) {
        if let [a, b] = edge {
            pieces.join(a.2 / 3, b.2 / 3);
        }
    }
    pieces
}

/// Drops pieces that end at an edge of more than two triangles, such as fins and walls between chambers. At each such
/// edge, pieces are dropped until two triangles are left: first pieces with a rim, then the smallest ones. Returns the
/// number of triangles dropped, and their share of the area.
pub(super) fn drop_fins(vertices: &[Vec3], faces: &mut Vec<[u32; 3]>) -> (usize, f64) {
    let given = faces.len();
    let all: f64 = faces.iter().map(|face| area_of(vertices, face)).sum();
    let most = LARGEST_FINS * all;
    let mut left = most;
    loop {
        let sides = sides(faces);
        if by_edge(&sides).all(|edge| edge.len() < 3) {
            break;
        }
        let mut pieces = pieces(faces, &sides);
        let mut areas: HashMap<u32, f64> = HashMap::new();
        for (face, f) in faces.iter().zip(0..) {
            *areas.entry(pieces.root(f)).or_default() += area_of(vertices, face);
        }
        let rims = by_edge(&sides).filter(|edge| edge.len() == 1).map(|edge| pieces.root(edge[0].2 / 3));
        let rims: HashSet<u32> = rims.collect();
        let before = |a: &u32, b: &u32| {
            rims.contains(b).cmp(&rims.contains(a)).then(areas[a].total_cmp(&areas[b])).then(a.cmp(b))
        };
        let mut fins: HashSet<u32> = HashSet::new();
        for edge in by_edge(&sides).filter(|edge| edge.len() > 2) {
            let mut roots: Vec<u32> = edge.iter().map(|side| pieces.root(side.2 / 3)).collect();
            roots.sort_unstable();
            // A piece with an odd number of triangles at the edge ends at this edge.
            let ends = roots.chunk_by(|a, b| a == b).filter(|same| same.len() % 2 == 1);
            let mut ends: Vec<(u32, usize)> = ends.map(|same| (same[0], same.len())).collect();
            ends.sort_unstable_by(|a, b| before(&a.0, &b.0));
            let of_fins = ends.iter().filter(|(root, _)| fins.contains(root)).map(|(_, count)| count).sum::<usize>();
            let mut more = (edge.len() - 2).saturating_sub(of_fins);
            for (root, count) in ends {
                if count <= more && areas[&root] <= left && fins.insert(root) {
                    more -= count;
                }
            }
        }
        let mut fins: Vec<u32> = fins.into_iter().collect();
        fins.sort_unstable_by(before);
        fins.retain(|root| {
            let fits = areas[root] <= left;
            left -= if fits { areas[root] } else { 0.0 };
            fits
        });
        if fins.is_empty() {
            break;
        }
        let mut f = 0..;
        faces.retain(|_| f.next().is_some_and(|f| !fins.contains(&pieces.root(f))));
    }
    let dropped = given - faces.len();
    (dropped, if dropped > 0 && all > 0.0 { (most - left) / all } else { 0.0 })
}

/// The choice of sides to join at an edge where a surface touches itself.
#[derive(Clone, Copy)]
enum Join {
    /// Joins the sides of two triangles if the body is between the triangles, so that the body ends at the edge.
    AcrossBody,
    /// Joins the sides of two triangles if the outside is between the triangles, so that the body continues through the
    /// edge.
    AcrossOutside,
}

/// Returns, for each side of each triangle, the side of another triangle to which it is joined, or [`OPEN`] if it isn't
/// joined.
fn joined(vertices: &[Vec3], faces: &[[u32; 3]], how: Join) -> Vec<u32> {
    let sides = sides(faces);
    let mut pieces = pieces(faces, &sides);
    let mut joined = pairs(faces, &sides);
    let mut join = |a: u32, b: u32| (joined[a as usize], joined[b as usize]) = (b, a);
    for edge in by_edge(&sides).filter(|edge| edge.len() > 2) {
        let mut by_piece: Vec<(u32, u32)> = edge.iter().map(|side| (pieces.root(side.2 / 3), side.2)).collect();
        by_piece.sort_unstable();
        for same in by_piece.chunk_by(|a, b| a.0 == b.0) {
            match same {
                [a, b] => join(a.1, b.1),
                _ => wedges(vertices, faces, edge[0], same, how).into_iter().for_each(|[a, b]| join(a, b)),
            }
        }
    }
    joined
}

/// Returns for each side the other side of its edge, or [`OPEN`] if the edge doesn't have exactly two triangles.
fn pairs(faces: &[[u32; 3]], sides: &[Side]) -> Vec<u32> {
    let mut other = vec![OPEN; 3 * faces.len()];
    for edge in by_edge(sides) {
        if let [a, b] = edge {
            (other[a.2 as usize], other[b.2 as usize]) = (b.2, a.2);
        }
    }
    other
}

/// Returns the pairs of sides to join, given several sides at one edge. The triangles of a pair are neighbours around
/// the edge. Returns no pairs unless body and outside alternate between the triangles.
fn wedges(
    vertices: &[Vec3],
    faces: &[[u32; 3]],
    (low, high, _): Side,
    sides: &[(u32, u32)],
    how: Join,
) -> Vec<[u32; 2]> {
    let at = |v: u32| vertices[v as usize];
    let axis = unit(sub(at(high), at(low)));
    let across = |v: u32| {
        let to = sub(at(v), at(low));
        let along = dot(to, axis);
        [0, 1, 2].map(|k| to[k] - along * axis[k])
    };
    let apex = |side: u32| faces[side as usize / 3][(side as usize % 3 + 2) % 3];
    let first = unit(across(apex(sides[0].1)));
    let second = cross(axis, first);
    // Each side has an entry with three values. The first is the angle of the side's triangle around the edge,
    // counter-clockwise if the edge points towards the viewer. The second states whether the side runs in the direction
    // of the edge. The third is the side's number.
    let mut around: Vec<(f64, bool, u32)> = sides
        .iter()
        .map(|&(_, side)| {
            let to = across(apex(side));
            (dot(to, second).atan2(dot(to, first)), start(faces, side) == low, side)
        })
        .collect();
    around.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = around.len();
    let alternate = count.is_multiple_of(2) && (0..count).all(|i| around[i].1 != around[(i + 1) % count].1);
    if !alternate {
        return Vec::new();
    }
    // If a triangle's side runs in the direction of the edge, the outside lies at larger angles than the triangle, and
    // the body at smaller ones.
    let other = match how {
        Join::AcrossBody => count - 1,
        Join::AcrossOutside => 1,
    };
    (0..count).filter(|&i| around[i].1).map(|i| [around[(i + other) % count].2, around[i].2]).collect()
}

/// Turns triangles so that all triangles of a piece agree with their neighbours. The part of the piece with the smaller
/// area is turned. Returns the number of triangles turned. A one-sided surface, such as a Möbius strip, isn't changed.
pub(super) fn orient(vertices: &[Vec3], faces: &mut [[u32; 3]]) -> usize {
    let joined = pairs(faces, &sides(faces));
    let mut turned: Vec<Option<bool>> = vec![None; faces.len()];
    let mut count = 0;
    for first in 0..faces.len() {
        if turned[first].is_some() {
            continue;
        }
        turned[first] = Some(false);
        let (mut piece, mut at, mut one_sided) = (vec![first], 0, false);
        while let Some(&f) = piece.get(at) {
            at += 1;
            for side in 3 * f as u32..3 * f as u32 + 3 {
                let other = joined[side as usize];
                if other == OPEN {
                    continue;
                }
                let agree = start(faces, side) != start(faces, other);
                let wanted = (turned[f] == Some(true)) == agree;
                match &mut turned[other as usize / 3] {
                    Some(is) => one_sided |= *is != wanted,
                    unset => {
                        *unset = Some(wanted);
                        piece.push(other as usize / 3);
                    }
                }
            }
        }
        if one_sided {
            continue;
        }
        let area = |which: bool| -> f64 {
            let of = piece.iter().filter(|&&f| turned[f] == Some(which));
            of.map(|&f| area_of(vertices, &faces[f])).sum()
        };
        let least = area(true) <= area(false);
        for &f in &piece {
            if turned[f] == Some(least) {
                let [a, b, c] = faces[f];
                faces[f] = [a, c, b];
                count += 1;
            }
        }
    }
    count
}

/// Turns all triangles of a closed surface that is wound inwards, and returns whether they were turned. An open surface
/// isn't changed.
pub(super) fn turn_closed_outward(vertices: &[Vec3], faces: &mut [[u32; 3]]) -> bool {
    let sides = sides(faces);
    let closed = !faces.is_empty() && by_edge(&sides).all(|edge| edge.len() == 2);
    let inwards = closed && volume(vertices, faces, 0..faces.len()) < 0.0;
    if inwards {
        faces.iter_mut().for_each(|face| face.swap(1, 2));
    }
    inwards
}

/// Returns six times the signed volume between the given triangles and the centre of their area.
fn volume(vertices: &[Vec3], faces: &[[u32; 3]], group: impl Iterator<Item = usize> + Clone) -> f64 {
    let corners = |f: usize| faces[f].map(|v| vertices[v as usize]);
    let weighted = |f: usize| {
        let [a, b, c] = corners(f);
        let area = area_of(vertices, &faces[f]);
        [0, 1, 2].map(|k| area * (a[k] + b[k] + c[k]) / 3.0)
    };
    let area: f64 = group.clone().map(|f| area_of(vertices, &faces[f])).sum();
    let sum = group.clone().fold([0.0; 3], |sum, f| add(sum, weighted(f)));
    let centre = scale(sum, 1.0 / area.max(f64::MIN_POSITIVE));
    group.map(|f| dot(sub(corners(f)[0], centre), face_normal(corners(f)))).sum()
}

/// Turns each closed piece that is wound inwards, and turns all open pieces together if the signed volume between their
/// triangles and the centre of their area is negative. A single open piece, such as a flat side of a box or the inside
/// of a bowl, doesn't show which side is outside.
pub(super) fn turn_outward(vertices: &[Vec3], faces: &mut [[u32; 3]]) {
    const ALL_OPEN: u32 = u32::MAX;
    let sides = sides(faces);
    let mut pieces = pieces(faces, &sides);
    let open = by_edge(&sides).filter(|edge| edge.len() != 2).flatten();
    let open: HashSet<u32> = open.map(|side| pieces.root(side.2 / 3)).collect();
    let mut groups: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for f in 0..faces.len() {
        let root = pieces.root(f as u32);
        groups.entry(if open.contains(&root) { ALL_OPEN } else { root }).or_default().push(f);
    }
    for group in groups.into_values() {
        if volume(vertices, faces, group.iter().copied()) < 0.0 {
            group.into_iter().for_each(|f| faces[f].swap(1, 2));
        }
    }
}

/// Keeps only the piece with the largest area. In case of ties, keeps the first of the largest pieces. Triangles with
/// joined sides belong to the same piece. Returns the number of pieces dropped, their share of the area, and the number
/// of dropped pieces that shared edges with the kept piece.
pub(super) fn keep_largest(vertices: &[Vec3], faces: &mut Vec<[u32; 3]>) -> (usize, f64, usize) {
    let mut pieces = UnionFind::new(faces.len());
    for (side, &other) in (0..).zip(&joined(vertices, faces, Join::AcrossBody)).filter(|(_, other)| **other != OPEN) {
        pieces.join(side / 3, other / 3);
    }
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    for (face, f) in faces.iter().zip(0..) {
        *areas.entry(pieces.root(f)).or_default() += area_of(vertices, face);
    }
    let all: f64 = areas.values().sum();
    let largest = areas.iter().rev().max_by(|a, b| a.1.total_cmp(b.1));
    let Some((&root, &area)) = largest.filter(|_| areas.len() > 1) else { return (0, 0.0, 0) };
    let mut attached: HashSet<u32> = HashSet::new();
    for edge in by_edge(&sides(faces)).filter(|edge| edge.len() > 2) {
        let roots: Vec<u32> = edge.iter().map(|side| pieces.root(side.2 / 3)).collect();
        if roots.contains(&root) {
            attached.extend(roots.into_iter().filter(|&other| other != root));
        }
    }
    let mut f = 0..;
    faces.retain(|_| f.next().is_some_and(|f| pieces.root(f) == root));
    (areas.len() - 1, if all > 0.0 { (1.0 - area / all).max(0.0) } else { 0.0 }, attached.len())
}

/// Gives each fan of triangles around a vertex a separate vertex. Where the surface touches itself along an edge, the
/// body ends at the edge or continues through it, whichever gives fewer handles. Returns the number of vertices added.
pub(super) fn split(vertices: &mut Vec<Vec3>, faces: &mut [[u32; 3]]) -> usize {
    let [(ends, most), (goes_on, other)] =
        [Join::AcrossBody, Join::AcrossOutside].map(|how| fans(faces, &joined(vertices, faces, how)));
    let mut corners = if most >= other { ends } else { goes_on };
    let before = vertices.len();
    let mut first = vec![OPEN; before];
    let mut added: HashMap<u32, u32> = HashMap::new();
    for (number, corner) in (0..).zip(faces.as_flattened_mut()) {
        let (vertex, fan) = (*corner as usize, corners.root(number));
        if first[vertex] == OPEN {
            first[vertex] = fan;
        } else if first[vertex] != fan {
            *corner = *added.entry(fan).or_insert_with(|| {
                vertices.push(vertices[vertex]);
                (vertices.len() - 1) as u32
            });
        }
    }
    vertices.len() - before
}

/// Returns the fans of triangles around vertices as sets of corners, and the Euler characteristic of the surface in
/// which each fan has its own vertex. Corner k of triangle f has the number 3 f + k.
fn fans(faces: &[[u32; 3]], joined: &[u32]) -> (UnionFind, i64) {
    let mut corners = UnionFind::new(joined.len());
    let next = |side: u32| if side % 3 == 2 { side - 2 } else { side + 1 };
    let mut twice_edges = 0;
    for (side, &other) in (0..).zip(joined) {
        twice_edges += if other == OPEN { 2 } else { 1 };
        if other != OPEN {
            // The corner and the side with the same number belong together: the side begins at this corner.
            let agree = start(faces, side) != start(faces, other);
            let (from, to) = if agree { (next(other), other) } else { (other, next(other)) };
            corners.join(side, from);
            corners.join(next(side), to);
        }
    }
    let characteristic = corners.sets() as i64 - twice_edges / 2 + faces.len() as i64;
    (corners, characteristic)
}
