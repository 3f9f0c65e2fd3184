//! `shape test`: groups and covariates at every vertex of a common sampling.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use serde_json::json;
use spharm::shape::stats::{Column, PermutationParams, Question, Statistic, Test, TestParams, question, test};
use spharm::shape::{Measurement, measure_group};
use spharm::{Kind, Sphere};
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::inputs::read_sphere;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::with_ending;
use spharm_cli::{Usage, output::check_outputs};
use spharm_surface::io::{Output, WriteOptions, write_mesh, write_signal};
use spharm_surface::{Mesh, Signal};

use super::args::{ReportArgs, Resources, files};
use super::groups::read_group;
use super::outputs::{csv, finish, number, write_text};
use super::plan::Plan;
use super::table::Table;

/// Test groups and covariates at every vertex
///
/// Two groups of models, --a and --b, or a table of subjects with an --effect and --covariates. Surfaces have to correspond
/// (`spharm shape align --group`, or spheres that share their parameters). At each vertex of the sampling a linear model is
/// tested: t, F, or Hotelling's T-squared for positions. Family-wise p values are of the largest statistic over relabelled
/// studies: all of them where there are at most 20,000.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape test --a @patients.txt --b @controls.txt -o test",
        "spharm shape test --table study.csv --effect group --covariates age,sex -o test",
        "spharm shape test --table subjects.csv --models aligned --effect group -o test",
        "spharm shape test --table study.csv --effect age --signal position --permutations 50000 -o test",
        "spharm shape test --a thick/a* --b thick/b* --signal value --welch -o test",
    ],
    &[
        "The folder gets mean.surf.gii and, as NAME.shape.gii, statistic, p, q (false-discovery rate), p-fwe (family-wise), \
         p-permutation (by relabelling, uncorrected), effect, its margin of confidence, and size; all of it in test.csv, and in \
         test.json what was tested.",
        "A table has a column `model` with paths relative to it, or a column `id` and --models, and a column for each variable: \
         numbers, or levels.",
    ],
))]
pub(super) struct Cli {
    /// Models of the first group
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "b", conflicts_with = "table", help_heading = INPUT)]
    a: Vec<PathBuf>,
    /// Models of the second group
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "a", help_heading = INPUT)]
    b: Vec<PathBuf>,
    /// Table of subjects, CSV or TSV
    #[arg(long, value_name = "FILE", requires = "effect", help_heading = INPUT)]
    table: Option<PathBuf>,
    /// Column of the table with the models' paths
    #[arg(long, value_name = "COLUMN", default_value = "model", help_heading = INPUT)]
    model_column: String,
    /// Folder of the models, named by the table's column `id`: ID.spharm.npz
    #[arg(long, value_name = "DIR", requires = "table", conflicts_with = "model_column", help_heading = INPUT)]
    models: Option<PathBuf>,
    /// Column of the table to test: the slope of numbers, the difference of levels
    #[arg(long, value_name = "COLUMN", requires = "table", help_heading = METHOD)]
    effect: Option<String>,
    /// Order of the effect's levels, which may be numbers: the difference is the first less the second [default: sorted]
    #[arg(long, value_name = "LEVELS", value_delimiter = ',', requires = "effect", help_heading = METHOD)]
    levels: Vec<String>,
    /// Columns of the table to account for
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', requires = "table", help_heading = METHOD)]
    covariates: Vec<String>,
    /// What is measured at a vertex: displacement along the mean's normal, position, or the value of a signal
    #[arg(long, value_enum, default_value_t = What::Normal, help_heading = METHOD)]
    signal: What,
    /// Welch's t, for groups of unequal variance
    #[arg(long, help_heading = METHOD)]
    welch: bool,
    /// Random relabellings; 0 for none
    #[arg(long, value_name = "N", default_value_t = 10_000, help_heading = METHOD)]
    permutations: usize,
    /// Seed of the relabellings
    #[arg(long, value_name = "SEED", default_value_t = 0, help_heading = METHOD)]
    seed: u64,
    /// Level of significance, for the summary and warnings
    #[arg(long, value_name = "ALPHA", default_value_t = 0.05, help_heading = METHOD)]
    level: f64,
    /// Highest degree to use [default: the lowest of the models']
    #[arg(long, value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Test at the vertices of a sphere mesh
    #[arg(long, value_name = "SPHERE", conflicts_with = "icosphere", help_heading = METHOD)]
    sphere: Option<PathBuf>,
    /// Test at the vertices of an icosphere of N subdivisions
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(0..=9), help_heading = METHOD)]
    icosphere: u32,
    /// Folder to write to
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    Normal,
    Position,
    Value,
}

/// Models and what is asked of them.
struct Study {
    paths: Vec<PathBuf>,
    question: Question,
    /// The names of the covariates, with the number of their levels where they have any.
    covariates: Vec<String>,
}

impl Cli {
    fn study(&self) -> Result<Study> {
        if let (Some(path), Some(effect)) = (&self.table, &self.effect) {
            let table = Table::read(path)?;
            let paths = files(&self.models_of(&table, path)?)?;
            let covariates = self.covariates.iter().map(|name| Ok((name.clone(), table.column(name)?)));
            let covariates = covariates.collect::<Result<Vec<_>>>()?;
            // With levels named, numbers are levels.
            let column = if self.levels.is_empty() { table.column(effect)? } else { table.levels(effect)? };
            let question = question((effect, &column), &self.levels, &covariates);
            let question = question.with_context(|| path.display().to_string())?;
            return Ok(Study { paths, question, covariates: covariates.iter().map(with_levels).collect() });
        }
        if self.a.is_empty() {
            return Err(Usage::missing("--a and --b, or --table, name the models").into());
        }
        let (a, b) = (files(&self.a)?, files(&self.b)?);
        if let Some(both) = a.iter().find(|path| b.contains(path)) {
            bail!("{}: it is in both groups", both.display());
        }
        let levels = std::iter::repeat_n("a", a.len()).chain(std::iter::repeat_n("b", b.len()));
        let question = question(("group", &Column::of(levels)), &[], &[])?;
        Ok(Study { paths: a.into_iter().chain(b).collect(), question, covariates: Vec::new() })
    }

    /// The models of a table's rows: by their paths, or by their names in a folder.
    fn models_of(&self, table: &Table, path: &Path) -> Result<Vec<PathBuf>> {
        if let Some(folder) = &self.models {
            let file = |id: &str| with_ending(&folder.join(id), "spharm.npz");
            return Ok(table.different("id")?.into_iter().map(file).collect());
        }
        if !table.has(&self.model_column) && table.has("id") {
            let (table, column) = (path.display(), &self.model_column);
            bail!(
                "{table}: there is no column {column:?}; --models DIR names the folder of the models by the column \"id\""
            );
        }
        table.paths(&self.model_column)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.output.join(name)
    }
}

/// A covariate's name; with the number of its levels where it was taken as such.
fn with_levels((name, column): &(String, Column)) -> String {
    match column {
        Column::Levels(levels) => format!("{name} ({} levels)", levels.iter().collect::<HashSet<_>>().len()),
        Column::Numbers(_) => name.clone(),
    }
}

/// Maps that are written, by name.
fn maps(found: &Test) -> Vec<(&'static str, Vec<f64>)> {
    let mut maps = vec![("statistic", found.statistic.clone()), ("p", found.p.clone()), ("q", found.q.clone())];
    if let Some(family_wise) = &found.family_wise {
        maps.push(("p-fwe", family_wise.p.clone()));
        maps.push(("p-permutation", family_wise.pointwise.clone()));
    }
    if let Some(effect) = &found.effect {
        let names: &[[&str; 2]] = match effect.estimate.ncols() {
            1 => &[["effect", "margin"]],
            _ => &[["effect-x", "margin-x"], ["effect-y", "margin-y"], ["effect-z", "margin-z"]],
        };
        for (column, [name, margin]) in names.iter().enumerate() {
            maps.push((name, effect.estimate.column(column).to_vec()));
            maps.push((margin, effect.margin.column(column).to_vec()));
        }
        let size = effect.size.iter().map(|size| if size.is_nan() { 0.0 } else { *size });
        maps.push(("size", size.collect()));
    }
    maps
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let console = monitor.console();
    let Study { paths, question, covariates } = cli.study()?;
    let (kind, measurement) = match cli.signal {
        What::Normal => (Kind::Surface, Measurement::Normal),
        What::Position => (Kind::Surface, Measurement::Position),
        What::Value => (Kind::Signal, Measurement::Value),
    };
    let known = ["statistic", "p", "q", "p-fwe", "p-permutation", "effect", "margin", "size"];
    let about_file = cli.file("test.json");
    let map_files: Vec<PathBuf> = known.iter().map(|name| cli.file(&format!("{name}.shape.gii"))).collect();
    let mean_file = cli.file("mean.surf.gii");
    let table_file = cli.file("test.csv");
    let maps_out = map_files.iter().map(|path| OutputFile::holding(path, "--output", Output::Signal));
    let more = [
        OutputFile::new(&mean_file, "--output"),
        OutputFile::new(&table_file, "--output"),
        OutputFile::new(&about_file, "--output"),
    ];
    let of_report = cli.report.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    check_outputs(maps_out.chain(more).chain(of_report), cli.report.force)?;
    let plan = Plan::new("test", &paths, cli.resources.both())?;
    let sphere = match &cli.sphere {
        Some(path) => {
            plan.budget.check_inputs("shape test", [path.as_path()])?;
            Some(read_sphere(path, false, console)?)
        }
        None => None,
    };
    let components = if cli.signal == What::Position { 3 } else { 1 };
    let of = |vertices: u64| plan.group.test(vertices, components, cli.permutations, plan.threads);
    let needed =
        |[vertices, faces]: [u64; 2]| plan.coefficients().saturating_add(of(vertices)) + 24 * (vertices + faces);
    let icosphere = sphere.is_none().then_some(cli.icosphere);
    plan.check_sampling(icosphere, plan.sampling(icosphere, sphere.as_ref()), needed)?;
    let sphere = match sphere {
        Some(sphere) => sphere,
        None => Sphere::icosphere(cli.icosphere),
    };
    let permutations = PermutationParams { count: cli.permutations, seed: cli.seed, ..PermutationParams::default() };
    let params = TestParams {
        permutations: (cli.permutations > 0).then_some(permutations),
        welch: cli.welch,
        level: cli.level,
        ..TestParams::default()
    };
    let (group, field, found) = cli.resources.threads.pool()?.install(|| -> Result<_> {
        let group = read_group(&paths, kind, cli.max_degree, monitor, console)?;
        let field = measure_group(&group.members, &sphere.directions, measurement, monitor)?;
        let (design, contrast) = (&question.design, &question.contrast);
        let found = test(field.values.view(), field.components, design, contrast, &params, monitor)?;
        Ok((group, field, found))
    })?;
    let mut warnings = group.warnings.clone();
    for warning in &found.warnings {
        console.warn(warning);
        warnings.push(warning.to_string());
    }
    let options = WriteOptions { overwrite: cli.report.force, double: false };
    let maps = maps(&found);
    prepare(&table_file)?;
    for (name, values) in &maps {
        let signal = Signal::new(values.clone(), values.len(), 1);
        write_signal(cli.file(&format!("{name}.shape.gii")), &signal, &options)?;
    }
    if kind == Kind::Surface && !sphere.faces.is_empty() {
        let mean = spharm::Model::without_sphere(field.mean.clone(), Kind::Surface);
        let mesh: Mesh = mean.reconstruct(&sphere, group.degree)?;
        write_mesh(&mean_file, &mesh, &options)?;
    }
    write_text(&table_file, cli.report.force, &table(&sphere, &maps))?;
    write_text(
        &about_file,
        cli.report.force,
        &(serde_json::to_string_pretty(&about(&found, &question, &covariates, cli))? + "\n"),
    )?;
    let report = json!({
        "models": paths,
        "degree": group.degree,
        "meaning": question.meaning,
        "levels": question.levels.iter().map(|(level, count)| json!({ "level": level, "subjects": count })).collect::<Vec<_>>(),
        "design": { "columns": question.design.names(), "rows": rows_of(question.design.matrix()) },
        "contrast": rows_of(question.contrast.weights.view()),
        "statistic": kind_of(&found.kind),
        "vertices": found.p.len(),
        "relabellings": found.family_wise.as_ref().map(|found| found.relabellings),
        "exact": found.family_wise.as_ref().map(|found| found.exact),
        "smallest_p_possible": found.family_wise.as_ref().map(|found| found.floor),
        "seed": cli.seed,
        "summary": summary(&found, cli.level),
        "folder": cli.output,
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("test", &report, &lines(&found, &question, &covariates, cli), &cli.report)
}

/// What was tested, for pages: the same for the same study, whenever and wherever it is run.
fn about(found: &Test, question: &Question, covariates: &[String], cli: &Cli) -> serde_json::Value {
    let levels = question.levels.iter().map(|(level, count)| json!({ "level": level, "subjects": count }));
    json!({
        "tested": question.meaning,
        "of": cli.effect.as_deref().unwrap_or("group"),
        "signal": cli.signal.to_possible_value().map(|value| value.get_name().to_owned()),
        "subjects": question.design.subjects(),
        "levels": levels.collect::<Vec<_>>(),
        "covariates": covariates,
        "statistic": kind_of(&found.kind),
        "welch": cli.welch,
        "relabellings": found.family_wise.as_ref().map(|found| found.relabellings),
        "exact": found.family_wise.as_ref().map(|found| found.exact),
        "level": cli.level,
        "warnings": found.warnings.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

fn rows_of(matrix: ndarray::ArrayView2<'_, f64>) -> Vec<Vec<f64>> {
    matrix.rows().into_iter().map(|row| row.to_vec()).collect()
}

fn kind_of(kind: &Statistic) -> serde_json::Value {
    match *kind {
        Statistic::T { freedom } => json!({ "name": "t", "freedom": freedom }),
        Statistic::F { between, within } => json!({ "name": "F", "freedom": [between, within] }),
        Statistic::TSquared { components, freedom } => {
            json!({ "name": "T2", "components": components, "freedom": freedom })
        }
        _ => serde_json::Value::Null,
    }
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn below(values: &[f64], level: f64) -> usize {
    values.iter().filter(|p| **p <= level).count()
}

fn summary(found: &Test, level: f64) -> serde_json::Value {
    let of = |values: &[f64]| json!({ "least": least(values), "vertices": below(values, level) });
    json!({
        "level": level,
        "largest": found.statistic.iter().fold(0.0_f64, |most, value| most.max(value.abs())),
        "p": of(&found.p),
        "q": of(&found.q),
        "p_fwe": found.family_wise.as_ref().map(|found| of(&found.p)),
    })
}

fn lines(found: &Test, question: &Question, covariates: &[String], cli: &Cli) -> Vec<Vec<String>> {
    let pair = |name: &str, value: String| vec![name.to_owned(), value];
    let largest = found.statistic.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let (name, freedom) = match found.kind {
        Statistic::T { freedom } => ("|t|", format!("{freedom:.4}")),
        Statistic::F { between, within } => ("F", format!("{between:.0}, {within:.0}")),
        Statistic::TSquared { freedom, .. } => ("T-squared", format!("{freedom:.0}")),
        _ => ("statistic", String::new()),
    };
    let count = |values: &[f64]| {
        let share = below(values, cli.level);
        format!("{:.4e}; {share} of {} vertices at most {}", least(values), values.len(), cli.level)
    };
    let mut lines = vec![
        pair("tested", question.meaning.clone()),
        pair("accounted for", if covariates.is_empty() { "nothing".to_owned() } else { covariates.join(", ") }),
        pair("subjects", question.design.subjects().to_string()),
        pair(&format!("largest {name}"), format!("{largest:.6}, {freedom} degrees of freedom")),
        pair("least p", count(&found.p)),
        pair("least q", count(&found.q)),
    ];
    if let Some(family_wise) = &found.family_wise {
        let which = if family_wise.exact { "all of them" } else { "random" };
        lines.push(pair("relabellings", format!("{}, {which}", family_wise.relabellings)));
        lines.push(pair("least family-wise p", count(&family_wise.p)));
    }
    lines.push(pair("maps", cli.output.display().to_string()));
    lines
}

fn table(sphere: &Sphere, maps: &[(&str, Vec<f64>)]) -> String {
    let header: Vec<&str> =
        ["vertex", "ux", "uy", "uz"].into_iter().chain(maps.iter().map(|(name, _)| *name)).collect();
    let rows: Vec<Vec<String>> = sphere
        .directions
        .as_slice()
        .iter()
        .enumerate()
        .map(|(v, u)| {
            let numbers = u.iter().copied().chain(maps.iter().map(|(_, values)| values[v])).map(number);
            std::iter::once(v.to_string()).chain(numbers).collect()
        })
        .collect();
    csv(&header, rows.iter().map(Vec::as_slice))
}
