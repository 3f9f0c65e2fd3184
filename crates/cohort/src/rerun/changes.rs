//! Compares the changes that were made to a surface before its fit with the requested changes.

use std::fmt;

use spharm::Preparation;
use spharm::model::Provenance;
use spharm::parametrize::volume::VoxelValues;

/// A setting that differs between a model and a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Name of the setting: a field of `FitParams`, `Method` or [`Preparation`], or `sphere` or `id`.
    pub setting: &'static str,
    /// Value recorded in the model.
    pub found: String,
    /// Requested value.
    pub wanted: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}, not {}", self.setting.replace('_', "-"), self.found, self.wanted)
    }
}

/// Returns the differences between the recorded and the requested changes to the surface. A requested change that
/// had no effect isn't a difference.
pub(super) fn unprepared(
    wanted: Preparation,
    of_label: bool,
    recorded: &Provenance,
    is_sound: &dyn Fn() -> bool,
) -> Vec<Difference> {
    let (mut differences, size) = (Vec::new(), wanted.reading.voxel_size);
    let same = match (recorded.voxel_size, size) {
        // Compare with a tolerance, because writing and reading a number may change its last bit.
        (Some(found), Some(wanted)) => found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= 1e-14 * b),
        (found, wanted) => found.is_none() && wanted.is_none(),
    };
    if !same {
        let name = |size: Option<[f64; 3]>| {
            size.map_or("from the file".to_owned(), |size| size.map(|size| size.to_string()).join(","))
        };
        let (found, wanted) = (name(recorded.voxel_size), name(size));
        differences.push(Difference { setting: "voxel_size", found, wanted });
    }
    if of_label {
        let named = |name: &str, radius: Option<f64>| {
            radius.map_or(name.to_owned(), |radius| format!("{name} within {radius} voxels"))
        };
        let found = named(recorded.label_surface.as_deref().unwrap_or("voxels"), recorded.smooth_radius);
        let (surface, values) = (wanted.label_surface, VoxelValues::of(recorded.threshold, recorded.probability));
        let compared = [
            ("label_surface", found, named(surface.name(), surface.radius())),
            ("values", values.to_string(), wanted.reading.values.to_string()),
            ("axes", recorded.axes.clone().unwrap_or_else(|| "xyz".to_owned()), wanted.reading.axes.name().to_owned()),
        ];
        let differ = compared.into_iter().filter(|(_, found, wanted)| found != wanted);
        differences.extend(differ.map(|(setting, found, wanted)| Difference { setting, found, wanted }));
    }
    if recorded.wrap != wanted.wrap {
        let named = |wrap: Option<usize>| wrap.map_or("none".to_owned(), |voxels| format!("{voxels} voxels"));
        let (found, wanted) = (named(recorded.wrap), named(wanted.wrap));
        differences.push(Difference { setting: "wrap", found, wanted });
        return differences;
    }
    // Wrapping a mesh is also recorded as a repair, so a recorded repair of a wrapped mesh doesn't mean that the mesh
    // itself was fixed.
    let repaired = recorded.repair.is_some() && recorded.wrap.is_none();
    let cut = recorded.handles.is_some();
    // If a label was fitted and no repair or cut is recorded, the label doesn't need any. For a mesh, this conclusion
    // doesn't hold.
    let as_it_is = of_label && !repaired && !cut;
    // A repaired label has no handles left to cut.
    let without_handles = of_label && repaired;
    let changed = [
        ("fix", recorded.fix || repaired, wanted.fix, repaired),
        ("cut_handles", recorded.cut_handles || cut, wanted.cut_handles && !without_handles, cut),
    ];
    let changed = changed.into_iter().filter(|&(_, found, wanted, mattered)| match (found, wanted) {
        (true, false) => mattered,
        (false, true) => !as_it_is,
        _ => false,
    });
    let changed: Vec<_> = changed.collect();
    let added = changed.iter().all(|&(_, found, ..)| !found);
    if changed.is_empty() || added && !repaired && !cut && is_sound() {
        return differences;
    }
    let word = |given: bool| if given { "yes" } else { "no" }.to_owned();
    let of = |(setting, found, wanted, _)| Difference { setting, found: word(found), wanted: word(wanted) };
    differences.extend(changed.into_iter().map(of));
    differences
}
