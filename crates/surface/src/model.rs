//! A SPHARM model: the coefficients of one fit, and what is needed to use them, as `NAME.spharm.npz`.
//!
//! The file is a NumPy archive, uncompressed, of these arrays:
//!
//! | name | type | what |
//! |---|---|---|
//! | `coefficients` | f64 (K, c) | canonical coefficients, row `l^2 + l + m`, in the input's unit |
//! | `max_degree` | i64 () | L, with K = (L + 1)^2 |
//! | `convention` | text () | [`CONVENTION`] |
//! | `faces` | i32 (F, 3) | triangles of the sphere, from 0; none when it was a list of angles |
//! | `directions` | f64 (n, 3) | unit vectors of the sampling |
//! | `scheme_key` | text () | key of the sampling scheme in a basis store |
//! | `provenance` | text () | JSON: how it was made |
//!
//! In Python: `m = numpy.load("lh.spharm.npz"); m["coefficients"]; str(m["scheme_key"])`. The bytes depend on the
//! contents alone: no times, no names of machines.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};

use ndarray::{Array0, Array2, ArrayView2, arr0};
use ndarray_npy::{ReadNpyExt, ReadableElement, WriteNpyExt};
use spharm_harmonics::Coefficients;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// What `convention` says in every model.
pub const CONVENTION: &str = "real orthonormal, no Condon-Shortley phase, row l^2 + l + m, sin(m phi) for negative m";

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// Unit vectors of the sampling, (n, 3).
    pub directions: Vec<[f64; 3]>,
    /// Triangles of the sampling, (F, 3); may be empty.
    pub faces: Vec<[u32; 3]>,
    /// Key of the sampling scheme.
    pub scheme_key: String,
    /// JSON: how it was made.
    pub provenance: String,
}

/// A model file that can't be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The operating system refused something.
    #[error("{}: cannot open the model: {source}", .path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not a file, or not one that `fit` wrote.
    #[error("{}: not a SPHARM model: {what}; expected a .spharm.npz file as fit writes it", .path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
}

impl Model {
    /// Writes the archive; `out` need not seek.
    ///
    /// # Errors
    ///
    /// Those of `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut zip = ZipWriter::new_stream(out);
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        let start = |zip: &mut ZipWriter<_>, name: &str| -> io::Result<()> {
            zip.start_file(format!("{name}.npy"), options).map_err(io::Error::other)
        };
        let npy = |result: Result<(), ndarray_npy::WriteNpyError>| result.map_err(io::Error::other);
        start(&mut zip, "coefficients")?;
        npy(self.coefficients.values().write_npy(&mut zip))?;
        start(&mut zip, "max_degree")?;
        npy(arr0(self.coefficients.max_degree() as i64).write_npy(&mut zip))?;
        start(&mut zip, "convention")?;
        write_text(&mut zip, CONVENTION)?;
        start(&mut zip, "faces")?;
        let faces: Vec<[i32; 3]> = self.faces.iter().map(|face| face.map(|v| v as i32)).collect();
        npy(ArrayView2::from(&faces[..]).write_npy(&mut zip))?;
        start(&mut zip, "directions")?;
        npy(ArrayView2::from(&self.directions[..]).write_npy(&mut zip))?;
        start(&mut zip, "scheme_key")?;
        write_text(&mut zip, &self.scheme_key)?;
        start(&mut zip, "provenance")?;
        write_text(&mut zip, &self.provenance)?;
        zip.finish().map_err(io::Error::other)?;
        Ok(())
    }

    /// Reads a model.
    ///
    /// # Errors
    ///
    /// [`ModelError`].
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let open = |source| ModelError::Open { path: path.to_path_buf(), source };
        let metadata = std::fs::metadata(path).map_err(open)?;
        if !metadata.is_file() {
            return Err(invalid(path, "it is not a regular file"));
        }
        let file = BufReader::new(File::open(path).map_err(open)?);
        let zip = ZipArchive::new(file).map_err(|error| invalid(path, error))?;
        Archive { path, zip, limit: metadata.len() }.read()
    }
}

fn invalid(path: &Path, what: impl ToString) -> ModelError {
    ModelError::Invalid { path: path.to_path_buf(), what: what.to_string() }
}

struct Archive<'p, R> {
    path: &'p Path,
    zip: ZipArchive<R>,
    /// Length of the file. Arrays are stored uncompressed, so none is longer.
    limit: u64,
}

impl<R: Read + Seek> Archive<'_, R> {
    fn read(mut self) -> Result<Model, ModelError> {
        let values = self.array::<f64>("coefficients")?;
        if values.iter().any(|value| !value.is_finite()) {
            return Err(invalid(self.path, "coefficients has a NaN or infinite value"));
        }
        let coefficients = Coefficients::new(values).map_err(|error| invalid(self.path, error))?;
        let convention = self.text("convention")?;
        if convention != CONVENTION {
            return Err(invalid(self.path, format!("convention is {convention:?}, expected {CONVENTION:?}")));
        }
        let bytes = self.entry("max_degree")?;
        let max_degree =
            Array0::<i64>::read_npy(&bytes[..]).map_err(|e| invalid(self.path, format!("max_degree: {e}")))?;
        if max_degree.into_scalar() != coefficients.max_degree() as i64 {
            return Err(invalid(self.path, "max_degree doesn't fit the number of coefficients"));
        }
        let directions = triples(&self.array::<f64>("directions")?).ok_or_else(|| invalid(self.path, "directions"))?;
        let faces = triples(&self.array::<i32>("faces")?).ok_or_else(|| invalid(self.path, "faces"))?;
        let in_range = |v: i32| usize::try_from(v).is_ok_and(|v| v < directions.len());
        if faces.iter().flatten().any(|&v| !in_range(v)) {
            return Err(invalid(self.path, "faces names a vertex that isn't there"));
        }
        Ok(Model {
            coefficients,
            faces: faces.into_iter().map(|face| face.map(|v| v as u32)).collect(),
            directions,
            scheme_key: self.text("scheme_key")?,
            provenance: self.text("provenance")?,
        })
    }

    fn entry(&mut self, name: &str) -> Result<Vec<u8>, ModelError> {
        let what = |error: &dyn std::fmt::Display| invalid(self.path, format!("{name}: {error}"));
        let mut entry = self.zip.by_name(&format!("{name}.npy")).map_err(|error| what(&error))?;
        let mut bytes = Vec::new();
        entry.by_ref().take(self.limit).read_to_end(&mut bytes).map_err(|error| what(&error))?;
        Ok(bytes)
    }

    fn array<T: ReadableElement>(&mut self, name: &str) -> Result<Array2<T>, ModelError> {
        let bytes = self.entry(name)?;
        // ndarray-npy allocates what the header claims before it reads.
        if claimed_values(&bytes).is_none_or(|count| count > bytes.len() as u64) {
            return Err(invalid(self.path, format!("{name}: its shape doesn't fit its length")));
        }
        Array2::read_npy(&bytes[..]).map_err(|error| invalid(self.path, format!("{name}: {error}")))
    }

    fn text(&mut self, name: &str) -> Result<String, ModelError> {
        let bytes = self.entry(name)?;
        read_text(&bytes).ok_or_else(|| invalid(self.path, format!("{name}: expected a text")))
    }
}

/// Number of values that the header of a NumPy array claims; an upper bound of a byte a value holds for any type.
fn claimed_values(npy: &[u8]) -> Option<u64> {
    let head = String::from_utf8_lossy(&npy[..npy.len().min(1024)]).into_owned();
    let (_, rest) = head.split_once("'shape':")?;
    let (shape, _) = rest.split_once('(')?.1.split_once(')')?;
    let lengths = shape.split(',').map(str::trim).filter(|length| !length.is_empty());
    lengths.map(|length| length.parse::<u64>().ok()).try_fold(1u64, |product, length| product.checked_mul(length?))
}

fn triples<T: Copy>(array: &Array2<T>) -> Option<Vec<[T; 3]>> {
    (array.ncols() == 3).then(|| array.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}

const NPY_MAGIC: &[u8] = b"\x93NUMPY\x01\x00";

/// A NumPy array () of type `<U`: UCS-4, as `numpy.array("text")` is stored. ndarray-npy has no texts.
fn write_text(out: &mut dyn Write, text: &str) -> io::Result<()> {
    let characters = text.chars().count().max(1);
    let mut header = format!("{{'descr': '<U{characters}', 'fortran_order': False, 'shape': (), }}");
    // The whole header is a multiple of 64 bytes and ends in a new line.
    let length = (NPY_MAGIC.len() + 2 + header.len() + 1).next_multiple_of(64) - NPY_MAGIC.len() - 2;
    header.extend(std::iter::repeat_n(' ', length - header.len() - 1));
    header.push('\n');
    out.write_all(NPY_MAGIC)?;
    out.write_all(&(length as u16).to_le_bytes())?;
    out.write_all(header.as_bytes())?;
    for character in text.chars().chain(text.is_empty().then_some('\0')) {
        out.write_all(&(character as u32).to_le_bytes())?;
    }
    Ok(())
}

fn read_text(bytes: &[u8]) -> Option<String> {
    let rest = bytes.strip_prefix(NPY_MAGIC)?;
    let (length, rest) = rest.split_first_chunk::<2>()?;
    let (header, data) = rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))?;
    if !std::str::from_utf8(header).ok()?.contains("'descr': '<U") {
        return None;
    }
    let code = |bytes: &[u8]| char::from_u32(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let text: String = data.chunks_exact(4).map(code).collect::<Option<_>>()?;
    Some(text.trim_end_matches('\0').to_owned())
}

/// Writes the paper's complex coefficients as rows `l,m,x_re,x_im,y_re,y_im,z_re,z_im`; channels that aren't three are
/// named `c0`, `c1`, ...
///
/// # Errors
///
/// Those of `out`.
pub fn write_complex_csv(coefficients: &Coefficients, out: &mut dyn Write) -> io::Result<()> {
    let complex = coefficients.to_complex();
    let names: Vec<String> = match coefficients.channels() {
        3 => ["x", "y", "z"].map(str::to_owned).to_vec(),
        channels => (0..channels).map(|channel| format!("c{channel}")).collect(),
    };
    write!(out, "l,m")?;
    names.iter().try_for_each(|name| write!(out, ",{name}_re,{name}_im"))?;
    writeln!(out)?;
    for (row, values) in complex.rows().into_iter().enumerate() {
        let (degree, order) = spharm_harmonics::index::degree_order(row);
        write!(out, "{degree},{order}")?;
        values.iter().try_for_each(|c| write!(out, ",{:?},{:?}", c.re, c.im))?;
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Model {
        let values = Array2::from_shape_fn((9, 3), |(k, c)| 0.1 * k as f64 - c as f64);
        Model {
            coefficients: Coefficients::new(values).unwrap(),
            directions: vec![[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            faces: vec![[0, 1, 2]],
            scheme_key: "ab".repeat(32),
            provenance: "{\"tool\":\"f\u{fc}t\"}".to_owned(),
        }
    }

    #[test]
    fn what_is_written_is_read_and_the_bytes_are_the_same_each_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spharm.npz");
        let (mut first, mut second) = (Vec::new(), Vec::new());
        model().write(&mut first).unwrap();
        model().write(&mut second).unwrap();
        assert_eq!(first, second);
        std::fs::write(&path, &first).unwrap();
        assert_eq!(Model::read(&path).unwrap(), model());
    }

    #[test]
    fn a_damaged_model_is_an_error_at_any_length() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spharm.npz");
        let mut bytes = Vec::new();
        model().write(&mut bytes).unwrap();
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(Model::read(&path).is_err(), "{length} of {} bytes", bytes.len());
        }
    }

    /// A header that claims more than there is must not be believed: 24 TB would be allocated.
    #[test]
    fn an_array_that_claims_to_be_huge_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spharm.npz");
        let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776, 3), }";
        let padded = format!("{header:<117}\n");
        let npy = [NPY_MAGIC, &(padded.len() as u16).to_le_bytes(), padded.as_bytes()].concat();
        let mut zip = ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        zip.start_file("coefficients.npy", options).unwrap();
        zip.write_all(&npy).unwrap();
        std::fs::write(&path, zip.finish().unwrap().into_inner()).unwrap();
        let error = Model::read(&path).unwrap_err().to_string();
        assert!(error.contains("coefficients: its shape"), "{error}");
    }

    #[test]
    fn complex_rows_have_the_published_columns() {
        let mut csv = Vec::new();
        write_complex_csv(&model().coefficients, &mut csv).unwrap();
        let csv = String::from_utf8(csv).unwrap();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines[0], "l,m,x_re,x_im,y_re,y_im,z_re,z_im");
        assert!(lines[2].starts_with("1,-1,"));
        assert_eq!(lines.len(), 10);
    }
}
