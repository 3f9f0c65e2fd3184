//! Tests that generated surfaces don't change, by their defining properties and by the positions of some vertices. The
//! documentation's examples and figures and other tests depend on these surfaces. Between machines the last bits may
//! differ.

use spharm_surface::Mesh;
use spharm_surface::generate::{Cortex, Study, Torus, cortex, double_torus, torus};
use spharm_surface::topology::{Topology, signed_volume};

/// Checks the numbers of vertices and triangles, the vertex a third of the way through the list, and the mean of the
/// squared coordinates.
fn is(mesh: &Mesh, counts: [usize; 2], third: [f64; 3], squares: [f64; 3]) {
    let vertices = &mesh.vertices;
    assert_eq!([vertices.len(), mesh.faces.len()], counts);
    let found = vertices[vertices.len() / 3];
    let mean = |k: usize| vertices.iter().map(|v| v[k] * v[k]).sum::<f64>() / vertices.len() as f64;
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * (1.0 + b.abs());
    let all = (0..3).all(|k| near(found[k], third[k]) && near(mean(k), squares[k]));
    assert!(all, "{found:?}, {:?}", [mean(0), mean(1), mean(2)]);
}

/// Vertices satisfy (ring - (x^2 + y^2)^(1/2))^2 + z^2 = r^2, with r the tube's radius including the bumps.
#[test]
fn tori_keep_to_their_equation() {
    for (ring, tube, bumps, around) in [(2.0, 1.0, 0.0, 40), (5.0, 1.5, 0.2, 24), (1.5, 1.0, 0.1, 3)] {
        let mesh = torus(&Torus { ring, tube, bumps, around });
        let along = (f64::from(around) * ring / tube).round() as usize;
        assert_eq!(mesh.vertices.len(), along * around as usize);
        assert_eq!(Topology::of(&mesh).genus(), Some(1));
        for [x, y, z] in &mesh.vertices {
            let out = x.hypot(*y) - ring;
            let (u, v) = (y.atan2(*x), z.atan2(out));
            let r = tube * (1.0 + bumps * (5.0 * u).cos() * (3.0 * v).sin());
            assert!((out.hypot(*z) - r).abs() < 1e-12 * ring, "{x} {y} {z}");
        }
        // The sections are evenly spaced around the ring, and the first one is on the x axis.
        let turn = std::f64::consts::TAU / along as f64;
        let second = mesh.vertices[around as usize];
        assert!((second[1].atan2(second[0]) - turn).abs() < 1e-12);
        // The diagonals of neighbouring quadrangles have different directions.
        assert_ne!(mesh.faces[0][2] - mesh.faces[0][0], mesh.faces[2][2] - mesh.faces[2][0]);
    }
}

#[test]
fn a_double_torus_keeps_to_its_equation() {
    for cells in [32, 61] {
        let mesh = double_torus(cells);
        for &[x, y, z] in &mesh.vertices {
            let plane = (x * x + y * y).powi(2) - x * x + y * y;
            assert!((plane * plane + z * z - 0.02).abs() < 1e-12, "{x} {y} {z}");
        }
        // The two halves are nearly mirror images; the grid is slightly off the middle.
        let mean = mesh.vertices.iter().map(|v| v[0]).sum::<f64>() / mesh.vertices.len() as f64;
        assert!(mean.abs() < 0.01, "{mean}");
        // Edges have about the size of the grid cells.
        let edge = |f: &[u32; 3], k: usize| {
            let [a, b] = [f[k], f[(k + 1) % 3]].map(|v| mesh.vertices[v as usize]);
            (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
        };
        let longest = mesh.faces.iter().flat_map(|f| [edge(f, 0), edge(f, 1), edge(f, 2)]).fold(0.0, f64::max);
        assert!(longest < 2.5 * 2.4 / f64::from(cells), "{longest}");
    }
}

#[test]
fn surfaces_are_the_ones_that_they_were() {
    let (first, second) = (Cortex { subdivisions: 3, variant: 0 }, Cortex { subdivisions: 3, variant: 7 });
    let third = [34.00237659292443, 47.17979038519812, 4.160174885664802];
    is(&cortex(&first).0, [642, 1280], third, [865.5560145124016, 1310.841179494989, 552.5796417803625]);
    let third = [33.381545645358045, 47.92054321193264, 5.9359308085526];
    is(&cortex(&second).0, [642, 1280], third, [845.1212297114702, 1279.4148220672096, 570.8804446203685]);
    let study = Study { seed: 5, ..Study::default() };
    let third = [-27.511178666650117, 21.191643199836953, -26.956247369753335];
    let squares = [1165.4043898922089, 532.2635341038233, 407.5331036636127];
    is(&study.subject(1, false), [2562, 5120], third, squares);
    let third = [-30.717226355560765, -23.244075900595, -17.561506183700004];
    is(&study.subject(1, true), [2562, 5120], third, [1390.0581064730547, 838.756483012467, 168.2844212088975]);
    assert_eq!([double_torus(32).vertices.len(), double_torus(32).faces.len()], [986, 1976]);
}

/// The bump adds volume to subjects of the second group, in proportion to its height, and doesn't affect the first
/// group.
#[test]
fn a_studys_second_group_has_a_bump() {
    let volume = |bump, second| signed_volume(&Study { subdivisions: 4, seed: 3, bump }.subject(4, second));
    assert_eq!(volume(0.0, false), volume(2.0, false));
    let (flat, raised, twice) = (volume(0.0, true), volume(2.0, true), volume(4.0, true));
    assert!(raised > flat + 100.0 && twice > raised + 100.0, "{flat} {raised} {twice}");
    // A bent ellipsoid, about 40 mm long, 22 mm wide and 16 mm high, has the volume 4/3 pi a b c; the waves change it
    // slightly.
    let body = 4.0 / 3.0 * std::f64::consts::PI * 20.0 * 11.0 * 8.0;
    assert!((flat / body - 1.0).abs() < 0.1, "{}", flat / body);
}
