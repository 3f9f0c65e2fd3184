//! Creates the design of a test from columns of a table, for `shape test` and studies.

use std::collections::{BTreeSet, HashSet};

use anyhow::{Result, anyhow, bail};
use spharm::shape::stats::{Column, Question, Term, mean_question, question};

use super::table::{Subjects, column_of, no_number};

/// A hypothesis to test, stated in terms of the columns of a table of subjects.
pub struct Asked<'a> {
    /// Name of the column to test, or of an interaction of two columns, `a:b`; `None` tests the mean.
    pub effect: Option<&'a str>,
    /// Names of the effect's levels in the order to use; empty for the sorted order.
    pub levels: &'a [String],
    /// Linear combinations of the design's columns that replace the effect's own contrast.
    pub contrast: &'a [String],
    /// Names of the covariates.
    pub covariates: &'a [String],
    /// Names of columns whose numbers are codes of levels rather than quantities.
    pub categorical: &'a [String],
    /// Name of the column of exchangeability blocks. If this column is also a covariate, its cells are treated as
    /// levels even if they are numbers.
    pub blocks: Option<&'a str>,
    /// Whether the tested values are relative to the mean of all subjects. The mean of such values is always zero, so
    /// it can't be tested.
    pub relative: bool,
}

impl Asked<'_> {
    /// Builds the design matrix and the contrast.
    ///
    /// # Errors
    ///
    /// If a column is missing or constant, or the design can't test the effect.
    pub fn question(&self, table: &impl Subjects) -> Result<Question> {
        let covariates = self.covariates.iter().map(|name| self.term(name, table)).collect::<Result<Vec<_>>>()?;
        let is_constant = |levels: &[String]| levels.windows(2).all(|pair| pair[0] == pair[1]);
        for term in &covariates {
            if let Term::Column(name, Column::Levels(levels)) = term
                && is_constant(levels)
            {
                let level = levels.first().map_or("", String::as_str);
                bail!("covariate {name:?} is {level:?} for all subjects and has no effect; remove the covariate");
            }
        }
        let Some(effect) = self.effect else { return Ok(mean_question(table.count(), &covariates)?) };
        let effect = self.term(effect, table)?;
        let question = question(&effect, self.levels, &covariates)?;
        if self.contrast.is_empty() {
            return Ok(question);
        }
        let question = question.with_contrast(self.contrast)?;
        if self.relative {
            question.check_differences()?;
        }
        Ok(question)
    }

    /// Returns a column of `categorical` that occurs neither in the effect nor in the covariates, if such a column
    /// exists.
    pub fn unused(&self) -> Option<&str> {
        let terms = || self.effect.into_iter().chain(self.covariates.iter().map(String::as_str));
        self.categorical.iter().map(String::as_str).find(|name| !terms().any(|term| parts(term).contains(name)))
    }

    /// Returns a term of the model: a column, or the interaction of two columns.
    fn term(&self, name: &str, table: &impl Subjects) -> Result<Term> {
        let names = table.names();
        let column = |name: &str| if names.contains(&name) { self.column(name, table).map(Some) } else { Ok(None) };
        match Term::parse(name, column)? {
            Some(term) => Ok(term),
            None => {
                let missing = parts(name).into_iter().skip(1).find(|part| !names.contains(part));
                Err(anyhow!("no column {:?}; the columns are {}", missing.unwrap_or(name), names.join(", ")))
            }
        }
    }

    fn column(&self, name: &str, table: &impl Subjects) -> Result<Column> {
        let cells = table.cells(name)?;
        if self.is_of_levels(name, &cells) {
            return Ok(Column::Levels(cells.into_iter().map(str::to_owned).collect()));
        }
        column_of(&cells).map_err(|row| anyhow!("{}: column {name:?}: {}", table.place(row), no_number(cells[row])))
    }

    /// Returns whether a column's numbers are names of levels. This holds for columns listed in `categorical`, for the
    /// column of blocks, and for the effect if the order of its levels is given.
    fn is_of_levels(&self, name: &str, cells: &[&str]) -> bool {
        let is_ordered = || {
            let order: BTreeSet<&str> = self.levels.iter().map(String::as_str).collect();
            let effect = self.effect.unwrap_or_default();
            let is_part = || parts(effect).contains(&name) && cells.iter().copied().collect::<BTreeSet<_>>() == order;
            !order.is_empty() && (effect == name || is_part())
        };
        self.categorical.iter().any(|of| of == name) || self.blocks == Some(name) || is_ordered()
    }
}

/// Returns the name of a term and, if the name has the form of an interaction, `a:b`, also the names of both columns.
pub fn parts(term: &str) -> Vec<&str> {
    let columns = term.split_once(':').map(|(first, second)| [first, second]);
    std::iter::once(term).chain(columns.into_iter().flatten()).collect()
}

/// Returns a covariate's name, with the number of its levels if it has levels.
pub(crate) fn with_levels(term: &Term) -> String {
    match term {
        Term::Column(name, Column::Levels(levels)) => {
            format!("{name} ({} levels)", levels.iter().collect::<HashSet<_>>().len())
        }
        _ => term.to_string(),
    }
}
