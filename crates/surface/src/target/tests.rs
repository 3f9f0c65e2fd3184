use super::*;
use crate::generate::{Cortex, cortex};

#[test]
fn a_surface_has_the_vertices_and_triangles_of_its_sphere() {
    let (surface, sphere) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    let sphere = Sphere::from_mesh(&sphere).unwrap();
    let target = Target::from_mesh(&surface, &sphere).unwrap();
    assert_eq!((target.channels, target.kind, target.values.len()), (3, Kind::Surface, 3 * 162));
    assert!(target.warnings.is_empty());
    assert_eq!(target.meta, surface.meta);

    let mut other = surface.clone();
    other.faces[0] = other.faces[1];
    let error = Target::from_mesh(&other, &sphere).unwrap_err();
    assert!(matches!(error, SurfaceError::OtherTriangles { differ: 2, .. }), "{error}");
    let error = Target::from_mesh(&surface, &Sphere::icosphere(1)).unwrap_err();
    assert!(matches!(error, SurfaceError::VertexCount { expected: 42, found: 162, .. }), "{error}");
    let mut broken = surface;
    broken.vertices[7][1] = f64::NAN;
    let error = Target::from_mesh(&broken, &sphere).unwrap_err();
    assert!(matches!(error, SurfaceError::NonFinite { vertex: 7, .. }), "{error}");
    let target = Target::from_mesh_with_gaps(&broken, &sphere).unwrap();
    let unread: Vec<bool> = (0..162).map(|vertex| vertex == 7).collect();
    assert!(target.check_finite(Some(&unread)).is_ok());
    for unread in [None, Some(&vec![false; 162][..])] {
        let error = target.check_finite(unread).unwrap_err();
        assert!(matches!(error, SurfaceError::NonFinite { vertex: 7, .. }), "{error}");
    }
}

#[test]
fn an_open_surface_is_a_warning() {
    let mut mesh = crate::generate::icosphere(2);
    mesh.faces.truncate(300);
    let sphere = Sphere::from_mesh(&mesh).unwrap();
    let target = Target::from_mesh(&mesh, &sphere).unwrap();
    assert!(target.warnings[0].to_string().starts_with("not a closed surface of genus zero: "));
}

#[test]
fn hemispheres_are_compared() {
    let (mut surface, mut sphere) = cortex(&Cortex { subdivisions: 1, variant: 0 });
    surface.meta.anatomical_structure_primary = Some("CortexLeft".to_owned());
    for (structure, differ) in [("CortexRight", true), ("CortexLeft", false), ("Cortex", false)] {
        sphere.meta.anatomical_structure_primary = Some(structure.to_owned());
        let sphere = Sphere::from_mesh(&sphere).unwrap();
        let warnings = Target::from_mesh(&surface, &sphere).unwrap().warnings;
        let expected = TargetWarning::OtherHemisphere { target: Hemisphere::Left, sphere: Hemisphere::Right };
        assert_eq!(warnings, if differ { vec![expected] } else { Vec::new() }, "{structure}");
    }
}

#[test]
fn a_sphere_that_turns_a_surface_inside_out_is_a_warning() {
    let (surface, outward) = cortex(&Cortex { subdivisions: 2, variant: 0 });
    let mirrored = outward.with_vertices(outward.vertices.iter().map(|&[x, y, z]| [-x, y, z]).collect());
    let inside_out = surface.with_vertices(surface.vertices.iter().map(|&[x, y, z]| [x, -y, z]).collect());
    let warnings = |surface: &Mesh, sphere: &Mesh| {
        let sphere = Sphere { path: Some("rh.sphere".into()), ..Sphere::from_mesh(sphere).unwrap() };
        Target::from_mesh(surface, &sphere).unwrap().warnings
    };
    let expected = vec![TargetWarning::Reversed { sphere: Some("rh.sphere".into()) }];
    assert_eq!(warnings(&surface, &mirrored), expected);
    assert_eq!(warnings(&inside_out, &outward), expected);
    assert!(expected[0].to_string().starts_with("the sphere rh.sphere reverses the orientation of the surface; "));
    assert!(warnings(&surface, &outward).is_empty());
    assert!(warnings(&inside_out, &mirrored).is_empty(), "both wind inwards");
    // The winding of the surface's own triangles doesn't matter, only the orientation of the map from sphere to
    // surface.
    let mut rewound = surface;
    rewound.faces.iter_mut().for_each(|face| face.swap(0, 1));
    assert!(warnings(&rewound, &outward).is_empty());
}

#[test]
fn the_name_of_a_file_determines_the_hemisphere_of_its_contents() {
    let (mesh, sphere) = cortex(&Cortex { subdivisions: 1, variant: 0 });
    let sphere = Sphere { path: Some("rh.sphere".into()), ..Sphere::from_mesh(&sphere).unwrap() };
    let signal = Signal::new(vec![f64::NAN; 42], 42, 1);
    for input in [Input::Mesh(mesh), Input::Signal(signal)] {
        let target = Target::with_gaps(input, Some(Path::new("lh.x")), &sphere).unwrap();
        let expected = TargetWarning::OtherHemisphere { target: Hemisphere::Left, sphere: Hemisphere::Right };
        assert_eq!((target.warnings, target.path), (vec![expected], Some("lh.x".into())));
    }
}

#[test]
fn a_mask_of_the_other_hemisphere_is_a_warning() {
    let named = Sphere { path: Some("lh.sphere".into()), ..Sphere::icosphere(0) };
    let (left, mask) = (Hemisphere::Left, Path::new("label/rh.cortex.label"));
    let expected = TargetWarning::OtherMask { target: left, mask: mask.into(), of: Hemisphere::Right };
    for (path, sphere, mask, warned) in [
        ("lh.thickness", Sphere::icosphere(0), mask, true),
        ("thickness", named, mask, true),
        ("thickness", Sphere::icosphere(0), mask, false),
        ("lh.thickness", Sphere::icosphere(0), Path::new("lh.cortex.label"), false),
        ("lh.thickness", Sphere::icosphere(0), Path::new("cortex.label"), false),
    ] {
        let signal = Input::Signal(Signal::new(vec![0.5; 12], 12, 1));
        let mut target = Target::with_gaps(signal, Some(Path::new(path)), &sphere).unwrap();
        target.check_mask(mask, &sphere);
        assert_eq!(target.warnings, if warned { vec![expected.clone()] } else { Vec::new() }, "{path}");
    }
}

#[test]
fn tables_with_an_index_or_decimal_commas_are_noticed() {
    let (folder, sphere) = (tempfile::tempdir().unwrap(), Sphere::icosphere(0));
    let path = folder.path().join("values.csv");
    let read = |head: &str, row: &dyn Fn(usize) -> String| {
        std::fs::write(&path, format!("{head}{}", (0..12).map(row).collect::<String>())).unwrap();
        read_target_with_gaps(&path, &sphere)
    };
    let target = read("vertex,thickness\n", &|i| format!("{i},2.5\n")).unwrap();
    assert_eq!((target.channels, &target.values), (1, &vec![2.5; 12]));
    assert!(matches!(&target.warnings[..], [note] if note.is_note() && note.to_string().contains("\"vertex\"")));
    let error = read("vertex,thickness\n", &|i| format!("{},2.5\n", 11 - i)).unwrap_err();
    assert!(error.to_string().contains("values.csv") && error.to_string().contains("sort the rows"), "{error}");
    let target = read("", &|i| format!("{i},0500\n")).unwrap();
    let [warning] = &target.warnings[..] else { panic!("{:?}", target.warnings) };
    let remedies = "with decimal points, as 0.0500; if they are two channels, add a first line of column names";
    assert!(!warning.is_note() && warning.to_string().ends_with(remedies), "{warning}");
    assert!(read("a,b\n", &|i| format!("{i},0500\n")).unwrap().warnings.is_empty());
    let target = read(",vertex,thickness\n", &|i| format!("{i},{i},2.5\n")).unwrap();
    let notes: Vec<String> = target.warnings.iter().map(TargetWarning::to_string).collect();
    assert!(notes.len() == 2 && notes[0].contains("\"\"") && notes[1].contains("\"vertex\""), "{notes:?}");
    assert_eq!(target.channels, 1);
}

#[test]
fn signals_count_too() {
    let sphere = Sphere::icosphere(0);
    let target = Target::from_signal(Signal::new(vec![0.5; 24], 12, 2), &sphere).unwrap();
    assert_eq!((target.channels, target.kind), (2, Kind::Signal));
    let error = Target::from_signal(Signal::new(vec![0.5; 10], 10, 1), &sphere).unwrap_err();
    assert!(error.to_string().contains("10 vertices, but the sphere has 12"), "{error}");
}
