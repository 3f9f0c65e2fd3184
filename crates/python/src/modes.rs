//! Computes the modes of variation of a group.

use std::path::PathBuf;

use ndarray::{Array2, Array3, ArrayView2, s};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1};
use pyo3::prelude::*;
use serde_json::json;
use spharm::Kind;
use spharm::harmonics::Coefficients;
use spharm::model::made;
use spharm::shape::Modes as Inner;
use spharm::shape::pca::file::ShapeModel;
use spharm::shape::pca::quality::{normal, quality};

use crate::errors::Failure;
use crate::groups::{coefficients, group};
use crate::models::Model;
use crate::run::{run, run_owned};

/// The mean and the modes of variation of a group. Objects of this class are immutable.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Modes {
    file: ShapeModel,
}

type Vector<'py> = Bound<'py, PyArray1<f64>>;

impl Modes {
    fn model(&self, values: Array2<f64>, deviations: Option<&[f64]>) -> Result<Model, Failure> {
        let tool = if deviations.is_some() { "shape sample" } else { "shape pca" };
        let mut inner = made(Coefficients::new(values)?, Kind::Surface, tool);
        match deviations {
            Some(deviations) => inner.provenance.other.insert("standard_deviations".to_owned(), json!(deviations)),
            None => inner.provenance.other.insert("members".to_owned(), json!(self.file.members)),
        };
        Ok(Model { inner })
    }
}

#[pymethods]
impl Modes {
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self { file: run(py, Some(1), None, move |_| Ok(ShapeModel::read(&path)?))? })
    }

    #[pyo3(signature = (path, *, overwrite = false))]
    fn write(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        run(py, Some(1), None, |_| Ok(self.file.write(&path, overwrite)?))
    }

    #[getter]
    fn mean(&self, py: Python<'_>) -> PyResult<Model> {
        run(py, Some(1), None, |_| self.model(self.file.modes.mean.clone(), None))
    }

    /// Returns the m modes as an array (m, K, 3): K coefficients of x, y and z. Row 0 of each mode, the position, is
    /// zero.
    #[getter]
    fn modes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let modes = &self.file.modes;
        let (rows, columns) = modes.mean.dim();
        let mut values = Array3::zeros((modes.count(), rows, columns));
        for (mut value, mode) in values.outer_iter_mut().zip(modes.modes.rows()) {
            value.slice_mut(s![1.., ..]).iter_mut().zip(mode).for_each(|(value, mode)| *value = *mode);
        }
        values.into_pyarray(py)
    }

    #[getter]
    fn variances<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.file.modes.variances.clone().into_pyarray(py)
    }

    #[getter]
    fn scores<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        self.file.modes.scores.clone().into_pyarray(py)
    }

    #[getter]
    fn total_variance(&self) -> f64 {
        self.file.modes.total_variance
    }

    #[getter]
    fn shares<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.file.modes.shares().into_pyarray(py)
    }

    #[getter]
    fn compactness<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.file.modes.compactness().into_pyarray(py)
    }

    #[getter]
    fn members(&self) -> Vec<String> {
        self.file.members.clone()
    }

    /// Returns the provenance of the modes, as JSON.
    #[getter]
    fn provenance(&self) -> String {
        self.file.provenance.clone()
    }

    /// Returns the mean with only the first `count` modes.
    fn truncate(&self, count: usize) -> Self {
        let mut file = self.file.clone();
        file.modes.truncate(count);
        Self { file }
    }

    /// Returns the shape at the given numbers of standard deviations along the first modes, as a model.
    fn shape(&self, py: Python<'_>, deviations: PyReadonlyArray1<'_, f64>) -> PyResult<Model> {
        let deviations = deviations.as_array().to_vec();
        run(py, Some(1), None, |_| self.model(self.file.modes.shape(&deviations)?, Some(&deviations)))
    }

    /// Returns `count` random shapes. The same seed gives the same shapes.
    #[pyo3(signature = (count, *, seed))]
    fn sample(&self, py: Python<'_>, count: usize, seed: u64) -> PyResult<Vec<Model>> {
        run(py, Some(1), None, |monitor| {
            let one = |index: usize| {
                monitor.check().map_err(spharm::Error::from)?;
                let deviations = normal(seed, index as u64, self.file.modes.count());
                self.model(self.file.modes.shape(&deviations)?, Some(&deviations))
            };
            (0..count).map(one).collect()
        })
    }

    /// Returns the coordinates of a model along the modes, and the distance of the model from the space spanned by the
    /// modes.
    fn project<'py>(&self, py: Python<'py>, model: PyRef<'py, Model>) -> PyResult<(Vector<'py>, f64)> {
        let values = model.inner.coefficients.values();
        let (scores, left) = run(py, Some(1), None, |_| Ok(self.file.modes.project(values.view())?))?;
        Ok((scores.into_pyarray(py), left))
    }

    /// Returns the generalisation and the specificity of the first k modes for each k from 1 to m, as two arrays of
    /// length m.
    #[pyo3(signature = (*, samples, seed, threads = None, progress = None))]
    fn quality<'py>(
        &self,
        py: Python<'py>,
        samples: usize,
        seed: u64,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<(Vector<'py>, Vector<'py>)> {
        let modes = &self.file.modes;
        let (members, found) = (modes.scores.nrows(), modes.count());
        let all = members.saturating_sub(1).min(modes.modes.ncols());
        let found = run(py, threads, progress.as_ref(), |monitor| {
            if found < all || members < 3 {
                let expected = format!("expected a group of 3 or more members with all {all} modes, not truncated");
                return Err(Failure::Argument(format!(
                    "quality: {expected}; found {found} modes of {members} members"
                )));
            }
            Ok(quality(modes, samples, seed, monitor)?)
        })?;
        Ok((found.generalisation.into_pyarray(py), found.specificity.into_pyarray(py)))
    }
}

/// Computes at most `most` modes of variation of a group of surfaces. Also returns warnings.
#[pyfunction]
#[pyo3(signature = (models, degree, *, most, names, threads = None))]
pub(crate) fn shape_pca(
    py: Python<'_>,
    models: Vec<Py<Model>>,
    degree: Option<usize>,
    most: Option<usize>,
    names: Vec<String>,
    threads: Option<usize>,
) -> PyResult<(Modes, Vec<String>)> {
    let models = coefficients(&models);
    let (file, warnings) = run_owned(py, threads, None, move |monitor| {
        let group = group(&models, Kind::Surface, degree, monitor)?;
        let members: Vec<ArrayView2<'_, f64>> = group.members.iter().map(|member| member.values().view()).collect();
        let mut modes = Inner::new(&members, usize::MAX)?;
        modes.truncate(most.unwrap_or(usize::MAX));
        let provenance = json!({ "tool": "shape pca", "versions": spharm::versions(), "degree": group.degree });
        Ok((ShapeModel { modes, members: names, provenance: provenance.to_string() }, group.warnings))
    })?;
    Ok((Modes { file }, warnings))
}
