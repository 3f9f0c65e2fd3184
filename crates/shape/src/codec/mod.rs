//! Compressed models: `NAME.sphz`.
//!
//! Coefficients are quantised with one step ([`Target`] decides which), and their magnitudes coded by an arithmetic
//! coder with adaptive probabilities, of which several are mixed, from what is known of neighbouring coefficients.
//! Degrees come in order, so that the beginning of a file is a coarser model. `docs/sphz-format.md` says every byte.
//!
//! *What is lost*: digits, by the step; the sphere, and with it the number, the triangles and the order of the vertices
//! that the model was fitted to. An expanded model is evaluated on any sphere. What surfaces are compared by is the
//! distance between them; a point may move along the surface as far as it moves off it.
//!
//! *Cost*: a coefficient takes some 200 ns to code either way, and 4 bytes of memory beside the model; coding goes on
//! one core. A tolerance takes 4 to 8 trials of the distance of two surfaces of `4 (L+1)^2` vertices or more.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`compress`], [`expand`] | models to bytes and back |
//! | [`CodecError`] | what can go wrong |
//! | `quantizer` | whole numbers of steps |
//! | `distance`, `search` | how far a compressed model is off, and the step for a target |
//! | `contexts`, `mixing`, `arithmetic`, `stream` | expected magnitudes, probabilities, the coder, and what is coded |
//! | `container` | the file |
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
