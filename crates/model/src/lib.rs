//! Defines SPHARM models: the coefficients of a fit, its sphere and its provenance. Reads, writes and evaluates them.
//!
//! A model is a NumPy archive, `NAME.spharm.npz`:
//!
//! | array | type | contents |
//! |---|---|---|
//! | `coefficients` | f64 (K, c) | canonical coefficients, row `l^2 + l + m`, in the input's unit |
//! | `max_degree` | i64 () | L, with K = (L + 1)^2 |
//! | `convention` | text () | [`CONVENTION`] |
//! | `faces` | i32 (F, 3) | triangles of the sphere, indexed from 0; F = 0 if the sphere was a list of angles |
//! | `directions` | f64 (n, 3) | unit vectors of the sampling scheme |
//! | `cut_from` | i64 (2,) | original numbers of vertices and triangles of a surface whose handles were cut |
//! | `seam` | i32 (k,) | with `cut_from`: the k vertices that are copied, in the order of their copies |
//! | `scheme_key` | text () | key of the sampling scheme in a basis store |
//! | `provenance` | text () | JSON: origin of the model, see [`Provenance`] |
//!
//! If the array `cut_from` exists, the sphere has the original vertices and triangles first, then the copies of the
//! vertices in `seam`, then the vertices of fillings; see `Seam` of `spharm-surface`.
//!
//! The bytes of a file depend only on the model's contents. They don't include times or the names of machines and
//! users, unless the paths of input and sphere, which are stored as given, contain such names. Only the array
//! `coefficients` is required for reading, so a mean of models can be written as a model:
//! `numpy.savez_compressed("mean.npz", coefficients=mean)`.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`Model`] | the model; evaluation on any sphere, to any degree |
//! | [`provenance`] | input, sphere and settings |
//! | [`geometry`] | position of a surface in its volume, preserved from the input to the reconstruction |
//! | [`arrays`] | archives of named matrices: groups of models |
//! | [`csv`] | complex coefficients in the convention of Shen and Chung's paper, as a CSV table |
//! | [`npy`] | NumPy's array files |
//! | `npz` | models as NumPy archives |
//!
//! # Example
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::Coefficients;
//! use spharm_model::Model;
//! use spharm_surface::{Kind, Sphere};
//!
//! // One coefficient of degree 1 for each of x, y and z: an ellipsoid.
//! let mut values = Array2::zeros((4, 3));
//! (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 4.0, 4.0);
//! let model = Model::without_sphere(Coefficients::new(values)?, Kind::Surface);
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("ellipsoid.spharm.npz");
//! model.write(&path)?;
//! let mesh = Model::read(&path)?.reconstruct(&Sphere::icosphere(3), 1)?;
//! assert_eq!(mesh.vertices.len(), 642);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod arrays;
pub mod csv;
mod error;
mod evaluate;
mod file_record;
mod files;
pub mod geometry;
mod hemisphere;
mod model;
pub mod npy;
mod npz;
pub mod provenance;

pub use error::ModelError;
pub use file_record::{FileRecord, recorded_name};
pub use model::{CONVENTION, Fitted, Model};
pub use provenance::{Distances, Provenance, Settings, Versions, VoxelRecord};
