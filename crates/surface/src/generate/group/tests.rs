use super::*;
use crate::nearest::TriangleTree;
use crate::topology::Topology;

fn group(family: Family) -> Group {
    Group { family, members: 8, seed: 3, subdivisions: 4, upright: false }
}

fn volume(mesh: &Mesh) -> f64 {
    let corner = |face: &[u32; 3], k: usize| mesh.vertices[face[k] as usize];
    mesh.faces.iter().map(|face| dot(corner(face, 0), cross(corner(face, 1), corner(face, 2)))).sum::<f64>() / 6.0
}

#[test]
fn members_are_closed_surfaces_with_their_places_on_them() {
    for family in Family::ALL {
        let group = group(family);
        for index in [0, 5] {
            let member = group.member(index);
            assert_eq!(member, group.member(index));
            assert_eq!(member.parameters.len(), family.parameters().len());
            let topology = Topology::of(&member.mesh);
            assert_eq!(topology.is_sphere(), family != Family::Tori, "{}", family.name());
            assert!(volume(&member.mesh) > 100.0, "{} {}", family.name(), volume(&member.mesh));
            // Places lie on the exact shape, so their distance from the mesh is at most the distance between a flat
            // facet and the shape.
            let tree = TriangleTree::new(&member.mesh);
            for (name, place) in member.names.iter().zip(&member.places) {
                let distance = tree.nearest(*place).unwrap().distance;
                assert!(distance < 0.7, "{} {name}: {distance}", family.name());
            }
            let upright = Group { upright: true, ..group }.member(index);
            assert_eq!(upright.mesh.faces, member.mesh.faces);
            let posed = add(member.rotation.map(|row| dot(row, upright.places[0])), member.translation);
            assert!(posed.iter().zip(&member.places[0]).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        let [first, last] = [group.member(0), group.member(7)];
        assert_ne!(first.mesh.faces, last.mesh.faces);
        assert_ne!(first.parameters, last.parameters);
        assert_eq!(first.names, last.names);
    }
}

#[test]
fn shapes_are_those_of_their_parameters() {
    let member = |family, index| Group { upright: true, subdivisions: 5, ..group(family) }.member(index);
    let ellipsoid = member(Family::Ellipsoids, 2);
    let exact = 4.0 / 3.0 * std::f64::consts::PI * ellipsoid.parameters[0] * ellipsoid.parameters[1] * 8.0;
    assert!((volume(&ellipsoid.mesh) / exact - 1.0).abs() < 3e-3);
    // Except near the knob, the section of a rod is an ellipse of area 0.7 pi r^2. The volume therefore grows by 0.7 pi
    // r^2 per mm of length.
    let [short, long] = [member(Family::Rods, 0), member(Family::Rods, 7)];
    let slope = (volume(&long.mesh) - volume(&short.mesh)) / (long.parameters[0] - short.parameters[0]);
    assert!((slope / (0.7 * std::f64::consts::PI * 16.0) - 1.0).abs() < 0.02, "{slope}");
    // The sharp bump's top is 8.5 mm above the middle, at the x given by the parameter.
    let sharp = member(Family::SharpBump, 3);
    let top = sharp.mesh.vertices.iter().copied().fold([0.0; 3], |top: Vec3, x| if x[2] > top[2] { x } else { top });
    assert!((top[2] - 8.5).abs() < 0.1 && (top[0] - sharp.parameters[0]).abs() < 0.5, "{top:?}");
    assert!((sharp.parameters[0] - (-9.0 + 18.0 * 3.0 / 7.0)).abs() < 1e-12);
    let ring = member(Family::Tori, 1);
    let tube = ring.parameters[1];
    let exact = 2.0 * std::f64::consts::PI.powi(2) * tube * tube * ring.parameters[0];
    // The tube's radius varies by a quarter around the ring, so the mean of its square is (1 + 1/32) times the square
    // of its mean.
    assert!((volume(&ring.mesh) / exact - 1.0 - 1.0 / 32.0).abs() < 0.02, "{}", volume(&ring.mesh) / exact);
}

/// In all families except those of moving bumps, places depend linearly on the parameters. A perfect correspondence
/// therefore has one mode per parameter.
#[test]
fn places_are_as_many_modes_as_parameters() {
    for family in [Family::GrowingBump, Family::Rods] {
        let group = Group { members: 3, upright: true, ..group(family) };
        let [a, b, c] = [0, 1, 2].map(|index| group.member(index).places);
        for ((a, b), c) in a.iter().zip(&b).zip(&c) {
            assert!((0..3).all(|i| (a[i] + c[i] - 2.0 * b[i]).abs() < 1e-9), "{}: {a:?} {b:?} {c:?}", family.name());
        }
    }
}
