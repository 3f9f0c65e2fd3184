//! Lists the provenance of a model as human-readable rows of a table.

use serde_json::Value;
use spharm_model::Model;

use crate::text::number;

/// Returns the names and values of a model's provenance; unknown values are omitted.
pub(crate) fn rows(model: &Model) -> Vec<(String, String)> {
    let mut rows: Vec<(String, String)> = Vec::new();
    let mut add = |key: &str, value: Option<String>| rows.extend(value.map(|value| (key.to_owned(), value)));
    let made = &model.provenance;
    add("Input", made.input.as_ref().map(ToString::to_string));
    add("Input, BLAKE3", made.input.as_ref().map(|input| input.blake3.clone()));
    add("Sphere", made.sphere.clone());
    add("Structure", made.anatomical_structure_primary.clone());
    add("Highest degree", Some(model.coefficients.max_degree().to_string()));
    add("Vertices", model.sphere.as_ref().map(|sphere| sphere.directions.len().to_string()));
    if let Some(set) = &made.settings {
        let positive = |value: usize| (value > 0).then(|| value.to_string());
        add("Method", Some(set.method.clone()));
        add("Fitted to", set.objective.clone());
        add("Passes", positive(set.passes));
        add("Granularity", set.granularity.map(|value| value.to_string()));
        add("Start degree", set.start_degree.map(|value| value.to_string()));
        add("Weights", Some(set.weights.clone()));
        add("Held out", set.hold_out.map(number));
        add("Smoothness", (set.smoothness > 0.0).then(|| number(set.smoothness)));
        add("Smoothness chosen", set.smoothness_choice.clone());
        add("Tolerance", set.tolerance.map(number));
        add("Optimality reached", set.optimality.map(number));
        add("Converged", set.converged.map(|yes| if yes { "yes" } else { "no" }.to_owned()));
        add("Basis", Some(set.dtype.clone()));
    }
    if let Some(distances) = &made.distances {
        add("Mean squared distance, bounding box scaled to volume 1", distances.msd.map(number));
        add("Largest squared distance, bounding box scaled to volume 1", distances.xsd.map(number));
        add("Rms distance of corresponding points", Some(number(distances.rms())));
        add("Largest distance of corresponding points", Some(number(distances.max())));
    }
    add("Cube root of the bounding box's volume", made.scale.map(number));
    for (key, value) in &made.other {
        add(key, plain(value));
    }
    add("Made by", made.tool.clone());
    add("Version", made.versions.as_ref().map(|versions| versions.spharm.clone()));
    rows
}

/// Returns the text of a value that is a string, a number or a boolean; `None` for lists and objects, which are meant
/// for programs.
fn plain(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(value) => Some(value.to_string()),
        Value::Bool(value) => Some(value.to_string()),
        _ => None,
    }
}
