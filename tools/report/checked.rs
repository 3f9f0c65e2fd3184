//! Reads the quality-control report that `shape check` writes for a group.

use std::path::Path;

use anyhow::Result;
use serde_json::Value;
use spharm::shape::outliers::FAR;
use spharm_cohort::check::Measure;
use spharm_cohort::check_id;
use spharm_monitor::number;
use spharm_report::{Check, CheckedCell, CheckedSubject};

use super::measured;

/// Columns of the page's table, each with its heading, the key of its values in the report, the key of their robust z
/// scores (empty if there are none), and the factor by which the values are multiplied.
const COLUMNS: [(&str, &str, &str, f64); 13] = [
    ("volume", "volume", "volume_z", 1.0),
    ("area", "area", "area_z", 1.0),
    ("sphericity", "sphericity", "sphericity_z", 1.0),
    ("rms between surfaces", "rms", "rms_z", 1.0),
    ("rms, voxels", "rms_by_voxel", "", 1.0),
    ("rms, % of the size", "rms_by_size", "", 100.0),
    ("distance from the mean", "distance", "distance_z", 1.0),
    ("farthest mode", "mode", "mode_z", 1.0),
    ("robust z along it", "mode_z", "mode_z", 1.0),
    ("voxel, mm", "voxel_size", "", 1.0),
    ("repair", "repair", "", 1.0),
    ("handles cut", "handles", "", 1.0),
    ("remarks", "remarks", "", 1.0),
];
/// Maximum size of a picture in bytes; thumbnails are far smaller.
const LARGEST_PICTURE: u64 = 1 << 20;

/// Reads the table of subjects, each with its picture if the picture exists. Columns without any values are omitted.
pub(super) fn read(path: &Path, pictures: Option<&Path>) -> Result<Check> {
    let found = measured::read(path, "shape check", "spharm shape check --report")?;
    let subjects = found["subjects"].as_array().map_or(&[][..], Vec::as_slice);
    let has_values =
        |key: &str| subjects.iter().any(|subject| !matches!(subject[key], Value::Null) && subject[key] != 0);
    let columns: Vec<_> = COLUMNS.into_iter().filter(|(_, key, ..)| has_values(key)).collect();
    let subject = |of: &Value| {
        let text = |key: &str| of[key].as_str().unwrap_or_default().to_owned();
        let id = text("id");
        let picture = pictures.filter(|_| check_id(&id).is_ok()).map(|folder| folder.join(format!("{id}.png")));
        // Subjects that couldn't be fitted have no picture.
        let picture = picture.filter(|path| path.is_file()).map(|path| spharm_files::read(path, LARGEST_PICTURE));
        let picture = picture.transpose()?;
        let flags = of["flags"].as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect();
        let cell = |(_, key, z, factor): &(&str, &str, &str, f64)| {
            let text = match &of[*key] {
                Value::String(text) => text.clone(),
                Value::Number(found) if found.is_u64() => found.to_string(),
                value => value.as_f64().map_or_else(String::new, |value| number(factor * value)),
            };
            let z = of[*z].as_f64();
            let is_far = |z: f64| Measure::with_key(key).map_or(z.abs() > FAR, |measure| measure.is_far(z));
            CheckedCell { text, z, far: z.is_some_and(is_far) }
        };
        let (cells, scale) = (columns.iter().map(cell).collect(), of["picture_scale"].as_f64());
        Ok(CheckedSubject { id, state: text("state"), flags, cells, picture, scale })
    };
    Ok(Check {
        columns: columns.iter().map(|(name, ..)| (*name).to_owned()).collect(),
        subjects: subjects.iter().map(subject).collect::<Result<_>>()?,
        red_at: found["thumbnails_red_at"].as_f64(),
    })
}
