//! Computes the differential geometry of a model exactly from its coefficients: tangents, normal, fundamental forms and
//! curvatures.
//!
//! Let X be the position at the direction u, [`L_k`](crate::derivatives) the derivatives under rotations, and (e1, e2)
//! an orthonormal tangent frame of the sphere with `e1 x e2 = u`, held fixed. Then
//!
//! ```text
//! X_1 = sum_k e2_k L_k X,    X_2 = -sum_k e1_k L_k X,    S_ij = (L_i L_j + L_j L_i) X / 2,
//! X_11 = e2' S e2,    X_22 = e1' S e1,    X_12 = -e2' S e1,    N = X_1 x X_2,    n = N / |N|
//! E, F, G = X_i . X_j,    e, f, g = n . X_ij
//! K = (e g - f^2) / (E G - F^2),    H = -(e G - 2 f F + g E) / (2 (E G - F^2))
//! ```
//!
//! (M. P. do Carmo, Differential Geometry of Curves and Surfaces (1976), section 3.3). |N| is the area element: area of
//! the surface per area of the sphere. H is the mean of the principal curvatures and positive on a sphere, whose normal
//! points outwards. There is no singularity at the poles, because no angles are used.
//!
//! The principal curvatures are computed from the second form, with entries a, b, c, in an orthonormal basis of the
//! tangent plane. The discriminant `((a - c) / 2)^2 + b^2` of this form is free of cancellation at umbilics, unlike
//! `H^2 - K`. If |N| is below [`SINGULAR`] times `|X_1|^2 + |X_2|^2`, the surface has no tangent plane, and the normal,
//! the second form and the curvatures are set to 0.
//!
//! Cost: ten syntheses of three columns. The number of directions evaluated at a time is limited to between 2^18 and
//! 2^21, depending on the degree. The workspace takes 240 bytes for each of these directions. The result takes 168
//! bytes per direction.

use ndarray::{Array2, Axis, Slice};
use rayon::prelude::*;
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::{Monitor, Stage};
use spharm_surface::geometry::{Vec3, add, cross, dot, scale};
use spharm_transform::synthesis;
use std::f64::consts::FRAC_2_PI;

use crate::derivatives::rotational_derivatives;
use crate::error::ShapeError;
use crate::extent::extent;

/// A point is singular if its area element is at most this fraction of `|X_1|^2 + |X_2|^2`, with the tangents X_1 and
/// X_2.
pub const SINGULAR: f64 = 1e-12;

/// Indices (i, j) of the six second derivatives S_ij, in the order of their columns.
const PAIRS: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];

/// Geometry of a surface at one direction, with lengths in the surface's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalGeometry {
    /// Position X of the surface's point.
    pub position: Vec3,
    /// Tangents `X_1` and `X_2`: the derivatives of the position along the two vectors of the [frame](tangent_frame).
    pub tangents: [Vec3; 2],
    /// Unit normal, outwards if the triangles of the sphere are counter-clockwise; 0 at singular points.
    pub normal: Vec3,
    /// Area element |N|: area of the surface per area of the sphere.
    pub area_element: f64,
    /// Coefficients E, F, G of the first fundamental form.
    pub first_form: [f64; 3],
    /// Coefficients e, f, g of the second fundamental form with respect to `normal`; e and g are negative on a sphere.
    pub second_form: [f64; 3],
    /// Principal curvatures, the larger one first, in 1 / length; positive on a sphere.
    pub principal: [f64; 2],
}

impl LocalGeometry {
    /// Computes the geometry from the position, the first derivatives along the frame, and the second derivatives
    /// `X_11`, `X_12` and `X_22`.
    fn new(position: Vec3, tangents: [Vec3; 2], second: [Vec3; 3]) -> Self {
        let [x1, x2] = tangents;
        let first_form = [dot(x1, x1), dot(x1, x2), dot(x2, x2)];
        let n = cross(x1, x2);
        let area_element = dot(n, n).sqrt();
        if area_element <= SINGULAR * (first_form[0] + first_form[2]) {
            let (normal, second_form, principal) = ([0.0; 3], [0.0; 3], [0.0; 2]);
            return Self { position, tangents, normal, area_element, first_form, second_form, principal };
        }
        let normal = scale(n, 1.0 / area_element);
        let second_form = second.map(|derivative| dot(normal, derivative));
        // Entries a, b, c of the second form in the orthonormal basis t1 = X_1 / sqrt E, t2 = (X_2 - F/E X_1) / r,
        // where r normalises t2.
        let [e, f, g] = second_form;
        let length = first_form[0].sqrt();
        let (slope, r) = (first_form[1] / first_form[0], area_element / length);
        let a = e / first_form[0];
        let b = (f - slope * e) / (length * r);
        let c = (g - 2.0 * slope * f + slope * slope * e) / (r * r);
        let (mean, radius) = (-0.5 * (a + c), (0.5 * (a - c)).hypot(b));
        let principal = [mean + radius, mean - radius];
        Self { position, tangents, normal, area_element, first_form, second_form, principal }
    }

    /// Returns the Gaussian curvature K, in 1 / length^2.
    #[must_use]
    pub fn gaussian_curvature(&self) -> f64 {
        self.principal[0] * self.principal[1]
    }

    /// Returns the mean curvature H, in 1 / length; positive on a sphere.
    #[must_use]
    pub fn mean_curvature(&self) -> f64 {
        0.5 * (self.principal[0] + self.principal[1])
    }

    /// Returns the shape index, from -1 (cup) through 0 (saddle) to 1 (cap, as on a sphere); 0 for a flat point.
    ///
    /// The index is `2/pi atan((k1 + k2) / (k1 - k2))` (J. J. Koenderink and A. J. van Doorn, Image Vis. Comput. 10
    /// (1992)), with this module's sign of curvatures.
    #[must_use]
    pub fn shape_index(&self) -> f64 {
        let [k1, k2] = self.principal;
        FRAC_2_PI * (k1 + k2).atan2(k1 - k2)
    }

    /// Returns the curvedness `sqrt((k1^2 + k2^2) / 2)`, in 1 / length.
    #[must_use]
    pub fn curvedness(&self) -> f64 {
        self.principal[0].hypot(self.principal[1]) * std::f64::consts::FRAC_1_SQRT_2
    }

    /// Returns whether the point has no tangent plane.
    #[must_use]
    pub fn is_singular(&self) -> bool {
        self.normal == [0.0; 3]
    }

    /// Returns the geometry with the normal reversed, which changes the signs of the principal curvatures and of the
    /// mean curvature, but not of the Gaussian curvature. Intended for models over a mirrored sphere, whose normals
    /// point inwards.
    #[must_use]
    pub fn flipped(&self) -> Self {
        let [k1, k2] = self.principal;
        Self {
            normal: self.normal.map(|x| -x),
            second_form: self.second_form.map(|x| -x),
            principal: [-k2, -k1],
            ..*self
        }
    }
}

/// Returns an orthonormal tangent frame (e1, e2) of the sphere at the unit vector u, with `e1 x e2 = u`.
///
/// The method of T. Duff et al., "Building an orthonormal basis, revisited", JCGT 6 (2017), needs no case distinction
/// and is accurate everywhere. The frame is discontinuous at the equator; no result here depends on its continuity.
#[must_use]
pub fn tangent_frame(u: Vec3) -> [Vec3; 2] {
    let [x, y, z] = u;
    let sign = 1f64.copysign(z);
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    [[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]]
}

/// Computes the geometry of the surface with the canonical coefficients `coefficients` (K, 3) at each of the
/// directions.
///
/// Runs on the current rayon pool; the result is bitwise the same on any number of threads.
///
/// # Errors
///
/// The errors of [`extent`]; [`ShapeError::Transform`] if the transform fails; [`ShapeError::Interrupted`] if the
/// monitor cancels.
pub fn local_geometry(
    coefficients: &Coefficients,
    directions: &Directions,
    monitor: &dyn Monitor,
) -> Result<Vec<LocalGeometry>, ShapeError> {
    extent(coefficients)?;
    let values = coefficients.values().view();
    let first = rotational_derivatives(values)?;
    let mut columns = vec![values.to_owned()];
    columns.extend(first.iter().cloned());
    let second = [0, 1, 2].map(|j| rotational_derivatives(first[j].view()));
    // Element `second[j][i]` is L_i L_j X.
    let [x, y, z] = second;
    let second = [x?, y?, z?];
    columns.extend(PAIRS.map(|[i, j]| (&second[j][i] + &second[i][j]) * 0.5));
    let columns = side_by_side(&columns);
    let mut found = Vec::with_capacity(directions.len());
    let run = run_length(coefficients.max_degree());
    monitor.begin(Stage::counted("geometry", "directions"), directions.len() as u64);
    for run in directions.as_slice().chunks(run) {
        monitor.check()?;
        let samples = synthesis(&Directions::from_unit_vectors(run.to_vec())?, columns.view())?;
        let rows = samples.axis_iter(Axis(0)).into_par_iter().zip(run);
        found.par_extend(rows.map(|(row, &u)| {
            let vector = |k: usize| -> Vec3 { std::array::from_fn(|c| row[3 * k + c]) };
            at(u, vector)
        }));
        monitor.step(run.len() as u64);
    }
    monitor.end();
    Ok(found)
}

/// Computes the geometry at the direction `u` from ten vectors (see the [module](self)): `vector` returns the position
/// X for 0, the derivatives `L_k X` for 1 to 3, and the six second derivatives `S_ij` for 4 to 9.
fn at(u: Vec3, vector: impl Fn(usize) -> Vec3) -> LocalGeometry {
    let [e1, e2] = tangent_frame(u);
    let sum = |weights: [f64; 3]| {
        let terms = [0, 1, 2].map(|k| scale(vector(1 + k), weights[k]));
        add(add(terms[0], terms[1]), terms[2])
    };
    let tangents = [sum(e2), sum(e1.map(|x| -x))];
    // Returns a' S b, computed from the six columns of the symmetric matrix S.
    let form = |a: Vec3, b: Vec3| {
        PAIRS.iter().enumerate().fold([0.0; 3], |total, (column, &[i, j])| {
            let weight = if i == j { a[i] * b[i] } else { a[i] * b[j] + a[j] * b[i] };
            add(total, scale(vector(4 + column), weight))
        })
    };
    let second = [form(e2, e2), scale(form(e2, e1), -1.0), form(e1, e1)];
    LocalGeometry::new(vector(0), tangents, second)
}

/// Concatenates the columns of arrays with equal numbers of rows.
pub(crate) fn side_by_side(arrays: &[Array2<f64>]) -> Array2<f64> {
    let width: usize = arrays.iter().map(Array2::ncols).sum();
    let rows = arrays.first().map_or(0, Array2::nrows);
    let mut joined = Array2::zeros((rows, width));
    let mut column = 0;
    for array in arrays {
        joined.slice_axis_mut(Axis(1), Slice::from(column..column + array.ncols())).assign(array);
        column += array.ncols();
    }
    joined
}

/// Returns the number of directions to evaluate together. The number is small enough to bound the memory, but so large
/// that planning the transform, whose cost depends only on the degree, doesn't dominate the time.
pub(crate) fn run_length(max_degree: usize) -> usize {
    (max_degree * max_degree).clamp(1 << 18, 1 << 21)
}
