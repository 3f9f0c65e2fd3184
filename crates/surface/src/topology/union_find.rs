//! Maintains disjoint sets of the numbers 0..n (union-find).

/// Tarjan's disjoint-set forest with path halving and union by index. It takes nearly linear time and 4 bytes per
/// element.
#[derive(Debug)]
pub struct UnionFind {
    parent: Vec<u32>,
    sets: usize,
}

impl UnionFind {
    /// Returns n sets of one element each.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { parent: (0..n as u32).collect(), sets: n }
    }

    /// Returns the number of sets.
    #[must_use]
    pub fn sets(&self) -> usize {
        self.sets
    }

    /// Returns the element that represents the set of `x`.
    ///
    /// # Panics
    ///
    /// Panics if `x` isn't below n.
    pub fn root(&mut self, mut x: u32) -> u32 {
        loop {
            let parent = self.parent[x as usize];
            if parent == x {
                return x;
            }
            let grandparent = self.parent[parent as usize];
            self.parent[x as usize] = grandparent;
            x = grandparent;
        }
    }

    /// Merges the sets of `a` and `b`.
    ///
    /// # Panics
    ///
    /// Panics in the same cases as [`root`](Self::root).
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b) as usize] = a.min(b);
            self.sets -= 1;
        }
    }
}
