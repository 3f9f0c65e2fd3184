//! Tests effects of groups and covariates at every vertex.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use spharm::Kind;
use spharm::model::made;
use spharm::shape::stats::{
    Blocks, Clusters, Column, Contrast, Design, Exchange, FamilyWise, PermutationParams, Question, SpatialParams,
    Statistic, SurfaceGraph, Term, TestParams, Tfce, mean_question, numbered, question, test,
};
use spharm::shape::{Measurement, ShapeError, measure_group};

use crate::arrays::{Faces, Positions, SphereArrays, mesh};
use crate::errors::Failure;
use crate::groups::{coefficients, group};
use crate::models::Model;
use crate::run::{run, run_owned};

/// Measurements of a group: an array with one row per model (or pair) and d columns for each vertex; d; the mean model;
/// and warnings.
type Measured<'py> = (Bound<'py, PyArray2<f64>>, usize, Model, Vec<String>);

/// Measures the quantity `signal` (`normal`, `position` or `value`) of the models of a group at directions. If `pairs`
/// is set, returns the differences between the first half of the models and the second half.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
#[pyo3(signature = (models, directions, degree, *, signal, pairs, threads = None, progress = None))]
pub(crate) fn shape_measure_group<'py>(
    py: Python<'py>,
    models: Vec<Py<Model>>,
    directions: Positions<'py>,
    degree: Option<usize>,
    signal: &str,
    pairs: bool,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Measured<'py>> {
    let (kind, measurement) = match signal {
        "normal" => (Kind::Surface, Measurement::Normal),
        "position" => (Kind::Surface, Measurement::Position),
        "value" => (Kind::Signal, Measurement::Value),
        found => {
            return Err(PyValueError::new_err(format!("signal: expected normal, position or value; found {found}")));
        }
    };
    let sphere = SphereArrays::new(&directions, None, false)?.owned();
    let models = coefficients(&models);
    let (field, warnings) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let group = group(&models, kind, degree, monitor)?;
        let field = measure_group(&group.members, &sphere.check()?.directions, measurement, monitor)?;
        let field = if pairs { field.differences()? } else { field };
        Ok((field, group.warnings))
    })?;
    let mean = Model { inner: made(field.mean, kind, "shape mean") };
    Ok((field.values.into_pyarray(py), field.components, mean, warnings))
}

/// Values of a column of the design, one per subject: numbers, or names of levels.
#[derive(FromPyObject)]
pub(crate) enum Cells<'py> {
    Numbers(PyReadonlyArray1<'py, f64>),
    Levels(Vec<String>),
}

impl Cells<'_> {
    fn column(&self) -> Column {
        match self {
            Self::Numbers(numbers) => Column::Numbers(numbers.as_array().to_vec()),
            Self::Levels(levels) => Column::Levels(levels.clone()),
        }
    }
}

/// Hypothesis to test. It is an effect of one column, the interaction of two columns, or a mean (no column), in each
/// case with covariates. Alternatively, it is given by a design matrix. A contrast is given as weights or as text.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Asked<'py> {
    effect: Vec<(String, Cells<'py>)>,
    levels: Vec<String>,
    covariates: Vec<(String, Cells<'py>)>,
    /// Names of additional interactions in the model, such as `age:sex`. The two columns of an interaction may be
    /// covariates or columns of the effect.
    interactions: Vec<String>,
    design: Option<PyReadonlyArray2<'py, f64>>,
    columns: Vec<String>,
    weights: Option<PyReadonlyArray2<'py, f64>>,
    contrast: Vec<String>,
    /// Whether values are displacements from the mean. The mean of such values is zero.
    relative: bool,
}

impl Asked<'_> {
    fn question(&self, subjects: usize) -> Result<Question, Failure> {
        let column = |(name, cells): &(String, Cells<'_>)| (name.clone(), cells.column());
        let term = |given: &(String, Cells<'_>)| {
            let (name, column) = column(given);
            Term::Column(name, column)
        };
        let mut covariates: Vec<Term> = self.covariates.iter().map(term).collect();
        covariates.extend(self.interactions.iter().map(|name| self.interaction(name)).collect::<Result<Vec<_>, _>>()?);
        let mut asked = match (&self.design, &self.effect[..]) {
            (Some(design), _) => {
                let design = Design::new(design.as_array().to_owned(), self.columns.clone())?;
                let contrast = Contrast { weights: ndarray::Array2::zeros((1, design.names().len())) };
                let meaning = "a contrast of the design".to_owned();
                let (levels, level_of, covariates, codes, warnings) = Default::default();
                Question { design, contrast, meaning, levels, level_of, covariates, codes, warnings }
            }
            (None, []) => mean_question(subjects, &covariates)?,
            (None, [effect]) => question(&term(effect), &self.levels, &covariates)?,
            (None, [a, b, ..]) => question(&Term::Interaction([column(a), column(b)]), &self.levels, &covariates)?,
        };
        if let Some(weights) = &self.weights {
            asked.contrast.weights = weights.as_array().to_owned();
        }
        if self.contrast.is_empty() {
            return Ok(asked);
        }
        let asked = asked.with_contrast(&self.contrast)?;
        if self.relative {
            asked.check_differences()?;
        }
        Ok(asked)
    }

    /// Returns the interaction of two of the given columns. `name` is its name, such as `age:sex`.
    fn interaction(&self, name: &str) -> Result<Term, Failure> {
        let columns = || self.effect.iter().chain(&self.covariates);
        let column = |name: &str| Ok(columns().find(|(of, _)| of == name).map(|(_, cells)| cells.column()));
        match Term::parse::<Failure>(name, column)? {
            Some(term @ Term::Interaction(_)) => Ok(term),
            _ => {
                let names: Vec<&str> = columns().map(|(name, _)| name.as_str()).collect();
                Err(Failure::Argument(format!(
                    "interactions: expected two columns from {}, joined as in \"age:sex\"; found {name:?}",
                    if names.is_empty() { "the covariates".to_owned() } else { names.join(", ") }
                )))
            }
        }
    }
}

/// Settings of the relabellings, and of the statistics of regions (TFCE and clusters). `surface` has the surface's
/// vertices, (V, 3), and triangles. `kept` (V) selects the vertices that have values.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Inference<'py> {
    errors: Option<String>,
    blocks: Option<Vec<String>>,
    whole_blocks: bool,
    variance_groups: Option<Vec<String>>,
    tfce: bool,
    cluster: Option<f64>,
    surface: Option<(Positions<'py>, Faces<'py>)>,
    kept: Option<Vec<bool>>,
}

impl Inference<'_> {
    fn params(&self, py: Python<'_>) -> PyResult<TestParams> {
        let exchange = if self.whole_blocks { Exchange::Whole } else { Exchange::Within };
        let spatial = match &self.surface {
            Some((vertices, faces)) => {
                let mesh = mesh("surface", vertices, faces)?;
                let surface = SurfaceGraph::new(&mesh.vertices, &mesh.faces).and_then(|surface| match &self.kept {
                    Some(kept) => surface.at(kept),
                    None => Ok(surface),
                });
                let surface = surface.map_err(|error| crate::errors::exception(py, error.into()))?;
                Some(SpatialParams { surface, tfce: self.tfce, cluster: self.cluster })
            }
            None => None,
        };
        Ok(TestParams {
            errors: self.errors.as_ref().and_then(|errors| errors.parse().ok()),
            blocks: self.blocks.as_ref().map(|names| Blocks::new(names, exchange)),
            variance_groups: self.variance_groups.as_ref().map(numbered),
            spatial,
            ..TestParams::default()
        })
    }
}

/// Tests values at V vertices. `values` has one row per subject and d columns for each vertex.
#[pyfunction]
#[pyo3(signature = (values, components, asked, inference, *, welch, permutations, seed, confidence, level, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
pub(crate) fn shape_test<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f64>,
    components: usize,
    asked: Asked<'py>,
    inference: Inference<'py>,
    welch: bool,
    permutations: usize,
    seed: u64,
    confidence: f64,
    level: f64,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let relabel = PermutationParams { count: permutations, seed, ..PermutationParams::default() };
    let params = TestParams {
        permutations: (permutations > 0).then_some(relabel),
        welch,
        confidence,
        level,
        ..inference.params(py)?
    };
    let values = values.as_array();
    let question = asked.question(values.nrows()).map_err(|failure| crate::errors::exception(py, failure))?;
    let (design, contrast) = (&question.design, &question.contrast);
    let found = run(py, threads, progress.as_ref(), |monitor| {
        // Check the level here, because the library uses the level only for warnings and accepts any level.
        if !(level > 0.0 && level < 1.0) {
            return Err(ShapeError::Share { what: "level", found: level }.into());
        }
        Ok(test(values, components, design, contrast, &params, monitor)?)
    })?;
    let result = PyDict::new(py);
    let array = |values: Vec<f64>| -> Bound<'py, PyArray1<f64>> { values.into_pyarray(py) };
    // If variances are estimated by group, the statistics are Aspin and Welch's v and G.
    let [t, f] = if inference.variance_groups.is_some() { ["v", "G"] } else { ["t", "F"] };
    let (kind, freedom) = match found.kind {
        Statistic::T { freedom } => (t, vec![freedom]),
        Statistic::F { between, within } => (f, vec![between, within]),
        Statistic::TSquared { components, freedom } => ("T2", vec![components as f64, freedom]),
        _ => return Err(crate::errors::exception(py, Failure::Panic)),
    };
    result.set_item("kind", kind)?;
    result.set_item("freedom", freedom)?;
    result.set_item("statistic", array(found.statistic))?;
    result.set_item("p", array(found.p))?;
    result.set_item("q", array(found.q))?;
    if let Some(FamilyWise { p, pointwise, resampling, relabellings, exact, floor, tfce, clusters }) = found.family_wise
    {
        if let Some(Tfce { statistic, p }) = tfce {
            result.set_item("tfce", array(statistic))?;
            result.set_item("p_tfce", array(p))?;
        }
        if let Some(Clusters { threshold, of, clusters }) = clusters {
            let list: Vec<_> = clusters.iter().map(|c| (c.vertices, c.area, c.peak, c.statistic, c.p)).collect();
            result.set_item("cluster_of", of.into_iter().map(i64::from).collect::<Vec<_>>().into_pyarray(py))?;
            result.set_item("clusters", list)?;
            result.set_item("cluster_threshold", threshold)?;
        }
        result.set_item("p_fwe", array(p))?;
        result.set_item("p_permutation", array(pointwise))?;
        result.set_item("resampling", resampling.name())?;
        result.set_item("assumption", resampling.assumption())?;
        result.set_item("relabellings", relabellings)?;
        result.set_item("exact", exact)?;
        result.set_item("smallest_p", floor)?;
    }
    if let Some(effect) = found.effect {
        result.set_item("effect", effect.estimate.into_pyarray(py))?;
        result.set_item("standard_error", effect.standard_error.into_pyarray(py))?;
        result.set_item("margin", effect.margin.into_pyarray(py))?;
        let size = effect.size.into_iter().map(|size| if size.is_nan() { 0.0 } else { size });
        result.set_item("size", array(size.collect()))?;
    }
    result.set_item("meaning", &question.meaning)?;
    result.set_item("levels", question.levels.clone())?;
    // Omit the column of the tested effect from the codes, because the caller declared its numbers to be quantities,
    // not codes of levels.
    let declared = match &asked.effect[..] {
        [(name, _)] => Some(name),
        _ => None,
    };
    let codes = question.codes.iter().filter(|(column, _)| declared != Some(column)).cloned();
    result.set_item("codes", codes.collect::<Vec<_>>())?;
    result.set_item("columns", design.names().to_vec())?;
    let warnings = question.warnings.iter().chain(&found.warnings).map(ToString::to_string);
    result.set_item("warnings", warnings.collect::<Vec<_>>())?;
    Ok(result)
}
