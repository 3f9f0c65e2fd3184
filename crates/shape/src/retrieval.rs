//! Finds the models in a library that are nearest to a query.
//!
//! A [`Library`] holds the singular values of its models ([`descriptors`](mod@crate::descriptors)). The distance
//! between the singular values of a model and of the query is a lower bound of the distance between the aligned
//! surfaces at equal directions. [`Library::nearest`] sorts by that bound. [`Library::refined`] aligns candidates in
//! the order of their bounds, until the next bound exceeds the distances found. If the alignment finds the best
//! rotations, the result is the same as after aligning every model, although only a few models are aligned.
//!
//! [`Metric::Standardized`] first divides each singular value by its standard deviation over the library. High degrees,
//! whose singular values are small, then have the same weight as low degrees. This metric finds a perturbed shape among
//! many if the perturbation of each degree is proportional to the degree's size. Its score isn't a distance between
//! surfaces.
//!
//! Cost: 6 L flops and 24 L bytes per model, 4 MB for 10,000 models at L = 15.

use rayon::prelude::*;

use crate::clusters::PairDistances;
use crate::descriptors::Descriptors;
use crate::error::ShapeError;

/// Criterion by which models are sorted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Metric {
    /// Distance between the singular values, in the models' unit: a lower bound of the distance between the surfaces at
    /// equal directions, in any pose.
    #[default]
    Distance,
    /// Distance between the singular values, each divided by its standard deviation over the library; it has no unit.
    Standardized,
}

/// Descriptors of many models, all truncated to one degree.
#[derive(Debug, Clone)]
pub struct Library {
    /// Singular values (models, degrees times channels), row-major.
    rows: Vec<f64>,
    /// Inverse of each column's standard deviation; 0 if the column is constant over all models.
    scales: Vec<f64>,
    width: usize,
    degree: usize,
    channels: usize,
    unit_size: bool,
}

/// A model in a library and its distance from the query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Index of the model in the library, from 0.
    pub index: usize,
    /// Distance between the singular values, which is at most the root mean square distance between the surfaces at
    /// equal directions, in any pose.
    pub bound: f64,
    /// Value by which the models were sorted: `bound`, unless another [`Metric`] was requested.
    pub score: f64,
    /// Root mean square distance after alignment, if computed.
    pub distance: Option<f64>,
}

impl Library {
    /// Creates a library from the descriptors of models, truncated to the lowest of their degrees. If `unit_size` is
    /// set, models are first scaled to size 1.
    ///
    /// # Errors
    ///
    /// - [`ShapeError::Setting`] if there are no models, or a model has no degree above 0.
    /// - [`ShapeError::Differ`] if a model's number of channels differs from the first model's.
    pub fn new<'a>(models: impl IntoIterator<Item = &'a Descriptors>, unit_size: bool) -> Result<Self, ShapeError> {
        let models: Vec<&Descriptors> = models.into_iter().collect();
        let degree = models.iter().map(|model| model.max_degree()).min().unwrap_or(0);
        let (Some(first), 1..) = (models.first(), degree) else {
            let (name, expected) =
                ("the lowest degree of the models", "at least one model is needed, and all must have degree 1 or more");
            let found = if models.is_empty() { "none" } else { "0" };
            return Err(ShapeError::Setting { name, expected, found: found.to_owned() });
        };
        let (channels, width) = (first.channels, degree * first.channels);
        let mut rows = Vec::with_capacity(models.len() * width);
        for model in &models {
            check_channels(channels, model)?;
            rows.extend(row(model, degree, unit_size));
        }
        let scales = scales(&rows, width);
        Ok(Self { rows, scales, width, degree, channels, unit_size })
    }

    /// Returns the number of models.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len() / self.width
    }

    /// Returns whether the library has no models; always `false`, because a library has at least one model.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Returns the degree up to which models are compared.
    #[must_use]
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Returns the `count` models whose singular values are nearest to the query's by `metric`, nearest first; ties are
    /// in the library's order.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Differ`] if the query's degree is below the library's, or its number of channels differs.
    pub fn nearest(&self, query: &Descriptors, count: usize, metric: Metric) -> Result<Vec<Match>, ShapeError> {
        let mut found = self.scores(query, metric)?;
        let count = count.min(found.len());
        if count == 0 {
            return Ok(Vec::new());
        }
        found.select_nth_unstable_by(count - 1, by_score);
        found.truncate(count);
        found.sort_by(by_score);
        Ok(found)
    }

    /// Returns the `count` models nearest to a query after alignment, nearest first. `align` returns the root mean
    /// square distance of an aligned model from the query, given the model's index in the library. The function `align`
    /// is called only for the models that the bounds don't exclude, and at most `most` times.
    ///
    /// `align` must compare the same degrees as the library. If the library scales models to size 1, `align` must do so
    /// as well. Calls are sequential, so each call can use all threads.
    ///
    /// # Errors
    ///
    /// The errors of [`nearest`](Self::nearest), and the first error of `align`.
    pub fn refined<E: From<ShapeError>>(
        &self,
        query: &Descriptors,
        count: usize,
        most: usize,
        mut align: impl FnMut(usize) -> Result<f64, E>,
    ) -> Result<Vec<Match>, E> {
        let mut candidates = self.scores(query, Metric::Distance)?;
        candidates.sort_by(by_score);
        let mut found: Vec<Match> = Vec::new();
        for candidate in candidates.into_iter().take(most) {
            let worst = found.get(count.wrapping_sub(1)).and_then(|worst| worst.distance);
            if count == 0 || worst.is_some_and(|worst| candidate.bound >= worst) {
                break;
            }
            let distance = align(candidate.index)?;
            let at = found.partition_point(|other| other.distance.is_some_and(|other| other <= distance));
            found.insert(at, Match { distance: Some(distance), ..candidate });
        }
        found.truncate(count);
        Ok(found)
    }

    /// Returns the distances between all pairs of models, measured by `metric`.
    #[must_use]
    pub fn distances(&self, metric: Metric) -> PairDistances {
        let row = |index: usize| &self.rows[index * self.width..(index + 1) * self.width];
        PairDistances::new(self.len(), |a, b| {
            let pairs = row(a).iter().zip(row(b)).zip(&self.scales);
            let square = |((a, b), scale): ((&f64, &f64), &f64)| match metric {
                Metric::Distance => (a - b) * (a - b),
                Metric::Standardized => (scale * (a - b)) * (scale * (a - b)),
            };
            pairs.map(square).sum::<f64>().sqrt()
        })
    }

    /// Returns every model with its bound and score, in the library's order.
    fn scores(&self, query: &Descriptors, metric: Metric) -> Result<Vec<Match>, ShapeError> {
        check_channels(self.channels, query)?;
        if query.max_degree() < self.degree {
            let (expected, found) = (self.degree, query.max_degree());
            return Err(ShapeError::Differ { what: "degree of the query", expected, found });
        }
        let query = row(query, self.degree, self.unit_size);
        let models = self.rows.par_chunks_exact(self.width).enumerate();
        Ok(models
            .map(|(index, model)| {
                let (mut square, mut scaled) = (0.0, 0.0);
                for ((a, b), scale) in model.iter().zip(&query).zip(&self.scales) {
                    square += (a - b) * (a - b);
                    scaled += (scale * (a - b)) * (scale * (a - b));
                }
                let score = if metric == Metric::Distance { square } else { scaled };
                Match { index, bound: square.sqrt(), score: score.sqrt(), distance: None }
            })
            .collect())
    }
}

/// Returns the inverse standard deviation of each column of `rows`; 0 for a constant column.
fn scales(rows: &[f64], width: usize) -> Vec<f64> {
    let models = (rows.len() / width) as f64;
    let mut means = vec![0.0; width];
    for row in rows.chunks_exact(width) {
        means.iter_mut().zip(row).for_each(|(mean, value)| *mean += value / models);
    }
    let mut variances = vec![0.0; width];
    for row in rows.chunks_exact(width) {
        let squares = row.iter().zip(&means).map(|(value, mean)| (value - mean) * (value - mean) / models);
        variances.iter_mut().zip(squares).for_each(|(variance, square)| *variance += square);
    }
    // A deviation within rounding error carries no information.
    let scale = |(variance, mean): (&f64, &f64)| {
        let deviation = variance.sqrt();
        if deviation > 1e-12 * mean.abs() { 1.0 / deviation } else { 0.0 }
    };
    variances.iter().zip(&means).map(scale).collect()
}

fn by_score(a: &Match, b: &Match) -> std::cmp::Ordering {
    a.score.total_cmp(&b.score).then(a.index.cmp(&b.index))
}

fn check_channels(expected: usize, model: &Descriptors) -> Result<(), ShapeError> {
    if model.channels == expected {
        return Ok(());
    }
    Err(ShapeError::Differ { what: "channels of a model", expected, found: model.channels })
}

/// Returns a model's singular values up to a degree. Scaling to unit size uses only these degrees, so that models of
/// different degrees are scaled in the same way.
fn row(model: &Descriptors, degree: usize, unit_size: bool) -> Vec<f64> {
    let model = model.up_to(degree);
    if unit_size { model.unit_size().singular_values } else { model.singular_values }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::descriptors::descriptors;
    use ndarray::Array2;
    use spharm_harmonics::Coefficients;
    use spharm_harmonics::index::basis_size;
    use std::f64::consts::PI;

    fn model(max_degree: usize, seed: usize) -> Coefficients {
        let value = |(k, c): (usize, usize)| {
            let x = (k * 3 + c) as f64 * 12.9898 + seed as f64 * 78.233;
            ((x.sin() * 43_758.547).fract() - 0.5) / (1.0 + (k as f64).powf(0.75))
        };
        Coefficients::new(Array2::from_shape_fn((basis_size(max_degree), 3), value)).unwrap()
    }

    fn distance(a: &Coefficients, b: &Coefficients) -> f64 {
        let squares = a.values().iter().zip(b.values()).skip(3).map(|(a, b)| (a - b) * (a - b));
        (squares.sum::<f64>() / (4.0 * PI)).sqrt()
    }

    #[test]
    fn a_model_is_found_and_bounds_are_bounds() {
        let models: Vec<Coefficients> = (0..200).map(|seed| model(6, seed)).collect();
        let rows: Vec<Descriptors> = models.iter().map(|model| descriptors(model).unwrap()).collect();
        let library = Library::new(&rows, false).unwrap();
        assert_eq!((library.len(), library.degree(), library.is_empty()), (200, 6, false));
        for (index, row) in rows.iter().enumerate() {
            let [first, second] = library.nearest(row, 2, Metric::Distance).unwrap()[..] else { panic!("two") };
            assert_eq!((first.index, first.bound, first.distance), (index, 0.0, None));
            assert!(second.bound > 0.0);
        }
        let all = library.nearest(&rows[17], 1_000, Metric::Distance).unwrap();
        assert!(all.len() == 200 && all.windows(2).all(|pair| pair[0].bound <= pair[1].bound));
        for found in all {
            assert!(found.bound <= distance(&models[17], &models[found.index]) + 1e-14);
        }
    }

    /// In this test `align` returns the distance of the models in their given poses. The bounds hold for this distance
    /// as well.
    #[test]
    fn refining_finds_what_comparing_all_finds_with_fewer_comparisons() {
        let models: Vec<Coefficients> = (0..300).map(|seed| model(4, seed)).collect();
        let rows: Vec<Descriptors> = models.iter().map(|model| descriptors(model).unwrap()).collect();
        let library = Library::new(&rows, false).unwrap();
        // The query is near model 40, so that one model is clearly the nearest.
        let near = models[40].values() + &(model(4, 999).values() * 0.02);
        let query = Coefficients::new(near).unwrap();
        let mut expected: Vec<(f64, usize)> =
            models.iter().enumerate().map(|(index, model)| (distance(&query, model), index)).collect();
        expected.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut calls = 0;
        let align = |index: usize| -> Result<f64, ShapeError> {
            calls += 1;
            Ok(distance(&query, &models[index]))
        };
        let found = library.refined(&descriptors(&query).unwrap(), 1, 300, align).unwrap();
        assert_eq!((found[0].index, found[0].distance), (40, Some(expected[0].0)));
        assert!(calls < 100, "{calls}");
        let row = descriptors(&query).unwrap();
        let found = library.refined::<ShapeError>(&row, 3, 300, |index| Ok(distance(&query, &models[index]))).unwrap();
        let indices: Vec<usize> = found.iter().map(|found| found.index).collect();
        assert_eq!(indices, expected[..3].iter().map(|(_, index)| *index).collect::<Vec<_>>());
        assert_eq!(library.refined::<ShapeError>(&row, 3, 2, |_| Ok(1.0)).unwrap().len(), 2);
        assert!(library.refined::<ShapeError>(&row, 0, 9, |_| Ok(1.0)).unwrap().is_empty());
        let failed = library.refined(&row, 1, 9, |_| Err(ShapeError::from(spharm_monitor::Interrupted)));
        assert!(matches!(failed, Err(ShapeError::Interrupted(_))));
    }

    #[test]
    fn degrees_and_sizes_are_made_alike() {
        let scaled = Coefficients::new(model(6, 3).values() * 7.0).unwrap();
        let rows: Vec<Descriptors> =
            [model(6, 2), scaled, model(4, 4)].iter().map(|model| descriptors(model).unwrap()).collect();
        let library = Library::new(&rows, true).unwrap();
        assert_eq!(library.degree(), 4);
        let query = descriptors(&model(9, 3)).unwrap();
        let first = library.nearest(&query, 1, Metric::Standardized).unwrap()[0];
        // The lower degrees of model(9, 3) equal those of model(6, 3).
        assert!(first.index == 1 && first.bound < 1e-14, "{first:?}");
        let low = descriptors(&model(3, 1)).unwrap();
        assert!(matches!(
            library.nearest(&low, 1, Metric::Distance),
            Err(ShapeError::Differ { expected: 4, found: 3, .. })
        ));
        let signal = descriptors(&Coefficients::new(Array2::ones((49, 2))).unwrap()).unwrap();
        assert!(matches!(
            library.nearest(&signal, 1, Metric::Distance),
            Err(ShapeError::Differ { expected: 3, found: 2, .. })
        ));
        assert!(matches!(Library::new(&[], false), Err(ShapeError::Setting { .. })));
    }
}
