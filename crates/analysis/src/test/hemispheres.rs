//! Warns if the models, or the files for the sampling's vertices (sphere, masks, annotation), belong to different
//! hemispheres.

use std::path::PathBuf;

use spharm::Sphere;
use spharm_surface::Hemisphere;

use super::super::masks::is_group;
use super::args::Cli;

/// Returns warnings about models of both hemispheres, and about a sphere, masks and an annotation that don't belong to
/// the models' hemisphere. `of_models` has the hemisphere or side of each model, if known.
pub(super) fn warnings(
    cli: &Cli,
    sphere: &Sphere,
    models: &[PathBuf],
    of_models: &[Option<Hemisphere>],
) -> Vec<String> {
    let first = |of: Hemisphere| models.iter().zip(of_models).find(|(_, found)| **found == Some(of));
    let (model, of_model) = match [Hemisphere::Left, Hemisphere::Right].map(first) {
        [Some((left, _)), Some((right, _))] => {
            return vec![format!(
                "{} belongs to the left hemisphere, but {} belongs to the right hemisphere, so they don't \
                 correspond; mirror the models of one hemisphere with `spharm shape rotate --mirror`, or make a study \
                 with `sides`",
                left.display(),
                right.display()
            )];
        }
        [Some((model, _)), None] => (model, Hemisphere::Left),
        [None, Some((model, _))] => (model, Hemisphere::Right),
        [None, None] => return Vec::new(),
    };
    let named = |path: &PathBuf| Some((path.clone(), Hemisphere::of(None, Some(path.as_path()))?));
    let of_sphere = cli.sphere.clone().zip(sphere.hemisphere());
    let masks = cli.mask.iter().filter(|mask| !is_group(mask)).filter_map(named);
    let files = of_sphere.into_iter().chain(masks).chain(cli.annotation.iter().filter_map(named));
    let other = files.filter(|(_, of)| *of != of_model);
    let warning = |(file, of): (PathBuf, Hemisphere)| {
        format!(
            "{}: this file belongs to the {of} hemisphere, but the model {} belongs to the {of_model} hemisphere",
            file.display(),
            model.display()
        )
    };
    other.map(warning).collect()
}
