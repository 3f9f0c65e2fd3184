//! Registers surfaces in space: moves a template mesh onto the surface of each subject of a group.
//!
//! The subject's surface is used only to find nearest points. It may therefore have handles, holes, several pieces, and
//! triangles in any order. The template's triangles don't change, so all subjects get the same triangulation, and
//! therefore the same sphere. Subject and template must be in the same pose.
//!
//! # Steps
//!
//! 1. Coherent point drift ([`drift`](mod@drift)) with three Gaussian kernels, the widest first, brings the template
//!    near the subject where the two differ after alignment.
//! 2. Pulls towards nearest points in both directions ([`snap`](mod@snap)) bring the template onto the surface. A thin
//!    plate, whose stiffness decreases from round to round, keeps the displacements smooth.
//! 3. The template's vertices are projected onto the surface. Vertices around triangles that are turned over are moved
//!    within the surface towards their neighbours ([`untangle`](mod@untangle)).
//! 4. [`Cover`] gives the distance of the subject's surface from the registered template. [`Registered`] also marks the
//!    template's vertices that have no counterpart on the subject.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`template`] | [`Template`]: kernels and plate, computed once for all subjects |
//! | [`subject`] | [`Subject`]: a surface with points on it and search trees |
//! | [`params`] | [`RegisterParams`], with the defaults |
//! | [`low_rank`] | Gaussian kernels as products of low rank |
//! | [`mod@drift`] | coherent point drift |
//! | `cells`, `exponential` | search for pairs of nearby points, and the exponentials of these pairs in the drift |
//! | [`plate`] | the bending energy of a thin plate over the template's triangles |
//! | [`mod@snap`] | nearest points in both directions under a thin plate |
//! | [`mod@untangle`] | projection, and repair of triangles that are turned over |
//! | [`cover`] | [`Cover`]: distances of the subject's surface from the registered template |
//! | [`guide`] | [`Guide`]: landmarks that pull points of the template |
//! | [`error`] | [`RegisterError`] |

pub mod cover;
pub mod drift;
pub mod error;
pub mod guide;
pub mod low_rank;
pub mod params;
pub mod plate;
pub mod register;
pub mod snap;
pub mod subject;
pub mod template;
pub mod untangle;

mod cells;
mod exponential;

pub use cover::Cover;
pub use error::RegisterError;
pub use guide::Guide;
pub use params::RegisterParams;
pub use register::{Registered, register};
pub use subject::Subject;
pub use template::{Template, without_counterpart};
