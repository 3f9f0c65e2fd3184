//! Represents columns of tables of subjects, and the terms of linear models made from them.

use std::collections::BTreeSet;
use std::fmt;

use crate::ShapeError;

/// A column of a table, with one value per subject.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Numbers, such as age or volume.
    Numbers(Vec<f64>),
    /// Names of levels, such as a group, a sex or a site.
    Levels(Vec<String>),
}

impl Column {
    /// Parses the cells of a column: numbers if all cells are finite numbers, otherwise levels. The minus sign U+2212
    /// is read as a hyphen.
    ///
    /// ```
    /// use spharm_shape::stats::Column;
    /// assert_eq!(Column::of(["1", " 2.5"]), Column::Numbers(vec![1.0, 2.5]));
    /// assert_eq!(Column::of(["1", "n/a"]), Column::Levels(vec!["1".into(), "n/a".into()]));
    /// ```
    pub fn of<'a>(cells: impl IntoIterator<Item = &'a str>) -> Self {
        let cells: Vec<&str> = cells.into_iter().map(str::trim).collect();
        let number =
            |cell: &&str| cell.replace('\u{2212}', "-").parse::<f64>().ok().filter(|number| number.is_finite());
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

    /// Returns the distinct values of a column of numbers that may be codes for levels: at most six distinct integers,
    /// and fewer distinct integers than subjects. Returns `None` for other numbers and for levels.
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

    /// Returns whether the column has no subjects.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A column of integers with at most this number of distinct values may contain codes for levels. A column with more
/// distinct values contains measurements.
const MAX_CODES: usize = 6;

/// A term of a linear model: a column, or the interaction of two columns. It is displayed as `group` or `group:age`.
#[derive(Debug, Clone, PartialEq)]
pub enum Term {
    /// A named column.
    Column(String, Column),
    /// The interaction of two columns: the dependence of one column's effect on the other column.
    Interaction([(String, Column); 2]),
}

impl Term {
    /// Parses the name of a term, such as `group` or `group:age`. `column` must return the column with a given name, or
    /// `None` if there is no such column. A column whose name contains a colon takes precedence over an interaction.
    /// The result is `None` if a column is missing.
    ///
    /// # Errors
    ///
    /// The errors of `column`.
    pub fn parse<E>(name: &str, mut column: impl FnMut(&str) -> Result<Option<Column>, E>) -> Result<Option<Self>, E> {
        if let Some(whole) = column(name)? {
            return Ok(Some(Self::Column(name.to_owned(), whole)));
        }
        let Some((first, second)) = name.split_once(':') else { return Ok(None) };
        let (Some(a), Some(b)) = (column(first)?, column(second)?) else { return Ok(None) };
        Ok(Some(Self::Interaction([(first.to_owned(), a), (second.to_owned(), b)])))
    }

    /// Returns whether two terms are the same, regardless of the order of an interaction's columns.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Interaction([a, b]), Self::Interaction(columns)) => {
                let [x, y] = columns;
                (a, b) == (x, y) || (a, b) == (y, x)
            }
            _ => self == other,
        }
    }

    /// Returns the names and the columns of the term.
    pub fn columns(&self) -> Vec<(&str, &Column)> {
        match self {
            Self::Column(name, column) => vec![(name, column)],
            Self::Interaction(columns) => columns.iter().map(|(name, column)| (name.as_str(), column)).collect(),
        }
    }
}

impl fmt::Display for Term {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.columns().into_iter().map(|(name, _)| name).collect();
        formatter.write_str(&names.join(":"))
    }
}

/// Returns the distinct levels in sorted order.
pub(crate) fn distinct(levels: &[String]) -> Vec<String> {
    levels.iter().collect::<BTreeSet<_>>().into_iter().cloned().collect()
}

/// Rejects a column of numbers that are all equal, because it would be linearly dependent on other columns of the
/// design.
pub(crate) fn check_varies(name: &str, column: &Column) -> Result<(), ShapeError> {
    let Column::Numbers(values) = column else { return Ok(()) };
    match values.first() {
        Some(&value) if values.iter().all(|other| *other == value) => {
            Err(ShapeError::Constant { column: name.to_owned(), value })
        }
        _ => Ok(()),
    }
}

/// Minimum number of values in a column for one value to be treated as far from the other values. The quartiles of
/// fewer values don't show whether a value is far away.
const FEWEST: usize = 8;
/// Distance from the median, in interquartile ranges, beyond which a number is treated as far from the other numbers.
const FAR: f64 = 20.0;

/// Numbers of at least this absolute value look like codes for missing values, such as 1e30 or the largest number of a
/// type.
const HUGE: f64 = 1e30;

/// Returns whether a number looks like a code for a missing value: -1, a number whose digits are all 7, all 8 or all 9,
/// such as -999 and 99.9, or a huge number. The distance from the median isn't a sufficient criterion, because the
/// largest numbers of skewed data may also be far from the other numbers.
fn is_like_code(number: f64) -> bool {
    let digits: Vec<char> = number.abs().to_string().chars().filter(|digit| *digit != '.').collect();
    let repeats = ['7', '8', '9'].contains(&digits[0]) && digits.iter().all(|digit| *digit == digits[0]);
    number == -1.0 || repeats || number.abs() >= HUGE
}

/// Checks whether the number that is farthest from the median may be a code for a missing value, such as -999. If the
/// number is far from the median and looks like a code, returns its row and the median, otherwise `None`.
pub(crate) fn far(numbers: &[f64]) -> Option<(usize, f64)> {
    let n = numbers.len();
    if n < FEWEST {
        return None;
    }
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (range, median) = (sorted[3 * n / 4] - sorted[n / 4], sorted[n / 2]);
    let distance = |row: &usize| (numbers[*row] - median).abs();
    let row = (0..n).max_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    (range > 0.0 && distance(&row) > FAR * range && is_like_code(numbers[row])).then_some((row, median))
}

/// Names and values of coded columns of a design.
pub(crate) type Coded = Vec<(String, Vec<f64>)>;

/// Returns numbers minus their mean.
pub(crate) fn centred(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| value - mean).collect()
}

/// Returns a column of ones for the subjects of a level and zeros for all others.
pub(crate) fn indicator(of: &[String], level: &str) -> Vec<f64> {
    of.iter().map(|other| f64::from(other == level)).collect()
}

/// Returns the elementwise product of two columns.
pub(crate) fn times(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// Codes a covariate as centred columns: its numbers, or ones and zeros for each level except the first. An interaction
/// is coded as the products of the columns of its two parts. Columns are centred so that other effects refer to
/// subjects with average covariates.
pub(crate) fn coded(term: &Term) -> Coded {
    let of_column = |name: &str, column: &Column| match column {
        Column::Numbers(numbers) => vec![(name.to_owned(), centred(numbers))],
        Column::Levels(of) => {
            let levels = distinct(of).into_iter().skip(1);
            levels.map(|level| (format!("{name} {level}"), centred(&indicator(of, &level)))).collect()
        }
    };
    match term {
        Term::Column(name, column) => of_column(name, column),
        Term::Interaction([(first, a), (second, b)]) => {
            let (a, b) = (of_column(first, a), of_column(second, b));
            let product = |(a, x): &(String, Vec<f64>), (b, z): &(String, Vec<f64>)| (format!("{a}:{b}"), times(x, z));
            a.iter().flat_map(|a| b.iter().map(move |b| product(a, b))).collect()
        }
    }
}
