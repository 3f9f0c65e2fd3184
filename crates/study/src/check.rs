//! Checks a study's settings and table before the subjects are fitted, because fitting takes a long time.

use std::collections::HashSet;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use spharm::parametrize::volume::is_volume;
use spharm::shape::stats::{self, TestParams};
use spharm::{Model, read_sphere};
use spharm_cli::output::{counted, first_of};
use spharm_cohort::{Manifest, Row};
use spharm_surface::generate::icosphere_counts;
use spharm_surface::io::read_annotation;
use spharm_surface::{Hemisphere, Sphere};

use super::call::LEAST;
use super::config::Method;
use super::plan::{Plan, Subject};
use super::test::Test;
use super::{emptied, sides, voxels};
use spharm_analysis::Poses;
use spharm_analysis::SUBDIVISIONS;
use spharm_analysis::masks;
use spharm_analysis::table::{Subjects, is_missing};

/// Maximum number of subjects named in a warning.
const NAMED: usize = 6;

/// Refuses a study that would fail after its fits, or give misleading results.
///
/// # Errors
///
/// The error names the cause: the file and its key, or the table with the line and the column.
pub(super) fn check(plan: &Plan) -> Result<()> {
    let rows = plan.manifest.rows.len();
    if rows < LEAST {
        let without = match plan.excluded.len() {
            0 => String::new(),
            count => format!(" ({} excluded)", counted(count, "subject")),
        };
        bail!("{}: expected {LEAST} subjects or more, found {rows}{without}", plan.table.display());
    }
    correspondence(plan)?;
    for test in &plan.study.test {
        tested(plan, test).with_context(|| format!("{}: test {:?}", plan.file.display(), test.name))?;
    }
    Ok(())
}

/// Checks that the alignment method suits the subjects: surfaces that were mapped individually don't correspond, and
/// must be aligned by `correspond` or `joint`.
fn correspondence(plan: &Plan) -> Result<()> {
    if plan.signal_fits().is_some() && !matches!(plan.method, Method::Fixed | Method::None) {
        bail!(
            "{}: `signal` in [subjects] needs spheres that correspond, such as FreeSurfer's sphere.reg: give `sphere`, \
             and method \"fixed\" or \"none\" in [align]; found method {:?}",
            plan.file.display(),
            plan.method.name()
        );
    }
    if plan.has_sides() && plan.method == Method::None {
        bail!(
            "{}: `sides` in [subjects]: the second side is mirrored and has to be aligned; expected a method other \
             than \"none\" in [align]",
            plan.file.display()
        );
    }
    if plan.method == Method::Correspond {
        return of_group(plan);
    }
    if plan.study.subjects.landmarks.is_some() {
        bail!(
            "{}: `landmarks` in [subjects] needs method \"correspond\" in [align], found {:?}",
            plan.file.display(),
            plan.method.name()
        );
    }
    if plan.study.align.pose != Poses::Any {
        bail!("{}: `pose` in [align] needs method \"correspond\", found {:?}", plan.file.display(), plan.method.name());
    }
    if !plan.study.align.signals.is_empty() {
        bail!(
            "{}: `signals` in [align] needs method \"correspond\", found {:?}",
            plan.file.display(),
            plan.method.name()
        );
    }
    let without = plan.manifest.rows.iter().find(|row| row.sphere.is_none());
    match without.filter(|_| plan.method != Method::Joint && !plan.has_one_sphere()) {
        None => Ok(()),
        Some(row) => bail!(
            "{}: method {:?} in [align] needs spheres that correspond, but {} has no sphere for {}; give `sphere`, or \
             method \"correspond\"",
            plan.file.display(),
            plan.method.name(),
            plan.table.display(),
            row.id
        ),
    }
}

/// Checks a study whose method is `correspond`. Refuses ids that can't be file names in the group's folder, and files
/// of landmarks and signals that don't exist.
fn of_group(plan: &Plan) -> Result<()> {
    if plan.study.align.guide && plan.landmarks.is_none() {
        bail!("{}: `guide` in [align] needs `landmarks` in [subjects], found none", plan.file.display());
    }
    if let Some(row) = plan.manifest.rows.iter().find(|row| row.id == "mean" || row.id.starts_with('.')) {
        bail!(
            "{}: line {}: expected an id other than `mean` that doesn't begin with a dot, found {:?}; change the id, \
             or give method \"joint\" in [align]",
            plan.table.display(),
            row.line,
            row.id
        );
    }
    let marks = plan.landmarks.iter().flatten().zip(&plan.manifest.rows).map(|(file, row)| ("landmarks", file, row));
    let rows = plan.guides.iter().zip(&plan.manifest.rows);
    let signals = rows.flat_map(|(files, row)| files.iter().map(move |file| ("a signal", file, row)));
    match marks.chain(signals).find(|(_, file, _)| !file.is_file()) {
        Some((what, file, row)) => bail!("{}: {what} of {}: no such file", file.display(), row.id),
        None => Ok(()),
    }
}

/// Checks that the design of a test suits the table of all subjects.
fn tested(plan: &Plan, test: &Test) -> Result<()> {
    if test.is_of_values() && plan.signal_fits().is_none() {
        bail!(
            "signal: \"value\" needs `signal` in [subjects], which names the file of each subject's values; found none"
        );
    }
    sampling(plan, test)?;
    let rows = Rows::of(plan, test, &|_| true);
    emptied::check(plan, test, &rows.rows, &[])?;
    if rows.rows.len() < LEAST {
        bail!("expected {LEAST} subjects or more with {}, found {}", of_side(test), rows.rows.len());
    }
    designed(plan, test, &rows).map(drop)
}

/// Checks that the design of a test suits `rows`, the rows of some subjects. Returns the level of each subject.
fn designed(plan: &Plan, test: &Test, rows: &Rows<'_>) -> Result<Vec<String>> {
    let question = test.asked().question(rows).with_context(|| plan.table.display().to_string())?;
    let components = if test.signal.as_deref() == Some("position") { 3 } else { 1 };
    let params = TestParams { welch: test.welch, ..TestParams::default() };
    if test.welch && (question.levels.len() != 2 || !question.covariates.is_empty()) {
        bail!("welch: expected two groups and no covariates; omit `welch` for other tests");
    }
    stats::check(components, &question.design, &question.contrast, &params)
        .with_context(|| plan.table.display().to_string())?;
    Ok(question.level_of)
}

/// Checks the tests again, applied to the subjects that could be fitted. `failed` lists the subjects that couldn't be
/// fitted, with the reasons. Returns warnings about subjects with only one fitted side, exchanged sides, and groups
/// with voxels of different sizes.
///
/// # Errors
///
/// If too few subjects are left for a test, or a group has no subjects left.
pub(super) fn fitted(plan: &Plan, subjects: &[Subject<'_>], failed: &[(String, String)]) -> Result<Vec<String>> {
    let ids: HashSet<&str> = subjects.iter().map(|subject| subject.id).collect();
    let (sizes, mut warnings) = (voxels::sizes(subjects)?, Vec::new());
    for test in &plan.study.test {
        let named = || format!("{}: test {:?}", plan.file.display(), test.name);
        let rows = Rows::of(plan, test, &|row| ids.contains(row.id.as_str()));
        emptied::check(plan, test, &rows.rows, failed).with_context(named)?;
        if rows.rows.len() < LEAST {
            let (of_side, found) = (of_side(test), rows.rows.len());
            bail!("{}: expected {LEAST} subjects or more with {of_side} that could be fitted, found {found}", named());
        }
        let levels = designed(plan, test, &rows).with_context(named)?;
        warnings.extend(voxels::differ(&test.name, &rows.rows, &levels, &sizes));
    }
    if !plan.has_sides() {
        return Ok(warnings);
    }
    let alone = sides::alone(&plan.manifest, subjects.iter().map(|subject| subject.cells));
    let (count, names) = (counted(alone.len(), "subject"), first_of(alone.iter().map(String::as_str), NAMED));
    let are = if alone.len() == 1 { "is" } else { "are" };
    let missing = (!alone.is_empty())
        .then(|| format!("{count} with only one side {are} excluded from the tests of asymmetry: {names}"));
    warnings.extend(missing.into_iter().chain(swapped(plan, subjects)?));
    Ok(warnings)
}

/// Returns a warning if, in the volumes of all subjects, the body of the left side lies to the right of the body of the
/// right side, which means that the names of the sides seem to be exchanged.
fn swapped(plan: &Plan, subjects: &[Subject<'_>]) -> Result<Option<String>> {
    let [first, second] = &plan.study.subjects.sides[..] else { return Ok(None) };
    let is = |name: &str, letter: char| name.to_lowercase().starts_with(letter);
    let left_first = is(first, 'l') && is(second, 'r');
    // Meshes are skipped because the direction of their x axis isn't known: it may point to the right or to the left.
    if !(left_first || is(first, 'r') && is(second, 'l')) || !subjects.iter().all(|subject| is_volume(&subject.surface))
    {
        return Ok(None);
    }
    let centre =
        |subject: &Subject<'_>| -> Result<f64> { Ok(Model::read(&subject.model)?.coefficients.values()[[0, 0]]) };
    let mut pairs = 0;
    for (first, second) in
        sides::pairs(&plan.study.subjects, subjects.iter().map(|of| of.cells), &plan.manifest.columns)
    {
        let is_left_first = centre(&subjects[first])? < centre(&subjects[second])?;
        if is_left_first == left_first {
            return Ok(None);
        }
        pairs += 1;
    }
    let all = counted(pairs, "subject");
    Ok((pairs > 0).then(|| {
        format!(
            "in all of {all}, side {first} is where side {second} is expected, so left and right seem to be exchanged; \
             check `sides` and `labels`"
        )
    }))
}

/// Returns the sides of each subject that a test needs, as text for messages.
fn of_side(test: &Test) -> String {
    match &test.side {
        Some(_) if test.is_of_differences() => "both sides".to_owned(),
        Some(side) => format!("side {side}"),
        None => "a row in the table".to_owned(),
    }
}

/// Checks that the mask, the sphere and the annotation of a test exist and have the same number of vertices. With
/// method "correspond", a mask that is given without a sphere must be for the default icosphere, whose directions are
/// points of the group's template.
fn sampling(plan: &Plan, test: &Test) -> Result<()> {
    for (key, path) in [("mask", &test.mask), ("sphere", &test.sphere), ("annotation", &test.annotation)] {
        if let Some(path) = path.as_ref().map(|path| plan.folder.join(path)).filter(|path| !path.is_file()) {
            bail!("{key}: {}: no such file", path.display());
        }
    }
    for (key, path) in [("mask", &test.mask), ("annotation", &test.annotation)] {
        let is_of_icosphere = key == "mask" && plan.method == Method::Correspond;
        if path.is_some() && test.sphere.is_none() && !is_of_icosphere {
            bail!("{key}: also give `sphere`, the sphere of the vertices to which the {key} refers");
        }
    }
    let sphere = test.sphere.as_ref().map(|sphere| plan.folder.join(sphere));
    let read = sphere.as_ref().map(read_sphere).transpose().context("sphere")?;
    of_first_side(plan, test, read.as_ref())?;
    let vertices = match read {
        Some(sphere) => sphere.directions.len(),
        None => usize::try_from(icosphere_counts(SUBDIVISIONS)[0])?,
    };
    if let Some(mask) = &test.mask {
        if plan.method == Method::Correspond && test.sphere.is_none() && masks::is_of_freesurfer(mask) {
            bail!(
                "mask: {}: this is a FreeSurfer label file, whose vertices are those of the FreeSurfer surface; with \
                 method \"correspond\", give a mask with one value for each vertex of a test's mean.surf.gii",
                plan.folder.join(mask).display()
            );
        }
        let sampling = masks::sampling(sphere.as_deref(), SUBDIVISIONS);
        let remedy = match sphere {
            Some(_) => "give the mask's own sphere as `sphere`",
            None => "give a mask for the vertices of a test's mean.surf.gii, or the mask's own sphere as `sphere`",
        };
        masks::read_file(&plan.folder.join(mask), vertices, &sampling, remedy).context("mask")?;
    }
    if let Some(annotation) = &test.annotation {
        read_annotation(plan.folder.join(annotation), vertices).context("annotation")?;
    }
    Ok(())
}

/// In a study with two sides, refuses a test whose sphere, mask or annotation belongs to the second side. The second
/// side is mirrored, so all results, including those of the second side, are given at points of the first side.
fn of_first_side(plan: &Plan, test: &Test, sphere: Option<&Sphere>) -> Result<()> {
    let [first, second] = &plan.study.subjects.sides[..] else { return Ok(()) };
    let Some(mirrored) = Hemisphere::of_side(second) else { return Ok(()) };
    let named = |path: Option<&PathBuf>| Hemisphere::of(None, path.map(PathBuf::as_path));
    let files = [
        ("sphere", &test.sphere, sphere.and_then(Sphere::hemisphere)),
        ("mask", &test.mask, named(test.mask.as_ref())),
        ("annotation", &test.annotation, named(test.annotation.as_ref())),
    ];
    for (key, path, of) in files {
        if let Some(path) = path.as_ref().filter(|_| of == Some(mirrored)) {
            bail!(
                "{key}: {}: this file belongs to the {mirrored} hemisphere, but side {second} is mirrored, and all \
                 results are at the vertices of side {first}; give the file of side {first}",
                plan.folder.join(path).display()
            );
        }
    }
    Ok(())
}

/// The subjects of a test, as a table from which the test's design is built.
struct Rows<'a> {
    plan: &'a Plan,
    rows: Vec<&'a Row>,
}

impl<'a> Rows<'a> {
    /// Returns the rows of a test, considering only rows for which `is_left` returns true.
    fn of(plan: &'a Plan, test: &Test, is_left: &dyn Fn(&Row) -> bool) -> Self {
        let Manifest { rows, columns, .. } = &plan.manifest;
        let rows: Vec<&Row> = rows.iter().filter(|row| is_left(row)).collect();
        let tested = sides::tested(test, &plan.study.subjects, rows.iter().map(|row| row.extra.as_slice()), columns);
        Self { plan, rows: tested.into_iter().map(|(row, _)| rows[row]).collect() }
    }
}

impl Subjects for Rows<'_> {
    fn count(&self) -> usize {
        self.rows.len()
    }

    fn names(&self) -> Vec<&str> {
        self.plan.manifest.columns.iter().map(String::as_str).collect()
    }

    fn cells(&self, column: &str) -> Result<Vec<&str>> {
        cells(self.plan, &self.rows, column)
    }

    fn place(&self, row: usize) -> String {
        self.rows[row].id.clone()
    }
}

/// Returns a column's cells, one per subject; a cell without a value is an error.
fn cells<'a>(plan: &Plan, rows: &[&'a Row], column: &str) -> Result<Vec<&'a str>> {
    let at = plan.manifest.columns.iter().position(|name| name == column);
    let at = at.with_context(|| format!("{}: no column {column:?}", plan.table.display()))?;
    let cell = |row: &&'a Row| {
        let cell = row.extra.get(at).map_or("", |cell| cell.trim());
        if cell.is_empty() || is_missing(cell) {
            let found = if cell.is_empty() { "nothing".to_owned() } else { format!("{cell:?}") };
            bail!(
                "{}: {}: column {column:?}: expected a value, found {found}; remove the subject from the table, or the \
                 column from the test",
                plan.table.display(),
                row.id
            );
        }
        Ok(cell)
    };
    rows.iter().map(cell).collect()
}
