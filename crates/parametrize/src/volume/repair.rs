//! Repairs any label so that it is a single ball of voxels without bare contacts (defined in
//! [`simple`](super::simple)).
//!
//! The largest piece is kept and its cavities are filled. Handles are removed in one of two ways, whichever changes
//! fewer voxels:
//!
//! - *cutting*: a ball grows inside the label from the label's innermost voxel, taking the voxels farthest from the
//!   background first. The ball takes a voxel only if the voxel is simple and this leaves no bare contact. Voxels that
//!   would close a ring are therefore never taken, which cuts the handle where it is thinnest.
//! - *filling*: the box around the label shrinks onto the label, removing the voxels farthest from the label first,
//!   under the same conditions. Voxels whose removal would open a ring are kept, which covers the hole with a lid.
//!
//! Both ways give a set with the topology of a ball, for any label. The report contains the number of changed voxels.
//! Cost: O(n log n) for a box of n voxels.

use std::collections::BinaryHeap;

use serde::Serialize;
use spharm_monitor::{Interrupted, Monitor, Stage};

use super::boundary::QuadMesh;
use super::mask::{Mask, around};
use super::pieces::{Pieces, cavities, pieces};
use super::simple::{Around, has_bare_contact, is_simple};

/// The way in which a repair removed handles and bare contacts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HandleRepair {
    /// Voxels were removed.
    Cut,
    /// Voxels were added.
    Filled,
}

/// A change of more than this share of a label's voxels is reported as large.
const LARGE: f64 = 0.05;
/// A label with at least this number of large dropped pieces is probably a mask of many bodies.
const MANY_BODIES: usize = 3;

/// The changes that a repair made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Repair {
    /// Number of pieces dropped, which are all except the largest.
    pub pieces_dropped: usize,
    /// Number of voxels of the dropped pieces.
    pub voxels_dropped: usize,
    /// Number of dropped pieces that have at least a quarter as many voxels as the largest piece.
    #[serde(skip)]
    pub large_pieces_dropped: usize,
    /// Number of the label's voxels before the repair.
    #[serde(skip)]
    pub voxels_before: usize,
    /// Number of cavities filled.
    pub cavities_filled: usize,
    /// Number of voxels of the filled cavities.
    pub voxels_filled: usize,
    /// Number of handles removed from the largest piece.
    #[serde(rename = "handles")]
    pub handles_removed: usize,
    /// The way in which handles and bare contacts were removed.
    #[serde(rename = "way")]
    pub handles: HandleRepair,
    /// Number of voxels changed to remove handles and contacts of voxels at a single edge or corner.
    pub voxels_changed: usize,
}

impl Repair {
    /// Returns the total number of voxels that were added or removed.
    #[must_use]
    pub fn voxels(&self) -> usize {
        self.voxels_dropped + self.voxels_filled + self.voxels_changed
    }

    /// Returns the dropped pieces' share of the label's voxels, from 0 to 1.
    #[must_use]
    pub fn share_dropped(&self) -> f64 {
        self.share(self.voxels_dropped)
    }

    /// Returns whether more than 5 % of the label's voxels were dropped, filled or changed. The label or its
    /// segmentation may then be wrong.
    #[must_use]
    pub fn is_large_loss(&self) -> bool {
        self.share(self.voxels()) > LARGE
    }

    /// Returns the given number of voxels as a share of the label's voxels.
    fn share(&self, voxels: usize) -> f64 {
        voxels as f64 / self.voxels_before.max(1) as f64
    }

    /// Returns a message for a caller who wanted to cut handles: the repair has already removed them. Returns `None` if
    /// there were no handles.
    #[must_use]
    pub fn no_handle_left(&self) -> Option<String> {
        let (number, kept) = match self.handles_removed {
            0 => return None,
            1 => ("1 handle".to_owned(), "it"),
            handles => (format!("{handles} handles"), "them"),
        };
        Some(format!(
            "the repair removed {number}, so no handle was left to cut; run without the repair to keep {kept}"
        ))
    }
}

impl std::fmt::Display for Repair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let count = |n: usize, one: &str, many: &str| format!("{n} {}", if n == 1 { one } else { many });
        let voxels = |n| count(n, "voxel", "voxels");
        let share = |n| match self.share(n) {
            share if share > LARGE => format!(", {:.0} % of the label", 100.0 * share),
            _ => String::new(),
        };
        let done = match self.handles {
            HandleRepair::Cut => "removed",
            HandleRepair::Filled => "added",
        };
        let mut changes = Vec::new();
        if self.pieces_dropped > 0 {
            let pieces = count(self.pieces_dropped, "piece", "pieces");
            changes.push(format!("{pieces} dropped ({}{})", voxels(self.voxels_dropped), share(self.voxels_dropped)));
        }
        if self.cavities_filled > 0 {
            let cavities = count(self.cavities_filled, "cavity", "cavities");
            changes.push(format!("{cavities} filled ({}{})", voxels(self.voxels_filled), share(self.voxels_filled)));
        }
        if self.voxels_changed > 0 {
            // If there were no handles, voxels were changed only to remove bare contacts.
            let removed = match self.handles_removed {
                0 => "contacts at edges or corners".to_owned(),
                handles => count(handles, "handle", "handles"),
            };
            let share = share(self.voxels_changed);
            changes.push(format!("{removed} removed ({} {done}{share})", voxels(self.voxels_changed)));
        }
        write!(f, "the volume was repaired: {}", changes.join(", "))?;
        if self.large_pieces_dropped >= MANY_BODIES {
            f.write_str(
                "; if the volume is a mask of many bodies, give each body its own label first, for example with \
                 skimage.measure.label or scipy.ndimage.label",
            )?;
        }
        Ok(())
    }
}

/// Repairs a mask: turns its largest piece into a set of voxels with the topology of a ball.
///
/// # Errors
///
/// [`Interrupted`] when the monitor asks to stop.
pub fn repair(mask: &Mask, monitor: &dyn Monitor) -> Result<(Mask, Repair), Interrupted> {
    monitor.begin(Stage::counted("repair", "voxels"), 0);
    let (whole, found, hollow) = largest_piece(mask, monitor)?;
    let cut = cut(&whole, monitor)?;
    let filled = fill(&whole, monitor)?;
    let changed = |other: &Mask| whole.inside.iter().zip(&other.inside).filter(|(a, b)| a != b).count();
    let (removed, added) = (changed(&cut), changed(&filled));
    let (repaired, handles, voxels_changed) =
        if removed <= added { (cut, HandleRepair::Cut, removed) } else { (filled, HandleRepair::Filled, added) };
    let dropped = found.sizes.get(1..).unwrap_or_default();
    let repair = Repair {
        pieces_dropped: dropped.len(),
        voxels_dropped: dropped.iter().sum(),
        large_pieces_dropped: dropped.iter().filter(|&&size| 4 * size >= found.sizes[0]).count(),
        voxels_before: found.sizes.iter().sum(),
        cavities_filled: hollow.sizes.len(),
        voxels_filled: hollow.sizes.iter().sum(),
        handles_removed: QuadMesh::around(&whole).handles(),
        handles,
        voxels_changed,
    };
    monitor.end();
    Ok((repaired, repair))
}

/// Returns the largest piece of a mask with its cavities filled, all pieces, and the cavities.
pub(super) fn largest_piece(mask: &Mask, monitor: &dyn Monitor) -> Result<(Mask, Pieces, Pieces), Interrupted> {
    let mut whole = mask.clone();
    let found = pieces(mask, monitor)?;
    whole.inside.iter_mut().zip(&found.of).for_each(|(inside, &piece)| *inside = piece == 1);
    let hollow = cavities(&whole, monitor)?;
    whole.inside.iter_mut().zip(&hollow.of).for_each(|(inside, &cavity)| *inside |= cavity != 0);
    Ok((whole, found, hollow))
}

/// Returns a set of voxels with the topology of a ball, grown inside the label.
fn cut(label: &Mask, monitor: &dyn Monitor) -> Result<Mask, Interrupted> {
    let depth = distance(label, true, monitor)?;
    let mut ball = Mask { inside: vec![false; label.inside.len()], ..label.clone() };
    // The ball starts at the voxel farthest from the background; in case of ties, at the first such voxel.
    let seed = (0..depth.len()).max_by_key(|&i| (depth[i], std::cmp::Reverse(i)));
    let Some(seed) = seed.filter(|&i| label.inside[i]) else { return Ok(ball) };
    ball.inside[seed] = true;
    change_sides(&mut ball, &[seed], |voxel| label.inside[voxel], &depth, monitor)?;
    Ok(ball)
}

/// Returns a set of voxels with the topology of a ball, made by shrinking the box around the label onto the label.
fn fill(label: &Mask, monitor: &dyn Monitor) -> Result<Mask, Interrupted> {
    let depth = distance(label, false, monitor)?;
    let mut ball = Mask { inside: (0..label.inside.len()).map(|i| !label.is_rim(i)).collect(), ..label.clone() };
    let rim: Vec<usize> = (0..ball.inside.len()).filter(|&i| !ball.inside[i]).collect();
    change_sides(&mut ball, &rim, |voxel| !label.inside[voxel] && !label.is_rim(voxel), &depth, monitor)?;
    Ok(ball)
}

/// Number of voxels between checks of the monitor.
const CHUNK: usize = 1 << 14;

/// Moves the voxels for which `wanted` is true to the side of `seeds`, inside or outside the ball, in order of
/// decreasing `depth`. Moves a voxel only if this preserves the topology and leaves no bare contact (see `simple`).
fn change_sides(
    ball: &mut Mask,
    seeds: &[usize],
    wanted: impl Fn(usize) -> bool,
    depth: &[u32],
    monitor: &dyn Monitor,
) -> Result<(), Interrupted> {
    let Some(&first) = seeds.first() else { return Ok(()) };
    let side = ball.inside[first];
    let offsets: Vec<isize> = around().map(|d| ball.step(d)).collect();
    // A voxel is queued, and hence tested, again whenever one of its 26 neighbours has changed sides.
    let mut heap = BinaryHeap::new();
    let push = |heap: &mut BinaryHeap<_>, ball: &Mask, voxel: usize| {
        let at = ball.place(voxel);
        for d in around() {
            if !(0..3).all(|k| at[k].checked_add_signed(d[k]).is_some_and(|x| x < ball.size[k])) {
                continue;
            }
            let next = voxel.wrapping_add_signed(ball.step(d));
            if ball.inside[next] != side && wanted(next) {
                heap.push((depth[next], std::cmp::Reverse(next)));
            }
        }
    };
    seeds.iter().for_each(|&seed| push(&mut heap, ball, seed));
    let mut looked_at = 0;
    while let Some((_, std::cmp::Reverse(voxel))) = heap.pop() {
        looked_at += 1;
        if looked_at % CHUNK == 0 {
            monitor.check()?;
        }
        // A voxel may be queued several times; this voxel has already changed sides.
        if ball.inside[voxel] == side {
            continue;
        }
        let bits = offsets
            .iter()
            .enumerate()
            .fold(0, |bits: Around, (i, &step)| bits | Around::from(ball.inside[voxel.wrapping_add_signed(step)]) << i);
        let changed = if side { bits | 1 << 13 } else { bits & !(1 << 13) };
        if is_simple(bits) && !has_bare_contact(changed) {
            ball.inside[voxel] = side;
            push(&mut heap, ball, voxel);
            monitor.step(1);
        }
    }
    Ok(())
}

/// Returns the distance of each voxel of one side from the other side, in units of about 1/3 voxel (the 3-4-5 chamfer
/// distance: G. Borgefors, "Distance transformations in digital images", 1986); 0 for voxels of the other side.
fn distance(label: &Mask, side: bool, monitor: &dyn Monitor) -> Result<Vec<u32>, Interrupted> {
    // The border of the mask's box doesn't belong to the other side, since the background continues beyond the box.
    let far = u32::MAX / 2;
    let mut depth: Vec<u32> = label.inside.iter().map(|&inside| if inside == side { far } else { 0 }).collect();
    let cost = |d: [isize; 3]| 2 + d.iter().map(|x| x.unsigned_abs() as u32).sum::<u32>();
    let before: Vec<[isize; 3]> = around().take(13).collect();
    let relax = |depth: &mut [u32], voxel: usize, sign: isize| {
        let at = label.place(voxel);
        for d in &before {
            let d = d.map(|x| sign * x);
            if (0..3).all(|k| at[k].checked_add_signed(d[k]).is_some_and(|x| x < label.size[k])) {
                let other = depth[voxel.wrapping_add_signed(label.step(d))];
                depth[voxel] = depth[voxel].min(other + cost(d));
            }
        }
    };
    let n = depth.len();
    for i in 0..2 * n {
        if i % CHUNK == 0 {
            monitor.check()?;
        }
        // The first pass is in the order of the voxels, the second in reverse order.
        if i < n {
            relax(&mut depth, i, 1);
        } else {
            relax(&mut depth, 2 * n - 1 - i, -1);
        }
    }
    Ok(depth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::boundary::QuadMesh;
    use spharm_monitor::Silent;

    /// Returns random voxels: thousands of pieces, handles, cavities and contacts.
    fn noise(size: [usize; 3], seed: u64) -> Mask {
        Mask::new(size, |[x, y, z]| {
            let mut h = seed ^ (x as u64) << 40 ^ (y as u64) << 20 ^ z as u64;
            for _ in 0..3 {
                h = (h ^ h >> 29).wrapping_mul(0x94d0_49bb_1331_11eb).wrapping_add(seed);
            }
            h >> 60 > 5
        })
    }

    fn any_bare_contact(mask: &Mask) -> bool {
        (0..mask.inside.len()).filter(|&i| !mask.is_rim(i)).any(|voxel| {
            let bits = around().enumerate().fold(0, |bits: Around, (i, d)| {
                bits | Around::from(mask.inside[voxel.wrapping_add_signed(mask.step(d))]) << i
            });
            has_bare_contact(bits)
        })
    }

    #[test]
    fn whatever_goes_in_a_ball_comes_out() {
        for seed in 1..20 {
            let mask = noise([9, 11, 10], seed);
            for (way, ball) in [("cut", cut(&mask, &Silent).unwrap()), ("fill", fill(&mask, &Silent).unwrap())] {
                let (found, hollow) =
                    (pieces(&ball, &Silent).unwrap().sizes.len(), cavities(&ball, &Silent).unwrap().sizes.len());
                assert_eq!((found, hollow, any_bare_contact(&ball)), (1, 0, false), "{way}, {seed}");
                let surface = QuadMesh::around(&ball);
                let genus = 1 - surface.euler_characteristic() / 2;
                assert_eq!((surface.components(), genus, surface.pinched_edges()), (1, 0, 0), "{way}, {seed}");
            }
            let (mended, report) = repair(&mask, &Silent).unwrap();
            let changed = mended.inside.iter().zip(&mask.inside).filter(|(a, b)| a != b).count();
            assert!(changed <= report.voxels(), "{seed}: {changed} {report:?}");
        }
    }

    #[test]
    fn a_mask_of_many_bodies_is_named() {
        let cubes = |number: usize| {
            let mask = Mask::new([5 * number, 4, 4], |[x, y, z]| (1..4).contains(&(x % 5)) && y > 0 && z > 0);
            repair(&mask, &Silent).unwrap().1
        };
        let two = cubes(2);
        assert!((two.share_dropped(), two.is_large_loss(), two.large_pieces_dropped) == (0.5, true, 1), "{two:?}");
        assert_eq!(two.to_string(), "the volume was repaired: 1 piece dropped (27 voxels, 50 % of the label)");
        let many = cubes(5).to_string();
        assert!(many.contains("80 % of the label") && many.contains("skimage.measure.label"), "{many}");
        // A dropped speck of a few voxels isn't a large loss.
        let speck = Mask::new([9; 3], |at| at.iter().all(|&x| x > 2) || at == [0; 3]);
        let (_, repair) = repair(&speck, &Silent).unwrap();
        assert!(
            repair.pieces_dropped == 1 && !repair.is_large_loss() && repair.large_pieces_dropped == 0,
            "{repair:?}"
        );
        assert!(repair.to_string().ends_with("1 piece dropped (1 voxel)"), "{repair}");
    }

    #[test]
    fn large_fillings_are_large_changes() {
        let distance = |at: [usize; 3]| at.iter().map(|&x| (x as f64 - 10.0).powi(2)).sum::<f64>().sqrt();
        let shell = Mask::new([21; 3], |at| (6.0..9.0).contains(&distance(at)));
        let (_, found) = repair(&shell, &Silent).unwrap();
        let share = 100.0 * found.voxels_filled as f64 / shell.count() as f64;
        assert!(found.is_large_loss() && found.share_dropped() == 0.0, "{found:?}");
        assert!(found.to_string().contains(&format!(" voxels, {share:.0} % of the label)")), "{found}");
        let small = Mask::new([21; 3], |at| (1.0..9.0).contains(&distance(at)));
        let (_, found) = repair(&small, &Silent).unwrap();
        assert!(found.cavities_filled == 1 && !found.is_large_loss(), "{found:?}");
        assert!(found.to_string().ends_with("1 cavity filled (1 voxel)"), "{found}");
    }

    #[test]
    fn a_ball_is_left_alone() {
        let ball = Mask::new([21; 3], |at| at.iter().map(|&x| (x as f64 - 10.0).powi(2)).sum::<f64>() < 90.0);
        let (mended, report) = repair(&ball, &Silent).unwrap();
        assert_eq!((mended == ball, report.voxels()), (true, 0));
    }
}
