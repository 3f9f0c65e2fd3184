//! Scales meshes to the size of other meshes, and values to a range of colours.

use spharm_surface::Mesh;

/// Percentile of the absolute values that limits the colour range: the range extends to at most twice this percentile.
/// Without a limit, a few large values would take up most of the range.
const PERCENTILE: usize = 99;

/// Returns a mesh that is scaled and moved so that its bounding box has the same largest extent and the same centre as
/// the bounding box of another mesh.
#[must_use]
pub fn fit_into(mesh: &Mesh, other: &Mesh) -> Mesh {
    let span = |mesh: &Mesh, axis: usize| {
        let values = mesh.vertices.iter().map(|p| p[axis]);
        values.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)))
    };
    let (from, to) = ([0, 1, 2].map(|axis| span(mesh, axis)), [0, 1, 2].map(|axis| span(other, axis)));
    let widest = |spans: [(f64, f64); 3]| spans.iter().map(|(low, high)| high - low).fold(f64::MIN_POSITIVE, f64::max);
    let factor = widest(to) / widest(from);
    let middle = |(low, high): (f64, f64)| 0.5 * (low + high);
    let place = |p: &[f64; 3]| [0, 1, 2].map(|k| middle(to[k]) + factor * (p[k] - middle(from[k])));
    mesh.with_vertices(mesh.vertices.iter().map(place).collect())
}

/// Returns a range symmetric about 0 that contains all values, but extends to at most twice the 99th percentile of the
/// absolute values.
#[must_use]
pub fn symmetric_range(values: &[f64]) -> (f64, f64) {
    let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    let at = sizes.len().saturating_sub(1) * PERCENTILE / 100;
    let largest = sizes.last().copied().unwrap_or_default();
    let bound = sizes.get(at).map(|size| 2.0 * size).filter(|bound| *bound > 0.0);
    let most = bound.map_or(largest, |bound| largest.min(bound)).max(f64::MIN_POSITIVE);
    (-most, most)
}

/// Returns whether a map with this name contains p values or false-discovery rates. Examples of such names are `p`, `q`
/// and `p-fwe`.
#[must_use]
pub fn is_probability(name: &str) -> bool {
    name == "p" || name == "q" || name.starts_with("p-")
}

/// Returns -log10 of p values, and the range from 0 to the largest of these numbers, or to 1 if they are all smaller.
/// Significant values have the colours at the upper end of the scale.
#[must_use]
pub fn significance(p: &[f64]) -> (Vec<f64>, (f64, f64)) {
    let values: Vec<f64> = p.iter().map(|p| if p.is_nan() { *p } else { -p.max(1e-300).log10() }).collect();
    let most = values.iter().copied().fold(1.0, f64::max);
    (values, (0.0, most))
}

/// Returns the label of a map's scale: the name of the map, preceded by `-log10` for probabilities, or followed by the
/// number of values that lie beyond the range.
#[must_use]
pub fn scale_label(name: &str, probability: bool, values: &[f64], (low, high): (f64, f64)) -> String {
    if probability {
        return format!("-log10 {name}");
    }
    let beyond = values.iter().filter(|value| **value < low || **value > high).count();
    if beyond == 0 { name.to_owned() } else { format!("{name}, {beyond} of {} values clipped", values.len()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_significant_has_the_last_colour() {
        let (values, range) = significance(&[1.0, 0.001, 0.0, f64::NAN]);
        assert_eq!((values[0], range), (0.0, (0.0, 300.0)));
        assert!((values[1] - 3.0).abs() < 1e-12 && values[3].is_nan());
        assert_eq!(significance(&[0.5]).1, (0.0, 1.0));
        assert!(is_probability("p-fwe") && is_probability("q") && !is_probability("power"));
        assert_eq!(scale_label("p-fwe", true, &[0.5], (0.0, 1.0)), "-log10 p-fwe");
        assert_eq!(scale_label("effect", false, &[0.5, -0.5], (-0.5, 0.5)), "effect");
        assert_eq!(scale_label("effect", false, &[0.5, 2.0], (-1.0, 1.0)), "effect, 1 of 2 values clipped");
    }

    #[test]
    fn a_mesh_takes_the_place_of_another() {
        let mesh = |vertices: &[[f64; 3]]| Mesh::new(vertices.to_vec(), Vec::new());
        let found = fit_into(&mesh(&[[-1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]), &mesh(&[[10.0, 5.0, 5.0], [14.0, 5.0, 5.0]]));
        assert_eq!(found.vertices, [[10.0, 4.0, 5.0], [14.0, 6.0, 5.0]]);
    }

    #[test]
    fn few_large_values_do_not_widen_the_range() {
        let mut values = vec![-2.0; 200];
        values[7] = 1e9;
        assert_eq!(symmetric_range(&values), (-4.0, 4.0));
        let mut sparse = vec![0.0; 200];
        sparse[3] = -5.0;
        assert_eq!(symmetric_range(&sparse), (-5.0, 5.0));
        values[7] = 3.0;
        assert_eq!(symmetric_range(&values), (-3.0, 3.0));
        assert_eq!(symmetric_range(&[]), (-f64::MIN_POSITIVE, f64::MIN_POSITIVE));
    }
}
