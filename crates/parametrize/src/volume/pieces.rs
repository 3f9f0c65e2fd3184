//! Finds the connected pieces of a label, and its cavities.

use spharm_monitor::{Interrupted, Monitor};

use super::mask::{FACES, Mask, around};

/// Connected pieces, numbered from 1 in order of decreasing size. Pieces of equal size are in the order of their first
/// voxels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pieces {
    /// Number of voxels of each piece.
    pub sizes: Vec<usize>,
    /// For each voxel of the mask's box, the number of its piece; 0 if it belongs to no piece.
    pub of: Vec<u32>,
}

/// Returns the pieces of a label; voxels that share a face are connected.
///
/// # Errors
///
/// [`Interrupted`] when the monitor asks to stop.
pub fn pieces(mask: &Mask, monitor: &dyn Monitor) -> Result<Pieces, Interrupted> {
    fill(mask, true, &FACES, monitor)
}

/// Returns the cavities: the pieces of the background that aren't connected to the outside. Background voxels that
/// share a face, an edge or a corner are connected.
pub(super) fn cavities(mask: &Mask, monitor: &dyn Monitor) -> Result<Pieces, Interrupted> {
    let neighbours: Vec<[isize; 3]> = around().filter(|d| *d != [0; 3]).collect();
    let mut found = fill(mask, false, &neighbours, monitor)?;
    // The first voxel is in the mask's rim of background voxels, so its piece is the background outside the label.
    let outside = found.of[0];
    for piece in &mut found.of {
        *piece = match (*piece).cmp(&outside) {
            std::cmp::Ordering::Less => *piece,
            std::cmp::Ordering::Equal => 0,
            std::cmp::Ordering::Greater => *piece - 1,
        };
    }
    found.sizes.remove(outside as usize - 1);
    Ok(found)
}

/// Number of voxels between checks of the monitor.
const CHUNK: usize = 1 << 18;

fn fill(mask: &Mask, side: bool, neighbours: &[[isize; 3]], monitor: &dyn Monitor) -> Result<Pieces, Interrupted> {
    let mut of = vec![0_u32; mask.inside.len()];
    let mut sizes = Vec::new();
    let mut stack = Vec::new();
    let mut visited = 0;
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
            visited += 1;
            if visited % CHUNK == 0 {
                monitor.check()?;
            }
            let at = mask.place(voxel);
            for d in neighbours {
                // Neighbours beyond the box's border are skipped; only background voxels have such neighbours.
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
    // A stable sort keeps pieces of equal size in the order of their first voxels.
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(sizes[i]));
    let mut rank = vec![0_u32; sizes.len() + 1];
    for (new, &old) in order.iter().enumerate() {
        rank[old + 1] = new as u32 + 1;
    }
    of.iter_mut().for_each(|piece| *piece = rank[*piece as usize]);
    Ok(Pieces { sizes: order.iter().map(|&i| sizes[i]).collect(), of })
}
