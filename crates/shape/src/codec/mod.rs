//! Compresses models into files `NAME.sphz` and expands them.
//!
//! Coefficients are quantised with a single step, which is chosen to meet a [`Target`]. Their magnitudes are coded by
//! an arithmetic coder with mixed adaptive probabilities, conditioned on the neighbouring coefficients. Degrees are
//! coded in order, so that a prefix of a file is a coarser model. `docs/sphz-format.md` specifies every byte.
//!
//! *Loss*: the quantisation step limits the precision of the coefficients. The sphere is lost, and with it the
//! triangles, and the number and order of the vertices that the model was fitted to. An expanded model can be evaluated
//! on any sphere. The error is measured by the distance between the surfaces. Points may also move along the surface,
//! by about as much as this distance.
//!
//! *Cost*: coding or decoding a coefficient takes about 200 ns on one core, and 4 bytes of memory in addition to the
//! model. Finding the step for a tolerance takes 4 to 8 evaluations of the distance between two surfaces of at least `8
//! (L+1)^2` vertices, up to a limit of 655,362 vertices.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`compress`], [`expand`] | conversion of models to bytes and back |
//! | [`CodecError`] | the error type |
//! | `quantizer` | quantisation: integer multiples of the step |
//! | `distance`, `search` | distance of a compressed model from the original; search for the step that meets a target |
//! | `contexts`, `mixing`, `arithmetic`, `stream` | expected magnitudes, probabilities, coder, coded stream |
//! | `container` | the file format |
//!
//! # Example
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::Coefficients;
//! use spharm_model::Model;
//! use spharm_monitor::Silent;
//! use spharm_shape::codec::{CompressParams, ExpandParams, Target, compress, expand};
//! use spharm_surface::Kind;
//!
//! let mut values = Array2::zeros((121, 3));
//! (values[[3, 0]], values[[1, 1]], values[[2, 2]], values[[40, 0]]) = (9.0, 4.0, 4.0, 0.1);
//! let model = Model::without_sphere(Coefficients::new(values)?, Kind::Surface);
//!
//! let file = compress(&model, &CompressParams::new(Target::Tolerance(1e-3)), &Silent)?;
//! assert!(file.bytes.len() < 200 && file.distance < 1e-3);
//! let expanded = expand(&file.bytes, &ExpandParams::default())?;
//! assert_eq!(expanded.model.coefficients.max_degree(), 10);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod arithmetic;
mod compress;
mod container;
mod contexts;
mod distance;
mod error;
mod expand;
mod mixing;
mod quantizer;
mod search;
mod stream;

pub use compress::{CompressParams, Compressed, Target, compress};
pub use container::VERSION;
pub use error::CodecError;
pub use expand::{ExpandParams, Expanded, Level, expand};
