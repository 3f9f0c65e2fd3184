//! Tests further measures of the subjects, such as volumes and scores, with the design of the test at vertices. Writes
//! a table for a paper: numbers of subjects, means, standard deviations, effects, p values.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use ndarray::{Array2, ArrayView1};
use serde_json::{Value, json};
use spharm::Monitor;
use spharm::shape::stats::{Test, TestParams, test};
use spharm_cli::paths::model_name;
use spharm_monitor::number;

use super::super::measure::COLUMNS;
use super::super::outputs::{csv, short};
use super::super::table::{Table, finite, rows_of};
use super::args::Source;
use super::question::Study;

/// Measures of all subjects.
pub(super) struct Measures {
    names: Vec<String>,
    /// Unit of each measure, as [`unit`] returns it.
    units: Vec<&'static str>,
    /// Values of the measures, an array of shape (subjects, measures).
    values: Array2<f64>,
}

impl Measures {
    /// Reads the measures of the subjects of a test. For pairs, computes the differences, first minus second. Columns
    /// of text and columns of equal numbers are skipped unless they are named. Unnamed columns in which some numbers
    /// are missing are skipped with a warning through `warn`.
    ///
    /// # Errors
    ///
    /// If a subject has no row, or a named column has a cell that isn't a number.
    pub(super) fn of(study: &Study, sources: &[Source], warn: &dyn Fn(String)) -> Result<Self> {
        let count = study.paths.len() / if study.pairs { 2 } else { 1 };
        let (first, second) = study.paths.split_at(count);
        let mut found = Read::of(sources, first, warn)?;
        if study.pairs {
            let second = Read::of(sources, second, warn)?;
            found.columns.retain(|column| second.columns.iter().any(|other| other.name == column.name));
            for column in &mut found.columns {
                let other = second.columns.iter().find(|other| other.name == column.name);
                let pairs = column.values.iter_mut().zip(other.into_iter().flat_map(|other| &other.values));
                pairs.for_each(|(value, other)| *value -= other);
            }
        }
        found.columns.retain(|column| column.named || column.values.iter().any(|value| *value != column.values[0]));
        if found.columns.is_empty() {
            bail!("--measures: expected a column of numbers that differ between subjects, found none");
        }
        let (rows, columns) = (count, found.columns.len());
        let values = Array2::from_shape_fn((rows, columns), |(row, column)| found.columns[column].values[row]);
        let (names, units) = found.columns.into_iter().map(|column| (column.name, column.unit)).unzip();
        Ok(Self { names, units, values })
    }

    /// Tests the measures.
    pub(super) fn test(self, study: &Study, params: &TestParams, monitor: &dyn Monitor) -> Result<Tested> {
        let params = TestParams { spatial: None, ..params.clone() };
        let (design, contrast) = (&study.question.design, &study.question.contrast);
        let found = test(self.values.view(), 1, design, contrast, &params, monitor)?;
        let levels = study.question.levels.iter().map(|(level, _)| level.clone()).collect();
        Ok(Tested { measures: self, found, levels, groups: study.question.level_of.clone() })
    }
}

/// Columns of measures as read from tables.
struct Read {
    columns: Vec<Numbers>,
}

/// A column of numbers.
struct Numbers {
    name: String,
    unit: &'static str,
    /// Whether the user named the column.
    named: bool,
    values: Vec<f64>,
}

impl Read {
    /// Reads the measures of the subjects to whom `models` belong. A table's first column has the models' names or
    /// paths.
    fn of(sources: &[Source], models: &[PathBuf], warn: &dyn Fn(String)) -> Result<Self> {
        let mut columns: Vec<Numbers> = Vec::new();
        for (path, wanted) in sources {
            let table = Table::read(path)?;
            let key = table.names().next().unwrap_or_default().to_owned();
            let order = rows_of(table.different(&key)?, models)
                .with_context(|| format!("{}: column {key:?}", path.display()))?;
            let all: Vec<String> = table.names().skip(1).map(str::to_owned).collect();
            for name in if wanted.is_empty() { &all } else { wanted } {
                let cells = table.texts(name)?;
                let number = |row: &usize| finite(cells[*row]);
                let values: Vec<f64> = order.iter().filter_map(number).collect();
                if let Some(at) = order.iter().position(|row| number(row).is_none()) {
                    let text = format!(
                        "{}: measure {name:?}: expected a number for {}, found {:?}",
                        path.display(),
                        model_name(&models[at]),
                        cells[order[at]]
                    );
                    match (wanted.is_empty(), values.is_empty()) {
                        (false, _) => bail!("{text}; exclude the subject or the measure"),
                        (true, true) => continue,
                        (true, false) => {
                            warn(format!("{text}; the measure is skipped"));
                            continue;
                        }
                    }
                }
                if columns.iter().any(|other| other.name == *name) {
                    bail!("{}: the measure {name:?} is also in another table", path.display());
                }
                let unit = unit(&table, name);
                columns.push(Numbers { name: name.clone(), unit, named: !wanted.is_empty(), values });
            }
        }
        Ok(Self { columns })
    }
}

/// Returns the unit of a column in a table of `shape measure` or `shape pca --scores`: 1, or a power of `length`. The
/// word `length` means the models' unit, which models don't record. Returns an empty text for other tables, because
/// their units aren't known.
fn unit(table: &Table, column: &str) -> &'static str {
    let measured = COLUMNS.iter().all(|name| table.has(name));
    let scores = table.names().skip(1).enumerate().all(|(at, name)| name == format!("mode_{}", at + 1));
    match column {
        "area" if measured => "length^2",
        "volume" if measured => "length^3",
        "centroid_x" | "centroid_y" | "centroid_z" if measured => "length",
        _ if measured && COLUMNS.contains(&column) => "1",
        _ if scores => "length",
        _ => "",
    }
}

/// Measures, with the results of testing them.
pub(super) struct Tested {
    measures: Measures,
    found: Test,
    /// Levels of the tested column, in the order in which they are subtracted.
    levels: Vec<String>,
    /// Level of each subject; empty if the tested column has no levels.
    groups: Vec<String>,
}

/// Number, mean and standard deviation of some values.
struct Spread {
    count: usize,
    mean: f64,
    deviation: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let count = values.clone().count();
        let mean = values.clone().sum::<f64>() / count as f64;
        let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
        let deviation = (squares / (count as f64 - 1.0)).sqrt();
        // Replace a mean that is zero up to rounding, such as the mean of scores along modes, by zero.
        let mean = if mean.abs() < 1e-12 * deviation { 0.0 } else { mean };
        Self { count, mean, deviation }
    }
}

impl Tested {
    fn of_level(&self, values: ArrayView1<'_, f64>, level: &str) -> Spread {
        let of = values.iter().zip(&self.groups).filter(|(_, group)| *group == level);
        Spread::of(of.map(|(value, _)| *value))
    }

    /// Returns the estimate of a measure's effect and the limits of its confidence interval; `None` for several
    /// contrasts.
    fn effect(&self, at: usize) -> Option<[f64; 3]> {
        let effect = self.found.effect.as_ref()?;
        let (estimate, margin) = (effect.estimate[[at, 0]], effect.margin[[at, 0]]);
        Some([estimate, estimate - margin, estimate + margin])
    }

    fn size(&self, at: usize) -> Option<f64> {
        self.found.effect.as_ref().map(|effect| effect.size[at])
    }

    fn family_wise(&self, at: usize) -> Option<f64> {
        self.found.family_wise.as_ref().map(|found| found.p[at])
    }

    /// Returns the table as text, with a row for each measure.
    pub(super) fn table(&self) -> String {
        let own = |level: &String| ["n", "mean", "sd"].map(|name| format!("{name} {level}"));
        let mut header: Vec<String> = ["measure", "n", "mean", "sd"].map(str::to_owned).to_vec();
        header.extend(self.levels.iter().flat_map(own));
        let of_effect = ["effect", "low", "high", "size"];
        let columns = of_effect.into_iter().filter(|_| self.found.effect.is_some()).chain(["statistic", "p", "q"]);
        let columns = columns.chain(self.found.family_wise.as_ref().map(|_| "p-fwe")).chain(["unit"]);
        header.extend(columns.map(str::to_owned));
        let row = |at: usize| -> Vec<String> {
            let values = self.measures.values.column(at);
            let cells = |spread: Spread| [spread.count.to_string(), short(spread.mean), short(spread.deviation)];
            let mut row = vec![self.measures.names[at].clone()];
            row.extend(cells(Spread::of(values.iter().copied())));
            row.extend(self.levels.iter().flat_map(|level| cells(self.of_level(values, level))));
            row.extend(self.effect(at).into_iter().flatten().chain(self.size(at)).map(short));
            let tested = [self.found.statistic[at], self.found.p[at], self.found.q[at]];
            row.extend(tested.into_iter().chain(self.family_wise(at)).map(short));
            row.push(self.measures.units[at].to_owned());
            row
        };
        let rows: Vec<Vec<String>> = (0..self.measures.names.len()).map(row).collect();
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        csv(&header, rows.iter().map(Vec::as_slice))
    }

    /// Returns the measures as JSON.
    pub(super) fn report(&self) -> Value {
        let of = |at: usize| {
            let values = self.measures.values.column(at);
            let spread = |of: Spread| json!({ "n": of.count, "mean": of.mean, "sd": of.deviation });
            let levels = self.levels.iter().map(|level| (level.clone(), spread(self.of_level(values, level))));
            json!({
                "measure": self.measures.names[at],
                "all": spread(Spread::of(values.iter().copied())),
                "levels": levels.collect::<serde_json::Map<_, _>>(),
                "effect": self.effect(at).map(|[estimate, low, high]| json!({ "estimate": estimate, "interval": [low, high] })),
                "size": self.size(at),
                "statistic": self.found.statistic[at],
                "p": self.found.p[at],
                "q": self.found.q[at],
                "p_fwe": self.family_wise(at),
            })
        };
        (0..self.measures.names.len()).map(of).collect()
    }

    /// Returns the rows of the printed table, one for each measure.
    pub(super) fn lines(&self) -> Vec<Vec<String>> {
        let line = |at: usize| {
            let effect = self
                .effect(at)
                .map(|[estimate, low, high]| format!("{} ({} to {}), ", number(estimate), number(low), number(high)));
            let [p, q] = [self.found.p[at], self.found.q[at]].map(number);
            let family_wise = self.family_wise(at).map(|p| format!(", p-fwe {}", number(p))).unwrap_or_default();
            vec![self.measures.names[at].clone(), format!("{}p {p}, q {q}{family_wise}", effect.unwrap_or_default())]
        };
        (0..self.measures.names.len()).map(line).collect()
    }
}
