//! Line charts with a logarithmic axis, as SVG without scripts or styles of its own: the page's style sheet gives lines their
//! colours, in light and dark.

use std::fmt::Write;

use crate::text::{escape, number};

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 250.0;
/// Left, right, top, bottom.
const MARGINS: [f64; 4] = [52.0, 12.0, 12.0, 38.0];
/// Values this far below the largest are left out: they are what rounding left.
const DECADES: f64 = 18.0;

/// A line: its class in the style sheet, its name, its points.
pub(crate) struct Line<'a> {
    pub(crate) class: &'static str,
    pub(crate) name: &'a str,
    /// x and y; where y isn't above 0 there is no point.
    pub(crate) points: Vec<[f64; 2]>,
}

/// A chart.
pub(crate) struct Chart<'a> {
    pub(crate) title: &'a str,
    pub(crate) x: &'a str,
    pub(crate) y: &'a str,
    pub(crate) lines: Vec<Line<'a>>,
    /// Whether points are marked: where they are few.
    pub(crate) marks: bool,
}

impl Chart<'_> {
    /// The figure; none where no line has a point.
    pub(crate) fn html(&self) -> Option<String> {
        let top = self.points().map(|p| p[1]).fold(0.0_f64, f64::max);
        let floor = top * 10f64.powf(-DECADES);
        let low = self.points().map(|p| p[1]).filter(|y| *y >= floor).fold(top, f64::min);
        if top <= 0.0 {
            return None;
        }
        let (bottom, mut upper) = (low.log10().floor(), top.log10().ceil());
        if upper <= bottom {
            upper = bottom + 1.0;
        }
        let (left, right) = self.points().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[0]), b.max(p[0])));
        let span = if right > left { right - left } else { 1.0 };
        let [ml, mr, mt, mb] = MARGINS;
        let at_x = |x: f64| ml + (x - left) / span * (WIDTH - ml - mr);
        let at_y = |y: f64| HEIGHT - mb - (y.log10() - bottom) / (upper - bottom) * (HEIGHT - mt - mb);

        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
            escape(&format!("{}: {} by {}", self.title, self.y, self.x))
        );
        // Writing to a string doesn't fail.
        let mut put = |text: std::fmt::Arguments<'_>| {
            let _ = svg.write_fmt(text);
        };
        let step = ((upper - bottom) / 6.0).ceil().max(1.0);
        let mut exponent = bottom;
        while exponent <= upper {
            let y = at_y(10f64.powf(exponent));
            put(format_args!(
                "<line class=\"grid\" x1=\"{ml}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>",
                WIDTH - mr
            ));
            put(format_args!(
                "<text class=\"tick end\" x=\"{}\" y=\"{:.1}\">10<tspan class=\"power\" dy=\"-5\">{exponent}</tspan></text>",
                ml - 6.0,
                y + 4.0
            ));
            exponent += step;
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
            let mut path = String::new();
            let mut pen = 'M';
            for &[x, y] in &line.points {
                if y < floor || y <= 0.0 || !y.is_finite() {
                    pen = 'M';
                    continue;
                }
                let _ = write!(path, "{pen}{:.1} {:.1}", at_x(x), at_y(y));
                pen = 'L';
                if self.marks {
                    put(format_args!(
                        "<circle class=\"{}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\"/>",
                        line.class,
                        at_x(x),
                        at_y(y)
                    ));
                }
            }
            put(format_args!("<path class=\"{}\" d=\"{path}\"/>", line.class));
        }
        svg.push_str("</svg>");
        let keys: String =
            self.lines.iter().map(|line| format!("<li class=\"{}\">{}</li>", line.class, escape(line.name))).collect();
        let keys = if self.lines.len() > 1 { format!("<ul class=\"keys\">{keys}</ul>") } else { String::new() };
        Some(format!(
            "<figure class=\"chart\"><figcaption><strong>{}</strong> {}</figcaption>{keys}{svg}</figure>",
            escape(self.title),
            escape(self.y)
        ))
    }

    fn points(&self) -> impl Iterator<Item = &[f64; 2]> {
        self.lines.iter().flat_map(|line| &line.points).filter(|p| p[1] > 0.0 && p[1].is_finite())
    }
}

/// Round numbers between two, at most six.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let span = high - low;
    if span <= 0.0 {
        return vec![low];
    }
    let power = 10f64.powf((span / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    // Degrees and passes are whole.
    let step = steps.into_iter().find(|step| span / step <= 5.0).unwrap_or(span).max(1.0);
    let first = (low / step).ceil() as i64;
    (first..=(high / step).floor() as i64).map(|k| k as f64 * step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<[f64; 2]>) -> Chart<'static> {
        let lines = vec![Line { class: "a", name: "<b>", points }];
        Chart { title: "power", x: "degree", y: "mm²", lines, marks: true }
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
    fn ticks_are_round() {
        assert_eq!(ticks(1.0, 100.0), [20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(ticks(1.0, 2.0), [1.0, 2.0]);
        assert_eq!(ticks(3.0, 3.0), [3.0]);
    }
}
