//! Writes models as a page for the browser: a single self-contained HTML file that evaluates the models at any degree.
//!
//! [`page()`] creates the page from [`Contents`]: models compared with the surfaces to which they were fitted, modes
//! of a group, maps of a test, and tables. The page contains coefficients, directions and triangles as arrays;
//! WebAssembly from `crates/viewer` evaluates the models, and the script from `viewer/` draws them. Without scripts
//! or WebGL, the page shows pictures instead of views.
//!
//! A surface with the same triangles as its model's sphere is stored as offsets from the model, in steps of 1/32,767
//! of the largest offset. Distances in the page are therefore accurate to 3e-5 of the largest distance. Coefficients
//! and directions are stored as f32.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`contents`] | contents and settings of a page |
//! | [`page`](mod@page) | the page and its content security policy |
//! | `model_item`, `modes_item`, `maps_item` | data of a model, of modes, and of a test for the script |
//! | `grid` | directions and triangles, or the equivalent icosphere |
//! | `blocks` | encoding of arrays as text |
//! | `curves`, `chart`, `axis` | the charts of a model, as SVG |
//! | `quality` | curves and a table that compare alignments |
//! | [`check`] | quality control of the subjects |
//! | [`table`], `provenance` | tables |
//! | `still` | pictures that replace views |
//! | `text` | escaping of text |
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
