//! Tests maps of public surfaces.

use spharm_monitor::Silent;
use spharm_parametrize::{CaldParams, ParametrizeError, Quality, auto, cald};
use spharm_surface::Mesh;
use spharm_surface::io::read_mesh;

/// Returns a mesh of the shared test data; `None` if the data isn't available.
fn shared(name: &str) -> Option<Mesh> {
    spharm_testdata::shared(name).map(|path| read_mesh(&path).unwrap())
}

#[test]
fn areas_come_out_equal() {
    for name in
        ["head.obj", "bowl.obj", "spot.obj", "homer.obj", "hippo_a01_l.obj", "hippo_a02_l.obj", "hippo_a03_l.obj"]
    {
        let Some(mesh) = shared(name) else { continue };
        let report = cald(&mesh, &CaldParams::default(), &Silent).unwrap().report;
        assert!(report.quality.area_rms <= 0.10, "{name}: {report:?}");
    }
}

#[test]
fn hippocampi_are_no_worse_than_as_published() {
    for name in ["hippo_a01_l", "hippo_a02_l", "hippo_a03_l"] {
        let (Some(mesh), Some(sphere)) = (shared(&format!("{name}.obj")), shared(&format!("{name}.sphere.obj"))) else {
            continue;
        };
        let published = Quality::of(&mesh, &sphere);
        let ours = auto(&mesh, &CaldParams::default(), &Silent).unwrap().report.quality;
        assert!(ours.area_rms <= published.area_rms, "{name}: {ours:?} {published:?}");
        assert!(ours.stretch <= published.stretch, "{name}: {ours:?} {published:?}");
    }
}

#[test]
fn surfaces_that_are_not_spheres_are_refused_with_counts() {
    for name in ["bad_cow.obj", "bad_suzanne.obj"] {
        let Some(mesh) = shared(name) else { continue };
        let error = auto(&mesh, &CaldParams::default(), &Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::BadSurface { .. }), "{name}");
        let text = error.to_string();
        assert!(text.chars().any(|c| c.is_ascii_digit()), "{name}: {text}");
        eprintln!("{name}: {text}");
    }
}
