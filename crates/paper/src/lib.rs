//! Repeats the experiments of a paper: L. Shen and M. K. Chung, "Large-scale modeling of parametric surfaces using
//! spherical harmonics", 3DPVT 2006.
//!
//! [`Experiments::new`] reads the surfaces, and [`Experiments::run`] makes the measurements.
//! [`Experiments::documents`] returns the results as text: tables as CSV, figures as SVG and a summary in Markdown.
//! The caller writes these documents to files.
//!
//! | module | contents |
//! |---|---|
//! | `surfaces` | the surfaces of the experiments |
//! | `published` | the paper's results, and the reference file in the data folder |
//! | `extent` | settings and sizes of the experiments |
//! | `bench` | construction of bases and fits of surfaces, with timing |
//! | `experiments`, `families` | measurements of figures 3, 5, 6, 7, table 1, and least squares against quadrature |
//! | `store` | permanent or temporary folder of the bases |
//! | `tables`, `figures`, `plots`, `summary` | the documents |

mod bench;
mod experiments;
mod extent;
mod families;
mod figures;
mod plots;
mod published;
mod run;
mod store;
mod summary;
mod surfaces;
mod tables;

pub use extent::Settings;
pub use run::{Document, Experiments, Measurements};
pub use summary::Circumstances;
