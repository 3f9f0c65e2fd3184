//! Chooses the loops along which a surface with handles is cut.
//!
//! Loops are cut in rounds until the genus is zero. A round computes the generators of the current complex and, near
//! each generator, a loop that can't be replaced by a shorter one (see `search`). The loops are considered in order of
//! length, and a loop that meets an earlier one is dropped. Together, the remaining loops may still separate the
//! surface, for instance if several run around the same handle. The remaining loops form the edges of a graph whose
//! nodes are the pieces into which these loops would cut the surface. A spanning tree of this graph, made of the
//! longest loops, is left uncut, so that the surface stays connected. The shortest loop is always cut.
//!
//! Guarantee: a cut loop is at least as short as every loop of edges that passes through any of eight vertices spread
//! evenly along the cut loop and doesn't separate the surface as it is in that round. In practice the shortest of all
//! loops is found if one of the searches reaches it. To be certain, a search from every vertex would be needed
//! (Erickson and Har-Peled 2004), which takes n times as long.
//!
//! Cost: a round takes O(n log n) for the generators. For each generator, a few searches are made, each limited to the
//! vertices within half a loop's length. Hundreds of small handles are cut in two or three rounds. In the worst case,
//! if all loops meet, each round cuts one handle.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor, Stage};
use spharm_surface::topology::UnionFind;

use super::complex::{Complex, Loop, Rims};
use super::homology::Homology;
use super::search::Search;

/// A cut that was made.
pub(super) struct Cut {
    pub(super) length: f64,
    pub(super) rims: Rims,
}

/// Returns disjoint loops, shortest first, that can all be cut without separating the complex. If the complex has a
/// handle, there is at least one such loop.
pub(super) fn round(complex: &Complex, monitor: &dyn Monitor) -> Result<Vec<Loop>, Interrupted> {
    let base = (0..complex.vertices() as u32).find(|&v| complex.around(v).next().is_some()).unwrap_or(0);
    let homology = Homology::of(complex, base);
    Ok(without_separating(complex, disjoint(complex, candidates(complex, &homology, monitor)?)))
}

/// Returns the loops found near the generators, shortest first, without duplicates.
fn candidates(complex: &Complex, homology: &Homology, monitor: &dyn Monitor) -> Result<Vec<Loop>, Interrupted> {
    let near = |search: &mut Search, &generator: &u32| {
        monitor.check()?;
        Ok(search.near(complex, homology, complex.from(generator)))
    };
    let search = || Search::new(complex.vertices());
    let found: Result<Vec<Option<Loop>>, Interrupted> = homology.generators.par_iter().map_init(search, near).collect();
    let mut loops: Vec<(u64, Vec<u32>, Loop)> = found?.into_iter().flatten().map(|found| key(complex, found)).collect();
    loops.sort_unstable_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
    loops.dedup_by(|a, b| a.1 == b.1);
    Ok(loops.into_iter().map(|(_, _, found)| found).collect())
}

/// Returns a loop with its sort key: its length, then its edges. The key doesn't depend on the loop's direction or
/// starting point.
fn key(complex: &Complex, found: Loop) -> (u64, Vec<u32>, Loop) {
    let mut edges: Vec<u32> = found.edges.iter().map(|&h| h.min(complex.twin(h))).collect();
    edges.sort_unstable();
    // The length is summed in the order of the edges' indices, so that it doesn't depend on the loop's direction or
    // starting point.
    let length: f64 = edges.iter().map(|&h| complex.length(h)).sum();
    (length.to_bits(), edges, Loop { length, ..found })
}

/// Cuts all handles of a complex of the given genus. Returns `None` if a round finds no loop.
pub(super) fn cut_all(
    complex: &mut Complex,
    genus: usize,
    monitor: &dyn Monitor,
) -> Result<Option<Vec<Cut>>, Interrupted> {
    monitor.begin(Stage::counted("cutting", "handles"), genus as u64);
    let mut cuts = Vec::with_capacity(genus);
    while cuts.len() < genus {
        let chosen = round(complex, monitor)?;
        if chosen.is_empty() {
            return Ok(None);
        }
        for found in chosen.into_iter().take(genus - cuts.len()) {
            cuts.push(Cut { length: found.length, rims: complex.cut(&found) });
            monitor.step(1);
        }
    }
    monitor.end();
    Ok(Some(cuts))
}

/// Drops each loop that shares a vertex with an earlier loop that was kept, and returns the kept loops.
fn disjoint(complex: &Complex, mut loops: Vec<Loop>) -> Vec<Loop> {
    let mut met = vec![false; complex.vertices()];
    loops.retain(|found| {
        let vertices = || found.edges.iter().map(|&h| complex.from(h) as usize);
        let free = vertices().all(|v| !met[v]);
        if free {
            vertices().for_each(|v| met[v] = true);
        }
        free
    });
    loops
}

/// Returns a subset of the disjoint loops, in the same order, that can all be cut without separating the surface. Loops
/// at the end of the list are dropped first.
fn without_separating(complex: &Complex, loops: Vec<Loop>) -> Vec<Loop> {
    let mut cut = vec![false; complex.half_edges() as usize];
    for &h in loops.iter().flat_map(|found| &found.edges) {
        cut[h as usize] = true;
        cut[complex.twin(h) as usize] = true;
    }
    let mut pieces = UnionFind::new(complex.faces());
    for h in (0..complex.half_edges()).filter(|&h| !cut[h as usize]) {
        pieces.join(complex.face(h), complex.face(complex.twin(h)));
    }
    let mut chosen: Vec<Loop> = Vec::with_capacity(loops.len());
    for found in loops.into_iter().rev() {
        let h = found.edges[0];
        let (left, right) = (complex.face(h), complex.face(complex.twin(h)));
        if pieces.root(left) == pieces.root(right) {
            chosen.push(found);
        } else {
            pieces.join(left, right);
        }
    }
    chosen.reverse();
    chosen
}
