//! Creates the charts of a model: power by degree, truncation error by degree, and convergence of the fit.

use serde_json::Value;
use spharm_harmonics::Coefficients;

use crate::axis::Scale;
use crate::chart::{Chart, Line};

const SPHERE: f64 = 4.0 * std::f64::consts::PI;

/// Returns the chart of the power of each degree from 1 on, `sum_m a_lm^2 / (4 pi)`, per channel and in total.
pub(crate) fn spectrum(coefficients: &Coefficients) -> Option<String> {
    let names = [("x", "x"), ("y", "y"), ("z", "z"), ("all", "all")];
    let lines = names.iter().enumerate().map(|(channel, &(class, name))| {
        let points = (1..=coefficients.max_degree()).map(|l| [l as f64, power(coefficients, l, channel)]).collect();
        Line { class, name: name.to_owned(), points, ..Line::default() }
    });
    let lines = lines.collect();
    Chart {
        title: "Spectrum",
        x: "degree",
        y: "power by degree, length²",
        lines,
        scale: Scale::Logarithmic,
        marks: false,
    }
    .html()
}

/// Returns the chart of the truncation error: the root mean square distance caused by truncating the model after each
/// degree, computed by Parseval's identity.
pub(crate) fn detail(coefficients: &Coefficients) -> Option<String> {
    let degrees = coefficients.max_degree();
    let mut left_out = 0.0;
    let mut points: Vec<[f64; 2]> = (1..=degrees)
        .rev()
        .map(|l| {
            left_out += power(coefficients, l, 3);
            [(l - 1) as f64, left_out.sqrt()]
        })
        .collect();
    points.reverse();
    let lines = vec![Line { class: "all", name: String::new(), points, ..Line::default() }];
    let y = "rms distance caused by omitting higher degrees, length";
    Chart { title: "Truncation error", x: "highest degree", y, lines, scale: Scale::Logarithmic, marks: false }.html()
}

/// Returns the power of a degree in channel 0, 1 or 2, or the total power if `channel` is 3.
fn power(coefficients: &Coefficients, l: usize, channel: usize) -> f64 {
    let rows = l * l..(l + 1) * (l + 1);
    let values = coefficients.values();
    let square = |row: usize| {
        let of = |c: usize| values[[row, c]] * values[[row, c]];
        if channel < 3 { of(channel) } else { (0..3).map(of).sum() }
    };
    rows.map(square).sum::<f64>() / SPHERE
}

/// Returns the chart of the mean and the largest squared distance after each pass, from a surface's entry in the
/// report of `fit`; `None` for fewer than two passes.
pub(crate) fn convergence(entry: &Value) -> Option<String> {
    let passes = entry.get("passes")?.as_array()?;
    if passes.len() < 2 {
        return None;
    }
    let line = |class, name: &str, key: &str| {
        let value = |pass: &Value| pass.get(key).and_then(Value::as_f64).unwrap_or_default();
        let points = passes.iter().enumerate().map(|(i, pass)| [(i + 1) as f64, value(pass)]).collect();
        Line { class, name: name.to_owned(), points, ..Line::default() }
    };
    let lines = vec![line("x", "mean", "msd"), line("y", "largest", "xsd")];
    let y = "squared distance, bounding box scaled to volume 1";
    Chart { title: "Convergence", x: "pass", y, lines, scale: Scale::Logarithmic, marks: passes.len() <= 40 }.html()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn power_is_of_a_degree_and_a_channel() {
        let mut values = Array2::zeros((9, 3));
        (values[[1, 0]], values[[3, 1]], values[[5, 2]]) = (2.0, 1.0, 3.0);
        let coefficients = Coefficients::new(values).unwrap();
        let found = [(1, 0), (1, 1), (1, 3), (2, 2), (2, 3)].map(|(l, c)| power(&coefficients, l, c) * SPHERE);
        for (found, expected) in found.iter().zip([4.0, 1.0, 5.0, 9.0, 9.0]) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert!(spectrum(&coefficients).is_some() && detail(&coefficients).is_some());
        let point = Coefficients::new(Array2::ones((1, 3))).unwrap();
        assert!(spectrum(&point).is_none() && detail(&point).is_none());
    }

    #[test]
    fn fits_in_one_go_have_no_convergence() {
        let entry = |passes: usize| serde_json::json!({ "passes": vec![serde_json::json!({"msd": 1e-4, "xsd": 2e-3}); passes] });
        assert!(convergence(&entry(1)).is_none() && convergence(&serde_json::json!({})).is_none());
        assert!(convergence(&entry(3)).unwrap().contains("Convergence"));
    }
}
