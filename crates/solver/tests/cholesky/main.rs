//! Tests of the Cholesky factor in memory, out of core and from a store.

mod matrices;
mod memory;
mod store;
