//! Creates designs from tables of subjects: a column to test, and covariates to account for.

use std::collections::BTreeSet;

use ndarray::Array2;

use super::design::{Contrast, Design};
use crate::ShapeError;

/// A table's column, with one value per subject.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Numbers, such as age or volume.
    Numbers(Vec<f64>),
    /// Levels, such as group, sex or site.
    Levels(Vec<String>),
}

impl Column {
    /// Parses the cells of a column: numbers if all cells are finite numbers, otherwise levels.
    ///
    /// ```
    /// use spharm_shape::stats::Column;
    /// assert_eq!(Column::of(["1", " 2.5"]), Column::Numbers(vec![1.0, 2.5]));
    /// assert_eq!(Column::of(["1", "n/a"]), Column::Levels(vec!["1".into(), "n/a".into()]));
    /// ```
    pub fn of<'a>(cells: impl IntoIterator<Item = &'a str>) -> Self {
        let cells: Vec<&str> = cells.into_iter().map(str::trim).collect();
        let number = |cell: &&str| cell.parse::<f64>().ok().filter(|number| number.is_finite());
        let numbers: Option<Vec<f64>> = cells.iter().map(number).collect();
        numbers.map_or_else(|| Self::Levels(cells.into_iter().map(str::to_owned).collect()), Self::Numbers)
    }

    /// Returns the number of subjects, n.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(numbers) => numbers.len(),
            Self::Levels(levels) => levels.len(),
        }
    }

    /// Returns the distinct values of numbers that may be codes of levels: at most six distinct values, all integers,
    /// fewer than subjects. Returns `None` otherwise, and for levels.
    ///
    /// ```
    /// use spharm_shape::stats::Column;
    /// assert_eq!(Column::of(["3", "1", "1", "2"]).codes(), Some(vec![1.0, 2.0, 3.0]));
    /// assert_eq!(Column::of(["31.5", "28", "31.5", "40"]).codes(), None);
    /// ```
    pub fn codes(&self) -> Option<Vec<f64>> {
        let Self::Numbers(numbers) = self else { return None };
        let mut values = Vec::new();
        for number in numbers {
            if !values.contains(number) {
                values.push(*number);
            }
            if number.fract() != 0.0 || values.len() > MAX_CODES {
                return None;
            }
        }
        values.sort_by(f64::total_cmp);
        (values.len() < numbers.len()).then_some(values)
    }

    /// Returns whether there are no subjects.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// With more distinct values than this, numbers are treated as measurements.
const MAX_CODES: usize = 6;

/// A design, the contrast to test, and the contrast's meaning.
#[derive(Debug, Clone)]
pub struct Question {
    /// The design, with the effect's columns first.
    pub design: Design,
    /// The contrast.
    pub contrast: Contrast,
    /// Description of the contrast: "control - patient", "slope of age".
    pub meaning: String,
    /// Levels of the effect, if it is a column of levels, and their numbers of subjects.
    pub levels: Vec<(String, usize)>,
    /// Columns treated as numbers that may be codes of levels, with their distinct values.
    pub codes: Vec<(String, Vec<f64>)>,
}

/// Returns the design and the contrast of an effect, given its name, with covariates: the slope of a number, the
/// difference of two levels (the first minus the second), or any difference between more levels. Levels are in the
/// order of `order`, by default sorted. Covariates are centred; each level of a covariate except the first has a
/// column.
///
/// # Errors
///
/// [`ShapeError::Subjects`] for columns of different lengths, [`ShapeError::Levels`] for an effect of one level or an
/// `order` that doesn't list all levels, [`ShapeError::Constant`] for numbers that are all equal; the errors of
/// [`Design`].
pub fn question(
    (name, effect): (&str, &Column),
    order: &[String],
    covariates: &[(String, Column)],
) -> Result<Question, ShapeError> {
    let n = effect.len();
    let (mut columns, mut names) = columns_of(n, covariates)?;
    check_varies(name, effect)?;
    let mut codes = codes_of(covariates);
    codes.extend(effect.codes().map(|values| (name.to_owned(), values)));
    let (base, effects, meaning, levels) = match effect {
        Column::Numbers(numbers) => {
            columns.insert(0, numbers.clone());
            names.insert(0, name.to_owned());
            (Design::new(Array2::ones((n, 1)), vec!["mean".to_owned()])?, None, format!("slope of {name}"), Vec::new())
        }
        Column::Levels(of) => {
            let found = distinct(of);
            let asked: BTreeSet<&String> = order.iter().collect();
            if found.len() < 2 || !order.is_empty() && asked.into_iter().ne(found.iter()) {
                return Err(ShapeError::Levels { column: name.to_owned(), found, order: order.to_vec() });
            }
            let found = if order.is_empty() { found } else { order.to_vec() };
            let matrix = Array2::from_shape_fn((n, found.len()), |(i, level)| f64::from(of[i] == found[level]));
            let meaning = match &found[..] {
                [first, second] => format!("{first} - {second}"),
                _ => format!("any difference between {}", found.join(", ")),
            };
            let counts = found.iter().map(|level| (level.clone(), of.iter().filter(|other| *other == level).count()));
            (Design::new(matrix, found.clone())?, Some(found.len()), meaning, counts.collect())
        }
    };
    let design = with_columns(base, &columns, &names)?;
    let all = design.matrix().ncols();
    let contrast = match effects {
        None => Contrast::column(all, 1),
        Some(levels) => Contrast {
            weights: Array2::from_shape_fn((levels - 1, all), |(row, column)| {
                f64::from(column == row) - f64::from(column == row + 1)
            }),
        },
    };
    Ok(Question { design, contrast, meaning, levels, codes })
}

/// Returns the design and the contrast of the mean of n subjects, with centred covariates; the hypothesis is that the
/// mean is zero. Values are differences between two measurements of each subject, or other values whose mean can be
/// zero.
///
/// # Errors
///
/// The errors of [`question`].
pub fn mean_question(subjects: usize, covariates: &[(String, Column)]) -> Result<Question, ShapeError> {
    let (columns, names) = columns_of(subjects, covariates)?;
    let base = Design::new(Array2::ones((subjects, 1)), vec!["mean".to_owned()])?;
    let design = with_columns(base, &columns, &names)?;
    let contrast = Contrast::column(design.matrix().ncols(), 0);
    let codes = codes_of(covariates);
    Ok(Question { design, contrast, meaning: "mean".to_owned(), levels: Vec::new(), codes })
}

fn with_columns(base: Design, columns: &[Vec<f64>], names: &[String]) -> Result<Design, ShapeError> {
    if columns.is_empty() {
        return Ok(base);
    }
    let table = Array2::from_shape_fn((base.subjects(), columns.len()), |(i, column)| columns[column][i]);
    base.with_covariates(table.view(), names)
}

/// Returns the columns of covariates and their names: numbers unchanged, ones and zeros for each level except the
/// first.
fn columns_of(n: usize, covariates: &[(String, Column)]) -> Result<(Vec<Vec<f64>>, Vec<String>), ShapeError> {
    if let Some((_, other)) = covariates.iter().find(|(_, column)| column.len() != n) {
        return Err(ShapeError::Subjects { what: "covariates", expected: n, found: other.len() });
    }
    let (mut columns, mut names): (Vec<Vec<f64>>, Vec<String>) = (Vec::new(), Vec::new());
    for (name, column) in covariates {
        check_varies(name, column)?;
        match column {
            Column::Numbers(numbers) => {
                columns.push(numbers.clone());
                names.push(name.clone());
            }
            Column::Levels(of) => {
                for level in distinct(of).into_iter().skip(1) {
                    columns.push(of.iter().map(|other| f64::from(*other == level)).collect());
                    names.push(format!("{name} {level}"));
                }
            }
        }
    }
    Ok((columns, names))
}

/// Rejects numbers that are all equal, which would be a linearly dependent column of the design.
fn check_varies(name: &str, column: &Column) -> Result<(), ShapeError> {
    let Column::Numbers(values) = column else { return Ok(()) };
    match values.first() {
        Some(&value) if values.iter().all(|other| *other == value) => {
            Err(ShapeError::Constant { column: name.to_owned(), value })
        }
        _ => Ok(()),
    }
}

/// Returns covariates that may be codes of levels. Covariates of two values aren't included: as numbers and as levels
/// they give the same model.
fn codes_of(covariates: &[(String, Column)]) -> Vec<(String, Vec<f64>)> {
    let codes = covariates.iter().filter_map(|(name, column)| Some((name.clone(), column.codes()?)));
    codes.filter(|(_, values)| values.len() > 2).collect()
}

fn distinct(levels: &[String]) -> Vec<String> {
    levels.iter().collect::<BTreeSet<_>>().into_iter().cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(of: &str) -> Column {
        Column::of(of.split(' '))
    }

    #[test]
    fn effects_and_covariates_become_columns() {
        let group = levels("b a a b b a");
        let covariates = [("age".to_owned(), levels("1 2 3 4 5 9")), ("site".to_owned(), levels("x y z x z y"))];
        let found = question(("group", &group), &[], &covariates).unwrap();
        assert_eq!(found.design.names(), ["a", "b", "age", "site y", "site z"]);
        assert_eq!(found.contrast.weights, ndarray::array![[1.0, -1.0, 0.0, 0.0, 0.0]]);
        assert_eq!((found.meaning.as_str(), found.levels[1].1), ("a - b", 3));
        assert_eq!(found.design.matrix().column(2).sum(), 0.0);
        let order = ["b".to_owned(), "a".to_owned()];
        assert_eq!(question(("group", &group), &order, &[]).unwrap().meaning, "b - a");
        let slope = question(("age", &covariates[0].1), &[], &[("group".to_owned(), group)]).unwrap();
        assert_eq!(slope.design.names(), ["mean", "age", "group b"]);
        assert_eq!(slope.contrast.weights, ndarray::array![[0.0, 1.0, 0.0]]);
        let three = question(("site", &covariates[1].1), &[], &[]).unwrap();
        assert_eq!(three.contrast.weights, ndarray::array![[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]);
    }

    #[test]
    fn columns_that_say_nothing_are_refused() {
        assert!(matches!(question(("group", &levels("a a a")), &[], &[]), Err(ShapeError::Levels { .. })));
        let order = ["a".to_owned(), "c".to_owned()];
        assert!(matches!(question(("group", &levels("a b a")), &order, &[]), Err(ShapeError::Levels { .. })));
        let short = [("age".to_owned(), levels("1 2"))];
        assert!(matches!(question(("group", &levels("a b a")), &[], &short), Err(ShapeError::Subjects { .. })));
        let constant = levels("7 7 7 7");
        let found = question(("age", &constant), &[], &[]).unwrap_err();
        assert!(matches!(&found, ShapeError::Constant { column, value: 7.0 } if column == "age"), "{found}");
        let found = question(("group", &levels("a b a b")), &[], &[("age".to_owned(), constant)]).unwrap_err();
        assert!(matches!(found, ShapeError::Constant { .. }), "{found}");
        let same = [("sex".to_owned(), levels("m f m f"))];
        assert!(matches!(question(("group", &levels("a b a b")), &[], &same), Err(ShapeError::Rank { .. })));
    }
}
