//! Tests compressed models: round trips, targets, levels and the golden files.

mod hostile;

use std::path::{Path, PathBuf};

use ndarray::Array2;
use proptest::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::{basis_size, degree_order};
use spharm_model::Model;
use spharm_monitor::Silent;
use spharm_shape::ShapeError;
use spharm_shape::codec::{CodecError, CompressParams, Compressed, ExpandParams, Target, compress, expand};
use spharm_surface::geometry::{add, dot, face_normal, sub};
use spharm_surface::metrics::{SurfaceDistanceParams, bounding_box_scale, surface_distance};
use spharm_surface::{Kind, Sphere};

/// Settings to expand complete files, with all degrees.
const WHOLE: ExpandParams = ExpandParams { max_degree: None, prefix: false };
/// Settings to expand prefixes of files.
const PREFIX: ExpandParams = ExpandParams { max_degree: None, prefix: true };

/// Returns a generator of pseudorandom numbers from 0 to 1.
fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    }
}

/// Returns a bumpy ellipsoid of about 20 units, away from the origin, or a model of signals with `channels` channels.
fn model(max_degree: usize, channels: usize, kind: Kind, seed: u64) -> Model {
    let mut random = random(seed);
    let mut values = Array2::from_shape_fn((basis_size(max_degree), channels), |(row, _)| {
        let degree = degree_order(row).0.max(1) as f64;
        6.0 * (random() - 0.5) * degree.powf(-2.5)
    });
    for (row, channel) in [(3, 0), (1, 1), (2, 2)] {
        if max_degree > 0 && channel < channels {
            values[[row, channel]] += 10.0;
        }
    }
    values.row_mut(0).fill(-70.0);
    let mut model = Model::without_sphere(Coefficients::new(values).unwrap(), kind);
    model.provenance.anatomical_structure_primary = Some("CortexLeft".to_owned());
    model.provenance.scale = Some(1.0 / 3.0);
    model.scheme_key = Some("ab".repeat(32));
    model
}

fn surface(max_degree: usize) -> Model {
    model(max_degree, 3, Kind::Surface, 1)
}

fn compressed(model: &Model, target: Target) -> Compressed {
    compress(model, &CompressParams::new(target), &Silent).unwrap()
}

/// Returns the root mean square difference between two models over the sphere.
fn error(a: &Coefficients, b: &Coefficients) -> f64 {
    let square: f64 = a.values().iter().zip(b.values()).map(|(a, b)| (a - b).powi(2)).sum();
    (square / (4.0 * std::f64::consts::PI)).sqrt()
}

#[test]
fn a_surface_comes_back_within_its_tolerance() {
    let model = surface(20);
    for tolerance in [1e-2, 1e-3, 1e-5] {
        let file = compressed(&model, Target::Tolerance(tolerance));
        assert!((0.9 * tolerance..=tolerance).contains(&file.distance), "{tolerance} {}", file.distance);
        let expanded = expand(&file.bytes, &WHOLE).unwrap();
        // The distance is measured independently, on a finer icosphere and with more points.
        let on = |model: &Model| model.reconstruct(&Sphere::icosphere(6), 20).unwrap();
        let params = SurfaceDistanceParams { samples: 200_000 };
        let distance = surface_distance(&on(&model), &on(&expanded.model), &params, &Silent).unwrap();
        let relative = distance.rms / distance.scale;
        assert!((0.88 * tolerance..=tolerance).contains(&relative), "{tolerance} {relative}");
        assert_eq!(expanded.model.coefficients.max_degree(), 20);
        assert_eq!((expanded.bytes, expanded.model.sphere), (file.bytes.len(), None));
    }
}

/// Returns the root mean square displacement along the normal over the area, at 10,242 vertices, relative to a surface
/// whose bounding box is scaled to volume 1.
fn displacement(from: &Model, to: &Model) -> f64 {
    let on = |model: &Model| model.reconstruct(&Sphere::icosphere(5), model.coefficients.max_degree()).unwrap();
    let (from, to) = (on(from), on(to));
    let mut normals = vec![[0.0; 3]; from.vertices.len()];
    for face in &from.faces {
        let normal = face_normal(face.map(|v| from.vertices[v as usize]));
        face.iter().for_each(|&v| normals[v as usize] = add(normals[v as usize], normal));
    }
    let (mut squares, mut area) = (0.0, 0.0);
    for (normal, (from, to)) in normals.iter().zip(from.vertices.iter().zip(&to.vertices)) {
        let length = dot(*normal, *normal).sqrt();
        squares += dot(*normal, sub(*to, *from)).powi(2) / length;
        area += length;
    }
    (squares / area).sqrt() / bounding_box_scale(&from.vertices).unwrap()
}

#[test]
fn tolerances_hold_for_displacements_along_the_normal_too() {
    let mut most = 0.0_f64;
    for seed in 1..=12 {
        let model = model(5 + 3 * seed as usize / 2, 3, Kind::Surface, seed);
        let tolerance = 1e-2 * 0.6_f64.powi(seed as i32);
        let file = compressed(&model, Target::Tolerance(tolerance));
        let expanded = expand(&file.bytes, &WHOLE).unwrap().model;
        most = most.max(displacement(&model, &expanded) / tolerance);
    }
    assert!((0.9..=1.0).contains(&most), "{most}");
}

#[test]
fn what_is_known_of_a_model_is_kept_where_it_is_to_be() {
    let model = surface(4);
    let mut params = CompressParams::new(Target::Step(1e-3));
    let file = compress(&model, &params, &Silent).unwrap();
    let found = expand(&file.bytes, &WHOLE).unwrap().model;
    assert_eq!(found.scheme_key, model.scheme_key);
    let done = &found.provenance.other["transform"][0]["compressed"];
    assert_eq!(done["bytes"], file.bytes.len());
    assert_eq!(done["step"].as_f64(), Some(file.step * file.scale));
    let mut provenance = found.provenance.clone();
    provenance.other.clear();
    assert_eq!(provenance.tool.take().as_deref(), Some("shape compress"));
    assert_eq!(provenance, model.provenance);

    params.provenance = false;
    let bare = compress(&model, &params, &Silent).unwrap();
    assert!(bare.bytes.len() + 100 < file.bytes.len());
    let found = expand(&bare.bytes, &WHOLE).unwrap().model;
    assert_eq!((&found.scheme_key, found.provenance.scale), (&None, None));
    assert_eq!(found.kind(), Kind::Surface);
}

#[test]
fn a_file_has_at_most_the_bytes_asked_for() {
    let model = surface(20);
    for bytes in [600, 1000, 2000] {
        let file = compressed(&model, Target::Bytes(bytes));
        assert!((bytes - bytes / 50..=bytes).contains(&file.bytes.len()), "{bytes} {}", file.bytes.len());
    }
    let error = compress(&model, &CompressParams::new(Target::Bytes(50)), &Silent).unwrap_err();
    assert!(matches!(error, CodecError::TooFewBytes { wanted: 50, .. }), "{error}");
}

#[test]
fn a_beginning_is_a_coarser_model() {
    let model = surface(24);
    let params = CompressParams { levels: Some(vec![1, 5, 10, 99]), ..CompressParams::new(Target::Step(1e-4)) };
    let file = compress(&model, &params, &Silent).unwrap();
    let degrees: Vec<usize> = file.levels.iter().map(|level| level.degree).collect();
    assert_eq!(degrees, [1, 5, 10, 24]);
    let whole = expand(&file.bytes, &WHOLE).unwrap().model.coefficients;
    for cut in file.head..file.bytes.len() {
        let beginning = &file.bytes[..cut];
        let level = file.levels.iter().rfind(|level| level.bytes <= cut);
        let refused = expand(beginning, &WHOLE).unwrap_err();
        assert!(matches!(refused, CodecError::CutOff { level: found, .. } if found == level.map(|level| level.degree)));
        match (expand(beginning, &PREFIX), level) {
            (Ok(found), Some(level)) => {
                assert_eq!((found.model.coefficients.max_degree(), found.bytes), (level.degree, level.bytes));
                assert_eq!(found.model.coefficients.values(), whole.up_to(level.degree));
            }
            (Err(CodecError::CutOff { expected, found, level: None }), None) => {
                assert_eq!((expected, found), (file.levels[0].bytes, cut));
            }
            (found, _) => panic!("{cut}: {found:?}"),
        }
    }
    for degree in 0..=30 {
        let params = ExpandParams { max_degree: Some(degree), prefix: false };
        let found = expand(&file.bytes, &params).unwrap().model.coefficients;
        assert_eq!(found.values(), whole.up_to(degree.min(24)));
    }
}

#[test]
fn signals_are_compressed_by_their_spread() {
    let mut model = model(16, 5, Kind::Signal, 3);
    let mut values = model.coefficients.values().clone();
    // The model has a signal in another unit, a constant signal, and a signal of zeros.
    values.column_mut(1).mapv_inplace(|value| 1e9 * value);
    values.column_mut(3).iter_mut().skip(1).for_each(|value| *value = 0.0);
    values.column_mut(4).fill(0.0);
    model.coefficients = Coefficients::new(values).unwrap();
    let file = compressed(&model, Target::Tolerance(1e-3));
    assert!((0.9e-3..=1e-3).contains(&file.distance), "{}", file.distance);
    let found = expand(&file.bytes, &WHOLE).unwrap().model;
    assert_eq!(found.kind(), Kind::Signal);
    for (channel, limit) in [(0, 0.02), (1, 2e7), (2, 0.02), (3, 0.1), (4, 0.0)] {
        let one = |model: &Coefficients| {
            let column = model.values().column(channel).to_vec();
            Coefficients::new(Array2::from_shape_vec((column.len(), 1), column).unwrap()).unwrap()
        };
        let found = error(&one(&model.coefficients), &one(&found.coefficients));
        assert!(found <= limit, "{channel} {found}");
    }
}

#[test]
fn models_of_next_to_nothing_come_back() {
    // A model with degree 0 alone is a point, which is valid as a signal but not as a surface.
    let point = model(0, 3, Kind::Surface, 1);
    assert!(matches!(
        compress(&point, &CompressParams::new(Target::Step(1e-3)), &Silent),
        Err(CodecError::Shape(ShapeError::NoExtent { .. }))
    ));
    let constant = model(0, 1, Kind::Signal, 1);
    let file = compressed(&constant, Target::Tolerance(1e-6));
    let found = expand(&file.bytes, &WHOLE).unwrap().model.coefficients;
    assert!((found.values()[[0, 0]] + 70.0).abs() < 1e-4);
    // The signal consists of zeros to a high degree. The format doesn't allow such a short file to declare that many
    // coefficients.
    let zeros = Coefficients::new(Array2::zeros((basis_size(1999), 2))).unwrap();
    let file = compressed(&Model::without_sphere(zeros, Kind::Signal), Target::Step(1.0));
    let found = expand(&file.bytes, &WHOLE).unwrap().model.coefficients;
    assert_eq!(found.max_degree(), file.max_degree);
    assert!(file.max_degree > 500 && file.max_degree < 1999, "{}", file.max_degree);
}

#[test]
fn what_cant_be_compressed_is_refused() {
    let mut broken = surface(2);
    let mut values = broken.coefficients.values().clone();
    values[[5, 1]] = f64::NAN;
    broken.coefficients = Coefficients::new(values).unwrap();
    let error = compress(&broken, &CompressParams::new(Target::Step(1e-3)), &Silent).unwrap_err();
    assert!(matches!(error, CodecError::Shape(ShapeError::NotFinite { row: 5, channel: 1, .. })), "{error}");
    let mut flat = surface(3);
    let mut values = flat.coefficients.values().clone();
    values.column_mut(1).assign(&flat.coefficients.values().column(0));
    flat.coefficients = Coefficients::new(values).unwrap();
    let error = compress(&flat, &CompressParams::new(Target::Step(1e-3)), &Silent).unwrap_err();
    assert!(matches!(error, CodecError::Flat), "{error}");
    for target in [Target::Tolerance(0.0), Target::Tolerance(f64::NAN), Target::Step(-1.0), Target::Bytes(0)] {
        let error = compress(&surface(2), &CompressParams::new(target), &Silent).unwrap_err();
        assert!(matches!(error, CodecError::Parameter { .. }), "{error}");
    }
    let error = compress(&surface(2), &CompressParams::new(Target::Step(1e-12)), &Silent).unwrap_err();
    assert!(matches!(error, CodecError::TooFine { .. }), "{error}");
}

#[test]
fn the_stated_smallest_size_holds_a_surface() {
    for (model, provenance) in [(surface(8), false), (surface(8), true), (model(8, 2, Kind::Signal, 4), false)] {
        let of_size = |bytes| {
            let params = CompressParams { provenance, ..CompressParams::new(Target::Bytes(bytes)) };
            compress(&model, &params, &Silent)
        };
        let Err(CodecError::TooFewBytes { least, of_which, wanted: 1 }) = of_size(1) else { panic!("{provenance}") };
        assert!(of_which <= least, "{of_which} {least}");
        let file = of_size(least).unwrap();
        assert!(file.bytes.len() <= least && file.distance.is_finite(), "{file:?}");
        for bytes in (least.saturating_sub(4)..least + 4).filter(|_| model.kind() == Kind::Surface) {
            match of_size(bytes) {
                Ok(file) => assert!(file.bytes.len() <= bytes && file.distance.is_finite(), "{bytes} {file:?}"),
                Err(CodecError::TooFewBytes { least: stated, .. }) => assert!(stated == least && bytes < least),
                Err(error) => panic!("{bytes}: {error}"),
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The error of expanded values is at most 0.62 of a step by quantisation, plus half a step by the reconstruction
    /// shifts.
    #[test]
    fn any_model_comes_back(degree in 1..9usize, channels in 1..5usize, seed: u64, log in -20.0..0.0f64) {
        let model = model(degree, channels, Kind::Signal, seed);
        let file = compressed(&model, Target::Step(f64::exp2(log)));
        let found = expand(&file.bytes, &WHOLE).unwrap().model;
        prop_assert_eq!(found.coefficients.max_degree(), degree);
        let step = &found.provenance.other["transform"][0]["compressed"]["step"];
        for channel in 0..channels {
            let step = step.get(channel).unwrap_or(step).as_f64().unwrap();
            let columns = [&model, &found].map(|model| model.coefficients.values().column(channel).to_vec());
            for (a, b) in columns[0].iter().zip(&columns[1]) {
                prop_assert!((a - b).abs() <= 1.13 * step, "{} {} {}", a, b, step);
            }
        }
    }
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/sphz-v1").join(name)
}

#[test]
fn golden_files_are_read_forever() {
    for (name, degrees) in [("surface", vec![3, 7, 15]), ("signal", vec![8])] {
        let bytes = std::fs::read(golden(&format!("{name}.sphz"))).unwrap();
        let expected = Model::read(golden(&format!("{name}.spharm.npz"))).unwrap();
        let found = expand(&bytes, &WHOLE).unwrap();
        assert_eq!(found.model, expected, "{name}");
        assert_eq!(found.levels.iter().map(|level| level.degree).collect::<Vec<_>>(), degrees);
    }
}
