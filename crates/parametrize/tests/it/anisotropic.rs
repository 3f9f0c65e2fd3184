//! Tests that quadrangles get areas equal in mm^2, so the map doesn't depend on the direction in which voxels are
//! longest.

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_parametrize::volume::{Affine, LabelSurface, LabelVolume, VolumeParams, VolumeSurface};
use spharm_parametrize::{EqualAreaParams, Parametrization, area_deviation, equal_area};
use spharm_solver::MatrixFreeOperator;
use spharm_solver::lsq::NormalEquations;
use spharm_solver::lsq::cg::{self, CgParams};
use spharm_transform::TransformParams;

/// Returns the surface of an ellipsoid with semi-axes 2, 1 and 1 mm, the longest along `axis`, in voxels of a given
/// size.
fn ellipsoid(axis: usize, voxel: [f64; 3]) -> VolumeSurface {
    let size = voxel.map(|h| (2.0 * 2.2 / h).ceil() as usize);
    let inside = |index: usize| {
        let at = [index % size[0], index / size[0] % size[1], index / (size[0] * size[1])];
        let sum: f64 = (0..3)
            .map(|k| {
                let mm = (at[k] as f64 + 0.5 - size[k] as f64 / 2.0) * voxel[k];
                (mm / if k == axis { 2.0 } else { 1.0 }).powi(2)
            })
            .sum();
        sum < 1.0
    };
    let row = |k: usize| std::array::from_fn(|j| if j == k { voxel[k] } else { 0.0 });
    let values = (0..size.iter().product()).map(|i| i32::from(inside(i))).collect();
    let volume = LabelVolume::new(size, values, Affine([row(0), row(1), row(2)]));
    let params = VolumeParams { surface: LabelSurface::Voxels, ..VolumeParams::default() };
    volume.surface(&params, &Silent).unwrap()
}

fn map(found: &VolumeSurface) -> Parametrization {
    let map = equal_area(&found.quads, &EqualAreaParams::default(), &Silent).unwrap();
    assert!(map.report.converged && map.quality().is_bijective(), "{:?}", map.report);
    assert!(area_deviation(&found.quads, &map.sphere.vertices) < 5e-3, "{:?}", map.report);
    map
}

/// Returns the energy of a model of degree 8 in each of the degrees 1 to 4.
fn energy(map: &Parametrization) -> [f64; 4] {
    let directions = Directions::from_vertices(&map.sphere.vertices).unwrap();
    let transform = TransformParams { max_degree: 8, ..TransformParams::default() };
    let operator = MatrixFreeOperator::new(&directions, &transform).unwrap();
    let vertices = &map.surface.vertices;
    let targets = Array2::from_shape_fn((vertices.len(), 3), |(v, k)| vertices[v][k]);
    let equations = NormalEquations { operator: &operator, weights: None, penalty: None };
    let fit = cg::solve(&equations, &targets, &equations.diagonal(), &CgParams::default(), &Silent).unwrap();
    let of = |l: usize| (l * l..(l + 1) * (l + 1)).map(|k| fit.solution.row(k).iter().map(|c| c * c).sum::<f64>());
    [1, 2, 3, 4].map(|l| of(l).sum())
}

#[test]
fn areas_are_equal_in_mm2() {
    for voxel in [[0.1, 0.1, 0.3], [0.3, 0.1, 0.1], [0.12, 0.2, 0.32]] {
        let map = map(&ellipsoid(0, voxel));
        // The two triangles of a quadrangle differ slightly in area. If voxel sizes were ignored, the value would be
        // 0.5.
        assert!(map.quality().area_rms < 0.15, "{voxel:?}: {:?}", map.quality());
    }
}

#[test]
fn an_ellipsoid_has_the_same_energies_along_every_axis() {
    let along = |axis| energy(&map(&ellipsoid(axis, [0.1, 0.1, 0.3])));
    let fine = energy(&map(&ellipsoid(0, [0.1; 3])));
    let (x, y, z) = (along(0), along(1), along(2));
    for other in [x, y, z] {
        assert!((other[0] / fine[0] - 1.0).abs() < 0.02, "{other:?} {fine:?}");
        assert!((other[2] - fine[2]).abs() < 0.01 * fine[0], "{other:?} {fine:?}");
    }
}

#[test]
fn the_size_of_cubes_changes_nothing() {
    let [one, other] = [1.0, 0.7].map(|h| {
        let values = ellipsoid(1, [0.2; 3]).quads;
        let scaled = values.vertices.iter().map(|v| v.map(|x| x * h)).collect();
        let mut quads = values;
        quads.vertices = scaled;
        equal_area(&quads, &EqualAreaParams::default(), &Silent).unwrap().sphere.vertices
    });
    assert!(one == other, "the same bits");
}
