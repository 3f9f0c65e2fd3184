//! Adds patches to a grid. A patch is the sum of the kernels around a node, and is multiplied by the node's values.
//! Each row of a tile of the grid is computed by a small matrix product.

use multiversion::{multiversion, target::target_cfg_f};

use super::patches::{COLUMNS, Patches};
use crate::grid::Layout;
use crate::lanes::{fused, load};

/// Multiplies each patch by the values of its node, and adds the products to the rows of a strip of the grid. Each node
/// has `stride` values. The first of these are the values of the layout's channels.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn add_patches(layout: Layout, grid: &mut [f64], patches: &Patches, values: &[f64], stride: usize) {
    for tile in &patches.tiles {
        for (row, grid) in tile.first.windows(2).zip(grid.chunks_mut(layout.row())) {
            let rows = row[0] as usize..row[1] as usize;
            if rows.is_empty() {
                continue;
            }
            let (nodes, factors) = (&patches.nodes[rows.clone()], &patches.values[rows]);
            let mut channel = 0;
            while channel < layout.channels {
                let left = layout.channels - channel;
                let grid = &mut grid[channel * layout.stride + tile.column..];
                let values = &values[channel..];
                let fma = target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64"));
                // The number of channels processed together is limited by the registers for their sums.
                channel += match (target_cfg_f!(target_feature = "avx512f"), fma, left) {
                    (true, _, 8..) => product::<COLUMNS, 8, true>(layout, grid, nodes, factors, values, stride),
                    (true, _, 3..) => product::<COLUMNS, 3, true>(layout, grid, nodes, factors, values, stride),
                    (true, ..) => product::<COLUMNS, 1, true>(layout, grid, nodes, factors, values, stride),
                    (_, true, 3..) => product::<12, 3, true>(layout, grid, nodes, factors, values, stride),
                    (_, true, _) => product::<12, 1, true>(layout, grid, nodes, factors, values, stride),
                    _ => product::<8, 1, false>(layout, grid, nodes, factors, values, stride),
                };
            }
        }
    }
}

/// For each of C channels, sums the products of each node's `factors` and the node's value in this channel, and adds
/// the sum to the channel's line of the grid. Returns C.
#[inline(always)]
fn product<const W: usize, const C: usize, const FMA: bool>(
    layout: Layout,
    grid: &mut [f64],
    nodes: &[u32],
    factors: &[[f64; COLUMNS]],
    values: &[f64],
    stride: usize,
) -> usize {
    for columns in (0..COLUMNS).step_by(W) {
        let mut sums = [[0.0; W]; C];
        for (channel, sums) in sums.iter_mut().enumerate() {
            *sums = load(grid, channel * layout.stride + columns);
        }
        for (node, factors) in nodes.iter().zip(factors) {
            let factors: [f64; W] = load(factors, columns);
            let values: [f64; C] = load(values, *node as usize * stride);
            for (sums, value) in sums.iter_mut().zip(values) {
                for (sum, factor) in sums.iter_mut().zip(&factors) {
                    *sum = fused::<FMA>(*factor, value, *sum);
                }
            }
        }
        for (channel, sums) in sums.iter().enumerate() {
            grid[channel * layout.stride + columns..][..W].copy_from_slice(sums);
        }
    }
    C
}
