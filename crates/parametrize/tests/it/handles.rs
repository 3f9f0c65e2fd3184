//! Tests surfaces whose handles are cut and filled.

use std::collections::HashMap;
use std::f64::consts::TAU;

use spharm_monitor::Silent;
use spharm_parametrize::handles::Kind;
use spharm_parametrize::{CaldParams, ParametrizeError, cald, cut_handles};
use spharm_surface::Mesh;
use spharm_surface::generate::{SplitMix64, Torus, double_torus, icosphere, torus};
use spharm_surface::geometry::{cross, dot, face_normal, sub, unit};
use spharm_surface::topology::{Topology, is_outward};

/// Returns the surface of a set of voxels, in which no two voxels may touch only in an edge or a corner.
fn voxel_surface(voxels: &[[i32; 3]]) -> Mesh {
    let there: std::collections::HashSet<[i32; 3]> = voxels.iter().copied().collect();
    let mut mesh = Mesh::default();
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    for &voxel in voxels {
        for axis in 0..3 {
            for side in [0, 1] {
                let mut beyond = voxel;
                beyond[axis] += 2 * side - 1;
                if there.contains(&beyond) {
                    continue;
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let mut quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(du, dv)| {
                    let mut corner = voxel;
                    (corner[axis], corner[u], corner[v]) = (voxel[axis] + side, voxel[u] + du, voxel[v] + dv);
                    *numbers.entry(corner).or_insert_with(|| {
                        mesh.vertices.push(corner.map(f64::from));
                        mesh.vertices.len() as u32 - 1
                    })
                });
                if side == 0 {
                    quad.reverse();
                }
                let [a, b, c, d] = quad;
                mesh.faces.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    mesh
}

/// Returns a plate with holes through it, and with ditches crossed by bridges, and its number of handles. Holes and
/// bridges give handles of both kinds, all a few voxels long.
fn sieve(side: i32) -> (Mesh, usize) {
    let mut random = SplitMix64::new(7);
    let mut gone = std::collections::HashSet::new();
    let mut handles = 0;
    for i in (2..side - 6).step_by(6) {
        for j in (2..side - 3).step_by(4) {
            handles += 1;
            if random.between(0.0, 1.0) < 0.5 {
                gone.extend((0..5).map(|k| [i, j, k]));
            } else {
                gone.extend([[i, j, 4], [i, j, 3], [i + 1, j, 3], [i + 2, j, 3], [i + 2, j, 4]]);
            }
        }
    }
    let all = (0..side).flat_map(|i| (0..side).flat_map(move |j| (0..5).map(move |k| [i, j, k])));
    (voxel_surface(&all.filter(|voxel| !gone.contains(voxel)).collect::<Vec<_>>()), handles)
}

/// Checks that the cut surface is a sphere from which the given surface can be recovered, bit for bit.
fn check(surface: &Mesh, genus: usize) -> spharm_parametrize::CutSurface {
    let found = cut_handles(surface, &Silent).unwrap();
    let topology = Topology::of(&found.surface);
    assert!(topology.is_sphere(), "{:?}", topology.problems());
    assert_eq!((found.report.genus_before, found.report.genus_after), (genus, 0));
    assert_eq!(found.report.loops.len(), genus);
    let welded = found.seam.as_ref().unwrap().weld(&found.surface).unwrap();
    assert_eq!(welded.mesh.faces, surface.faces);
    let same =
        welded.mesh.vertices.iter().zip(&surface.vertices).all(|(a, b)| sub(*a, *b).iter().all(|x| x.abs() < 1e-12));
    assert!(same && welded.gap == 0.0);
    assert_eq!(is_outward(&found.surface), is_outward(surface));
    found
}

/// Returns Gauss's linking number of two closed polygons, from the solid angles of pairs of their edges.
fn linking(first: &[[f64; 3]], second: &[[f64; 3]]) -> f64 {
    let mut sum = 0.0;
    for i in 0..first.len() {
        for j in 0..second.len() {
            let (a, b) = (first[i], first[(i + 1) % first.len()]);
            let (c, d) = (second[j], second[(j + 1) % second.len()]);
            let corners = [sub(c, a), sub(d, a), sub(d, b), sub(c, b)].map(unit);
            let turn = |[a, b, c]: [[f64; 3]; 3]| spharm_surface::geometry::solid_angle([a, b, c]);
            sum += turn([corners[0], corners[1], corners[2]]) + turn([corners[0], corners[2], corners[3]]);
        }
    }
    sum / (2.0 * TAU)
}

#[test]
fn the_shorter_of_handle_and_tunnel_is_cut() {
    // Shortest loops: around the tube 2 pi, through the hole 2 pi (ring - tube).
    for (ring, expected, kind) in [(3.0, TAU, Kind::Handle), (1.5, 0.5 * TAU, Kind::Tunnel)] {
        let surface = torus(&Torus { ring, ..Torus::default() });
        let found = check(&surface, 1);
        let [cut] = &found.report.loops[..] else { panic!("{:?}", found.report) };
        assert_eq!(cut.kind, kind, "{cut:?}");
        // A loop along edges can't be shorter than the geodesic, up to the error of the mesh.
        assert!(cut.length > 0.98 * expected && cut.length < 1.16 * expected, "{} {expected}", cut.length);
        assert!(found.report.area_added > 0.0);
        // An independent criterion for the kind, by the linking number of the loop pushed off the surface: a loop
        // around a handle links with the circle inside the tube, a loop through a tunnel with the torus's axis.
        let seam = found.seam.as_ref().unwrap();
        let mut on_seam: Vec<[f64; 3]> = seam.copies.iter().map(|&v| surface.vertices[v as usize]).collect();
        on_seam.iter_mut().for_each(|p| *p = p.map(|x| 1.0001 * x));
        let core: Vec<[f64; 3]> =
            (0..400).map(|i| TAU * f64::from(i) / 400.0).map(|t| [ring * t.cos(), ring * t.sin(), 0.0]).collect();
        let around_tube = linking(&on_seam, &core).abs();
        assert!((around_tube - f64::from(u8::from(kind == Kind::Handle))).abs() < 1e-3, "{around_tube}");
    }
}

/// Fillings continue the surface: triangles meet at small angles across the seam, on both sides.
#[test]
fn fillings_are_smooth_across_the_seam_and_lie_apart() {
    for bumps in [0.0, 0.15] {
        let surface = torus(&Torus { ring: 2.5, bumps, ..Torus::default() });
        let found = check(&surface, 1);
        let cut = &found.surface;
        let mut normals: HashMap<(u32, u32), (usize, [f64; 3])> = HashMap::new();
        let mut bends: Vec<f64> = Vec::new();
        for (number, face) in cut.faces.iter().enumerate() {
            let normal = unit(face_normal(face.map(|v| cut.vertices[v as usize])));
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                match normals.remove(&(b, a)) {
                    Some((other, theirs)) if (other < surface.faces.len()) != (number < surface.faces.len()) => {
                        bends.push(dot(cross(normal, theirs), cross(normal, theirs)).sqrt().atan2(dot(normal, theirs)));
                    }
                    Some(_) => {}
                    None => {
                        normals.insert((a, b), (number, normal));
                    }
                }
            }
        }
        assert_eq!(bends.len(), 2 * found.report.loops[0].vertices);
        let largest = bends.iter().copied().fold(0.0, f64::max).to_degrees();
        assert!(largest < 30.0, "{largest}");
        // The two domes meet only along the seam, so their inner vertices differ.
        let first = surface.vertices.len() + found.report.loops[0].vertices;
        let filling = &cut.vertices[first..];
        let (right, left) = filling.split_at(filling.len() / 2);
        let nearest = right.iter().flat_map(|p| left.iter().map(|q| dot(sub(*p, *q), sub(*p, *q)))).fold(9.0, f64::min);
        assert!(nearest > 0.0, "no vertex of one filling is one of the other");
    }
}

#[test]
fn a_double_torus_is_cut_twice_and_its_sphere_mapped() {
    let surface = double_torus(40);
    let found = check(&surface, 2);
    assert!(found.report.loops.iter().all(|cut| cut.length < 1.6), "{:?}", found.report.loops);
    let map = cald(&found.surface, &CaldParams::default(), &Silent).unwrap();
    assert!(map.quality().is_bijective());
}

#[test]
fn hundreds_of_small_handles_are_cut_each_by_a_short_loop() {
    let (surface, handles) = sieve(100);
    assert!(handles > 300, "{handles}");
    let found = check(&surface, handles);
    // The shortest loops around a bridge and through a hole of one voxel have 4 edges.
    assert!(found.report.loops.iter().all(|cut| cut.length < 8.1), "{:?}", found.report.loops.last());
    let short = found.report.loops.iter().filter(|cut| cut.length < 4.1).count();
    assert!(short as f64 > 0.95 * handles as f64, "{short} of {handles}");
}

#[test]
fn the_same_bits_for_any_number_of_threads_and_spheres_stay() {
    let (surface, _) = sieve(30);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| cut_handles(&surface, &Silent)).unwrap()
    };
    let (one, four) = (with(1), with(4));
    assert_eq!((one.surface, one.report), (four.surface, four.report));
    let ball = icosphere(2);
    let found = cut_handles(&ball, &Silent).unwrap();
    assert_eq!((found.surface, found.seam, found.report.loops.len()), (ball, None, 0));
}

#[test]
fn handles_are_refused_with_the_loops_lengths_and_open_meshes_are_not_cut() {
    let surface = torus(&Torus::default());
    let error = cald(&surface, &CaldParams::default(), &Silent).unwrap_err();
    assert!(matches!(error, ParametrizeError::BadSurface { handles: 1, .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("genus 1") && text.contains("a loop of length 6."), "{text}");
    let mut open = surface.clone();
    open.faces.pop();
    let error = cut_handles(&open, &Silent).unwrap_err();
    assert!(error.to_string().contains("3 edges belong to one triangle only"), "{error}");
    // If the surface is turned inside out, the same loop of the same kind is cut.
    let mut turned = surface.clone();
    turned.faces.iter_mut().for_each(|face| face.swap(0, 1));
    let (found, as_given) = (check(&turned, 1), check(&surface, 1));
    assert_eq!(found.report.loops[0].kind, as_given.report.loops[0].kind);
}
