//! Imports models from files of other packages.

use std::io::{self, Read};
use std::path::Path;

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_surface::Sphere;
use spharm_surface::io::check_room;

use crate::convert::with_phase;
use crate::error::ExchangeError;
use crate::flaw::Flaw;
use crate::format::{Format, Normalization};
use crate::text::text;
use crate::{beta, coef, fits, mat, npy, shtools, table};

/// Options of [`import()`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// The format of the files, or `None` (default) to determine it from their contents.
    pub format: Option<Format>,
    /// Normalisation of pyshtools' files, which isn't recorded in the files.
    pub normalization: Normalization,
    /// Whether the harmonics of pyshtools' files have the Condon-Shortley phase (`csphase=-1`), which isn't recorded
    /// in the files.
    pub condon_shortley: bool,
}

/// Result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The canonical coefficients, all finite: K rows, one per harmonic, and c columns, one per channel.
    pub coefficients: Coefficients,
    /// The sphere of a SPHARM-MAT file, if it has one. The other formats don't contain a sphere.
    pub sphere: Option<Sphere>,
    /// The format of the first file.
    pub format: Format,
    /// Whether a file also has the errors (uncertainties) of its coefficients. The import ignores these errors.
    pub errors_left_out: bool,
}

/// Reads a model from one or more files. The channels of all files are combined in the order of the files.
///
/// # Errors
///
/// [`Io`](ExchangeError::Io) if a file can't be read, [`Malformed`](ExchangeError::Malformed) if its contents violate
/// the format, [`OtherContents`](ExchangeError::OtherContents) if it holds data other than coefficients,
/// [`Unknown`](ExchangeError::Unknown) if its format can't be determined, [`WrittenOnly`](ExchangeError::WrittenOnly)
/// if the format can only be exported, [`SeveralModels`](ExchangeError::SeveralModels) if one of several files has more
/// than one channel, and [`Degrees`](ExchangeError::Degrees) or [`Formats`](ExchangeError::Formats) if the files differ
/// in degree or format.
pub fn import<P: AsRef<Path>>(files: &[P], options: &ImportOptions) -> Result<Imported, ExchangeError> {
    let mut whole: Option<Imported> = None;
    for path in files.iter().map(AsRef::as_ref) {
        let found = one(path, options)?;
        let channels = found.coefficients.channels();
        // If the formats differ, the files are refused below, with an error that states both formats.
        let one_format = whole.as_ref().is_none_or(|before| before.format == found.format);
        if one_format && files.len() > 1 && channels > 1 {
            return Err(ExchangeError::SeveralModels { path: path.to_owned(), channels });
        }
        whole = Some(match whole {
            None => found,
            Some(before) if before.format != found.format => {
                let first = files.first().map_or(path, AsRef::as_ref).to_owned();
                let (path, expected, found) = (path.to_owned(), before.format.file(), found.format.file());
                return Err(ExchangeError::Formats { path, found, first, expected });
            }
            Some(before) => {
                let (expected, found_degree) = (before.coefficients.max_degree(), found.coefficients.max_degree());
                let values = ndarray::concatenate(
                    ndarray::Axis(1),
                    &[before.coefficients.values().view(), found.coefficients.values().view()],
                );
                let errors_left_out = before.errors_left_out || found.errors_left_out;
                let joined = values.ok().and_then(|values| Coefficients::new(values).ok());
                let coefficients = joined.ok_or_else(|| ExchangeError::Degrees {
                    path: path.to_owned(),
                    found: found_degree,
                    first: files.first().map_or(path, AsRef::as_ref).to_owned(),
                    expected,
                })?;
                Imported { coefficients, errors_left_out, ..before }
            }
        });
    }
    whole.ok_or_else(|| ExchangeError::Io {
        path: Path::new("").to_owned(),
        source: io::Error::new(io::ErrorKind::NotFound, "no file"),
    })
}

fn one(path: &Path, options: &ImportOptions) -> Result<Imported, ExchangeError> {
    let bytes = load(path).map_err(|source| ExchangeError::Io { path: path.to_owned(), source })?;
    let format = match options.format {
        Some(format) => format,
        None => detect(path, &bytes)?,
    };
    if format == Format::Aics {
        return Err(ExchangeError::WrittenOnly { path: path.to_owned(), package: "aics-shparam" });
    }
    let (coefficients, sphere) = parse(&bytes, format, options).map_err(|flaw| flaw.at(path, format.file()))?;
    let values = coefficients.values();
    if let Some(((row, channel), x)) = values.indexed_iter().find(|(_, x)| !x.is_finite()) {
        let found = format!("{x} in row {row} of channel {channel}");
        return Err(Flaw::new("finite coefficients", found).at(path, format.file()));
    }
    let errors_left_out = format == Format::Pyshtools && !npy::is_npy(&bytes) && shtools::has_errors(&bytes);
    Ok(Imported { coefficients, sphere, format, errors_left_out })
}

/// Reads a regular file completely. Other kinds of files, such as FIFOs, are rejected, because reading them could
/// block.
fn load(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = spharm_files::open(path)?;
    // Check that enough memory is free for the bytes of the file and for the parsed numbers, which take about as many
    // bytes as the text. Check before reading, because the length of a sparse file can far exceed its size on disk.
    check_room(file.metadata()?.len().saturating_mul(2))
        .map_err(|room| io::Error::other(format!("the contents need {room}")))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Determines the format of a file from its contents.
fn detect(path: &Path, bytes: &[u8]) -> Result<Format, ExchangeError> {
    let unknown = |found: String, remedy| ExchangeError::Unknown { path: path.to_owned(), found, remedy };
    if mat::is_mat(bytes) {
        return Ok(Format::Mat);
    }
    if fits::is_fits(bytes) {
        return Ok(Format::Healpy);
    }
    if npy::is_npy(bytes) {
        return npy::format_of(bytes)
            .map_err(|found| unknown(found, "ktch (c, K), flowshape (K, c), s2fft or pyshtools"));
    }
    if coef::is_coef(bytes) {
        return Ok(Format::Pdm);
    }
    match text(bytes) {
        Ok(text) if table::is_csv(text) => Ok(Format::Csv),
        Ok(text) if text.contains("\"shcoeffs_L") || text.starts_with("shcoeffs_L") => Ok(Format::Aics),
        Ok(text) if text.trim_start().starts_with('{') => Ok(Format::Json),
        Ok(text) if shtools::is_shtools(text) || shtools::is_gfc(text) => Ok(Format::Pyshtools),
        Ok(_) => Err(unknown("text".to_owned(), "pyshtools (l, m, C, S), afni (one row per degree), pdm, csv or json")),
        Err(_) => Err(unknown(
            "unknown bytes".to_owned(),
            "pdm, mat, pyshtools, healpy, s2fft, ktch, flowshape, afni, csv or json",
        )),
    }
}

fn parse(bytes: &[u8], format: Format, options: &ImportOptions) -> Result<(Coefficients, Option<Sphere>), Flaw> {
    let scale = options.normalization;
    let channel = |values: Vec<f64>| columns(&[values]);
    let coefficients = match format {
        Format::Mat => return mat::read(bytes),
        Format::Pdm => coef::read(bytes)?,
        Format::Pyshtools if npy::is_npy(bytes) => npy::read(bytes, format, scale)?,
        Format::Pyshtools => channel(shtools::read(bytes, scale)?)?,
        Format::Healpy => columns(&fits::read(bytes)?)?,
        Format::S2fft | Format::Ktch | Format::Flowshape => npy::read(bytes, format, scale)?,
        Format::Afni => channel(beta::read(bytes)?)?,
        Format::Csv => table::read_csv(bytes)?,
        Format::Json => table::read_json(bytes)?,
        Format::Aics => return Err(Flaw::new("a format that can be imported", format)),
    };
    if format != Format::Pyshtools {
        return Ok((coefficients, None));
    }
    let degree = coefficients.max_degree();
    if let Some(highest) = scale.highest().filter(|highest| degree > *highest) {
        return Err(Flaw::new(format!("degrees up to {highest} with the normalisation {}", scale.name()), degree));
    }
    if !options.condon_shortley {
        return Ok((coefficients, None));
    }
    let coefficients = Coefficients::new(with_phase(coefficients.values()));
    Ok((coefficients.map_err(|error| Flaw::new("(L + 1)^2 coefficients", error))?, None))
}

/// Combines the coefficients of several channels, which must have equal degrees.
fn columns(channels: &[Vec<f64>]) -> Result<Coefficients, Flaw> {
    let rows = channels.first().map_or(0, Vec::len);
    if let Some(other) = channels.iter().find(|channel| channel.len() != rows) {
        return Err(Flaw::new(format!("{rows} coefficients in every channel"), other.len()));
    }
    let values = Array2::from_shape_vec((channels.len(), rows), channels.concat());
    let values = values.map_err(|error| Flaw::new("coefficients", error))?.t().as_standard_layout().into_owned();
    Coefficients::new(values).map_err(|error| Flaw::new("(L + 1)^2 coefficients", error))
}
