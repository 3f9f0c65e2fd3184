//! Writes models as a page for the browser: a single self-contained HTML file, which evaluates the models at any
//! degree.
//!
//! [`page()`] creates it from [`Contents`]: models compared with the surfaces to which they were fitted, modes of a
//! group, maps of a test, tables of status. The page contains coefficients, directions and triangles as arrays;
//! WebAssembly from `crates/viewer` evaluates the models, and the script from `viewer/` draws them. Without scripts or
//! WebGL, the page shows pictures instead of views.
//!
//! A surface with the triangles of its model's sphere is stored as offsets from the model, in steps of 1/32,767 of the
//! largest offset, so that distances in the page are accurate to 3e-5 of the largest distance. Coefficients and
//! directions are f32.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`contents`] | the input of a page |
//! | [`page`](mod@page) | the page and its content security policy |
//! | `model_item`, `modes_item`, `maps_item` | the script's data for a model, for modes, for a test |
//! | `grid` | directions and triangles, or the equivalent icosphere |
//! | `blocks` | arrays as text |
//! | `curves`, `chart`, `axis` | the charts of a model, as SVG |
//! | `quality` | curves and a table that compare alignments |
//! | [`check`] | quality control of the subjects |
//! | [`table`], `provenance` | tables |
//! | `still` | pictures that replace views |
//! | `text` | escaping |
//! | `assets` | script, WebAssembly, style sheet |
//!
//! # Example
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::Coefficients;
//! use spharm_model::Model;
//! use spharm_monitor::Silent;
//! use spharm_report::{Contents, Params, Shown, page};
//! use spharm_surface::Kind;
//!
//! let mut values = Array2::zeros((4, 3));
//! (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 4.0, 4.0);
//! let model = Model::without_sphere(Coefficients::new(values)?, Kind::Surface);
//! let shown = Shown { name: "ellipsoid".into(), model, surface: None, fit: None };
//! let contents = Contents { title: "An ellipsoid".into(), models: vec![shown], ..Contents::default() };
//! let html = page(&contents, Params::default(), &Silent)?;
//! assert!(html.starts_with("<!doctype html>"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod assets;
mod axis;
mod blocks;
mod chart;
pub mod check;
pub mod contents;
mod curves;
mod error;
mod grid;
mod maps_item;
mod memory;
mod model_item;
mod modes_item;
pub mod page;
mod provenance;
mod quality;
mod still;
pub mod table;
mod text;

pub use check::{Check, CheckedCell, CheckedSubject};
pub use contents::{Contents, Maps, Params, Quality, Shown};
pub use error::ReportError;
pub use page::page;
pub use table::Table;
