//! Indexes the triangle lists of vertices with many triangles, so that operations on them take constant time.
//!
//! The list of the triangles around a vertex is usually short, and is searched linearly. But the pole of a fan, of a
//! sphere of meridians and parallels, or of a surface of revolution has one triangle for each meridian. All of these
//! triangles are removed and reinserted, which would take quadratic time without an index.

use std::collections::HashMap;

/// Largest number of triangles of a vertex without an index. With more triangles a vertex gets an index: it becomes a
/// hub.
pub(crate) const HUB: usize = 64;

/// A vertex loses its index, and is no longer a hub, when its number of triangles falls to this number.
const KEPT: usize = HUB / 2;

/// Counts the list entries searched. Used by tests.
#[cfg(test)]
pub(crate) fn looked_at(entries: usize) {
    tests::LOOKED_AT.with(|count| count.set(count.get() + entries));
}

/// Does nothing outside of tests.
#[cfg(not(test))]
pub(crate) fn looked_at(_: usize) {}

/// The indices of all hubs.
#[derive(Default)]
pub(crate) struct Hubs(HashMap<u32, Hub>);

/// The index of a hub's list of triangles.
#[derive(Default)]
struct Hub {
    /// Position of each triangle in the list.
    places: HashMap<u32, usize>,
    /// For each neighbour, the number of triangles that it shares with the hub.
    neighbours: HashMap<u32, u32>,
}

impl Hub {
    fn new(vertex: u32, list: &[u32], faces: &[[u32; 3]]) -> Self {
        let mut hub = Self::default();
        for (place, &f) in list.iter().enumerate() {
            hub.places.insert(f, place);
            faces[f as usize].iter().filter(|&&w| w != vertex).for_each(|&w| hub.meets(w));
        }
        hub
    }

    fn meets(&mut self, neighbour: u32) {
        *self.neighbours.entry(neighbour).or_default() += 1;
    }

    fn leaves(&mut self, neighbour: u32) {
        if let Some(shared) = self.neighbours.get_mut(&neighbour) {
            *shared -= 1;
            if *shared == 0 {
                self.neighbours.remove(&neighbour);
            }
        }
    }
}

impl Hubs {
    /// Builds indices for the lists of more than [`HUB`] triangles.
    pub(crate) fn new(around: &[Vec<u32>], faces: &[[u32; 3]]) -> Self {
        let long = around.iter().zip(0..).filter(|(list, _)| list.len() > HUB);
        Self(long.map(|(list, v)| (v, Hub::new(v, list, faces))).collect())
    }

    /// Adds triangle f to a vertex's list. `faces` has the corners of f and of all triangles in the list.
    pub(crate) fn push(&mut self, vertex: u32, list: &mut Vec<u32>, f: u32, faces: &[[u32; 3]]) {
        list.push(f);
        if let Some(hub) = self.0.get_mut(&vertex) {
            hub.places.insert(f, list.len() - 1);
            faces[f as usize].iter().filter(|&&w| w != vertex).for_each(|&w| hub.meets(w));
        } else if list.len() > HUB {
            self.0.insert(vertex, Hub::new(vertex, list, faces));
        }
    }

    /// Removes triangle f with the given corners from a vertex's list. If the list has no index, its order is
    /// preserved.
    pub(crate) fn remove(&mut self, vertex: u32, list: &mut Vec<u32>, f: u32, corners: [u32; 3]) {
        let Some(hub) = self.0.get_mut(&vertex) else {
            looked_at(list.len());
            list.retain(|&g| g != f);
            return;
        };
        let Some(place) = hub.places.remove(&f) else { return };
        list.swap_remove(place);
        if let Some(&moved) = list.get(place) {
            hub.places.insert(moved, place);
        }
        corners.into_iter().filter(|&w| w != vertex).for_each(|w| hub.leaves(w));
        if list.len() <= KEPT {
            self.0.remove(&vertex);
        }
    }

    /// Records that the corner `from` of one of the triangles around `vertex` was replaced by `to`.
    pub(crate) fn rename(&mut self, vertex: u32, from: u32, to: u32) {
        if let Some(hub) = self.0.get_mut(&vertex) {
            hub.leaves(from);
            hub.meets(to);
        }
    }

    /// Drops the index of a removed vertex.
    pub(crate) fn forget(&mut self, vertex: u32) {
        self.0.remove(&vertex);
    }

    /// Returns whether the vertex `hub` has a triangle in common with `vertex`; `None` if `hub` isn't a hub.
    pub(crate) fn is_neighbour(&self, hub: u32, vertex: u32) -> Option<bool> {
        self.0.get(&hub).map(|hub| hub.neighbours.contains_key(&vertex))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::cell::Cell;

    use super::*;

    std::thread_local! {
        pub(crate) static LOOKED_AT: Cell<usize> = const { Cell::new(0) };
    }

    /// Returns a fan of `count` triangles around vertex 0: the indices of the triangles at this vertex, and the
    /// triangles.
    fn fan(count: u32) -> (Vec<u32>, Vec<[u32; 3]>) {
        ((0..count).collect(), (0..count).map(|k| [0, 1 + k, 1 + (k + 1) % count]).collect())
    }

    #[test]
    fn an_indexed_list_has_what_a_list_has() {
        let (mut list, faces) = fan(200);
        let mut hubs = Hubs::new(std::slice::from_ref(&list), &faces);
        let has = |hubs: &Hubs, list: &[u32], w: u32| {
            let scanned = list.iter().any(|&f| faces[f as usize].contains(&w));
            assert!(hubs.is_neighbour(0, w).is_none_or(|indexed| indexed == scanned), "{w}");
        };
        let order: Vec<u32> = (0..200).map(|k| k * 73 % 200).collect();
        for &f in &order[..190] {
            hubs.remove(0, &mut list, f, faces[f as usize]);
            (1..=200).for_each(|w| has(&hubs, &list, w));
        }
        let mut left = list.clone();
        left.sort_unstable();
        let mut expected = order[190..].to_vec();
        expected.sort_unstable();
        assert_eq!((left, hubs.is_neighbour(0, 1)), (expected, None));
        for &f in &order[..190] {
            hubs.push(0, &mut list, f, &faces);
        }
        assert_eq!(list.len(), 200);
        (1..=200).for_each(|w| has(&hubs, &list, w));
        hubs.rename(0, 7, 500);
        hubs.rename(0, 7, 500);
        assert_eq!([7, 500].map(|w| hubs.is_neighbour(0, w)), [Some(false), Some(true)]);
    }
}
