//! `moments`: computes the moments of samples for later fits, in parts that can be added.

mod args;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use serde_json::{Value, json};
use spharm::Directions;
use spharm::moments::{Accumulated, Moments, Request, accumulate, equal_sums, merge_named};
use spharm_cli::Usage;
use spharm_cli::console::Console;
use spharm_cli::inputs::read_sphere;
use spharm_cli::machine::memory;
use spharm_cli::memory::Budget;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, is_stdout, prepare, print_json, print_line, write_json};
use spharm_cli::paths::{all_shown, shown};
use spharm_surface::Sphere;
use spharm_surface::generate::{icosphere_bytes, icosphere_counts};
use spharm_surface::io::bytes_to_read;

pub(crate) use self::args::Cli;
use self::args::{Command, Form, Merge, OutputArgs};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let monitor = ConsoleMonitor::new(cli.common.console());
    match &cli.command {
        Some(Command::Merge(merge)) => add(merge, monitor.console()),
        None => cli.form.threads.pool()?.install(|| read(&cli.form, &monitor)),
    }
}

fn read(form: &Form, monitor: &ConsoleMonitor) -> Result<()> {
    let output = Output::new(&form.output)?;
    let budget = form.memory.budget(form.threads.count());
    let free = usize::try_from(budget.work()).unwrap_or(usize::MAX);
    let request = Request {
        files: form.samples.clone(),
        columns: form.columns(vertices(form, budget, monitor)?),
        max_degree: form.max_degree.ok_or_else(|| Usage::missing("--max-degree is required"))?,
        shard: form.shard,
        memory: Some(form.memory.memory.map_or(free, |size| size.0)),
    };
    let Accumulated { moments, warnings, seconds } = accumulate(&request, monitor)?;
    for warning in &warnings {
        monitor.console().warn(warning);
    }
    let mut report = output.write(&moments)?;
    report["samples"] = json!(all_shown(&form.samples));
    report["sphere"] = json!(form.positions.sphere.as_ref().map(shown));
    report["icosphere"] = json!(form.positions.icosphere);
    report["shard"] = json!([form.shard.index, form.shard.of]);
    report["warnings"] = json!(warnings.iter().map(ToString::to_string).collect::<Vec<_>>());
    report["seconds"] = json!(seconds);
    output.finish(&moments, &report, seconds.total)
}

/// Returns the directions of the sphere's vertices if the samples are at these vertices (--sphere or --icosphere),
/// otherwise `None`.
fn vertices(form: &Form, budget: Budget, monitor: &ConsoleMonitor) -> Result<Option<Directions>> {
    let sphere = match (&form.positions.sphere, form.positions.icosphere) {
        (Some(path), _) => {
            budget.check_inputs("moments", [path.as_path()])?;
            read_sphere(path, false, monitor.console())?
        }
        (None, Some(subdivisions)) => {
            let vertices = icosphere_counts(subdivisions)[0];
            let what = format_args!("moments --icosphere {subdivisions} ({vertices} vertices)");
            budget.check(what, icosphere_bytes(subdivisions))?;
            Sphere::icosphere(subdivisions)
        }
        (None, None) => return Ok(None),
    };
    Ok(Some(sphere.directions))
}

fn add(cli: &Merge, console: &Console) -> Result<()> {
    let started = Instant::now();
    let output = Output::new(&cli.output)?;
    // Memory for the sum of the parts' moments, and for the part that is being added to the sum.
    let largest = cli.parts.iter().map(|path| bytes_to_read(path)).max().unwrap_or(0);
    cli.memory.budget(1).check("moments merge", largest.saturating_mul(2))?;
    let names: Vec<_> = cli.parts.iter().map(|path| path.display().to_string()).collect();
    let mut hashes = Vec::new();
    let read = |path: &PathBuf| Moments::read(path).inspect(|part| hashes.push(part.sums_hash()));
    let moments = merge_named(cli.parts.iter().map(read), names.clone(), cli.partial)?;
    let warnings = equal_sums(&hashes, &names);
    for warning in &warnings {
        console.warn(warning);
    }
    let seconds = started.elapsed().as_secs_f64();
    let mut report = output.write(&moments)?;
    report["parts"] = json!(all_shown(&cli.parts));
    report["warnings"] = json!(warnings.iter().map(ToString::to_string).collect::<Vec<_>>());
    report["seconds"] = json!({ "total": seconds });
    output.finish(&moments, &report, seconds)
}

fn report(moments: &Moments, output: &Path) -> Value {
    json!({
        "tool": "moments",
        "versions": spharm::versions(),
        "output": shown(output),
        "scheme_key": moments.scheme.map(|key| key.to_string()),
        "max_degree": moments.sums.max_degree,
        "channels": moments.channels,
        "rows": moments.rows,
        "count": moments.sums.count,
        "weight": moments.sums.weight,
        "squares": moments.sums.squares,
        "shards": moments.sources.iter().map(|source| json!({
            "key": source.key.iter().map(|byte| format!("{byte:02x}")).collect::<String>(),
            "shard": [source.shard.index, source.shard.of],
            "rows": source.rows,
        })).collect::<Vec<_>>(),
        "memory": memory(),
    })
}

/// Output files: the file of moments, and the report.
struct Output<'a> {
    args: &'a OutputArgs,
    path: &'a Path,
}

impl<'a> Output<'a> {
    /// Refuses outputs that can't be written, before any samples or parts are read.
    fn new(args: &'a OutputArgs) -> Result<Self> {
        let path = args.output.as_deref().ok_or_else(|| Usage::missing("--output is required"))?;
        let moments = OutputFile::with_ending(path, "--output", &[".moments"]);
        let report = args.report.iter().map(|path| OutputFile::new(path, "--report"));
        check_outputs(std::iter::once(moments).chain(report), args.force)?;
        Ok(Self { args, path })
    }

    fn write(&self, moments: &Moments) -> Result<Value> {
        prepare(self.path)?;
        moments.write(self.path, self.args.force)?;
        Ok(report(moments, self.path))
    }

    fn finish(&self, moments: &Moments, report: &Value, seconds: f64) -> Result<()> {
        if let Some(path) = &self.args.report {
            write_json(path, self.args.force, report)?;
        }
        if self.args.report.as_deref().is_some_and(is_stdout) {
            return Ok(());
        }
        if self.args.json {
            return print_json(report);
        }
        let (rows, channels) = (counted(moments.rows as usize, "sample"), counted(moments.channels.len(), "channel"));
        let degree = moments.sums.max_degree;
        print_line(&format!("{}: {rows}, {channels}, degree {degree}, {seconds:.2} s", self.path.display()))
    }
}
