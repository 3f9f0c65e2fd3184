//! Reads the quality measures of a group written by `shape quality` and `shape correspond`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::Value;
use spharm::shape::Curve;
use spharm_cli::inputs::{MOST_OWN, read_text};
use spharm_monitor::number;
use spharm_report::{Quality, Table};

/// Reads the quality measures of alignments, each named after its file.
pub(super) fn quality(paths: &[PathBuf]) -> Result<Vec<Quality>> {
    paths.iter().map(|path| quality_of(path)).collect()
}

fn quality_of(path: &Path) -> Result<Quality> {
    let found = read(path, "shape quality", "spharm shape quality -o")?;
    let needed = |name: &str| {
        curve(&found[name]).with_context(|| format!("{}: expected numbers in {name}, found none", path.display()))
    };
    let landmarks = &found["landmarks"];
    Ok(Quality {
        name: path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
        variance: found["variance"].as_f64().unwrap_or(f64::NAN),
        compactness: needed("compactness")?,
        generalisation: needed("generalisation")?,
        specificity: needed("specificity")?,
        surface_generalisation: curve(&found["surface_generalisation"]),
        surface_specificity: curve(&found["surface_specificity"]),
        landmarks: mean_and_median(landmarks),
    })
}

fn mean_and_median(landmarks: &Value) -> Option<[f64; 2]> {
    Some([landmarks["mean"].as_f64()?, landmarks["median"].as_f64()?])
}

fn curve(value: &Value) -> Option<Curve> {
    let numbers = |key: &str| value[key].as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
    let of_band = |key| numbers(key).unwrap_or_default();
    Some(Curve { values: numbers("values")?, low: of_band("low"), high: of_band("high") })
}

/// Correspondence of a group, from the report of `shape correspond`.
pub(super) struct Correspondence {
    /// Table of the members with their coverage and, if the group has landmarks, table of the landmarks.
    pub(super) tables: Vec<Table>,
    /// Mean and median distance between a carried landmark and the member's own landmark.
    pub(super) landmarks: Option<[f64; 2]>,
}

/// Columns of the table of a group's members, each with its heading, the key of its values in the report, the factor by
/// which the values are multiplied, and the number of decimals.
const MEMBERS: [(&str, &str, f64, usize); 7] = [
    ("pose distance", "pose_distance", 1.0, 4),
    ("coverage, rms", "cover_rms", 1.0, 4),
    ("coverage, 99 %", "cover_most", 1.0, 4),
    ("coverage, largest", "cover_farthest", 1.0, 4),
    ("not reached, %", "unreached", 100.0, 2),
    ("points without a counterpart", "without_counterpart", 1.0, 0),
    ("model, rms", "model_rms", 1.0, 4),
];

pub(super) fn correspondence(path: &Path) -> Result<Correspondence> {
    let found = read(path, "shape correspond", "spharm shape correspond --report")?;
    let members = found["members"].as_array().map_or(&[][..], Vec::as_slice);
    let row = |member: &Value| {
        let of = &member["registration"];
        let cells = MEMBERS.iter().map(|(_, key, factor, decimals)| {
            of[*key].as_f64().map_or("–".to_owned(), |value| format!("{:.*}", *decimals, factor * value))
        });
        std::iter::once(member["name"].as_str().unwrap_or_default().to_owned()).chain(cells).collect()
    };
    let columns = std::iter::once("subject").chain(MEMBERS.iter().map(|(name, ..)| *name)).map(str::to_owned);
    let columns = columns.collect();
    let rows = members.iter().map(row).collect();
    let mut tables = vec![Table { title: "Correspondence".to_owned(), columns, rows, note: None }];
    let marks = &found["landmarks"];
    if let (Some(names), Some(means)) = (marks["names"].as_array(), marks["by_landmark"].as_array()) {
        let length = |value: &Value| value.as_f64().map_or("–".to_owned(), number);
        let left_out = marks["guide"]["left_out"].as_array();
        let row = |(index, (name, mean)): (usize, (&Value, &Value))| {
            let mut row = vec![name.as_str().unwrap_or_default().to_owned(), length(mean)];
            row.extend(left_out.map(|values| values.get(index).map_or("–".to_owned(), length)));
            row
        };
        let rows = names.iter().zip(means).enumerate().map(row).collect();
        let mut columns = vec![
            "landmark",
            "mean distance between the subject's own landmark and the same landmark carried from another subject",
        ];
        columns.extend(left_out.map(|_| "distance from the landmark's position in the group, if not used as a guide"));
        let columns = columns.into_iter().map(str::to_owned).collect();
        tables.push(Table { title: "Landmarks".to_owned(), columns, rows, note: None });
    }
    Ok(Correspondence { tables, landmarks: mean_and_median(marks) })
}

/// Reads a report, and checks that the verb `tool` wrote it.
pub(super) fn read(path: &Path, tool: &str, command: &str) -> Result<Value> {
    let text = read_text(path, "report", MOST_OWN)?;
    let value: Value = serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))?;
    if value["tool"] != tool {
        let found = value["tool"].as_str().map_or("another file".to_owned(), |tool| format!("a report of `{tool}`"));
        bail!("{}: expected a report of `{command}`, found {found}", path.display());
    }
    Ok(value)
}
