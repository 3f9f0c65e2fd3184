//! Quality control of a group: compares its subjects, and flags those that should be inspected.
//!
//! Volume, area, sphericity, the residual of the fit, the distance from the mean and the scores along the modes are
//! compared by their robust z ([`robust_z`]), with the threshold [`FAR`]. Other flags don't depend on this comparison:
//! they mark equal inputs and models, labels at the border of their volume, voxels of an unusual size, repairs with
//! many changes, and modes that are mostly due to a single subject ([`influential`]).
//!
//! A flag isn't a verdict. By chance, a normally distributed measure flags at least one subject in 8 to 16 of 100
//! groups if the groups have 8 to 200 subjects. In larger groups, such a measure flags about one subject in 2,000.
//! Distributions with long tails cause more flags.

mod flags;
mod measure;

use std::collections::HashMap;

use spharm::fit_mesh::steps_of;
use spharm::model::VoxelRecord;
use spharm::parametrize::volume::VoxelSteps;
use spharm::pose::IN_DOUBT;
use spharm::shape::outliers::{FAR, LEAST, median};
use spharm::shape::{MeasureParams, ShapeError, influential, measure, robust_z};
use spharm::{FileRecord, Model, Monitor};

use self::flags::VOXELS_CHANGED;
pub use self::flags::{Counts, Flag, Others, edges};
pub use self::measure::Measure;
use crate::equal::EqualSets;

/// A mode is examined only if its share of the total variance exceeds this value.
const LEAST_VARIANCE: f64 = 0.05;

/// The data about a subject that are compared within the group.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Facts {
    /// Id of the subject.
    pub id: String,
    /// Values of the measures, in the order of [`Measure::ALL`]; `None` if unknown.
    pub measures: [Option<f64>; Measure::ALL.len()],
    /// Scores along the modes of the group; empty if unknown.
    pub scores: Vec<f64>,
    /// Cube root of the volume of the input's bounding box.
    pub size: Option<f64>,
    /// Voxels of the label, if the surface was extracted from a label.
    pub voxels: Option<VoxelRecord>,
    /// The staircase of voxels that the model reproduces because its degree is too high; `None` if it reproduces none.
    pub steps: Option<VoxelSteps>,
    /// Changes made by a repair of the input.
    pub repair: Counts,
    /// Number of handles that were cut.
    pub handles: u64,
    /// Record of the input file, with its path and hash.
    pub input: Option<FileRecord>,
    /// BLAKE3 hash of the model's coefficients.
    pub coefficients: String,
    /// Ids of the subjects that have the same surface, in any pose.
    pub identical_to: Vec<String>,
    /// Warnings about the subject from other commands. A warning about a doubtful pose doesn't lead to a flag, since
    /// shapes with two nearly equal poses cause this warning even if the pose is right. A wrong pose is detected by the
    /// subject's distance from the mean.
    pub notes: Vec<String>,
}

impl Facts {
    /// Returns the facts that follow from a subject's model: all except the distance from the mean, the scores and the
    /// notes.
    ///
    /// # Errors
    ///
    /// The errors of [`measure`].
    pub fn of(id: &str, model: &Model, monitor: &dyn Monitor) -> Result<Self, ShapeError> {
        let found = measure(&model.coefficients, &MeasureParams::default(), monitor)?;
        let record = &model.provenance;
        let mut hasher = blake3::Hasher::new();
        for value in model.coefficients.values() {
            hasher.update(&value.to_le_bytes());
        }
        let handles = record.handles.as_ref().and_then(|handles| handles.get("genus_before")?.as_u64());
        Ok(Self {
            id: id.to_owned(),
            measures: [Some(found.volume), Some(found.area), Some(found.sphericity), record.surface_rms, None],
            size: record.scale,
            voxels: record.voxels,
            repair: record.repair.as_ref().map(Counts::of).unwrap_or_default(),
            handles: handles.unwrap_or(0),
            input: record.input.clone(),
            coefficients: hasher.finalize().to_hex().to_string(),
            steps: steps_of(record),
            ..Self::default()
        })
    }

    /// Returns the value of a measure, or `None` if it is unknown.
    #[must_use]
    pub fn measure(&self, measure: Measure) -> Option<f64> {
        self.measures[measure as usize]
    }
}

/// The result of the check for one subject.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checked {
    /// Robust z of each measure, in the order of [`Measure::ALL`]; `None` if the group has too few values.
    pub z: [Option<f64>; Measure::ALL.len()],
    /// The mode, counted from 1, along which the subject is farthest from the other subjects, and the robust z of its
    /// score.
    pub mode: Option<(usize, f64)>,
    /// The flags, sorted: an unusual voxel size first, then other causes, then unusual values; within each kind, the
    /// most severe first.
    pub flags: Vec<Flag>,
    /// Warnings from other commands that don't lead to flags.
    pub remarks: Vec<String>,
}

impl Checked {
    /// Returns the severity of the most severe flag, or 0 if there are no flags.
    #[must_use]
    pub fn severity(&self) -> f64 {
        self.flags.iter().map(Flag::severity).fold(0.0, f64::max)
    }
}

/// Compares the subjects of a group. Returns one result per subject, in the order of `facts`.
#[must_use]
pub fn check(facts: &[Facts]) -> Vec<Checked> {
    let mut checked = vec![Checked::default(); facts.len()];
    compare_measures(facts, &mut checked);
    compare_scores(facts, &mut checked);
    compare_inputs(facts, &mut checked);
    let usual = usual_voxels(facts);
    for (of, result) in facts.iter().zip(&mut checked) {
        let flags = &mut result.flags;
        if let Some(voxels) = &of.voxels {
            flags.extend(voxels.at_border.then_some(Flag::AtBorder));
            let other = usual.filter(|usual| !same_size(voxels.size, *usual));
            flags.extend(other.map(|usual| Flag::VoxelSize { found: voxels.size, usual }));
            let share = of.repair.voxels as f64 / voxels.count.max(1) as f64;
            flags.extend((share > VOXELS_CHANGED).then(|| Flag::Repaired { what: of.repair.to_string(), share }));
        }
        let (remarks, notes): (Vec<String>, _) = of.notes.iter().cloned().partition(|note| note.starts_with(IN_DOUBT));
        flags.extend(notes.into_iter().map(Flag::Note));
        result.remarks = remarks;
        // Flags that report possible causes come before flags that report unusual values, because the causes may
        // explain the unusual values.
        flags.sort_by(|a, b| a.rank().cmp(&b.rank()).then(b.severity().total_cmp(&a.severity())));
    }
    checked
}

fn compare_measures(facts: &[Facts], checked: &mut [Checked]) {
    for measure in Measure::ALL {
        let known = facts.iter().enumerate().filter_map(|(index, of)| Some((index, of.measure(measure)?)));
        let (subjects, values): (Vec<usize>, Vec<f64>) = known.unzip();
        if values.len() < LEAST {
            continue;
        }
        let median = median(&values);
        for ((z, value), subject) in robust_z(&values).into_iter().zip(values).zip(subjects) {
            checked[subject].z[measure as usize] = Some(z);
            if measure.is_far(z) {
                checked[subject].flags.push(Flag::Far { measure, value, median, z });
            }
        }
    }
}

fn compare_scores(facts: &[Facts], checked: &mut [Checked]) {
    let count = facts.iter().map(|of| of.scores.len()).min().unwrap_or(0);
    if facts.len() < LEAST {
        return;
    }
    let modes: Vec<Vec<f64>> = (0..count).map(|mode| facts.iter().map(|of| of.scores[mode]).collect()).collect();
    let variance = |scores: &Vec<f64>| scores.iter().map(|score| score * score).sum::<f64>();
    let all: f64 = modes.iter().map(variance).sum();
    for (mode, scores) in modes.iter().enumerate().filter(|(_, scores)| variance(scores) > LEAST_VARIANCE * all) {
        for (z, result) in robust_z(scores).into_iter().zip(checked.iter_mut()) {
            if result.mode.is_none_or(|(_, most)| z.abs() > most.abs()) {
                result.mode = Some((mode + 1, z));
            }
        }
        if let Some(found) = influential(scores) {
            checked[found.index].flags.push(Flag::MakesMode { mode: mode + 1, share: found.share });
        }
    }
    for result in checked {
        if let Some((mode, z)) = result.mode.filter(|(_, z)| z.abs() > FAR) {
            result.flags.push(Flag::FarScore { mode, z });
        }
    }
}

fn compare_inputs(facts: &[Facts], checked: &mut [Checked]) {
    let mut inputs = EqualSets::default();
    let mut models = EqualSets::default();
    let mut surfaces: HashMap<&str, Vec<&str>> = HashMap::new();
    for of in facts {
        if let Some(record) = &of.input {
            inputs.add(record.contents(), of.id.clone());
        }
        models.add(of.coefficients.clone(), of.id.clone());
    }
    for of in facts {
        // If two surfaces are equal in different poses, both subjects are named, since either may be the wrong one.
        for other in &of.identical_to {
            surfaces.entry(of.id.as_str()).or_default().push(other);
            surfaces.entry(other.as_str()).or_default().push(&of.id);
        }
    }
    let (inputs, models) = (inputs.sets(), models.sets());
    let (of_inputs, of_models) = (set_of_name(&inputs), set_of_name(&models));
    for (of, result) in facts.iter().zip(checked) {
        let id = of.id.as_str();
        let others = |set: &Vec<&str>| Others::new(id, set);
        // Equal inputs give equal models, and equal models have equal surfaces. Therefore, of the three flags for equal
        // inputs, models and surfaces, only the first that applies is set.
        let same_input = of_inputs.get(id).map(|set| Flag::SameInput(others(set)));
        let same_model = || of_models.get(id).map(|set| Flag::SameModel(others(set)));
        let same_surface = || surfaces.get(id).map(|set| Flag::SameSurface(others(set)));
        result.flags.extend(same_input.or_else(same_model).or_else(same_surface));
    }
}

/// Maps each name to the set that contains it.
fn set_of_name<'s, 'n>(sets: &'s [Vec<&'n str>]) -> HashMap<&'n str, &'s Vec<&'n str>> {
    sets.iter().flat_map(|set| set.iter().map(move |name| (*name, set))).collect()
}

/// Returns the voxel size that more than half of the subjects have, or `None` if there is no such size.
fn usual_voxels(facts: &[Facts]) -> Option<[f64; 3]> {
    let sizes: Vec<[f64; 3]> = facts.iter().filter_map(|of| Some(of.voxels?.size)).collect();
    // If more than half of the subjects have the same size, it equals the median along each axis.
    let median = std::array::from_fn(|axis| median(&sizes.iter().map(|size| size[axis]).collect::<Vec<_>>()));
    let count = sizes.iter().filter(|size| same_size(**size, median)).count();
    (sizes.len() >= LEAST && 2 * count > sizes.len()).then_some(median)
}

/// Splits a warning `ID: text` into the subject's id and the text. Returns `None` if the warning doesn't begin with a
/// known id.
pub fn subject_of(warning: &str, is_id: impl Fn(&str) -> bool) -> Option<(&str, &str)> {
    warning.match_indices(": ").map(|(at, end)| (&warning[..at], &warning[at + end.len()..])).find(|(id, _)| is_id(id))
}

/// Returns warnings if the subjects of a group can't be compared, or if a measure is unknown for some of them.
#[must_use]
pub fn incomplete(facts: &[Facts]) -> Vec<String> {
    if facts.len() < LEAST {
        let count = facts.len();
        return vec![format!(
            "{count} subjects are too few for robust z scores, which need at least {LEAST}: volume, area, sphericity, \
             rms, distance and scores weren't compared"
        )];
    }
    let unknown =
        Measure::ALL.map(|measure| (measure, facts.iter().filter(|of| of.measure(measure).is_none()).count()));
    let some = unknown.into_iter().filter(|(_, count)| *count > 0 && *count < facts.len());
    some.map(|(measure, count)| format!("{}: unknown for {count} of {} subjects", measure.name(), facts.len()))
        .collect()
}

/// Returns whether two voxel sizes are equal up to the rounding in file headers.
fn same_size(a: [f64; 3], b: [f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-3 * b.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the facts of `count` subjects that differ slightly.
    fn group(count: usize) -> Vec<Facts> {
        let of = |k: usize| {
            let x = ((k * 7919) % 101) as f64 / 101.0 - 0.5;
            let y = ((k * 104_729) % 89) as f64 / 89.0 - 0.5;
            Facts {
                id: format!("s{k:02}"),
                measures: [2000.0 + 900.0 * x, 1000.0 + 200.0 * y, 0.8 + 0.1 * x, 0.2 + 0.02 * y, 1.0 + 0.2 * x]
                    .map(Some),
                scores: vec![3.0 * x, 2.0 * y],
                voxels: Some(VoxelRecord { count: 2000, size: [1.0, 1.0, 1.5], at_border: false }),
                coefficients: k.to_string(),
                ..Facts::default()
            }
        };
        (0..count).map(of).collect()
    }

    fn said(checked: &Checked) -> String {
        checked.flags.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
    }

    #[test]
    fn subjects_that_differ_a_little_have_no_flags() {
        let checked = check(&group(40));
        assert!(checked.iter().all(|result| result.flags.is_empty() && result.severity() == 0.0), "{checked:?}");
        assert!(checked.iter().all(|result| result.z.iter().all(Option::is_some) && result.mode.is_some()));
        // Four subjects are too few for any comparison.
        assert!(check(&group(4)).iter().all(|result| *result == Checked::default()));
        assert!(check(&[]).is_empty());
    }

    #[test]
    fn each_kind_of_flag_names_its_reason() {
        let mut facts = group(30);
        facts[3].measures[0] = Some(2e6);
        facts[3].scores[0] = 500.0;
        facts[4].voxels = Some(VoxelRecord { count: 2000, size: [1.0, 1.0, 1.5], at_border: true });
        facts[5].voxels = Some(VoxelRecord { count: 2000, size: [1.0, 1.0, 1.0], at_border: false });
        facts[6].coefficients = facts[7].coefficients.clone();
        facts[8].repair = Counts { voxels: 300, texts: vec!["1 piece dropped".to_owned()] };
        facts[9].notes = vec!["it may be of the other side".to_owned()];
        facts[12].notes =
            vec![format!("{IN_DOUBT}: another pose fits nearly equally well, with a distance of 1.01 in place of 1")];
        // A residual far below those of the other subjects means a good fit, so it isn't flagged.
        facts[10].measures[Measure::Rms as usize] = Some(0.001);
        facts[11].measures[Measure::Rms as usize] = Some(1.0);
        let checked = check(&facts);
        let expected = [
            (3, "volume 2.000e6 (median "),
            (3, "another unit: about 10 times"),
            (3, "mode 1 is mostly due to this subject"),
            (4, "border of the volume"),
            (5, "voxel size 1 x 1 x 1"),
            (6, "s07"),
            (7, "same model as s06"),
            (8, "1 piece dropped"),
            (9, "other side"),
            (11, "rms 1.000"),
        ];
        for (index, text) in expected {
            assert!(said(&checked[index]).contains(text), "{index}: {}", said(&checked[index]));
        }
        let flagged = checked.iter().filter(|result| !result.flags.is_empty()).count();
        assert_eq!((flagged, checked[12].remarks.len()), (8, 1), "{checked:?}");
        let worst = (0..30).max_by(|a, b| checked[*a].severity().total_cmp(&checked[*b].severity()));
        assert_eq!(worst, Some(3));
    }
}
