//! Computes the normals at the vertices of a mesh.

/// Returns the unit normals at the vertices, (n, 3) row-major: area-weighted means of the normals of each vertex's
/// triangles, scaled to length 1, or zero if the mean is zero. Normals point outwards if triangles are
/// counter-clockwise seen from outside.
///
/// Triangles, (m, 3), must refer to existing vertices.
#[must_use]
pub fn vertex_normals(vertices: &[f64], faces: &[u32]) -> Vec<f32> {
    let mut sums = vec![0.0; vertices.len()];
    let point = |v: u32| {
        let at = 3 * v as usize;
        [vertices[at], vertices[at + 1], vertices[at + 2]]
    };
    for face in faces.chunks_exact(3) {
        let [a, b, c] = [point(face[0]), point(face[1]), point(face[2])];
        let (u, v) = (difference(b, a), difference(c, a));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        for &vertex in face {
            let at = 3 * vertex as usize;
            sums[at..at + 3].iter_mut().zip(normal).for_each(|(sum, part)| *sum += part);
        }
    }
    let mut normals = Vec::with_capacity(sums.len());
    for sum in sums.chunks_exact(3) {
        let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
        let factor = if length > 0.0 { 1.0 / length } else { 0.0 };
        normals.extend(sum.iter().map(|part| (part * factor) as f32));
    }
    normals
}

fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[cfg(test)]
mod tests {
    use super::vertex_normals;

    #[test]
    fn normals_of_a_tetrahedron_point_outwards() {
        let vertices = [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0, 1.0];
        let normals = vertex_normals(&vertices, &[0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 3, 2]);
        for (normal, vertex) in normals.iter().zip(vertices) {
            assert!((f64::from(*normal) - vertex / 3f64.sqrt()).abs() < 1e-7);
        }
        // The normals are zero at the corners of a triangle without area, and at vertices without triangles.
        assert_eq!(vertex_normals(&vertices, &[0, 0, 0]), [0.0; 12]);
    }
}
