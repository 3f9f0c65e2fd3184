//! Splits polygons and strips into triangles.

use crate::geometry::{Vec3, add, dot, face_normal, unit};
use crate::mesh::Mesh;

/// Concave polygons with at most this many corners are cut into triangles without folds. Larger polygons remain fans.
/// The time needed to cut a polygon usually grows with the square of its number of corners, and in the worst case with
/// the cube.
const MOST_CORNERS: usize = 512;
/// A triangle that faces backwards counts as a fold only if its area exceeds this fraction of the polygon's area.
/// Smaller triangles may face backwards only because of rounding, if their corners lie on a line.
const ROUNDING: f64 = 1e-6;

/// Triangles of polygons and strips. A polygon is stored as a fan of triangles until the positions of the vertices are
/// known.
#[derive(Debug, Default)]
pub(super) struct Triangles {
    faces: Vec<[u32; 3]>,
    /// For each polygon with more than three corners: the index of its first triangle, and its number of triangles.
    polygons: Vec<[u32; 2]>,
}

impl Triangles {
    pub(super) fn reserve(&mut self, faces: usize) {
        self.faces.reserve(faces);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Adds a polygon. Returns `false` for fewer than three corners.
    pub(super) fn polygon(&mut self, corners: &[u32]) -> bool {
        // Meshes whose number of triangles exceeds 32 bits are rejected later.
        if let (Ok(first), Ok(count @ 4..)) = (u32::try_from(self.faces.len()), u32::try_from(corners.len())) {
            self.polygons.push([first, count - 2]);
        }
        fan(corners, &mut self.faces)
    }

    /// Adds a strip. Returns `false` for fewer than three corners.
    pub(super) fn strip(&mut self, corners: &[u32]) -> bool {
        strip(corners, &mut self.faces)
    }

    /// Returns the triangles. A polygon whose fan has folds is cut by ear clipping instead.
    pub(super) fn cut(mut self, vertices: &[Vec3]) -> Vec<[u32; 3]> {
        for [first, count] in self.polygons.iter().map(|polygon| polygon.map(|number| number as usize)) {
            let Some(fan) = self.faces.get_mut(first..first + count) else { continue };
            if let Some(ears) = unfolded(fan, vertices) {
                fan.copy_from_slice(&ears);
            }
        }
        self.faces
    }

    /// Returns the mesh of these triangles.
    pub(super) fn into_mesh(self, vertices: Vec<Vec3>) -> Mesh {
        let faces = self.cut(&vertices);
        Mesh::new(vertices, faces)
    }
}

/// Splits a polygon into triangles that share its first corner, and adds them to `faces`. Returns `false` for fewer
/// than three corners.
///
/// The triangles have the polygon's winding, and no vertex is added.
pub(super) fn fan(corners: &[u32], faces: &mut Vec<[u32; 3]>) -> bool {
    let [first, second, rest @ ..] = corners else {
        return false;
    };
    if rest.is_empty() {
        return false;
    }
    let mut previous = *second;
    for &corner in rest {
        faces.push([*first, previous, corner]);
        previous = corner;
    }
    true
}

/// Cuts a polygon that is given as a fan of triangles into the same number of other triangles, without folds. Folds are
/// detected in the plane perpendicular to the polygon's normal (Newell's method). Returns `None` if the fan has no
/// folds, if the polygon has too many corners, or if no cut without folds is found, as for polygons that cross
/// themselves.
fn unfolded(fan: &[[u32; 3]], vertices: &[Vec3]) -> Option<Vec<[u32; 3]>> {
    let place = |[a, b, c]: [u32; 3]| {
        let at = |v: u32| vertices.get(v as usize).copied();
        Some([at(a)?, at(b)?, at(c)?])
    };
    let normals: Vec<Vec3> = fan.iter().map(|face| place(*face).map(face_normal)).collect::<Option<_>>()?;
    let normal = normals.iter().fold([0.0; 3], |sum, normal| add(sum, *normal));
    let up = unit(normal);
    let least = -ROUNDING * dot(normal, up);
    if normals.iter().all(|normal| dot(*normal, up) >= least) || fan.len() + 2 > MOST_CORNERS {
        return None;
    }
    let corners: Vec<u32> =
        fan.iter().take(1).flat_map(|[a, b, _]| [*a, *b]).chain(fan.iter().map(|[_, _, c]| *c)).collect();
    ears(
        &corners,
        |face| place(face).map_or(f64::NAN, |corners| dot(face_normal(corners), up)),
        |a, b| vertices.get(a as usize) == vertices.get(b as usize),
    )
}

/// Cuts a polygon into triangles by ear clipping (G. Meisters, Amer. Math. Monthly 82, 1975). `area` returns the signed
/// area of a triangle. `same` returns whether two corners are at the same position. Corners at the same position occur
/// at the ends of the line that joins a hole to the outline of a polygon.
fn ears(corners: &[u32], area: impl Fn([u32; 3]) -> f64, same: impl Fn(u32, u32) -> bool) -> Option<Vec<[u32; 3]>> {
    let mut left = corners.to_vec();
    let mut faces = Vec::with_capacity(left.len().saturating_sub(2));
    let mut from = 0;
    while left.len() > 3 {
        let count = left.len();
        let at = |place: usize| left[place % count];
        let is_ear = |&place: &usize| {
            let [a, b, c] = [at(place + count - 1), at(place), at(place + 1)];
            let is_inside = |p: u32| {
                let covers = area([a, b, p]) >= 0.0 && area([b, c, p]) >= 0.0 && area([c, a, p]) >= 0.0;
                covers && ![a, b, c].iter().any(|&corner| same(p, corner))
            };
            area([a, b, c]) > 0.0 && !left.iter().any(|&p| is_inside(p))
        };
        let ear = (from..from + count).find(is_ear)? % count;
        faces.push([at(ear + count - 1), at(ear), at(ear + 1)]);
        left.remove(ear);
        // The corner after the ear is next, so that the triangles don't all share a corner.
        from = ear;
    }
    let last = <[u32; 3]>::try_from(left).ok()?;
    faces.push(last);
    (area(last) > 0.0).then_some(faces)
}

/// Splits a strip into triangles, each of three successive corners, and adds them to `faces`. Returns `false` for fewer
/// than three corners.
///
/// Every second triangle is reversed, so that all triangles have the winding of the first one. Triangles that repeat a
/// corner are dropped, because exporters insert such triangles only to join several strips into one.
pub(super) fn strip(corners: &[u32], faces: &mut Vec<[u32; 3]>) -> bool {
    for (i, triangle) in corners.windows(3).enumerate() {
        let &[a, b, c] = triangle else { continue };
        if a != b && b != c && c != a {
            faces.push(if i % 2 == 0 { [a, b, c] } else { [b, a, c] });
        }
    }
    corners.len() >= 3
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The corners of an L with area 3, whose reflex corner is (1, 1).
    const L: [Vec3; 6] =
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 2.0, 0.0]];

    /// Returns the triangles of a polygon and their areas. The polygon's corners are all vertices in order, starting at
    /// `start`.
    fn cut(vertices: &[Vec3], start: u32) -> (Vec<[u32; 3]>, Vec<f64>) {
        let count = vertices.len() as u32;
        let corners: Vec<u32> = (0..count).map(|k| (start + k) % count).collect();
        let mut triangles = Triangles::default();
        assert!(triangles.polygon(&corners));
        let faces = triangles.cut(vertices);
        assert_eq!(faces.len(), vertices.len() - 2);
        let areas = faces.iter().map(|face| 0.5 * face_normal(face.map(|v| vertices[v as usize]))[2]).collect();
        (faces, areas)
    }

    #[test]
    fn concave_polygons_are_cut_inside_from_every_corner() {
        // The polygons are the end of a bar with a slot, a polygon with corners on a line, and a square with a square
        // hole that is joined to the outline along one line.
        let slot = [[0., 0.], [3., 0.], [3., 2.], [2., 2.], [2., 1.], [1., 1.], [1., 2.], [0., 2.]];
        let line = [[0., 0.], [1., 0.], [2., 0.], [2., 1.], [1., 1.], [1., 1.5], [1., 2.], [0., 2.], [0., 1.]];
        let hole = [[0., 0.], [3., 0.], [3., 3.], [0., 3.], [0., 0.], [1., 1.], [1., 2.], [2., 2.], [2., 1.], [1., 1.]];
        let flat = |corners: &[[f64; 2]]| corners.iter().map(|&[x, y]| [x, y, 0.0]).collect::<Vec<Vec3>>();
        for (polygon, area) in [(L.to_vec(), 3.0), (flat(&slot), 5.0), (flat(&line), 3.0), (flat(&hole), 8.0)] {
            for start in 0..polygon.len() as u32 {
                let (faces, areas) = cut(&polygon, start);
                assert!(areas.iter().all(|area| *area >= 0.0), "{start}: {faces:?} {areas:?}");
                assert!((areas.iter().sum::<f64>() - area).abs() < 1e-12, "{start}: {areas:?}");
            }
        }
    }

    #[test]
    fn darts_are_cut_along_their_inner_diagonal() {
        let dart = [[0.0, 0.0, 0.0], [3.0, -1.0, 0.0], [1.0, 0.0, 0.0], [3.0, 1.0, 0.0]];
        for start in 0..4 {
            let (faces, _) = cut(&dart, start);
            assert!(faces.iter().all(|face| face.contains(&0) && face.contains(&2)), "{start}: {faces:?}");
        }
    }

    #[test]
    fn a_fan_that_has_no_folds_is_kept_and_so_is_that_of_crossing_polygons() {
        let turn = |k: i32, step: f64| (f64::from(k) * step * std::f64::consts::TAU).sin_cos();
        // The polygons are a bent pentagon and a pentagram.
        for (step, bend) in [(0.2, 0.1), (0.4, 0.0)] {
            let polygon: Vec<Vec3> = (0..5).map(|k| turn(k, step)).map(|(y, x)| [x, y, bend * x * y]).collect();
            assert_eq!(cut(&polygon, 1).0, [[1, 2, 3], [1, 3, 4], [1, 4, 0]]);
        }
        // The polygons have all corners on a line, a missing vertex, or coordinates that aren't finite.
        let line: Vec<Vec3> = (0..4).map(|k| [f64::from(k), 0.0, 0.0]).collect();
        assert_eq!(cut(&line, 0).0, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(cut(&[[f64::NAN; 3]; 4], 0).0, [[0, 1, 2], [0, 2, 3]]);
        let mut triangles = Triangles::default();
        assert!(triangles.polygon(&[0, 1, 2, 9]) && !triangles.polygon(&[0, 1]));
        assert_eq!(triangles.cut(&L), [[0, 1, 2], [0, 2, 9]]);
    }

    #[test]
    fn a_strip_keeps_the_winding_of_its_first_triangle() {
        let mut faces = Vec::new();
        assert!(strip(&[0, 1, 2, 3, 4], &mut faces));
        assert_eq!(faces, [[0, 1, 2], [2, 1, 3], [2, 3, 4]]);
        // Two strips of two triangles each are joined by repeated corners.
        faces.clear();
        assert!(strip(&[0, 1, 2, 3, 3, 4, 4, 5, 6, 7], &mut faces));
        assert_eq!(faces, [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7]]);
        assert!(!strip(&[0, 1], &mut faces));
    }
}
