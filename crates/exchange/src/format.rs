//! Lists the supported formats, their names and their file-name extensions.

use std::fmt;
use std::str::FromStr;

/// A file format for coefficients: the format of another package, or plain text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Format {
    /// SPHARM-PDM's `.coef` files.
    Pdm,
    /// SPHARM-MAT's `.mat` files.
    Mat,
    /// SHTOOLS' text files of coefficients.
    Pyshtools,
    /// FITS tables, as written by healpy's `write_alm`.
    Healpy,
    /// s2fft's arrays of complex coefficients, as NumPy files.
    S2fft,
    /// ktch's arrays of coefficients, as NumPy files.
    Ktch,
    /// FlowShape's arrays of coefficients, as NumPy files.
    Flowshape,
    /// Named coefficients of a star-shaped body's radius, for aics-shparam. This format can only be exported.
    Aics,
    /// Matrices of weighted SPHARM, as written by Chung's MATLAB code and AFNI.
    Afni,
    /// A CSV table with columns `l,m,x,y,z`.
    Csv,
    /// A JSON object with the coefficients and their convention.
    Json,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 11] = [
        Self::Pdm,
        Self::Mat,
        Self::Pyshtools,
        Self::Healpy,
        Self::S2fft,
        Self::Ktch,
        Self::Flowshape,
        Self::Aics,
        Self::Afni,
        Self::Csv,
        Self::Json,
    ];

    /// Returns the name of the format, as used on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pdm => "pdm",
            Self::Mat => "mat",
            Self::Pyshtools => "pyshtools",
            Self::Healpy => "healpy",
            Self::S2fft => "s2fft",
            Self::Ktch => "ktch",
            Self::Flowshape => "flowshape",
            Self::Aics => "aics",
            Self::Afni => "afni",
            Self::Csv => "csv",
            Self::Json => "json",
        }
    }

    /// Returns the file-name extension of models exported in this format.
    #[must_use]
    pub fn ending(self) -> &'static str {
        match self {
            Self::Pdm => "coef",
            Self::Mat => "mat",
            Self::Pyshtools => "sh",
            Self::Healpy => "alm.fits",
            Self::S2fft => "s2fft.npy",
            Self::Ktch => "ktch.npy",
            Self::Flowshape => "flowshape.npy",
            Self::Aics => "aics.json",
            Self::Afni => "beta.1D",
            Self::Csv => "csv",
            Self::Json => "json",
        }
    }

    /// Returns the extensions that the name of a file in this format may have, in lower case. A name without an
    /// extension is valid too.
    #[must_use]
    pub fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Pdm => &[".coef"],
            Self::Mat => &[".mat"],
            Self::Pyshtools => &[".sh", ".txt", ".dat"],
            Self::Healpy => &[".fits", ".fit"],
            Self::S2fft | Self::Ktch | Self::Flowshape => &[".npy"],
            Self::Aics => &[".json", ".csv"],
            Self::Afni => &[".1d", ".txt"],
            Self::Csv => &[".csv"],
            Self::Json => &[".json"],
        }
    }

    /// Returns a description of a file in this format for messages, beginning with an article.
    pub(crate) fn file(self) -> &'static str {
        match self {
            Self::Pdm => "a SPHARM-PDM .coef file",
            Self::Mat => "a SPHARM-MAT .mat file",
            Self::Pyshtools => "an SHTOOLS text file",
            Self::Healpy => "a healpy FITS file",
            Self::S2fft => "an s2fft array",
            Self::Ktch => "a ktch array",
            Self::Flowshape => "a FlowShape array",
            Self::Aics => "a file for aics-shparam",
            Self::Afni => "a matrix of weighted SPHARM",
            Self::Csv => "a table of coefficients",
            Self::Json => "a JSON file of coefficients",
        }
    }

    /// Returns whether each channel is stored in its own file.
    #[must_use]
    pub fn file_a_channel(self) -> bool {
        matches!(self, Self::Pyshtools | Self::Afni)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL.into_iter().find(|format| format.name() == name).ok_or_else(|| format!("expected one of {}", names()))
    }
}

/// Normalisation of the harmonics in pyshtools' files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Normalization {
    /// The square of a harmonic integrates to 1 over the sphere: pyshtools' `ortho`, which this library also uses.
    #[default]
    Orthonormal,
    /// The square of a harmonic integrates to 4 pi over the sphere, as in geodesy: pyshtools' `4pi`, its default.
    FourPi,
    /// The square of a harmonic of degree l integrates to 4 pi / (2 l + 1): pyshtools' `schmidt`.
    Schmidt,
    /// The harmonics are products of associated Legendre functions and cosines or sines: pyshtools' `unnorm`.
    Unnormalized,
}

impl Normalization {
    /// All normalisations.
    pub const ALL: [Self; 4] = [Self::Orthonormal, Self::FourPi, Self::Schmidt, Self::Unnormalized];

    /// Returns pyshtools' name of the normalisation.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Orthonormal => "ortho",
            Self::FourPi => "4pi",
            Self::Schmidt => "schmidt",
            Self::Unnormalized => "unnorm",
        }
    }

    /// Returns the highest degree at which the normalisation's factors for all orders are in the range of f64; `None`
    /// if there is no such limit.
    pub(crate) fn highest(self) -> Option<usize> {
        (self == Self::Unnormalized).then_some(150)
    }

    /// Returns the factor that converts a canonical coefficient of degree l and order m <= l to this normalisation.
    pub(crate) fn factor(self, l: usize, m: usize) -> f64 {
        let whole = 4.0 * std::f64::consts::PI;
        match self {
            Self::Orthonormal => 1.0,
            Self::FourPi => 1.0 / whole.sqrt(),
            Self::Schmidt => ((2 * l + 1) as f64 / whole).sqrt(),
            Self::Unnormalized => {
                // The product is sqrt((l - m)! / (l + m)!).
                let orders: f64 = ((l + 1).saturating_sub(m)..=l + m).map(|k| 1.0 / (k as f64).sqrt()).product();
                let halves = if m == 0 { 1.0 } else { 2.0 };
                (halves * (2 * l + 1) as f64 / whole).sqrt() * orders
            }
        }
    }
}
