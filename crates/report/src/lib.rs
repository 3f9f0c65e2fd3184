//! Models as a page for the browser: one HTML file, which asks for nothing beside itself and evaluates the models at
//! any degree.
//!
//! [`page()`] makes it of [`Contents`]: models beside the surfaces that they were fitted to, modes of a group, maps of
//! a test, tables of status. Coefficients, directions and triangles are in the page as arrays; WebAssembly of
//! `crates/viewer` evaluates them there and `viewer/` draws. Without scripts, or without WebGL, pictures stand in place
//! of the views.
//!
//! A surface with the triangles of its model's sphere is stored as its offsets from the model, in steps of a 32,767th
//! of the largest, so that distances in the page are right to 3e-5 of the largest one. Coefficients and directions are
//! f32.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`contents`] | what a page is made of |
//! | [`page`](mod@page) | the page, its policy of what may run |
//! | `model_item`, `modes_item`, `maps_item` | what the script gets of a model, of modes, of a test |
//! | `grid` | directions and triangles, or the icosphere that they are |
//! | `blocks` | arrays as text |
//! | `curves`, `chart`, `axis` | the charts of a model, as SVG |
//! | `quality` | curves and a table of alignments side by side |
//! | [`table`], `provenance` | tables |
//! | `still` | pictures in place of views |
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

pub use contents::{Contents, Maps, Params, Quality, Shown};
pub use error::ReportError;
pub use page::page;
pub use table::Table;
