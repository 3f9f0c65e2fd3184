//! `moments`: sums over samples that fits are made of, by parts.

mod args;

use std::time::Instant;

use anyhow::Result;
use serde_json::{Value, json};
use spharm::moments::{Accumulated, Moments, Request, accumulate, merge_named};
use spharm_cli::Usage;
use spharm_cli::machine::memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print, print_json, write_json};

pub(crate) use self::args::Cli;
use self::args::{Command, Form, Merge, Output};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let monitor = ConsoleMonitor::new(cli.common.console());
    match (&cli.command, &cli.form) {
        (Some(Command::Merge(merge)), _) => add(merge),
        (None, Some(form)) => form.threads.pool()?.install(|| read(form, &monitor)),
        (None, None) => Err(Usage::missing("moments needs --samples FILE, or is followed by merge").into()),
    }
}

fn read(form: &Form, monitor: &ConsoleMonitor) -> Result<()> {
    form.output.check()?;
    let request = Request {
        files: form.samples.clone(),
        columns: form.columns(),
        max_degree: form.max_degree,
        shard: form.shard,
        memory: form.memory.map(|size| size.0),
    };
    let Accumulated { moments, warnings, seconds } = accumulate(&request, monitor)?;
    for warning in &warnings {
        monitor.console().warn(warning);
    }
    prepare(&form.output.path)?;
    moments.write(&form.output.path, form.output.force)?;
    let mut report = report(&moments, &form.output);
    report["samples"] = json!(form.samples);
    report["shard"] = json!([form.shard.index, form.shard.of]);
    report["warnings"] = json!(warnings.iter().map(ToString::to_string).collect::<Vec<_>>());
    report["seconds"] = json!(seconds);
    form.output.finish(&moments, &report, seconds.total)
}

fn add(cli: &Merge) -> Result<()> {
    let started = Instant::now();
    cli.output.check()?;
    let names = cli.parts.iter().map(|path| path.display().to_string()).collect();
    let moments = merge_named(cli.parts.iter().map(|path| Moments::read(path)), names, cli.partial)?;
    prepare(&cli.output.path)?;
    moments.write(&cli.output.path, cli.output.force)?;
    let seconds = started.elapsed().as_secs_f64();
    let mut report = report(&moments, &cli.output);
    report["parts"] = json!(cli.parts);
    report["seconds"] = json!({ "total": seconds });
    cli.output.finish(&moments, &report, seconds)
}

fn report(moments: &Moments, output: &Output) -> Value {
    json!({
        "tool": "moments",
        "versions": spharm::versions(),
        "output": output.path,
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

impl Output {
    fn check(&self) -> Result<()> {
        let moments = OutputFile::with_ending(&self.path, "--output", &[".moments"]);
        let report = self.report.iter().map(|path| OutputFile::new(path, "--report"));
        check_outputs(std::iter::once(moments).chain(report), self.force)
    }

    fn finish(&self, moments: &Moments, report: &Value, seconds: f64) -> Result<()> {
        if let Some(path) = &self.report {
            write_json(path, self.force, report)?;
        }
        if self.json {
            return print_json(report);
        }
        let (rows, channels) = (counted(moments.rows as usize, "sample"), counted(moments.channels.len(), "channel"));
        let degree = moments.sums.max_degree;
        print(&format!("{}: {rows}, {channels}, degree {degree}, {seconds:.2} s", self.path.display()))
    }
}
