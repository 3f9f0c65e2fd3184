//! Tests that the counts of a mesh's defects are correct.

use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::topology::{Topology, is_outward, signed_volume};

fn sphere() -> Mesh {
    icosphere(2)
}

/// Returns a torus of m x n quadrangles, each split into two triangles.
fn torus(m: u32, n: u32) -> Mesh {
    let turn = std::f64::consts::TAU;
    let vertices = (0..m * n).map(|k| {
        let (u, v) = (turn * f64::from(k / n) / f64::from(m), turn * f64::from(k % n) / f64::from(n));
        let r = 3.0 + v.cos();
        [r * u.cos(), r * u.sin(), v.sin()]
    });
    let at = |i: u32, j: u32| (i % m) * n + j % n;
    let faces = (0..m * n).flat_map(|k| {
        let (i, j) = (k / n, k % n);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    Mesh::new(vertices.collect(), faces.collect())
}

#[test]
fn icospheres_have_the_counts_of_the_formula_and_nest() {
    let finest = icosphere(5);
    for s in 0..=5 {
        let mesh = icosphere(s);
        let topology = Topology::of(&mesh);
        let quarter = 4_usize.pow(s);
        assert_eq!(topology.vertices, 10 * quarter + 2);
        assert_eq!(topology.edges, 30 * quarter);
        assert_eq!(topology.faces, 20 * quarter);
        assert!(topology.is_sphere() && topology.duplicate_vertices == 0 && is_outward(&mesh));
        assert_eq!(mesh.vertices, finest.vertices[..mesh.vertices.len()], "nested at {s}");
        for v in &mesh.vertices {
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((length - 1.0).abs() <= 2.0 * f64::EPSILON);
        }
    }
}

#[test]
fn volumes() {
    // The icosphere's volume is smaller than the ball's by O(h^2), with h the length of an edge.
    let mut mesh = icosphere(5);
    let ball = 4.0 / 3.0 * std::f64::consts::PI;
    assert!((signed_volume(&mesh) / ball - 1.0).abs() < 2e-3);
    // Far from the origin, a naive sum of volumes would lose its digits.
    for v in &mut mesh.vertices {
        *v = [v[0] + 1e6, v[1] - 2e6, v[2] + 3e6];
    }
    assert!((signed_volume(&mesh) / ball - 1.0).abs() < 2e-3);
    for face in &mut mesh.faces {
        face.swap(0, 1);
    }
    assert!(!is_outward(&mesh) && Topology::of(&mesh).is_sphere(), "inside out is a sphere still");
}

#[test]
fn a_hole() {
    let mut mesh = sphere();
    mesh.faces.pop();
    let topology = Topology::of(&mesh);
    assert_eq!((topology.boundary_edges, topology.euler_characteristic), (3, 1));
    assert!(!topology.is_sphere() && topology.genus().is_none());
    assert_eq!(topology.problems(), ["3 edges belong to one triangle only: the surface has holes"]);
}

#[test]
fn a_turned_triangle() {
    let mut mesh = sphere();
    mesh.faces[7].swap(1, 2);
    let topology = Topology::of(&mesh);
    assert_eq!(topology.inconsistent_edges, 3);
    assert_eq!(topology.problems().len(), 1);
}

#[test]
fn a_surface_with_one_side() {
    // Seven triangles in a ring with a half twist; with 8 triangles the ring has two sides.
    let strip = |n: u32| {
        let faces = (0..n).map(|k| [k, (k + 1) % n, (k + 2) % n]).collect();
        Topology::of(&Mesh::new((0..n).map(|k| [f64::from(k), 0.0, 0.0]).collect(), faces))
    };
    let one = strip(7);
    assert!(one.one_sided && one.inconsistent_edges > 0);
    let problems = one.problems().join("; ");
    assert!(problems.contains("one side only") && !problems.contains("orientation"), "{problems}");
    let two = strip(8);
    assert!(!two.one_sided && two.inconsistent_edges > 0);
    assert!(two.problems().join("; ").contains("opposite orientation"));
}

#[test]
fn a_handle() {
    let topology = Topology::of(&torus(7, 5));
    assert_eq!((topology.genus(), topology.euler_characteristic), (Some(1), 0));
    assert!(!topology.is_sphere());
    assert_eq!(topology.problems(), ["the surface has a handle (genus 1)"]);
}

#[test]
fn two_spheres_apart_and_touching_in_a_vertex() {
    let one = sphere();
    let n = one.vertices.len() as u32;
    let mut two = one.clone();
    two.vertices.extend(one.vertices.iter().map(|v| [v[0], v[1], v[2] + 2.0]));
    two.faces.extend(one.faces.iter().map(|f| f.map(|i| i + n)));
    let topology = Topology::of(&two);
    assert_eq!((topology.components, topology.euler_characteristic), (2, 4));
    assert_eq!(topology.duplicate_vertices, 1, "the lower's north pole is the upper's south pole");
    assert!(!topology.is_sphere());

    // Joins the two spheres where they touch: vertex 0 is the north pole, vertex 11 the south pole.
    for face in &mut two.faces[one.faces.len()..] {
        *face = face.map(|i| if i == n + 11 { 0 } else { i });
    }
    let topology = Topology::of(&two);
    assert_eq!((topology.components, topology.non_manifold_vertices, topology.unreferenced_vertices), (1, 1, 1));
    assert!(topology.genus().is_none());
}

#[test]
fn a_fin() {
    let mut mesh = sphere();
    let [a, b, _] = mesh.faces[0];
    mesh.vertices.push([2.0, 2.0, 2.0]);
    mesh.faces.push([b, a, mesh.vertices.len() as u32 - 1]);
    let topology = Topology::of(&mesh);
    assert_eq!((topology.non_manifold_edges, topology.boundary_edges), (1, 2));
    assert_eq!(topology.non_manifold_vertices, 0, "its fans hang together at the edge");
}

#[test]
fn repeated_and_degenerate_triangles_and_loose_vertices() {
    let mut mesh = sphere();
    let [a, b, c] = mesh.faces[3];
    mesh.faces.push([b, c, a]);
    mesh.faces.push([c, b, a]);
    assert_eq!(Topology::of(&mesh).duplicate_faces, 2);

    // Two triangles back to back have correct edge counts but are duplicates of each other.
    let pillow = Mesh::new(sphere().vertices[..3].to_vec(), vec![[0, 1, 2], [0, 2, 1]]);
    let topology = Topology::of(&pillow);
    assert_eq!((topology.boundary_edges, topology.euler_characteristic), (0, 2));
    assert!(!topology.is_sphere());

    let mut mesh = sphere();
    mesh.faces.push([4, 4, 9]);
    mesh.vertices.push([0.0, 0.0, 0.0]);
    mesh.vertices.push([-0.0, 0.0, 0.0]);
    let topology = Topology::of(&mesh);
    assert_eq!((topology.degenerate_faces, topology.unreferenced_vertices, topology.duplicate_vertices), (1, 2, 1));
    assert_eq!((topology.components, topology.euler_characteristic), (1, 2));
    assert!(!topology.is_sphere());
}

#[test]
fn an_unwelded_mesh_is_told_to_be_welded() {
    let mesh = sphere();
    let soup = Mesh::new(
        mesh.faces.iter().flat_map(|f| f.map(|i| mesh.vertices[i as usize])).collect(),
        (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
    );
    let topology = Topology::of(&soup);
    assert_eq!(topology.components, mesh.faces.len());
    assert_eq!(topology.duplicate_vertices, soup.vertices.len() - mesh.vertices.len());
    assert!(topology.problems().iter().any(|p| p.contains("welding")));
}

fn sorted(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}

/// Counts pieces by repeatedly adding vertices that share a triangle.
fn pieces(faces: &[[u32; 3]], mut unseen: std::collections::BTreeSet<u32>) -> usize {
    let mut count = 0;
    while let Some(first) = unseen.pop_first() {
        count += 1;
        let mut reached = std::collections::BTreeSet::from([first]);
        loop {
            let before = reached.len();
            for face in faces.iter().filter(|f| f.iter().any(|v| reached.contains(v))).collect::<Vec<_>>() {
                reached.extend(face);
            }
            if reached.len() == before {
                break;
            }
        }
        unseen.retain(|v| !reached.contains(v));
    }
    count
}

/// Compares the fast counts with simple counts over a set of edges, on random triangles.
#[test]
fn counts_agree_with_a_plain_count_on_random_triangles() {
    use std::collections::{BTreeMap, BTreeSet};
    let mut random = crate::Random(11);
    for round in 0..200 {
        let n = 3 + random.below(12);
        let faces: Vec<[u32; 3]> =
            (0..1 + random.below(30)).map(|_| [0; 3].map(|_: u32| random.below(n) as u32)).collect();
        let mesh = Mesh::new((0..n).map(|i| [i as f64, 0.0, 0.0]).collect(), faces.clone());
        let found = Topology::of(&mesh);

        let mut directed: BTreeMap<(u32, u32), Vec<bool>> = BTreeMap::new();
        let proper: Vec<_> = faces.iter().filter(|f| f[0] != f[1] && f[1] != f[2] && f[2] != f[0]).collect();
        for f in &proper {
            for k in 0..3 {
                let (a, b) = (f[k], f[(k + 1) % 3]);
                directed.entry((a.min(b), a.max(b))).or_default().push(a < b);
            }
        }
        let with = |test: &dyn Fn(&Vec<bool>) -> bool| directed.values().filter(|d| test(d)).count();
        assert_eq!(found.edges, directed.len(), "round {round}");
        assert_eq!(found.boundary_edges, with(&|d| d.len() == 1));
        assert_eq!(found.non_manifold_edges, with(&|d| d.len() > 2));
        assert_eq!(found.inconsistent_edges, with(&|d| d.len() == 2 && d[0] == d[1]));
        let sets: BTreeSet<_> = faces.iter().map(|&f| sorted(f)).collect();
        assert_eq!(found.duplicate_faces, faces.len() - sets.len());
        let used: BTreeSet<u32> = faces.iter().flatten().copied().collect();
        assert_eq!(found.unreferenced_vertices, n - used.len());
        assert_eq!(found.degenerate_faces, faces.len() - proper.len());
        assert_eq!(found.components, pieces(&faces, used));
    }
}
