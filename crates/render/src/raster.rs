//! Rasterises triangles into a z-buffer at twice the picture's resolution, and averages the samples of each pixel.

use std::ops::Range;

use spharm_surface::Mesh;
use spharm_surface::geometry::{Vec3, add, dot, scale, unit, vertex_normals};

use crate::camera::Camera;
use crate::image::Image;
use crate::{Contour, INK};

/// Number of samples per pixel along each axis.
const FINE: usize = 2;
/// Number of bytes per pixel for the depths and colours of the pixel's samples.
pub(crate) const BYTES_PER_PIXEL: u64 = (FINE * FINE * 20) as u64;
/// Directions of the lights in the picture's axes (right, up, towards the camera), and their strengths: a key light
/// from the upper left, and a weak light from the right that keeps the shadow side legible.
const LIGHTS: [(Vec3, f64); 2] = [([-0.5, 0.7, 0.8], 0.78), ([0.9, -0.1, 0.4], 0.22)];
const AMBIENT: f64 = 0.14;
/// Half the width of contours, as a fraction of the panel's width.
const LINE: f64 = 1.0 / 500.0;
/// Minimum half width of contours in samples, so that lines are at least a pixel wide.
const THINNEST: f64 = 0.5 * FINE as f64;

/// A panel being drawn, with the depth and colour of each sample.
pub(crate) struct Raster {
    width: usize,
    height: usize,
    depth: Vec<f64>,
    /// Colour of each sample, in linear light.
    color: Vec<[f32; 3]>,
}

/// A vertex projected to the picture, with its normal and colour.
#[derive(Clone, Copy)]
struct Corner {
    at: Vec3,
    normal: Vec3,
    /// Colour in linear light.
    color: Vec3,
    /// Value at this vertex of the map whose contour is drawn, minus the contour's level; NaN without a contour.
    off: f64,
}

impl Raster {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let samples = width * height * FINE * FINE;
        Self { width, height, depth: vec![f64::NEG_INFINITY; samples], color: vec![[0.0; 3]; samples] }
    }

    /// Draws a mesh with a colour (sRGB) per vertex, and a contour, if any. Triangles that face away from the camera
    /// are also drawn, lit as if seen from the front, so that the inside of an open or inverted surface is visible.
    pub(crate) fn draw(&mut self, mesh: &Mesh, colors: &[[u8; 3]], contour: Option<Contour<'_>>, camera: &Camera) {
        let lights = LIGHTS.map(|(direction, strength)| (camera.direction(direction), strength));
        let normals = vertex_normals(&mesh.vertices, &mesh.faces).into_iter().map(unit);
        let corners: Vec<Corner> = mesh
            .vertices
            .iter()
            .zip(normals)
            .zip(colors)
            .enumerate()
            .map(|(vertex, ((&position, normal), &color))| {
                let [x, y, depth] = camera.project(position);
                let at = [x * FINE as f64, y * FINE as f64, depth];
                let off = contour.map_or(f64::NAN, |contour| contour.values[vertex] - contour.level);
                Corner { at, normal, color: color.map(to_linear), off }
            })
            .collect();
        for face in &mesh.faces {
            // Triangles that refer to a missing vertex are skipped; meshes built by hand may have them.
            let [Some(a), Some(b), Some(c)] = face.map(|i| corners.get(i as usize)) else {
                continue;
            };
            self.triangle([a, b, c], &lights, camera.towards);
        }
    }

    fn triangle(&mut self, corners: [&Corner; 3], lights: &[(Vec3, f64)], towards: Vec3) {
        let [a, b, c] = corners.map(|corner| corner.at);
        let area = cross(a, b, c);
        if !area.is_normal() {
            return;
        }
        let (columns, rows) = (self.width * FINE, self.height * FINE);
        let range = |axis: usize, most: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]).floor().max(0.0);
            let high = a[axis].max(b[axis]).max(c[axis]).ceil().min(most as f64);
            low as usize..high as usize
        };
        let across = range(0, columns);
        let line = Line::through(corners, (LINE * columns as f64).max(THINNEST));
        for row in range(1, rows) {
            for column in columns_of([a, b, c], row as f64 + 0.5, &across) {
                let p = [column as f64 + 0.5, row as f64 + 0.5, 0.0];
                let weights = [cross(p, b, c) / area, cross(a, p, c) / area, cross(a, b, p) / area];
                if weights.iter().any(|&w| w < 0.0) {
                    continue;
                }
                let depth = mixed(corners.map(|corner| [corner.at[2]]), weights)[0];
                let sample = row * columns + column;
                if depth > self.depth[sample] {
                    self.depth[sample] = depth;
                    let normal = unit(mixed(corners.map(|corner| corner.normal), weights));
                    let light = shade(normal, lights, towards);
                    let color = if line.is_some_and(|line| line.covers(weights)) {
                        INK.map(to_linear)
                    } else {
                        mixed(corners.map(|corner| corner.color), weights).map(|x| x * light)
                    };
                    self.color[sample] = color.map(|x| x as f32);
                }
            }
        }
    }

    /// Averages the samples of each pixel over the background, and draws the result with its upper left corner at (x,
    /// y).
    pub(crate) fn paint_on(&self, picture: &mut Image, x: usize, y: usize) {
        let columns = self.width * FINE;
        for row in 0..self.height {
            for column in 0..self.width {
                let sample = |i: usize| (row * FINE + i / FINE) * columns + column * FINE + i % FINE;
                if (0..FINE * FINE).all(|i| self.depth[sample(i)] == f64::NEG_INFINITY) {
                    continue;
                }
                let background = picture.get(x + column, y + row).map(to_linear);
                let mut sum = [0.0; 3];
                for i in 0..FINE * FINE {
                    let sample = sample(i);
                    let light = match self.depth[sample] {
                        f64::NEG_INFINITY => background,
                        _ => self.color[sample].map(f64::from),
                    };
                    sum = add(sum, light);
                }
                picture.set(x + column, y + row, sum.map(|s| from_linear(s / (FINE * FINE) as f64)));
            }
        }
    }
}

/// Part of a contour within a triangle.
#[derive(Clone, Copy)]
struct Line {
    /// Difference between the value of the map and the contour's level at each corner of the triangle.
    off: [f64; 3],
    /// Absolute difference between map and level at the two edges of the drawn line.
    most: f64,
}

impl Line {
    /// Returns the part of a contour within a triangle. `half` is half of the line's width in samples. Returns `None`
    /// if the contour doesn't touch the triangle.
    fn through(corners: [&Corner; 3], half: f64) -> Option<Self> {
        let off = corners.map(|corner| corner.off);
        let [a, b, c] = corners.map(|corner| corner.at);
        // Gradient of the linear function on the triangle, computed from its differences along two edges.
        let (along, across) = (off[1] - off[0], off[2] - off[0]);
        let gradient = [along * (c[1] - a[1]) - across * (b[1] - a[1]), across * (b[0] - a[0]) - along * (c[0] - a[0])];
        let most = half * gradient[0].hypot(gradient[1]) / cross(a, b, c).abs();
        // A contour that runs outside of the triangle, but nearer to it than half the line's width, still covers part
        // of the triangle.
        let near = off.iter().any(|x| *x <= most) && off.iter().any(|x| *x >= -most);
        (most.is_finite() && most > 0.0 && near).then_some(Self { off, most })
    }

    /// Returns whether the line covers a point, given by its barycentric coordinates.
    fn covers(self, weights: [f64; 3]) -> bool {
        (0..3).map(|k| weights[k] * self.off[k]).sum::<f64>().abs() < self.most
    }
}

/// Returns the columns in which a triangle may have samples in the row at height y. A narrow triangle covers only a
/// few columns of its bounding box.
fn columns_of(corners: [Vec3; 3], y: f64, across: &Range<usize>) -> Range<usize> {
    /// Upper bound of the rounding error of positions, in units of the distance between samples.
    const SLACK: f64 = 1e-3;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for k in 0..3 {
        let (p, q) = (corners[k], corners[(k + 1) % 3]);
        if y < p[1].min(q[1]) - SLACK || y > p[1].max(q[1]) + SLACK {
            continue;
        }
        let rise = q[1] - p[1];
        // A nearly horizontal edge may lie within the row along its entire length.
        let ends = if rise.abs() < 1.0 { [0.0, 1.0] } else { [((y - p[1]) / rise).clamp(0.0, 1.0); 2] };
        for x in ends.map(|t| p[0] + t * (q[0] - p[0])) {
            (low, high) = (low.min(x), high.max(x));
        }
    }
    let start = across.start.max((low - 1.0).floor().max(0.0) as usize);
    start..across.end.min((high + 1.0).ceil().max(0.0) as usize).max(start)
}

/// Returns the mean of the corners' values, weighted by barycentric coordinates.
#[inline]
fn mixed<const N: usize>([a, b, c]: [[f64; N]; 3], weights: [f64; 3]) -> [f64; N] {
    std::array::from_fn(|k| a[k] * weights[0] + b[k] * weights[1] + c[k] * weights[2])
}

/// Returns the brightness of a point by Lambert's cosine law plus ambient light.
fn shade(normal: Vec3, lights: &[(Vec3, f64)], towards: Vec3) -> f64 {
    let normal = if dot(normal, towards) < 0.0 { scale(normal, -1.0) } else { normal };
    let lit: f64 = lights.iter().map(|(direction, strength)| strength * dot(normal, *direction).max(0.0)).sum();
    AMBIENT + lit
}

/// Returns twice the signed area of a triangle in the plane.
fn cross(a: Vec3, b: Vec3, c: Vec3) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn to_linear(srgb: u8) -> f64 {
    (f64::from(srgb) / 255.0).powf(2.2)
}

fn from_linear(light: f64) -> u8 {
    (255.0 * light.clamp(0.0, 1.0).powf(1.0 / 2.2)).round() as u8
}
