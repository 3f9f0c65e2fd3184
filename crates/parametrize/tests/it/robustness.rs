//! Tests that the map is one to one for any surface.

use crate::shapes::surface;
use rayon::prelude::*;
use spharm_monitor::Silent;
use spharm_parametrize::{CaldParams, ConformalParams, Quality, StretchParams, auto, conformal, stretch};

#[test]
fn auto_maps_two_hundred_surfaces_one_to_one() {
    let failed: Vec<String> = (0..200_u64)
        .into_par_iter()
        .filter_map(|seed| {
            let (kind, mesh) = surface(seed);
            let found = match auto(&mesh, &CaldParams::default(), &Silent) {
                Ok(found) => found,
                Err(error) => return Some(format!("{kind} {seed}: {error}")),
            };
            let quality = Quality::of(&mesh, &found.sphere);
            let round = |p: &[f64; 3]| (p.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-14;
            let good = quality.is_bijective()
                && quality == found.report.quality
                && found.sphere.faces == mesh.faces
                && found.sphere.vertices.iter().all(round);
            (!good).then(|| format!("{kind} {seed}: {quality:?}"))
        })
        .collect();
    assert!(failed.is_empty(), "{} of 200: {failed:#?}", failed.len());
}

#[test]
fn the_other_methods_map_some_of_each_kind_one_to_one() {
    for seed in 0..10 {
        let (kind, mesh) = surface(seed);
        let found = conformal(&mesh, &ConformalParams::default(), &Silent);
        let found = found.unwrap_or_else(|error| panic!("{kind} {seed}: {error}"));
        assert!(Quality::of(&mesh, &found.sphere).is_bijective(), "{kind} {seed}");
        let found = stretch(&mesh, &StretchParams::default(), &Silent);
        let found = found.unwrap_or_else(|error| panic!("{kind} {seed}: {error}"));
        assert!(Quality::of(&mesh, &found.sphere).is_bijective(), "{kind} {seed}");
    }
}
