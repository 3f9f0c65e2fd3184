//! Tests that the generated cortex is as documented: closed, embedded, not star-shaped, reproducible.

use std::collections::HashMap;

use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, cortex, icosphere};
use spharm_surface::topology::{Topology, is_outward};

type Vec3 = [f64; 3];

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
}

fn surface(subdivisions: u32, variant: u64) -> Mesh {
    cortex(&Cortex { subdivisions, variant }).0
}

#[test]
fn it_is_a_closed_surface_over_its_sphere_of_a_brains_size() {
    for variant in [0, 1, 12] {
        let (surface, sphere) = cortex(&Cortex { subdivisions: 5, variant });
        assert_eq!(sphere, icosphere(5));
        assert_eq!(surface.faces, sphere.faces);
        assert_eq!(surface.meta.anatomical_structure_primary.as_deref(), Some("Cortex"));
        assert_eq!(surface.meta.surface_metadata, [("GeometricType".to_owned(), "Anatomical".to_owned())]);
        assert!(Topology::of(&surface).is_sphere() && is_outward(&surface));
        for (axis, extent) in [110.0, 140.0, 90.0].into_iter().enumerate() {
            let along = || surface.vertices.iter().map(|v| v[axis]);
            let found = along().fold(f64::MIN, f64::max) - along().fold(f64::MAX, f64::min);
            assert!((found - extent).abs() < 1e-9);
        }
    }
}

/// If a surface is star-shaped about a point, all its triangles face away from the point.
#[test]
fn it_is_not_star_shaped_from_anywhere_near_its_middle() {
    let mesh = surface(5, 0);
    let mut random = crate::Random(3);
    for trial in 0..60 {
        let point: Vec3 = match trial {
            0 => [0.0; 3],
            _ => [70.0, 90.0, 60.0].map(|extent| extent * (random.below(1000) as f64 / 1000.0 - 0.5)),
        };
        let turned_in = mesh.faces.iter().filter(|face| {
            let [a, b, c] = face.map(|i| mesh.vertices[i as usize]);
            dot(cross(sub(b, a), sub(c, a)), sub(a, point)) < 0.0
        });
        assert!(turned_in.count() > 100, "from {point:?}");
    }
}

/// Returns whether a segment and a triangle cross in their interiors.
fn pierces(p: Vec3, q: Vec3, [a, b, c]: [Vec3; 3]) -> bool {
    let volume = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| dot(sub(d, a), cross(sub(b, a), sub(c, a)));
    if volume(a, b, c, p) * volume(a, b, c, q) >= 0.0 {
        return false;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0)
}

/// Counts the pairs of triangles that cross and have no common vertex. Candidates are found with a grid of cells.
fn crossings(mesh: &Mesh, cell: f64) -> usize {
    let corners = |f: usize| mesh.faces[f].map(|i| mesh.vertices[i as usize]);
    let range = |t: [Vec3; 3], axis: usize| {
        let along = t.map(|v| v[axis] / cell);
        along.iter().copied().fold(f64::MAX, f64::min).floor() as i64
            ..=along.iter().copied().fold(f64::MIN, f64::max).floor() as i64
    };
    let mut grid: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    for f in 0..mesh.faces.len() {
        let t = corners(f);
        for x in range(t, 0) {
            for y in range(t, 1) {
                for z in range(t, 2) {
                    grid.entry([x, y, z]).or_default().push(f);
                }
            }
        }
    }
    let mut pairs = std::collections::HashSet::new();
    for members in grid.values() {
        for (k, &f) in members.iter().enumerate() {
            for &g in &members[k + 1..] {
                if mesh.faces[f].iter().any(|i| mesh.faces[g].contains(i)) {
                    continue;
                }
                let (s, t) = (corners(f), corners(g));
                if (0..3).any(|k| pierces(s[k], s[(k + 1) % 3], t) || pierces(t[k], t[(k + 1) % 3], s)) {
                    pairs.insert((f.min(g), f.max(g)));
                }
            }
        }
    }
    pairs.len()
}

#[test]
fn no_two_triangles_cross() {
    for variant in [0, 1, 2] {
        assert_eq!(crossings(&surface(5, variant), 4.0), 0, "variant {variant}");
    }
    // Verifies that the test finds a crossing in a mesh that has one.
    let mut mesh = surface(3, 0);
    mesh.vertices[0] = mesh.vertices[11].map(|x| 1.5 * x);
    assert!(crossings(&mesh, 15.0) > 0);
}

#[test]
fn variants_are_subjects_of_one_study() {
    let mean = |a: &Mesh, b: &Mesh| {
        let squared = a.vertices.iter().zip(&b.vertices).map(|(&p, &q)| dot(sub(p, q), sub(p, q)));
        (squared.sum::<f64>() / a.vertices.len() as f64).sqrt()
    };
    let (zero, again, one, two) = (surface(4, 0), surface(4, 0), surface(4, 1), surface(4, 2));
    assert_eq!(zero, again);
    for (a, b) in [(&zero, &one), (&zero, &two), (&one, &two)] {
        let distance = mean(a, b);
        assert!((1.0..15.0).contains(&distance), "{distance} mm");
    }
}
