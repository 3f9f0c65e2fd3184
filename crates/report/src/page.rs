//! Creates the page: a single self-contained HTML file.
//!
//! The content security policy in the page's head allows only the page's own script and style sheet, by their hashes,
//! so that names from files can't inject code.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use sha2::{Digest, Sha256};
use spharm_monitor::{Monitor, Stage};
use spharm_surface::metrics::{DIVERGING, viridis};

use crate::ReportError;
use crate::assets::{STYLE, VIEW, WASM, script};
use crate::blocks::Blocks;
use crate::check;
use crate::contents::{Contents, Params, Shown};
use crate::curves::{convergence, detail, spectrum};
use crate::maps_item::{self, MapsItem};
use crate::model_item::{Made, ModelItem};
use crate::modes_item::ModesItem;
use crate::provenance;
use crate::quality;
use crate::table::{Table, pairs};
use crate::text::{escape, json, name, number};

/// Data that the page's script reads.
#[derive(Serialize)]
struct Info<'a> {
    items: &'a [Item],
    /// Colours of the colour map viridis, at equal steps.
    viridis: Vec<[u8; 3]>,
    diverging: [[u8; 3]; 9],
}

#[derive(Serialize)]
#[serde(untagged)]
enum Item {
    Model(ModelItem),
    Modes(ModesItem),
    Maps(MapsItem),
}

/// Returns the page as HTML. Equal contents give identical bytes.
///
/// # Errors
///
/// [`ReportError`] if there are no contents, a model isn't a model of a surface, maps don't match their mesh, or the
/// monitor cancels ([`ReportError::Surface`]).
pub fn page(contents: &Contents, params: Params, monitor: &dyn Monitor) -> Result<String, ReportError> {
    let Contents { title, warnings, check, tests, models, modes, quality: measured, tables, version, .. } = contents;
    if [models.len(), modes.len(), tests.len(), measured.len(), tables.len()] == [0; 5] && check.is_none() {
        return Err(ReportError::Empty);
    }
    let (mut blocks, mut items, mut sections) = (Blocks::default(), Vec::new(), String::new());
    // If the page has a single item with the same name as the page, the item has no heading of its own.
    let alone = models.len() + modes.len() + tests.len() == 1;
    let mut section = |name: &str, still: &[u8], details: &str| {
        let heading = if alone && name == title.as_str() { None } else { Some(name) };
        sections += &item(heading, name, still, details);
    };
    for test in tests {
        let (item, still) = MapsItem::new(test, params.max_vertices, &mut blocks)?;
        section(&test.name, &still, &pairs("Maps", &maps_item::rows(test)));
        items.push(Item::Maps(item));
    }
    monitor.begin(Stage::counted("page", "models"), models.len() as u64);
    let mut errors = Vec::new();
    for shown in models {
        let Made { item, still, errors: of_model } = ModelItem::make(shown, params.max_vertices, &mut blocks, monitor)?;
        section(&shown.name, &still, &details(shown));
        items.push(Item::Model(item));
        errors.push(of_model);
        monitor.step(1);
    }
    monitor.end();
    for (name, shapes) in modes {
        let (item, still) = ModesItem::new(name, shapes, params.max_vertices, &mut blocks)?;
        section(name, &still, &spectrum_of_variance(shapes));
        items.push(Item::Modes(item));
    }
    let mut rows = quality::section(measured)?;
    if models.len() > 1 {
        // The page's script turns the names in this table into buttons.
        rows += &models_table(models, &errors).html()?.replace("class=\"sortable\"", "class=\"sortable models\"");
    }
    for table in tables {
        rows += &table.html()?;
    }
    rows += &origin(contents);

    let stops = (0..=16).map(|i| viridis(f64::from(i) / 16.0)).collect();
    let info = json(&Info { items: &items, viridis: stops, diverging: DIVERGING })?;
    let script = script()?;
    let policy = format!(
        "default-src 'none'; script-src '{}' 'wasm-unsafe-eval'; style-src '{}'; img-src data:; base-uri 'none'; \
         form-action 'none'",
        hash(&script),
        hash(STYLE)
    );
    let view = if items.is_empty() { "" } else { VIEW };
    let (heading, warnings) = (escape(title), warning_list(warnings));
    let check = check.as_ref().map(check::section).transpose()?.unwrap_or_default();
    let summary = if alone && tables.is_empty() && measured.is_empty() { String::new() } else { summary(contents) };
    let version = escape(version);
    let (wasm, data) = (STANDARD.encode(WASM), blocks.html());
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{heading}</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n<header><h1><bdi>{heading}</bdi></h1><p>{summary}</p></header>\n<main>\n{warnings}{check}{view}\n\
         <div id=\"items\">\n{sections}</div>\n{rows}</main>\n\
         <footer>spharm {version}. Drawn with three.js (MIT licence).</footer>\n\
         <script type=\"application/json\" id=\"info\">{info}</script>\n\
         <script type=\"application/octet-stream\" id=\"wasm\">{wasm}</script>\n{data}<script>{script}</script>\n</body>\n</html>\n"
    ))
}

/// Returns the sections on methods and provenance.
fn origin(contents: &Contents) -> String {
    let (cited, said): (Vec<&String>, Vec<&String>) = contents.methods.iter().partition(|text| text.starts_with("- "));
    let said: String = said.iter().map(|text| format!("<p>{}</p>\n", escape(text))).collect();
    let cited: String = cited.iter().map(|text| format!("<li>{}</li>\n", escape(&text[2..]))).collect();
    let cited = if cited.is_empty() { cited } else { format!("<ul>\n{cited}</ul>\n") };
    let methods = match said.is_empty() && cited.is_empty() {
        true => String::new(),
        false => format!("<section class=\"methods\"><h2>Methods</h2>\n{said}{cited}</section>\n"),
    };
    let provenance = match contents.provenance.is_empty() {
        true => String::new(),
        false => format!("<section class=\"methods\">{}</section>\n", pairs("Provenance", &contents.provenance)),
    };
    methods + &provenance
}

/// Returns the list of warnings at the top of the page.
fn warning_list(warnings: &[String]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let rows: String = warnings.iter().map(|warning| format!("<li><bdi>{}</bdi></li>\n", escape(warning))).collect();
    let count = warnings.len();
    let heading = if count == 1 { "1 warning".to_owned() } else { format!("{count} warnings") };
    format!("<section class=\"warnings\" aria-label=\"Warnings\"><h2>{heading}</h2>\n<ul>\n{rows}</ul></section>\n")
}

/// Returns a hash in the form used by content security policies.
fn hash(text: &str) -> String {
    format!("sha256-{}", STANDARD.encode(Sha256::digest(text.as_bytes())))
}

/// Returns the HTML of an item with a picture. The page's script creates the view, which replaces the picture.
fn item(heading: Option<&str>, title: &str, still: &[u8], details: &str) -> String {
    let png = STANDARD.encode(still);
    let heading = heading.map_or_else(String::new, |heading| format!("<h2>{}</h2>", name(heading)));
    format!(
        "<section class=\"item\">{heading}\n<figure class=\"still\"><img alt=\"{}\" src=\"data:image/png;base64,{png}\">\
         </figure>\n<div class=\"details\">{details}</div></section>\n",
        escape(&format!("Picture of {title}"))
    )
}

/// Returns the charts and the provenance of a model as HTML.
fn details(shown: &Shown) -> String {
    let coefficients = &shown.model.coefficients;
    let charts = [spectrum(coefficients), detail(coefficients), shown.fit.as_ref().and_then(convergence)];
    let mut html: String = charts.into_iter().flatten().collect();
    let mut rows = provenance::rows(&shown.model);
    if let Some((surface, _)) = &shown.surface {
        rows.insert(0, ("Compared with".to_owned(), surface.clone()));
    }
    html += &pairs("Provenance", &rows);
    html
}

/// Returns a table with the group's size, its variance, and the fraction of the variance along each mode.
fn spectrum_of_variance(shapes: &spharm_shape::pca::file::ShapeModel) -> String {
    let total = shapes.modes.total_variance;
    let (shares, cumulative) = (shapes.modes.shares(), shapes.modes.compactness());
    let row = |(k, variance): (usize, &f64)| {
        let [share, cumulative] = [shares[k], cumulative[k]].map(|share| 100.0 * share);
        let deviation = number(variance.sqrt());
        (
            format!("Mode {}", k + 1),
            format!("{share:.1} % of the variance, {cumulative:.1} % cumulative; standard deviation {deviation}"),
        )
    };
    let mut rows = vec![
        ("Members".to_owned(), shapes.members.len().to_string()),
        ("Total variance, length²".to_owned(), number(total)),
    ];
    rows.extend(shapes.modes.variances.iter().take(10).enumerate().map(row));
    pairs("Modes", &rows)
}

/// Returns the table that compares the models of the page.
fn models_table(models: &[Shown], errors: &[Option<[f64; 2]>]) -> Table {
    let columns = ["model", "degree", "method", "msd", "xsd", "rms error", "largest error"];
    let row = |(shown, errors): (&Shown, &Option<[f64; 2]>)| {
        let made = &shown.model.provenance;
        let fitted = made.distances.as_ref();
        let cell = |value: Option<f64>| value.map_or("–".to_owned(), number);
        let raw = fitted.map(|d| [d.rms(), d.max()]);
        let errors = errors.or(raw);
        vec![
            shown.name.clone(),
            shown.model.coefficients.max_degree().to_string(),
            made.settings.as_ref().map_or("–".to_owned(), |settings| settings.method.clone()),
            cell(fitted.and_then(|d| d.msd)),
            cell(fitted.and_then(|d| d.xsd)),
            cell(errors.map(|e| e[0])),
            cell(errors.map(|e| e[1])),
        ]
    };
    Table {
        title: "Models".to_owned(),
        columns: columns.map(str::to_owned).to_vec(),
        rows: models.iter().zip(errors).map(row).collect(),
        note: None,
    }
}

fn summary(contents: &Contents) -> String {
    let counted = |count: usize, one: &str, more: &str| match count {
        0 => None,
        1 => Some(format!("1 {one}")),
        _ => Some(format!("{count} {more}")),
    };
    let rows = contents.tables.iter().map(|table| table.rows.len()).sum();
    let parts = [
        counted(contents.tests.len(), "test", "tests"),
        counted(contents.models.len(), "model", "models"),
        counted(contents.modes.len(), "set of modes", "sets of modes"),
        counted(contents.quality.len(), "compared alignment", "compared alignments"),
        counted(rows, "table row", "table rows"),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}
