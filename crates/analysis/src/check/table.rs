//! Formats the table of the subjects, as text for `quality.tsv` and as JSON for the page.

use serde_json::{Value, json};
use spharm_cohort::cell;
use spharm_cohort::check::{Checked, Facts, Measure, edges};

use super::super::outputs::short;
use super::gather::{State, WithoutModel};

/// A subject's row in the table.
pub(super) struct Line<'a> {
    pub(super) id: &'a str,
    pub(super) state: State,
    /// Facts and the result of the check; `None` for a subject without a model.
    found: Option<(&'a Facts, &'a Checked)>,
    /// Reason why there is no model, or why the flags were accepted.
    reason: &'a str,
    /// Scale of the subject's picture: 1, or less for a surface that is much larger than the other surfaces.
    scale: Option<f64>,
}

/// Columns of the table after id, state and flags. Next to the column of each measure is a column with its robust z.
const COLUMNS: [&str; 20] = [
    "volume",
    "volume_z",
    "area",
    "area_z",
    "sphericity",
    "sphericity_z",
    "rms",
    "rms_z",
    "rms_by_voxel",
    "rms_by_size",
    "distance",
    "distance_z",
    "mode",
    "mode_z",
    "voxels",
    "voxel_size",
    "at_border",
    "repair",
    "handles",
    "remarks",
];

impl<'a> Line<'a> {
    /// Returns the line of a subject with a model. `accepted` is the reason for accepting the subject's flags, if they
    /// were accepted. `scale` is the scale of the subject's picture.
    pub(super) fn of(facts: &'a Facts, checked: &'a Checked, accepted: Option<&'a String>, scale: Option<f64>) -> Self {
        let state = match (checked.flags.is_empty(), accepted) {
            (true, _) => State::Ok,
            (false, Some(_)) => State::Accepted,
            (false, None) => State::Flagged,
        };
        let reason = accepted.map_or("", String::as_str);
        Self { id: &facts.id, state, found: Some((facts, checked)), reason, scale }
    }

    pub(super) fn without_model(subject: &'a WithoutModel) -> Self {
        Self { id: &subject.id, state: subject.state, found: None, reason: &subject.reason, scale: None }
    }

    /// Returns the flags of a subject, or the reason why it has no model.
    fn flags(&self) -> Vec<String> {
        match self.found {
            Some((_, checked)) => checked.flags.iter().map(ToString::to_string).collect(),
            None if self.reason.is_empty() => Vec::new(),
            None => vec![self.reason.to_owned()],
        }
    }

    /// Returns the flags as one string.
    pub(super) fn why(&self) -> String {
        self.flags().join("; ")
    }

    /// Returns the first flag, and the number of further flags.
    pub(super) fn first_flag(&self) -> String {
        match &self.flags()[..] {
            [] => String::new(),
            [only] => only.clone(),
            [first, others @ ..] => format!("{first} (and {} more)", others.len()),
        }
    }

    fn severity(&self) -> f64 {
        self.found.map_or(0.0, |(_, checked)| checked.severity())
    }

    /// Returns the values of [`COLUMNS`]; null if unknown.
    fn values(&self) -> [Value; COLUMNS.len()] {
        let Some((facts, checked)) = self.found else { return std::array::from_fn(|_| Value::Null) };
        let [volume, area, sphericity, rms, distance] = Measure::ALL.map(|measure| facts.measure(measure));
        let [volume_z, area_z, sphericity_z, rms_z, distance_z] = checked.z;
        let edge = facts.voxels.map(|voxels| voxels.size.iter().product::<f64>().cbrt());
        let ratio = |of: Option<f64>| Some(rms? / of.filter(|of| *of > 0.0)?);
        let accepted = (self.state == State::Accepted).then(|| format!("accepted: {}", self.reason));
        let remarks: Vec<String> = accepted.into_iter().chain(checked.remarks.iter().cloned()).collect();
        let remarks = Some(remarks.join("; ")).filter(|text| !text.is_empty());
        let repair = Some(facts.repair.to_string()).filter(|text| !text.is_empty());
        [
            json!(volume),
            json!(volume_z),
            json!(area),
            json!(area_z),
            json!(sphericity),
            json!(sphericity_z),
            json!(rms),
            json!(rms_z),
            json!(ratio(edge)),
            json!(ratio(facts.size)),
            json!(distance),
            json!(distance_z),
            json!(checked.mode.map(|(mode, _)| mode)),
            json!(checked.mode.map(|(_, z)| z)),
            json!(facts.voxels.map(|voxels| voxels.count)),
            json!(facts.voxels.map(|voxels| edges(voxels.size))),
            json!(facts.voxels.map(|voxels| voxels.at_border)),
            json!(repair),
            json!(facts.handles),
            json!(remarks),
        ]
    }

    pub(super) fn json(&self) -> Value {
        let mut value = json!({
            "id": self.id,
            "state": self.state.to_string(),
            "flags": self.flags(),
            "picture_scale": self.scale,
        });
        for (name, cell) in COLUMNS.iter().zip(self.values()) {
            value[*name] = cell;
        }
        value
    }
}

/// Sorts the subjects: flagged subjects first, and among these the worst at the top.
pub(super) fn sort(lines: &mut [Line<'_>]) {
    lines.sort_by(|a, b| a.state.cmp(&b.state).then(b.severity().total_cmp(&a.severity())));
}

/// Returns the table as tab-separated text.
pub(super) fn tsv(lines: &[Line<'_>]) -> String {
    let mut text = ["id", "state", "flags"].into_iter().chain(COLUMNS).collect::<Vec<_>>().join("\t") + "\n";
    for line in lines {
        let text_of = |value: Value| match value {
            Value::Null => String::new(),
            Value::Bool(yes) => if yes { "yes" } else { "no" }.to_owned(),
            Value::String(text) => cell(&text),
            Value::Number(found) => match found.as_f64() {
                Some(value) if found.is_f64() => short(value),
                _ => found.to_string(),
            },
            other => other.to_string(),
        };
        let own = [cell(line.id), line.state.to_string(), cell(&line.why())];
        text += &(own.into_iter().chain(line.values().map(text_of)).collect::<Vec<_>>().join("\t") + "\n");
    }
    text
}
