use ndarray::Array2;
use proptest::prelude::*;
use spharm_monitor::Silent;

use super::*;
use crate::samples::{apart, blob, ellipsoid, hippocampi, pose, posed, reflected, some_pose};

fn aligned(moving: &Coefficients, target: &Coefficients, params: &AlignParams) -> Alignment {
    align(moving, target, params, &Silent).unwrap()
}

/// Distances of four aligned hippocampi from a fifth one. The distances in `SHREC` are from the method SHREC in
/// SPHARM-MAT, and those in the second array from the joint search in the prototype that shape.md describes.
const SHREC: [f64; 4] = [3.8910, 3.6538, 2.0639, 4.0496];
const KNOWN: [f64; 4] = [3.8725, 3.6126, 2.0627, 4.0112];

#[test]
fn hippocampi_come_nearer_than_by_shrec_from_any_pose() {
    let Some(surfaces) = hippocampi("foe") else { return };
    for (n, moving) in surfaces[1..].iter().enumerate() {
        let found = aligned(moving, &surfaces[0], &AlignParams::default()).report.rmsd_after;
        assert!(found <= KNOWN[n] + 1e-3 && found < SHREC[n], "{n}: {found}");
        for m in 0..3 {
            let moved = posed(moving, &some_pose(7 * n + m));
            let again = aligned(&moved, &surfaces[0], &AlignParams::default()).report.rmsd_after;
            assert!((again - found).abs() < 1e-6, "{n} {m}: {again} {found}");
        }
    }
}

#[test]
fn fewer_starts_and_more_find_the_same() {
    let Some(surfaces) = hippocampi("foe") else { return };
    let many = AlignParams { bandwidth: Some(13), starts: 16, ..Default::default() };
    for (n, (moving, target)) in [(1, 2), (3, 4), (4, 0), (2, 3)].into_iter().enumerate() {
        let moving = posed(&surfaces[moving], &some_pose(n));
        let report = aligned(&moving, &surfaces[target], &AlignParams::default()).report;
        let best = aligned(&moving, &surfaces[target], &many).report.rmsd_after;
        assert!(report.rmsd_after < best + 1e-9, "{n}: {} {best}", report.rmsd_after);
    }
}

/// The surfaces are nearly ellipsoids, so there is an optimum for each of four half turns, and the distances at these
/// optima differ by less than a percent. The grid has several maxima near each of these optima, and a search of the
/// grid alone misses the best optimum.
#[test]
fn optima_a_half_turn_apart_are_told_apart() {
    let many = AlignParams { bandwidth: Some(13), starts: 16, ..Default::default() };
    let (f, g) = (blob(6, 26), blob(6, 27));
    for n in 0..6 {
        let f = posed(&f, &some_pose(n));
        let found = aligned(&f, &g, &AlignParams::default()).report;
        let best = aligned(&f, &g, &many).report.rmsd_after;
        assert!(found.rmsd_after < best + 1e-9, "{n}: {best} {:?}", found.ends);
    }
}

/// Surfaces of high degree are first refined at a lower degree.
#[test]
fn high_degrees_find_the_same_from_any_pose() {
    let (f, g) = (blob(45, 3), blob(45, 4));
    let many = AlignParams { bandwidth: Some(12), starts: 20, ..Default::default() };
    let best = aligned(&f, &g, &many).report.rmsd_after;
    for n in 0..2 {
        let found = aligned(&posed(&f, &some_pose(n)), &g, &AlignParams::default()).report;
        assert!((found.rmsd_after - best).abs() < 1e-9, "{n}: {best} {:?}", found.ends);
    }
}

#[test]
fn a_rotated_copy_comes_back() {
    for n in 0..5 {
        let surface = blob(9, 3);
        let found = aligned(&posed(&surface, &some_pose(n)), &surface, &AlignParams::default());
        assert!(found.report.rmsd_after < 1e-11 * 9.0, "{n}: {:e}", found.report.rmsd_after);
        assert!(found.report.warnings.is_empty() && !found.report.mirrored);
    }
}

#[test]
fn the_best_scale_is_found() {
    let (surface, params) = (blob(7, 1), AlignParams { scale: true, ..Default::default() });
    let mut transform = some_pose(4);
    transform.similarity.scale = 0.37;
    let found = aligned(&posed(&surface, &transform), &surface, &params).report;
    assert!((found.transform.similarity.scale * 0.37 - 1.0).abs() < 1e-12 && found.rmsd_after < 1e-11);
}

#[test]
fn a_mirror_image_is_matched_only_if_asked_for() {
    let surface = blob(8, 5);
    let mirror = AlignParams { mirror: true, ..Default::default() };
    // The surface is mirrored in space, once without and once with its sphere.
    let both = Transform { antipodal: true, ..Transform::default() };
    for image in [reflected(&surface), posed(&reflected(&surface), &both)] {
        let image = posed(&image, &some_pose(2));
        let proper = aligned(&image, &surface, &AlignParams::default()).report;
        assert!(proper.rmsd_after > 0.1 && !proper.mirrored, "{proper:?}");
        let mirrored = aligned(&image, &surface, &mirror).report;
        assert!(mirrored.rmsd_after < 1e-11 && mirrored.mirrored, "{mirrored:?}");
    }
}

#[test]
fn a_hippocampus_isnt_its_reflection() {
    let Some(surfaces) = hippocampi("foe") else { return };
    // The sphere of the mirror image is mirrored as well.
    let image = posed(&reflected(&surfaces[0]), &Transform { antipodal: true, ..some_pose(8) });
    let proper = aligned(&image, &surfaces[0], &AlignParams::default()).report.rmsd_after;
    assert!((proper - 2.2486).abs() < 1e-4, "{proper}");
    let mirror = AlignParams { mirror: true, ..Default::default() };
    assert!(aligned(&image, &surfaces[0], &mirror).report.rmsd_after < 1e-11);
}

#[test]
fn fixed_parameters_leave_the_sphere_alone() {
    let (surface, mut transform) = (blob(8, 2), some_pose(3));
    transform.rotation = Rotation::IDENTITY;
    let params = AlignParams { method: Method::FixedParameters, ..Default::default() };
    let found = aligned(&posed(&surface, &transform), &surface, &params);
    assert!(found.report.transform.rotation == Rotation::IDENTITY && found.report.rmsd_after < 1e-12);
    assert!(apart(&surface, &found.coefficients) < 1e-13);
}

/// Each ellipsoid's axes have four possible orientations, and the pair of orientations with the smallest distance is
/// chosen. The expected distances are from shape.md. A round surface causes a warning, because its axes are arbitrary.
#[test]
fn ellipsoid_frames_are_no_better_than_known() {
    let params = AlignParams { method: Method::FirstOrderEllipsoid, ..Default::default() };
    if let Some(surfaces) = hippocampi("foe") {
        for (moving, expected) in surfaces[1..].iter().zip([3.907, 3.709, 2.065, 4.063]) {
            let found = aligned(&posed(moving, &some_pose(1)), &surfaces[0], &params).report;
            assert!((found.rmsd_after - expected).abs() < 1e-3, "{} {expected}", found.rmsd_after);
        }
    }
    let round = ellipsoid([1.0, 1.0, 0.5]);
    let report = aligned(&round, &round, &params).report;
    assert!(matches!(report.warnings[..], [AlignWarning::NearlyRound { .. }]), "{report:?}");
}

/// The distance between ellipsoids in the same pose follows from the differences of their axes.
#[test]
fn ellipsoids_differ_by_their_axes() {
    let (a, b) = (ellipsoid([5.0, 3.0, 2.0]), ellipsoid([4.0, 3.5, 2.5]));
    let found = aligned(&posed(&a, &some_pose(6)), &b, &AlignParams::default()).report;
    // The mean square of (d_x u_x, d_y u_y, d_z u_z) over the sphere is a third of |d|^2.
    assert!((found.rmsd_after - (1.5_f64 / 3.0).sqrt()).abs() < 1e-12, "{found:?}");
}

#[test]
fn what_is_undetermined_is_said() {
    let flat = |columns: usize| {
        let mut values = blob(5, 1).values().clone();
        (columns..3).for_each(|c| values.column_mut(c).fill(0.0));
        posed(&Coefficients::new(values).unwrap(), &some_pose(5))
    };
    let warnings = |a: &Coefficients, params: &AlignParams| aligned(a, a, params).report.warnings;
    let plain = AlignParams::default();
    assert_eq!(warnings(&flat(0), &plain), [AlignWarning::Point]);
    assert_eq!(warnings(&flat(1), &plain), [AlignWarning::ObjectUndetermined]);
    assert_eq!(warnings(&flat(2), &plain), []);
    assert_eq!(warnings(&flat(2), &AlignParams { mirror: true, ..plain.clone() }), [AlignWarning::MirrorUndetermined]);
    assert_eq!(warnings(&ellipsoid([2.0, 2.0, 1.0]), &plain), [AlignWarning::BothUndetermined]);
    assert_eq!(warnings(&ellipsoid([2.0, 1.5, 1.0]), &plain), []);
    let single = Coefficients::new(Array2::ones((1, 3))).unwrap();
    assert_eq!(warnings(&single, &plain), [AlignWarning::Point]);
}

#[test]
fn the_lower_degree_is_compared_and_all_are_transformed() {
    let (long, short) = (blob(9, 2), Coefficients::new(blob(9, 2).up_to(6).to_owned()).unwrap());
    let found = aligned(&posed(&long, &some_pose(1)), &short, &AlignParams::default());
    assert_eq!((found.report.degree, found.coefficients.max_degree()), (6, 9));
    assert_eq!(found.report.warnings, [AlignWarning::DegreesDiffer { moving: 9, target: 6, used: 6 }]);
    assert!(apart(&long, &found.coefficients) < 1e-11 && found.report.rmsd_after < 1e-11);
}

#[test]
fn bad_input_is_refused() {
    let (good, params) = (blob(3, 1), AlignParams::default());
    let signal = Coefficients::new(Array2::zeros((16, 1))).unwrap();
    assert!(matches!(align(&signal, &good, &params, &Silent), Err(ShapeError::NotASurface { channels: 1 })));
    let mut values = good.values().clone();
    values[[4, 2]] = f64::INFINITY;
    let infinite = Coefficients::new(values).unwrap();
    assert!(matches!(align(&good, &infinite, &params, &Silent), Err(ShapeError::NotFinite { row: 4, channel: 2, .. })));
    for params in
        [AlignParams { starts: 0, ..Default::default() }, AlignParams { bandwidth: Some(1), ..Default::default() }]
    {
        assert!(matches!(align(&good, &good, &params, &Silent), Err(ShapeError::Setting { .. })));
    }
    let stopped = std::sync::atomic::AtomicBool::new(true);
    assert!(matches!(align(&good, &good, &params, &stopped), Err(ShapeError::Interrupted(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Moving the first surface to another pose doesn't change the result: align(R f, g) = align(f, g).
    #[test]
    fn the_pose_of_the_moving_surface_doesnt_matter(numbers in prop::array::uniform6(0.0..1.0), seed in 0u32..50) {
        let (f, g) = (blob(6, seed), blob(6, seed + 1));
        let (plain, turned) = (
            aligned(&f, &g, &AlignParams::default()),
            aligned(&posed(&f, &pose(numbers)), &g, &AlignParams::default()),
        );
        prop_assert!((plain.report.rmsd_after - turned.report.rmsd_after).abs() < 1e-9);
        prop_assert!(apart(&plain.coefficients, &turned.coefficients) < 1e-6);
    }
}

/// The pose in space is found regardless of the parameters, even if the spheres were rotated against each other.
#[test]
fn poses_by_surfaces_dont_depend_on_the_parameters() {
    let target = blob(6, 1);
    let params = AlignParams { method: Method::Surfaces, ..AlignParams::default() };
    for n in 0..3 {
        let known = some_pose(n);
        let found = align(&posed(&target, &known), &target, &params, &Silent).unwrap().report;
        let back = known.similarity.then(&found.transform.similarity);
        let off = back.apply([1.0, 2.0, 3.0]);
        let miss = (0..3).map(|k| (off[k] - [1.0, 2.0, 3.0][k]).powi(2)).sum::<f64>().sqrt();
        let size = rmsd(&target, &Coefficients::new(target.values() * 0.0).unwrap()).unwrap();
        assert!(miss < 0.02 * size && found.rmsd_after < 0.02 * size, "{n}: {miss} {found:?}");
        assert!(found.surface_distance.is_some_and(|distance| distance < 0.02 * size), "{found:?}");
        assert!(!found.mirrored);
    }
}

#[test]
fn mirrored_poses_by_surfaces_keep_the_outside_outside() {
    let target = blob(6, 1);
    let params = AlignParams { method: Method::Surfaces, mirror: true, ..AlignParams::default() };
    // The first surface is mirrored only in space, and is therefore inside out. The sphere of the second surface is
    // mirrored as well.
    let inside_out = reflected(&target);
    let turned = Transform { antipodal: true, ..Transform::default() }.apply(&inside_out, &Silent).unwrap();
    for (moving, antipodal) in [(inside_out, false), (turned, true)] {
        let found = align(&moving, &target, &params, &Silent).unwrap().report;
        assert!(found.mirrored && found.transform.antipodal == antipodal, "{found:?}");
        assert!(found.rmsd_after < 0.05 * found.rmsd_before, "{found:?}");
    }
}
