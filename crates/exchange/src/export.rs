//! Exports models to files of other packages.

use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};

use spharm_model::Model;
use spharm_surface::io::write_new;

use crate::error::ExchangeError;
use crate::format::{Format, Normalization};
use crate::{aics, beta, coef, fits, mat, npy, shtools, table};

/// Options of [`export()`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ExportOptions {
    /// Whether existing files are overwritten.
    pub overwrite: bool,
    /// Normalisation of the harmonics in pyshtools' files. All other formats have a fixed normalisation.
    pub normalization: Normalization,
}

/// Result of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// Paths of the files written: one file, or one per channel.
    pub files: Vec<PathBuf>,
    /// Warnings about the files written.
    pub warnings: Vec<ExportWarning>,
}

/// A limitation on the use of an exported file by the other package.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ExportWarning {
    /// The model's degree exceeds 85, the highest degree that SPHARM-PDM can evaluate.
    PdmDegree {
        /// The model's degree.
        degree: usize,
    },
    /// The model has no sphere, so the exported SPHARM-MAT file has coefficients, but no surface or sphere.
    NoSphere,
}

impl fmt::Display for ExportWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PdmDegree { degree } => write!(
                f,
                "degree {degree}: SPHARM-PDM's own programs can't evaluate degrees above {}; other programs can read \
                 the file",
                coef::HIGHEST_EVALUATED
            ),
            Self::NoSphere => f.write_str(
                "the model has no sphere of its own, so the file contains fvec, but not vertices, faces and sph_verts",
            ),
        }
    }
}

/// Returns the paths of the files of an exported model: `path`, or, for formats with one file per channel,
/// `NAME.x.ENDING`, `NAME.y.ENDING` and so on.
#[must_use]
pub fn files(format: Format, channels: usize, path: &Path) -> Vec<PathBuf> {
    if !format.file_a_channel() || channels == 1 {
        return vec![path.to_owned()];
    }
    let named = |name: String| {
        let mut ending = OsString::from(name);
        if let Some(of_path) = path.extension() {
            ending.push(".");
            ending.push(of_path);
        }
        path.with_extension(ending)
    };
    table::channel_names(channels).into_iter().map(named).collect()
}

/// Checks that a format can represent a model.
///
/// # Errors
///
/// [`CannotHold`](ExchangeError::CannotHold) if the format doesn't support the model's number of channels.
pub fn check(model: &Model, format: Format) -> Result<(), ExchangeError> {
    let channels = model.coefficients.channels();
    let cannot = |format, holds, hint| Err(ExchangeError::CannotHold { format, holds, channels, hint });
    match format {
        Format::Pdm if channels != 3 => {
            cannot("SPHARM-PDM", "surfaces (3 channels)", "; csv and json files can hold any number of channels")
        }
        Format::Mat if channels != 3 => {
            cannot("SPHARM-MAT", "surfaces (3 channels)", "; csv and json files can hold any number of channels")
        }
        Format::Aics if channels != 1 => cannot(
            "aics-shparam",
            "the radius of a star-shaped body (1 channel)",
            "; fit the distance from a center as a signal, instead of x, y and z",
        ),
        _ => Ok(()),
    }
}

/// Writes a model to one or more files in a given format. Each file is written atomically.
///
/// # Errors
///
/// The errors of [`check`], [`DegreeTooHigh`](ExchangeError::DegreeTooHigh) if the normalisation doesn't support the
/// model's degree, [`Model`](ExchangeError::Model) if the model can't be evaluated, and
/// [`Surface`](ExchangeError::Surface) if a file exists and `overwrite` isn't set, or if a file can't be written.
pub fn export(model: &Model, format: Format, path: &Path, options: &ExportOptions) -> Result<Exported, ExchangeError> {
    check(model, format)?;
    let a = &model.coefficients;
    if let (Format::Pyshtools, Some(highest)) = (format, options.normalization.highest())
        && a.max_degree() > highest
    {
        let (normalization, degree) = (options.normalization.name(), a.max_degree());
        return Err(ExchangeError::DegreeTooHigh { normalization, highest, degree });
    }
    let files = files(format, a.channels(), path);
    let mut warnings = Vec::new();
    let surface = match (&model.sphere, format) {
        (Some(sphere), Format::Mat) => {
            let values = model.evaluate(&sphere.directions, a.max_degree())?;
            let vertices: Vec<[f64; 3]> = values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
            Some((vertices, sphere))
        }
        (None, Format::Mat) => {
            warnings.push(ExportWarning::NoSphere);
            None
        }
        _ => None,
    };
    if format == Format::Pdm && a.max_degree() > coef::HIGHEST_EVALUATED {
        warnings.push(ExportWarning::PdmDegree { degree: a.max_degree() });
    }
    let as_csv = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
    for (channel, file) in files.iter().enumerate() {
        write_new(file, options.overwrite, |out| match format {
            Format::Pdm => coef::write(out, a),
            Format::Mat => {
                let surface = surface.as_ref().map(|(vertices, sphere)| mat::Surface {
                    vertices,
                    faces: &sphere.faces,
                    sphere: sphere.directions.as_slice(),
                });
                mat::write(out, a, surface.as_ref())
            }
            Format::Pyshtools => shtools::write(out, a, channel, options.normalization),
            Format::Healpy => fits::write(out, a),
            Format::S2fft | Format::Ktch | Format::Flowshape => npy::write(out, a, format),
            Format::Aics if as_csv => aics::write_csv(out, a),
            Format::Aics => aics::write_json(out, a),
            Format::Afni => beta::write(out, a, channel),
            Format::Csv => table::write_csv(out, a),
            Format::Json => table::write_json(out, a),
        })?;
    }
    Ok(Exported { files, warnings })
}
