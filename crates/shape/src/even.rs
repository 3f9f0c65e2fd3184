//! Relocates directions so that a surface's vertices are spread evenly over its area.
//!
//! An icosphere's vertices are spread evenly on the sphere. Mapped to the surface, they are sparse in regions with a
//! large area element `|N|` ([`geometry`](crate::geometry)). J. Moser's flow ("On the volume elements on a manifold",
//! Trans. Amer. Math. Soc. 120 (1965); B. Dacorogna and J. Moser, Ann. Inst. H. Poincare Anal. Non Lineaire 7 (1990))
//! transports the uniform density 1 to the density `rho = |N| / mean(|N|)`, without a search:
//!
//! ```text
//! laplacian(psi) = rho - 1,    rho_t = 1 + t (rho - 1),    u' = -grad psi(u) / rho_t(u),    t from 0 to 1
//! ```
//!
//! This velocity satisfies the continuity equation, `d rho_t / dt + div(rho_t u') = 0`. In harmonics, `psi_l = -rho_l /
//! (l (l + 1))` and `-grad psi = u x L psi`, so a step needs only a synthesis. For a surface of degree L, the density
//! is expanded to degree 2L or 16, whichever is higher, but no further than the mesh can resolve. A heat kernel smooths
//! the density and damps its highest degree to 5 %, so that truncation causes no ripples. The density is kept above
//! [`LEAST_DENSITY`]. The flow is integrated by fourth-order Runge-Kutta steps.
//!
//! Cost: four syntheses of four functions per step at n directions, and the analysis of |N| on a grid with four times
//! as many rings as the density's degree.

use ndarray::Array2;
use rayon::prelude::*;
use spharm_harmonics::index::{basis_size, degree_order};
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::{Monitor, Stage};
use spharm_surface::geometry::{Vec3, add, cross, dot, face_normal, orientation, scale, unit};
use spharm_surface::{Mesh, Sphere};
use spharm_transform::{Transform, TransformParams, synthesis};

use crate::derivatives::rotational_derivatives;
use crate::error::ShapeError;
use crate::extent::extent;
use crate::geometry::side_by_side;
use crate::heat::HeatKernel;
use crate::measures::{Columns, Grid};

/// Minimum density of the directions, relative to the mean density.
pub const LEAST_DENSITY: f64 = 0.02;
/// Value of `name` in the [`ShapeError::Setting`] that is returned for a sphere without triangles.
pub const NO_TRIANGLES: &str = "the number of triangles of the sphere";
/// Factor by which the heat kernel damps the density's highest degree.
const LEFT: f64 = 0.05;

/// A sphere whose directions were relocated.
#[derive(Debug, Clone, PartialEq)]
pub struct EvenSphere {
    /// The relocated directions, with the triangles of the input sphere.
    pub sphere: Sphere,
    /// Standard deviation of the surface's triangle areas divided by their mean, before the relocation.
    pub before: f64,
    /// Standard deviation of the surface's triangle areas divided by their mean, after the relocation.
    pub after: f64,
    /// Number of triangles that the relocation inverted. The surface is folded there. The number is 0 unless the mesh
    /// is too coarse for the variation of the area element.
    pub folded: usize,
}

/// Relocates the directions of a sphere so that the surface with the canonical coefficients `coefficients` (K, 3) has
/// triangles of about equal area.
///
/// `steps` is the number of steps of the flow; 16 steps are more than enough.
///
/// # Errors
///
/// The errors of [`extent`]; [`ShapeError::Setting`] if the sphere has no triangles or `steps` is 0;
/// [`ShapeError::Transform`] if the transform fails; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn even_sphere(
    coefficients: &Coefficients,
    sphere: &Sphere,
    steps: usize,
    monitor: &dyn Monitor,
) -> Result<EvenSphere, ShapeError> {
    extent(coefficients)?;
    if sphere.faces.is_empty() || steps == 0 {
        let name = if steps == 0 { "the number of steps" } else { NO_TRIANGLES };
        return Err(ShapeError::Setting { name, expected: "it must be at least 1", found: "0".to_owned() });
    }
    let flow = Flow::new(coefficients, sphere.directions.len(), monitor)?;
    let mut at = sphere.directions.as_slice().to_vec();
    monitor.begin(Stage::counted("relocation", "steps"), steps as u64);
    let step = 1.0 / steps as f64;
    for k in 0..steps {
        monitor.check()?;
        at = flow.step(&at, k as f64 * step, step)?;
        monitor.step(1);
    }
    monitor.end();
    let folded = sphere.faces.iter().filter(|face| orientation(face.map(|v| at[v as usize])) <= 0.0).count();
    let directions = Directions::from_vertices(&at)?;
    let spread = |directions: &Directions| -> Result<f64, ShapeError> {
        let samples = synthesis(directions, coefficients.values().view())?;
        let vertices = samples.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
        Ok(area_spread(&Mesh::new(vertices, sphere.faces.clone())))
    };
    let (before, after) = (spread(&sphere.directions)?, spread(&directions)?);
    let anatomical_structure = sphere.anatomical_structure.clone();
    let sphere = Sphere { faces: sphere.faces.clone(), anatomical_structure, ..Sphere::from_directions(directions) };
    Ok(EvenSphere { sphere, before, after, folded })
}

/// Returns the standard deviation of the areas of a mesh's triangles, divided by their mean; 0 for a mesh without area.
#[must_use]
pub fn area_spread(mesh: &Mesh) -> f64 {
    let area = |face: &[u32; 3]| {
        let normal = face_normal(face.map(|v| mesh.vertices[v as usize]));
        0.5 * dot(normal, normal).sqrt()
    };
    let areas: Vec<f64> = mesh.faces.iter().map(area).collect();
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    let variance = areas.iter().map(|area| (area - mean) * (area - mean)).sum::<f64>() / areas.len() as f64;
    if mean > 0.0 { variance.sqrt() / mean } else { 0.0 }
}

/// Coefficients of the density rho and of the three derivatives `L_k psi` of its potential (see the module), side by
/// side.
struct Flow(Array2<f64>);

impl Flow {
    fn new(coefficients: &Coefficients, vertices: usize, monitor: &dyn Monitor) -> Result<Self, ShapeError> {
        // Harmonics of degree B have about B^2 extrema, and a mesh of n vertices resolves about n / 4 extrema.
        let resolved = ((vertices as f64).sqrt() / 2.0) as usize;
        let degree = (2 * coefficients.max_degree()).max(16).min(resolved.max(2));
        let mut density = analysis(coefficients, degree, monitor)?;
        let mean = density[[0, 0]];
        let highest = (degree * (degree + 1)) as f64;
        let heat = HeatKernel::after(-LEFT.ln() / highest)?;
        let scale = (4.0 * std::f64::consts::PI).sqrt() / mean;
        let mut potential = Array2::zeros(density.raw_dim());
        for (row, value) in density.column_mut(0).iter_mut().enumerate() {
            let l = degree_order(row).0;
            *value *= scale * heat.factor(l);
            potential[[row, 0]] = if l == 0 { 0.0 } else { -*value / (l * (l + 1)) as f64 };
        }
        let [x, y, z] = rotational_derivatives(potential.view())?;
        Ok(Self(side_by_side(&[density, x, y, z])))
    }

    /// Returns the velocity `-grad psi / rho_t` at the directions `at`, which needn't be of unit length, at time t.
    fn velocity(&self, at: &[Vec3], t: f64) -> Result<Vec<Vec3>, ShapeError> {
        let directions = Directions::from_vertices(at)?;
        let samples = synthesis(&directions, self.0.view())?;
        let rows = samples.axis_iter(ndarray::Axis(0)).into_par_iter().zip(directions.as_slice());
        Ok(rows
            .map(|(row, &u)| {
                let density = 1.0 + t * (row[0].max(LEAST_DENSITY) - 1.0);
                scale(cross(u, [row[1], row[2], row[3]]), 1.0 / density)
            })
            .collect())
    }

    fn step(&self, at: &[Vec3], t: f64, h: f64) -> Result<Vec<Vec3>, ShapeError> {
        let along = |velocity: &[Vec3], h: f64| -> Vec<Vec3> {
            at.iter().zip(velocity).map(|(u, v)| add(*u, scale(*v, h))).collect()
        };
        let k1 = self.velocity(at, t)?;
        let k2 = self.velocity(&along(&k1, 0.5 * h), t + 0.5 * h)?;
        let k3 = self.velocity(&along(&k2, 0.5 * h), t + 0.5 * h)?;
        let k4 = self.velocity(&along(&k3, h), t + h)?;
        let sum = |i: usize| add(add(k1[i], k4[i]), scale(add(k2[i], k3[i]), 2.0));
        Ok(at.iter().enumerate().map(|(i, u)| unit(add(*u, scale(sum(i), h / 6.0)))).collect())
    }
}

/// Returns the coefficients (K, 1) of the area element |N| up to a degree, computed on a grid with four times as many
/// rings as the degree.
fn analysis(coefficients: &Coefficients, degree: usize, monitor: &dyn Monitor) -> Result<Array2<f64>, ShapeError> {
    let grid = Grid::new(4 * degree.max(4));
    let columns = Columns::new(coefficients)?;
    let mut density = Array2::zeros((basis_size(degree), 1));
    for run in grid.runs(coefficients.max_degree()) {
        monitor.check()?;
        let directions = grid.directions(run.clone());
        let points = columns.at(directions.clone())?;
        let weights = run.flat_map(|ring| std::iter::repeat_n(grid.weight(ring), grid.around()));
        let samples: Vec<f64> = points.iter().zip(weights).map(|([_, n], w)| w * dot(*n, *n).sqrt()).collect();
        let samples = Array2::from_shape_fn((samples.len(), 1), |(i, _)| samples[i]);
        let params = TransformParams { max_degree: degree, channels: 1, ..TransformParams::default() };
        let transform = Transform::new(&Directions::from_unit_vectors(directions)?, &params)?;
        density += &transform.adjoint_synthesis(samples.view())?;
    }
    Ok(density)
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;

    /// Returns a bent ellipsoid with semi-axes in the ratio 4 : 1 : 1.
    fn banana() -> Coefficients {
        let mut values = Array2::zeros((9, 3));
        (values[[3, 0]], values[[1, 1]], values[[2, 2]], values[[8, 2]]) = (8.0, 2.0, 2.0, 1.0);
        Coefficients::new(values).unwrap()
    }

    #[test]
    fn triangles_of_a_long_surface_become_even() {
        let sphere = Sphere::icosphere(4);
        let plain = Mesh::new(sphere.directions.as_slice().to_vec(), sphere.faces.clone());
        let found = even_sphere(&banana(), &sphere, 16, &Silent).unwrap();
        assert_eq!(found.folded, 0);
        // The triangle areas of the icosphere itself have the spread `own`, which the flow preserves.
        let (before, after, own) = (found.before, found.after, area_spread(&plain));
        assert!(before > 0.3 && after < 1.2 * own, "{before} {after} {own}");
        assert_eq!(found.sphere.faces, sphere.faces);
    }

    #[test]
    fn an_even_surface_stays_as_it_is() {
        let mut values = Array2::zeros((4, 3));
        (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (2.0, 2.0, 2.0);
        let ball = Coefficients::new(values).unwrap();
        let sphere = Sphere::icosphere(2);
        let found = even_sphere(&ball, &sphere, 4, &Silent).unwrap();
        for (a, b) in found.sphere.directions.as_slice().iter().zip(sphere.directions.as_slice()) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-11));
        }
    }

    #[test]
    fn what_cannot_be_relocated_is_refused() {
        let points = Sphere::from_directions(Sphere::icosphere(1).directions);
        assert!(matches!(even_sphere(&banana(), &points, 4, &Silent), Err(ShapeError::Setting { .. })));
        assert!(matches!(even_sphere(&banana(), &Sphere::icosphere(1), 0, &Silent), Err(ShapeError::Setting { .. })));
        let stop = std::sync::atomic::AtomicBool::new(true);
        assert!(matches!(even_sphere(&banana(), &Sphere::icosphere(1), 4, &stop), Err(ShapeError::Interrupted(_))));
    }
}
