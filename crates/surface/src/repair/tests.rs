//! Tests the repair of meshes.

use super::*;
use crate::generate::{bipyramid, icosphere, subdivide_sphere};
use crate::topology::Topology;

#[test]
fn a_sound_mesh_stays_as_it_is() {
    let mesh = icosphere(2);
    let (same, found) = repair(&mesh);
    assert_eq!((same, found.is_any()), (mesh, false));
}

#[test]
fn a_soup_is_welded() {
    let mesh = icosphere(2);
    let vertices: Vec<[f64; 3]> = mesh.faces.as_flattened().iter().map(|&v| mesh.vertices[v as usize]).collect();
    let faces = (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let (welded, found) = repair(&Mesh::new(vertices, faces));
    assert!(Topology::of(&welded).is_sphere());
    assert_eq!((welded.vertices.len(), found.welded, found.unused), (162, 960 - 162, 0));
}

/// -0 and +0 are the same position. Nearly equal positions are welded only on rims.
#[test]
fn what_lies_on_another_is_welded_and_rims_also_where_they_nearly_meet() {
    let mut mesh = icosphere(0);
    let whole = mesh.vertices.len() as u32;
    mesh.vertices[0] = [0.0, 0.0, 1.0];
    mesh.vertices.extend([[-0.0, -0.0, 1.0], [0.0, 1e-300, 1.0]]);
    mesh.faces[0] = mesh.faces[0].map(|v| if v == 0 { whole } else { v });
    let (welded, found) = repair(&mesh);
    assert_eq!((found.welded, found.unused, welded.vertices.len()), (1, 1, 12));
    assert!(Topology::of(&welded).is_sphere());
    mesh.faces[0] = mesh.faces[0].map(|v| if v == whole { whole + 1 } else { v });
    let (closed, found) = repair(&mesh);
    assert_eq!((found.welded, found.holes, closed.vertices.len()), (2, 0, 12));
    assert!(Topology::of(&closed).is_sphere());
    // Two vertices that nearly coincide but aren't on a rim aren't welded.
    let mut near = icosphere(2);
    near.vertices[7] = near.vertices[near.faces.iter().find(|face| face.contains(&7)).unwrap()[0] as usize];
    near.vertices[7][0] += 1e-12;
    assert!(!repair(&near).1.is_any());
    // The corners of a triangle soup are off by up to 1e-6.
    let ball = icosphere(3);
    let mut number = 0_u32;
    let vertices = ball.faces.as_flattened().iter().map(|&v| {
        ball.vertices[v as usize].map(|x| {
            number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            x + 1e-6 * (f64::from(number) / f64::from(u32::MAX) - 0.5)
        })
    });
    let soup =
        Mesh::new(vertices.collect(), (0..ball.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect());
    let (welded, found) = repair(&soup);
    assert!(Topology::of(&welded).is_sphere() && welded.vertices.len() == ball.vertices.len(), "{found}");
}

#[test]
fn triangles_turn_to_the_larger_part() {
    let whole = icosphere(2);
    let mut mesh = whole.clone();
    for (f, face) in mesh.faces.iter_mut().enumerate().filter(|(f, _)| f % 3 == 0) {
        *face = [face[0], face[2], face[1]];
        assert!(f < 320);
    }
    let (turned, found) = repair(&mesh);
    assert_eq!((turned, found.turned), (whole, 107));
}

/// A Möbius strip of triangles has only one side. The repair turns none of its triangles, and filling its hole doesn't
/// make it a sphere.
#[test]
fn a_surface_with_one_side_stays() {
    let strip: Vec<[u32; 3]> = (0..7).map(|k| [k, (k + 1) % 7, (k + 2) % 7]).collect();
    let around = (0..7).map(|k| f64::from(k) * std::f64::consts::TAU / 7.0);
    let mesh = Mesh::new(around.map(|t| [t.cos(), t.sin(), (0.5 * t).sin()]).collect(), strip);
    let (same, found) = repair(&mesh);
    assert!(found.turned == 0 && !Topology::of(&same).is_sphere(), "{found}");
}

#[test]
fn fins_go_and_the_surface_under_them_stays() {
    let whole = icosphere(2);
    let mut mesh = whole.clone();
    let [a, b, c] = mesh.faces[5];
    // Adds a fin of two triangles, and a tent over two edges of the same triangle.
    mesh.vertices.extend([[1.1, 0.0, 0.0], [1.1, 0.1, 0.0], [0.0, 0.0, 1.1]]);
    mesh.faces.extend([[a, b, 162], [162, b, 163], [b, c, 164], [c, a, 164]]);
    let (clean, found) = repair(&mesh);
    assert_eq!((clean, found.fins, found.pieces), (whole, 4, 0), "{found}");
}

#[test]
fn parts_that_touch_are_separated() {
    let ball = icosphere(2);
    let n = ball.vertices.len() as u32;
    // A smaller ball touches the ball at a vertex, then along an edge.
    let north = ball.faces[0];
    for shared in [&north[..1], &north[..2]] {
        let mut mesh = ball.clone();
        mesh.vertices.extend(ball.vertices.iter().map(|v| v.map(|x| 2.0 - 0.3 * x)));
        let moved = |v: u32| if shared.contains(&v) { v } else { v + n };
        mesh.faces.extend(ball.faces.iter().map(|face| face.map(moved)));
        let (apart, found) = repair(&mesh);
        assert_eq!((apart, found.pieces), (ball.clone(), 1), "{found}");
        assert!(found.dropped_area > 0.01 && found.to_string().contains("1 smaller piece dropped ("), "{found}");
    }
    // A ball that was pinched until it touched itself, at a point or along two edges, is a ball again after repair.
    let ball = subdivide_sphere(&subdivide_sphere(&bipyramid(8)));
    let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
    let place = |v: u32| ball.vertices[v as usize];
    let all = 0..ball.vertices.len() as u32;
    let mut upper: Vec<u32> = all.clone().filter(|&v| close(place(v)[1], 0.0) && place(v)[2] > 0.9).collect();
    upper.sort_by(|a, b| place(*b)[2].total_cmp(&place(*a)[2]));
    let below = |v: u32| {
        let [x, y, z] = place(v);
        let found = all.clone().find(|&w| [x, y, -z].iter().zip(place(w)).all(|(a, b)| close(*a, b)));
        (v, found.expect("a mirror image"))
    };
    let pairs: Vec<(u32, u32)> = upper.into_iter().map(below).collect();
    assert_eq!(pairs.len(), 3);
    for count in [1, pairs.len()] {
        let mut mesh = ball.clone();
        for &(upper, lower) in &pairs[..count] {
            mesh.vertices[upper as usize][2] = 0.0;
            mesh.faces.as_flattened_mut().iter_mut().filter(|v| **v == lower).for_each(|v| *v = upper);
        }
        let (apart, found) = repair(&mesh);
        assert!(Topology::of(&apart).is_sphere(), "{count}: {found}: {:?}", Topology::of(&apart));
        assert_eq!(found.split, count);
    }
}

/// Holes of four edges are filled along the shorter diagonal, larger holes by a fan around the mean of the rim.
#[test]
fn holes_are_filled_without_bumps() {
    let tent = |top: [f64; 3], rim: Vec<[f64; 3]>| {
        let n = rim.len() as u32;
        let faces = (0..n).map(|k| [n, k, (k + 1) % n]).collect();
        repair(&Mesh::new(rim.into_iter().chain([top]).collect(), faces))
    };
    let rim = (0..6).map(|k| f64::from(k).sin_cos()).map(|(y, x)| [3.0 * x, 2.0 * y, x]).collect::<Vec<_>>();
    let (filled, found) = tent([0.0, 0.0, 9.0], rim.clone());
    assert_eq!((found.holes, found.filled), (1, 6));
    let middle = filled.vertices[7];
    for k in 0..3 {
        assert!((middle[k] - rim.iter().map(|v| v[k]).sum::<f64>() / 6.0).abs() < 1e-15, "{middle:?}");
    }
    for (a, diagonal) in [(0.5, [0, 2]), (2.0, [1, 3])] {
        let rim = vec![[a, 0.0, 0.0], [0.0, 1.0, 0.0], [-a, 0.0, 0.0], [0.0, -1.0, 0.0]];
        let (filled, found) = tent([0.0, 0.0, 1.0], rim);
        assert_eq!((found.holes, found.filled), (1, 2));
        assert!(filled.faces[4..].iter().all(|face| diagonal.iter().all(|v| face.contains(v))), "{filled:?}");
    }
}

#[test]
fn holes_of_every_size_up_to_the_bound_are_filled() {
    let whole = icosphere(3);
    let around: Vec<[u32; 3]> = whole.faces.iter().filter(|face| face.contains(&500)).copied().collect();
    let edge = |a: &[u32; 3], b: &[u32; 3]| a.iter().filter(|corner| b.contains(corner)).count() == 2;
    let second = around.iter().find(|face| **face != around[0] && !edge(face, &around[0])).unwrap();
    let apart = [around[0], *second];
    let next = around.iter().find(|face| **face != around[0] && edge(face, &around[0])).unwrap();
    let joined = [around[0], *next];
    // Removes all triangles around a vertex (which leaves a rim of five or six edges), one triangle, or two triangles
    // that share an edge.
    let at = |vertex: u32| move |face: &[u32; 3]| face.contains(&vertex);
    for (drop, holes) in [
        (Box::new(at(0)) as Box<dyn Fn(&[u32; 3]) -> bool>, 1),
        (Box::new(|face: &[u32; 3]| at(0)(face) || at(400)(face)), 2),
        (Box::new(|face: &[u32; 3]| *face == whole.faces[7]), 1),
        // Removes two triangles that share a vertex but no edge.
        (Box::new(|face: &[u32; 3]| apart.contains(face)), 2),
        (Box::new(|face: &[u32; 3]| joined.contains(face)), 1),
    ] {
        let mut mesh = whole.clone();
        mesh.faces.retain(|face| !drop(face));
        let (filled, found) = repair(&mesh);
        assert!(Topology::of(&filled).is_sphere(), "{found:?}");
        assert_eq!(found.holes, holes, "{found}");
    }
    let mut half = whole.clone();
    half.faces.retain(|face| face.iter().any(|&v| whole.vertices[v as usize][2] > 0.0));
    let (open, found) = repair(&half);
    assert!(found.holes == 0 && !Topology::of(&open).is_sphere(), "a hole of half the surface stays");
}

#[test]
fn loose_and_repeated_things_are_dropped_and_counted() {
    let mut mesh = icosphere(2);
    let whole = mesh.clone();
    let [a, b, c] = mesh.faces[0];
    mesh.faces.extend([[b, c, a], [c, b, a], [a, a, b]]);
    mesh.vertices.extend([[9.0; 3], [5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]]);
    mesh.faces.push([163, 164, 165]);
    let (found, report) = repair(&mesh);
    assert_eq!(found, whole);
    let expected = MeshRepair { degenerate: 1, repeated: 2, pieces: 1, unused: 4, ..MeshRepair::default() };
    assert!(report.dropped_area > 0.0 && report.dropped_area < 0.05, "{report:?}");
    assert_eq!(MeshRepair { dropped_area: 0.0, ..report }, expected);
    let text = report.to_string();
    assert!(text.contains("1 degenerate triangle dropped, 2 repeated triangles dropped, 1 smaller piece dropped ("));
    assert!(text.ends_with("4 unused vertices dropped"), "{text}");
}

/// A sphere of meridians has a seam that is open because of rounding errors, and a pole whose vertices nearly coincide.
/// Welding closes the seam, and only slivers at the pole are lost.
#[test]
fn a_sphere_of_meridians_is_welded_along_its_seam() {
    let (rows, columns) = (9_u32, 12_u32);
    let at = |row: u32, column: u32| {
        let (t, p) = (f64::from(row) / f64::from(rows - 1), f64::from(column) / f64::from(columns));
        let ((s, c), (y, x)) = ((t * std::f64::consts::PI).sin_cos(), (p * std::f64::consts::TAU).sin_cos());
        [s * x, s * y, c]
    };
    let vertices = (0..rows).flat_map(|row| (0..=columns).map(move |column| at(row, column))).collect();
    let number = |row: u32, column: u32| row * (columns + 1) + column;
    let quads = (0..rows - 1).flat_map(|row| (0..columns).map(move |column| (row, column)));
    let faces = quads.flat_map(|(row, column)| {
        let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| number(row + i, column + j));
        [[a, b, c], [a, c, d]]
    });
    let (welded, found) = repair(&Mesh::new(vertices, faces.collect()));
    assert!(Topology::of(&welded).is_sphere(), "{found}: {:?}", Topology::of(&welded));
    assert_eq!((welded.vertices.len(), found.holes), (7 * 12 + 2, 0), "{found}");
}

/// A tiny edge at a rim doesn't cause an overflow, and doesn't prevent welding.
#[test]
fn a_tiny_edge_at_a_rim_is_welded() {
    let mut mesh = icosphere(1);
    mesh.vertices.push(mesh.vertices[0].map(|x| x + 1e-25));
    mesh.vertices[0] = [0.0, 0.0, 1.0];
    mesh.vertices[42] = [1e-25, 0.0, 1.0];
    let face = mesh.faces.iter().position(|face| face.contains(&0)).unwrap();
    let [a, b, c] = mesh.faces[face];
    mesh.faces[face] = [a, b, c].map(|v| if v == 0 { 42 } else { v });
    let (welded, found) = repair(&mesh);
    assert!(Topology::of(&welded).is_sphere() && welded.vertices.len() == 42, "{found}");
}

/// Many fins at one edge are dropped in one round, even if the body has a hole.
#[test]
fn fins_go_from_a_body_with_a_hole() {
    let mut mesh = icosphere(3);
    let whole = mesh.vertices.len() as u32;
    let ([a, b, _], hole) = (mesh.faces[3], mesh.faces[600]);
    mesh.faces.retain(|face| *face != hole);
    for fin in 0..50 {
        let turn = 0.01 * f64::from(fin);
        mesh.vertices.push([turn, 0.1 * turn, 1.0 + 0.01 * turn]);
        mesh.faces.push([a, b, whole + fin]);
    }
    let (clean, found) = repair(&mesh);
    assert!(Topology::of(&clean).is_sphere() && clean.vertices.len() == whole as usize, "{found}");
    assert_eq!((found.fins, found.holes), (50, 1), "{found}");
}

/// Two edges of the rim are in line with the mean of its vertices, so a fan around the mean would have triangles
/// without area.
#[test]
fn a_hole_with_edges_in_line_with_its_middle_gets_no_triangles_without_area() {
    // Each side of a cube is a grid of 8 x 8 squares, with two triangles per square.
    let mut mesh = Mesh::new(Vec::new(), Vec::new());
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
        for (i, j) in (0..8).flat_map(|i| (0..8).map(move |j| (i, j))) {
            // A half turn about the middle of the hole maps the hole to itself.
            let halves: &[usize] = match (axis, sign > 0.0, [i, j]) {
                (0, true, [3 | 4, 3 | 4] | [5, 4] | [2, 3]) => &[],
                (0, true, [5, 5]) => &[1],
                (0, true, [2, 2]) => &[0],
                _ => &[0, 1],
            };
            let first = mesh.vertices.len() as u32;
            for (a, b) in [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)] {
                let mut corner = [0.0; 3];
                corner[axis] = sign;
                corner[(axis + 1) % 3] = f64::from(a) / 4.0 - 1.0;
                corner[(axis + 2) % 3] = f64::from(b) / 4.0 - 1.0;
                mesh.vertices.push(corner);
            }
            mesh.faces.extend(halves.iter().map(|half| [[0, 1, 2], [0, 2, 3]][*half].map(|k| first + k)));
        }
    }
    let (mended, found) = repair(&mesh);
    assert_eq!((found.holes, rims(&mended.faces).len()), (0, 1), "{found}");
    assert!(mended.faces.iter().all(|face| area_of(&mended.vertices, face) > 1e-3));
}

/// If three of the four vertices of a rim lie on a line, only one of the two diagonals gives two triangles of nonzero
/// area.
#[test]
fn a_rim_of_four_is_not_filled_by_a_triangle_without_area() {
    let mut tetrahedron = Mesh::new(
        vec![[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [2.0, 0.0, 0.0]],
        vec![[0, 2, 4], [4, 2, 1], [0, 3, 2], [2, 3, 1]],
    );
    for _ in 0..4 {
        let (mended, found) = repair(&tetrahedron);
        assert!(found.holes == 1 && Topology::of(&mended).is_sphere(), "{found}");
        assert!(mended.faces.iter().all(|face| area_of(&mended.vertices, face) > 0.1), "{:?}", mended.faces);
        tetrahedron.faces.rotate_left(1);
    }
}

#[test]
fn a_closed_surface_that_is_inside_out_is_turned() {
    let ball = icosphere(2);
    let mut inside_out = ball.clone();
    inside_out.faces.iter_mut().for_each(|face| face.swap(1, 2));
    let (turned, found) = repair(&inside_out);
    assert_eq!((turned, found.turned), (ball.clone(), 320));
    // Three triangles of the inside-out mesh are now wound outwards, and the mesh has a hole.
    ball.faces[..3].iter().zip(&mut inside_out.faces).for_each(|(given, face)| *face = *given);
    inside_out.faces.pop();
    let (turned, found) = repair(&inside_out);
    assert_eq!((found.turned, found.holes, found.filled), (316, 1, 1));
    assert_eq!(turned.faces[..319], ball.faces[..319]);
}

/// In a rim with the shape of a dart, the shorter diagonal lies outside of the rim, where the triangles would overlap.
#[test]
fn a_rim_with_the_shape_of_a_dart_is_filled_inside() {
    let vertices = vec![[0.0, 0.0, 0.0], [3.0, 0.4, 0.0], [1.0, 0.0, 0.0], [3.0, -0.4, 0.0], [1.0, 0.0, 3.0]];
    let open = Mesh::new(vertices, vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]);
    let (mended, found) = repair(&open);
    assert_eq!((found.holes, found.filled), (1, 2));
    assert!(Topology::of(&mended).is_sphere());
    let normals = mended.faces[4..].iter().map(|face| face_normal(face.map(|v| mended.vertices[v as usize]))[2]);
    let normals: Vec<f64> = normals.collect();
    assert!(normals.iter().all(|z| *z > 0.0) || normals.iter().all(|z| *z < 0.0), "{normals:?}");
    assert!((normals.iter().sum::<f64>().abs() - 0.8).abs() < 1e-12, "{normals:?}");
}

/// A ball has a hole of one triangle, and a speck at a distance of 1e6. The ball keeps all its triangles, and the speck
/// is dropped.
#[test]
fn a_speck_far_away_does_not_change_the_distance_of_welding() {
    let mut mesh = icosphere(3);
    let hole = mesh.faces.remove(7);
    let first = mesh.vertices.len() as u32;
    let speck: [[f64; 3]; 3] = [[1e6, 0.0, 0.0], [1e6, 0.01, 0.0], [1e6, 0.0, 0.01]];
    for far in [1.0, 1e30] {
        let mut mesh = mesh.clone();
        mesh.vertices.extend(speck.map(|[x, y, z]| [far * x, y, z]));
        mesh.faces.push([first, first + 1, first + 2]);
        let (mended, found) = repair(&mesh);
        assert_eq!((mended.faces.len(), found.pieces, found.holes, found.welded), (1280, 1, 1, 0), "{found}");
        assert!(mended.faces[1279].iter().all(|v| hole.contains(v)) && found.lost_area == 0.0, "{found}");
    }
}

/// A triangle that is narrower than the welding distance collapses.
#[test]
fn area_that_welding_loses_is_counted() {
    let mut mesh = icosphere(2);
    mesh.faces.pop();
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend([[3.0, 0.0, 0.0], [3.0, 1e-6, 0.0], [3.0, 0.0, 1.0]]);
    mesh.faces.push([first, first + 1, first + 2]);
    let (_, found) = repair(&mesh);
    assert!(found.lost_area > 1e-9 && found.lost_area < 1e-7 && found.degenerate == 1, "{found:?}");
    let large = MeshRepair { lost_area: 0.9375, welded: 3, ..MeshRepair::default() };
    assert_eq!(large.drops_and_fills(), "93.8 % of the area lost by welding");
    assert_eq!(large.changes(), "3 vertices welded to others, 93.8 % of the area lost by welding");
}

/// Two cubes share a face. One of the cubes is dropped, and its share of the area is stated. If the shared face is less
/// than 5 % of the area, the face is dropped instead, and its share is stated.
#[test]
fn bodies_that_share_a_wall_are_named_with_their_area() {
    let corners =
        |length: f64| (0..12).map(move |k| [f64::from(k / 4) * length, f64::from(k / 2 % 2), f64::from(k % 2)]);
    let ring = |[a, b, c, d]: [u32; 4], by: u32| {
        [[a, b], [b, d], [d, c], [c, a]].into_iter().flat_map(move |[p, q]| [[p, p + by, q + by], [p, q + by, q]])
    };
    let lid = |[a, b, c, d]: [u32; 4]| [[a, b, d], [a, d, c]];
    let faces: Vec<[u32; 3]> = ring([0, 1, 2, 3], 4)
        .chain(ring([4, 5, 6, 7], 4))
        .chain([[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]].into_iter().flat_map(lid))
        .collect();
    let (cube, found) = repair(&Mesh::new(corners(1.0).collect(), faces.clone()));
    assert!(Topology::of(&cube).is_sphere() && found.attached > 0, "{found:?}");
    assert!((found.dropped_area - 6.0 / 11.0).abs() < 1e-12, "{found:?}");
    let said = found.drops_and_fills();
    assert!(said.contains("dropped (54.5 % of the area)") && said.contains("shared edges with the kept"), "{said}");
    let (both, found) = repair(&Mesh::new(corners(5.0).collect(), faces));
    assert!(Topology::of(&both).is_sphere() && (found.fins, found.pieces) == (2, 0), "{found:?}");
    assert!((found.fins_area - 1.0 / 43.0).abs() < 1e-12, "{found:?}");
    assert!(found.changes().contains("2 triangles of fins or inner walls dropped (2.3 % of the area)"), "{found}");
}
