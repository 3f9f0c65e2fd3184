//! `shape check`: quality control of a group.

mod args;
mod evaluated;
mod gather;
mod table;
mod thumbnails;

use std::time::Instant;

use anyhow::{Result, bail};
use serde_json::json;
use spharm::parametrize::volume::steps_of_labels;
use spharm::shape::memory::measure_bytes;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, counted, print_line};
use spharm_cli::paths::shown;
use spharm_cohort::check::{Facts, check, incomplete};

pub(super) use self::args::Cli;
use self::gather::{Inputs, State};
use self::table::Line;
use self::thumbnails::Drawing;
use super::args::files;
use super::outputs::{self, check_beside, write_text};
use super::plan::Plan;

/// Maximum number of subjects in the printed table.
const SHOWN: usize = 20;

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    let aligned = if cli.aligned.is_empty() { None } else { Some(files(&cli.aligned)?) };
    let pictures = cli.thumbnails.as_deref().map(|folder| thumbnails::paths(folder, &paths));
    let of_pictures = pictures.iter().flatten().map(|path| OutputFile::new(path, "--thumbnails"));
    let of_table = OutputFile::with_ending(&cli.output, "--output", &[".tsv"]);
    check_beside(&paths, of_pictures.chain([of_table]), &cli.report)?;
    let inputs = Inputs::read(cli, paths, aligned)?;
    let plan = Plan::new("check", &inputs.files(), cli.resources.both())?;
    let threads = plan.threads.min(inputs.models.len()) as u64;
    let each = plan.one().saturating_mul(2).saturating_add(measure_bytes(plan.group.max_degree));
    plan.check(threads.saturating_mul(each), [])?;
    plan.note(threads.saturating_mul(each), monitor.console());
    let pool = cli.resources.threads.pool()?;
    let found = pool.install(|| inputs.find(monitor))?;
    let drawing = match &pictures {
        Some(pictures) => {
            plan.check(threads.saturating_mul(each.saturating_add(thumbnails::bytes(&found))), [])?;
            Some(pool.install(|| thumbnails::draw(&inputs, &found, pictures, cli.report.force, monitor))?)
        }
        None => None,
    };
    let facts: Vec<Facts> = found.into_iter().map(|found| found.facts).collect();
    let checked = check(&facts);
    let mut lines: Vec<Line<'_>> = Vec::with_capacity(facts.len() + inputs.others.len());
    for (index, (facts, checked)) in facts.iter().zip(&checked).enumerate() {
        let scale = drawing.as_ref().map(|drawing| drawing.scales[index]);
        lines.push(Line::of(facts, checked, inputs.accepted.get(&facts.id), scale));
    }
    lines.extend(inputs.others.iter().map(Line::without_model));
    table::sort(&mut lines);
    write_text(&cli.output, cli.report.force, &table::tsv(&lines))?;
    let warnings = warnings(&facts, drawing.as_ref());
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let count = |state: State| lines.iter().filter(|line| line.state == state).count();
    let flagged = count(State::Flagged);
    let report = json!({
        "output": shown(&cli.output),
        "thumbnails": cli.thumbnails.as_ref().map(shown),
        "thumbnails_red_at": drawing.as_ref().map(|drawing| drawing.red_at),
        "subjects": lines.iter().map(Line::json).collect::<Vec<_>>(),
        "flagged": flagged,
        "accepted": count(State::Accepted),
        "failed": count(State::Failed),
        "excluded": count(State::Excluded),
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    let rows = printed(&lines);
    if rows.len() > 1 || cli.report.json {
        outputs::finish("check", &report, &rows, &cli.report)?;
    } else {
        outputs::write_report("check", &report, &cli.report)?;
    }
    if !cli.report.json {
        let subjects = counted(lines.len(), "subject");
        print_line(&format!("{flagged} of {subjects} flagged: {}", cli.output.display()))?;
    }
    if cli.strict && flagged > 0 {
        let flagged = counted(flagged, "subject");
        bail!("{}: {flagged} flagged; repair their surfaces, or exclude their models", cli.output.display());
    }
    Ok(())
}

/// Returns the warnings about the whole group.
fn warnings(facts: &[Facts], drawing: Option<&Drawing>) -> Vec<String> {
    let steps: Vec<_> = facts.iter().filter_map(|facts| Some((facts.id.clone(), facts.steps?))).collect();
    let mut warnings = incomplete(facts);
    warnings.extend(steps_of_labels(&steps));
    warnings.extend(drawing.iter().flat_map(|drawing| drawing.warnings.iter().cloned()));
    warnings
}

/// Returns the printed table: subjects that are flagged or failed.
fn printed(lines: &[Line<'_>]) -> Vec<Vec<String>> {
    let mut rows = vec![["subject", "state", "why"].map(str::to_owned).to_vec()];
    let listed = lines.iter().filter(|line| matches!(line.state, State::Flagged | State::Failed));
    let row = |line: &Line<'_>| vec![line.id.to_owned(), line.state.to_string(), line.first_flag()];
    rows.extend(listed.clone().take(SHOWN).map(row));
    if let Some(more) = listed.count().checked_sub(SHOWN + 1) {
        rows.push(vec![format!("and {} more", more + 1), String::new(), String::new()]);
    }
    rows
}
