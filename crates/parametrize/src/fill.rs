//! Fills in missing vertex values from the known values around them.
//!
//! The filled values are harmonic on the graph of the mesh's edges: each value is the mean of its neighbours' values,
//! and lies between the smallest and the largest known value at the border of its gap. Without filled values, a
//! least-squares model of high degree isn't determined inside a gap (a region of vertices without values) and can
//! oscillate there without bound.

use spharm_monitor::Monitor;

use crate::ParametrizeError;
use crate::sparse_cholesky::Symbolic;

/// Marks a vertex with a known value in the list `places`. For each of the other vertices, the list contains the index
/// of the vertex's unknown in the linear system.
const KNOWN: u32 = u32::MAX;

/// Fills in the values of the vertices for which `known` (n) is false. `values` (n, `channels`) is row-major; its
/// entries for these vertices are overwritten without being read.
///
/// Cost: O(m^1.5) flops for a sparse factorisation with m unknowns, one per missing vertex.
///
/// # Errors
///
/// [`ParametrizeError::Unfilled`] if a vertex without a value isn't connected by edges to a vertex with a value;
/// [`ParametrizeError::Interrupted`].
///
/// # Panics
///
/// When lengths differ, or a triangle's index is out of range.
pub fn fill_in(
    values: &mut [f64],
    channels: usize,
    known: &[bool],
    faces: &[[u32; 3]],
    monitor: &dyn Monitor,
) -> Result<(), ParametrizeError> {
    assert_eq!(values.len(), channels * known.len(), "expected one value per vertex and channel");
    let unknown: Vec<usize> = (0..known.len()).filter(|&v| !known[v]).collect();
    if unknown.is_empty() || channels == 0 {
        return Ok(());
    }
    let mut places = vec![KNOWN; known.len()];
    unknown.iter().zip(0..).for_each(|(&v, place)| places[v] = place);
    let neighbours = neighbours(&places, unknown.len(), faces);
    let (mut starts, mut columns, mut blocks) = (vec![0], Vec::new(), Vec::new());
    for (row, around) in neighbours.iter().enumerate() {
        columns.push(row as u32);
        blocks.push([around.len() as f64]);
        for &v in around.iter().filter(|&&v| places[v as usize] != KNOWN) {
            columns.push(places[v as usize]);
            blocks.push([-1.0]);
        }
        starts.push(columns.len() as u32);
    }
    let unfilled = || ParametrizeError::Unfilled { vertices: unknown.len() };
    if !reaches_all(&neighbours, &places) {
        return Err(unfilled());
    }
    let symbolic = Symbolic::new(1, &starts, &columns, monitor)?.ok_or_else(unfilled)?;
    let factor = symbolic.factor(&starts, &columns, blocks, monitor)?.ok_or_else(unfilled)?;
    for channel in 0..channels {
        let value = |v: u32| values[channels * v as usize + channel];
        let at_edge =
            |around: &Vec<u32>| around.iter().filter(|&&v| places[v as usize] == KNOWN).map(|&v| value(v)).sum();
        let mut x: Vec<f64> = neighbours.iter().map(at_edge).collect();
        factor.solve(&mut x);
        unknown.iter().zip(x).for_each(|(&v, x)| values[channels * v + channel] = x);
    }
    Ok(())
}

/// Returns the neighbours of each vertex without a value, without duplicates.
fn neighbours(places: &[u32], unknown: usize, faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); unknown];
    for face in faces {
        for k in 0..3 {
            let place = places[face[k] as usize];
            if place != KNOWN {
                neighbours[place as usize].extend([face[(k + 1) % 3], face[(k + 2) % 3]]);
            }
        }
    }
    for (row, around) in neighbours.iter_mut().enumerate() {
        // A triangle that uses a vertex twice makes the vertex its own neighbour, which is removed here.
        around.retain(|&v| places[v as usize] != row as u32);
        around.sort_unstable();
        around.dedup();
    }
    neighbours
}

/// Returns whether every vertex without a value is connected to a vertex with a value.
fn reaches_all(neighbours: &[Vec<u32>], places: &[u32]) -> bool {
    let is_edge = |around: &Vec<u32>| around.iter().any(|&v| places[v as usize] == KNOWN);
    let mut reached: Vec<bool> = neighbours.iter().map(is_edge).collect();
    let mut left: Vec<usize> = (0..reached.len()).filter(|&row| reached[row]).collect();
    while let Some(row) = left.pop() {
        for &v in &neighbours[row] {
            let place = places[v as usize];
            if place != KNOWN && !std::mem::replace(&mut reached[place as usize], true) {
                left.push(place as usize);
            }
        }
    }
    reached.into_iter().all(|reached| reached)
}

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;

    use super::*;

    #[test]
    fn filled_values_are_their_neighbours_mean_and_known_ones_stay() {
        let sphere = icosphere(3);
        let known: Vec<bool> = sphere.vertices.iter().map(|p| p[2] < 0.6 && p[0] < 0.95).collect();
        // Unknown values are NaN, which would spread if they were read.
        let value = |(p, known): (&[f64; 3], &bool)| if *known { [p[0], 4.0] } else { [f64::NAN, f64::NAN] };
        let mut values = sphere.vertices.iter().zip(&known).map(value).collect::<Vec<_>>().into_flattened();
        // A triangle that uses a vertex twice must not change the result.
        let mut faces = sphere.faces.clone();
        let of_unknown = faces.iter().find(|face| !known[face[0] as usize]).unwrap();
        faces.push([of_unknown[0], of_unknown[0], of_unknown[1]]);
        fill_in(&mut values, 2, &known, &faces, &Silent).unwrap();
        let everywhere: Vec<u32> = (0..known.len() as u32).collect();
        let around = neighbours(&everywhere, known.len(), &sphere.faces);
        for (v, p) in sphere.vertices.iter().enumerate() {
            let mean = around[v].iter().map(|&w| values[2 * w as usize]).sum::<f64>() / around[v].len() as f64;
            if known[v] {
                assert_eq!(values[2 * v..2 * v + 2], [p[0], 4.0]);
            } else {
                assert!((values[2 * v] - mean).abs() < 1e-13 && (values[2 * v + 1] - 4.0).abs() < 1e-13, "{v}");
            }
        }
    }

    #[test]
    fn unconnected_vertices_are_refused() {
        let sphere = icosphere(1);
        let mut values = vec![1.0; sphere.vertices.len()];
        let none = vec![false; values.len()];
        let error = fill_in(&mut values, 1, &none, &sphere.faces, &Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::Unfilled { vertices: 42 }), "{error}");
        fill_in(&mut values, 1, &vec![true; none.len()], &[], &Silent).unwrap();
    }
}
