//! Reads and writes models as NumPy archives (`.npz`).

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};

use ndarray::Array2;
use spharm_harmonics::{Coefficients, Directions};
use spharm_surface::io::most_expanded;
use spharm_surface::{Seam, Sphere};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::error::ModelError;
use crate::model::{CONVENTION, Model};
use crate::npy::{Array, write_header, write_text};
use crate::provenance::Provenance;

/// First bytes of a compressed model.
const COMPRESSED: [u8; 4] = *b"\x89SPZ";

/// Writes the arrays of a model to an uncompressed archive.
pub(crate) fn write(model: &Model, out: &mut dyn Write) -> io::Result<()> {
    if model.not_finite().is_some() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "a coefficient is NaN or infinite"));
    }
    let mut zip = ZipWriter::new_stream(out);
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
    let start = |zip: &mut ZipWriter<_>, name: &str| -> io::Result<()> {
        zip.start_file(format!("{name}.npy"), options).map_err(io::Error::other)
    };
    let values = model.coefficients.values();
    start(&mut zip, "coefficients")?;
    write_header(&mut zip, "<f8", &format!("({}, {})", values.nrows(), values.ncols()))?;
    write_all(&mut zip, values.iter().map(|x| x.to_le_bytes()))?;
    start(&mut zip, "max_degree")?;
    write_header(&mut zip, "<i8", "()")?;
    zip.write_all(&(model.coefficients.max_degree() as i64).to_le_bytes())?;
    start(&mut zip, "convention")?;
    write_text(&mut zip, CONVENTION)?;
    if let Some(sphere) = &model.sphere {
        start(&mut zip, "faces")?;
        write_header(&mut zip, "<i4", &format!("({}, 3)", sphere.faces.len()))?;
        write_all(&mut zip, sphere.faces.as_flattened().iter().map(|v| v.to_le_bytes()))?;
        start(&mut zip, "directions")?;
        let directions = sphere.directions.as_slice();
        write_header(&mut zip, "<f8", &format!("({}, 3)", directions.len()))?;
        write_all(&mut zip, directions.as_flattened().iter().map(|x| x.to_le_bytes()))?;
        if let Some(Seam { vertices, faces, copies }) = &sphere.seam {
            start(&mut zip, "cut_from")?;
            write_header(&mut zip, "<i8", "(2,)")?;
            write_all(&mut zip, [*vertices as i64, *faces as i64].iter().map(|x| x.to_le_bytes()))?;
            start(&mut zip, "seam")?;
            write_header(&mut zip, "<i4", &format!("({},)", copies.len()))?;
            write_all(&mut zip, copies.iter().map(|v| v.to_le_bytes()))?;
        }
    }
    if let Some(key) = &model.scheme_key {
        start(&mut zip, "scheme_key")?;
        write_text(&mut zip, key)?;
    }
    start(&mut zip, "provenance")?;
    write_text(&mut zip, &serde_json::to_string(&model.provenance)?)?;
    zip.finish().map_err(io::Error::other)?;
    Ok(())
}

pub(crate) fn write_all<const N: usize>(out: &mut dyn Write, values: impl Iterator<Item = [u8; N]>) -> io::Result<()> {
    let mut out = io::BufWriter::with_capacity(1 << 16, out);
    for value in values {
        out.write_all(&value)?;
    }
    out.flush()
}

/// Reads a model from an archive; `path` is only used in error messages.
pub(crate) fn read(path: &Path, input: impl Read + Seek) -> Result<Model, ModelError> {
    let mut zip = opened(path, input)?;
    Archive { path, zip: &mut zip }.read()
}

/// Reads only the provenance of a model from an archive; `path` is only used in error messages.
pub(crate) fn read_provenance(path: &Path, input: impl Read + Seek) -> Result<Provenance, ModelError> {
    let mut zip = opened(path, input)?;
    Archive { path, zip: &mut zip }.provenance()
}

/// Opens the file of an archive.
pub(crate) fn file(path: &Path) -> Result<BufReader<File>, ModelError> {
    let file = spharm_files::open(path).map_err(|source| ModelError::Open { path: path.to_owned(), source })?;
    Ok(BufReader::new(file))
}

/// Opens an archive; `path` is only used in error messages. Compressed models are recognised by their first bytes.
pub(crate) fn opened<R: Read + Seek>(path: &Path, mut input: R) -> Result<ZipArchive<R>, ModelError> {
    let mut start = [0; COMPRESSED.len()];
    if input.read_exact(&mut start).is_ok() && start == COMPRESSED {
        return Err(ModelError::Compressed { path: path.to_owned() });
    }
    input.rewind().map_err(|error| invalid(path, error))?;
    ZipArchive::new(input).map_err(|error| invalid(path, error))
}

fn invalid(path: &Path, problem: impl ToString) -> ModelError {
    ModelError::Invalid { path: path.to_owned(), problem: problem.to_string() }
}

pub(crate) struct Archive<'p, R> {
    pub(crate) path: &'p Path,
    pub(crate) zip: R,
}

impl<R: Read + Seek> Archive<'_, &mut ZipArchive<R>> {
    fn read(mut self) -> Result<Model, ModelError> {
        let path = self.path;
        let coefficients = self
            .array("coefficients", Array::matrix)?
            .ok_or_else(|| invalid(path, "the file has no array `coefficients`"))?;
        let coefficients = Coefficients::new(coefficients).map_err(|error| invalid(path, error))?;
        if let Some(convention) = self.array("convention", Array::text)?
            && convention != CONVENTION
        {
            return Err(invalid(path, format!("the convention is {convention:?}, expected {CONVENTION:?}")));
        }
        if let Some(max_degree) = self.array("max_degree", Array::scalar)?
            && max_degree != coefficients.max_degree() as f64
        {
            return Err(invalid(path, "max_degree doesn't match the number of coefficients"));
        }
        let provenance = self.provenance()?;
        let mut sphere = self.sphere()?;
        if let Some(sphere) = &mut sphere {
            sphere.anatomical_structure.clone_from(&provenance.anatomical_structure_primary);
            sphere.path = provenance.sphere.as_ref().map(PathBuf::from);
            sphere.parametrized = provenance.parametrized;
        }
        let model = Model {
            coefficients,
            sphere,
            scheme_key: self.array("scheme_key", Array::text)?.filter(|key| !key.is_empty()),
            provenance,
        };
        match model.not_finite() {
            None => Ok(model),
            Some((row, channel, value)) => Err(ModelError::NonFinite { path: path.to_owned(), row, channel, value }),
        }
    }

    fn provenance(&mut self) -> Result<Provenance, ModelError> {
        let text = self.array("provenance", Array::text)?;
        Ok(text.map(|text| Provenance::parse(&text)).unwrap_or_default())
    }

    fn sphere(&mut self) -> Result<Option<Sphere>, ModelError> {
        let path = self.path;
        let Some(directions) = self.array("directions", Array::matrix)? else { return Ok(None) };
        let vectors = triples(&directions).ok_or_else(|| invalid(path, "directions: expected three columns"))?;
        // Vectors of exact unit length, as `write` stores them, are used unchanged. Other vectors are normalised.
        let directions = Directions::from_unit_vectors(vectors.clone())
            .or_else(|_| Directions::from_vertices(&vectors))
            .map_err(|error| invalid(path, format!("directions: {error}")))?;
        let mut sphere = Sphere::from_directions(directions);
        if let Some(faces) = self.array("faces", Array::matrix)? {
            let count = sphere.directions.len() as f64;
            if faces.iter().any(|&v| !(0.0..count).contains(&v) || v.fract() != 0.0) {
                return Err(invalid(path, "faces refer to a vertex that doesn't exist"));
            }
            let faces = triples(&faces).ok_or_else(|| invalid(path, "faces: expected three columns"))?;
            sphere.faces = faces.into_iter().map(|face| face.map(|v| v as u32)).collect();
        }
        sphere.seam = self.seam(sphere.directions.len(), sphere.faces.len())?;
        Ok(Some(sphere))
    }

    /// Reads the record of the surface's cuts; `None` if the model has no such record.
    fn seam(&mut self, vertices: usize, faces: usize) -> Result<Option<Seam>, ModelError> {
        let path = self.path;
        let Some(cut_from) = self.array("cut_from", Array::matrix)? else { return Ok(None) };
        let copies = self.array("seam", Array::matrix)?.ok_or_else(|| invalid(path, "the file has no array `seam`"))?;
        let whole = |x: &f64| (x.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(x)).then_some(*x as u32);
        let numbers = |array: &Array2<f64>| array.iter().map(whole).collect::<Option<Vec<u32>>>();
        let (cut_from, copies) = (numbers(&cut_from), numbers(&copies));
        let (Some([own, triangles]), Some(copies)) = (cut_from.as_deref(), copies) else {
            return Err(invalid(path, "cut_from, seam: expected two numbers in cut_from, and copied vertices in seam"));
        };
        let seam = Seam { vertices: *own as usize, faces: *triangles as usize, copies };
        seam.checked(vertices, faces).map(Some).map_err(|found| invalid(path, format!("cut_from, seam: {found}")))
    }

    /// Reads and converts an array; `None` if the archive has no array of that name.
    pub(crate) fn array<T>(
        &mut self,
        name: &str,
        convert: impl FnOnce(&Array) -> Result<T, String>,
    ) -> Result<Option<T>, ModelError> {
        let problem = |text: String| invalid(self.path, format!("{name}: {text}"));
        let mut entry = match self.zip.by_name(&format!("{name}.npy")) {
            Ok(entry) => entry,
            Err(ZipError::FileNotFound) => return Ok(None),
            Err(error) => return Err(problem(error.to_string())),
        };
        let most = match entry.compression() {
            CompressionMethod::Stored => entry.compressed_size(),
            _ => most_expanded(entry.compressed_size()),
        };
        let array = Array::read(&mut entry, most).map_err(problem)?;
        convert(&array).map(Some).map_err(problem)
    }
}

fn triples(array: &Array2<f64>) -> Option<Vec<[f64; 3]>> {
    (array.ncols() == 3).then(|| array.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}

#[cfg(test)]
mod tests;
