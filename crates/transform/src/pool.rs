//! Pools of working memory. Memory that one call or task has returned is reused by the next.

use std::sync::{Mutex, PoisonError};

/// A pool of values for reuse. The number of values in the pool is the largest number that has been in use at the same
/// time. Reuse is faster than allocation, because the first access to a newly allocated page of memory costs more than
/// writing to the page.
#[derive(Debug)]
pub(crate) struct Pool<T>(Mutex<Vec<T>>);

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Pool<T> {
    /// Calls `work` with a value of the pool that isn't in use, or with a new value from `make` if all are in use. A
    /// value of the pool has the contents left by its last user.
    pub(crate) fn with<R>(&self, make: impl FnOnce() -> T, work: impl FnOnce(&mut T) -> R) -> R {
        let free = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut value = free.unwrap_or_else(make);
        let result = work(&mut value);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(value);
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_in_use_are_not_given_again_and_others_are() {
        let (pool, mut made) = (Pool::default(), 0);
        let mut make = || {
            made += 1;
            made
        };
        let inner = pool.with(&mut make, |first| (*first, pool.with(|| 7, |second| *second)));
        assert_eq!(inner, (1, 7));
        assert_eq!(pool.with(&mut make, |again| *again), 1);
        assert_eq!(made, 1);
    }
}
