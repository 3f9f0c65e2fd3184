//! Creates designs from tables of subjects. A design has columns for the term to test, and for covariates.

use std::collections::BTreeMap;

use ndarray::Array2;

use super::TestWarning;
use super::design::{Contrast, Design};
use super::nested::{container, leave_out};
use super::projection::{Projection, contrast_in_basis};
use super::terms::{Coded, Column, Term, centred, check_varies, coded, distinct, far, indicator, times};
use crate::ShapeError;
use crate::product::product;

/// A design, the contrast to test, and the contrast's meaning.
#[derive(Debug, Clone)]
pub struct Question {
    /// Design, whose first columns are the columns of the effect.
    pub design: Design,
    /// Contrast of the design to test.
    pub contrast: Contrast,
    /// Description of the contrast, such as "control - patient" or "slope of age".
    pub meaning: String,
    /// Levels of the effect and the number of subjects at each level. For the interaction of two columns of levels,
    /// pairs of levels ("cells") are listed instead.
    pub levels: Vec<(String, usize)>,
    /// Level, or pair of levels, of each subject; empty if the effect has no levels.
    pub level_of: Vec<String>,
    /// Terms that the design accounts for: covariates, and the columns of interactions.
    pub covariates: Vec<Term>,
    /// Names and distinct values of the columns that are treated as numbers but may be codes for levels.
    pub codes: Vec<(String, Vec<f64>)>,
    /// Warnings about the columns.
    pub warnings: Vec<TestWarning>,
}

impl Question {
    /// Returns pairs of names, such as `["group", "subject"]`. The effects of the first column aren't in the design,
    /// because the effects of the second column contain them.
    pub fn contained(&self) -> Vec<[String; 2]> {
        let mut found: Vec<[String; 2]> = Vec::new();
        for (name, column) in self.covariates.iter().flat_map(Term::columns) {
            let pair = container(name, column, &self.covariates).map(|other| [name.to_owned(), other.to_owned()]);
            found.extend(pair.filter(|pair| !found.contains(pair)));
        }
        found
    }

    /// Replaces the contrast by one or more combinations of the design's columns, such as `patient - control`; see
    /// [`Design::contrast`]. The statistic is t for one combination, and F for several.
    ///
    /// # Errors
    ///
    /// The errors of [`Design::contrast`]; [`ShapeError::Contrast`] if a combination is zero or depends linearly on the
    /// preceding ones.
    pub fn with_contrast(mut self, rows: &[impl AsRef<str>]) -> Result<Self, ShapeError> {
        self.contrast = self.design.contrast(rows)?;
        Projection::new(&self.design, &self.contrast)?;
        let rows: Vec<&str> = rows.iter().map(|row| row.as_ref().trim()).collect();
        self.meaning = if rows.len() == 1 { rows[0].to_owned() } else { format!("any of {}", rows.join("; ")) };
        Ok(self)
    }

    /// Checks that the contrast consists of differences or slopes. Other contrasts aren't meaningful for displacements
    /// from the mean.
    ///
    /// # Errors
    ///
    /// [`ShapeError::MeanOfDisplacements`] if the contrast tests a mean.
    pub fn check_differences(&self) -> Result<(), ShapeError> {
        if self.is_of_means() {
            return Err(ShapeError::MeanOfDisplacements { tested: self.meaning.clone() });
        }
        Ok(())
    }

    /// Returns whether the contrast tests means: its estimates change if a number is added to all values, unlike
    /// differences and slopes.
    pub fn is_of_means(&self) -> bool {
        let (basis, u) = contrast_in_basis(&self.design, &self.contrast);
        let ones = Array2::<f64>::ones((self.design.subjects(), 1));
        let estimates = product(u.t(), product(basis.t(), ones.view()).view());
        let scale = self.contrast.weights.iter().fold(0.0_f64, |most, weight| most.max(weight.abs()));
        estimates.iter().any(|estimate| estimate.abs() > 1e-9 * scale)
    }
}

/// The tested part of a design, and its contrast.
struct Tested {
    /// Columns of ones and zeros, or the constant.
    base: Coded,
    /// Columns of centred numbers, which are zero for average subjects.
    slopes: Coded,
    /// Rows of the contrast: the weights of the columns of `base`, followed by the weights of the columns of `slopes`.
    weights: Vec<Vec<f64>>,
    meaning: String,
    levels: Vec<String>,
    level_of: Vec<String>,
}

/// Returns the design and the contrast that test an effect, given covariates.
///
/// | effect | columns | tested hypothesis |
/// |---|---|---|
/// | numbers | `mean`, the numbers | the slope |
/// | levels | one for each level | for two levels the first minus the second, for more levels any difference |
/// | levels, numbers | one for each level, and a slope for each, `LEVEL:NUMBERS` | differences of the slopes |
/// | levels, levels | one for each pair of levels, `LEVEL:LEVEL` | differences of differences |
/// | numbers, numbers | `mean`, both, and their product | the product's slope |
///
/// Levels are in the order `order`, by default sorted. For an interaction, `order` applies to its first column of
/// levels. If a covariate, such as the subject, contains the main effect of one column of an interaction, the design
/// has no columns for this main effect; see [`Question::contained`]. Numbers are centred. A covariate of levels has a
/// centred column for each level except the first, and interactions of covariates are products of such columns. The
/// design includes the columns of an interaction even if they aren't listed as covariates.
///
/// # Errors
///
/// [`ShapeError::Subjects`] if columns have different lengths; [`ShapeError::Levels`] if the effect has only one level,
/// or `order` doesn't list all levels; [`ShapeError::DuplicateLevel`] if `order` lists a level twice;
/// [`ShapeError::Setting`] if `order` is given for an effect of numbers, or colons in levels give two pairs of levels
/// the same name; [`ShapeError::Constant`] if all numbers of a column are equal; [`ShapeError::EmptyCell`] if a pair of
/// levels has no subjects; the errors of [`Design::new`].
pub fn question(effect: &Term, order: &[String], covariates: &[Term]) -> Result<Question, ShapeError> {
    let n = effect.columns()[0].1.len();
    let terms: Vec<&Term> = std::iter::once(effect).chain(covariates).collect();
    check(n, &terms)?;
    let codes = codes_of(Some(effect), covariates);
    let warnings = doubts(&terms);
    let mut tested = match effect {
        Term::Column(name, Column::Numbers(numbers)) => Tested {
            base: constant(n),
            slopes: vec![(name.clone(), centred(numbers))],
            weights: vec![vec![0.0, 1.0]],
            meaning: format!("slope of {name}"),
            levels: Vec::new(),
            level_of: Vec::new(),
        },
        Term::Column(name, Column::Levels(of)) => of_levels(of, &ordered(name, of, order)?),
        Term::Interaction([(first, Column::Levels(a)), (second, Column::Levels(b))]) => {
            let levels = [ordered(first, a, order)?, ordered(second, b, &[])?];
            of_cells([first, second], [a, b], &levels)?
        }
        Term::Interaction([(first, Column::Levels(of)), (second, Column::Numbers(numbers))])
        | Term::Interaction([(second, Column::Numbers(numbers)), (first, Column::Levels(of))]) => {
            of_slopes((of, &ordered(first, of, order)?), (second, numbers))?
        }
        Term::Interaction([(first, Column::Numbers(a)), (second, Column::Numbers(b))]) => Tested {
            base: constant(n),
            slopes: vec![
                (first.clone(), centred(a)),
                (second.clone(), centred(b)),
                (effect.to_string(), times(&centred(a), &centred(b))),
            ],
            weights: vec![vec![0.0, 0.0, 0.0, 1.0]],
            meaning: format!("change of the slope of {first} with {second}"),
            levels: Vec::new(),
            level_of: Vec::new(),
        },
    };
    if tested.levels.is_empty() && !order.is_empty() {
        let (found, expected) = (order.join(", "), "a numeric effect has no levels");
        return Err(ShapeError::Setting { name: "the order of levels", found, expected });
    }
    let [own, covariates] = expanded(Some(effect), covariates);
    if let Term::Interaction(columns) = effect {
        leave_out((&mut tested.base, &mut tested.slopes, &mut tested.weights[..]), columns, &covariates);
    }
    let design = assemble(tested.base, tested.slopes, &covariates)?;
    let covariates = [own, covariates].concat();
    let columns = design.matrix().ncols();
    let weight = |row: usize, column: usize| tested.weights[row].get(column).copied().unwrap_or(0.0);
    let weights = Array2::from_shape_fn((tested.weights.len(), columns), |(row, column)| weight(row, column));
    let count = |level: &String| tested.level_of.iter().filter(|other| *other == level).count();
    let levels = tested.levels.iter().map(|level| (level.clone(), count(level))).collect();
    let contrast = Contrast { weights };
    let Tested { meaning, level_of, .. } = tested;
    Ok(Question { design, contrast, meaning, levels, level_of, covariates, codes, warnings })
}

/// Returns the design and the contrast of the mean of n subjects, with centred covariates; the hypothesis is that the
/// mean is zero. Values should be differences between two measurements of each subject, or other values whose mean
/// can be zero.
///
/// # Errors
///
/// The errors of [`question`].
pub fn mean_question(subjects: usize, covariates: &[Term]) -> Result<Question, ShapeError> {
    let terms: Vec<&Term> = covariates.iter().collect();
    check(subjects, &terms)?;
    let codes = codes_of(None, covariates);
    let warnings = doubts(&terms);
    let [_, covariates] = expanded(None, covariates);
    let design = assemble(constant(subjects), Vec::new(), &covariates)?;
    let contrast = Contrast::column(design.matrix().ncols(), 0);
    let (levels, level_of) = (Vec::new(), Vec::new());
    let meaning = "mean".to_owned();
    Ok(Question { design, contrast, meaning, levels, level_of, covariates, codes, warnings })
}

fn constant(n: usize) -> Coded {
    vec![("mean".to_owned(), vec![1.0; n])]
}

/// Returns the levels in the given order, by default sorted.
fn ordered(name: &str, of: &[String], order: &[String]) -> Result<Vec<String>, ShapeError> {
    let found = distinct(of);
    if let Some((_, level)) = order.iter().enumerate().find(|(at, level)| order[..*at].contains(*level)) {
        return Err(ShapeError::DuplicateLevel { column: name.to_owned(), level: level.clone() });
    }
    if found.len() < 2 || !order.is_empty() && distinct(order) != found {
        return Err(ShapeError::Levels { column: name.to_owned(), found, order: order.to_vec() });
    }
    Ok(if order.is_empty() { found } else { order.to_vec() })
}

/// Returns the weights of `count - 1` contrasts over `count` columns that follow `before` other columns. Each contrast
/// is a column minus the next column.
fn successive(before: usize, count: usize) -> Vec<Vec<f64>> {
    let weight = |row: usize, column: usize| f64::from(column == row) - f64::from(column == row + 1);
    (0..count - 1)
        .map(|row| vec![0.0; before].into_iter().chain((0..count).map(|at| weight(row, at))).collect())
        .collect()
}

fn of_levels(of: &[String], levels: &[String]) -> Tested {
    Tested {
        base: levels.iter().map(|level| (level.clone(), indicator(of, level))).collect(),
        slopes: Vec::new(),
        weights: successive(0, levels.len()),
        meaning: match levels {
            [first, second] => format!("{first} - {second}"),
            _ => format!("any difference between {}", levels.join(", ")),
        },
        levels: levels.to_vec(),
        level_of: of.to_vec(),
    }
}

/// Returns the columns and the contrast for the interaction of levels and numbers. The contrast tests differences
/// between the slopes within the levels.
fn of_slopes((of, levels): (&[String], &[String]), (name, numbers): (&str, &[f64])) -> Result<Tested, ShapeError> {
    let centred = centred(numbers);
    let slope = |level: &String| (format!("{level}:{name}"), times(&indicator(of, level), &centred));
    for level in levels {
        let own: Vec<f64> = of.iter().zip(numbers).filter(|(of, _)| *of == level).map(|(_, number)| *number).collect();
        check_varies(&format!("{name} in {level}"), &Column::Numbers(own))?;
    }
    Ok(Tested {
        slopes: levels.iter().map(slope).collect(),
        weights: successive(levels.len(), levels.len()),
        meaning: match levels {
            [first, second] => format!("slope of {name} in {first} minus slope of {name} in {second}"),
            _ => format!("any difference between the slopes of {name} in {}", levels.join(", ")),
        },
        ..of_levels(of, levels)
    })
}

/// Returns the columns and the contrast for the interaction of two columns of levels. The contrast tests differences of
/// differences between the means of the cells, that is, the pairs of levels.
fn of_cells(names: [&str; 2], of: [&[String]; 2], levels: &[Vec<String>; 2]) -> Result<Tested, ShapeError> {
    let level_of: Vec<String> = of[0].iter().zip(of[1]).map(|(a, b)| format!("{a}:{b}")).collect();
    let mut cells = Vec::new();
    for (a, b) in levels[0].iter().flat_map(|a| levels[1].iter().map(move |b| (a, b))) {
        let cell = format!("{a}:{b}");
        let members: Vec<f64> = of[0].iter().zip(of[1]).map(|(x, y)| f64::from(x == a && y == b)).collect();
        if members.iter().all(|member| *member == 0.0) {
            return Err(ShapeError::EmptyCell { interaction: names.join(":"), levels: [a.clone(), b.clone()] });
        }
        if cells.iter().any(|(other, _)| *other == cell) {
            let (name, found) =
                ("the name of a pair of levels", format!("{cell}, which is also the name of another pair of levels"));
            return Err(ShapeError::Setting { name, found, expected: "rename levels that contain colons" });
        }
        cells.push((cell, members));
    }
    // Row (i, j) of the weights is the difference between the cells (i, j) and (i + 1, j), minus the same difference at
    // column j + 1.
    let (rows, columns) = (successive(0, levels[0].len()), successive(0, levels[1].len()));
    let product = |a: &[f64], b: &[f64]| a.iter().flat_map(|a| b.iter().map(move |b| a * b)).collect();
    Ok(Tested {
        levels: cells.iter().map(|(cell, _)| cell.clone()).collect(),
        base: cells,
        slopes: Vec::new(),
        weights: rows.iter().flat_map(|a| columns.iter().map(move |b| product(a, b))).collect(),
        meaning: match (&levels[0][..], &levels[1][..]) {
            ([a, b], [first, second]) => format!("({a} - {b} at {first}) - ({a} - {b} at {second})"),
            _ => format!("any interaction of {} and {}", names[0], names[1]),
        },
        level_of,
    })
}

/// Returns two lists of terms. The first contains the columns of the effect, if the effect is an interaction. The
/// second contains the covariates and the columns of their interactions, without the terms of the effect.
fn expanded(effect: Option<&Term>, covariates: &[Term]) -> [Vec<Term>; 2] {
    let parts = |term: &Term| match term {
        Term::Column(..) => Vec::new(),
        Term::Interaction(columns) => {
            columns.iter().map(|(name, column)| Term::Column(name.clone(), column.clone())).collect()
        }
    };
    // A column that is both tested and a covariate is kept, so that the design reports it as linearly dependent.
    let has = |terms: &[Term], term: &Term| terms.iter().any(|other| other.is_same(term));
    let mut included: Vec<Term> = effect.map(parts).unwrap_or_default();
    let is_interaction = |term: &&Term| matches!(term, Term::Interaction(_));
    included.extend(effect.filter(is_interaction).cloned());
    let of_effect = included.len();
    for term in covariates {
        for part in parts(term) {
            let tested = effect == Some(&part);
            let is_contained = matches!(&part, Term::Column(name, of) if container(name, of, covariates).is_some());
            if !(tested || is_contained || covariates.contains(&part) || included.contains(&part)) {
                included.push(part);
            }
        }
        let again = matches!(term, Term::Interaction(_)) && has(&included, term);
        if !(again || has(&included[..of_effect], term)) {
            included.push(term.clone());
        }
    }
    let covariates = included.split_off(of_effect);
    included.retain(|term| Some(term) != effect);
    [included, covariates]
}

/// Creates a design from the columns `base` and `slopes` of the tested effect, followed by the columns of the
/// covariates.
fn assemble(base: Coded, slopes: Coded, covariates: &[Term]) -> Result<Design, ShapeError> {
    let n = base[0].1.len();
    let columns = base.into_iter().chain(slopes).chain(covariates.iter().flat_map(coded));
    let (names, columns): (Vec<String>, Vec<Vec<f64>>) = columns.unzip();
    Design::new(Array2::from_shape_fn((n, columns.len()), |(i, column)| columns[column][i]), names)
}

/// Checks that all columns have n cells, and that columns of numbers aren't constant.
fn check(n: usize, terms: &[&Term]) -> Result<(), ShapeError> {
    for (name, column) in terms.iter().flat_map(|term| term.columns()) {
        if column.len() != n {
            return Err(ShapeError::Subjects { what: "covariates", expected: n, found: column.len() });
        }
        check_varies(name, column)?;
    }
    Ok(())
}

/// Returns the columns of numbers that may be codes for levels. Covariates with two values aren't included, because the
/// model is the same whether they are numbers or levels.
fn codes_of(effect: Option<&Term>, covariates: &[Term]) -> Vec<(String, Vec<f64>)> {
    let of = |terms: &[Term], least: usize| {
        let columns = terms.iter().flat_map(Term::columns);
        let codes = columns.filter_map(|(name, column)| Some((name.to_owned(), column.codes()?)));
        codes.filter(|(_, values)| values.len() >= least).collect::<Vec<_>>()
    };
    let mut codes = of(covariates, 3);
    codes.extend(effect.map(|effect| of(std::slice::from_ref(effect), 2)).unwrap_or_default());
    let mut seen = Vec::new();
    codes.retain(|(name, _)| {
        !seen.contains(name) && {
            seen.push(name.clone());
            true
        }
    });
    codes
}

/// Returns warnings about levels of a column that differ only in case or in surrounding spaces, and about numbers that
/// are far from the other numbers in their column.
fn doubts(terms: &[&Term]) -> Vec<TestWarning> {
    let mut found: Vec<TestWarning> = Vec::new();
    for (name, column) in terms.iter().flat_map(|term| term.columns()) {
        let of = match column {
            Column::Levels(of) => of,
            Column::Numbers(numbers) => {
                let warning = far(numbers).map(|(row, median)| TestWarning::FarValue {
                    column: name.to_owned(),
                    row: row + 1,
                    value: numbers[row],
                    median,
                });
                found.extend(warning.filter(|warning| !found.contains(warning)));
                continue;
            }
        };
        let mut before = BTreeMap::new();
        for level in distinct(of) {
            let Some(other) = before.insert(level.trim().to_lowercase(), level.clone()) else { continue };
            let warning = TestWarning::SimilarLevels { column: name.to_owned(), levels: [other, level] };
            if !found.contains(&warning) {
                found.push(warning);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests;
