//! Chooses a common degree for the models of many surfaces.
//!
//! Models are compared, averaged and tabulated degree by degree, so all models of a run have the same degree. For
//! labels, it is chosen from their sizes in voxels; for meshes, from fits to a few of them.

use std::fmt;

use spharm::degree::{Accuracy, DegreeChoice, choose_degree, choose_degree_over};
use spharm::io::read_mesh;
use spharm::parametrize::volume::{is_volume, suitable_degree};
use spharm::{Error, FitParams, Model, Monitor, Stage};

use crate::Row;
use crate::reader::SurfaceReader;
use crate::run::Cohort;
use crate::run::quiet::Quiet;

/// Largest number of surfaces that are fitted to choose a degree.
const MESHES: usize = 3;

/// Largest number of labels whose sizes are used to choose a degree.
const LABELS: usize = 50;

/// Lowest and highest degree chosen for labels. Lower degrees reproduce little of the shape. Higher degrees are used
/// only if the user requests them.
const OF_LABELS: (usize, usize) = (4, 60);

/// The degree chosen for a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ChosenDegree {
    /// The degree was chosen from the sizes of labels in voxels.
    Labels {
        /// Degree that suits the label of median size.
        degree: usize,
        /// Number of labels.
        labels: usize,
    },
    /// The degree was chosen by fitting surfaces.
    Surfaces {
        /// The choice for the fitted surface that needs the highest degree.
        choice: DegreeChoice,
        /// Degree of the run: the degree of `choice`, or, if lower, the highest degree that the vertices of every
        /// fitted surface determine.
        degree: usize,
        /// Number of surfaces that were fitted to choose the degree.
        fitted: usize,
        /// Number of fitted surfaces whose model of degree `degree` isn't as accurate as requested.
        missed: usize,
    },
    /// The degree is that of an existing model of the run.
    Existing {
        /// Degree of the model.
        degree: usize,
    },
}

impl ChosenDegree {
    /// Returns the degree.
    #[must_use]
    pub fn degree(&self) -> usize {
        match self {
            Self::Labels { degree, .. } | Self::Surfaces { degree, .. } | Self::Existing { degree } => *degree,
        }
    }

    /// Returns whether the models of all fitted surfaces are as accurate as requested.
    #[must_use]
    pub fn reached(&self) -> bool {
        !matches!(self, Self::Surfaces { missed: 1.., .. })
    }
}

impl fmt::Display for ChosenDegree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Labels { degree, labels: 1 } => write!(f, "degree {degree}, chosen from the label's size in voxels"),
            Self::Labels { degree, labels } => {
                write!(f, "degree {degree}, chosen from the median size of {labels} labels in voxels")
            }
            Self::Surfaces { choice, fitted: 1, .. } => choice.fmt(f),
            Self::Surfaces { choice, fitted, missed: 0, .. } => write!(f, "{choice} (chosen from {fitted} surfaces)"),
            Self::Surfaces { degree, fitted, missed, .. } => write!(
                f,
                "degree {degree}: {missed} of {fitted} surfaces would need a higher degree for the requested accuracy, \
                 but some surfaces have too few vertices for a higher degree"
            ),
            Self::Existing { degree } => write!(f, "degree {degree}, as in an existing model of these surfaces"),
        }
    }
}

/// Returns the degree for the models of a cohort.
///
/// If `keep` is set and a row has a model, the degree is that of this model. Otherwise, if some rows are labels and
/// `accuracy` is `None`, the degree suits the median size of up to 50 labels, limited to degrees from 4 to 60.
/// Otherwise up to three surfaces, spread evenly over the rows, are fitted. The degree is then the highest degree that
/// any of these surfaces needs for the accuracy (see [`choose_degree`]). The default accuracy is 0.2 % of a surface's
/// size. The degree from the fits is lowered, if necessary, to the highest degree that the vertices of every fitted
/// surface determine.
///
/// # Errors
///
/// The error of the first row if none of the rows used can be read and fitted; an interruption if `monitor` cancels the
/// work.
pub fn choose(
    cohort: &Cohort,
    accuracy: Option<Accuracy>,
    keep: bool,
    params: &FitParams,
    reader: &SurfaceReader,
    monitor: &dyn Monitor,
) -> Result<ChosenDegree, Error> {
    let models = cohort.rows.iter().filter(|_| keep).map(|row| row.model(&cohort.folder));
    let existing = models.filter(|path| path.is_file()).find_map(|path| Model::read(path).ok());
    if let Some(model) = existing {
        return Ok(ChosenDegree::Existing { degree: model.coefficients.max_degree() });
    }
    let labels: Vec<&Row> = cohort.rows.iter().filter(|row| is_label(cohort, row)).collect();
    if accuracy.is_none() && !labels.is_empty() {
        return Ok(median(any(spread(&labels, LABELS), |row| of_label(row, reader, monitor))?));
    }
    let accuracy = accuracy.unwrap_or_default();
    let rows: Vec<&Row> = cohort.rows.iter().collect();
    let rows = spread(&rows, MESHES);
    monitor.begin(Stage::counted("choose the degree", "surfaces"), rows.len() as u64);
    let choices = any(rows, |row| {
        let choice = of_surface(cohort, row, accuracy, params, reader, &Quiet(monitor));
        monitor.step(1);
        choice
    });
    monitor.end();
    of_choices(&choices?).ok_or(Error::NoArea)
}

/// Returns the highest degree of the choices, limited to the degrees that the vertices of every surface determine.
fn of_choices(choices: &[DegreeChoice]) -> Option<ChosenDegree> {
    let choice = *choices.iter().max_by_key(|choice| choice.degree)?;
    let degree = choices.iter().map(|choice| choice.most).fold(choice.degree, usize::min);
    let missed = choices.iter().filter(|choice| !choice.reached() || choice.degree > degree).count();
    Some(ChosenDegree::Surfaces { choice, degree, fitted: choices.len(), missed })
}

/// Returns the degree that suits the median size of labels, as in [`choose`]. `voxels` lists the number of voxels of
/// each label. All labels have the same voxel size.
#[must_use]
pub fn degree_of_labels(voxels: &[usize], voxel_size: [f64; 3]) -> ChosenDegree {
    median(voxels.iter().map(|voxels| suitable_degree(*voxels, voxel_size)).collect())
}

fn median(mut degrees: Vec<usize>) -> ChosenDegree {
    degrees.sort_unstable();
    let (least, most) = OF_LABELS;
    let degree = degrees.get(degrees.len() / 2).map_or(least, |degree| *degree.clamp(&least, &most));
    ChosenDegree::Labels { degree, labels: degrees.len() }
}

/// Returns whether the surface of a row is extracted from a label.
fn is_label(cohort: &Cohort, row: &Row) -> bool {
    is_volume(&row.surface) && row.sphere.is_none() && cohort.sphere.is_none()
}

fn of_label(row: &Row, reader: &SurfaceReader, monitor: &dyn Monitor) -> Result<usize, Error> {
    let volume = reader.volume(&row.surface, monitor)?;
    let label = volume.choose(row.label)?;
    let voxels = volume.labels().get(&label).copied().unwrap_or(0);
    Ok(suitable_degree(voxels, volume.voxel_size()))
}

fn of_surface(
    cohort: &Cohort,
    row: &Row,
    accuracy: Accuracy,
    params: &FitParams,
    reader: &SurfaceReader,
    monitor: &dyn Monitor,
) -> Result<DegreeChoice, Error> {
    let read;
    let sphere = match (&cohort.sphere, &row.sphere) {
        (Some(sphere), _) => Some(sphere),
        (None, Some(path)) => {
            read = spharm::read_sphere(path)?;
            Some(&read)
        }
        (None, None) => None,
    };
    match sphere {
        Some(sphere) => choose_degree_over(sphere, &read_mesh(&row.surface)?, accuracy, params, monitor),
        None => {
            let volume = is_label(cohort, row);
            let label = if volume { Some(reader.volume(&row.surface, monitor)?.choose(row.label)?) } else { None };
            choose_degree(&reader.read(&row.surface, label, monitor)?, accuracy, params, monitor)
        }
    }
}

/// Returns at most `most` elements of a list, spread evenly from the first to the last.
fn spread<'a, T>(of: &[&'a T], most: usize) -> Vec<&'a T> {
    let count = of.len().min(most);
    (0..count).map(|at| of[at * (of.len() - 1) / (count - 1).max(1)]).collect()
}

/// Applies a function to each row, and returns the results of the successful calls. If all calls fail, returns the
/// first error.
fn any<T>(rows: Vec<&Row>, mut of: impl FnMut(&Row) -> Result<T, Error>) -> Result<Vec<T>, Error> {
    let (mut found, mut first) = (Vec::new(), None);
    for row in rows {
        match of(row) {
            Ok(value) => found.push(value),
            Err(error) if error.is_interrupted() => return Err(error),
            Err(error) => first = first.or(Some(error)),
        }
    }
    match (found.is_empty(), first) {
        (true, Some(error)) => Err(error),
        _ => Ok(found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_spread_from_the_first_to_the_last() {
        let numbers: Vec<usize> = (0..10).collect();
        let all: Vec<&usize> = numbers.iter().collect();
        assert_eq!(spread(&all, 3), [&0, &4, &9]);
        assert_eq!(spread(&all[..2], 3), [&0, &1]);
        assert_eq!(spread(&all[..1], 3), [&0]);
        assert!(spread(&all[..0], 3).is_empty());
    }
}
