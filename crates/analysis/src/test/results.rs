//! Formats the results of a test: the maps, their table, and the summary as printed and as JSON.

use clap::ValueEnum;
use serde_json::{Value, json};
use spharm::Sphere;
use spharm::shape::stats::{FamilyWise, Statistic, Test};
use spharm_cli::paths::shown;
use spharm_monitor::number;

use super::super::masks::is_group;
use super::super::outputs::{csv, exact};
use super::args::Cli;
use super::places::Places;
use super::question::Study;
use super::regions;

/// Names of all maps that a test may write.
pub(super) const MAPS: [&str; 18] = [
    "statistic",
    "p",
    "q",
    "p-fwe",
    "p-permutation",
    "tfce",
    "p-tfce",
    "cluster",
    "p-cluster",
    "effect",
    "margin",
    "effect-x",
    "margin-x",
    "effect-y",
    "margin-y",
    "effect-z",
    "margin-z",
    "size",
];

/// Returns the maps to write, by name, at all vertices. Masked vertices have statistics and effects of 0, and p values
/// of 1.
pub(super) fn maps(found: &Test, mask: Option<&[bool]>) -> Vec<(&'static str, Vec<f64>)> {
    let mut maps = tested_maps(found);
    for (name, values) in &mut maps {
        let Some(mask) = mask else { break };
        let left_out = if *name == "q" || *name == "p" || name.starts_with("p-") { 1.0 } else { 0.0 };
        let mut tested = std::mem::take(values).into_iter();
        *values = mask.iter().map(|kept| if *kept { tested.next().unwrap_or(left_out) } else { left_out }).collect();
    }
    maps
}

/// Returns the maps at the tested vertices only, that is, without the masked vertices.
fn tested_maps(found: &Test) -> Vec<(&'static str, Vec<f64>)> {
    let mut maps = vec![("statistic", found.statistic.clone()), ("p", found.p.clone()), ("q", found.q.clone())];
    if let Some(family_wise) = &found.family_wise {
        maps.push(("p-fwe", family_wise.p.clone()));
        maps.push(("p-permutation", family_wise.pointwise.clone()));
        maps.extend(regions::maps(family_wise));
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

/// Returns the description of a test that pages show, for `test.json`. The same study always gives the same
/// description.
pub(super) fn about(found: &Test, study: &Study, cli: &Cli, places: &Places<'_>, warnings: &[String]) -> Value {
    let question = &study.question;
    let levels = question.levels.iter().map(|(level, count)| json!({ "level": level, "subjects": count }));
    json!({
        "tested": question.meaning,
        "of": study.of,
        "contrasts": cli.contrast,
        "columns": question.design.names(),
        "signal": cli.signal.to_possible_value().map(|value| value.get_name().to_owned()),
        "subjects": question.design.subjects(),
        "pairs": study.pairs(),
        "levels": levels.collect::<Vec<_>>(),
        "covariates": study.covariates,
        "numbers_that_may_be_codes": codes(study),
        "statistic": kind_of(&found.kind, cli),
        "welch": cli.welch,
        "blocks": cli.blocks,
        "whole_blocks": cli.whole_blocks,
        "variance_groups": cli.variance_groups,
        "relabellings": relabellings(found),
        "exact": found.family_wise.as_ref().map(|found| found.exact),
        "resampling": found.family_wise.as_ref().map(|found| found.resampling.name()),
        "assumption": found.family_wise.as_ref().map(|found| found.resampling.assumption()),
        "level": cli.level,
        "vertices": found.p.len(),
        "mask": masks_of(cli),
        "surface": cli.surface.as_ref().map(shown),
        "tfce": cli.tfce,
        "cluster": cli.cluster,
        "map": map_of(found),
        "annotation": cli.annotation.as_ref().map(shown),
        "summary": summary(found, cli.level),
        "peak": places.peak(&found.statistic),
        "warnings": warnings,
    })
}

/// Returns the complete report on a test.
pub(super) fn report(found: &Test, study: &Study, cli: &Cli, degree: usize, warnings: &[String]) -> Value {
    let question = &study.question;
    let levels = question.levels.iter().map(|(level, count)| json!({ "level": level, "subjects": count }));
    let models = study.paths.iter().map(|path| path.display().to_string());
    json!({
        "models": models.collect::<Vec<_>>(),
        "pairs": study.pairs,
        "degree": degree,
        "meaning": question.meaning,
        "levels": levels.collect::<Vec<_>>(),
        "numbers_that_may_be_codes": codes(study),
        "design": { "columns": question.design.names(), "rows": rows_of(question.design.matrix()) },
        "contrast": rows_of(question.contrast.weights.view()),
        "statistic": kind_of(&found.kind, cli),
        "welch": cli.welch,
        "blocks": cli.blocks,
        "whole_blocks": cli.whole_blocks,
        "variance_groups": cli.variance_groups,
        "vertices": found.p.len(),
        "mask": masks_of(cli),
        "surface": cli.surface.as_ref().map(shown),
        "relabellings": relabellings(found),
        "exact": found.family_wise.as_ref().map(|found| found.exact),
        "resampling": found.family_wise.as_ref().map(|found| found.resampling.name()),
        "assumption": found.family_wise.as_ref().map(|found| found.resampling.assumption()),
        "smallest_p_possible": found.family_wise.as_ref().map(|found| found.floor),
        "seed": cli.seed,
        "summary": summary(found, cli.level),
        "folder": cli.output.display().to_string(),
        "warnings": warnings,
    })
}

/// Returns the paths of the masks, except masks that are groups.
fn masks_of(cli: &Cli) -> Vec<String> {
    cli.mask.iter().filter(|path| !is_group(path)).map(shown).collect()
}

/// Returns the name of the map of p values that pages and figures show.
fn map_of(found: &Test) -> &'static str {
    match &found.family_wise {
        Some(family_wise) if family_wise.tfce.is_some() => "p-tfce",
        Some(_) => "p-fwe",
        None => "q",
    }
}

fn relabellings(found: &Test) -> Option<usize> {
    found.family_wise.as_ref().map(|found| found.relabellings)
}

/// Returns the columns of numbers that may be codes of levels, with their values.
fn codes(study: &Study) -> Vec<Value> {
    study.question.codes.iter().map(|(column, values)| json!({ "column": column, "values": values })).collect()
}

fn rows_of(matrix: ndarray::ArrayView2<'_, f64>) -> Vec<Vec<f64>> {
    matrix.rows().into_iter().map(|row| row.to_vec()).collect()
}

/// Returns the names of the statistics for one contrast and for several. With variances by group, the statistics are
/// Aspin and Welch's v and G instead of t and F.
fn statistic_names(cli: &Cli) -> [&'static str; 2] {
    if cli.variance_groups.is_some() { ["v", "G"] } else { ["t", "F"] }
}

fn kind_of(kind: &Statistic, cli: &Cli) -> Value {
    let [t, f] = statistic_names(cli);
    match *kind {
        Statistic::T { freedom } => json!({ "name": t, "freedom": freedom }),
        Statistic::F { between, within } => json!({ "name": f, "freedom": [between, within] }),
        Statistic::TSquared { components, freedom } => {
            json!({ "name": "T2", "components": components, "freedom": freedom })
        }
        _ => Value::Null,
    }
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn below(values: &[f64], level: f64) -> usize {
    values.iter().filter(|p| **p <= level).count()
}

fn summary(found: &Test, level: f64) -> Value {
    let of = |values: &[f64]| json!({ "least": least(values), "vertices": below(values, level) });
    json!({
        "level": level,
        "largest": found.statistic.iter().fold(0.0_f64, |most, value| most.max(value.abs())),
        "p": of(&found.p),
        "q": of(&found.q),
        "p_fwe": found.family_wise.as_ref().map(|found| of(&found.p)),
        "p_tfce": found.family_wise.as_ref().and_then(|found| found.tfce.as_ref()).map(|found| of(&found.p)),
        "clusters": found.family_wise.as_ref().and_then(|found| regions::summary(found, level)),
    })
}

/// Returns the rows of the printed table.
pub(super) fn lines(found: &Test, study: &Study, cli: &Cli) -> Vec<Vec<String>> {
    let Study { question, covariates, .. } = study;
    let pair = |name: &str, value: String| vec![name.to_owned(), value];
    let largest = found.statistic.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let [t, f] = statistic_names(cli);
    // With variances by group, the degrees of freedom differ between vertices.
    let freedom_of = |freedom: f64| match cli.variance_groups.is_some() || cli.welch {
        true => format!("{freedom:.1} or more"),
        false => format!("{freedom:.0}"),
    };
    let (name, freedom) = match found.kind {
        Statistic::T { freedom } => (format!("|{t}|"), freedom_of(freedom)),
        Statistic::F { between, within } => (f.to_owned(), format!("{between:.0}, {}", freedom_of(within))),
        Statistic::TSquared { freedom, .. } => ("T-squared".to_owned(), format!("{freedom:.0}")),
        _ => ("statistic".to_owned(), String::new()),
    };
    let count = |values: &[f64]| {
        let share = below(values, cli.level);
        format!("{}; at most {} at {share} of {} vertices", number(least(values)), cli.level, values.len())
    };
    let mut lines = vec![
        pair("tested", question.meaning.clone()),
        pair("accounted for", if covariates.is_empty() { "nothing".to_owned() } else { covariates.join(", ") }),
        match &study.blocks {
            Some(blocks) => pair("rows", format!("{} in {} blocks", blocks.observations(), blocks.count())),
            None => pair("subjects", question.design.subjects().to_string()),
        },
        pair(&format!("largest {name}"), format!("{} with {freedom} degrees of freedom", number(largest))),
        pair("least p", count(&found.p)),
        pair("least q", count(&found.q)),
    ];
    if let Some(family_wise) = &found.family_wise {
        let FamilyWise { p, resampling, relabellings, exact, .. } = family_wise;
        let which = if *exact { "all of them" } else { "random" };
        lines.push(pair("relabellings", format!("{relabellings}, {which}: {}", resampling.name())));
        lines.push(pair("assumed", resampling.assumption().to_owned()));
        lines.push(pair("least family-wise p", count(p)));
        lines.extend(regions::lines(family_wise, cli.level, count));
    }
    lines.push(pair("maps", cli.output.display().to_string()));
    lines
}

/// Returns the maps as CSV, with a row for each tested vertex.
pub(super) fn table(sphere: &Sphere, maps: &[(&str, Vec<f64>)], mask: Option<&[bool]>) -> String {
    let header: Vec<&str> =
        ["vertex", "ux", "uy", "uz"].into_iter().chain(maps.iter().map(|(name, _)| *name)).collect();
    let rows: Vec<Vec<String>> = sphere
        .directions
        .as_slice()
        .iter()
        .enumerate()
        .filter(|(v, _)| mask.is_none_or(|mask| mask[*v]))
        .map(|(v, u)| {
            let numbers = u.iter().copied().chain(maps.iter().map(|(_, values)| values[v])).map(exact);
            std::iter::once(v.to_string()).chain(numbers).collect()
        })
        .collect();
    csv(&header, rows.iter().map(Vec::as_slice))
}
