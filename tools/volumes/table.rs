//! The table that `volumes` writes, with a row for each label.

use std::collections::HashSet;
use std::ffi::OsString;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use spharm::model::Provenance;
use spharm::parametrize::volume::{ImageChoice, VoxelSteps};
use spharm::shape::{Descriptors, Measures};
use spharm_cli::inputs::read_text;
use spharm_cohort::cell;

/// Maximum size, in bytes, of a table from an earlier call that is read.
const LARGEST: u64 = 1 << 30;

/// A row of the table: a label, or a volume that couldn't be read.
#[derive(Clone)]
pub(super) struct Row {
    pub(super) file: String,
    pub(super) label: Option<i64>,
    pub(super) voxels: Option<usize>,
    /// Whether the label touches the border of the volume and so may be cut off.
    pub(super) border: Option<bool>,
    /// Total volume of the label's voxels, if the file contains labels rather than grey values or probabilities.
    pub(super) volume: Option<f64>,
    pub(super) outcome: Outcome,
}

impl Row {
    /// Returns the name of the label in warnings.
    pub(super) fn name(&self) -> String {
        self.label.map_or_else(|| self.file.clone(), |label| format!("{} label {label}", self.file))
    }
}

/// Outcome of a label.
#[derive(Clone)]
pub(super) enum Outcome {
    /// A model, made by this call or by an earlier call.
    Model(Box<Model>),
    /// No model was made; the text is the reason.
    Failed(String),
    /// The label was skipped; the text is the reason.
    Skipped(String),
}

impl Default for Outcome {
    fn default() -> Self {
        Self::Failed(String::new())
    }
}

/// Values of a model in its row of the table.
#[derive(Clone)]
pub(super) struct Model {
    pub(super) file: String,
    /// Whether the model was made by an earlier call.
    pub(super) kept: bool,
    /// Short description of the label's repairs and cuts; empty if there were none.
    pub(super) repair: String,
    /// Whether handles were cut.
    pub(super) cut: bool,
    /// Warning that the model resolves the steps between voxels; `None` if the model doesn't resolve them.
    pub(super) steps: Option<VoxelSteps>,
    pub(super) measures: Measures,
    /// Root mean square distance of the model from the surface's vertices.
    pub(super) residual: Option<f64>,
    pub(super) descriptors: Descriptors,
}

/// Columns that precede the columns for the image (channel and time) and for the powers of the degrees.
const COLUMNS: [&str; 16] = [
    "file",
    "label",
    "state",
    "border",
    "voxels",
    "repair",
    "volume",
    "area",
    "sphericity",
    "residual",
    "size",
    "centroid_x",
    "centroid_y",
    "centroid_z",
    "model",
    "error",
];

/// Returns the names and cells of the image's columns: `channel`, if a channel was chosen, and `time`, if a time was
/// chosen.
fn image_cells(image: ImageChoice) -> impl Iterator<Item = (&'static str, usize)> {
    let named = [("channel", image.channel), ("time", image.time)];
    named.into_iter().filter_map(|(name, number)| Some((name, number?)))
}

/// Text of a cell without a value, as in BIDS.
const NONE: &str = "n/a";

/// Returns the text of the table: one tab-separated line per row. The last columns are the powers of the degrees up to
/// `max_degree`.
pub(super) fn lines(rows: &[Row], image: ImageChoice, max_degree: usize) -> String {
    let lines = rows.iter().map(|row| cells(row, image, max_degree).join("\t") + "\n");
    std::iter::once(head(image, max_degree) + "\n").chain(lines).collect()
}

/// Converts a table to JSON: one object per row, in which numeric cells are numbers, cells without a value are null,
/// and the powers are one list.
pub(super) fn to_json(table: &str) -> Vec<Value> {
    let mut lines = table.lines().map(|line| line.split('\t'));
    let head: Vec<&str> = lines.next().into_iter().flatten().collect();
    let value = |name: &str, cell: &str| match (name, cell) {
        (_, NONE) => Value::Null,
        ("border", _) => json!(cell == "yes"),
        ("file" | "state" | "repair" | "model" | "error", _) => json!(cell),
        _ => serde_json::from_str(cell).unwrap_or(Value::Null),
    };
    let row = |cells: std::str::Split<'_, char>| {
        let mut row = serde_json::Map::new();
        let mut powers = Vec::new();
        for (name, cell) in head.iter().zip(cells) {
            match name.starts_with("power_") {
                true => powers.extend(cell.parse::<f64>().ok()),
                false => drop(row.insert((*name).to_owned(), value(name, cell))),
            }
        }
        row.insert("power".to_owned(), json!(powers));
        Value::Object(row)
    };
    lines.map(row).collect()
}

/// Converts a tab-separated table to the text of its file, with commas instead of tabs if the file's name ends in .csv.
pub(super) fn to_file(path: &Path, text: String) -> Result<String> {
    if !has_commas(path) {
        return Ok(text);
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    for line in text.lines() {
        writer.write_record(line.split('\t'))?;
    }
    Ok(String::from_utf8(writer.into_inner().map_err(|error| error.into_error())?)?)
}

/// Converts the text of a table's file to a tab-separated table.
fn of_file(path: &Path, text: String) -> Result<String> {
    if !has_commas(path) {
        return Ok(text);
    }
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(text.as_bytes());
    let line = |record: csv::Result<csv::StringRecord>| Ok(record?.iter().collect::<Vec<_>>().join("\t") + "\n");
    reader.records().map(line).collect::<csv::Result<_>>().with_context(|| path.display().to_string())
}

fn has_commas(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"))
}

/// Returns the header line of the table.
fn head(image: ImageChoice, max_degree: usize) -> String {
    let powers = (1..=max_degree).map(|degree| format!("power_{degree}"));
    let names = COLUMNS.into_iter().chain(image_cells(image).map(|(name, _)| name));
    names.map(str::to_owned).chain(powers).collect::<Vec<String>>().join("\t")
}

/// Returns whether a file is a table written by this verb without any model, so that replacing it loses no results.
pub(super) fn is_without_models(table: &Path) -> bool {
    let text = if table.is_file() { read(table).unwrap_or_default() } else { String::new() };
    text.starts_with("file\tlabel\tstate\t") && !has_models(&text)
}

/// Reads a table, and converts it to cells separated by tabs.
fn read(table: &Path) -> Result<String> {
    of_file(table, read_text(table, "table", LARGEST)?)
}

/// Reads the table that an earlier call wrote, which must have the columns that this call writes.
pub(super) fn earlier(table: &Path, image: ImageChoice, max_degree: Option<usize>) -> Result<String> {
    let text = read(table)?;
    let powers = powers(&text);
    let max_degree = max_degree.unwrap_or(powers);
    let (found, expected) = (text.lines().next().unwrap_or_default(), head(image, max_degree));
    if found != expected {
        if powers == max_degree {
            bail!(
                "{}: expected the columns of this version, with the given --channel and --time, found other columns; \
                 give --force, or another --output",
                table.display()
            );
        }
        bail!(
            "{}: expected the columns of degree {max_degree}, found those of degree {powers}; give --force, or another --output",
            table.display()
        );
    }
    Ok(text)
}

/// Returns the degree of a table's models, which is the number of columns with powers.
pub(super) fn powers(table: &str) -> usize {
    let head = table.lines().next().unwrap_or_default();
    head.split('\t').filter(|name| name.starts_with("power_")).count()
}

/// Returns whether a table has a row with a model.
pub(super) fn has_models(table: &str) -> bool {
    table.lines().any(|line| matches!(line.split('\t').nth(2), Some("fitted" | "kept")))
}

/// Returns the names of the files of a table's models.
pub(super) fn models(table: &str) -> HashSet<OsString> {
    let column = COLUMNS.iter().position(|name| *name == "model").unwrap_or_default();
    let cells = table.lines().skip(1).filter_map(|line| line.split('\t').nth(column));
    cells.filter(|cell| *cell != NONE).filter_map(|cell| Some(Path::new(cell).file_name()?.to_owned())).collect()
}

/// Appends the rows of an earlier table's models to `table`, except those whose file, label and image are already in
/// `table`. Both tables have the same columns.
pub(super) fn with_earlier(earlier: &str, table: &str, image: ImageChoice) -> String {
    fn key(line: &str, images: usize) -> Vec<&str> {
        let (cells, of_image) = (line.split('\t'), line.split('\t').skip(COLUMNS.len()));
        cells.take(2).chain(of_image.take(images)).collect()
    }
    let images = image_cells(image).count();
    let own: HashSet<Vec<&str>> = table.lines().map(|line| key(line, images)).collect();
    let kept = |line: &str| {
        let cells: Vec<&str> = line.splitn(4, '\t').collect();
        match cells[..] {
            [file, label, "fitted" | "kept", rest] => Some(format!("{file}\t{label}\tkept\t{rest}\n")),
            _ => None,
        }
    };
    table.to_owned()
        + &earlier.lines().filter(|line| !own.contains(&key(line, images))).filter_map(kept).collect::<String>()
}

fn cells(row: &Row, image: ImageChoice, max_degree: usize) -> Vec<String> {
    let or_none = |text: Option<String>| text.unwrap_or_else(|| NONE.to_owned());
    let number = |value: f64| format!("{value:?}");
    let (state, model, error) = match &row.outcome {
        Outcome::Model(model) => (if model.kept { "kept" } else { "fitted" }, Some(model), None),
        Outcome::Failed(error) => ("failed", None, Some(error)),
        Outcome::Skipped(reason) => ("skipped", None, Some(reason)),
    };
    let of = |value: fn(&Model) -> f64| or_none(model.map(|model| number(value(model))));
    let powers =
        (0..max_degree).map(|at| or_none(model.and_then(|m| m.descriptors.power.get(at).copied()).map(number)));
    let cells = [
        cell(&row.file),
        or_none(row.label.map(|label| label.to_string())),
        state.to_owned(),
        or_none(row.border.map(|cut| if cut { "yes" } else { "no" }.to_owned())),
        or_none(row.voxels.map(|voxels| voxels.to_string())),
        or_none(model.map(|model| if model.repair.is_empty() { "none".to_owned() } else { model.repair.clone() })),
        of(|model| model.measures.volume),
        of(|model| model.measures.area),
        of(|model| model.measures.sphericity),
        or_none(model.and_then(|model| model.residual).map(number)),
        of(|model| model.descriptors.size()),
        of(|model| model.measures.centroid[0]),
        of(|model| model.measures.centroid[1]),
        of(|model| model.measures.centroid[2]),
        or_none(model.map(|model| cell(&model.file))),
        or_none(error.map(|error| cell(error))),
    ];
    cells.into_iter().chain(image_cells(image).map(|(_, number)| number.to_string())).chain(powers).collect()
}

/// Returns the number of handles that were cut, as recorded in a model's provenance.
pub(super) fn handles_cut(provenance: &Provenance) -> u64 {
    provenance.handles.as_ref().and_then(|handles| handles["genus_before"].as_u64()).unwrap_or(0)
}

/// Returns a short description of the repairs and cuts recorded in a model's provenance.
pub(super) fn repair(provenance: &Provenance) -> String {
    let of = |name: &str| provenance.repair.as_ref().and_then(|repair| repair[name].as_u64()).unwrap_or(0);
    let cut = handles_cut(provenance);
    let counted = |count: u64, one: &str, many: &str| format!("{count} {}", if count == 1 { one } else { many });
    let voxels = |name: &str| counted(of(name), "voxel", "voxels");
    let handles = |count: u64| counted(count, "handle", "handles");
    let filled = provenance.repair.as_ref().is_some_and(|repair| repair["way"] == "filled");
    let way = if filled { "added" } else { "removed" };
    let pieces = counted(of("pieces_dropped"), "piece", "pieces");
    let cavities = counted(of("cavities_filled"), "cavity", "cavities");
    // A repair that only separates voxels that touch at edges or corners changes voxels, but removes no handle.
    let removed = match of("handles") {
        0 => "contacts at edges or corners".to_owned(),
        count => handles(count),
    };
    let parts = [
        (of("pieces_dropped"), format!("{pieces} dropped ({})", voxels("voxels_dropped"))),
        (of("cavities_filled"), format!("{cavities} filled ({})", voxels("voxels_filled"))),
        (of("voxels_changed"), format!("{removed} removed ({} {way})", voxels("voxels_changed"))),
        (cut, format!("{} cut", handles(cut))),
    ];
    parts.into_iter().filter(|(count, _)| *count > 0).map(|(_, text)| text).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns the row of a label with a model.
    pub(in super::super) fn fitted(label: i64, border: Option<bool>) -> Row {
        let measures = Measures {
            area: 1.0,
            area_change: 0.0,
            rings: 1,
            volume: 1.0,
            centroid: [0.0; 3],
            sphericity: 1.0,
            inwards: false,
            squeezed: 0.0,
            warnings: Vec::new(),
        };
        let model = Model {
            file: "a.npz".to_owned(),
            kept: false,
            repair: String::new(),
            cut: false,
            steps: None,
            measures,
            residual: None,
            descriptors: Descriptors { power: vec![1.0], singular_values: vec![1.0, 0.0, 0.0], channels: 3 },
        };
        let outcome = Outcome::Model(Box::new(model));
        Row { file: "a".to_owned(), label: Some(label), voxels: Some(1), border, volume: None, outcome }
    }

    #[test]
    fn every_row_has_every_cell() {
        let failed = Row {
            file: "a\tb.nii".to_owned(),
            label: Some(3),
            voxels: Some(8),
            border: Some(true),
            volume: None,
            outcome: Outcome::Failed("no\nball".to_owned()),
        };
        let text = lines(&[failed], ImageChoice::default(), 2);
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split('\t').collect()).collect();
        assert_eq!((lines.len(), lines[0].len(), lines[1].len()), (2, 18, 18));
        assert_eq!(lines[1][..5], ["a b.nii", "3", "failed", "yes", "8"]);
        assert_eq!(lines[1][15..], ["no ball", "n/a", "n/a"]);
        let json = &to_json(&text)[0];
        assert_eq!((&json["file"], &json["label"], &json["border"]), (&json!("a b.nii"), &json!(3), &json!(true)));
        assert!(json["volume"].is_null() && json["voxels"] == 8 && json["centroid_z"].is_null(), "{json}");
        assert!(json["power"] == json!([]) && json["error"] == "no ball", "{json}");
    }

    /// Rows of the same label at different times are different rows, and the table of an earlier run must have the same
    /// columns.
    #[test]
    fn rows_of_times_are_kept_apart() {
        let at = |time| ImageChoice { time: Some(time), ..ImageChoice::default() };
        let [first, third] = [1, 3].map(|time| lines(&[fitted(1, None), fitted(2, None)], at(time), 1));
        assert!(first.starts_with(&(COLUMNS.join("\t") + "\ttime\tpower_1\n")), "{first}");
        assert_eq!((&to_json(&first)[0]["time"], models(&first).len()), (&json!(1), 1));
        assert_eq!(with_earlier(&first, &third, at(3)).lines().count(), 1 + 2 + 2);
        assert_eq!(with_earlier(&first, &first, at(1)).lines().count(), 1 + 2);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.tsv");
        std::fs::write(&path, &first).unwrap();
        assert_eq!(earlier(&path, at(3), None).unwrap(), first);
        let error = earlier(&path, ImageChoice::default(), None).unwrap_err().to_string();
        assert!(error.contains("with the given --channel and --time, found other columns"), "{error}");
    }
}
