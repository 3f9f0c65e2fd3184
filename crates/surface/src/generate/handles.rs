//! Generates surfaces with handles: tori and a double torus.

use std::collections::HashMap;
use std::f64::consts::TAU;

use crate::geometry::{Vec3, add, dot, scale};
use crate::mesh::Mesh;

/// A torus about the z axis, with bumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torus {
    /// Distance of the tube's centre line from the z axis.
    pub ring: f64,
    /// Radius of the tube, below `ring`.
    pub tube: f64,
    /// Height of the bumps, relative to the tube's radius.
    pub bumps: f64,
    /// Number of vertices around the tube, at least 3. Around the ring, vertices have the same spacing, measured on the
    /// circle of radius `ring`.
    pub around: u32,
}

impl Default for Torus {
    fn default() -> Self {
        Self { ring: 2.0, tube: 1.0, bumps: 0.0, around: 40 }
    }
}

/// Returns a torus: one closed surface of genus 1, wound outwards.
///
/// # Panics
///
/// Panics if `around` is below 3, or `tube` isn't between 0 and `ring`.
#[must_use]
pub fn torus(parameters: &Torus) -> Mesh {
    let Torus { ring, tube, bumps, around } = *parameters;
    assert!(around >= 3 && tube > 0.0 && tube < ring, "{parameters:?}");
    let along = ((f64::from(around) * ring / tube).round() as u32).max(3);
    let mut mesh = Mesh::default();
    for i in 0..along {
        let u = TAU * f64::from(i) / f64::from(along);
        for j in 0..around {
            let v = TAU * f64::from(j) / f64::from(around);
            let r = tube * (1.0 + bumps * (5.0 * u).cos() * (3.0 * v).sin());
            let out = ring + r * v.cos();
            mesh.vertices.push([out * u.cos(), out * u.sin(), r * v.sin()]);
        }
    }
    let at = |i: u32, j: u32| (i % along) * around + j % around;
    for i in 0..along {
        for j in 0..around {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            // The quadrangles' diagonals alternate in direction, so that no direction is preferred.
            mesh.faces.extend(if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
        }
    }
    mesh
}

/// Returns a smooth surface of genus 2 and length 2.2, wound outwards: ((x^2 + y^2)^2 - x^2 + y^2)^2 + z^2 = 0.02.
///
/// `cells` is the number of grid cells along x from -1.2 to 1.2, at least 32. Each cell that the surface passes through
/// gets a vertex, which is then moved onto the surface (surface nets, S. Gibson, MICCAI 1998).
///
/// # Panics
///
/// Panics if `cells` is below 32.
#[must_use]
pub fn double_torus(cells: u32) -> Mesh {
    assert!(cells >= 32, "expected at least 32 cells for a double torus, found {cells}");
    const LEVEL: f64 = 0.02;
    let step = 2.4 / f64::from(cells);
    // The grid is placed such that the flat part of the surface between the holes lies midway between grid points, so
    // that no cell is ambiguous.
    let thickness = 2.0 * LEVEL.sqrt();
    let flat = (thickness / step).round();
    let steps = [step, step, thickness / flat];
    let counts = [cells as usize + 2, (1.4 / step) as usize + 2, flat as usize + 5];
    let corner = [-1.2 - 0.6 * step, -0.7 - 0.6 * step, -0.5 * thickness - 2.5 * steps[2]];
    net(counts, corner, steps, |[x, y, z]| {
        let plane = (x * x + y * y).powi(2) - x * x + y * y;
        plane * plane + z * z - LEVEL
    })
}

/// Returns the surface net of f = 0 over a grid of `counts` points, for a function f that is negative inside the
/// surface.
fn net(counts: [usize; 3], corner: Vec3, steps: Vec3, f: impl Fn(Vec3) -> f64) -> Mesh {
    let point = |i: [usize; 3]| -> Vec3 { std::array::from_fn(|axis| corner[axis] + steps[axis] * i[axis] as f64) };
    let number = |[x, y, z]: [usize; 3]| (z * counts[1] + y) * counts[0] + x;
    let all = || {
        let [nx, ny, nz] = counts;
        (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
    };
    let inside: Vec<bool> = all().map(|i| f(point(i)) < 0.0).collect();
    let mut mesh = Mesh::default();
    let mut vertices: HashMap<usize, u32> = HashMap::new();
    let mut vertex = |mesh: &mut Mesh, cell: [usize; 3]| {
        *vertices.entry(number(cell)).or_insert_with(|| {
            mesh.vertices.push(add(point(cell), scale(steps, 0.5)));
            mesh.vertices.len() as u32 - 1
        })
    };
    for i in all() {
        for axis in 0..3 {
            let mut j = i;
            j[axis] += 1;
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            if j[axis] == counts[axis] || i[u] == 0 || i[v] == 0 || inside[number(i)] == inside[number(j)] {
                continue;
            }
            // The four cells around the grid edge from i to j, counter-clockwise when seen from j.
            let cell = |du: usize, dv: usize| {
                let mut cell = i;
                (cell[u], cell[v]) = (cell[u] - du, cell[v] - dv);
                cell
            };
            let mut quad = [cell(1, 1), cell(0, 1), cell(0, 0), cell(1, 0)].map(|cell| vertex(&mut mesh, cell));
            if !inside[number(i)] {
                quad.reverse();
            }
            let [a, b, c, d] = quad;
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    relax(&mut mesh, steps[0], f);
    mesh
}

/// Moves each vertex to the mean of its neighbours, then back onto the surface f = 0 by Newton steps along the
/// gradient.
fn relax(mesh: &mut Mesh, step: f64, f: impl Fn(Vec3) -> f64) {
    let gradient = |p: Vec3| -> Vec3 {
        let h = 1e-4 * step;
        std::array::from_fn(|axis| {
            let (mut a, mut b) = (p, p);
            (a[axis], b[axis]) = (p[axis] + h, p[axis] - h);
            (f(a) - f(b)) / (2.0 * h)
        })
    };
    for _ in 0..10 {
        let mut sums = vec![([0.0; 3], 0.0); mesh.vertices.len()];
        for face in &mesh.faces {
            for k in 0..3 {
                let (sum, count) = &mut sums[face[k] as usize];
                *sum = add(*sum, mesh.vertices[face[(k + 1) % 3] as usize]);
                *count += 1.0;
            }
        }
        for (p, (sum, count)) in mesh.vertices.iter_mut().zip(sums) {
            *p = scale(sum, 1.0 / count);
            for _ in 0..5 {
                let slope = gradient(*p);
                *p = add(*p, scale(slope, -f(*p) / dot(slope, slope)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topology::{Topology, is_outward, signed_volume};

    #[test]
    fn tori_have_their_genus_and_volume() {
        let smooth = torus(&Torus::default());
        let expected = 2.0 * std::f64::consts::PI.powi(2) * 2.0;
        assert!((signed_volume(&smooth) / expected - 1.0).abs() < 0.01, "{}", signed_volume(&smooth));
        for mesh in [smooth, torus(&Torus { bumps: 0.15, around: 31, ..Torus::default() })] {
            assert_eq!(Topology::of(&mesh).genus(), Some(1));
            assert!(is_outward(&mesh));
        }
        for cells in [32, 40, 47, 60, 61, 80, 100] {
            let mesh = double_torus(cells);
            assert_eq!(Topology::of(&mesh).genus(), Some(2), "{:?}", Topology::of(&mesh).problems());
            assert!(is_outward(&mesh));
        }
    }
}
