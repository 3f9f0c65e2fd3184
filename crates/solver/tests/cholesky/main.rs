//! The Cholesky factor: what it must satisfy in memory, out of core and from a store.

mod matrices;
mod memory;
mod store;
