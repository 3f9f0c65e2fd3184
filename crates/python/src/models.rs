//! Defines models: coefficients, their sphere and provenance.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, ToPyArray};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use spharm::harmonics::{Coefficients, Directions};
use spharm::shape::codec::{CodecError, CompressParams, ExpandParams, Target, compress, expand};
use spharm::{Error, Kind, Model as Inner};
use spharm_surface::io::write_new;

use crate::arrays::{
    Faces, FacesOut, Positions, PositionsOut, SeamIn, SeamOut, SphereArrays, positions, rows, seam_out, triangles,
};
use crate::errors::Failure;
use crate::run::run;
use crate::surfaces::{SurfaceOut, surface_out};

/// A model of a surface or signal. Objects of this class are immutable.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Model {
    pub(crate) inner: Inner,
}

fn kind(surface: bool) -> Kind {
    if surface { Kind::Surface } else { Kind::Signal }
}

#[pymethods]
impl Model {
    /// Creates a model from coefficients (one row per basis function, one column per channel), optionally with a
    /// sphere.
    #[new]
    #[pyo3(signature = (coefficients, *, surface, sphere = None, faces = None, parametrized = false, seam = None))]
    fn new(
        py: Python<'_>,
        coefficients: PyReadonlyArray2<'_, f64>,
        surface: bool,
        sphere: Option<Positions<'_>>,
        faces: Option<Faces<'_>>,
        parametrized: bool,
        seam: Option<SeamIn>,
    ) -> PyResult<Self> {
        let values = coefficients.as_array().to_owned();
        let sphere =
            sphere.as_ref().map(|sphere| SphereArrays::new(sphere, faces.as_ref(), parametrized)).transpose()?;
        let sphere = sphere.map(|sphere| sphere.with_seam(seam));
        let inner = run(py, Some(1), None, move |_| {
            let coefficients = Coefficients::new(values).map_err(Error::from)?;
            Ok(match sphere {
                Some(sphere) => Inner::new(sphere.check()?, coefficients, kind(surface)),
                None => Inner::without_sphere(coefficients, kind(surface)),
            })
        })?;
        Ok(Self { inner })
    }

    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self { inner: run(py, Some(1), None, move |_| Ok(Inner::read(path).map_err(Error::from)?))? })
    }

    #[pyo3(signature = (path, *, overwrite = false))]
    fn write(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        run(py, Some(1), None, |_| Ok(self.inner.write_with(path, overwrite).map_err(Error::from)?))
    }

    /// Expands the bytes of a compressed model. Error messages show `name` as the file's name.
    #[staticmethod]
    fn expand(py: Python<'_>, bytes: &[u8], name: String) -> PyResult<Self> {
        let inner = run(py, Some(1), None, move |_| match expand(bytes, &ExpandParams::default()) {
            Ok(found) => Ok(found.model),
            Err(error) => Err(Failure::Codec { name: Some(name), error: Box::new(error) }),
        })?;
        Ok(Self { inner })
    }

    /// Writes the model to a compressed file, with either a limit on the distance from the model or a limit on the
    /// file's size. Returns the distance reached, as a relative length, and the highest degree of the file.
    #[pyo3(signature = (path, *, tolerance, bytes, overwrite, threads = None))]
    fn compress(
        &self,
        py: Python<'_>,
        path: PathBuf,
        tolerance: Option<f64>,
        bytes: Option<usize>,
        overwrite: bool,
        threads: Option<usize>,
    ) -> PyResult<(f64, usize)> {
        run(py, threads, None, |monitor| {
            let target = match (tolerance, bytes) {
                (Some(tolerance), None) => Target::Tolerance(tolerance),
                (None, Some(bytes)) => Target::Bytes(bytes),
                (given, _) => {
                    let found = if given.is_some() { "both" } else { "none" };
                    return Err(Failure::Argument(format!("tolerance, bytes: expected one of them, found {found}")));
                }
            };
            let failure = |error: CodecError| Failure::Codec { name: None, error: Box::new(error) };
            let file = compress(&self.inner, &CompressParams::new(target), monitor).map_err(failure)?;
            write_new(path, overwrite, |out| out.write_all(&file.bytes))?;
            Ok((file.distance, file.max_degree))
        })
    }

    /// Reads a model from the bytes of a model file.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        Ok(Self { inner: run(py, Some(1), None, |_| Ok(Inner::from_bytes(bytes).map_err(Error::from)?))? })
    }

    /// Returns the model as the bytes of a model file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = run(py, Some(1), None, |_| {
            let mut bytes = Vec::new();
            let written = self.inner.write_to(&mut bytes);
            written.map_err(|error| Failure::Argument(format!("model: {error}")))?;
            Ok(bytes)
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    #[getter]
    fn coefficients<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.inner.coefficients.values().to_pyarray(py)
    }

    #[getter]
    fn max_degree(&self) -> usize {
        self.inner.coefficients.max_degree()
    }

    #[getter]
    fn is_surface(&self) -> bool {
        self.inner.kind() == Kind::Surface
    }

    #[getter]
    fn parametrized(&self) -> bool {
        self.inner.sphere.as_ref().map_or(self.inner.provenance.parametrized, |sphere| sphere.parametrized)
    }

    fn mapped_apart(&self, other: &Self) -> bool {
        self.inner.mapped_apart(&other.inner)
    }

    /// Returns unit vectors, (n, 3), and triangles, (f, 3), of the model's sphere; `None` if the model has no sphere.
    #[getter]
    fn sphere<'py>(&self, py: Python<'py>) -> Option<(PositionsOut<'py>, FacesOut<'py>)> {
        let sphere = self.inner.sphere.as_ref()?;
        Some((positions(py, sphere.directions.as_slice().to_vec()), triangles(py, sphere.faces.clone())))
    }

    /// Returns the record of cut handles: the original numbers of vertices and triangles, and the copied vertices.
    /// `None` if no handles were cut.
    #[getter]
    fn seam<'py>(&self, py: Python<'py>) -> Option<SeamOut<'py>> {
        self.inner.sphere.as_ref()?.seam.clone().map(|seam| seam_out(py, seam))
    }

    /// Returns the provenance of the model, as JSON.
    #[getter]
    fn provenance(&self) -> String {
        serde_json::to_string(&self.inner.provenance).unwrap_or_default()
    }

    /// Returns the model truncated to a degree.
    fn truncate(&self, py: Python<'_>, degree: usize) -> PyResult<Self> {
        run(py, Some(1), None, |_| {
            let (mut inner, max_degree) = (self.inner.clone(), self.max_degree());
            if degree > max_degree {
                return Err(Failure::from(Error::from(spharm::ModelError::DegreeTooHigh { degree, max_degree })));
            }
            inner.coefficients =
                Coefficients::new(self.inner.coefficients.up_to(degree).to_owned()).map_err(Error::from)?;
            Ok(inner)
        })
        .map(|inner| Self { inner })
    }

    /// Returns a model with other coefficients (one row per basis function, one column per channel) over the same
    /// sphere.
    fn with_coefficients(&self, py: Python<'_>, coefficients: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let values = coefficients.as_array().to_owned();
        let inner = run(py, Some(1), None, |_| {
            let (coefficients, kind) = (Coefficients::new(values).map_err(Error::from)?, self.inner.kind());
            Ok(match &self.inner.sphere {
                Some(sphere) => Inner::new(sphere.clone(), coefficients, kind),
                None => Inner::without_sphere(coefficients, kind),
            })
        })?;
        Ok(Self { inner })
    }

    /// Returns the values of the model, (n, c), at the given directions. By default, these are the directions of the
    /// model's sphere.
    #[pyo3(signature = (directions, degree, *, threads = None))]
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        directions: Option<Positions<'py>>,
        degree: usize,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let directions = directions.map(|directions| rows("directions", directions.as_array())).transpose()?;
        let values = run(py, threads, None, |_| {
            let found = match directions {
                Some(directions) => {
                    let directions = Directions::from_vertices(&directions).map_err(Error::from)?;
                    self.inner.evaluate(&directions, degree)
                }
                None => self.inner.own_sphere().and_then(|sphere| self.inner.evaluate(&sphere.directions, degree)),
            };
            Ok(found.map_err(Error::from)?)
        })?;
        Ok(values.into_pyarray(py))
    }

    /// Evaluates the model's surface over a sphere, and returns vertices, triangles and the metadata that the model
    /// preserves. Without a given sphere, the model's own sphere is used, and cuts of handles are undone.
    #[pyo3(signature = (sphere, faces, degree, *, threads = None))]
    fn surface<'py>(
        &self,
        py: Python<'py>,
        sphere: Option<Positions<'py>>,
        faces: Option<Faces<'py>>,
        degree: usize,
        threads: Option<usize>,
    ) -> PyResult<SurfaceOut<'py>> {
        let sphere = sphere.as_ref().map(|sphere| SphereArrays::new(sphere, faces.as_ref(), false)).transpose()?;
        let mesh = run(py, threads, None, |_| {
            let found = match sphere {
                Some(sphere) => self.inner.reconstruct(&sphere.check()?, degree),
                None => self.inner.reconstruct_original(degree).map(|found| found.mesh),
            };
            Ok(found.map_err(Error::from)?)
        })?;
        Ok(surface_out(py, mesh, None))
    }
}
