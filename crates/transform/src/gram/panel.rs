//! Computes the requested rows of the Gram matrix, in the columns of a few orders m'. The sums are computed in a
//! sequence that uses caches well, and are written to their places in the matrix.
//!
//! The orders m of the rows are processed in panels. The Fourier coefficients c and d (see [`gram`](super)) of a panel
//! for all orders m', and the Legendre functions of three degrees l, stay in a core's L2 cache while they are
//! multiplied with every degree l'. The Legendre table, which may be larger than any cache, is read once. In a column
//! of the matrix, the rows of one degree and sign are contiguous, so a panel's sums are written to the column in runs
//! as long as the panel. To compute the whole matrix, one m' is processed at a time, and a panel has 40 orders at
//! degree 100.

use std::ops::Range;

use spharm_harmonics::column;
use spharm_harmonics::index::degree_order;

use super::kernel::{KINDS, LANES, Lanes, ROWS, Row, products, strip};
use super::measure::Measure;

/// Largest size in bytes of the Fourier coefficients for a panel of orders m (`c_k` and `d_k` in [`gram`](super)). The
/// value suits L2 caches of 1 MiB or more.
const WAVE_BYTES: usize = 256 << 10;

/// The requested rows.
#[derive(Debug)]
pub(super) struct Rows {
    pub(super) range: Range<usize>,
    /// Whether only rows on and below the diagonal are requested.
    pub(super) lower: bool,
}

/// The columns of one degree and one absolute order.
#[derive(Debug)]
pub(super) struct Part<'a> {
    pub(super) degree: usize,
    /// The output columns of the cosine and of the sine, if requested; each starts with the first row that is written
    /// and ends with the last row of the range.
    pub(super) signs: [Option<&'a mut [f64]>; 2],
}

impl Part<'_> {
    pub(super) fn new(degree: usize) -> Self {
        Self { degree, signs: [None, None] }
    }
}

/// Columns of the basis with the orders m and -m, where m is `order`, ascending in degree.
#[derive(Debug)]
pub(super) struct Columns<'a> {
    pub(super) order: usize,
    pub(super) parts: Vec<Part<'a>>,
}

/// Returns the largest number of orders m' that a task may process. For these orders and a panel of eight orders m, the
/// Fourier coefficients c and d (see [`gram`](super)) of both parities may take up to [`WAVE_BYTES`] bytes.
pub(super) const fn most_orders(rings: usize) -> usize {
    let orders = WAVE_BYTES / window_bytes(rings);
    if orders == 0 { 1 } else { orders }
}

/// Returns the size in bytes of the Fourier coefficients c and d (see [`gram`](super)), of both parities, for the
/// windows m - m' and m + m'.
const fn window_bytes(rings: usize) -> usize {
    8 * rings * size_of::<Lanes>()
}

/// Computes the requested rows of the columns of a few orders m', and writes them to the columns.
pub(super) fn fill(measure: &Measure, rows: &Rows, orders: &mut [Columns<'_>]) {
    let rings = measure.rings();
    let parts = || orders.iter().flat_map(|columns| columns.parts.iter().map(|part| (columns.order, part.degree)));
    let lowest = parts().map(|(_, degree)| degree).min().unwrap_or(0);
    let legendre: Vec<f64> = parts().flat_map(|(order, degree)| measure.order(degree, order)).collect();
    let most = orders.iter().map(|columns| columns.parts.len()).max().unwrap_or(0);
    let groups = rows.groups(lowest);
    let all = groups.iter().fold(0..0, |all, group| join(all, group.blocks.clone()));
    let panel = (WAVE_BYTES / (orders.len() * window_bytes(rings))).clamp(1, all.len().max(1));
    let mut sums = vec![[0.0; LANES]; ROWS * most * KINDS * panel];
    let (mut taken, mut of_columns) = (Vec::with_capacity(most), Vec::with_capacity(most));
    for origin in all.clone().step_by(panel) {
        for group in &groups {
            let blocks = group.blocks.start.max(origin)..group.blocks.end.min(origin + panel);
            if blocks.is_empty() {
                continue;
            }
            let highest = group.degrees[group.degrees.len() - 1];
            let of_rows = group.degrees.iter().map(|&degree| Row { degree, legendre: measure.degree(degree) });
            let of_rows: Vec<_> = of_rows.collect();
            let mut rest = legendre.as_slice();
            for Columns { order, parts } in &mut *orders {
                let own = rest.split_off(..parts.len() * rings).unwrap_or_default();
                // Pairs of degrees l, l' with an even sum share one set of Fourier coefficients, and pairs with an odd
                // sum share another.
                for parity in 0..2 {
                    let wanted = |degree: usize| (degree + highest) % 2 == parity && !(rows.lower && degree > highest);
                    taken.clear();
                    taken.extend((0..parts.len()).filter(|&i| wanted(parts[i].degree)));
                    of_columns.clear();
                    of_columns.extend(taken.iter().map(|&i| &own[i * rings..][..rings]));
                    products(&of_rows, &of_columns, measure.waves(parity, *order), rings, blocks.clone(), &mut sums);
                    for (r, &degree) in group.degrees.iter().enumerate() {
                        for (c, &i) in taken.iter().enumerate() {
                            for kind in 0..KINDS {
                                if let Some(values) = &mut parts[i].signs[kind / 2] {
                                    let sums = &sums[strip(r, taken.len(), c, kind, blocks.len())..][..blocks.len()];
                                    rows.put(values, degree, kind % 2 == 1, blocks.start * LANES, sums.as_flattened());
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Up to [`ROWS`] degrees of equal parity, ascending, and the blocks of eight orders that at least one of them needs.
#[derive(Debug)]
struct Group {
    degrees: Vec<usize>,
    blocks: Range<usize>,
}

impl Rows {
    fn groups(&self, lowest: usize) -> Vec<Group> {
        let (first, last) = (degree_order(self.range.start).0, degree_order(self.range.end - 1).0);
        let first = if self.lower { first.max(lowest) } else { first };
        let mut groups = Vec::new();
        for start in [first, first + 1] {
            let degrees: Vec<_> = (start..=last).step_by(2).collect();
            for degrees in degrees.chunks(ROWS) {
                let blocks = degrees.iter().fold(0..0, |all, &l| join(all, self.blocks(l)));
                groups.push(Group { degrees: degrees.to_vec(), blocks });
            }
        }
        groups
    }

    /// Returns the blocks of eight absolute orders that contain an order of degree `l` whose row is in `range`.
    fn blocks(&self, l: usize) -> Range<usize> {
        let (centre, low, high) = (column(l, 0), column(l, -(l as isize)), column(l, l as isize));
        let (start, end) = (low.max(self.range.start), high.min(self.range.end - 1));
        let (start_order, end_order) = (start.abs_diff(centre), end.abs_diff(centre));
        let least = if start <= centre && centre <= end { 0 } else { start_order.min(end_order) };
        least / LANES..start_order.max(end_order) / LANES + 1
    }

    /// Copies the sums of degree `l` to their rows, for the orders m from `first` on. The rows of sines are sorted by
    /// descending m.
    fn put(&self, values: &mut [f64], l: usize, sine: bool, first: usize, sums: &[f64]) {
        if first > l {
            return;
        }
        let centre = column(l, 0);
        let sums = &sums[..sums.len().min(l + 1 - first)];
        // `values` ends with the last row of the range.
        let start = self.range.end - values.len();
        let clip = |low: usize, high: usize| low.clamp(start, self.range.end)..high.clamp(start, self.range.end);
        if sine {
            // There is no sine of order 0.
            let (first, sums) = if first == 0 { (1, &sums[1..]) } else { (first, sums) };
            let end = centre + 1 - first;
            let rows = clip(end - sums.len(), end);
            if rows.is_empty() {
                return;
            }
            let sums = &sums[end - rows.end..];
            let out = values[rows.start - start..rows.end - start].iter_mut().rev();
            out.zip(sums).for_each(|(out, sum)| *out = *sum);
        } else {
            let rows = clip(centre + first, centre + first + sums.len());
            if !rows.is_empty() {
                let sums = &sums[rows.start - centre - first..][..rows.len()];
                values[rows.start - start..rows.end - start].copy_from_slice(sums);
            }
        }
    }
}

/// Returns the smallest range that contains both ranges.
fn join(a: Range<usize>, b: Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b,
        (_, true) => a,
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}
