//! Previews a run: the number of rows, existing models, spheres, memory, and the rows that are certain to fail.

use anyhow::{Result, anyhow};
use serde_json::{Value, json};
use spharm_cli::exit::line_with_advice;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, first_of, print, print_json};
use spharm_cli::paths::shown;
use spharm_cli::size::Size;
use spharm_cohort::run::{Cohort, Preview, PreviewedSphere};

use super::console::Rows;
use super::options::Options;

/// Maximum number of spheres that the preview lists.
const SPHERES: usize = 3;
/// Maximum number of failing rows that the preview lists.
const NAMED: usize = 5;

/// Preview of a call of a verb, as text and as JSON.
pub(crate) struct Previewed {
    pub(crate) text: String,
    json: Value,
    /// The error with which the call would end, if any.
    pub(crate) error: Option<anyhow::Error>,
}

/// Prints the preview of a call, and returns the error with which the call would end, if any.
pub(super) fn run(cohort: &Cohort, options: &Options, monitor: &ConsoleMonitor) -> Result<()> {
    let previewed = preview(cohort, options, monitor)?;
    match options.json {
        true => print_json(&previewed.json)?,
        false => print(&previewed.text)?,
    }
    previewed.error.map_or(Ok(()), Err)
}

/// Determines what a call would do and which rows would fail, without fitting anything.
pub(crate) fn preview(cohort: &Cohort, options: &Options, monitor: &ConsoleMonitor) -> Result<Previewed> {
    let rows = Rows::new(monitor.console(), cohort.rows.len(), options);
    let found = spharm_cohort::run::preview(cohort, &options.run, &rows, monitor)?;
    let budget = options.run.fit.memory_budget();
    let Preview {
        rows: all, exist, kept, missing, spheres: shared, first_spheres: spheres, mapped: own, failed, ..
    } = found;
    let id = |number: usize| cohort.rows[number].id.as_str();
    let first_spheres = spheres.iter().map(
        |PreviewedSphere { path, rows, vertices, .. }| json!({ "sphere": shown(path), "rows": rows, "vertices": vertices }),
    );
    let fail = failed.iter().map(|(number, error)| json!({ "id": id(*number), "error": line_with_advice(error) }));
    let json = json!({
        "rows": all, "exist": exist, "kept": kept, "missing": missing, "spheres": shared,
        "first_spheres": first_spheres.collect::<Vec<_>>(), "mapped": own, "memory": budget,
        "would_fail": fail.collect::<Vec<_>>(),
    });
    let keeps = if options.run.if_exists.keeps() { format!(" and {kept} would be kept") } else { String::new() };
    let mut lines = vec![format!("{}, of which {exist} exist{keeps}", counted(all, "model"))];
    lines.push(match (shared, own) {
        (0, _) => "each surface is mapped to its own sphere".to_owned(),
        (_, 0) => format!("fitted over {}", counted(shared, "sphere")),
        _ => format!(
            "fitted over {}; {} to their own spheres",
            counted(shared, "sphere"),
            if own == 1 { "1 surface is mapped".to_owned() } else { format!("{own} surfaces are mapped") }
        ),
    });
    let size = |PreviewedSphere { path, rows, vertices, .. }: &PreviewedSphere| {
        format!("  {}: {vertices} vertices, {}", path.display(), counted(*rows, "surface"))
    };
    lines.extend(spheres.iter().take(SPHERES).map(size));
    if shared > spheres.len().min(SPHERES) {
        lines.push(format!("  and {} more", shared - spheres.len().min(SPHERES)));
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
    // Without --keep-going, the first row that fails ends the call.
    let first = failed.into_iter().min_by_key(|(number, _)| *number).map(|(_, error)| anyhow::Error::from(error));
    let error = match options.run.keep_going {
        true => first.map(|_| anyhow!("{count} of {} would fail: {names}", counted(all, "surface"))),
        false => first,
    };
    Ok(Previewed { text: lines.join("\n"), json, error })
}
