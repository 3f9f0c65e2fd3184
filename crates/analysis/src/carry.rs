//! `shape carry`: carries landmarks from one member of a group to other members.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde_json::{Value, json};
use spharm::correspond::{Carried, GroupFiles};
use spharm_cli::help::{self, INPUT, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_files, first_of, prepare};
use spharm_cli::paths::shown;
use spharm_surface::Mesh;
use spharm_surface::io::landmarks::Landmarks;

use super::args::ReportArgs;
use super::landmarks::on_surface;
use super::outputs::finish;

/// Carry landmarks from one member of a group to the corresponding positions on another member, or on all others
///
/// Each member's landmarks are in the frame of the file from which the member was read. If a landmark has no
/// counterpart on one of the two members, its new position is only a guess. Such landmarks are listed by name, and
/// `reached` is false for them in the report.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape carry group marks.mrk.json --from s01 --to s07 -o s07.mrk.json",
        "spharm shape carry group marks.csv --from s01 --to all -o carried --format csv",
    ],
    &["Landmarks: 3D Slicer's .mrk.json and .fcsv, .json, .csv and .tsv."],
))]
pub(super) struct Cli {
    /// Folder that `spharm shape correspond` wrote
    #[arg(value_name = "GROUP", help_heading = INPUT)]
    group: PathBuf,
    /// Landmarks to carry
    #[arg(value_name = "LANDMARKS", help_heading = INPUT)]
    landmarks: PathBuf,
    /// Member to which the landmarks belong
    #[arg(long, value_name = "NAME", help_heading = INPUT)]
    from: String,
    /// Member to which the landmarks are carried; `all` for all others
    #[arg(long, value_name = "NAME", help_heading = INPUT)]
    to: String,
    /// File of landmarks to write; with --to all, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    /// Format of the landmark files, with --to all
    #[arg(long, value_name = "ENDING", default_value = "mrk.json", help_heading = OUTPUT)]
    format: String,
    #[command(flatten)]
    report: ReportArgs,
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let files = GroupFiles::open(&cli.group)?;
    let index = |flag: &str, name: &str| match files.names().iter().position(|other| other == name) {
        Some(index) => Ok(index),
        None => {
            let names = first_of(files.names().iter().map(String::as_str), 5);
            bail!("{flag} {name}: no such member in {}; the group's members are {names}", cli.group.display())
        }
    };
    let source = index("--from", &cli.from)?;
    let all = cli.to == "all";
    let targets = match all {
        true => (0..files.names().len()).filter(|target| *target != source).collect(),
        false => vec![index("--to", &cli.to)?],
    };
    let ending = cli.format.trim_start_matches('.');
    let output = |target: usize| match all {
        true => cli.output.join(format!("{}.{ending}", files.names()[target])),
        false => cli.output.clone(),
    };
    let outputs: Vec<PathBuf> = targets.iter().map(|target| output(*target)).collect();
    let endings = [".mrk.json", ".fcsv", ".json", ".csv", ".tsv"];
    let named = |path: &PathBuf| endings.iter().any(|ending| path.to_string_lossy().ends_with(ending));
    if let Some(path) = outputs.iter().find(|path| !named(path)) {
        bail!("{}: expected the name of a landmark file, ending in {}", path.display(), endings.join(", "));
    }
    let of_report = cli.report.report.iter().map(|path| OutputFile::new(path, "--report"));
    let written = outputs.iter().map(|path| OutputFile::new(path, "--output")).chain(of_report);
    check_files([cli.landmarks.as_path()], written, cli.report.force)?;
    // Hold only the source and one target in memory at a time, because a group may have any number of members.
    let first = files.members(&[source])?;
    let surface = Mesh::new(first.places[0].clone(), first.template.sphere.faces.clone());
    let own = first.similarities[0].inverse().apply_mesh(&surface);
    let (landmarks, warnings) = on_surface(&cli.landmarks, &own)?;
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let mut rows = vec![["member", "landmarks", "without a counterpart"].map(str::to_owned).to_vec()];
    let mut carried = Vec::new();
    for (target, path) in targets.iter().zip(&outputs) {
        spharm::Monitor::check(monitor)?;
        let name = &files.names()[*target];
        let found = files.members(&[source, *target])?.carry(&landmarks.points, 0, 1)?;
        let points = found.iter().map(|found| found.point).collect();
        let there = Landmarks::new(landmarks.names.clone(), points, landmarks.frame)?;
        prepare(path)?;
        there.write(path, cli.report.force)?;
        let unreached = landmarks.names.iter().zip(&found).filter(|(_, found)| !found.reached);
        let unreached: Vec<&str> = unreached.map(|(name, _)| name.as_str()).collect();
        if !unreached.is_empty() {
            let names = first_of(unreached.iter().copied(), 5);
            let doubt = format!("{name}: these landmarks have no counterpart, so their positions are guesses: {names}");
            monitor.console().warn(doubt);
        }
        rows.push(vec![name.clone(), found.len().to_string(), unreached.len().to_string()]);
        carried.push(json!({ "member": name, "output": shown(path), "landmarks": described(&landmarks, &found) }));
    }
    let report = json!({
        "group": shown(&cli.group),
        "from": cli.from,
        "input": shown(&cli.landmarks),
        "carried": carried,
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("carry", &report, &rows, &cli.report)
}

fn described(landmarks: &Landmarks, found: &[Carried]) -> Vec<Value> {
    let one = |(name, found): (&String, &Carried)| json!({ "name": name, "coordinates": found.point, "off_surface": found.off, "reached": found.reached });
    landmarks.names.iter().zip(found).map(one).collect()
}
