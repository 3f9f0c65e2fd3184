//! Evaluates models in a browser.
//!
//! The pages of `spharm report` contain this crate as WebAssembly: a [`View`] holds one model's coefficients,
//! directions and triangles, and evaluates the surface to any degree, with its normals and its distances from a
//! reference surface. On `wasm32`, the module `exports` turns the crate into a library of C functions. On other
//! targets, which are used only for tests, the crate has [`View`] but no C functions.
//!
//! `./run report-assets` builds the WebAssembly, and writes it to `crates/report/assets`.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`view`] | evaluation to any degree, distances from a reference |
//! | [`normals`] | normals at the vertices of a mesh |
//! | `exports` | the C functions that the page's script calls |

#[cfg(target_arch = "wasm32")]
pub mod exports;
pub mod normals;
pub mod view;

pub use view::{View, ViewError};
