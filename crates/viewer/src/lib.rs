//! Models evaluated in a browser.
//!
//! This is what the pages of `spharm report` have as WebAssembly: a [`View`] holds one model's coefficients, directions and
//! triangles, and evaluates the surface to any degree, with its normals and its distances from a reference surface. On
//! `wasm32` the module `exports` makes it a library of C functions; elsewhere there is the type alone, for tests.
//!
//! `./run report-assets` builds it into `crates/report/assets`.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`view`] | evaluation to any degree, distances from a reference |
//! | [`normals`] | normals at vertices |
//! | `exports` | the C functions that the page's script calls |

#[cfg(target_arch = "wasm32")]
pub mod exports;
pub mod normals;
pub mod view;

pub use view::{View, ViewError};
