//! Prepares the maps of a test for a page.

use serde::Serialize;
use spharm_render::{Paint, Panel, is_probability, scale_label, significance, symmetric_range};

use crate::ReportError;
use crate::blocks::{Block, Blocks};
use crate::contents::Maps;
use crate::model_item::Drawn;
use crate::still::still;
use crate::text::number;

/// Significance level: vertices with a p value of at most this level are counted.
const LEVEL: f64 = 0.05;

/// Maps of a test, in the form in which the page's script reads them.
#[derive(Debug, Serialize)]
pub(crate) struct MapsItem {
    kind: &'static str,
    name: String,
    meaning: String,
    mesh: Drawn,
    maps: Vec<Map>,
}

#[derive(Debug, Serialize)]
struct Map {
    name: String,
    values: Block,
    /// Whether the values are p values or false-discovery rates, which are shown as logarithms.
    probability: bool,
    /// Values shown by the first and the last colour of the scale, before logarithms are taken.
    range: [f64; 2],
    /// Label of the colour scale.
    label: String,
}

impl MapsItem {
    /// Creates the item and its picture (PNG).
    pub(crate) fn new(test: &Maps, max_vertices: usize, blocks: &mut Blocks) -> Result<(Self, Vec<u8>), ReportError> {
        let expected = test.mesh.vertices.len();
        if expected > max_vertices {
            return Err(ReportError::TooLarge { name: test.name.clone(), found: expected, most: max_vertices });
        }
        for (map, values) in &test.maps {
            if values.len() != expected {
                let (name, map, found) = (test.name.clone(), map.clone(), values.len());
                return Err(ReportError::ValueCount { name, map, expected, found });
            }
        }
        // The picture uses the same colour ranges as the script.
        let has = |name: &str| test.maps.iter().any(|(other, _)| other == name);
        // The statistic and the effect size of a test have signs only if the test has a single effect. In F tests and
        // in tests of positions, they have no sign.
        let has_sign = |name: &str| has("effect") && ["effect", "statistic", "size"].contains(&name);
        let range = |name: &str, values: &[f64]| if has_sign(name) { symmetric(values) } else { range(values) };
        let shown = ["effect", "statistic", if has("p-tfce") { "p-tfce" } else { "p-fwe" }];
        let painted: Vec<(Vec<f64>, (f64, f64), String)> = test
            .maps
            .iter()
            .filter(|(name, _)| shown.contains(&name.as_str()))
            .map(|(name, values)| {
                let label = scale_label(name, is_probability(name), values, range(name, values));
                let (values, range) =
                    if is_probability(name) { significance(values) } else { (values.clone(), range(name, values)) };
                (values, range, label)
            })
            .collect();
        let mut panels: Vec<Panel<'_>> = painted
            .iter()
            .map(|(values, range, label)| Panel {
                paint: Paint::Scalar { values, range: *range, label },
                ..Panel::new(&test.mesh, "")
            })
            .collect();
        if panels.is_empty() {
            panels.push(Panel::new(&test.mesh, ""));
        }
        let still = still(&panels)?;
        let mut maps = Vec::new();
        for (name, values) in &test.maps {
            let probability = is_probability(name);
            let (low, high) = range(name, values);
            let label = scale_label(name, probability, values, (low, high));
            let values = blocks.f32(values.iter().copied());
            maps.push(Map { name: name.clone(), values, probability, range: [low, high], label });
        }
        let mesh = Drawn::new(&test.mesh, blocks);
        let (name, meaning) = (test.name.clone(), test.meaning.clone());
        Ok((Self { kind: "maps", name, meaning, mesh, maps }, still))
    }
}

/// Returns rows that describe the test and each map, for the table under the view.
pub(crate) fn rows(test: &Maps) -> Vec<(String, String)> {
    let mut rows = vec![("Vertices".to_owned(), test.mesh.vertices.len().to_string())];
    if !test.meaning.is_empty() {
        rows.insert(0, ("Tested".to_owned(), test.meaning.clone()));
    }
    rows.extend(test.about.iter().cloned());
    for (name, values) in &test.maps {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let (low, high) = finite().fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        let of = match finite().next() {
            None => "no finite value".to_owned(),
            Some(_) => format!("{} to {}", number(low), number(high)),
        };
        let below = finite().filter(|value| *value <= LEVEL).count();
        let text = if is_probability(name) { format!("{of}; at most {LEVEL} at {below} vertices") } else { of };
        let text = match explained(name) {
            Some(what) => format!("{what}: {text}"),
            None => text,
        };
        rows.push((name.clone(), text));
    }
    rows
}

/// Returns an explanation of a map of `spharm shape test`; `None` for other maps, and for maps with self-explanatory
/// names.
fn explained(name: &str) -> Option<&'static str> {
    Some(match name {
        "p" => "uncorrected p value",
        "q" => "false discovery rate over the vertices",
        "p-permutation" => "uncorrected p value by relabelling",
        "p-fwe" => "family-wise p value by relabelling",
        "tfce" => "statistic with threshold-free cluster enhancement",
        "p-tfce" => "family-wise p value with threshold-free cluster enhancement",
        "cluster" => "number of the cluster",
        "p-cluster" => "family-wise p value of the cluster's area",
        "statistic" => "statistic of the test at each vertex",
        "effect" => "difference or slope",
        "margin" => "half the width of the effect's confidence interval",
        "size" => "standardised effect",
        _ => return None,
    })
}

/// Returns a range that is symmetric about 0, computed from the finite values.
fn symmetric(values: &[f64]) -> (f64, f64) {
    symmetric_range(&values.iter().copied().filter(|value| value.is_finite()).collect::<Vec<_>>())
}

/// Returns a range symmetric about 0 if there are negative values, otherwise the range from the smallest to the
/// largest value.
fn range(values: &[f64]) -> (f64, f64) {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite().fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
    if low < 0.0 && high > f64::MIN {
        return symmetric(values);
    }
    if low < high { (low, high) } else { (0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use spharm_surface::generate::icosphere;

    use super::*;

    #[test]
    fn ranges_are_symmetric_where_signs_differ() {
        assert_eq!(range(&[-1.0, 3.0, f64::NAN]).0, -range(&[-1.0, 3.0]).1);
        assert_eq!(range(&[-3.0, -1.0]).0, -range(&[-3.0, -1.0]).1);
        assert_eq!(range(&[0.25, 0.5]), (0.25, 0.5));
        assert_eq!(range(&[f64::NAN]), (0.0, 1.0));
        assert_eq!(range(&[]), (0.0, 1.0));
    }

    #[test]
    fn effects_and_their_statistics_have_zero_in_the_middle() {
        let values: Vec<f64> = (1..=42).map(f64::from).collect();
        let ranges = |names: &[&str]| -> Vec<[f64; 2]> {
            let maps = names.iter().map(|name| ((*name).to_owned(), values.clone())).collect();
            let (name, mesh) = ("test".to_owned(), icosphere(1));
            let test = Maps { name, meaning: String::new(), about: Vec::new(), mesh, maps };
            let (item, _) = MapsItem::new(&test, 100, &mut Blocks::default()).unwrap();
            item.maps.iter().map(|map| map.range).collect()
        };
        let both = [-42.0, 42.0];
        assert_eq!(ranges(&["effect", "statistic", "margin"]), [both, both, [1.0, 42.0]]);
        assert_eq!(ranges(&["statistic", "effect-x"]), [[1.0, 42.0], [1.0, 42.0]], "no single effect, as in F tests");
    }

    #[test]
    fn maps_are_explained() {
        let maps = [("margin", 2.0), ("p-tfce", 0.01), ("other", 1.0)].map(|(name, x)| (name.to_owned(), vec![x; 12]));
        let (name, mesh, maps) = ("test".to_owned(), icosphere(0), maps.to_vec());
        let rows = rows(&Maps { name, meaning: String::new(), about: Vec::new(), mesh, maps });
        let text = |name: &str| rows.iter().find(|(key, _)| key == name).unwrap().1.as_str();
        assert!(text("margin").starts_with("half the width of the effect's confidence interval: 2"));
        assert!(text("p-tfce").starts_with("family-wise p value with threshold-free cluster enhancement: 0.01"));
        assert!(text("p-tfce").ends_with("at most 0.05 at 12 vertices") && text("other").starts_with('1'));
    }
}
