//! Computes a label's surface without voxel steps: the surface of least bending within half a voxel of the stepped one.
//!
//! ```text
//! min |L x|^2   with   |x_v - c_v| <= 1/2 along each axis,   (L x)_v = x_v - mean of its neighbours
//! ```
//!
//! in voxels, where c_v is the lattice corner of vertex v. Minimising |L x|^2 (the bilaplacian) shrinks the surface
//! less than the Laplacian does (S. Gibson, "Constrained elastic surface nets", MICCAI 1998, has the boxes and the
//! Laplacian). The problem is solved by projected gradients with Nesterov's momentum, 60 flops per vertex and step.
//! Small bodies still lose up to 8 % of their volume. It is restored: all vertices move along their normals, within the
//! boxes, until the volume equals that of the voxels.

use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::geometry::{Vec3, add, cross, dot, scale, sub, unit};
use spharm_surface::topology::signed_volume;

use super::boundary::QuadMesh;

/// Number of gradient steps. Afterwards vertices are within a hundredth of a voxel of the minimum.
const STEPS: usize = 300;
/// Step length. It must be below 1/4, since the largest eigenvalue of `L^T L` is about 4, and exactly 4 for symmetric
/// L.
const STEP: f64 = 0.22;
/// Largest number of moves along the normals. Each leaves at most a tenth of the missing volume, unless most vertices
/// are at the limits of their boxes.
const MOVES: usize = 8;
/// Half the width of the box in which a vertex may move, in voxels.
const HALF: f64 = 0.5;

/// Largest relative difference of a smooth surface's volume from that of the voxels.
const VOLUME: f64 = 0.01;

impl QuadMesh {
    /// Returns this surface with smooth positions: those of [`relaxed`](Self::relaxed). A label of so few voxels that
    /// the smooth surface can't have their volume keeps the voxels' faces.
    ///
    /// # Errors
    ///
    /// [`Interrupted`], by the monitor.
    pub(crate) fn smoothed(self, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        let relaxed = self.relaxed(monitor)?;
        let keeps = (volume(&relaxed) / volume(&self) - 1.0).abs() < VOLUME;
        Ok(Self { smooth: keeps.then_some(relaxed.vertices), ..self })
    }

    /// Returns the surface of least bending that has the volume of this one, and whose vertices are within half a voxel
    /// of their positions in this one along each axis. This surface must be in voxel coordinates, as returned by
    /// [`around`](Self::around).
    ///
    /// # Errors
    ///
    /// [`Interrupted`], by the monitor.
    pub fn relaxed(&self, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        let rings = Rings::of(self);
        let mut found = self.vertices.clone();
        let mut ahead = found.clone();
        let mut momentum = 1.0_f64;
        for step in 0..STEPS {
            if step % 10 == 0 {
                monitor.check()?;
            }
            let bending = rings.transposed(&rings.off_mean(&ahead));
            let next: Vec<[f64; 3]> = ahead
                .iter()
                .zip(&bending)
                .zip(&self.vertices)
                .map(|((x, g), corner)| {
                    std::array::from_fn(|k| (x[k] - STEP * g[k]).clamp(corner[k] - HALF, corner[k] + HALF))
                })
                .collect();
            let following = 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt());
            let share = (momentum - 1.0) / following;
            ahead =
                next.iter().zip(&found).map(|(n, x)| std::array::from_fn(|k| n[k] + share * (n[k] - x[k]))).collect();
            (found, momentum) = (next, following);
        }
        Ok(self.with_own_volume(Self { vertices: found, ..self.clone() }))
    }

    /// Moves a relaxed surface along its normals until its volume is that of this surface.
    fn with_own_volume(&self, mut relaxed: Self) -> Self {
        let whole = volume(self);
        for _ in 0..MOVES {
            let missing = whole - volume(&relaxed);
            if missing.abs() < 1e-4 * whole.abs() {
                break;
            }
            let (normals, area) = relaxed.normals();
            let by = missing / area;
            for ((x, normal), corner) in relaxed.vertices.iter_mut().zip(normals).zip(&self.vertices) {
                let moved = add(*x, scale(normal, by));
                *x = std::array::from_fn(|k| moved[k].clamp(corner[k] - HALF, corner[k] + HALF));
            }
        }
        relaxed
    }

    /// Returns the unit normal of each vertex, and the surface's area.
    fn normals(&self) -> (Vec<Vec3>, f64) {
        let (mut normals, mut area) = (vec![[0.0; 3]; self.vertices.len()], 0.0);
        for quad in &self.quads {
            let [a, b, c, d] = quad.map(|v| self.vertices[v as usize]);
            let own = scale(cross(sub(c, a), sub(d, b)), 0.5);
            area += dot(own, own).sqrt();
            quad.iter().for_each(|v| normals[*v as usize] = add(normals[*v as usize], own));
        }
        normals.iter_mut().for_each(|normal| *normal = unit(*normal));
        (normals, area)
    }
}

/// Returns the volume within a surface, as the mean over both ways to cut its quadrangles.
fn volume(mesh: &QuadMesh) -> f64 {
    0.5 * (signed_volume(&mesh.triangles(|_| false)) + signed_volume(&mesh.triangles(|_| true)))
}

/// For each vertex, the vertices connected to it by an edge.
struct Rings {
    starts: Vec<usize>,
    near: Vec<u32>,
}

impl Rings {
    fn of(mesh: &QuadMesh) -> Self {
        let mut starts = vec![0; mesh.vertices.len() + 1];
        mesh.edges().flatten().for_each(|v| starts[v as usize + 1] += 1);
        (1..starts.len()).for_each(|v| starts[v] += starts[v - 1]);
        let (mut at, mut near) = (starts.clone(), vec![0; starts[mesh.vertices.len()]]);
        for [a, b] in mesh.edges() {
            for (v, w) in [(a, b), (b, a)] {
                near[at[v as usize]] = w;
                at[v as usize] += 1;
            }
        }
        Self { starts, near }
    }

    fn row(&self, v: usize) -> &[u32] {
        &self.near[self.starts[v]..self.starts[v + 1]]
    }

    /// Returns `L x`.
    fn off_mean(&self, x: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let of = |(v, x_v): (usize, &[f64; 3])| {
            let ring = self.row(v);
            let share = 1.0 / ring.len().max(1) as f64;
            std::array::from_fn(|k| x_v[k] - share * ring.iter().map(|w| x[*w as usize][k]).sum::<f64>())
        };
        x.iter().enumerate().map(of).collect()
    }

    /// Returns `L^T x`.
    fn transposed(&self, x: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let of = |(v, x_v): (usize, &[f64; 3])| {
            let share = |w: u32| 1.0 / self.row(w as usize).len().max(1) as f64;
            let pulls = |k: usize| self.row(v).iter().map(|w| share(*w) * x[*w as usize][k]).sum::<f64>();
            std::array::from_fn(|k| x_v[k] - pulls(k))
        };
        x.iter().enumerate().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::mask::Mask;

    /// The surface of a ball of 10.3 voxels has steps of 0.29 voxels (root mean square), and 1.5 times the area of the
    /// ball.
    #[test]
    fn a_ball_of_voxels_is_round() {
        let radius = 10.3_f64;
        let centred = |at: [usize; 3]| at.map(|x| x as f64 - 12.0);
        let inside = |at: [usize; 3]| dot(centred(at), centred(at)) < radius * radius;
        let steps = QuadMesh::around(&Mask::new([25; 3], inside));
        let smooth = steps.relaxed(&spharm_monitor::Silent).unwrap();
        let off = |mesh: &QuadMesh| {
            let square = |v: &[f64; 3]| (dot(v.map(|x| x - 12.0), v.map(|x| x - 12.0)).sqrt() - radius).powi(2);
            (mesh.vertices.iter().map(square).sum::<f64>() / mesh.vertices.len() as f64).sqrt()
        };
        assert!(off(&smooth) < 0.12 && off(&steps) > 0.25, "{} {}", off(&smooth), off(&steps));
        let moved = smooth.vertices.iter().flatten().zip(steps.vertices.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(moved.fold(0.0, f64::max) <= HALF);
        let area = spharm_surface::topology::area(&smooth.triangles(|_| false));
        let expected = 4.0 * std::f64::consts::PI * radius * radius;
        assert!((area / expected - 1.0).abs() < 0.02, "{area} {expected}");
        assert!((volume(&smooth) / volume(&steps) - 1.0).abs() < 1e-3);
    }
}
