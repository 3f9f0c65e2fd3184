//! Determines the tested models and their design from groups, or from the columns of a table.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm::shape::ShapeError;
use spharm::shape::stats::{Blocks, Column, Exchange, Question, Term, mean_question, numbered, question};
use spharm_cli::Usage;
use spharm_cli::paths::with_ending;

use super::super::args::files;
use super::super::design::{Asked, with_levels};
use super::super::table::Table;
use super::args::{Cli, What};
use super::pairs::{self, SubjectsDiffer};

/// The models of a test, and the hypothesis to test on them.
pub(super) struct Study {
    /// Paths of the models; for pairs, the first models of all pairs come before the second models.
    pub(super) paths: Vec<PathBuf>,
    /// Whether the models form pairs, whose differences are tested.
    pub(super) pairs: bool,
    pub(super) question: Question,
    /// Name of the tested column, or `mean` if a mean is tested.
    pub(super) of: String,
    /// Whether contrasts given by the user replace the effect's own contrast.
    pub(super) contrast: bool,
    /// Names of the covariates, with the number of levels for a covariate that has levels.
    pub(super) covariates: Vec<String>,
    /// Exchangeability blocks, if given.
    pub(super) blocks: Option<Blocks>,
    /// Variance group of each row, if given.
    pub(super) variance_groups: Option<Vec<usize>>,
    /// Reasons to doubt that rows are independent subjects, or that the models of a pair belong to one subject.
    pub(super) warnings: Vec<String>,
}

impl Cli {
    /// Determines the models and the hypothesis from the table, or from the two groups.
    pub(super) fn study(&self) -> Result<Study> {
        if let Some(path) = &self.table {
            return self.study_of_table(path);
        }
        if self.a.is_empty() {
            return Err(Usage::missing("give the models with --a and --b, or with --table").into());
        }
        let (a, b) = (files(&self.a)?, files(&self.b)?);
        distinct(&a, &b)?;
        let (question, of) = if self.paired {
            if a.len() != b.len() {
                bail!("--paired: expected {} models in --b, as in --a, found {}", a.len(), b.len());
            }
            let question = mean_question(a.len(), &[])?;
            (Question { meaning: "mean of a - b".to_owned(), ..question }, "mean")
        } else {
            let levels = std::iter::repeat_n("a", a.len()).chain(std::iter::repeat_n("b", b.len()));
            (question(&Term::Column("group".to_owned(), Column::of(levels)), &[], &[])?, "group")
        };
        let differ = if self.paired { SubjectsDiffer::of(&a, &b) } else { None };
        Ok(Study {
            paths: a.into_iter().chain(b).collect(),
            pairs: self.paired,
            question,
            of: of.to_owned(),
            contrast: false,
            covariates: Vec::new(),
            blocks: None,
            variance_groups: None,
            warnings: differ.iter().map(ToString::to_string).collect(),
        })
    }

    fn study_of_table(&self, path: &Path) -> Result<Study> {
        if self.mean && self.minus.is_none() && self.signal != What::Value {
            return Err(Usage::missing(
                "--mean of surfaces needs --minus, which gives each subject's other model, because the mean \
                 displacement from the group's mean is always zero; to test the values of a signal, give --signal \
                 value",
            )
            .into());
        }
        let table = Table::read(path)?;
        let mut paths = files(&self.models_of(&table, path)?)?;
        let mut differ = None;
        if let Some(minus) = &self.minus {
            let others = files(&self.others_of(&table, minus)?)?;
            distinct(&paths, &others)?;
            differ = SubjectsDiffer::of(&paths, &others);
            paths.extend(others);
        }
        let asked = Asked {
            effect: self.effect.as_deref(),
            levels: &self.levels,
            contrast: &self.contrast,
            covariates: &self.covariates,
            categorical: &self.categorical,
            blocks: self.blocks.as_deref(),
            relative: self.minus.is_none() && self.signal != What::Value,
        };
        if let Some(name) = asked.unused() {
            return Err(Usage::conflict(format!(
                "--categorical {name}: this column is neither in --effect nor in --covariates"
            ))
            .into());
        }
        if self.effect.is_none() && !self.mean {
            return Err(Usage::missing("give --effect, the column of --table to test, or give --mean").into());
        }
        let question = asked.question(&table);
        let question = match question.as_ref().map_err(|error| error.downcast_ref()) {
            Err(Some(ShapeError::MeanOfDisplacements { .. })) => {
                question.context("to test the mean of differences, give each subject's other model with --minus")
            }
            _ => question,
        };
        let mut question = question.with_context(|| path.display().to_string())?;
        if let Some(minus) = &self.minus {
            let first = self.models.as_deref().unwrap_or(Path::new(&self.model_column));
            let of = if self.mean { " of" } else { ", of the differences" };
            question.meaning += &format!("{of} {} - {}", first.display(), minus.display());
        }
        let exchange = if self.whole_blocks { Exchange::Whole } else { Exchange::Within };
        let blocks =
            self.blocks.as_ref().map(|name| anyhow::Ok(Blocks::new(table.cells(name)?, exchange))).transpose()?;
        // Skip the warning about repeated subjects if blocks state which rows depend on each other.
        let repeated = if blocks.is_some() { None } else { repeated(&table, &question.covariates) };
        let warnings = differ.iter().map(ToString::to_string).chain(repeated).collect();
        Ok(Study {
            paths,
            pairs: self.minus.is_some(),
            of: self.effect.clone().unwrap_or_else(|| "mean".to_owned()),
            contrast: !self.contrast.is_empty(),
            covariates: question.covariates.iter().map(with_levels).collect(),
            question,
            blocks,
            variance_groups: self
                .variance_groups
                .as_ref()
                .map(|name| anyhow::Ok(numbered(table.cells(name)?)))
                .transpose()?,
            warnings,
        })
    }

    /// Returns the models of a table's rows: from the column of paths, or by their ids in a folder.
    fn models_of(&self, table: &Table, path: &Path) -> Result<Vec<PathBuf>> {
        if let Some(folder) = &self.models {
            return named(table, folder);
        }
        if !table.has(&self.model_column) && table.has("id") {
            let (table, column) = (path.display(), &self.model_column);
            bail!(
                "{table}: no column {column:?}; if the column \"id\" has the models' names, give their folder as \
                 --models DIR"
            );
        }
        table.paths(&self.model_column)
    }

    /// Returns the models to subtract: from another column of the table, or from another folder.
    fn others_of(&self, table: &Table, minus: &Path) -> Result<Vec<PathBuf>> {
        if self.models.is_some() {
            return named(table, minus);
        }
        table.paths(minus.to_str().with_context(|| format!("--minus: expected a column, found {}", minus.display()))?)
    }
}

impl Study {
    /// Returns the names of the models of each pair; `None` if models aren't pairs.
    pub(super) fn pairs(&self) -> Option<Vec<[String; 2]>> {
        let (first, second) = self.paths.split_at(self.paths.len() / 2);
        self.pairs.then(|| pairs::listed(first, second))
    }

    /// Returns notes on columns of numbers that may be codes of levels, and on columns that are left out of the design.
    pub(super) fn notes(&self) -> Vec<String> {
        let codes = self.question.codes.iter();
        let note = |(column, values): &(String, Vec<f64>)| {
            let steps_by_one = values.windows(2).all(|pair| pair[1] - pair[0] == 1.0);
            let values: Vec<String> = values.iter().map(f64::to_string).collect();
            let sign = if *column == self.of && !self.contrast && values.len() == 2 && steps_by_one {
                format!("the effect is {} minus {}; ", values[1], values[0])
            } else {
                String::new()
            };
            format!(
                "{column}: the numbers {} are treated as quantities, with one slope; {sign}to treat them as levels, \
                 give --categorical {column}",
                values.join(", ")
            )
        };
        let contained = self.question.contained().into_iter().map(|[name, other]| {
            format!("{name} is left out of the design, because the effects of {other} already contain its effect")
        });
        codes.map(note).chain(contained).collect()
    }
}

/// Returns the path `DIR/ID.spharm.npz` for each row.
fn named(table: &Table, folder: &Path) -> Result<Vec<PathBuf>> {
    let file = |id: &str| with_ending(&folder.join(id), "spharm.npz");
    Ok(table.different("id")?.into_iter().map(file).collect())
}

/// Refuses a model that occurs in both lists or twice in one list, even if its paths are written differently.
fn distinct(a: &[PathBuf], b: &[PathBuf]) -> Result<()> {
    let place = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone());
    let first: HashSet<PathBuf> = a.iter().map(place).collect();
    if let Some(both) = b.iter().find(|path| first.contains(&place(path))) {
        bail!("{}: the model is in both groups", both.display());
    }
    for group in [a, b] {
        let mut seen = HashSet::new();
        if let Some(twice) = group.iter().find(|path| !seen.insert(place(path))) {
            bail!("{}: the model is in the same group twice", twice.display());
        }
    }
    Ok(())
}

/// Names of columns that identify subjects, in lowercase and without `_`, `-`, `.` and spaces.
const SUBJECTS: [&str; 16] = [
    "id",
    "pid",
    "participant",
    "participantid",
    "subject",
    "subjectid",
    "subjectlabel",
    "subj",
    "subjid",
    "sub",
    "subid",
    "ptid",
    "rid",
    "patientid",
    "childid",
    "animalid",
];

/// Names of columns that identify either subjects or groups. For example, a column `case` has either ids or yes and no.
const SUBJECTS_OR_GROUPS: [&str; 7] = ["patient", "child", "animal", "case", "caseid", "person", "individual"];

/// A column named in [`SUBJECTS_OR_GROUPS`] identifies subjects only if it has at least this number of different
/// values.
const FEWEST_SUBJECTS: usize = 5;
/// A column named in [`SUBJECTS_OR_GROUPS`] identifies subjects only if each of its values has at most this number of
/// rows on average. Groups, such as species in a column `animal`, have more rows per value.
const MOST_ROWS: usize = 4;

/// Returns whether a column with this name and these cells identifies subjects.
fn are_subjects<'a>(name: &str, cells: impl Iterator<Item = &'a str>) -> bool {
    let name: String = name.to_lowercase().chars().filter(|c| !matches!(c, '_' | '-' | '.' | ' ')).collect();
    if SUBJECTS.contains(&name.as_str()) {
        return true;
    }
    let cells: Vec<&str> = cells.collect();
    let different = cells.iter().collect::<HashSet<_>>().len();
    SUBJECTS_OR_GROUPS.contains(&name.as_str()) && different >= FEWEST_SUBJECTS && cells.len() <= MOST_ROWS * different
}

/// Returns a warning about subjects with several rows, unless a covariate identifies the subjects.
fn repeated(table: &Table, covariates: &[Term]) -> Option<String> {
    let identifies = |term: &Term| match term {
        Term::Column(name, Column::Levels(levels)) => are_subjects(name, levels.iter().map(String::as_str)),
        _ => false,
    };
    if covariates.iter().any(identifies) {
        return None;
    }
    table.names().find_map(|name| {
        let cells = table.cells(name).ok().filter(|cells| are_subjects(name, cells.iter().copied()))?;
        let mut seen = HashSet::new();
        let twice: HashSet<&str> = cells.iter().copied().filter(|cell| !seen.insert(*cell)).collect();
        let first = cells.iter().find(|cell| twice.contains(*cell))?;
        Some(format!(
            "{} of {} subjects {} more than one row ({name} {first} has {}), but the test assumes independent rows, so p \
             values are too small; test the differences between two models of each subject (--minus), or, for an effect \
             within subjects that is equal in all of them, add the subjects as a covariate (--covariates {name} \
             --categorical {name}); if the effect differs between subjects, compute a slope for each subject and test the \
             slopes",
            twice.len(),
            seen.len(),
            if twice.len() == 1 { "has" } else { "have" },
            cells.iter().filter(|cell| *cell == first).count(),
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::are_subjects;

    #[test]
    fn columns_of_groups_are_not_taken_for_subjects() {
        let cells = |levels: usize, each: usize| ["a", "b", "c", "d", "e"][..levels].repeat(each);
        let found = |name, levels, each| are_subjects(name, cells(levels, each).into_iter());
        assert!(found("Animal ID", 2, 9) && found("subject", 5, 9));
        // Five species of eight animals each, and five animals of four scans each.
        assert!(!found("animal", 5, 8) && found("animal", 5, 4) && !found("case", 2, 2));
    }
}
