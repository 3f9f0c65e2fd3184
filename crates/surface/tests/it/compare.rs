//! Tests vertex-wise distances and colours.

use spharm_monitor::Silent;
use spharm_surface::generate::icosphere;
use spharm_surface::metrics::{
    SurfaceDistanceParams, bounding_box_scale, colors, compare, compare_at, distances_to_surface, squared_distances,
    surface_distance_at, vertex_distances, viridis,
};
use spharm_surface::{Mesh, SurfaceError};

/// Returns an octahedron with a bounding box of 2 x 4 x 8 = 64, so that its scale is 4.
fn octahedron() -> Mesh {
    let vertices =
        vec![[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, 4.0], [0.0, 0.0, -4.0]];
    let faces = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    Mesh::new(vertices, faces)
}

#[test]
fn msd_and_xsd_are_the_papers() {
    let original = octahedron();
    let mut moved = original.clone();
    moved.vertices[2] = [0.0, 2.0, 3.0];
    moved.vertices[4] = [0.0, 1.0, 4.0];
    let d = compare(&original, &moved).unwrap();
    assert!((d.scale - 4.0).abs() < 1e-14);
    assert_eq!((d.worst_vertex, d.xsd_raw, d.msd_raw), (2, 9.0, 10.0 / 6.0));
    assert!((d.xsd - 9.0 / 16.0).abs() < 1e-14 && (d.msd - 10.0 / 96.0).abs() < 1e-14);
    let same = compare(&original, &original).unwrap();
    assert_eq!((same.msd, same.xsd), (0.0, 0.0));
}

#[test]
fn a_mask_leaves_out_vertices_and_the_triangles_at_them() {
    let original = icosphere(3);
    // The cap above z = 0.5 moves out by 0.1, and the rest by 0.01.
    let is_cap: Vec<bool> = original.vertices.iter().map(|v| v[2] > 0.5).collect();
    let grown = |v: &[f64; 3]| v.map(|x| if v[2] > 0.5 { 1.1 * x } else { 1.01 * x });
    let moved = original.with_vertices(original.vertices.iter().map(grown).collect());
    let rest: Vec<bool> = is_cap.iter().map(|cap| !cap).collect();
    let of = |mask: &[bool]| compare_at(&original, &moved, Some(mask)).unwrap();
    let (cap, others, all) = (of(&is_cap), of(&rest), compare(&original, &moved).unwrap());
    assert!((cap.rms_raw - 0.1).abs() < 1e-12 && (others.max_raw - 0.01).abs() < 1e-12);
    assert!(is_cap[cap.worst_vertex] && rest[others.worst_vertex] && cap.scale == all.scale);
    let count = is_cap.iter().filter(|cap| **cap).count() as f64;
    let total = count * cap.msd + (rest.len() as f64 - count) * others.msd;
    assert!((total / rest.len() as f64 / all.msd - 1.0).abs() < 1e-12);

    let params = SurfaceDistanceParams { samples: 20_000 };
    let between = |mask: Option<&[bool]>| surface_distance_at(&original, &moved, mask, &params, &Silent).unwrap();
    let (cap, others, all) = (between(Some(&is_cap)), between(Some(&rest)), between(None));
    assert!((0.08..0.101).contains(&cap.rms) && (0.009..0.0101).contains(&others.rms), "{} {}", cap.rms, others.rms);
    assert!(cap.forward.worst[2] > 0.49 && others.forward.worst[2] < 0.51 && cap.scale == all.scale);
    assert!(all.rms < cap.rms && others.rms < all.rms);
    let everything = between(Some(&vec![true; rest.len()]));
    assert_eq!(everything, all);

    let one: Vec<bool> = (0..rest.len()).map(|vertex| vertex == 5).collect();
    let no_triangle = surface_distance_at(&original, &moved, Some(&one), &params, &Silent);
    assert!(matches!(no_triangle, Err(SurfaceError::Argument { what: "mask", .. })));
    let none = compare_at(&original, &moved, Some(&vec![false; rest.len()]));
    assert!(matches!(none, Err(SurfaceError::Argument { what: "mask", .. })));
    let short = compare_at(&original, &moved, Some(&rest[1..]));
    assert!(matches!(short, Err(SurfaceError::LengthMismatch { expected: 642, found: 641, .. })));
}

#[test]
fn the_scale_does_not_depend_on_units_or_place() {
    let mut mesh = octahedron();
    for v in &mut mesh.vertices {
        *v = v.map(|x| 1e150 * x);
    }
    let scale = bounding_box_scale(&mesh.vertices).unwrap();
    assert!((scale / 4e150 - 1.0).abs() < 1e-14, "the volume itself overflows: {scale}");
}

/// Distances whose squares leave the range of f64 equal ordinary distances times a power of two.
#[test]
fn distances_of_any_size_are_those_of_ordinary_ones() {
    let original = octahedron();
    let mut moved = original.clone();
    moved.vertices[2] = [0.0, 2.0, 3.0];
    moved.vertices[4] = [0.25, 1.0, 5.0];
    let (vertices, surface) = (
        vertex_distances(&original.vertices, &moved.vertices).unwrap(),
        distances_to_surface(&original, &moved.vertices, &Silent).unwrap(),
    );
    assert_eq!(vertices[..4], [0.0, 0.0, 3.0, 0.0]);
    assert!(surface[4] > 0.5 && surface[0] < 1e-15);
    for exponent in [700, -700] {
        let by = 2f64.powi(exponent);
        let [a, b] =
            [&original, &moved].map(|mesh| mesh.vertices.iter().map(|v| v.map(|x| by * x)).collect::<Vec<_>>());
        let wanted = |values: &[f64]| values.iter().map(|x| by * x).collect::<Vec<_>>();
        assert_eq!(vertex_distances(&a, &b).unwrap(), wanted(&vertices));
        let (far, near) = (
            compare(&original.with_vertices(a.clone()), &moved.with_vertices(b.clone())).unwrap(),
            compare(&original, &moved).unwrap(),
        );
        assert_eq!(far.worst_vertex, near.worst_vertex);
        let lengths = [(far.scale, near.scale), (far.rms_raw, near.rms_raw), (far.max_raw, near.max_raw)];
        let relative = [(far.msd, near.msd), (far.xsd, near.xsd)];
        let pairs = relative.into_iter().chain(lengths.map(|(far, near)| (far, by * near)));
        assert!(pairs.into_iter().all(|(far, near)| (far / near - 1.0).abs() < 1e-14), "{far:?} {near:?}");
        // The squares are clamped to the ends of the range instead of becoming infinite or zero.
        let end = if exponent > 0 { f64::MAX } else { f64::from_bits(1) };
        assert_eq!((far.msd_raw, far.xsd_raw), (end, end));
        let found = distances_to_surface(&original.with_vertices(a), &b, &Silent).unwrap();
        let near = |(found, wanted): (f64, f64)| (found - wanted).abs() <= 1e-14 * by;
        assert!(found.into_iter().zip(wanted(&surface)).all(near));
    }
}

#[test]
fn a_reconstruction_that_is_not_a_number_never_passes_for_good() {
    let original = octahedron();
    let mut broken = original.clone();
    broken.vertices[3][0] = f64::NAN;
    let d = compare(&original, &broken).unwrap();
    assert!(d.msd.is_nan() && d.xsd.is_nan() && d.worst_vertex == 3);
}

#[test]
fn what_cannot_be_compared_is_told() {
    let original = octahedron();
    let error = compare(&original, &icosphere(0)).unwrap_err();
    assert!(matches!(error, SurfaceError::LengthMismatch { expected: 8, found: 20, .. }), "{error}");
    let mut turned = original.clone();
    turned.faces[5].rotate_left(1);
    turned.faces.swap(0, 7);
    assert_eq!(compare(&original, &turned).unwrap().xsd, 0.0, "the same triangles, told otherwise");
    let mut other = original.clone();
    other.faces[5] = original.faces[4];
    let error = compare(&original, &other).unwrap_err();
    assert!(matches!(error, SurfaceError::TopologyDiffers { face: 5, .. }), "{error}");
    let mut flat = original.clone();
    for v in &mut flat.vertices {
        v[1] = 0.5;
    }
    assert!(matches!(compare(&flat, &original), Err(SurfaceError::FlatBox { .. })));
    assert!(bounding_box_scale(&[]).is_err());
    assert!(squared_distances(&original.vertices, &original.vertices[1..]).is_err());
}

#[test]
fn colours_run_from_dark_blue_to_yellow() {
    // Colours of Matplotlib 3 at 0, 1/2 and 1. Between entries of the table, colours may be off by one step.
    for (x, wanted) in [(0.0, [68, 1, 84]), (0.5, [33, 145, 140]), (1.0, [253, 231, 37])] {
        assert_eq!(viridis(x), wanted);
    }
    assert_eq!((viridis(-3.0), viridis(9.0)), (viridis(0.0), viridis(1.0)));
    assert_eq!(viridis(f64::NAN), [128; 3]);
    assert_eq!(colors(&[2.0, 4.0, 6.0], 2.0, 6.0), [viridis(0.0), viridis(0.5), viridis(1.0)]);
    assert_eq!(colors(&[5.0], 5.0, 5.0), [viridis(0.0)], "no range");
}
