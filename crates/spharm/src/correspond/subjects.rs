//! The surfaces of a group, read as they are needed.

use rayon::prelude::*;
use spharm_surface::Mesh;

use crate::Error;

/// Where the surfaces of a group come from.
pub(super) struct Subjects<'a> {
    pub(super) count: usize,
    pub(super) read: &'a (dyn Fn(usize) -> Result<Mesh, Error> + Sync),
}

impl Subjects<'_> {
    /// Does something with each surface, several at a time.
    pub(super) fn each<T: Send>(
        &self,
        work: impl Fn(usize, Mesh) -> Result<T, Error> + Sync + Send,
    ) -> Result<Vec<T>, Error> {
        let one = |index: usize| {
            let mesh = (self.read)(index)?;
            work(index, mesh).map_err(|error| Error::of_member(index, error))
        };
        (0..self.count).into_par_iter().map(one).collect()
    }
}
