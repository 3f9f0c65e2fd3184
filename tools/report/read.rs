//! Reads the contents of a page from files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::Value;
use spharm::shape::pca::file::ShapeModel;
use spharm_cli::console::Console;
use spharm_cli::inputs::{expand_lists, read_text};
use spharm_cli::models::surface_file;
use spharm_cli::output::counted;
use spharm_cli::paths::{expand, model_name, shown};
use spharm_model::Model;
use spharm_report::{Maps, Shown, Table};
use spharm_surface::Mesh;
use spharm_surface::io::{read_mesh, read_signal};

use super::args::Cli;
use super::tested::{CLUSTERS, LARGEST_TABLE, SUMMARY, table};

/// Names of maps, in the order in which the page lists them; a test has only some of these maps.
const MAPS: [&str; 16] = [
    "effect",
    "effect-x",
    "effect-y",
    "effect-z",
    "statistic",
    "p-fwe",
    "p-tfce",
    "p-cluster",
    "q",
    "p",
    "p-permutation",
    "size",
    "margin",
    "tfce",
    "cluster",
    "value",
];
/// File in a test's folder that describes the test.
const ABOUT: &str = "test.json";
/// Maximum size in bytes of a report on fits; no report is larger.
const LARGEST_REPORT: u64 = 1 << 30;

/// Reads the models, each with its surface and its entry in the reports that `spharm fit` wrote.
pub(super) fn models(cli: &Cli, console: &Console) -> Result<Vec<Shown>> {
    if cli.models.is_empty() {
        return Ok(Vec::new());
    }
    let paths = expand(&cli.models, ".npz")?;
    let surfaces = expand_lists(&cli.surface)?;
    if !surfaces.is_empty() && surfaces.len() != paths.len() {
        let (models, surfaces) = (counted(paths.len(), "model"), counted(surfaces.len(), "surface"));
        bail!("expected a --surface for each model, in the same order; found {models} and {surfaces}");
    }
    let reports = cli.fit_report.iter().map(|path| report(path)).collect::<Result<Vec<_>>>()?;
    let one = |(k, path): (usize, &PathBuf)| {
        let model = Model::read(path)?;
        let surface = match surfaces.get(k) {
            Some(surface) => Some((surface.display().to_string(), read_mesh(surface)?)),
            None => fitted_to(&model, path, console),
        };
        let name = model_name(path);
        let fit = reports.iter().flatten().find(|entry| is_of(entry, path)).cloned();
        Ok(Shown { name, model, surface, fit })
    };
    for (report, entries) in cli.fit_report.iter().zip(&reports) {
        if !entries.iter().any(|entry| paths.iter().any(|path| is_of(entry, path))) {
            console.note(format!("{}: ignored, because the file reports fits of other models", report.display()));
        }
    }
    paths.iter().enumerate().map(one).collect()
}

/// Returns the surface to which a model was fitted, if its file still exists unchanged.
fn fitted_to(model: &Model, path: &Path, console: &Console) -> Option<(String, Mesh)> {
    let input = &model.provenance.input.as_ref()?.path;
    let read = surface_file(model, path).and_then(|file| match read_mesh(&file) {
        Ok(mesh) => Ok((shown(&file), mesh)),
        Err(error) => Err(error.to_string()),
    });
    let left_out = |why: String| {
        let model = path.display();
        console.note(format!(
            "{model}: shown without the original surface {input} ({why}); give the surface with --surface"
        ));
    };
    read.map_err(left_out).ok()
}

/// Reads the entries of a report of `spharm fit`.
fn report(path: &Path) -> Result<Vec<Value>> {
    let text = read_text(path, "report", LARGEST_REPORT)?;
    let value: Value = serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))?;
    match value.get("surfaces").and_then(Value::as_array) {
        Some(entries) => Ok(entries.clone()),
        None => bail!(
            "{}: expected a report written by `spharm fit --report`, found JSON without `surfaces`",
            path.display()
        ),
    }
}

/// Returns whether an entry of a fit's report describes this model: by the model's file or, if the entry has no file,
/// by the model's name.
fn is_of(entry: &Value, model: &Path) -> bool {
    let of = |key: &str| entry.get(key).and_then(Value::as_str);
    let file = |path: &Path| path.file_name().map(std::ffi::OsStr::to_owned);
    of("output").is_some_and(|output| Path::new(output) == model || file(Path::new(output)) == file(model))
}

/// Reads the modes of groups, each with a name for the page.
pub(super) fn modes(paths: &[PathBuf]) -> Result<Vec<(String, ShapeModel)>> {
    let name = |path: &Path| {
        let name = model_name(path);
        name.strip_suffix(".shape-model").map_or(name.clone(), str::to_owned)
    };
    paths.iter().map(|path| Ok((format!("{}: modes", name(path)), ShapeModel::read(path)?))).collect()
}

/// Reads the results of tests from folders that contain a mean surface and maps.
pub(super) fn tests(folders: &[PathBuf]) -> Result<Vec<Maps>> {
    folders.iter().map(|folder| test(folder)).collect()
}

fn test(folder: &Path) -> Result<Maps> {
    let mesh = folder.join("mean.surf.gii");
    if !mesh.is_file() {
        bail!(
            "{}: expected a folder written by `spharm shape test`, found no mean.surf.gii in this folder",
            folder.display()
        );
    }
    let mesh = read_mesh(mesh)?;
    let mut maps = Vec::new();
    for name in MAPS {
        let Some(path) = map_files(folder, name).into_iter().find(|path| path.is_file()) else { continue };
        let signal = read_signal(&path)?;
        if signal.channels != 1 || signal.vertices != mesh.vertices.len() {
            let (found, expected) = (signal.vertices * signal.channels, mesh.vertices.len());
            bail!(
                "{}: expected a value for each of the {expected} vertices of mean.surf.gii, found {found}",
                path.display()
            );
        }
        maps.push((name.to_owned(), signal.values));
    }
    if maps.is_empty() {
        bail!(
            "{}: expected maps written by `spharm shape test`, such as statistic.shape.gii; found none",
            folder.display()
        );
    }
    let name = folder.file_name().map_or_else(|| "test".to_owned(), |name| name.to_string_lossy().into_owned());
    let (meaning, about) = about(folder)?;
    Ok(Maps { name: format!("{name}: test"), meaning, about, mesh, maps })
}

/// Reads the description of a test from `test.json`. Returns the meaning of the tested effect, and the rows of the
/// page's table. There are no rows for a folder from an earlier version of spharm, which has no `test.json`.
fn about(folder: &Path) -> Result<(String, Vec<(String, String)>)> {
    let path = folder.join(ABOUT);
    if !path.is_file() {
        return Ok((String::new(), Vec::new()));
    }
    let text = read_text(&path, "description of a test", LARGEST_TABLE)?;
    let about: Value = serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))?;
    let text = |value: &Value| match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let list = |value: &Value| -> Vec<String> { value.as_array().into_iter().flatten().map(text).collect() };
    let meaning = match (about["tested"].as_str().unwrap_or_default(), about["of"].as_str()) {
        (tested, Some(of)) if !tested.is_empty() && !tested.contains(of) => format!("{of}: {tested}"),
        (tested, _) => tested.to_owned(),
    };
    let mut rows = Vec::new();
    let mut row = |name: &str, value: String| rows.push((name.to_owned(), value));
    let levels = about["levels"].as_array().into_iter().flatten();
    let levels: Vec<String> = levels.map(|of| format!("{} {}", text(&of["subjects"]), text(&of["level"]))).collect();
    let subjects = text(&about["subjects"]);
    row("Subjects", if levels.is_empty() { subjects } else { format!("{subjects}: {}", levels.join(", ")) });
    if let Some(signal) = about["signal"].as_str() {
        let what = match signal {
            "normal" => "displacement along the mean's normal",
            "position" => "position",
            _ => "value",
        };
        row("Measured", what.to_owned());
    }
    let covariates = list(&about["covariates"]);
    row("Accounted for", if covariates.is_empty() { "nothing".to_owned() } else { covariates.join(", ") });
    let by_group = about["welch"] == true || about["variance_groups"].is_string();
    let short = |number: f64| ((1e4 * number).round() / 1e4).to_string();
    let freedom: Vec<String> = match &about["statistic"]["freedom"] {
        Value::Array(both) => both.iter().filter_map(Value::as_f64).map(short).collect(),
        other => other.as_f64().map(short).into_iter().collect(),
    };
    let welch = if about["welch"] == true { "Welch's " } else { "" };
    let more = if by_group { " or more" } else { "" };
    let name = text(&about["statistic"]["name"]);
    row("Statistic", format!("{welch}{name}, {}{more} degrees of freedom", freedom.join(", ")));
    let shown = [("variance_groups", "Variances by"), ("mask", "Mask"), ("surface", "Shown on"), ("map", "Map of p")];
    for (key, name) in shown {
        // Several masks are recorded as a list, a single mask as a string.
        let values = about[key].as_str().map_or_else(|| list(&about[key]), |value| vec![value.to_owned()]);
        if !values.is_empty() {
            row(name, values.join(", "));
        }
    }
    if let Some(count) = about["without_counterpart"].as_u64().filter(|count| *count > 0) {
        row("Left out", format!("vertices without a counterpart on the members of the group: {count}"));
    }
    if let Some(blocks) = about["blocks"].as_str() {
        let how = if about["whole_blocks"] == true { "whole blocks are exchanged" } else { "exchanges within blocks" };
        row("Blocks", format!("{blocks}: {how}"));
    }
    if let Some(count) = about["relabellings"].as_u64() {
        row("Relabellings", format!("{count}, {}", if about["exact"] == true { "all of them" } else { "random" }));
    }
    if let Some(assumption) = about["assumption"].as_str() {
        row("p-fwe assumes", assumption.to_owned());
    }
    if let Some(level) = about["level"].as_f64() {
        row("Level", level.to_string());
    }
    list(&about["warnings"]).into_iter().for_each(|warning| row("Warning", warning));
    Ok((meaning, rows))
}

/// Returns the paths of a map in the formats that `spharm shape test` writes.
fn map_files(folder: &Path, name: &str) -> [PathBuf; 2] {
    ["shape.gii", "mgh"].map(|ending| folder.join(format!("{name}.{ending}")))
}

/// Returns the paths of a test's files, whether or not they exist.
pub(super) fn files(folder: &Path) -> Vec<PathBuf> {
    let maps = MAPS.iter().flat_map(|name| map_files(folder, name));
    maps.chain(["mean.surf.gii", ABOUT, SUMMARY, CLUSTERS].map(|name| folder.join(name))).collect()
}

/// Reads tables with a header.
pub(super) fn tables(paths: &[PathBuf]) -> Result<Vec<Table>> {
    paths.iter().map(|path| table(path)).collect()
}

/// Reads the methods paragraph of a study, and returns it as paragraphs for the page.
pub(super) fn methods(path: &Path) -> Result<Vec<String>> {
    let text = read_text(path, "methods paragraph", LARGEST_TABLE)?;
    let lines = text.split("\n\n").flat_map(|part| match part.starts_with("- ") {
        true => part.lines().map(str::to_owned).collect(),
        false => vec![part.replace('\n', " ")],
    });
    Ok(lines.filter(|line| !line.trim().is_empty()).collect())
}

/// Reads the provenance of a study, as rows of a table.
pub(super) fn provenance(path: &Path) -> Result<Vec<(String, String)>> {
    let text = read_text(path, "provenance", LARGEST_REPORT)?;
    let made: Value = serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))?;
    let Some(version) = made["versions"]["spharm"].as_str() else {
        bail!(
            "{}: expected a provenance.json written by `spharm study`, found JSON without `versions`",
            path.display()
        );
    };
    let table = &made["table"];
    let named = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let inputs = made["inputs"].as_array().map_or(0, Vec::len);
    let mut rows = vec![
        ("Version".to_owned(), version.to_owned()),
        ("Study".to_owned(), named(&made["file"])),
        ("Table".to_owned(), format!("{}, BLAKE3 {}", named(&table["path"]), named(&table["blake3"]))),
        ("Inputs".to_owned(), format!("{}, with hashes in {}", counted(inputs, "file"), shown(path))),
        ("Threads".to_owned(), made["threads"].to_string()),
    ];
    let commands = made["commands"].as_array().into_iter().flatten().enumerate();
    rows.extend(commands.map(|(at, command)| (format!("Command {}", at + 1), named(command))));
    Ok(rows)
}
