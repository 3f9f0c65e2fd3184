//! Tests closed surfaces around meshes of any kind.

use spharm_monitor::Silent;
use spharm_parametrize::wrap::would_wrap;
use spharm_parametrize::{CaldParams, ParametrizeError, cald, defects, wrap};
use spharm_surface::Mesh;
use spharm_surface::generate::{SplitMix64, Torus, icosphere, torus};
use spharm_surface::geometry::{Vec3, add, dot, face_normal, scale, sub};

fn ball(centre: Vec3, radius: f64) -> Mesh {
    let mut ball = icosphere(5);
    ball.vertices.iter_mut().for_each(|v| *v = add(centre, scale(*v, radius)));
    ball
}

fn joined(meshes: &[Mesh]) -> Mesh {
    meshes.iter().fold(Mesh::default(), |mut all, mesh| {
        let first = all.vertices.len() as u32;
        all.vertices.extend_from_slice(&mesh.vertices);
        all.faces.extend(mesh.faces.iter().map(|face| face.map(|v| v + first)));
        all
    })
}

fn volume(mesh: &Mesh) -> f64 {
    let of = |face: &[u32; 3]| {
        let corners = face.map(|v| mesh.vertices[v as usize]);
        dot(corners[0], face_normal(corners)) / 6.0
    };
    mesh.faces.iter().map(of).sum()
}

fn assert_sphere(mesh: &Mesh) {
    assert_eq!(defects(mesh), (Vec::new(), 0));
}

/// The outside of two balls that overlap, one inside out and one with its triangles in random order, is that of their
/// union: the walls inside are gone, and the vertices lie on the balls.
#[test]
fn overlapping_parts_become_their_union() {
    let (near, far) = (ball([0.0; 3], 1.0), ball([1.0, 0.2, 0.1], 0.8));
    let mut far = far;
    far.faces.iter_mut().for_each(|face| face.swap(1, 2));
    let both = joined(&[near, far]);
    let (outer, report) = wrap(&both, 64, &Silent).unwrap();
    assert_sphere(&outer);
    let off = |v: &Vec3| {
        let from = |centre: Vec3, radius: f64| dot(sub(*v, centre), sub(*v, centre)).sqrt() - radius;
        from([0.0; 3], 1.0).min(from([1.0, 0.2, 0.1], 0.8))
    };
    let found = report.wrap.unwrap();
    let rms = (outer.vertices.iter().map(|v| off(v).powi(2)).sum::<f64>() / outer.vertices.len() as f64).sqrt();
    assert!(rms < 2e-3 && found.rms_distance < 2e-3, "{rms:e}, {:e}", found.rms_distance);
    assert!(outer.vertices.iter().all(|v| off(v).abs() < found.voxel));
    // The volume of two balls less that of their intersection, a lens of two caps.
    let (r, s, d) = (1.0_f64, 0.8_f64, 1.05_f64.sqrt());
    let lens = (r + s - d).powi(2) * (d * d + 2.0 * d * (r + s) - 3.0 * (r - s).powi(2)) / (12.0 * d);
    let expected = 4.0 / 3.0 * (r.powi(3) + s.powi(3)) - lens;
    let found_volume = volume(&outer) / std::f64::consts::PI;
    assert!((found_volume / expected - 1.0).abs() < 5e-3, "{found_volume} for {expected}");
    // The walls inside have an area of two caps.
    let inside = |centre: Vec3, radius: f64, mesh: &Mesh| {
        mesh.vertices.iter().filter(|v| dot(sub(**v, centre), sub(**v, centre)).sqrt() < radius).count() as f64
    };
    let walls = inside([1.0, 0.2, 0.1], 0.77, &ball([0.0; 3], 1.0))
        + 0.64 * inside([0.0; 3], 0.97, &ball([1.0, 0.2, 0.1], 0.8));
    let share = walls / (1.64 * ball([0.0; 3], 1.0).vertices.len() as f64);
    assert!((found.hidden_area - share).abs() < 0.02, "{} for {share}", found.hidden_area);
    assert!(found.bridged_area < 0.01 && (found.pieces, found.cavities, found.handles) == (0, 0, 0));
    cald(&outer, &CaldParams::default(), &Silent).unwrap();
}

/// A box of six panels that don't share vertices, one of them a dome that bends inwards: flat and concave panels keep
/// their sides. Inside out as a whole, it is turned.
#[test]
fn panels_keep_their_sides() {
    let mut panels = Vec::new();
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            // Panels have different numbers of cells, so that their rims have few vertices in common.
            let cells = 3 + 2 * axis as u32 + side as u32;
            let at = |i: u32, j: u32| {
                let (u, v) = (f64::from(i) / f64::from(cells), f64::from(j) / f64::from(cells));
                let inwards = if axis == 2 && side == 1.0 { 3.0 * u * (1.0 - u) * v * (1.0 - v) } else { 0.0 };
                let mut point = [0.0; 3];
                (point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3]) = (side - inwards, u, v);
                point
            };
            let vertices = (0..=cells).flat_map(|i| (0..=cells).map(move |j| at(i, j))).collect();
            let quads = (0..cells).flat_map(|i| (0..cells).map(move |j| i * (cells + 1) + j));
            let faces = quads.flat_map(|a| {
                let (b, c, d) = (a + cells + 1, a + cells + 2, a + 1);
                let outward = if side == 1.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                outward.into_iter()
            });
            panels.push(Mesh::new(vertices, faces.collect()));
        }
    }
    let mut all = joined(&panels);
    let expected = 1.0 - 3.0 / 36.0;
    for _ in 0..2 {
        let (closed, report) = wrap(&all, 40, &Silent).unwrap();
        assert_sphere(&closed);
        assert!((volume(&closed) - expected).abs() < 0.01, "{} for {expected}", volume(&closed));
        assert!(report.wrap.unwrap().hidden_area < 1e-3, "{report}");
        all.faces.iter_mut().for_each(|face| face.swap(1, 2));
    }
}

/// A Möbius strip, also if its vertices are few.
#[test]
fn a_strip_with_one_side_is_refused() {
    for n in [60_u32, 24] {
        let place = |k: u32| {
            let along = f64::from(k / 2) * std::f64::consts::TAU / f64::from(n);
            let across = if k.is_multiple_of(2) { -0.3 } else { 0.3 };
            let out = 1.0 + across * (0.5 * along).cos();
            [out * along.cos(), out * along.sin(), across * (0.5 * along).sin()]
        };
        let pair = |i: u32| {
            let [c, d] = if i + 1 < n { [2 * i + 2, 2 * i + 3] } else { [1, 0] };
            [[2 * i, c, 2 * i + 1], [2 * i + 1, c, d]]
        };
        let strip = Mesh::new((0..2 * n).map(place).collect(), (0..n).flat_map(pair).collect());
        let error = wrap(&strip, 64, &Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::OneSided { closed: false }), "{error}");
    }
}

/// Whether a wrap is advised: it unites bodies that overlap, but keeps only one of bodies that lie apart, and spans
/// the opening of half a ball.
#[test]
fn a_wrap_is_advised_only_if_it_would_succeed() {
    let half = |face: &&[u32; 3], ball: &Mesh| face.iter().all(|&v| ball.vertices[v as usize][2] > 0.0);
    let whole = ball([0.0; 3], 1.0);
    let bowl = Mesh::new(whole.vertices.clone(), whole.faces.iter().filter(|f| half(f, &whole)).copied().collect());
    let two = |distance: f64| joined(&[whole.clone(), ball([distance, 0.0, 0.0], 1.0)]);
    for (mesh, expected) in [(&whole, true), (&two(1.0), true), (&two(3.0), false), (&bowl, false)] {
        assert_eq!(would_wrap(mesh, &Silent).unwrap(), expected);
    }
}

/// A ball without a third of its triangles, at random and at one side, is closed; where there is a surface, the wrap
/// lies on it. Triangles don't have to share vertices.
#[test]
fn holes_are_spanned() {
    let mut random = SplitMix64::new(3);
    let whole = ball([5.0, -3.0, 100.0], 2.0);
    let kept = whole.faces.iter().filter(|face| {
        let low = face.iter().all(|&v| whole.vertices[v as usize][2] < 101.2);
        low && random.between(0.0, 1.0) < 0.9
    });
    let corners: Vec<Vec3> = kept.flat_map(|face| face.map(|v| whole.vertices[v as usize])).collect();
    let faces = (0..corners.len() as u32).step_by(3).map(|i| [i, i + 1, i + 2]).collect();
    let (closed, report) = wrap(&Mesh::new(corners, faces), 80, &Silent).unwrap();
    assert_sphere(&closed);
    let found = report.wrap.unwrap();
    let radius = |v: &Vec3| dot(sub(*v, [5.0, -3.0, 100.0]), sub(*v, [5.0, -3.0, 100.0])).sqrt();
    let low = closed.vertices.iter().filter(|v| v[2] < 100.5).map(|v| (radius(v) - 2.0).abs());
    let farthest = low.fold(0.0, f64::max);
    assert!(farthest < 2.0 * found.voxel, "{farthest} with voxels of {}, {report}", found.voxel);
    // The cap that is missing has a fifth of the area; the wrap is flatter there.
    assert!(found.bridged_area > 0.1 && found.bridged_area < 0.3, "{}", found.bridged_area);
    assert!(found.hidden_area < 1e-3 && report.welded > 0, "{report:?}");
}

#[test]
fn handles_cavities_and_pieces_are_counted() {
    let ring = torus(&Torus::default());
    let (closed, report) = wrap(&ring, 48, &Silent).unwrap();
    assert_sphere(&closed);
    assert_eq!(report.wrap.unwrap().handles, 1);
    // A hollow ball, its inner wall wound inwards, and a small ball beside it.
    let mut inner = ball([0.0; 3], 0.6);
    inner.faces.iter_mut().for_each(|face| face.swap(1, 2));
    let parts = joined(&[ball([0.0; 3], 1.0), inner, ball([1.5, 0.0, 0.0], 0.3)]);
    let (outer, report) = wrap(&parts, 64, &Silent).unwrap();
    assert_sphere(&outer);
    let found = report.wrap.unwrap();
    assert_eq!((found.pieces, found.handles), (1, 0));
    let text = report.to_string();
    assert!(text.contains("wrapped with 64 voxels along the longest side, 31.0 % of the mesh's area"), "{text}");
    assert!(text.contains("of the mesh's area lies more than 2 voxels outside the wrap"), "{text}");
    assert!(text.contains("1 smaller piece left out (2.") && text.ends_with(" % of the body's voxels)"), "{text}");
    // The small ball has 0.09 of an area of 1.45; the inner wall isn't lost.
    assert!((found.lost_area - 0.09 / 1.45).abs() < 0.02 && found.hidden_area > 0.3, "{found:?}");
    assert!((found.left_out - 0.027 / 1.027).abs() < 2e-3, "{found:?}");
    assert!((volume(&outer) / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 5e-3);
}

/// A vertex far away makes the voxels too large for the rest of the mesh: the error names it. Vertices without
/// triangles don't matter.
#[test]
fn a_vertex_far_away_is_named() {
    let mut spiked = ball([0.0; 3], 1.0);
    spiked.vertices.push([500.0, 0.0, 0.0]);
    let (unused, report) = wrap(&spiked, 32, &Silent).unwrap();
    assert_sphere(&unused);
    assert!(report.wrap.unwrap().lost_area < 1e-3, "{report}");
    let last = spiked.vertices.len() as u32 - 1;
    spiked.vertices.extend([[500.0, 0.01, 0.0], [500.0, 0.0, 0.01]]);
    spiked.faces.push([last, last + 1, last + 2]);
    let error = wrap(&spiked, 128, &Silent).unwrap_err();
    let named = matches!(error, ParametrizeError::FarVertex { vertex, enough: None, .. } if vertex >= last as usize);
    assert!(named && error.to_string().contains("500.0"), "{error}");
    spiked.vertices[last as usize..].iter_mut().for_each(|v| v[0] = 20.0);
    let error = wrap(&spiked, 16, &Silent).unwrap_err().to_string();
    assert!(error.contains("or use at least 8"), "{error}");
}

/// The triangles of a vertex that is still attached have most of the area, and a wrap loses them.
#[test]
fn a_spike_is_named() {
    for (far, enough) in [(500.0, None), (50.0, Some(200..220))] {
        let mut spiked = icosphere(3);
        spiked.vertices[0] = [far, 0.0, 0.0];
        match wrap(&spiked, 128, &Silent).unwrap_err() {
            ParametrizeError::FarVertex { vertex: 0, enough: found, .. } => {
                assert_eq!(found.is_some(), enough.is_some(), "{found:?}");
                assert!(found.zip(enough).is_none_or(|(found, enough)| enough.contains(&found)), "{found:?}");
            }
            error => panic!("{error}"),
        }
    }
}

/// A thin tail with little area may be lost, though the body has fewer than 8 voxels.
#[test]
fn a_thin_tail_may_be_lost() {
    let mut tailed = ball([0.0; 3], 1.0);
    let next = tailed.vertices.len() as u32;
    tailed.vertices.extend([[0.1, 0.1, 0.9], [0.105, 0.1, 0.9], [0.1, 0.1, 36.0]]);
    tailed.faces.push([next, next + 1, next + 2]);
    let (body, report) = wrap(&tailed, 128, &Silent).unwrap();
    assert_sphere(&body);
    let lost = report.wrap.unwrap().lost_area;
    assert!(lost > 0.003 && lost < 0.01, "{lost}");
}

/// More voxels don't keep a second body, and there may be no more.
#[test]
fn the_remedy_depends_on_the_loss() {
    let two = joined(&[ball([0.0; 3], 1.0), ball([3.0, 0.0, 0.0], 0.9)]);
    let (_, report) = wrap(&two, 32, &Silent).unwrap();
    let bodies = report.wrap.unwrap();
    let said = |wrap| ParametrizeError::LossyWrap { wrap: Box::new(wrap), most: 0.05 }.to_string();
    let text = said(bodies);
    assert!(text.ends_with("put the other bodies into separate files and fit them separately"), "{text}");
    let mut thin = bodies;
    (thin.pieces, thin.left_out) = (0, 0.0);
    assert!(said(thin).ends_with("use more voxels to keep thin parts"), "{}", said(thin));
    thin.voxels = 512;
    assert!(said(thin).ends_with("more than 2 voxels outside the wrap"), "{}", said(thin));
}

/// The wrap moves and scales with the mesh, also at the ends of the range of numbers.
#[test]
fn the_unit_does_not_matter() {
    let parts = joined(&[ball([0.0; 3], 1.0), ball([1.0, 0.0, 0.0], 0.5)]);
    let (expected, _) = wrap(&parts, 32, &Silent).unwrap();
    for exponent in [-900, 0, 900] {
        let factor = 2.0_f64.powi(exponent);
        let mut scaled = parts.clone();
        scaled.vertices.iter_mut().for_each(|v| *v = scale(*v, factor));
        let (found, report) = wrap(&scaled, 32, &Silent).unwrap();
        assert_eq!(found.faces, expected.faces, "{exponent}");
        let same = |(a, b): (&Vec3, &Vec3)| (0..3).all(|k| (a[k] / factor - b[k]).abs() < 1e-12);
        assert!(found.vertices.iter().zip(&expected.vertices).all(same), "{exponent}");
        assert!((report.wrap.unwrap().voxel / factor - 2.5 / 32.0).abs() < 1e-12, "{exponent}");
    }
}

#[test]
fn what_has_no_inside_is_refused() {
    let flat = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2], [0, 2, 3]]);
    let at = |k: u32| [k / 31, k % 31].map(|x| 0.1 * f64::from(x));
    let wave = (0..31 * 31).map(at).map(|[x, y]| [x, y, 0.4 * (2.0 * x).sin() * (2.0 * y).cos()]).collect();
    let squares = (0..30 * 30).map(|k| k / 30 * 31 + k % 30);
    let wavy = Mesh::new(wave, squares.flat_map(|a| [[a, a + 31, a + 32], [a, a + 32, a + 1]]).collect());
    for sheet in [&flat, &wavy] {
        let error = wrap(sheet, 32, &Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::OpenSheet { filled } if filled > 0.4), "{error}");
    }
    let apart = joined(&[flat.clone(), flat.with_vertices(flat.vertices.iter().map(|v| add(*v, [3.0; 3])).collect())]);
    let error = wrap(&apart, 32, &Silent).unwrap_err();
    assert!(matches!(error, ParametrizeError::NothingToWrap { voxels: 32 }), "{error}");
    let point = Mesh::new(vec![[1.0; 3]; 3], vec![[0, 1, 2]]);
    assert!(matches!(wrap(&point, 32, &Silent), Err(ParametrizeError::NothingToWrap { .. })));
    assert!(wrap(&Mesh::default(), 32, &Silent).is_err());
    let beyond = Mesh::new(vec![[0.0; 3]; 3], vec![[0, 1, 3]]);
    assert!(matches!(wrap(&beyond, 32, &Silent), Err(ParametrizeError::InvalidMesh { .. })));
    let sphere = ball([0.0; 3], 1.0);
    for voxels in [0, 15, 513, usize::MAX] {
        let error = wrap(&sphere, voxels, &Silent).unwrap_err().to_string();
        assert!(error.contains("wrap: expected 16 to 512 voxels, found"), "{error}");
    }
}
