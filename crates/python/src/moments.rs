//! Computes moments of samples: sums that can be added, and from which fits are computed.

use std::path::PathBuf;

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::json;
use spharm::moments::{Part, Samples, Shard, accumulate_samples, merge_named};
use spharm::{Moments as Inner, Monitor, fit_moments};

use crate::arrays::Positions;
use crate::errors::Failure;
use crate::fitting::{Fitted, Settings, category};
use crate::models::Model;
use crate::run::run;

/// The moments of samples. Objects of this class are immutable.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Moments {
    inner: Inner,
}

#[pymethods]
impl Moments {
    /// Computes the moments of samples in memory. The samples may be one part of all samples: `shard` is the index of
    /// this part and the number of parts.
    #[new]
    #[pyo3(signature = (directions, values, weights, max_degree, channels, *, whole, shard, threads = None, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
    fn new(
        py: Python<'_>,
        directions: Positions<'_>,
        values: PyReadonlyArray2<'_, f64>,
        weights: Option<PyReadonlyArray1<'_, f64>>,
        max_degree: usize,
        channels: Vec<String>,
        whole: Option<String>,
        shard: (u32, u32),
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let samples = Samples {
            directions: directions.as_array(),
            values: values.as_array(),
            weights: weights.as_ref().map(|weights| weights.as_array()),
        };
        let part = Part { whole, shard: Shard { index: shard.0, of: shard.1 } };
        let work = |monitor: &dyn Monitor| {
            accumulate_samples(&samples, channels, max_degree, &part, monitor).map_err(Failure::Moments)
        };
        Ok(Self { inner: run(py, threads, progress.as_ref(), work)? })
    }

    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self { inner: run(py, Some(1), None, move |_| Inner::read(&path).map_err(Failure::Moments))? })
    }

    #[pyo3(signature = (path, *, overwrite = false))]
    fn write(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        run(py, Some(1), None, |_| self.inner.write(&path, overwrite).map_err(Failure::Moments))
    }

    /// Reads moments from the bytes of a file of moments.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        Ok(Self { inner: run(py, Some(1), None, |_| Inner::from_bytes(bytes).map_err(Failure::Moments))? })
    }

    /// Returns the moments as the bytes of a file of moments.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &run(py, Some(1), None, |_| self.inner.to_bytes().map_err(Failure::Moments))?))
    }

    /// Returns the sum of the moments of several parts of the samples. If `partial` is set, some of the parts may be
    /// missing.
    #[staticmethod]
    #[pyo3(signature = (parts, *, partial = false))]
    fn merge(py: Python<'_>, parts: Vec<PyRef<'_, Self>>, partial: bool) -> PyResult<Self> {
        let names = (0..parts.len()).map(|number| format!("part {number}")).collect();
        let parts: Vec<&Inner> = parts.iter().map(|part| &part.inner).collect();
        // Parts are cloned one after another, so at most two copies are in memory in addition to the caller's parts.
        let parts = parts.into_iter().cloned().map(Ok);
        Ok(Self {
            inner: run(py, Some(1), None, move |_| merge_named(parts, names, partial).map_err(Failure::Moments))?,
        })
    }

    #[getter]
    fn max_degree(&self) -> usize {
        self.inner.sums.max_degree
    }

    #[getter]
    fn channels(&self) -> Vec<String> {
        self.inner.channels.clone()
    }

    /// Returns the number of samples, including samples of weight 0.
    #[getter]
    fn samples(&self) -> u64 {
        self.inner.rows
    }

    /// Returns the sum of the weights.
    #[getter]
    fn weight(&self) -> f64 {
        self.inner.sums.weight
    }

    /// Returns the key of the sampling scheme; `None` if the samples aren't at the vertices of a scheme.
    #[getter]
    fn scheme(&self) -> Option<String> {
        self.inner.scheme.map(|key| key.to_string())
    }

    /// Fits the samples by least squares, from their moments.
    #[pyo3(signature = (settings, progress = None))]
    fn fit<'py>(
        &self,
        py: Python<'py>,
        settings: Settings<'py>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Fitted<'py>> {
        let params = settings.params()?;
        let fit = run(py, settings.threads, progress.as_ref(), |monitor| {
            fit_moments(&self.inner, &params, monitor).map_err(Failure::Library)
        })?;
        let warnings = fit.report.warnings.iter().map(|warning| (category(warning), warning.to_string())).collect();
        let errors = fit.standard_errors.clone().map(|errors| numpy::IntoPyArray::into_pyarray(errors, py));
        let mut report = json!(fit.report);
        if let Some(report) = report.as_object_mut() {
            report.insert("scheme_key".to_owned(), json!(self.scheme()));
        }
        Ok((Model { inner: fit.model() }, errors, report.to_string(), warnings))
    }
}
