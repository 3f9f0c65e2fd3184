//! Reads the surfaces of a group on demand, several at a time.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use spharm_surface::Mesh;

use crate::Error;

/// The source of a group's surfaces.
pub(super) struct Subjects<'a> {
    pub(super) count: usize,
    pub(super) read: &'a (dyn Fn(usize) -> Result<Mesh, Error> + Sync),
}

impl Subjects<'_> {
    /// Applies a function to each surface, several at a time. If several surfaces fail, the error of the first failed
    /// surface in order is returned, regardless of the number of threads. Surfaces after a failed surface may be
    /// skipped, but surfaces before it are always processed.
    pub(super) fn each<T: Send>(
        &self,
        work: impl Fn(usize, Mesh) -> Result<T, Error> + Sync + Send,
    ) -> Result<Vec<T>, Error> {
        let failed = AtomicUsize::new(usize::MAX);
        let one = |index: usize| {
            if index > failed.load(Ordering::Relaxed) {
                return None;
            }
            let mesh = (self.read)(index);
            let done = mesh.and_then(|mesh| work(index, mesh).map_err(|error| Error::of_member(index, error)));
            if done.is_err() {
                failed.fetch_min(index, Ordering::Relaxed);
            }
            Some(done)
        };
        let found: Vec<Option<Result<T, Error>>> = (0..self.count).into_par_iter().map(one).collect();
        found.into_iter().flatten().collect()
    }
}
