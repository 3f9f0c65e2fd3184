//! Reads groups of models up to a common degree, and warns if higher degrees are dropped.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm::shape::places::one_key;
use spharm::shape::{
    CommonDegree, PosesDiffer, Smoothing, SmoothingDiffers, equal_members, mean, other_units, places_differ, rmsd,
    to_common_degree,
};
use spharm::{Coefficients, Kind, Monitor};
use spharm_cli::console::Console;
use spharm_cli::output::counted;
use spharm_cli::paths::model_name;
use spharm_model::recorded_name;
use spharm_surface::io::landmarks::Frame;
use spharm_surface::{AxesDiffer, Hemisphere};

use super::args::read_all;

/// Returns warnings about models that occur more than once in a group.
pub(super) fn equal_models(
    members: &[Coefficients],
    paths: &[PathBuf],
    name: impl Fn(&Path) -> String,
) -> impl Iterator<Item = String> {
    equal_members(members).into_iter().map(move |equal| {
        let names: Vec<String> = equal.into_iter().map(|index| name(&paths[index])).collect();
        format!("{}: the models are identical", names.join(", "))
    })
}

/// Returns a warning if the files of a group's surfaces stated different axes. `stated` has the axes of each member.
pub(super) fn axes_differ(
    stated: &[Option<Frame>],
    paths: &[PathBuf],
    name: impl Fn(&Path) -> String,
) -> Option<String> {
    AxesDiffer::of(stated).map(|axes| axes.with_names(|member| name(&paths[member])))
}

/// A group of models, cut to a common degree.
pub(super) struct Group {
    /// Names of the members: their file names without extensions.
    pub(super) names: Vec<String>,
    pub(super) members: Vec<Coefficients>,
    pub(super) degree: usize,
    /// Hemisphere of each member; `None` if unknown.
    pub(super) hemispheres: Vec<Option<Hemisphere>>,
    /// Side of each member: its hemisphere or, if the hemisphere is unknown, the side that a word or letter in its name
    /// states.
    pub(super) sides: Vec<Option<Hemisphere>>,
    pub(super) warnings: Vec<String>,
}

/// Reads a group of surfaces or of signals up to `degree`, by default the lowest degree of its members.
pub(super) fn read_group(
    paths: &[PathBuf],
    kind: Kind,
    degree: Option<usize>,
    monitor: &dyn Monitor,
    console: &Console,
) -> Result<Group> {
    let read = |model: &spharm::Model, path: &Path| {
        let (found, channels) = (model.kind(), model.coefficients.channels());
        if found != kind || kind == Kind::Signal && channels != 1 {
            let expected = if kind == Kind::Surface { "a surface" } else { "a signal of one channel" };
            let found = if found == Kind::Surface {
                "a surface".to_owned()
            } else {
                format!("a signal of {}", counted(channels, "channel"))
            };
            bail!("{}: expected a model of {expected}, found {found}", path.display());
        }
        let of_model = (model.coefficients.clone(), model.scheme_key.clone());
        let hemisphere = model.hemisphere(Some(path));
        let side = hemisphere.or_else(|| side_of(model, path));
        Ok((of_model, ((hemisphere, side), (Smoothing::of(&model.provenance), model.provenance.axes()))))
    };
    let (models, records): (Vec<_>, Vec<_>) = read_all(paths, monitor, read)?.into_iter().unzip();
    let (members, keys): (Vec<_>, Vec<_>) = models.into_iter().unzip();
    let (of_members, of_surfaces): (Vec<_>, Vec<_>) = records.into_iter().unzip();
    let (smoothing, axes): (Vec<_>, Vec<_>) = of_surfaces.into_iter().unzip();
    let (hemispheres, sides): (Vec<_>, Vec<_>) = of_members.into_iter().unzip();
    let CommonDegree { members, degree, warning } = to_common_degree(&members, degree)?;
    let mut warnings: Vec<String> = warning.iter().map(ToString::to_string).collect();
    let smoothing = SmoothingDiffers::of(&smoothing);
    warnings.extend(smoothing.map(|differs| differs.with_names(|index| paths[index].display().to_string())));
    if kind == Kind::Surface {
        let units = other_units(&members);
        warnings.extend(units.iter().map(|of| format!("{}: {}", paths[of.member].display(), of.of_member())));
        warnings.extend(axes_differ(&axes, paths, |path| path.display().to_string()));
    }
    // Signals have no pose, so poses are only compared for surfaces.
    let poses = if kind == Kind::Surface { PosesDiffer::of(&members) } else { None };
    // Compare corresponding points only if the poses agree, because in different poses these points always differ.
    if kind == Kind::Surface && poses.is_none() && !one_key(keys.iter().map(Option::as_deref)) {
        warnings.extend(places_differ(&members, monitor)?.map(|places| places.to_string()));
    }
    warnings.extend(poses.map(|poses| format!("{poses} (align with `spharm shape align --group`)")));
    warnings.extend(equal_models(&members, paths, |path| path.display().to_string()));
    warnings.extend(mean_among(paths));
    warnings.iter().for_each(|warning| console.warn(warning));
    let names = paths.iter().map(|path| model_name(path)).collect();
    Ok(Group { names, members, degree, hemispheres, sides, warnings })
}

/// Returns the side of a model without a known hemisphere, according to the name of its input or of its file, such as
/// `s1_L`.
fn side_of(model: &spharm::Model, path: &Path) -> Option<Hemisphere> {
    let input = model.provenance.input.as_ref().map(|input| Path::new(recorded_name(&input.path)));
    let stated = |path: &Path| Hemisphere::and_rest_of(&model_name(path)).0;
    let of_files = [input, Some(path)].into_iter().flatten().find_map(stated)?;
    // The model records whether it has been mirrored since the fit.
    model.hemisphere(Some(Path::new(if of_files == Hemisphere::Left { "lh" } else { "rh" })))
}

/// Returns the distance of each surface from the group's mean, after centring the surfaces but without rotating them.
pub(super) fn distances_from_mean(members: &[Coefficients], degree: usize) -> Result<Vec<f64>> {
    let centred = members.iter().map(|member| {
        let mut values = member.up_to(degree).to_owned();
        values.row_mut(0).fill(0.0);
        Coefficients::new(values)
    });
    let centred = centred.collect::<Result<Vec<_>, _>>()?;
    let mean = mean(&centred)?;
    Ok(centred.iter().map(|member| rmsd(member, &mean)).collect::<Result<_, _>>()?)
}

/// Returns a warning if the files include members of a group and the mean that `shape correspond` writes next to them.
fn mean_among(paths: &[PathBuf]) -> Option<String> {
    let of_group = |path: &Path| {
        path.file_name().is_some_and(|name| name == "mean.spharm.npz") && path.with_file_name("group.json").is_file()
    };
    let mean = paths.iter().find(|path| of_group(path))?;
    let beside = paths.iter().any(|path| path != mean && path.parent() == mean.parent());
    beside.then(|| {
        format!(
            "{}: the group's mean is counted as a member; leave it out, or give the group's folder, which stands for \
             its members",
            mean.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_among_the_members_of_its_group_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["a", "mean"].map(|name| folder.path().join(format!("{name}.spharm.npz")));
        assert_eq!(mean_among(&files), None);
        std::fs::write(folder.path().join("group.json"), "{}").unwrap();
        assert!(mean_among(&files).is_some_and(|warning| warning.contains("mean.spharm.npz: the group's mean")));
        assert_eq!(mean_among(&files[..1]), None);
        assert_eq!(mean_among(&[files[1].clone(), PathBuf::from("elsewhere/b.spharm.npz")]), None);
    }
}
