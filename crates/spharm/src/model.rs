//! From a fit to a model, with how it was made.

use std::fmt;
use std::fs::File;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use spharm_store::format::VERSION as STORE_FORMAT;
use spharm_surface::{Kind, Model, Sphere};

use crate::assess::Distances;
use crate::{Error, Fit};

/// Versions that a result may depend on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Versions {
    /// This library and its programs.
    pub spharm: &'static str,
    /// The store's format.
    pub store_format: u32,
    /// Operating system and processor.
    pub platform: (&'static str, &'static str),
}

impl Versions {
    /// Returns the versions of this build.
    pub fn current() -> Self {
        Self {
            spharm: env!("CARGO_PKG_VERSION"),
            store_format: STORE_FORMAT,
            platform: (std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

/// A file that a result was made from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Its path, as it was given.
    pub path: String,
    /// Its size.
    pub bytes: u64,
    /// The BLAKE3 hash of its contents, in hexadecimal digits.
    pub blake3: String,
    /// Of a volume, the label that the surface was made of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<i64>,
}

impl fmt::Display for FileRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.path)?;
        self.label.map_or(Ok(()), |label| write!(f, " label {label}"))
    }
}

impl FileRecord {
    /// Reads a file's size and hash.
    ///
    /// # Errors
    ///
    /// [`Error::Input`] where there is no such file, or no regular one, and when it can't be read.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let refuse = |source| Error::Input { path: path.to_owned(), source };
        // A FIFO would be waited for.
        if !path.is_file() {
            let problem = if path.exists() { "not a regular file" } else { "no such file" };
            return Err(refuse(io::Error::other(problem)));
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(File::open(path).map_err(refuse)?).map_err(refuse)?;
        let path = path.to_string_lossy().into_owned();
        Ok(Self { path, bytes: hasher.count(), blake3: hasher.finalize().to_hex().to_string(), label: None })
    }

    /// Returns whether two files have the same contents, whatever they are called, and the same label is meant.
    pub fn same_contents(&self, other: &Self) -> bool {
        (self.bytes, &self.blake3, self.label) == (other.bytes, &other.blake3, other.label)
    }
}

#[derive(Debug, Serialize)]
struct Provenance<'a> {
    tool: &'static str,
    versions: Versions,
    input: Option<&'a FileRecord>,
    /// The sphere's file, as it was given.
    sphere: Option<String>,
    /// Whether the sphere was made for this surface.
    parametrized: bool,
    method: &'static str,
    passes: usize,
    granularity: Option<usize>,
    start_degree: Option<usize>,
    accelerate: bool,
    weights: &'a str,
    hold_out: Option<f64>,
    tolerance: f64,
    /// `default`, `fixed` or `auto`.
    smoothness_choice: &'static str,
    /// Smoothness penalty, lambda.
    smoothness: f64,
    dtype: &'static str,
    surface: bool,
    scale: Option<f64>,
    distances: Option<Distances>,
    anatomical_structure_primary: Option<&'a str>,
}

/// Returns the model of a fit over a sphere; `input` is the target's file, where it has one.
pub fn model_of(sphere: &Sphere, fit: &Fit, input: Option<&FileRecord>) -> Model {
    let (report, settings) = (&fit.report, &fit.report.settings);
    let provenance = Provenance {
        tool: "fit",
        versions: Versions::current(),
        input,
        sphere: sphere.path.as_deref().map(|path| path.to_string_lossy().into_owned()),
        parametrized: sphere.parametrized,
        method: settings.method.name(),
        passes: settings.method.passes(),
        granularity: settings.method.granularity(),
        start_degree: settings.method.start_degree(),
        accelerate: settings.method.accelerated(),
        weights: &settings.weights,
        hold_out: settings.hold_out,
        tolerance: settings.tolerance,
        smoothness_choice: settings.smoothness.name(),
        smoothness: report.smoothness,
        dtype: settings.scalar.name(),
        surface: settings.kind == Kind::Surface,
        scale: report.scale,
        distances: report.passes.last().copied(),
        anatomical_structure_primary: settings.meta.anatomical_structure_primary.as_deref(),
    };
    Model {
        coefficients: fit.coefficients.clone(),
        directions: sphere.directions.as_slice().to_vec(),
        faces: sphere.faces.clone(),
        scheme_key: settings.scheme.to_string(),
        provenance: serde_json::to_string(&provenance).unwrap_or_default(),
    }
}
