//! Exports SPHARM models to files of other packages, and imports models from these files.
//!
//! The canonical coefficients of a model are real, orthonormal and without the Condon-Shortley phase, in row `l^2 + l +
//! m`. Every package has its own harmonics, order of coefficients and file format; [`Format`] lists the formats.
//! [`export()`] writes a model in one of these formats, and [`import()`] reads it. Export and import are exact except
//! for rounding: numbers in text files have 17 digits.
//!
//! | format | coefficients | file |
//! |---|---|---|
//! | [`Pdm`](Format::Pdm) | factors of Re Y and Im Y with the phase, order 0 of each degree first | `.coef`, text |
//! | [`Mat`](Format::Mat) | complex with the phase, `fvec` (K, 3) | `.mat`, MATLAB level 5 |
//! | [`Pyshtools`](Format::Pyshtools) | `C` and `S`, orthonormal, or geodesy's 4 pi | text, one file per channel |
//! | [`Healpy`](Format::Healpy) | complex with the phase, m from 0 | FITS, one table per channel |
//! | [`S2fft`](Format::S2fft) | complex with the phase, (c, L + 1, 2 L + 1) | `.npy` |
//! | [`Ktch`](Format::Ktch) | canonical, (c, K) | `.npy` |
//! | [`Flowshape`](Format::Flowshape) | canonical with the phase, (K, c) | `.npy` |
//! | [`Aics`](Format::Aics) | `C` and `S` normalised to 4 pi, with the phase, named | JSON or CSV; export only |
//! | [`Afni`](Format::Afni) | cosines, then sines, with the phase, one row per degree | text, one file per channel |
//! | [`Csv`](Format::Csv), [`Json`](Format::Json) | canonical | text |
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`convert`] | conversion of coefficients to and from the arrays of other packages |
//! | `coef`, `mat`, `shtools`, `fits`, `npy`, `aics`, `beta`, `table` | one file format each |
//! | `text` | numbers in text files |
//!
//! # Example
//!
//! ```
//! use ndarray::Array2;
//! use spharm_exchange::{ExportOptions, Format, ImportOptions, export, import};
//! use spharm_harmonics::Coefficients;
//! use spharm_model::Model;
//! use spharm_surface::Kind;
//!
//! let coefficients = Coefficients::new(Array2::from_shape_fn((9, 3), |(k, c)| k as f64 - c as f64))?;
//! let model = Model::without_sphere(coefficients, Kind::Surface);
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("body.coef");
//! export(&model, Format::Pdm, &path, &ExportOptions::default())?;
//! let back = import(&[&path], &ImportOptions::default())?;
//! assert_eq!(back.format, Format::Pdm);
//! assert!((back.coefficients.values() - model.coefficients.values()).iter().all(|d| d.abs() < 1e-14));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Sources
//!
//! SPHARM-PDM: M. Styner et al., "Framework for the statistical shape analysis of brain structures using SPHARM-PDM",
//! Insight Journal 2006. SPHARM-MAT: L. Shen, H. Farid, M. A. McPeek, Evolution 63 (2009). Weighted SPHARM: M. K. Chung
//! et al., IEEE TMI 26 (2007). SHTOOLS: M. A. Wieczorek, M. Meschede, G3 19 (2018). HEALPix: K. M. Gorski et al., ApJ
//! 622 (2005). FITS: standard 4.0. MAT files: "MAT-File Format", MathWorks, level 5.

#![forbid(unsafe_code)]

mod aics;
mod beta;
mod coef;
pub mod convert;
mod error;
mod export;
mod fits;
mod flaw;
mod format;
mod import;
mod mat;
mod npy;
mod shtools;
mod table;
mod text;

pub use error::ExchangeError;
pub use export::{ExportOptions, ExportWarning, Exported, check, export, files};
pub use format::{Format, Normalization};
pub use import::{ImportOptions, Imported, import};
