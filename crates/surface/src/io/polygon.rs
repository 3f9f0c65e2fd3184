//! Splits polygons and strips into triangles.

/// Splits a polygon into triangles that share its first corner, and adds them to `faces`.
///
/// The triangles have the polygon's winding, and no vertex is added. If the polygon isn't convex, triangles may
/// overlap, which affects the geometry but not the topology. Returns `false` for fewer than three corners.
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

/// Splits a strip into triangles, each of three successive corners, and adds them to `faces`. Returns `false` for fewer
/// than three corners.
///
/// Every second triangle is reversed, so that all have the winding of the first. Triangles that repeat a corner are
/// dropped: exporters insert them to join several strips into one.
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

    #[test]
    fn a_strip_keeps_the_winding_of_its_first_triangle() {
        let mut faces = Vec::new();
        assert!(strip(&[0, 1, 2, 3, 4], &mut faces));
        assert_eq!(faces, [[0, 1, 2], [2, 1, 3], [2, 3, 4]]);
        // The same quadrangles as two strips joined by repeated corners.
        faces.clear();
        assert!(strip(&[0, 1, 2, 3, 3, 4, 4, 5, 6, 7], &mut faces));
        assert_eq!(faces, [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7]]);
        assert!(!strip(&[0, 1], &mut faces));
    }
}
