//! Provides synthesis at scattered directions, the adjoint of synthesis, and least-squares fits of samples at these
//! directions.

use ndarray::{Array2, ArrayView2};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use spharm::harmonics::Directions;
use spharm::transform::{Transform as Inner, TransformError, TransformParams};
use spharm::{Error, PlannedSphere, Sphere};

use crate::arrays::{Positions, borrowed_rows};
use crate::errors::exception;
use crate::run::{pool, run};

/// A plan for transforms at a list of directions. Its attributes never change.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Transform {
    pub(crate) planned: PlannedSphere,
    threads: Option<usize>,
}

type Values<'py> = Bound<'py, PyArray2<f64>>;

impl Transform {
    /// Runs a transform. The transform can't be interrupted, because it takes little time.
    fn call<'py>(
        &self,
        py: Python<'py>,
        work: impl FnOnce(&Inner) -> Result<Array2<f64>, TransformError> + Send,
    ) -> PyResult<Values<'py>> {
        let pool = pool(self.threads)?;
        let values = py.detach(|| pool.install(|| work(self.planned.transform())));
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
        let directions = borrowed_rows("directions", directions.as_array())?;
        let planned = run(py, threads, None, move |_| {
            let sphere = Sphere::from_directions(Directions::from_vertices(&directions).map_err(Error::from)?);
            Ok(PlannedSphere::new(sphere, &TransformParams { max_degree, accuracy, channels })?)
        })?;
        Ok(Self { planned, threads })
    }

    #[getter]
    fn max_degree(&self) -> usize {
        self.planned.transform().max_degree()
    }

    #[getter]
    fn directions(&self) -> usize {
        self.planned.transform().directions()
    }

    /// Returns whether fits up to degree `max_degree` use this plan.
    fn serves(&self, max_degree: usize) -> bool {
        self.planned.serves(max_degree)
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
            return Err(PyValueError::new_err("weights: expected finite numbers of at least 0"));
        }
        self.call(py, |transform| {
            let weights = weights.map(|weights| transform.sorted_weights(&weights)).transpose()?;
            transform.normal(coefficients, weights.as_ref())
        })
    }
}
