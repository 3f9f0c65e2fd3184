//! `shape quality`: measures how well a group's models correspond, and how well its modes represent them.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};
use spharm::Kind;
use spharm::Sphere;
use spharm::shape::{Curve, GroupQuality, QualityParams, group_quality};
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::memory::round_numbers_below;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::{all_shown, shown};
use spharm_render::{Curve as Drawn, CurvePanel, render_curves, write_png};
use spharm_surface::generate::icosphere_counts;
use spharm_surface::io::WriteOptions;

use super::args::{Models, ReportArgs, Resources};
use super::groups::read_group;
use super::outputs::{check_beside, finish};
use super::plan::Plan;
use super::{frames, landmarks, masks};

/// Measure how well a group corresponds: compactness, generalisation, specificity, landmark errors
///
/// The models have to correspond, as after `spharm shape align --group`; their position in space is ignored. Points are
/// weighted by the area around them; distances between surfaces are measured between nearest points. The bands are 95 %
/// intervals of a bootstrap over the members.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape quality aligned --curves quality.png -o quality.json",
        "spharm shape quality aligned --rigid --landmarks landmarks/ --modes 5",
        "spharm shape quality @group.txt --landmarks landmarks/ --frames group.json",
    ],
    &[
        "Generalisation is the mean distance between a member and the nearest shape that the modes of the other \
         members can form. Specificity is the mean distance between a random shape and the nearest member. Both are in \
         the surfaces' unit, with 1, 2, ... modes; lower is better. If measured at equal directions, both also \
         decrease when directions drift to positions at which members differ little, so only landmarks show whether \
         positions correspond.",
    ],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Highest degree [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Maximum number of modes to measure
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=1000), help_heading = METHOD)]
    modes: u16,
    /// Number of random shapes for the specificity
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..), help_heading = METHOD)]
    samples: u64,
    /// Number of bootstrap samples for the bands; 0 for none
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(0..=100_000), help_heading = METHOD)]
    bands: u32,
    /// Subdivisions of the icosphere on which models are evaluated
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(2..=7), help_heading = METHOD)]
    icosphere: u32,
    /// First align members rigidly, by points at equal directions, weighted by area
    #[arg(long, help_heading = METHOD)]
    rigid: bool,
    /// Skip distances between surfaces, which take most of the time
    #[arg(long, help_heading = METHOD)]
    no_surfaces: bool,
    /// Landmarks in the models' own frames
    ///
    /// Give a folder with one file per model, named like the model, or give one file per model, or @LIST, in the
    /// models' order. The files are .mrk.json, .fcsv, .json, .csv or .tsv. Landmarks whose names occur in all files are
    /// compared.
    #[arg(long, value_name = "FILE", num_args = 1.., help_heading = METHOD)]
    landmarks: Vec<PathBuf>,
    /// Transforms from the landmarks' frames to the models' frames
    ///
    /// Needed for landmarks on the original surfaces. The file is written by `spharm shape align --transforms` or
    /// `spharm shape correspond --report`.
    #[arg(long, value_name = "FILE.json", requires = "landmarks", help_heading = METHOD)]
    frames: Option<PathBuf>,
    /// Mask of the icosphere's directions: a file with nonzero values at the directions to compare, or the folder of a
    /// group
    ///
    /// In a group made by `spharm shape correspond`, some parts of the template have no counterpart on the members,
    /// such as the lids of holes; these parts are skipped.
    #[arg(long, value_name = "FILE", help_heading = METHOD)]
    mask: Option<PathBuf>,
    /// Seed of the random shapes and of the bootstrap
    #[arg(long, value_name = "SEED", default_value_t = 0, help_heading = METHOD)]
    seed: u64,
    /// JSON file to write, with all measures
    #[arg(short, long, value_name = "OUT.json", help_heading = OUTPUT)]
    output: Option<PathBuf>,
    /// Picture to write, with the curves and their bands
    #[arg(long, value_name = "OUT.png", help_heading = OUTPUT)]
    curves: Option<PathBuf>,
    /// Print the measures as JSON in place of the table
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    force: bool,
    #[command(flatten)]
    resources: Resources,
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    let report = ReportArgs { report: None, json: cli.json, force: cli.force };
    let outputs = [
        cli.output.as_deref().map(|path| OutputFile::with_ending(path, "--output", &[".json"])),
        cli.curves.as_deref().map(|path| OutputFile::with_ending(path, "--curves", &[".png"])),
    ];
    check_beside(&paths, outputs.into_iter().flatten(), &report)?;
    let plan = Plan::new("quality", &paths, cli.resources.both())?;
    let (modes, [directions, _]) = (usize::from(cli.modes), icosphere_counts(cli.icosphere));
    let needed = |samples: u64| {
        let samples = usize::try_from(samples).unwrap_or(usize::MAX);
        plan.coefficients().saturating_add(plan.group.quality(directions, modes, samples, plan.threads))
    };
    let fewer = round_numbers_below(cli.samples).map(|n| (format!("--samples {n}"), needed(n)));
    plan.check(needed(cli.samples), fewer)?;
    let params = QualityParams {
        modes,
        samples: usize::try_from(cli.samples)?,
        bands: cli.bands as usize,
        subdivisions: cli.icosphere,
        rigid: cli.rigid,
        surfaces: !cli.no_surfaces,
        seed: cli.seed,
        mask: cli.mask.as_deref().map(|path| mask(path, cli.icosphere)).transpose()?,
    };
    let (group, marks, found) = cli.resources.threads.pool()?.install(|| -> Result<_> {
        let group = read_group(&paths, Kind::Surface, cli.max_degree, monitor, monitor.console())?;
        let frames = cli.frames.as_deref().map(|path| frames::read(path, &group.names)).transpose()?;
        let marks = landmarks::of_models(&cli.landmarks, &paths, &group.members, frames.as_deref(), monitor.console())?;
        let points = marks.as_ref().map(|marks| marks.points.as_slice());
        let found = group_quality(&group.members, points, &params, monitor)?;
        Ok((group, marks, found))
    })?;
    let names = marks.as_ref().map_or(&[][..], |marks| &marks.names);
    let warnings: Vec<&String> = group.warnings.iter().chain(marks.iter().flat_map(|marks| &marks.warnings)).collect();
    let whole = json!({
        "output": cli.output.as_ref().map(shown),
        "curves": cli.curves.as_ref().map(shown),
        "models": all_shown(&paths),
        "degree": group.degree,
        "directions": directions,
        "samples": cli.samples,
        "bands": cli.bands,
        "rigid": cli.rigid,
        "seed": cli.seed,
        "variance": found.variance,
        "variances": found.variances,
        "compactness": curve(&found.compactness),
        "generalisation": curve(&found.generalisation),
        "specificity": curve(&found.specificity),
        "surface_generalisation": found.surface_generalisation.as_ref().map(curve),
        "surface_specificity": found.surface_specificity.as_ref().map(curve),
        "landmarks": found.landmarks.as_ref().map(|errors| json!({
            "names": names,
            "mean": errors.mean,
            "median": errors.median,
            "band": errors.band,
            "by_landmark": errors.by_landmark,
            "off_surface": errors.off,
        })),
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    if let Some(path) = &cli.curves {
        prepare(path)?;
        let picture = render_curves(&panels(&found))?;
        write_png(path, &picture, &WriteOptions { overwrite: cli.force, double: false })?;
    }
    finish("quality", &whole, &rows(&found), &ReportArgs { report: cli.output.clone(), ..report })?;
    if let Some(errors) = &found.landmarks {
        let band = errors.band.map(|[low, high]| format!(" ({low:.3} to {high:.3})")).unwrap_or_default();
        let apart = format!("landmark error: mean {:.3}{band}, median {:.3}", errors.mean, errors.median);
        monitor.console().note(apart);
    }
    Ok(())
}

/// Returns, for each vertex of an icosphere, whether it is compared.
fn mask(path: &Path, subdivisions: u32) -> Result<Vec<bool>> {
    let sampling = masks::sampling(None, subdivisions);
    let remedy = "give a mask for an icosphere, and the icosphere's subdivisions with --icosphere";
    masks::read(path, &Sphere::icosphere(subdivisions), &sampling, remedy)
}

fn curve(curve: &Curve) -> Value {
    let band = |ends: &Vec<f64>| (!ends.is_empty()).then(|| ends.clone());
    json!({ "values": curve.values, "low": band(&curve.low), "high": band(&curve.high) })
}

/// Returns the printed table: each measure with its band.
fn rows(found: &GroupQuality) -> Vec<Vec<String>> {
    let mut names = vec!["modes", "compactness", "generalisation", "specificity"];
    if found.surface_generalisation.is_some() {
        names.extend(["generalisation (surface)", "specificity (surface)"]);
    }
    let mut rows: Vec<Vec<String>> = vec![names.into_iter().map(str::to_owned).collect()];
    let with_band = |curve: &Curve, k: usize, text: &dyn Fn(f64) -> String| {
        let band = curve.low.get(k).zip(curve.high.get(k));
        let band = band.map(|(low, high)| format!(" ({} to {})", text(*low), text(*high)));
        text(curve.values[k]) + &band.unwrap_or_default()
    };
    let (share, length) = (|value: f64| format!("{value:.3}"), |value: f64| format!("{value:.4}"));
    for k in 0..found.variances.len().min(20) {
        let mut row = vec![(k + 1).to_string(), with_band(&found.compactness, k, &share)];
        let lengths = [Some(&found.generalisation), Some(&found.specificity)];
        let surfaces = [found.surface_generalisation.as_ref(), found.surface_specificity.as_ref()];
        row.extend(lengths.into_iter().chain(surfaces).flatten().map(|curve| with_band(curve, k, &length)));
        rows.push(row);
    }
    rows
}

/// Returns the panels of the picture. Each panel has the curve measured at points and, if measured, the curve of
/// distances between surfaces.
fn panels(found: &GroupQuality) -> Vec<CurvePanel<'_>> {
    vec![
        panel("compactness, share of the variance", &found.compactness, None),
        panel("generalisation, distance", &found.generalisation, found.surface_generalisation.as_ref()),
        panel("specificity, distance", &found.specificity, found.surface_specificity.as_ref()),
    ]
}

fn panel<'a>(title: &'a str, points: &'a Curve, surfaces: Option<&'a Curve>) -> CurvePanel<'a> {
    let mut curves = vec![drawn("at equal directions", points)];
    curves.extend(surfaces.map(|curve| drawn("between surfaces", curve)));
    CurvePanel { title, x_label: "modes", curves }
}

fn drawn<'a>(label: &'a str, Curve { values, low, high }: &'a Curve) -> Drawn<'a> {
    Drawn { label, values, band: [low, high] }
}
