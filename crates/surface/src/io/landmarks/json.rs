//! Reads and writes landmarks as JSON: 3D Slicer's markups, and plain lists.
//!
//! The schema of markups is
//! <https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json>.
//! A file is an object whose `markups` are lists of `controlPoints` with `label`, `id` and `position`. Points whose
//! position is undefined in Slicer are skipped.

use serde_json::{Value, json};

use super::{Frame, Gathered, Landmarks};
use crate::geometry::Vec3;
use crate::io::flaw::{Flaw, shown};

/// Reads markups (a JSON object) or a plain list (a JSON array).
pub(super) fn read(text: &str) -> Result<Landmarks, Flaw> {
    let value: Value = serde_json::from_str(text).map_err(|error| Flaw::new("valid JSON", error.to_string()))?;
    match &value {
        Value::Array(entries) => read_list(entries),
        Value::Object(object) => match object.get("markups") {
            Some(Value::Array(lists)) => read_markups(lists),
            _ => Err(Flaw::new("an object with \"markups\", or a list", "an object without \"markups\"")),
        },
        other => Err(Flaw::new("an object with \"markups\", or a list", kind(other))),
    }
}

fn read_list(entries: &[Value]) -> Result<Landmarks, Flaw> {
    let mut found = Gathered::default();
    for (index, entry) in entries.iter().enumerate() {
        let at = format!("entry {index} (counted from 0)");
        let name = name(entry, &["id", "name", "label"], &at)?;
        let point = ["coordinates", "position"].iter().find_map(|key| entry.get(key));
        found.add(&at, &name, position(point, "coordinates", &at)?)?;
    }
    Ok(found.landmarks(None))
}

fn read_markups(lists: &[Value]) -> Result<Landmarks, Flaw> {
    let mut found = Gathered::default();
    let mut frame = None;
    for (number, list) in lists.iter().enumerate() {
        let own = match list.get("coordinateSystem") {
            // LPS is the schema's default frame.
            None | Some(Value::Null) => Frame::Lps,
            Some(Value::String(text)) => Frame::named(text).ok_or_else(|| {
                Flaw::new(format!("LPS or RAS as the coordinateSystem of markups {number}"), shown(text.as_bytes()))
            })?,
            Some(other) => {
                return Err(Flaw::new(format!("LPS or RAS as the coordinateSystem of markups {number}"), kind(other)));
            }
        };
        let unit = match list.get("coordinateUnits") {
            Some(Value::Array(code)) => code.first().and_then(Value::as_str),
            other => other.and_then(Value::as_str),
        };
        if let Some(unit) = unit.filter(|unit| *unit != "mm") {
            return Err(Flaw::unsupported(
                format!("coordinateUnits {}", shown(unit.as_bytes())),
                "convert the coordinates to mm, or save the landmarks as a table (.csv), which has no unit",
            ));
        }
        // The lists of a file may have different frames. The result has the frame of the first list.
        let turn = *frame.get_or_insert(own) != own;
        let points = match list.get("controlPoints") {
            None | Some(Value::Null) => &[][..],
            Some(Value::Array(points)) => points,
            Some(other) => {
                return Err(Flaw::new(
                    format!("a list for the controlPoints of markups {number} (counted from 0)"),
                    kind(other),
                ));
            }
        };
        for (index, point) in points.iter().enumerate() {
            let status = point.get("positionStatus").and_then(Value::as_str);
            if matches!(status, Some("undefined" | "missing")) {
                continue;
            }
            let at = format!("control point {index} of markups {number} (counted from 0)");
            let name = name(point, &["label", "id"], &at)?;
            let [x, y, z] = position(point.get("position"), "position", &at)?;
            found.add(&at, &name, if turn { [-x, -y, z] } else { [x, y, z] })?;
        }
    }
    Ok(found.landmarks(frame))
}

/// Returns the name of a landmark: the value of the first key that has nonempty text or a number.
fn name(entry: &Value, keys: &[&str], at: &str) -> Result<String, Flaw> {
    if !entry.is_object() {
        return Err(Flaw::new(format!("an object as {at}"), kind(entry)));
    }
    let text = |key: &&str| match entry.get(key) {
        Some(Value::String(text)) if !text.trim().is_empty() => Some(text.clone()),
        Some(Value::Number(number)) => Some(number.to_string()),
        _ => None,
    };
    keys.iter().find_map(text).ok_or_else(|| Flaw::new(format!("{} in {at}", keys.join(" or ")), "none"))
}

fn position(value: Option<&Value>, key: &str, at: &str) -> Result<Vec3, Flaw> {
    let expected = || format!("{key} with 3 numbers in {at}");
    let Some(Value::Array(numbers)) = value else {
        return Err(Flaw::new(expected(), value.map_or("none", kind)));
    };
    if numbers.len() != 3 {
        return Err(Flaw::new(expected(), numbers.len().to_string()));
    }
    let mut point = [0.0; 3];
    for (x, number) in point.iter_mut().zip(numbers) {
        *x = number.as_f64().ok_or_else(|| Flaw::new(expected(), kind(number)))?;
    }
    Ok(point)
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

/// Returns a file of Slicer's markups with all landmarks in one list.
pub(super) fn markups(landmarks: &Landmarks) -> Vec<u8> {
    let point = |(index, (name, point)): (usize, (&String, &Vec3))| {
        json!({
            "id": (index + 1).to_string(),
            "label": name,
            "position": point,
            "selected": true,
            "locked": false,
            "visibility": true,
            "positionStatus": "defined",
        })
    };
    let points: Vec<Value> = landmarks.names.iter().zip(&landmarks.points).enumerate().map(point).collect();
    let schema = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/\
                  markups-schema-v1.0.3.json#";
    let value = json!({
        "@schema": schema,
        "markups": [{
            "type": "Fiducial",
            "coordinateSystem": landmarks.frame.unwrap_or(Frame::Lps).name(),
            "coordinateUnits": "mm",
            "controlPoints": points,
        }],
    });
    format!("{value:#}\n").into_bytes()
}

/// Returns a plain list with one entry per line.
pub(super) fn list(landmarks: &Landmarks) -> Vec<u8> {
    let entry = |(name, point): (&String, &Vec3)| json!({ "id": name, "coordinates": point }).to_string();
    let entries: Vec<String> = landmarks.names.iter().zip(&landmarks.points).map(entry).collect();
    format!("[{}]\n", entries.join(",\n ")).into_bytes()
}
