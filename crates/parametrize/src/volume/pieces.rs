//! What hangs together: the label's pieces, and the cavities in it.

use super::mask::{FACES, Mask, around};

/// Pieces, numbered from 1 by size, the largest first (of equal ones, the one that comes first in the volume).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pieces {
    /// Voxels in each.
    pub sizes: Vec<usize>,
    /// The piece of each voxel of the mask's box; 0 for none.
    pub of: Vec<u32>,
}

/// The label's pieces: voxels that share faces.
#[must_use]
pub fn pieces(mask: &Mask) -> Pieces {
    fill(mask, true, &FACES)
}

/// The parts of the background, connected over faces, edges and corners, that the outside doesn't reach.
pub(super) fn cavities(mask: &Mask) -> Pieces {
    let neighbours: Vec<[isize; 3]> = around().filter(|d| *d != [0; 3]).collect();
    let mut found = fill(mask, false, &neighbours);
    // The rim is one piece of background with all that it reaches; the first voxel is of it.
    let outside = found.of[0];
    for piece in &mut found.of {
        *piece = match (*piece).cmp(&outside) {
            std::cmp::Ordering::Less => *piece,
            std::cmp::Ordering::Equal => 0,
            std::cmp::Ordering::Greater => *piece - 1,
        };
    }
    found.sizes.remove(outside as usize - 1);
    found
}

fn fill(mask: &Mask, side: bool, neighbours: &[[isize; 3]]) -> Pieces {
    let mut of = vec![0_u32; mask.inside.len()];
    let mut sizes = Vec::new();
    let mut stack = Vec::new();
    for start in 0..of.len() {
        if of[start] != 0 || mask.inside[start] != side {
            continue;
        }
        let piece = sizes.len() as u32 + 1;
        let mut size = 0;
        of[start] = piece;
        stack.push(start);
        while let Some(voxel) = stack.pop() {
            size += 1;
            let at = mask.place(voxel);
            for d in neighbours {
                // Background reaches the box's border, where there are no neighbours beyond.
                let within = (0..3).all(|k| at[k].checked_add_signed(d[k]).is_some_and(|x| x < mask.size[k]));
                if !within {
                    continue;
                }
                let next = voxel.wrapping_add_signed(mask.step(*d));
                if of[next] == 0 && mask.inside[next] == side {
                    of[next] = piece;
                    stack.push(next);
                }
            }
        }
        sizes.push(size);
    }
    // Stable: equal ones stay in the volume's order.
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(sizes[i]));
    let mut rank = vec![0_u32; sizes.len() + 1];
    for (new, &old) in order.iter().enumerate() {
        rank[old + 1] = new as u32 + 1;
    }
    of.iter_mut().for_each(|piece| *piece = rank[*piece as usize]);
    Pieces { sizes: order.iter().map(|&i| sizes[i]).collect(), of }
}
