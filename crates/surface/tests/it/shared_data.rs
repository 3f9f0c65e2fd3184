//! Tests with public surfaces.

use spharm_surface::Mesh;
use spharm_surface::io::read_mesh;
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::topology::{Topology, is_outward};
use spharm_testdata::shared;

fn mesh(name: &str) -> Option<Mesh> {
    shared(name).map(|path| read_mesh(path).unwrap())
}

#[test]
fn closed_surfaces_of_genus_zero_are_taken() {
    for (name, vertices) in [
        ("cort40962.surf.gii", 40_962),
        ("cort40962.sphere.surf.gii", 40_962),
        ("head27618.surf.gii", 27_618),
        ("head27618.sphere.surf.gii", 27_618),
        ("head.obj", 1_728),
        ("fsaverage5.pial_left.gii.gz", 10_242),
        ("fsaverage5.white_left.gii.gz", 10_242),
        ("fsaverage5.sphere_left.gii.gz", 10_242),
        ("hippo_a01_l.obj", 2_386),
        ("spot.obj", 2_930),
        ("homer.obj", 6_002),
        ("nefertiti.obj", 49_971),
    ] {
        let Some(mesh) = mesh(name) else { continue };
        let topology = Topology::of(&mesh);
        assert!(topology.is_sphere(), "{name}: {:?}", topology.problems());
        assert!(topology.problems().is_empty());
        assert_eq!(topology.euler_characteristic, 2);
        assert_eq!(mesh.vertices.len(), vertices, "{name}");
    }
}

#[test]
fn brains_are_wound_outward() {
    for name in ["cort40962.surf.gii", "fsaverage5.pial_left.gii.gz", "head27618.surf.gii"] {
        if let Some(mesh) = mesh(name) {
            assert!(is_outward(&mesh), "{name}");
        }
    }
}

#[test]
fn others_are_refused_with_their_counts() {
    for name in ["bad_cow.obj", "bad_suzanne.obj"] {
        let Some(mesh) = mesh(name) else { continue };
        let topology = Topology::of(&mesh);
        assert!(!topology.is_sphere() && topology.genus().is_none(), "{name}: {topology:?}");
        let problems = topology.problems();
        assert!(problems.iter().any(|p| p.starts_with(|c: char| c.is_ascii_digit())), "{problems:?}");
    }
}

/// The values in `reference.json` were computed with NumPy from the same files.
#[test]
fn bounding_box_scales_are_the_references() {
    let Some(path) = shared("reference.json") else {
        return;
    };
    let reference: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    for name in ["cort40962", "head27618"] {
        let Some(mesh) = mesh(&format!("{name}.surf.gii")) else {
            continue;
        };
        let wanted = reference[name]["scale"].as_f64().unwrap();
        let found = bounding_box_scale(&mesh.vertices).unwrap();
        assert!((found / wanted - 1.0).abs() < 4.0 * f64::EPSILON, "{name}: {found} {wanted}");
    }
}

#[test]
fn gifti_metadata_of_a_published_surface_is_read() {
    let Some(mesh) = mesh("fsaverage5.pial_left.gii.gz") else {
        return;
    };
    assert_eq!(mesh.meta.anatomical_structure_primary.as_deref(), Some("CortexLeft"));
    assert_eq!(mesh.meta.coordinate_system.unwrap().transformed_space, "NIFTI_XFORM_TALAIRACH");
}
