//! Operations on three-vectors, and areas of triangles on the unit sphere.

/// A point or a vector in space.
pub type Vec3 = [f64; 3];

/// Returns a + b.
#[must_use]
#[inline]
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Returns a - b.
#[must_use]
#[inline]
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Returns `a` multiplied by `s`.
#[must_use]
#[inline]
pub fn scale(a: Vec3, s: f64) -> Vec3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// Returns the inner product of a and b.
#[must_use]
#[inline]
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the cross product a x b.
#[must_use]
#[inline]
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns `a` scaled to length 1, or the zero vector if the length of `a` is 0 or not finite.
#[must_use]
#[inline]
pub fn unit(a: Vec3) -> Vec3 {
    let length = dot(a, a).sqrt();
    if length > 0.0 && length.is_finite() { scale(a, 1.0 / length) } else { [0.0; 3] }
}

/// Returns the normal of a triangle, with twice the triangle's area as its length.
#[must_use]
#[inline]
pub fn face_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    cross(sub(b, a), sub(c, a))
}

/// Returns the normal at each of the n vertices of a mesh: the sum of [`face_normal`] over the triangles around the
/// vertex. Triangles with indices out of range are skipped.
#[must_use]
pub fn vertex_normals(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![[0.0; 3]; vertices.len()];
    for face in faces {
        let [Some(a), Some(b), Some(c)] = face.map(|v| vertices.get(v as usize)) else { continue };
        let normal = face_normal([*a, *b, *c]);
        for &v in face {
            normals[v as usize] = add(normals[v as usize], normal);
        }
    }
    normals
}

/// Returns the smallest and the largest coordinate of the points along each axis. If there are no points, the smallest
/// coordinates are +infinity and the largest are -infinity.
#[must_use]
pub fn bounds(points: impl IntoIterator<Item = Vec3>) -> (Vec3, Vec3) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for p in points {
        for axis in 0..3 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    (low, high)
}

/// Returns the length of the diagonal of a box, given its [`bounds`].
#[must_use]
pub fn diagonal((low, high): (Vec3, Vec3)) -> f64 {
    let off = sub(high, low);
    dot(off, off).sqrt()
}

/// Returns the signed area of a triangle on the unit sphere, in steradians: positive if its corners are
/// counter-clockwise when seen from outside (A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30, 1983,
/// eq. 8).
///
/// The corners are unit vectors. The area depends on their determinant, which is computed from the triangle's edges, as
/// `a . ((b - a) x (c - a))`. A determinant computed from the corners themselves would lose all digits in triangles
/// with edges of 1e-8 rad.
#[must_use]
#[inline]
pub fn solid_angle([a, b, c]: [Vec3; 3]) -> f64 {
    let volume = dot(a, face_normal([a, b, c]));
    2.0 * volume.atan2(1.0 + dot(a, b) + dot(b, c) + dot(c, a))
}

/// Returns the orientation of a triangle, exact for the given coordinates: positive if its corners are
/// counter-clockwise when seen from outside a sphere around the origin, 0 if its plane contains the origin
/// (J. Shewchuk, Discrete Comput. Geom. 18, 1997).
#[must_use]
pub fn orientation([a, b, c]: [Vec3; 3]) -> f64 {
    let coord = |[x, y, z]: Vec3| robust::Coord3D { x, y, z };
    robust::orient3d(coord(a), coord(b), coord(c), coord([0.0; 3]))
}

/// Returns the winding number of a closed mesh of unit vectors around the origin: 1 for a sphere wound outwards, -1
/// for a sphere wound inwards, 0 if the origin lies outside the mesh.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn winding_number(directions: &[Vec3], faces: &[[u32; 3]]) -> f64 {
    let covered: f64 = faces.iter().map(|face| solid_angle(face.map(|v| directions[v as usize]))).sum();
    covered / (4.0 * std::f64::consts::PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OCTAHEDRON: [Vec3; 6] =
        [[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.]];
    const FACES: [[u32; 3]; 8] =
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];

    #[test]
    fn an_octant_is_an_eighth_of_the_sphere() {
        let octant = FACES[0].map(|v| OCTAHEDRON[v as usize]);
        assert!((solid_angle(octant) - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        let [a, b, c] = octant;
        assert!((solid_angle([b, a, c]) + std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    }

    #[test]
    fn an_octant_is_positive() {
        let octant = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(orientation(octant) > 0.0);
        let [a, b, c] = octant;
        assert!(orientation([b, a, c]) < 0.0);
    }

    #[test]
    fn orientation_is_exact_where_rounding_decides() {
        // c is a + b, changed by one unit in the last place to either side of the plane through a, b and the origin.
        let (a, b) = ([0.6, 0.8, 0.1], [0.3, -0.2, 0.7]);
        let c = [0.6 + 0.3, 0.8 - 0.2, 0.1 + 0.7];
        let side = |z: f64| orientation([a, b, [c[0], c[1], z]]);
        assert!(side(f64::from_bits(c[2].to_bits() + 2)) * side(f64::from_bits(c[2].to_bits() - 2)) < 0.0);
        let (a, b) = ([0.5, 0.25, 1.0], [0.125, 2.0, 0.75]);
        assert_eq!(orientation([a, b, add(a, b)]), 0.0);
    }

    /// Returns the coordinates as whole multiples of 2^-55, which is exact for numbers from 1/8 to 1. The determinants
    /// of small triangles in these units fit into 128 bits.
    fn integers(v: Vec3) -> [i128; 3] {
        v.map(|x| {
            let scaled = x * 2.0_f64.powi(55);
            assert_eq!(scaled, scaled.trunc());
            scaled as i128
        })
    }

    /// The area of a triangle with edges of about 1e-8 rad is half its determinant, up to a relative error of 1e-16.
    #[test]
    fn cells_of_a_hundred_millionth_keep_their_digits() {
        let mut random = crate::generate::SplitMix64::new(3);
        for _ in 0..100 {
            let mut corner = || unit([0.48, -0.6, 0.64].map(|x| x + random.between(-1e-8, 1e-8)));
            let [a, b, c] = [corner(), corner(), corner()];
            let [p, q, r] = [a, b, c].map(integers);
            let minus = |x: [i128; 3], y: [i128; 3]| [x[0] - y[0], x[1] - y[1], x[2] - y[2]];
            let (u, v) = (minus(q, p), minus(r, p));
            let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            let determinant = p[0] * normal[0] + p[1] * normal[1] + p[2] * normal[2];
            let exact = 0.5 * determinant as f64 * 2.0_f64.powi(-3 * 55);
            // For slivers, the relative error is larger, since the rounding error is proportional to the product of the
            // edges' lengths rather than to the area.
            let edges = (dot(sub(b, a), sub(b, a)) * dot(sub(c, a), sub(c, a))).sqrt();
            let found = solid_angle([a, b, c]);
            assert!((found - exact).abs() < 1e-12 * exact.abs().max(1e-3 * edges), "{found} {exact}");
        }
    }

    #[test]
    fn an_octahedron_goes_once_around_its_centre() {
        assert!((winding_number(&OCTAHEDRON, &FACES) - 1.0).abs() < 1e-14);
        let inwards = FACES.map(|[a, b, c]| [a, c, b]);
        assert!((winding_number(&OCTAHEDRON, &inwards) + 1.0).abs() < 1e-14);
        let moved = OCTAHEDRON.map(|[x, y, z]| unit([x + 3.0, y + 0.1, z]));
        assert!(winding_number(&moved, &FACES).abs() < 1e-14);
    }
}
