//! Draws line charts as SVG without scripts or embedded styles. The page's style sheet defines the colours of the lines
//! for light and dark mode.

use std::fmt::Write;

use crate::axis::{Axis, Scale};
use crate::text::{escape, number};

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 250.0;
/// Margins of a chart around its axes, in SVG units: left, right, top, bottom.
const MARGINS: [f64; 4] = [52.0, 12.0, 12.0, 38.0];

/// A line of a chart.
#[derive(Default)]
pub(crate) struct Line {
    pub(crate) class: &'static str,
    pub(crate) name: String,
    /// Points (x, y) of the line; points whose y can't be shown on the axis are skipped.
    pub(crate) points: Vec<[f64; 2]>,
    /// Band around the line, as triples of x and the lowest and highest y at x; may be empty.
    pub(crate) band: Vec<[f64; 3]>,
}

/// A line chart with axes.
pub(crate) struct Chart<'a> {
    pub(crate) title: &'a str,
    pub(crate) x: &'a str,
    pub(crate) y: &'a str,
    pub(crate) lines: Vec<Line>,
    pub(crate) scale: Scale,
    /// Whether points are marked by circles; suitable for a small number of points.
    pub(crate) marks: bool,
}

impl Chart<'_> {
    /// Returns the chart as an HTML figure; `None` if no value is above 0.
    pub(crate) fn html(&self) -> Option<String> {
        let axis = Axis::new(self.scale, || self.points().map(|p| p[1]))?;
        let (left, right) = self.points().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[0]), b.max(p[0])));
        let span = if right > left { right - left } else { 1.0 };
        let [ml, mr, mt, mb] = MARGINS;
        let at_x = |x: f64| ml + (x - left) / span * (WIDTH - ml - mr);
        let on_height = |share: f64| HEIGHT - mb - share * (HEIGHT - mt - mb);

        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
            escape(&format!("{}: {} by {}", self.title, self.y, self.x))
        );
        // Writing to a string never fails.
        let mut put = |text: std::fmt::Arguments<'_>| {
            let _ = svg.write_fmt(text);
        };
        for (share, label) in axis.ticks() {
            let y = on_height(share);
            put(format_args!(
                "<line class=\"grid\" x1=\"{ml}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>",
                WIDTH - mr
            ));
            put(format_args!("<text class=\"tick end\" x=\"{}\" y=\"{:.1}\">{label}</text>", ml - 6.0, y + 4.0));
        }
        for x in ticks(left, right) {
            put(format_args!(
                "<text class=\"tick middle\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                at_x(x),
                HEIGHT - mb + 16.0,
                number(x)
            ));
        }
        put(format_args!(
            "<text class=\"axis middle\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            0.5 * (ml + WIDTH - mr),
            HEIGHT - 4.0,
            escape(self.x)
        ));
        for line in &self.lines {
            let edge = |k: usize, of: &[f64; 3]| {
                axis.share(of[k]).map(|share| format!("{:.1},{:.1}", at_x(of[0]), on_height(share)))
            };
            let (low, high) = (line.band.iter().map(|of| edge(1, of)), line.band.iter().rev().map(|of| edge(2, of)));
            // A band is drawn only if all its corners can be shown.
            if let Some(corners) = low.chain(high).collect::<Option<Vec<_>>>().filter(|corners| !corners.is_empty()) {
                put(format_args!("<polygon class=\"{}\" points=\"{}\"/>", line.class, corners.join(" ")));
            }
        }
        for line in &self.lines {
            let mut path = String::new();
            let mut pen = 'M';
            for &[x, y] in &line.points {
                let Some(share) = axis.share(y) else {
                    pen = 'M';
                    continue;
                };
                let _ = write!(path, "{pen}{:.1} {:.1}", at_x(x), on_height(share));
                pen = 'L';
                if self.marks {
                    put(format_args!(
                        "<circle class=\"{}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\"/>",
                        line.class,
                        at_x(x),
                        on_height(share)
                    ));
                }
            }
            put(format_args!("<path class=\"{}\" d=\"{path}\"/>", line.class));
        }
        svg.push_str("</svg>");
        let keys: String =
            self.lines.iter().map(|line| format!("<li class=\"{}\">{}</li>", line.class, escape(&line.name))).collect();
        let keys = if self.lines.len() > 1 { format!("<ul class=\"keys\">{keys}</ul>") } else { String::new() };
        Some(format!(
            "<figure class=\"chart\"><figcaption><strong>{}</strong> {}</figcaption>{keys}{svg}</figure>",
            escape(self.title),
            escape(self.y)
        ))
    }

    fn points(&self) -> impl Iterator<Item = &[f64; 2]> {
        self.lines.iter().flat_map(|line| &line.points).filter(|p| self.scale.has(p[1]))
    }
}

/// Returns at most six round numbers between two values, for ticks.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let span = high - low;
    if span <= 0.0 {
        return vec![low];
    }
    let power = 10f64.powf((span / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    // The step is at least 1, because degrees and passes are integers.
    let step = steps.into_iter().find(|step| span / step <= 5.0).unwrap_or(span).max(1.0);
    let first = (low / step).ceil() as i64;
    (first..=(high / step).floor() as i64).map(|k| k as f64 * step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<[f64; 2]>) -> Chart<'static> {
        let lines = vec![Line { class: "a", name: "<b>".to_owned(), points, ..Line::default() }];
        Chart { title: "power", x: "degree", y: "mm²", lines, scale: Scale::Logarithmic, marks: true }
    }

    #[test]
    fn a_chart_has_its_points_within_its_frame() {
        let html = chart((1..=100).map(|l| [f64::from(l), f64::from(l).powi(-4)]).collect()).html().unwrap();
        let numbers = html.split("d=\"M").nth(1).unwrap().split('"').next().unwrap();
        let numbers: Vec<f64> = numbers.split(['L', ' ']).map(|number| number.parse().unwrap()).collect();
        assert_eq!(numbers.len(), 200);
        assert!(numbers.chunks(2).all(|p| (0.0..=WIDTH).contains(&p[0]) && (0.0..=HEIGHT).contains(&p[1])));
        assert!(numbers[1] < numbers[199], "falling values go down");
    }

    #[test]
    fn values_that_have_no_logarithm_are_left_out() {
        assert!(chart(vec![[0.0, 0.0], [1.0, f64::NAN], [2.0, -1.0]]).html().is_none());
        let html = chart(vec![[0.0, 1.0], [1.0, 0.0], [2.0, 1.0]]).html().unwrap();
        let path = html.split("d=\"").nth(1).unwrap().split('"').next().unwrap();
        assert_eq!(path.matches('M').count(), 2, "{path}");
        assert!(chart(vec![[1.0, 3.0]]).html().unwrap().matches("<circle").count() == 1);
    }

    #[test]
    fn a_band_is_about_its_line() {
        let points = vec![[1.0, 2.0], [2.0, 1.0]];
        let band = vec![[1.0, 1.5, 2.5], [2.0, 0.0, 2.0]];
        let lines = vec![Line { class: "x", name: String::new(), points, band }];
        let mut chart = Chart { title: "t", x: "x", y: "y", lines, scale: Scale::Linear, marks: false };
        let html = chart.html().unwrap();
        let corners = html.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        let corners: Vec<f64> = corners.split([',', ' ']).map(|number| number.parse().unwrap()).collect();
        assert_eq!(corners.len(), 8);
        assert!(corners[1] > corners[7] && corners[3] > corners[5], "the lower edge first, and back: {corners:?}");
        chart.lines[0].band[0][1] = f64::NAN;
        assert!(!chart.html().unwrap().contains("polygon"));
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(1.0, 100.0), [20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(ticks(1.0, 2.0), [1.0, 2.0]);
        assert_eq!(ticks(3.0, 3.0), [3.0]);
    }
}
