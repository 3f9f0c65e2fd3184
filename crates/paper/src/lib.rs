//! The experiments of the paper, repeated: L. Shen and M. K. Chung, "Large-scale modeling of parametric surfaces using
//! spherical harmonics", 3DPVT 2006.
//!
//! [`Experiments::new`] reads the surfaces, [`Experiments::run`] measures, and the documents that come of it, tables as
//! CSV, figures as SVG and a summary in Markdown, are texts for the caller to write.
//!
//! | module | contents |
//! |---|---|
//! | `surfaces` | what the experiments run on |
//! | `published` | the paper's own numbers, and the reference beside the data |
//! | `extent` | how large they are |
//! | `bench` | building bases and fitting surfaces, with the time taken |
//! | `experiments`, `families` | figures 3, 5, 6 and 7, table 1, least squares beside quadrature: what is measured |
//! | `store` | the bases, in a folder that is kept or a temporary one |
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
