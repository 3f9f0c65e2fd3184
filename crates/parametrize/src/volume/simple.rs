//! Tests whether a voxel may be moved from inside a label to outside, or the reverse, without changing the topology.
//!
//! A voxel is *simple* if moving it to the other side preserves the topology of both sides (G. Bertrand and G.
//! Malandain, "A new characterization of three-dimensional simple points", Pattern Recognition Letters 15, 1994). For
//! (6, 26)-connectivity, a voxel is simple if, among its 26 neighbours,
//!
//! - exactly one piece of the inside shares a face with the voxel, where pieces are connected by faces within the 18
//!   neighbours that share a face or an edge with the voxel, and
//! - the outside is one piece, connected by faces, edges and corners.
//!
//! A *bare contact* is a pair of voxels on one side that share only an edge or a corner, while all other voxels around
//! that edge or corner are on the other side. The boundary of a set without bare contacts is a surface without doubled
//! vertices (L. Latecki, U. Eckhardt, A. Rosenfeld, "Well-composed sets", CVIU 61, 1995).

use std::sync::LazyLock;

/// A voxel (bit 13) and its 26 neighbours: each voxel has a bit, which is set if the voxel is inside. x varies fastest.
pub(super) type Around = u32;

/// For each of the 27 voxels in a block of 3 x 3 x 3 voxels: the voxels of the block that share a face with this voxel,
/// and the voxels that share at least a corner with it.
struct Neighbours {
    face: [Around; 27],
    any: [Around; 27],
}

static NEIGHBOURS: LazyLock<Neighbours> = LazyLock::new(|| {
    let at = |i: i32| [i % 3, i / 3 % 3, i / 9];
    let apart = |i: i32, j: i32| {
        let (p, q) = (at(i), at(j));
        let d: [i32; 3] = std::array::from_fn(|k| (p[k] - q[k]).abs());
        (d.iter().sum::<i32>(), d.into_iter().max().unwrap_or(0))
    };
    let of = |near: &dyn Fn(i32, i32) -> bool| {
        std::array::from_fn(|i| (0..27).filter(|&j| near(i as i32, j)).fold(0, |bits, j| bits | 1 << j))
    };
    Neighbours { face: of(&|i, j| apart(i, j).0 == 1), any: of(&|i, j| i != j && apart(i, j).1 == 1) }
});

const CENTRE: usize = 13;

/// The 18 neighbours that share a face or an edge with the centre.
const EIGHTEEN: Around = {
    let mut bits = 0;
    let mut i = 0;
    while i < 27 {
        let off = (i % 3 != 1) as u32 + (i / 3 % 3 != 1) as u32 + (i / 9 != 1) as u32;
        if off == 1 || off == 2 {
            bits |= 1 << i;
        }
        i += 1;
    }
    bits
};

const ALL: Around = ((1 << 27) - 1) & !(1 << CENTRE);

/// Returns the voxels of `seed`, and the voxels of `set` that are connected to them.
fn reach(seed: Around, set: Around, neighbours: &[Around; 27]) -> Around {
    let (mut reached, mut front) = (seed, seed);
    while front != 0 {
        let mut next = 0;
        while front != 0 {
            next |= neighbours[front.trailing_zeros() as usize];
            front &= front - 1;
        }
        front = next & set & !reached;
        reached |= front;
    }
    reached
}

/// Returns whether the voxel at the centre of a neighbourhood is simple, whether the voxel itself is inside or outside.
pub(super) fn is_simple(around: Around) -> bool {
    let n = &*NEIGHBOURS;
    let (inside, outside) = (around & EIGHTEEN, !around & ALL);
    let touching = inside & n.face[CENTRE];
    let lowest = |bits: Around| bits & bits.wrapping_neg();
    if touching == 0 || outside == 0 {
        return false;
    }
    let piece = reach(lowest(touching), inside, &n.face);
    touching & !piece == 0 && reach(lowest(outside), outside, &n.any) == outside
}

/// Returns whether there is a bare contact, as defined at the top of this file, at an edge or a corner of the centre
/// voxel.
pub(super) fn has_bare_contact(around: Around) -> bool {
    let inside = |[x, y, z]: [i32; 3]| around >> (x + 3 * y + 9 * z) & 1 == 1;
    // Tests the eight blocks of 2 x 2 x 2 voxels that contain the centre.
    (0..8).any(|block| {
        let low = [block & 1, block >> 1 & 1, block >> 2];
        let of = |corner: i32| inside([low[0] + (corner & 1), low[1] + (corner >> 1 & 1), low[2] + (corner >> 2)]);
        let sides: u8 = (0..8).fold(0, |bits, corner| bits | u8::from(of(corner)) << corner);
        // Contact at a corner: exactly two opposite corners of the block are on one side.
        let corner = |sides: u8| matches!(sides, 0b1000_0001 | 0b0100_0010 | 0b0010_0100 | 0b0001_1000);
        // Contact at an edge: on a face of the block, two diagonal voxels are on one side and the other two on the
        // other side.
        let face = |[a, b, c, d]: [u8; 4]| {
            let side = |i: u8| sides >> i & 1;
            side(a) == side(d) && side(b) == side(c) && side(a) != side(b)
        };
        const FACES: [[u8; 4]; 6] =
            [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 4, 5], [2, 3, 6, 7], [0, 2, 4, 6], [1, 3, 5, 7]];
        corner(sides) || corner(!sides) || FACES.into_iter().any(face)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(inside: &[[i32; 3]]) -> Around {
        inside.iter().fold(0, |bits, [x, y, z]| bits | 1 << (x + 1 + 3 * (y + 1) + 9 * (z + 1)))
    }

    #[test]
    fn simple_points_are_those_of_the_textbook() {
        assert!(!is_simple(0), "an isolated voxel");
        assert!(!is_simple(ALL), "a cavity");
        assert!(is_simple(bits(&[[1, 0, 0]])), "an end");
        assert!(!is_simple(bits(&[[1, 0, 0], [-1, 0, 0]])), "a bridge");
        assert!(!is_simple(bits(&[[1, 1, 0]])), "voxels that share only an edge aren't connected");
        assert!(is_simple(bits(&[[1, 0, 0], [1, 1, 0], [0, 1, 0]])), "the corner of a square");
        assert!(!is_simple(bits(&[[1, 0, 0], [0, 1, 0]])), "the bend of a chain");
        let flat: Vec<[i32; 3]> = (0..9).map(|i| [i % 3 - 1, i / 3 - 1, -1]).collect();
        assert!(is_simple(bits(&flat)), "a voxel on a plane");
        assert!(!is_simple(ALL & !bits(&[[1, 0, 0], [-1, 0, 0]])), "a tunnel");
    }

    #[test]
    fn bare_contacts_are_edges_and_corners_alone() {
        let centre = 1 << CENTRE;
        assert!(!has_bare_contact(centre) && !has_bare_contact(centre | bits(&[[1, 0, 0]])));
        assert!(has_bare_contact(centre | bits(&[[1, 1, 0]])));
        assert!(has_bare_contact(centre | bits(&[[1, 1, 1]])));
        assert!(!has_bare_contact(centre | bits(&[[1, 1, 0], [1, 0, 0]])));
        assert!(has_bare_contact(ALL & !bits(&[[1, 1, 1]])), "two of the background");
    }
}
