//! Tests the steps from label volumes to surfaces and equal-area spheres.

use spharm_monitor::Silent;
use spharm_parametrize::volume::{
    Affine, HandleRepair, LabelSurface, LabelVolume, Mask, VolumeParams, VolumeReading, VolumeSurface,
};
use spharm_parametrize::{EqualAreaParams, ParametrizeError, area_deviation, equal_area};
use spharm_surface::topology::{Topology, area, is_outward, signed_volume};

use crate::label_files::nifti;
use crate::label_formats::nifti2;

const N: usize = 24;

/// Returns a volume of N^3 voxels, in which label 1 is given by a formula in voxels relative to the volume's middle.
fn volume(inside: impl Fn([f64; 3]) -> bool) -> LabelVolume {
    labels(|at| i32::from(inside(at)))
}

fn labels(label: impl Fn([f64; 3]) -> i32) -> LabelVolume {
    let at = |i: usize| [i % N, i / N % N, i / (N * N)].map(|x| x as f64 - 11.5);
    LabelVolume::new([N; 3], (0..N * N * N).map(|i| label(at(i))).collect(), Affine::IDENTITY)
}

fn ball([x, y, z]: [f64; 3], radius: f64) -> bool {
    x * x + y * y + z * z < radius * radius
}

fn torus([x, y, z]: [f64; 3]) -> bool {
    (x.hypot(y) - 7.0).hypot(z) < 2.6
}

/// Returns the surface of the voxels' faces.
fn take(volume: &LabelVolume) -> Result<VolumeSurface, ParametrizeError> {
    volume.surface(&VolumeParams { surface: LabelSurface::Voxels, ..VolumeParams::default() }, &Silent)
}

fn fixed(volume: &LabelVolume) -> VolumeSurface {
    volume.surface(&VolumeParams { fix: true, ..VolumeParams::default() }, &Silent).unwrap()
}

/// Returns the problems listed in the error that rejects a volume.
fn problems(volume: &LabelVolume) -> String {
    match take(volume) {
        Err(ParametrizeError::BadVolume { problems, handles, repairable, .. }) => {
            assert!(repairable);
            assert_eq!(handles > 0, problems.contains("handle"), "{handles}: {problems}");
            problems
        }
        other => panic!("{other:?}"),
    }
}

/// Checks the map of a surface: closed, one to one, areas of quadrangles within 5 % of their targets.
fn check_map(found: &VolumeSurface) {
    let map = equal_area(&found.quads, &EqualAreaParams::default(), &Silent).unwrap();
    let topology = Topology::of(&map.surface);
    assert!(topology.is_sphere(), "{:?}", topology.problems());
    assert!(is_outward(&map.surface) && is_outward(&map.sphere));
    let quality = &map.report.quality;
    assert_eq!((quality.flipped, quality.degenerate, quality.winding_number), (0, 0, 1));
    let off = area_deviation(&found.quads, &map.sphere.vertices);
    assert!(off < 0.05 && map.report.converged, "{off} {:?}", map.report);
    let again = equal_area(&found.quads, &EqualAreaParams::default(), &Silent).unwrap();
    assert_eq!(map.sphere.vertices, again.sphere.vertices, "the same input, the same bits");
}

#[test]
fn balls_ellipsoids_and_bent_things_get_equal_areas() {
    check_map(&take(&volume(|at| ball(at, 9.3))).unwrap());
    check_map(&take(&volume(|[x, y, z]| ball([x / 2.5, y, z / 1.7], 4.3))).unwrap());
    // A ring with a gap, a dumbbell, a single voxel, three voxels in a corner.
    check_map(&take(&volume(|at| torus(at) && !(at[0] > 0.0 && at[1].abs() < 3.0))).unwrap());
    check_map(
        &take(&volume(|[x, y, z]| ball([x.abs() - 7.0, y, z], 4.0) || (x.abs() < 7.0 && y.hypot(z) < 1.6))).unwrap(),
    );
    check_map(&take(&volume(|at| at == [0.5; 3])).unwrap());
    check_map(&take(&volume(|at| at == [0.5; 3] || at == [1.5, 0.5, 0.5] || at == [0.5, 1.5, 0.5])).unwrap());
}

#[test]
fn the_surface_encloses_the_voxels_in_mm() {
    let inside = |at| ball(at, 6.0);
    let plain = take(&volume(inside)).unwrap();
    assert!((signed_volume(&plain.quads.triangles(|_| false)) / plain.voxels as f64 - 1.0).abs() < 1e-12);
    // A sheared and mirrored matrix: volumes are multiplied by its determinant, and the winding stays outward.
    let affine = Affine([[-2.0, 0.3, 0.0, 90.0], [0.0, 1.5, 0.1, -120.0], [0.0, 0.0, 1.0, -70.0]]);
    let mut moved = volume(inside);
    moved.affine = affine;
    let moved = take(&moved).unwrap();
    for q in [false, true] {
        let mesh = moved.quads.triangles(|_| q);
        assert!((signed_volume(&mesh) / (3.0 * plain.voxels as f64) - 1.0).abs() < 1e-12);
        assert!(Topology::of(&mesh).is_sphere());
    }
    check_map(&moved);
    // Voxel (0, 0, 0) is centred at the origin of the matrix.
    let corner = LabelVolume::new([1, 1, 1], vec![7], affine);
    let corner = take(&corner).unwrap();
    let middle: [f64; 3] = std::array::from_fn(|k| corner.quads.vertices.iter().map(|v| v[k]).sum::<f64>() / 8.0);
    assert!((0..3).all(|k| (middle[k] - affine.0[k][3]).abs() < 1e-12), "{middle:?}");
    assert_eq!((corner.label, corner.voxels), (7, 1));
}

/// How a NIfTI header states the positions of voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Sizes,
    Quaternion,
    Rows,
}

/// Returns a NIfTI file, of version 1 or 2, of a ball of radius 10 voxels. The voxels' `size`, and the `origin` of the
/// first one along each axis, are in the unit of the header's `xyzt_units`.
fn ball_in(version: u8, form: Form, xyzt_units: u8, size: f64, origin: f64) -> Vec<u8> {
    let at = |i: usize| [i % N, i / N % N, i / (N * N)].map(|x| x as f64 - 11.5);
    let values: Vec<u8> = (0..N * N * N).map(|i| u8::from(ball(at(i), 10.0))).collect();
    // Offsets of the voxel sizes, the unit, the codes of qform and sform, the qform's offset, and the sform's rows.
    let (mut bytes, width, [sizes, unit, qform, sform, offset, rows]) = match version {
        1 => (nifti([N as i16; 3], &values), 4, [80, 123, 252, 254, 268, 280]),
        _ => (nifti2([N as i64; 3], &values), 8, [112, 500, 344, 348, 376, 400]),
    };
    bytes[unit] = xyzt_units;
    match form {
        Form::Sizes => {}
        Form::Quaternion => bytes[qform] = 1,
        Form::Rows => bytes[sform] = 1,
    }
    let mut put = |at: usize, x: f64| match width {
        4 => bytes[at..at + 4].copy_from_slice(&(x as f32).to_le_bytes()),
        _ => bytes[at..at + 8].copy_from_slice(&x.to_le_bytes()),
    };
    for axis in 0..3 {
        // With an sform the voxel sizes aren't read.
        put(sizes + width * axis, if form == Form::Rows { 1.0 } else { size });
        put(offset + width * axis, origin);
        put(rows + width * (4 * axis + axis), size);
        put(rows + width * (4 * axis + 3), origin);
    }
    bytes
}

#[test]
fn nifti_files_in_metres_and_microns_are_read_in_mm() {
    let folder = tempfile::tempdir().unwrap();
    let near = |found: [f64; 3], expected: f64| found.iter().all(|x| (x - expected).abs() < 1e-6);
    // Voxels of 0.2 mm, and an origin of -2.3 mm, in an unknown unit, m, mm and microns.
    for (unit, millimetre) in [(0, 1.0), (1, 1e-3), (2, 1.0), (3, 1e3)] {
        for (version, form) in
            [1, 2].into_iter().flat_map(|v| [Form::Sizes, Form::Quaternion, Form::Rows].map(|f| (v, f)))
        {
            let named = format!("unit {unit}, NIfTI-{version}, {form:?}");
            let path = folder.path().join("ball.nii");
            // Bits 3 to 5 have the unit of time, here seconds.
            std::fs::write(&path, ball_in(version, form, unit | 8, 0.2 * millimetre, -2.3 * millimetre)).unwrap();
            let volume = LabelVolume::read(&path, &Silent).unwrap();
            let origin = if form == Form::Sizes { 0.0 } else { -2.3 };
            assert!(near(volume.voxel_size(), 0.2) && near(volume.affine.apply([0.0; 3]), origin), "{named}");
            let found = take(&volume).unwrap();
            let in_mm = signed_volume(&found.quads.triangles(|_| false));
            let of_ball = 4.0 / 3.0 * std::f64::consts::PI * 8.0;
            assert!((in_mm / of_ball - 1.0).abs() < 0.01, "{named}: {in_mm} {of_ball}");
            // A given voxel size is in mm, as the origin is.
            let reading = VolumeReading { voxel_size: Some([0.3; 3]), ..VolumeReading::default() };
            let volume = LabelVolume::read_with(&path, reading, &Silent).unwrap();
            assert!(near(volume.voxel_size(), 0.3) && near(volume.affine.apply([0.0; 3]), origin), "{named}");
        }
    }
    for (version, unit) in [(1, 4), (2, 5), (1, 6), (2, 7)] {
        let path = folder.path().join("unit.nii");
        std::fs::write(&path, ball_in(version, Form::Rows, unit | 8, 0.2, 0.0)).unwrap();
        let error = LabelVolume::read(&path, &Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::NotAVolume { .. }), "{error}");
        let said = error.to_string();
        let expected = format!("found xyzt_units {}, with the length unit {unit}", unit | 8);
        assert!(said.contains("unit.nii") && said.contains(&expected), "{said}");
    }
}

/// Checks that the smooth surface has the same vertices as the voxels' faces, a map of its own areas, the voxels'
/// volume, and nearly the area of the body. Labels of few voxels keep the faces.
#[test]
fn smooth_surfaces_have_their_own_map_and_the_volume_of_the_voxels() {
    let body = volume(|[x, y, z]| ball([x / 2.0, y, z], 4.5));
    let steps = take(&body).unwrap();
    let smooth = body.surface(&VolumeParams::default(), &Silent).unwrap();
    assert_eq!(steps.quads.vertices, smooth.quads.vertices);
    let maps = [&steps, &smooth].map(|found| equal_area(&found.quads, &EqualAreaParams::default(), &Silent).unwrap());
    check_map(&smooth);
    assert!(maps[1].quality().area_rms < 0.05, "{:?}", maps[1].report);
    let moved = maps[0].surface.vertices.iter().zip(&maps[1].surface.vertices);
    let farthest = moved.flat_map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs())).fold(0.0, f64::max);
    assert!(farthest > 0.1 && farthest <= 0.5 + 1e-12, "{farthest}");
    let [of_steps, of_smooth] = maps.map(|map| (area(&map.surface), signed_volume(&map.surface)));
    assert!((of_smooth.1 / smooth.voxels as f64 - 1.0).abs() < 5e-3, "{of_smooth:?}");
    // Area of the prolate spheroid with half axes 9, 4.5 and 4.5.
    assert!((of_smooth.0 / 435.0 - 1.0).abs() < 0.02 && of_steps.0 > 1.3 * of_smooth.0, "{of_smooth:?} {of_steps:?}");
    let single = volume(|at| at == [0.5; 3]).surface(&VolumeParams::default(), &Silent).unwrap();
    assert!((signed_volume(&single.quads.triangles(|_| false)) - 1.0).abs() < 1e-12);
    check_map(&single);
}

#[test]
fn a_label_at_the_border_is_closed_there() {
    let full = LabelVolume::new([3, 4, 5], vec![1; 60], Affine::IDENTITY);
    let found = take(&full).unwrap();
    assert_eq!(found.quads.quads.len(), 2 * (12 + 15 + 20));
    check_map(&found);
}

#[test]
fn handles_are_named_and_opened() {
    let ring = volume(torus);
    assert_eq!(problems(&ring), "1 handle (genus 1)");
    let found = fixed(&ring);
    let repair = found.repair.unwrap();
    // A cut through the tube takes about 21 voxels, filling the hole about 60.
    assert!(
        repair.handles == HandleRepair::Cut && repair.voxels_changed > 10 && repair.voxels_changed < 40,
        "{repair:?}"
    );
    check_map(&found);

    // A ball with an ear one voxel thick.
    let ear = |[x, y, z]: [f64; 3]| (x.hypot(y - 7.0) - 3.0).abs() < 0.71 && z.abs() < 0.6 && z > 0.0;
    let eared = volume(|at| ball(at, 6.0) || ear(at));
    assert_eq!(problems(&eared), "1 handle (genus 1)");
    let found = fixed(&eared);
    assert!(found.repair.unwrap().voxels() < 5, "{:?}", found.repair);
    check_map(&found);

    // A ball with a drilled hole one voxel wide. The hole is filled, since a cut would change more voxels.
    let drilled = volume(|at| ball(at, 6.0) && !(at[0] == 0.5 && at[1] == 0.5));
    let found = fixed(&drilled);
    assert_eq!(found.repair.unwrap().handles, HandleRepair::Filled);
    assert!(found.repair.unwrap().voxels() <= 2, "{:?}", found.repair);
    check_map(&found);
}

#[test]
fn pieces_and_cavities_are_counted() {
    let two = volume(|[x, y, z]| ball([x - 6.0, y, z], 4.0) || ball([x + 6.0, y, z], 3.0));
    let said = problems(&two);
    assert!(said.starts_with("2 pieces") && said.contains("voxels"), "{said}");
    let found = fixed(&two);
    let repair = found.repair.unwrap();
    assert!(repair.pieces_dropped == 1 && repair.voxels_dropped > 50 && repair.voxels_changed == 0, "{repair:?}");
    assert!(repair.to_string().contains("1 piece dropped"), "{repair}");
    check_map(&found);

    let hollow = volume(|at| ball(at, 6.0) && !ball(at, 2.0));
    let said = problems(&hollow);
    assert!(said.starts_with("1 cavity inside") && !said.contains("handle"), "{said}");
    let found = fixed(&hollow);
    assert_eq!(found.repair.unwrap().voxels_filled, found.repair.unwrap().voxels());
    check_map(&found);
}

#[test]
fn bare_contacts_are_split_or_repaired() {
    // Two voxels on a ball that share an edge; the surface passes between them.
    let ball_with = |more: &[[f64; 3]]| {
        let more = more.to_vec();
        volume(move |at| ball(at, 5.0) || more.contains(&at))
    };
    let top = (0..).map(|k| 0.5 + f64::from(k)).find(|&z| !ball([0.5, 0.5, z], 5.0)).unwrap();
    let edge = ball_with(&[[0.5, 0.5, top], [1.5, 1.5, top]]);
    assert!(ball([1.5, 1.5, top - 1.0], 5.0) && !ball([1.5, 1.5, top], 5.0));
    check_map(&take(&edge).unwrap());
    check_map(&fixed(&edge));
    // Two cubes that touch only in a corner, or only in an edge, are two pieces.
    let corner = volume(|at| at == [0.5; 3] || at == [1.5; 3]);
    assert!(problems(&corner).starts_with("2 pieces"));
    let diagonal = volume(|at| at == [0.5; 3] || at == [1.5, 1.5, 0.5]);
    assert!(problems(&diagonal).starts_with("2 pieces"));
    assert_eq!(fixed(&diagonal).quads.quads.len(), 6);
    // A hollow that opens to the outside only along an edge: its surface is closed as quadrangles, but not as
    // triangles.
    let bottle = volume(|[x, y, z]| {
        let walls = x.abs() < 3.0 && y.abs() < 3.0 && z.abs() < 2.0;
        let room = x.abs() < 2.0 && y.abs() < 2.0 && z.abs() < 1.0;
        walls && !room && !([x, y, z] == [2.5, 2.5, 0.5])
    });
    let said = problems(&bottle);
    assert!(said.contains("touch"), "{said}");
    check_map(&fixed(&bottle));
}

#[test]
fn every_label_of_a_volume_has_its_mask() {
    let several = labels(|[x, y, z]| if ball([x, y, z], 5.0) { 17 } else { i32::from(x > 9.0 && z < -4.0) * -3 });
    let all = several.labels();
    assert_eq!(all.keys().copied().collect::<Vec<_>>(), [-3, 17]);
    for (label, voxels) in all {
        let mask = several.mask(label).unwrap();
        let at = |i: [usize; 3]| i.map(|x| x as f64 - 11.5);
        let inside = |i| if label == 17 { ball(at(i), 5.0) } else { at(i)[0] > 9.0 && at(i)[2] < -4.0 };
        assert_eq!((mask.count(), &mask), (voxels, &Mask::new([N; 3], inside)), "{label}");
    }
}

#[test]
fn labels_are_chosen_or_named() {
    let several = labels(|at| if ball(at, 5.0) { 17 } else { i32::from(at[2] < -10.0) * 53 });
    let error = take(&several).unwrap_err().to_string();
    assert!(error.contains("expected one label") && error.contains("17 (") && error.contains("53 ("), "{error}");
    let with = |label| several.surface(&VolumeParams { label: Some(label), ..VolumeParams::default() }, &Silent);
    assert!(with(17).is_ok() && with(53).is_ok());
    let error = with(4).unwrap_err().to_string();
    assert!(error.contains("no voxel has label 4") && error.contains("17 ("), "{error}");
    let error = take(&labels(|_| 0)).unwrap_err().to_string();
    assert!(error.contains("only 0"), "{error}");
}

#[test]
fn published_hippocampi_get_equal_areas() {
    for name in ["hippo_a01_l", "hippo_a02_l", "hippo_a03_l"] {
        let Some(path) = spharm_testdata::shared(&format!("{name}.nii.gz")) else { continue };
        let found = take(&LabelVolume::read(&path, &Silent).unwrap()).unwrap();
        assert_eq!(found.repair, None);
        check_map(&found);
    }
}
