//! Tests that surfaces in volumes of grey values and probabilities are those of the bodies that the values describe.

use std::f64::consts::PI;

use spharm_monitor::Silent;
use spharm_parametrize::ParametrizeError;
use spharm_parametrize::volume::{
    Affine, LabelSurface, LabelVolume, VolumeParams, VolumeReading, VolumeSurface, VoxelValues,
};
use spharm_surface::topology::{area, signed_volume};

const SIZE: [usize; 3] = [17, 18, 19];
/// The centre of the bodies, which isn't at a special position between voxels.
const CENTRE: [f64; 3] = [8.3, 8.6, 9.1];

/// Returns the values of a function at all voxels, with x varying fastest.
fn values(of: impl Fn([f64; 3]) -> f64) -> Vec<f64> {
    let [nx, ny, nz] = SIZE;
    (0..nx * ny * nz).map(|i| of([i % nx, i / nx % ny, i / (nx * ny)].map(|x| x as f64))).collect()
}

fn distance(at: [f64; 3], centre: [f64; 3]) -> f64 {
    (0..3).map(|k| (at[k] - centre[k]).powi(2)).sum::<f64>().sqrt()
}

/// Returns the share of each voxel in a ball, from 8 x 8 x 8 samples.
fn shares(radius: f64) -> Vec<f64> {
    let offset = |i: usize| (i as f64 + 0.5) / 8.0 - 0.5;
    values(|[x, y, z]| {
        let inside = (0..512)
            .filter(|i| distance([x + offset(i % 8), y + offset(i / 8 % 8), z + offset(i / 64)], CENTRE) < radius);
        inside.count() as f64 / 512.0
    })
}

fn volume_of(values: &[f64], meaning: VoxelValues) -> Result<LabelVolume, ParametrizeError> {
    LabelVolume::of_values(SIZE, values, meaning, Affine::of_voxel_size([1.0; 3]))
}

fn surface(volume: &LabelVolume, params: &VolumeParams) -> VolumeSurface {
    volume.surface(params, &Silent).unwrap()
}

/// Returns the relative errors of a surface's area and volume, compared with a ball.
fn errors(surface: &VolumeSurface, radius: f64) -> [f64; 2] {
    let mesh = surface.quads.triangles(|_| false);
    let volume = 4.0 / 3.0 * PI * radius.powi(3);
    [area(&mesh) / (4.0 * PI * radius * radius) - 1.0, signed_volume(&mesh) / volume - 1.0]
}

#[test]
fn shares_of_voxels_give_area_and_volume_of_the_body() {
    for radius in [3.0, 4.2, 6.5] {
        let shares = shares(radius);
        let found = surface(&volume_of(&shares, VoxelValues::Probability).unwrap(), &VolumeParams::default());
        let [area, volume] = errors(&found, radius);
        assert!(volume.abs() < 2e-3 && area.abs() < 0.015, "{radius}: area {area}, volume {volume}");
        // Interpolation finds a ball whose radius is too small by a share of about 1 / (6 r^2): half of this comes
        // from the sampling by voxels, half from the interpolation.
        let [_, volume] =
            errors(&surface(&volume_of(&shares, VoxelValues::Level(0.5)).unwrap(), &VolumeParams::default()), radius);
        assert!(volume < -0.002 && volume > -0.9 / (radius * radius), "{radius}: volume {volume}");
    }
}

#[test]
fn a_level_is_where_interpolation_reaches_it() {
    // Along a line that doesn't pass through the centre, the distance from the centre is convex. Linear interpolation
    // therefore overestimates it, and underestimates the radius in proportion to the radius's inverse.
    for (level, radius) in [(0.0, 6.0), (-1.3, 7.3), (2.5, 3.5)] {
        for (scale, shift) in [(1.0, 0.0), (40.0, 1000.0)] {
            let values = values(|at| scale * (6.0 - distance(at, CENTRE)) + shift);
            let volume = volume_of(&values, VoxelValues::Level(scale * level + shift)).unwrap();
            let [area, volume] = errors(&surface(&volume, &VolumeParams::default()), radius);
            assert!(
                volume.abs() < 0.25 / (radius * radius) && area.abs() < 0.01,
                "{level}, {scale}: area {area}, volume {volume}"
            );
        }
    }
}

#[test]
fn a_repair_keeps_the_largest_body_and_its_volume() {
    let far = [2.5, 2.5, 2.5];
    let two = values(|at| (4.0 - distance(at, CENTRE)).max(1.6 - distance(at, far)));
    let volume = volume_of(&two, VoxelValues::Level(0.0)).unwrap();
    let refused = volume.surface(&VolumeParams::default(), &Silent).unwrap_err().to_string();
    assert!(refused.contains("2 pieces"), "{refused}");
    let found = surface(&volume, &VolumeParams { fix: true, ..VolumeParams::default() });
    let [area, volume] = errors(&found, 4.0);
    assert!(found.repair.is_some() && volume.abs() < 0.01 && area.abs() < 0.01, "{area} {volume}");
}

#[test]
fn values_of_files_are_those_of_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grey.npy");
    let grey = values(|[x, y, z]| {
        let inside = 5.0 - distance([x, 1.1 * y, z], [8.3, 9.0, 9.1]);
        if inside < -3.0 { f64::NAN } else { inside }
    });
    let in_memory = surface(&volume_of(&grey, VoxelValues::Level(0.1)).unwrap(), &VolumeParams::default());
    assert!(in_memory.quads.vertices.len() > 100);
    let reading =
        VolumeReading { voxel_size: Some([1.0; 3]), values: VoxelValues::Level(0.1), ..VolumeReading::default() };
    let [nx, ny, nz] = SIZE;
    let in_c_order = (0..grey.len()).map(|i| grey[i / (ny * nz) + nx * (i / nz % ny + ny * (i % nz))]);
    for (fortran, stored) in [("True", grey.clone()), ("False", in_c_order.collect())] {
        let header = format!("{{'descr': '<f8', 'fortran_order': {fortran}, 'shape': ({nx}, {ny}, {nz}), }}\n");
        let numbers: Vec<u8> = stored.iter().flat_map(|x| x.to_le_bytes()).collect();
        let head = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
        std::fs::write(&path, [head, numbers].concat()).unwrap();
        let found = surface(&LabelVolume::read_with(&path, reading, &Silent).unwrap(), &VolumeParams::default());
        assert_eq!(found.quads, in_memory.quads, "{fortran}");
        let error = LabelVolume::read(&path, &Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::NotLabels { .. } | ParametrizeError::NoVoxelSize { .. }), "{error}");
    }
}

#[test]
fn unusable_values_are_refused() {
    let refused = |values: &[f64], meaning| volume_of(values, meaning).unwrap_err().to_string();
    let grey = values(|at| 5.0 - distance(at, CENTRE));
    assert!(refused(&grey, VoxelValues::Probability).contains("probabilities from 0 to 1, found -"), "range");
    let high = refused(&grey, VoxelValues::Level(9.0));
    assert!(
        high.contains("values both below and above the threshold, found values from -")
            && high.ends_with("threshold 9"),
        "{high}"
    );
    assert!(refused(&grey, VoxelValues::Level(-99.0)).ends_with("all at or above the threshold -99"), "low");
    assert!(refused(&vec![f64::NAN; grey.len()], VoxelValues::Level(0.0)).contains("found no values"), "NaN");
    assert!(refused(&grey, VoxelValues::Level(f64::NAN)).contains("threshold: expected a number"), "level");
    for (name, radius) in [("round", None), ("voxels", Some(1.0)), ("smooth", Some(0.2)), ("smooth", Some(4.5))] {
        assert!(matches!(LabelSurface::named(name, radius), Err(ParametrizeError::Argument { .. })), "{name}");
    }
}

#[test]
fn a_larger_radius_removes_shifts_between_slices() {
    // A ball outlined slice by slice, each slice shifted by up to a voxel.
    let shift = [0.8, -0.9, 0.3, -0.6, 1.0, -0.2, -1.0, 0.5];
    let labels = values(|[x, y, z]| {
        f64::from(u8::from(distance([x + shift[z as usize % 8], y - shift[(z as usize + 3) % 8], z], CENTRE) < 6.0))
    });
    let labels = labels.iter().map(|&x| x as i32).collect();
    let volume = LabelVolume::new(SIZE, labels, Affine::of_voxel_size([1.0; 3]));
    let of = |radius| {
        let params =
            VolumeParams { surface: LabelSurface::named("smooth", radius).unwrap(), ..VolumeParams::default() };
        errors(&surface(&volume, &params), 6.0)
    };
    let ([narrow, volume], [wide, same]) = (of(None), of(Some(1.5)));
    assert!(narrow > 0.03 && wide.abs() < 0.015, "areas {narrow} {wide}");
    assert!((volume - same).abs() < 1e-3, "volumes {volume} {same}");
}
