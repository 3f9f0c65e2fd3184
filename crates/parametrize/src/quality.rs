//! Measures whether a map to the sphere is one to one, and its distortion of areas, angles and lengths.
//!
//! The surface is scaled to the area of the sphere, 4 pi. Each flat triangle of the surface is mapped linearly onto the
//! flat triangle of its vertices on the sphere; the singular values of this map are s1 >= s2. With A the triangle's
//! area on the surface, and sums over triangles:
//!
//! | figure | formula | value for an isometry |
//! |---|---|---|
//! | log area ratio | log (solid angle / A) | 0 |
//! | angle distortion | corner angle on the sphere - corner angle on the surface | 0 |
//! | L2 stretch | sqrt (sum A (1/s1^2 + 1/s2^2) / 2 / sum A) (Sander, Snyder, Gortler, Hoppe, SIGGRAPH 2001) | 1 |
//! | length distortion | max (s1, 1/s2), the worst case over directions (Shen and Makedon 2006, section 2.2) | 1 |
//!
//! # Verifying that a map is one to one
//!
//! A continuous map from a closed surface to the sphere is a branched covering if it maps each triangle one to one and
//! preserves its orientation. Such a map is one to one if it covers the sphere once. The orientation of each triangle
//! is determined by an exact predicate from the given coordinates. The number of times that the sphere is covered, an
//! integer, is determined from the sum of solid angles.

use rayon::prelude::*;
use serde::Serialize;
use spharm_surface::Mesh;
use spharm_surface::range::scaled_meshes;

use crate::geometry::{Vec3, area, cross, dot, norm, orientation, solid_angle, sub};

/// Orientation and distortion of a map from a surface to the sphere. Reports use the names of these fields as keys.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Quality {
    /// Number of triangles.
    pub triangles: usize,
    /// Number of spherical triangles that are wound against the majority, by the exact predicate.
    pub flipped: usize,
    /// Number of spherical triangles without area, by the exact predicate.
    pub degenerate: usize,
    /// Number of times that the triangles cover the sphere. For a one-to-one map the number is 1, or -1 if the
    /// triangles wind clockwise seen from outside.
    pub winding_number: i64,
    /// Root mean square of the triangles' log area ratios.
    pub area_rms: f64,
    /// Root mean square of the log area ratio, with each triangle weighted by its area on the surface.
    pub area_rms_weighted: f64,
    /// 1st percentile of the triangles' log area ratios.
    pub area_p01: f64,
    /// 99th percentile of the triangles' log area ratios.
    pub area_p99: f64,
    /// Root mean square of the angle distortions at the triangles' corners, in degrees.
    pub angle_rms_degrees: f64,
    /// The L2 stretch of the map.
    pub stretch: f64,
    /// Largest length distortion among all triangles.
    pub length_worst: f64,
    /// 99th percentile of the triangles' length distortions.
    pub length_p99: f64,
}

impl Quality {
    /// Measures the map from a surface to a sphere with the same triangles. Takes O(n log n) time.
    ///
    /// # Panics
    ///
    /// When the numbers of vertices differ, or a triangle's vertex index is out of range.
    #[must_use]
    pub fn of(surface: &Mesh, sphere: &Mesh) -> Self {
        assert_eq!(
            surface.vertices.len(),
            sphere.vertices.len(),
            "the surface and its sphere must have equally many vertices"
        );
        let scaled = scaled_meshes([surface]);
        let surface = scaled.as_ref().map_or(surface, |([surface], _)| surface);
        Self::measure(&surface.vertices, &sphere.vertices, &surface.faces)
    }

    /// Returns whether every point of the sphere is the image of exactly one point of the surface.
    #[must_use]
    pub fn is_bijective(&self) -> bool {
        self.flipped == 0 && self.degenerate == 0 && self.winding_number.abs() == 1
    }

    pub(crate) fn measure(surface: &[Vec3], sphere: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let corners = |points: &[Vec3], face: &[u32; 3]| face.map(|v| points[v as usize]);
        let total: f64 = faces.iter().map(|face| area(corners(surface, face))).sum();
        let scale = 4.0 * std::f64::consts::PI / total;
        let each: Vec<Triangle> = faces
            .par_iter()
            .map(|face| Triangle::measure(corners(surface, face), corners(sphere, face), scale))
            .collect();

        let turns: f64 = each.iter().map(|t| t.solid_angle).sum::<f64>() / (4.0 * std::f64::consts::PI);
        let winding_number = turns.round() as i64;
        let outward = if winding_number < 0 { -1.0 } else { 1.0 };
        let degenerate = each.iter().filter(|t| t.orientation == 0.0).count();
        let flipped = each.iter().filter(|t| t.orientation * outward < 0.0).count();

        let count = each.len() as f64;
        let mean = |f: &dyn Fn(&Triangle) -> f64| each.iter().map(f).sum::<f64>() / count;
        // The logarithm of a flipped triangle's ratio isn't defined; its ratio is set to the smallest positive number.
        let log = |t: &Triangle| (t.solid_angle * outward / t.area).max(f64::MIN_POSITIVE).ln();
        let weight: f64 = each.iter().map(|t| t.area).sum();
        let logs = sorted(each.iter().map(log));
        let lengths = sorted(each.iter().map(|t| t.length));
        Self {
            triangles: each.len(),
            flipped,
            degenerate,
            winding_number,
            area_rms: mean(&|t| log(t).powi(2)).sqrt(),
            area_rms_weighted: (each.iter().map(|t| t.area * log(t).powi(2)).sum::<f64>() / weight).sqrt(),
            area_p01: percentile(&logs, 0.01),
            area_p99: percentile(&logs, 0.99),
            angle_rms_degrees: mean(&|t| t.angle_square).sqrt().to_degrees(),
            stretch: (each.iter().map(|t| t.area * t.stretch_square).sum::<f64>() / weight).sqrt(),
            length_worst: percentile(&lengths, 1.0),
            length_p99: percentile(&lengths, 0.99),
        }
    }
}

/// Returns the log area ratio at each vertex (n): the logarithm of a / b, where a and b are the areas of the triangles
/// around the vertex on the sphere and on the surface, with both meshes scaled to area 4 pi. NaN at a vertex without
/// triangles. The sphere's vertices must be unit vectors.
///
/// # Panics
///
/// When the numbers of vertices differ, or a triangle's vertex index is out of range.
#[must_use]
pub fn log_area_ratios(surface: &Mesh, sphere: &Mesh) -> Vec<f64> {
    assert_eq!(
        surface.vertices.len(),
        sphere.vertices.len(),
        "the surface and its sphere must have equally many vertices"
    );
    let around = |measure: fn([Vec3; 3]) -> f64, vertices: &[Vec3]| {
        let mut sums = vec![0.0; vertices.len()];
        let mut total = 0.0;
        for face in &surface.faces {
            let each = measure(face.map(|v| vertices[v as usize]));
            face.iter().for_each(|&v| sums[v as usize] += each);
            total += each;
        }
        sums.iter_mut().for_each(|sum| *sum /= total);
        sums
    };
    // On a sphere that winds inwards, all solid angles and their sum are negative, so the quotients are positive.
    let (before, after) = (around(area, &surface.vertices), around(solid_angle, &sphere.vertices));
    after.iter().zip(&before).map(|(after, before)| (after / before).ln()).collect()
}

/// Quantities measured on one triangle.
struct Triangle {
    /// Area of the triangle on the surface, after the surface was scaled to area 4 pi.
    area: f64,
    solid_angle: f64,
    orientation: f64,
    /// Mean over corners of the squared angle distortion.
    angle_square: f64,
    stretch_square: f64,
    length: f64,
}

impl Triangle {
    fn measure(surface: [Vec3; 3], sphere: [Vec3; 3], scale: f64) -> Self {
        let (area, image) = (area(surface) * scale, area(sphere));
        let (before, after) = (angles(surface), angles(sphere));
        // The map stretches the triangle by s1 and s2: s1^2 + s2^2 = sum of cot(angle) |opposite edge|^2 / (2 area),
        // with the angles on the surface and the edges on the sphere, and s1 s2 = image / area, with `image` the area
        // of the flat triangle on the sphere.
        let [a, b, c] = surface;
        let cotangents = [cotangent(a, b, c), cotangent(b, c, a), cotangent(c, a, b)];
        let [p, q, r] = sphere;
        let opposite = [sub(r, q), sub(p, r), sub(q, p)];
        let sum = (0..3).map(|i| cotangents[i] * dot(opposite[i], opposite[i])).sum::<f64>() / (2.0 * area);
        let product = image / area;
        let root = (sum * sum - 4.0 * product * product).max(0.0).sqrt();
        let large = ((sum + root) / 2.0).sqrt();
        let small = product / large;
        Self {
            area,
            solid_angle: solid_angle(sphere),
            orientation: orientation(sphere),
            angle_square: (0..3).map(|i| (after[i] - before[i]).powi(2)).sum::<f64>() / 3.0,
            stretch_square: sum / (2.0 * product * product),
            length: large.max(1.0 / small),
        }
    }
}

/// Returns the cotangent of the angle at corner a.
fn cotangent(a: Vec3, b: Vec3, c: Vec3) -> f64 {
    let (u, v) = (sub(b, a), sub(c, a));
    dot(u, v) / norm(cross(u, v))
}

/// Returns the angle at each corner, in radians.
fn angles([a, b, c]: [Vec3; 3]) -> [f64; 3] {
    [(a, b, c), (b, c, a), (c, a, b)].map(|(at, to, and)| {
        let (u, v) = (sub(to, at), sub(and, at));
        norm(cross(u, v)).atan2(dot(u, v))
    })
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values
}

/// Returns the value below which the given share (0 to 1) of the sorted values lies; NaN for an empty list.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_surface::generate::icosphere;

    #[test]
    fn the_identity_distorts_nothing_but_flat_triangles() {
        let sphere = icosphere(4);
        let quality = Quality::of(&sphere, &sphere);
        assert!(quality.is_bijective());
        assert_eq!(quality.winding_number, 1);
        assert!(quality.area_rms < 0.003, "{quality:?}");
        assert!((quality.stretch - 1.0).abs() < 0.003, "{quality:?}");
        assert!((quality.length_worst - 1.0).abs() < 0.003, "{quality:?}");
        assert!(quality.angle_rms_degrees < 1e-12);
    }

    #[test]
    fn a_known_stretch_is_measured() {
        // The surface is the sphere stretched tenfold along z, so the map squeezes triangles near the equator tenfold.
        let sphere = icosphere(5);
        let long = sphere.with_vertices(sphere.vertices.iter().map(|&[x, y, z]| [x, y, 10.0 * z]).collect());
        let quality = Quality::of(&long, &sphere);
        // The area of a prolate spheroid of semi-axes 1, 1, c is 2 pi (1 + c asin(e) / e) with e^2 = 1 - 1 / c^2.
        let e = (1.0_f64 - 0.01).sqrt();
        let area = 2.0 * std::f64::consts::PI * (1.0 + 10.0 * e.asin() / e);
        let scale = (4.0 * std::f64::consts::PI / area).sqrt();
        // Near the equator, the map multiplies lengths along a circle of latitude by 1 / scale, and lengths along z by
        // 0.1 / scale.
        assert!((quality.length_worst / (10.0 * scale) - 1.0).abs() < 0.02, "{quality:?}");
        assert!((quality.area_p01 - (0.1 / (scale * scale)).ln()).abs() < 0.01, "{quality:?}");
    }

    #[test]
    fn the_log_area_ratio_of_a_vertex_is_that_around_it() {
        let sphere = icosphere(5);
        let long = sphere.with_vertices(sphere.vertices.iter().map(|&[x, y, z]| [x, y, 10.0 * z]).collect());
        let ratios = log_area_ratios(&long, &sphere);
        let quality = Quality::of(&long, &sphere);
        // The smallest ratio is near the equator, where triangles are squeezed; the largest is near the poles.
        let (least, most) = ratios.iter().fold((f64::MAX, f64::MIN), |(a, b), &x| (a.min(x), b.max(x)));
        assert!(
            (least - quality.area_p01).abs() < 0.01 && (most - least - 10.0_f64.ln()).abs() < 0.1,
            "{least} {most}"
        );
        let mut inward = sphere.clone();
        inward.faces.iter_mut().for_each(|face| face.swap(0, 1));
        assert!(log_area_ratios(&inward, &inward).iter().all(|ratio| ratio.abs() < 0.02));
    }

    #[test]
    fn flips_and_turned_spheres_are_told_apart() {
        let sphere = icosphere(2);
        let mut folded = sphere.clone();
        // One vertex is moved out of its ring of neighbours, to the other side.
        let [a, b, _] = sphere.faces[40];
        folded.vertices[a as usize] = {
            let (p, q) = (sphere.vertices[a as usize], sphere.vertices[b as usize]);
            crate::geometry::unit([3.0 * q[0] - 2.0 * p[0], 3.0 * q[1] - 2.0 * p[1], 3.0 * q[2] - 2.0 * p[2]])
        };
        let quality = Quality::of(&sphere, &folded);
        assert!(quality.flipped > 0 && !quality.is_bijective());
        assert_eq!(quality.winding_number, 1);

        let mut inward = sphere.clone();
        inward.faces.iter_mut().for_each(|face| face.swap(0, 1));
        let quality = Quality::of(&inward, &inward);
        assert_eq!((quality.winding_number, quality.flipped), (-1, 0));
        assert!(quality.is_bijective());
        assert!(quality.area_rms < 0.02);
    }

    #[test]
    fn a_double_cover_is_not_one_to_one() {
        let mut twice = icosphere(1);
        let (n, faces) = (twice.vertices.len() as u32, twice.faces.clone());
        twice.vertices.extend(twice.vertices.clone());
        twice.faces.extend(faces.iter().map(|face| face.map(|v| v + n)));
        let quality = Quality::of(&twice, &twice);
        assert_eq!((quality.winding_number, quality.flipped), (2, 0));
        assert!(!quality.is_bijective());
    }
}
