//! Warns about tests whose levels have voxels of different sizes. Coarser voxels give rounder surfaces, so a difference
//! between the levels may be caused by the voxels rather than by the subjects' shapes.

use std::collections::HashMap;
use std::path::Path;

use anyhow::Result;
use rayon::prelude::*;
use spharm::Model;
use spharm::parametrize::volume::is_volume;
use spharm_cohort::Row;
use spharm_cohort::check::edges;

use super::plan::Subject;

/// Largest relative difference between two voxel sizes that are treated as equal.
const EQUAL: f64 = 0.01;

/// Voxel size of each subject whose surface was made from a label, by the subject's id: the voxel's three edge lengths,
/// in ascending order.
pub(super) type Sizes<'a> = HashMap<&'a str, [f64; 3]>;

/// Reads the voxel sizes that the subjects' models record.
pub(super) fn sizes<'a>(subjects: &[Subject<'a>]) -> Result<Sizes<'a>> {
    let of_volumes = subjects.par_iter().filter(|subject| is_volume(&subject.surface));
    let sizes = of_volumes.map(|subject| size(&subject.model).map(|size| Some((subject.id, size?))));
    Ok(sizes.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// Reads the voxel size that a model records, in ascending order; `None` if it records no voxels.
fn size(model: &Path) -> Result<Option<[f64; 3]>> {
    let voxels = Model::read_provenance(model)?.voxels;
    Ok(voxels.map(|voxels| {
        let mut size = voxels.size;
        size.sort_unstable_by(f64::total_cmp);
        size
    }))
}

/// Returns a warning if the most frequent voxel size differs between two levels. `levels` has the level of each row.
pub(super) fn differ(test: &str, rows: &[&Row], levels: &[String], sizes: &Sizes<'_>) -> Option<String> {
    let mut usual: Vec<(&str, [f64; 3])> = Vec::new();
    for level in levels {
        if usual.iter().all(|(other, _)| other != level) {
            let members = rows.iter().zip(levels).filter(|(_, of)| *of == level);
            let found = members.filter_map(|(row, _)| sizes.get(row.id.as_str()).copied());
            usual.push((level, most_frequent(found.collect())?));
        }
    }
    let (first, size) = *usual.first()?;
    let (other, found) = *usual.iter().find(|(_, found)| !are_equal(*found, size))?;
    Some(format!(
        "test {test:?}: the voxels of most subjects in {first} are {}, and those in {other} are {}; surfaces of \
         coarser voxels are rounder, so a difference may come from the voxels; resample all volumes to one voxel size",
        edges(size),
        edges(found)
    ))
}

/// Returns the most frequent size; the first one in case of ties.
fn most_frequent(sizes: Vec<[f64; 3]>) -> Option<[f64; 3]> {
    let count = |size: &[f64; 3]| sizes.iter().filter(|other| are_equal(**other, *size)).count();
    sizes.iter().rev().max_by_key(|size| count(size)).copied()
}

fn are_equal(a: [f64; 3], b: [f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= EQUAL * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_of_different_voxels_are_named() {
        let ids = ["a1", "a2", "a3", "b1", "b2", "b3"];
        let rows: Vec<Row> = ids.iter().map(|id| Row { id: (*id).to_owned(), ..Row::default() }).collect();
        let rows: Vec<&Row> = rows.iter().collect();
        let levels = ids.map(|id| id[..1].to_owned());
        let of = |coarse: &[&str]| -> Sizes<'static> {
            ids.into_iter().map(|id| (id, if coarse.contains(&id) { [1.0, 1.0, 1.6] } else { [1.0; 3] })).collect()
        };
        let found = differ("group", &rows, &levels, &of(&["a1", "a2", "a3"])).unwrap();
        assert!(found.contains("in a are 1 x 1 x 1.6,") && found.contains("those in b are 1 x 1 x 1;"), "{found}");
        // A different voxel size of a single subject, or of one subject in each level, isn't a difference between the
        // levels.
        assert_eq!(differ("group", &rows, &levels, &of(&["a1"])), None);
        assert_eq!(differ("group", &rows, &levels, &of(&["a1", "b2"])), None);
        assert_eq!(differ("group", &rows, &levels, &Sizes::new()), None);
    }
}
