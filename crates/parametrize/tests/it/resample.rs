//! Tests samplings shared by several surfaces: by resampling, and by deforming an icosphere.

use spharm_monitor::Silent;
use spharm_parametrize::{DeformParams, ParametrizeError, deform, resample};
use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::topology::{Topology, is_outward};

/// Returns a ball with arms, and the sphere from which the arms were pulled out.
fn arms() -> (Mesh, Mesh) {
    let sphere = icosphere(5);
    let pull = |&[x, y, z]: &[f64; 3]| {
        let r = 1.0 + 2.0 * x.powi(8) + 1.5 * y.max(0.0).powi(12) + 2.5 * (-z).max(0.0).powi(10);
        [r * x, r * y, r * z]
    };
    (sphere.with_vertices(sphere.vertices.iter().map(pull).collect()), sphere)
}

#[test]
fn the_own_sphere_gives_the_surface_itself() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 4, variant: 0 });
    // The shared sphere has another radius, and its vertices and triangles are in another order.
    let shared = Mesh::new(sphere.vertices.iter().rev().map(|v| v.map(|x| 64.0 * x)).collect(), {
        let last = sphere.vertices.len() as u32 - 1;
        sphere.faces.iter().rev().map(|face| face.map(|v| last - v)).collect()
    });
    let found = resample(&surface, &sphere, &shared, &Silent).unwrap();
    let turned: Vec<[f64; 3]> = surface.vertices.iter().rev().copied().collect();
    assert_eq!(found.surface.vertices, turned);
    assert_eq!(found.surface.faces, shared.faces);
    let distance = found.resampling.unwrap().distance;
    assert!(distance.hausdorff < 1e-12 * distance.scale);
    assert_eq!(found.sphere, shared, "what is shared stays as it is");
}

#[test]
fn denser_samplings_come_closer() {
    let (surface, sphere) = arms();
    let off = |subdivisions| {
        let found = resample(&surface, &sphere, &icosphere(subdivisions), &Silent).unwrap();
        assert!(found.report.quality.is_bijective());
        let distance = found.resampling.unwrap().distance;
        distance.mean / distance.scale
    };
    let (coarse, fine) = (off(3), off(4));
    assert!(fine < 0.5 * coarse && fine < 5e-3, "{coarse} {fine}");
}

#[test]
fn folded_and_foreign_spheres_are_refused() {
    let (surface, mut sphere) = arms();
    let shared = icosphere(2);
    let error = resample(&surface, &shared, &shared, &Silent).unwrap_err();
    assert!(matches!(error, ParametrizeError::Surface(_)), "{error}");
    sphere.vertices[7] = sphere.vertices[900];
    let error = resample(&surface, &sphere, &shared, &Silent).unwrap_err();
    assert!(matches!(error, ParametrizeError::NotBijective { .. }), "{error}");
    assert!(deform(&surface, &sphere, &DeformParams::default(), &Silent).is_err());
}

#[test]
fn a_deformed_icosphere_stays_one_and_lies_on_the_surface() {
    for (name, (surface, sphere)) in [("arms", arms()), ("cortex", cortex(&Cortex { subdivisions: 5, variant: 2 }))] {
        let params = DeformParams { subdivisions: Some(5), ..DeformParams::default() };
        let found = deform(&surface, &sphere, &params, &Silent).unwrap();
        let map = &found;
        assert_eq!((&map.sphere, &map.surface.faces), (&icosphere(5), &icosphere(5).faces), "{name}");
        assert!(Topology::of(&map.surface).is_sphere() && is_outward(&map.surface), "{name}");
        assert_eq!(found.resampling.unwrap().self_intersections, Some(0), "{name}: {:?}", map.report.warnings);
        let distance = found.resampling.unwrap().distance;
        let (mean, most) = (distance.mean / distance.scale, distance.hausdorff / distance.scale);
        assert!(mean < 3e-3 && most < 5e-2, "{name}: {mean} {most}");
        // Springs give more even triangles than plain resampling on the icosphere.
        let plain = resample(&surface, &sphere, &icosphere(5), &Silent).unwrap();
        let (own, others) = (&map.report.quality, &plain.report.quality);
        assert!(own.stretch < others.stretch, "{name}: {own:?} {others:?}");
        let again = deform(&surface, &sphere, &params, &Silent).unwrap();
        assert_eq!(again.surface.vertices, map.surface.vertices, "{name}: the same input, the same bits");
    }
}

#[test]
fn the_number_of_vertices_follows_the_surface() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
    let params = DeformParams { sweeps: 2, ..DeformParams::default() };
    assert_eq!(deform(&surface, &sphere, &params, &Silent).unwrap().report.vertices, 642);
    let params = DeformParams { subdivisions: Some(11), ..params };
    assert!(matches!(deform(&surface, &sphere, &params, &Silent), Err(ParametrizeError::Argument { .. })));
}
