//! The table of all labels.

use std::collections::HashSet;

use spharm::shape::{Descriptors, Measures};

/// A label, or a volume that couldn't be read.
pub(super) struct Row {
    pub(super) file: String,
    pub(super) label: Option<i64>,
    pub(super) voxels: Option<usize>,
    /// Whether the label reaches the border of the volume, which may have cut it.
    pub(super) border: Option<bool>,
    pub(super) outcome: Outcome,
}

/// What became of it.
pub(super) enum Outcome {
    /// Fitted now, or by an earlier call.
    Model(Box<Model>),
    /// Not fitted, and why.
    Failed(String),
}

/// What the table has of a model.
pub(super) struct Model {
    pub(super) file: String,
    /// Whether an earlier call made it.
    pub(super) kept: bool,
    pub(super) measures: Measures,
    /// Root mean square distance at the surface's vertices.
    pub(super) residual: Option<f64>,
    pub(super) descriptors: Descriptors,
}

const COLUMNS: [&str; 12] = [
    "file",
    "label",
    "state",
    "border",
    "voxels",
    "volume",
    "area",
    "sphericity",
    "residual",
    "size",
    "model",
    "error",
];

/// What a cell without a value has, as in BIDS.
const NONE: &str = "n/a";

/// Text of the table: a line a row, tabs between cells, the powers of the degrees up to `max_degree` last.
pub(super) fn text(rows: &[Row], max_degree: usize) -> String {
    let lines = rows.iter().map(|row| cells(row, max_degree).join("\t") + "\n");
    std::iter::once(head(max_degree) + "\n").chain(lines).collect()
}

/// The table's first line.
pub(super) fn head(max_degree: usize) -> String {
    let powers = (1..=max_degree).map(|degree| format!("power_{degree}"));
    let head: Vec<String> = COLUMNS.iter().map(|&name| name.to_owned()).chain(powers).collect();
    head.join("\t")
}

/// A table of the same columns with the models of an earlier one whose file and label it doesn't have, after its own.
pub(super) fn with_earlier(earlier: &str, table: &str) -> String {
    fn key(line: &str) -> Vec<&str> {
        line.splitn(3, '\t').take(2).collect()
    }
    let own: HashSet<Vec<&str>> = table.lines().map(key).collect();
    let kept = |line: &str| {
        let cells: Vec<&str> = line.splitn(4, '\t').collect();
        match cells[..] {
            [file, label, "fitted" | "kept", rest] => Some(format!("{file}\t{label}\tkept\t{rest}\n")),
            _ => None,
        }
    };
    table.to_owned() + &earlier.lines().filter(|line| !own.contains(&key(line))).filter_map(kept).collect::<String>()
}

fn cells(row: &Row, max_degree: usize) -> Vec<String> {
    let or_none = |text: Option<String>| text.unwrap_or_else(|| NONE.to_owned());
    let number = |value: f64| format!("{value:?}");
    let (model, error) = match &row.outcome {
        Outcome::Model(model) => (Some(model), None),
        Outcome::Failed(error) => (None, Some(error)),
    };
    let state = model.map_or("failed", |model| if model.kept { "kept" } else { "fitted" });
    let of = |value: fn(&Model) -> f64| or_none(model.map(|model| number(value(model))));
    let powers =
        (0..max_degree).map(|at| or_none(model.and_then(|m| m.descriptors.power.get(at).copied()).map(number)));
    let cells = [
        plain(&row.file),
        or_none(row.label.map(|label| label.to_string())),
        state.to_owned(),
        or_none(row.border.map(|cut| if cut { "yes" } else { "no" }.to_owned())),
        or_none(row.voxels.map(|voxels| voxels.to_string())),
        of(|model| model.measures.volume),
        of(|model| model.measures.area),
        of(|model| model.measures.sphericity),
        or_none(model.and_then(|model| model.residual).map(number)),
        of(|model| model.descriptors.size()),
        or_none(model.map(|model| plain(&model.file))),
        or_none(error.map(|error| plain(error))),
    ];
    cells.into_iter().chain(powers).collect()
}

/// A text without what would end its cell.
fn plain(text: &str) -> String {
    text.replace(|c: char| c.is_control(), " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_every_cell() {
        let failed = Row {
            file: "a\tb.nii".to_owned(),
            label: Some(3),
            voxels: Some(8),
            border: Some(true),
            outcome: Outcome::Failed("no\nball".to_owned()),
        };
        let text = text(&[failed], 2);
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split('\t').collect()).collect();
        assert_eq!((lines.len(), lines[0].len(), lines[1].len()), (2, 14, 14));
        assert_eq!(lines[1][..5], ["a b.nii", "3", "failed", "yes", "8"]);
        assert_eq!(lines[1][11..], ["no ball", "n/a", "n/a"]);
    }
}
