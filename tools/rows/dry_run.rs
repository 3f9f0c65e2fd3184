//! What would be done: rows, models that exist, spheres, memory; and which rows would fail, as far as that is known
//! beforehand.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use serde_json::{Value, json};
use spharm::cohort::Row;
use spharm::files::ModelFiles;
use spharm::parametrize::volume::is_volume;
use spharm::rerun::IfExists;
use spharm::{Monitor, Sphere, SurfaceError, check_memory, check_surface};
use spharm_cli::exit::{is_interrupted, line_with_advice};
use spharm_cli::inputs::read_sphere;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, first_of, print, print_json};
use spharm_cli::paths::shown;
use spharm_cli::size::Size;
use spharm_surface::io::declared_vertices;

use super::groups::{Group, groups};
use super::ledger::Ledger;
use super::options::{Options, Rows};
use super::work::{Work, lock};

/// Spheres, and surfaces without one, that are read where nothing is there yet: for their sizes.
const READ: usize = 3;
/// Rows that are named where they would fail.
const NAMED: usize = 5;

/// What a call would do.
pub(crate) struct Preview {
    pub(crate) text: String,
    json: Value,
    /// What the call would end with.
    pub(crate) error: Option<anyhow::Error>,
}

/// Prints what a call would do; an error where it would end with one.
pub(super) fn run(rows: &Rows, options: &Options, monitor: &ConsoleMonitor) -> Result<()> {
    let preview = preview(rows, options, monitor)?;
    match options.json {
        true => print_json(&preview.json)?,
        false => print(&preview.text)?,
    }
    preview.error.map_or(Ok(()), Err)
}

/// Looks at what a call would do: at all models that exist, at a few spheres, and whether surfaces are there.
pub(crate) fn preview(rows: &Rows, options: &Options, monitor: &ConsoleMonitor) -> Result<Preview> {
    let all = rows.rows.len();
    let numbers: Vec<usize> = (0..all).collect();
    let groups = groups(&rows.rows, &numbers);
    let ledger = Ledger::new(monitor.console(), all, None, false)?;
    let work = Work::new(rows, options, monitor, &ledger);
    let mut look = Look { work: &work, spheres: Vec::new(), own: 0, kept: 0, failed: Vec::new() };
    for group in &groups {
        monitor.check()?;
        look.at_group(group)?;
    }
    let Look { spheres, kept, failed, .. } = look;
    let exist = rows.rows.iter().filter(|row| row.model(&rows.folder).exists()).count();
    let missing = rows.rows.iter().filter(|row| !row.surface.exists()).count();
    let shared = groups.iter().filter(|group| group.sphere.is_some()).count();
    let own: usize = groups.iter().filter(|group| group.sphere.is_none()).map(|group| group.rows.len()).sum();
    let budget = options.params.memory_budget();
    let id = |number: usize| rows.rows[number].id.as_str();
    let first_spheres =
        spheres.iter().map(|(path, rows, n)| json!({ "sphere": shown(path), "rows": rows, "vertices": n }));
    let fail = failed.iter().map(|(number, error)| json!({ "id": id(*number), "error": line_with_advice(error) }));
    let json = json!({
        "rows": all, "exist": exist, "kept": kept, "missing": missing, "spheres": shared,
        "first_spheres": first_spheres.collect::<Vec<_>>(), "mapped": own, "memory": budget,
        "would_fail": fail.collect::<Vec<_>>(),
    });
    let keeps = if options.if_exists.keeps() { format!(" and {kept} would be kept") } else { String::new() };
    let mut lines = vec![format!("{}, of which {exist} exist{keeps}", counted(all, "model"))];
    lines.push(match (shared, own) {
        (0, _) => "each surface is mapped to a sphere of its own".to_owned(),
        (_, 0) => format!("over {}", counted(shared, "sphere")),
        _ => format!(
            "over {}; {} to spheres of their own",
            counted(shared, "sphere"),
            if own == 1 { "1 surface is mapped".to_owned() } else { format!("{own} surfaces are mapped") }
        ),
    });
    let size = |(path, rows, n): &(PathBuf, usize, usize)| {
        format!("  {}: {n} vertices, {}", path.display(), counted(*rows, "surface"))
    };
    lines.extend(spheres.iter().take(READ).map(size));
    if shared > spheres.len().min(READ) {
        lines.push(format!("  and {} more", shared - spheres.len().min(READ)));
    }
    lines.push(format!("within {} of memory", Size(budget)));
    if !failed.is_empty() {
        lines.push(format!("{} would fail:", counted(failed.len(), "surface")));
        let named = failed.iter().take(NAMED);
        lines.extend(named.map(|(number, error)| format!("  {}: {}", id(*number), line_with_advice(error))));
        if failed.len() > NAMED {
            lines.push(format!("  and {} more", failed.len() - NAMED));
        }
    }
    let (count, names) = (failed.len(), first_of(failed.iter().map(|(number, _)| id(*number)), NAMED));
    // Without --keep-going the first row that fails ends the call.
    let first = failed.into_iter().min_by_key(|(number, _)| *number).map(|(_, error)| error);
    let error = match options.cohort.keep_going {
        true => first.map(|_| anyhow!("{count} of {} would fail: {names}", counted(all, "surface"))),
        false => first,
    };
    Ok(Preview { text: lines.join("\n"), json, error })
}

/// What has been looked at.
struct Look<'a> {
    work: &'a Work<'a>,
    /// Spheres that were read, the number of their rows, and their vertices.
    spheres: Vec<(PathBuf, usize, usize)>,
    /// Surfaces without a sphere that were read.
    own: usize,
    kept: usize,
    /// Rows that would fail, by number, and why.
    failed: Vec<(usize, anyhow::Error)>,
}

impl Look<'_> {
    /// Looks at the rows of a sphere; only an interruption is an error.
    fn at_group(&mut self, group: &Group) -> Result<()> {
        let before = self.failed.len();
        let Err(error) = self.at_sphere(group) else { return Ok(()) };
        if is_interrupted(&error) {
            return Err(error);
        }
        // None of its rows can be fitted; what each would say is the same.
        self.failed.truncate(before);
        let line = line_with_advice(&match &group.sphere {
            Some(path) if self.work.options.cohort.keep_going => error.context(path.display().to_string()),
            _ => error,
        });
        self.failed.extend(group.rows.iter().map(|&number| (number, anyhow!(line.clone()))));
        Ok(())
    }

    fn at_sphere(&mut self, group: &Group) -> Result<()> {
        let Work { rows, options, monitor, .. } = *self.work;
        let any_there = group.rows.iter().any(|&number| self.any_output(number));
        let read;
        let sphere = match (&group.sphere, &rows.sphere) {
            (Some(_), Some(sphere)) => Some(sphere),
            (Some(path), None) if any_there || self.spheres.len() < READ => {
                read = read_sphere(path, options.params.strict, monitor.console())?;
                Some(&read)
            }
            (Some(path), None) => {
                is_there(path)?;
                None
            }
            (None, _) => None,
        };
        let params = self.work.masked(self.work.params(&rows.rows[group.rows[0]])?, sphere)?;
        if let (Some(path), Some(sphere)) = (&group.sphere, sphere) {
            check_memory(&sphere.to_mesh(), &params)?;
            self.spheres.push((path.clone(), group.rows.len(), sphere.directions.len()));
        }
        for &number in &group.rows {
            monitor.check()?;
            let row = &rows.rows[number];
            let mut look = || -> Result<bool> {
                is_there(&row.surface)?;
                row.region.as_deref().map_or(Ok(()), is_there)?;
                self.counts(row, sphere)?;
                if self.any_output(number) && self.work.decide(number, sphere, &params)?.is_none() {
                    return Ok(true);
                }
                if group.sphere.is_none() && !is_volume(&row.surface) && self.own < READ {
                    self.own += 1;
                    let found = lock(&self.work.reader).read(&row.surface, None, monitor)?;
                    check_surface(&found, &params)?;
                }
                Ok(false)
            };
            match look() {
                Ok(kept) => self.kept += usize::from(kept),
                Err(error) if is_interrupted(&error) => return Err(error),
                Err(error) => self.failed.push((number, error)),
            }
        }
        Ok(())
    }

    /// Compares the vertices of a surface and its sphere, as far as the files say them in their heads.
    fn counts(&self, row: &Row, sphere: Option<&Sphere>) -> Result<()> {
        let Some(found) = declared_vertices(&row.surface)? else { return Ok(()) };
        let of_sphere = match (sphere, &row.sphere) {
            (Some(sphere), _) => Some(sphere.directions.len() as u64),
            (None, Some(path)) => declared_vertices(path)?,
            (None, None) => None,
        };
        match of_sphere.filter(|expected| *expected != found) {
            None => Ok(()),
            Some(expected) => {
                let (path, sphere) = (row.surface.clone(), row.sphere.clone());
                Err(SurfaceError::VertexCount { path, sphere, expected: expected as usize, found: found as usize }
                    .into())
            }
        }
    }

    /// Whether any file of a row's model is there, about which something has to be decided.
    fn any_output(&self, number: usize) -> bool {
        let Work { rows, options, .. } = *self.work;
        if options.if_exists == IfExists::Replace {
            return false;
        }
        let files = ModelFiles { model: rows.rows[number].model(&rows.folder) };
        let beside = [files.csv(), files.standard_errors(), files.sphere(), files.surface(), files.cut_surface()];
        beside.iter().chain([&files.model, &files.fixed_surface()]).any(|path| path.exists())
    }
}

fn is_there(path: &Path) -> Result<()> {
    if !path.exists() {
        bail!("{}: no such file", path.display());
    }
    Ok(())
}
