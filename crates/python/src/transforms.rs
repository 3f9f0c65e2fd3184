//! Synthesis at scattered directions, its adjoint, and the least squares over them.

use ndarray::{Array2, ArrayView2};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use spharm::Error;
use spharm::harmonics::Directions;
use spharm::transform::{Transform as Inner, TransformError, TransformParams};

use crate::arrays::{Positions, rows};
use crate::errors::exception;
use crate::run::{pool, run};

/// A plan for transforms at one list of directions. It is immutable.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Transform {
    inner: Inner,
    threads: Option<usize>,
}

type Values<'py> = Bound<'py, PyArray2<f64>>;

impl Transform {
    /// Runs a transform, which is too short to be interrupted.
    fn call<'py>(
        &self,
        py: Python<'py>,
        work: impl FnOnce(&Inner) -> Result<Array2<f64>, TransformError> + Send,
    ) -> PyResult<Values<'py>> {
        let pool = pool(self.threads)?;
        let values = py.detach(|| pool.install(|| work(&self.inner)));
        Ok(values.map_err(|error| exception(py, Error::from(error).into()))?.into_pyarray(py))
    }
}

#[pymethods]
impl Transform {
    #[new]
    #[pyo3(signature = (directions, max_degree, *, accuracy, channels, threads = None))]
    fn new(
        py: Python<'_>,
        directions: Positions<'_>,
        max_degree: usize,
        accuracy: f64,
        channels: usize,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let directions = rows("directions", directions.as_array())?;
        let inner = run(py, threads, None, move |_| {
            let directions = Directions::from_vertices(&directions).map_err(Error::from)?;
            Ok(Inner::new(&directions, &TransformParams { max_degree, accuracy, channels }).map_err(Error::from)?)
        })?;
        Ok(Self { inner, threads })
    }

    #[getter]
    fn max_degree(&self) -> usize {
        self.inner.max_degree()
    }

    #[getter]
    fn directions(&self) -> usize {
        self.inner.directions()
    }

    fn synthesis<'py>(&self, py: Python<'py>, coefficients: PyReadonlyArray2<'py, f64>) -> PyResult<Values<'py>> {
        let coefficients: ArrayView2<'_, f64> = coefficients.as_array();
        self.call(py, |transform| transform.synthesis(coefficients))
    }

    fn adjoint<'py>(&self, py: Python<'py>, samples: PyReadonlyArray2<'py, f64>) -> PyResult<Values<'py>> {
        let samples: ArrayView2<'_, f64> = samples.as_array();
        self.call(py, |transform| transform.adjoint_synthesis(samples))
    }

    #[pyo3(signature = (coefficients, weights = None))]
    fn normal<'py>(
        &self,
        py: Python<'py>,
        coefficients: PyReadonlyArray2<'py, f64>,
        weights: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Values<'py>> {
        let coefficients: ArrayView2<'_, f64> = coefficients.as_array();
        let weights = weights.map(|weights| weights.as_array().to_vec());
        if weights.iter().flatten().any(|weight| !(weight.is_finite() && *weight >= 0.0)) {
            return Err(PyValueError::new_err("weights: expected finite numbers from 0"));
        }
        self.call(py, |transform| {
            let weights = weights.map(|weights| transform.sorted_weights(&weights)).transpose()?;
            transform.normal(coefficients, weights.as_ref())
        })
    }
}
