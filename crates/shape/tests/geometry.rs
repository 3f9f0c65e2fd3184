//! Compares differential geometry and measures with analytic surfaces, finite differences and published figures.

use ndarray::Array2;
use num_complex::Complex64;
use spharm_harmonics::index::{basis_size, column};
use spharm_harmonics::{Coefficients, Directions, synthesis};
use spharm_monitor::Silent;
use spharm_shape::{LocalGeometry, MeasureParams, MeasureWarning, ShapeError, local_geometry, measure, tangent_frame};
use spharm_surface::geometry::{Vec3, add, cross, dot, scale, sub};
use std::f64::consts::PI;

type Matrix = [Vec3; 3];

fn times(m: &Matrix, v: Vec3) -> Vec3 {
    m.map(|row| dot(row, v))
}

fn transposed(m: &Matrix) -> Matrix {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]))
}

/// Returns the rotation matrix of a quaternion of any length.
fn rotation([w, x, y, z]: [f64; 4]) -> Matrix {
    let s = 2.0 / (w * w + x * x + y * y + z * z);
    [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ]
}

/// Returns the surface X(u) = at + M u.
fn linear(m: &Matrix, at: Vec3) -> Coefficients {
    let mut values = Array2::zeros((4, 3));
    for c in 0..3 {
        values[[0, c]] = at[c] * (4.0 * PI).sqrt();
        for (row, axis) in [(column(1, 1), 0), (column(1, -1), 1), (column(1, 0), 2)] {
            values[[row, c]] = m[c][axis] * (4.0 * PI / 3.0).sqrt();
        }
    }
    Coefficients::new(values).expect("degree 1")
}

/// Semi-axes of an ellipsoid rotated by Q in space and by R in its parameters, `Q diag(axes) R u`; `AT` is its
/// position.
const AXES: Vec3 = [3.0, 2.0, 1.0];
const AT: Vec3 = [100.0, -50.0, 30.0];

fn ellipsoid(mirrored: bool) -> (Coefficients, Matrix) {
    let (q, r) = (rotation([0.3, -0.5, 0.7, 0.2]), rotation([0.9, 0.1, -0.4, 0.6]));
    let sign = if mirrored { -1.0 } else { 1.0 };
    let m = q.map(|row| {
        let scaled: Vec3 = [row[0] * AXES[0], row[1] * AXES[1], row[2] * AXES[2]];
        times(&transposed(&r), scaled).map(|x| sign * x)
    });
    (linear(&m, AT), q)
}

/// Returns directions all over the sphere, at the poles, and on the equator, at which the tangent frame is
/// discontinuous.
fn everywhere() -> Directions {
    let mut vertices = Directions::fibonacci(1_000).expect("directions").as_slice().to_vec();
    vertices.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, -0.8, -0.0], [1e-9, 0.0, 1.0]]);
    Directions::from_vertices(&vertices).expect("directions")
}

fn bumpy(max_degree: usize) -> Coefficients {
    let mut values = Array2::from_shape_fn((basis_size(max_degree), 3), |(k, c)| {
        0.08 * ((k * 7 + c * 3) as f64 * 0.37).sin() / (1.0 + (k as f64).sqrt())
    });
    for (row, c) in [(column(1, 1), 0), (column(1, -1), 1), (column(1, 0), 2)] {
        values[[row, c]] += 2.0;
    }
    Coefficients::new(values).expect("a degree")
}

#[test]
fn an_ellipsoid_has_its_normals_and_curvatures_everywhere() {
    let (coefficients, q) = ellipsoid(false);
    let directions = everywhere();
    let found = local_geometry(&coefficients, &directions, &Silent).expect("a surface");
    let product2 = (AXES[0] * AXES[1] * AXES[2]).powi(2);
    let mut worst = [0.0f64; 4];
    for (point, u) in found.iter().zip(directions.as_slice()) {
        let y = times(&transposed(&q), sub(point.position, AT));
        let gradient: Vec3 = std::array::from_fn(|k| y[k] / (AXES[k] * AXES[k]));
        let h = 1.0 / dot(gradient, gradient).sqrt();
        let normal = scale(times(&q, gradient), h);
        let gaussian = h.powi(4) / product2;
        let mean = h.powi(3) * (dot(AXES, AXES) - dot(y, y)) / (2.0 * product2);
        // The area element is |cof(M) u| = det |M^-T u|, and M^-T u = Q diag(1 / axes) R u = Q (gradient).
        let element = product2.sqrt() / h;
        let off = sub(point.normal, normal);
        let errors = [
            dot(off, off).sqrt(),
            (point.gaussian_curvature() / gaussian - 1.0).abs(),
            (point.mean_curvature() / mean - 1.0).abs(),
            (point.area_element / element - 1.0).abs(),
        ];
        assert!(errors.iter().all(|error| *error < 1e-12), "{u:?}: {errors:?}");
        for (worst, error) in worst.iter_mut().zip(errors) {
            *worst = worst.max(error);
        }
        let [k1, k2] = point.principal;
        assert!(k1 >= k2 && (point.shape_index() - 2.0 / PI * ((k1 + k2) / (k1 - k2)).atan()).abs() < 1e-12);
        assert!((point.curvedness().powi(2) - 0.5 * (k1 * k1 + k2 * k2)).abs() < 1e-12);
    }
    println!("ellipsoid: normal, K, H, area element: {:?}", worst.map(|w| format!("{w:.1e}")));
}

#[test]
fn an_ellipsoid_has_its_area_volume_and_centre() {
    /// Area of the ellipsoid, computed to 30 digits from elliptic integrals.
    const AREA: f64 = 48.882_146_302_582_06;
    let volume = 4.0 / 3.0 * PI * AXES[0] * AXES[1] * AXES[2];
    let params = MeasureParams { tolerance: 1e-13, most_rings: None };
    for mirrored in [false, true] {
        let found = measure(&ellipsoid(mirrored).0, &params, &Silent).expect("a surface");
        println!("ellipsoid: area {:.1e}, volume {:.1e}", found.area / AREA - 1.0, found.volume / volume - 1.0);
        assert!((found.area / AREA - 1.0).abs() < 1e-12, "{found:?}");
        assert!((found.volume / volume - 1.0).abs() < 1e-12, "{found:?}");
        let off = sub(found.centroid, AT);
        assert!(dot(off, off).sqrt() < 1e-12, "{found:?}");
        assert!((found.sphericity - (36.0 * PI * volume * volume).cbrt() / AREA).abs() < 1e-12);
        assert_eq!(found.inwards, mirrored);
        let warnings: &[MeasureWarning] = if mirrored { &[MeasureWarning::Inwards] } else { &[] };
        assert_eq!(found.warnings, warnings);
    }
}

#[test]
fn a_mirrored_surface_has_the_curvatures_of_the_other_side() {
    let directions = everywhere();
    let outwards = local_geometry(&ellipsoid(false).0, &directions, &Silent).expect("a surface");
    // Because -M u equals M (-u), the mirrored surface has the reversed normals of the antipodal directions.
    let inwards = local_geometry(&ellipsoid(true).0, &directions, &Silent).expect("a surface");
    for (a, b) in outwards.iter().zip(inwards) {
        let b = b.flipped();
        let off = add(a.normal, b.normal);
        assert!(dot(off, off).sqrt() < 1e-14);
        assert!((a.mean_curvature() - b.mean_curvature()).abs() < 1e-13);
        assert!((a.gaussian_curvature() - b.gaussian_curvature()).abs() < 1e-13);
        assert!((a.shape_index() - b.shape_index()).abs() < 1e-12);
    }
}

#[test]
fn a_sphere_is_a_cap_everywhere() {
    let r = 2.5;
    let sphere = linear(&[[r, 0.0, 0.0], [0.0, r, 0.0], [0.0, 0.0, r]], AT);
    for point in local_geometry(&sphere, &everywhere(), &Silent).expect("a surface") {
        assert!(point.principal.iter().all(|k| (k * r - 1.0).abs() < 1e-13), "{point:?}");
        assert!((point.shape_index() - 1.0).abs() < 1e-6, "{point:?}");
    }
    let found = measure(&sphere, &MeasureParams::default(), &Silent).expect("a surface");
    assert!((found.sphericity - 1.0).abs() < 1e-13 && found.squeezed == 0.0, "{found:?}");
}

/// Computes normal, area element, Gaussian and mean curvature from central differences along great circles, by
/// textbook formulas.
fn brute_force(coefficients: &Coefficients, u: Vec3) -> (Vec3, f64, f64, f64) {
    let [e1, e2] = tangent_frame(u);
    let at = |s: f64, t: f64| -> Vec3 {
        let (v, angle) = (add(scale(e1, s), scale(e2, t)), s.hypot(t));
        let sinc = if angle > 0.0 { angle.sin() / angle } else { 1.0 };
        let direction = add(scale(u, angle.cos()), scale(v, sinc));
        let directions = Directions::from_vertices(&[direction]).expect("a direction");
        let row = synthesis(&directions, coefficients.values().view()).expect("a degree");
        [row[[0, 0]], row[[0, 1]], row[[0, 2]]]
    };
    let h = 1e-3;
    // Richardson extrapolation makes the differences accurate to fourth order.
    let richardson = |f: &dyn Fn(f64) -> Vec3| scale(sub(scale(f(h), 4.0), f(2.0 * h)), 1.0 / 3.0);
    let first = |s: f64, t: f64| richardson(&|h| scale(sub(at(s * h, t * h), at(-s * h, -t * h)), 0.5 / h));
    let second = |s: f64, t: f64| {
        let centre = scale(at(0.0, 0.0), -2.0);
        richardson(&|h| scale(add(add(at(s * h, t * h), at(-s * h, -t * h)), centre), 1.0 / (h * h)))
    };
    let (x1, x2, x11, x22) = (first(1.0, 0.0), first(0.0, 1.0), second(1.0, 0.0), second(0.0, 1.0));
    let x12 = scale(sub(sub(second(1.0, 1.0), x11), x22), 0.5);
    let n = cross(x1, x2);
    let element = dot(n, n).sqrt();
    let n = scale(n, 1.0 / element);
    let [ee, ff, gg] = [dot(x1, x1), dot(x1, x2), dot(x2, x2)];
    let [e, f, g] = [dot(n, x11), dot(n, x12), dot(n, x22)];
    let determinant = ee * gg - ff * ff;
    let mean = -(e * gg - 2.0 * f * ff + g * ee) / (2.0 * determinant);
    (n, element, (e * g - f * f) / determinant, mean)
}

#[test]
fn curvatures_of_a_bumpy_surface_are_those_of_finite_differences() {
    let coefficients = bumpy(6);
    let mut vertices = Directions::fibonacci(40).expect("directions").as_slice().to_vec();
    vertices.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]);
    let directions = Directions::from_vertices(&vertices).expect("directions");
    let found = local_geometry(&coefficients, &directions, &Silent).expect("a surface");
    for (point, &u) in found.iter().zip(directions.as_slice()) {
        let (normal, element, gaussian, mean) = brute_force(&coefficients, u);
        let scale_of = 1.0 + point.curvedness().powi(2);
        assert!(dot(sub(point.normal, normal), sub(point.normal, normal)).sqrt() < 1e-8, "{u:?}");
        assert!((point.area_element - element).abs() < 1e-8, "{u:?}");
        assert!((point.gaussian_curvature() - gaussian).abs() < 1e-6 * scale_of, "{u:?} {gaussian} {point:?}");
        assert!((point.mean_curvature() - mean).abs() < 1e-6 * scale_of, "{u:?} {mean} {point:?}");
        // The Gaussian curvature also follows from the two fundamental forms.
        let [ee, ff, gg] = point.first_form;
        let [e, f, g] = point.second_form;
        let determinant = ee * gg - ff * ff;
        assert!((point.gaussian_curvature() - (e * g - f * f) / determinant).abs() < 1e-12 * scale_of);
    }
}

/// By the theorem of Gauss and Bonnet, the integral of K over a closed surface of genus zero is 4 pi.
#[test]
fn the_integral_of_the_gaussian_curvature_is_that_of_a_sphere() {
    let rings = spharm_harmonics::gauss_legendre(80);
    let mut vertices = Vec::new();
    for j in 0..80 {
        vertices.extend((0..160).map(|k| {
            let (sin, cos) = (PI * f64::from(k) / 80.0).sin_cos();
            [rings.sines[j] * cos, rings.sines[j] * sin, rings.cosines[j]]
        }));
    }
    let directions = Directions::from_vertices(&vertices).expect("directions");
    let found = local_geometry(&bumpy(6), &directions, &Silent).expect("a surface");
    let ring = |points: &[LocalGeometry]| {
        points.iter().map(|point| point.gaussian_curvature() * point.area_element).sum::<f64>()
    };
    let sum: f64 = found.chunks(160).zip(&rings.weights).map(|(points, w)| w * PI / 80.0 * ring(points)).sum();
    assert!((sum / (4.0 * PI) - 1.0).abs() < 1e-10, "{sum}");
}

#[test]
fn a_flat_surface_has_no_volume_and_its_rim_no_normal() {
    let flat = linear(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]], AT);
    let found = measure(&flat, &MeasureParams { most_rings: Some(64), ..Default::default() }, &Silent).expect("flat");
    assert!(found.volume == 0.0 && found.centroid == AT.map(|x| x + 0.0), "{found:?}");
    // The flat surface is two discs of area pi each.
    assert!((found.area / (2.0 * PI) - 1.0).abs() < 1e-3, "{found:?}");
    assert!(found.warnings.contains(&MeasureWarning::Flat));
    assert!(found.warnings.iter().any(|warning| matches!(warning, MeasureWarning::NotConverged { rings: 64, .. })));
    let equator = Directions::from_vertices(&[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).expect("directions");
    let [rim, centre] = local_geometry(&flat, &equator, &Silent).expect("flat")[..] else { panic!("two") };
    assert!(rim.is_singular() && !centre.is_singular());
    for point in [rim, centre] {
        let numbers = [point.gaussian_curvature(), point.mean_curvature(), point.shape_index(), point.curvedness()];
        assert!(numbers.iter().all(|number| number.abs() < 1e-15), "{point:?}");
    }
}

#[test]
fn what_is_no_surface_is_refused() {
    let directions = everywhere();
    let of = |values: Array2<f64>| {
        let coefficients = Coefficients::new(values).expect("a degree");
        let error = local_geometry(&coefficients, &directions, &Silent).expect_err("no surface");
        let same = measure(&coefficients, &MeasureParams::default(), &Silent).expect_err("no surface");
        assert_eq!(error.to_string(), same.to_string());
        error
    };
    assert!(matches!(of(Array2::ones((4, 2))), ShapeError::NotASurface { channels: 2 }));
    assert!(matches!(of(Array2::ones((1, 3))), ShapeError::NoExtent { rank: 0, .. }));
    assert!(matches!(of(Array2::ones((4, 3))), ShapeError::NoExtent { rank: 1, .. }));
    assert!(matches!(of(Array2::from_elem((4, 3), f64::NAN)), ShapeError::NotFinite { row: 0, .. }));
    for tolerance in [0.0, -1.0, f64::NAN] {
        let params = MeasureParams { tolerance, most_rings: None };
        let error = measure(&bumpy(3), &params, &Silent).expect_err("no tolerance");
        assert!(matches!(error, ShapeError::Setting { .. }), "{error}");
    }
}

#[test]
fn results_are_the_same_bits_on_any_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let coefficients = bumpy(12);
            let geometry = local_geometry(&coefficients, &everywhere(), &Silent).expect("a surface");
            (geometry, measure(&coefficients, &MeasureParams::default(), &Silent).expect("a surface"))
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn a_wish_to_stop_is_heard() {
    let stop = std::sync::atomic::AtomicBool::new(true);
    let error = local_geometry(&bumpy(3), &everywhere(), &stop).expect_err("stopped");
    assert!(matches!(error, ShapeError::Interrupted(_)));
    assert!(measure(&bumpy(3), &MeasureParams::default(), &stop).is_err());
}

/// The coefficients are those of a hippocampus by the paper's authors, L = 15, centred. The expected values were
/// computed with 128 rings.
#[test]
fn a_hippocampus_has_its_area_and_volume() {
    let Some(path) = spharm_testdata::shared("hippo_a01_l.degree15.fvec.csv") else { return };
    let text = std::fs::read_to_string(path).expect("a table");
    let mut complex = Array2::zeros((basis_size(15), 3));
    for (row, line) in text.lines().skip(1).enumerate() {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        for c in 0..3 {
            complex[[row, c]] = Complex64::new(cells[2 + 2 * c], cells[3 + 2 * c]);
        }
    }
    let coefficients = Coefficients::from_complex(&complex).expect("degree 15");
    let found = measure(&coefficients, &MeasureParams::default(), &Silent).expect("a surface");
    println!("hippocampus: volume {:.10}, area {:.5}, {} rings", found.volume, found.area, found.rings);
    assert!((found.volume / 2_818.137_615_800_1 - 1.0).abs() < 1e-12, "{found:?}");
    assert!((found.area / 1_477.653_35 - 1.0).abs() < 1e-7, "{found:?}");
}

/// Synthesis uses transforms for many directions at high degrees, and direct sums for few directions.
#[test]
fn transforms_and_direct_sums_give_the_same_geometry() {
    let coefficients = bumpy(48);
    let many = Directions::fibonacci(3_000).expect("directions");
    let few = Directions::from_unit_vectors(many.as_slice()[..100].to_vec()).expect("directions");
    let many = local_geometry(&coefficients, &many, &Silent).expect("a surface");
    let few = local_geometry(&coefficients, &few, &Silent).expect("a surface");
    for (a, b) in many.iter().zip(&few) {
        let off = sub(a.normal, b.normal);
        assert!(dot(off, off).sqrt() < 1e-10, "{a:?} {b:?}");
        let scale_of = 1.0 + b.curvedness();
        assert!((a.mean_curvature() - b.mean_curvature()).abs() < 1e-10 * scale_of, "{a:?} {b:?}");
        assert!((a.gaussian_curvature() - b.gaussian_curvature()).abs() < 1e-10 * scale_of.powi(2), "{a:?} {b:?}");
    }
}
