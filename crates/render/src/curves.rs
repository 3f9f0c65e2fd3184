//! Draws panels of curves, with bands around them, over integers on the x axis, such as quality measures against the
//! number of modes.
//!
//! Curves and bands are anti-aliased: a curve's coverage of a pixel follows from its distance from the pixel's
//! centre, and a band's coverage from the fraction of the pixel's height that it covers.

use crate::RenderError;
use crate::image::Image;
use crate::text::Label;

/// A curve over the integers 1 to m, and its band.
#[derive(Clone, Copy, Debug)]
pub struct Curve<'a> {
    /// Name of the curve in the legend.
    pub label: &'a str,
    /// Values of the curve at the integers 1 to m; an array of length m.
    pub values: &'a [f64],
    /// Lower and upper bounds of the curve's band: two arrays of length m, or empty.
    pub band: [&'a [f64]; 2],
}

/// A panel: axes with curves.
#[derive(Clone, Debug)]
pub struct CurvePanel<'a> {
    /// Title above the panel.
    pub title: &'a str,
    /// Label of the x axis.
    pub x_label: &'a str,
    /// Curves of the panel, to which colours are assigned in order.
    pub curves: Vec<Curve<'a>>,
}

/// Colours that colour-blind people can distinguish (B. Wong, Nature Methods 8, 2011).
const COLORS: [[u8; 3]; 4] = [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167]];
const INK: [u8; 3] = [51, 51, 51];
const GRID: [u8; 3] = [226, 226, 226];
/// Width and height of a panel in pixels.
const PANEL: [usize; 2] = [520, 400];
/// Margins around the axes of a panel in pixels: left, right, top, bottom.
const MARGINS: [usize; 4] = [78, 20, 44, 62];
const TEXT: f64 = 18.0;
/// Half of a curve's width, in pixels.
const HALF: f64 = 1.3;

/// Draws panels side by side.
///
/// # Errors
///
/// [`RenderError::NoPanels`] if there are no panels; [`RenderError::Size`] if there are more than 31.
pub fn render_curves(panels: &[CurvePanel<'_>]) -> Result<Image, RenderError> {
    if panels.is_empty() {
        return Err(RenderError::NoPanels);
    }
    let (width, height) = (PANEL[0] * panels.len(), PANEL[1]);
    if width > 16_384 {
        return Err(RenderError::Size { width, height });
    }
    let mut picture = Image::filled(width, height, [255; 3]);
    for (index, panel) in panels.iter().enumerate() {
        Axes::of(panel, index * PANEL[0]).draw(&mut picture, panel);
    }
    Ok(picture)
}

/// Converts values on the axes to pixels.
struct Axes {
    /// Area of the axes in pixels: left, right, top, bottom.
    area: [f64; 4],
    /// Last integer on the x axis.
    last: usize,
    /// Highest value on the y axis.
    top: f64,
    /// Distance between the ticks on the y axis.
    step: f64,
}

impl Axes {
    fn of(panel: &CurvePanel<'_>, left: usize) -> Self {
        let all = panel.curves.iter().flat_map(|curve| curve.values.iter().chain(curve.band[1]));
        let highest = all.copied().filter(|value| value.is_finite()).fold(0.0, f64::max);
        let step = tick_step(highest);
        let [a, b, c, d] = MARGINS;
        let area = [left + a, left + PANEL[0] - b, c, PANEL[1] - d].map(|x| x as f64);
        let last = panel.curves.iter().map(|curve| curve.values.len()).max().unwrap_or(0).max(2);
        Self { area, last, top: (highest / step * (1.0 - 1e-9)).ceil().max(1.0) * step, step }
    }

    fn x(&self, number: f64) -> f64 {
        let [left, right, ..] = self.area;
        left + 12.0 + (number - 1.0) / (self.last - 1) as f64 * (right - left - 24.0)
    }

    fn y(&self, value: f64) -> f64 {
        let [_, _, top, bottom] = self.area;
        bottom - (value / self.top).clamp(-0.02, 1.02) * (bottom - top)
    }

    fn draw(&self, picture: &mut Image, panel: &CurvePanel<'_>) {
        let [left, right, top, bottom] = self.area;
        let ticks = (self.top / self.step).round() as usize;
        for tick in 0..=ticks {
            let value = tick as f64 * self.step;
            let y = self.y(value);
            for x in left as usize..right as usize {
                picture.set(x, y.round() as usize, GRID);
            }
            let digits = (-self.step.log10().floor()).clamp(0.0, 12.0) as usize;
            let text = if self.step < 1e6 { format!("{value:.digits$}") } else { format!("{value:.1e}") };
            Label::new(&text, TEXT).ending(picture, left as usize - 8, (y - 0.55 * TEXT).max(0.0) as usize, INK);
        }
        for number in (1..=self.last).step_by(self.last.div_ceil(12)) {
            let at = self.x(number as f64) as usize;
            Label::new(&number.to_string(), TEXT).centred(picture, at, bottom as usize + 8, INK);
        }
        for y in top as usize..=bottom as usize {
            picture.set(left as usize, y, INK);
        }
        for x in left as usize..=right as usize {
            picture.set(x, bottom as usize, INK);
        }
        let middle = (0.5 * (left + right)) as usize;
        Label::new(panel.title, 1.15 * TEXT).centred(picture, middle, 10, INK);
        Label::new(panel.x_label, TEXT).centred(picture, middle, bottom as usize + 32, INK);
        for (curve, color) in panel.curves.iter().zip(COLORS.iter().cycle()) {
            self.band(picture, curve.band, *color);
        }
        for (curve, color) in panel.curves.iter().zip(COLORS.iter().cycle()) {
            self.curve(picture, curve.values, *color);
        }
        if panel.curves.len() > 1 {
            self.legend(picture, panel);
        }
    }

    fn band(&self, picture: &mut Image, [low, high]: [&[f64]; 2], color: [u8; 3]) {
        for column in self.area[0] as usize..self.area[1] as usize {
            let at = |values: &[f64]| self.at(values, column as f64 + 0.5).map(|value| self.y(value));
            let (Some(under), Some(over)) = (at(low), at(high)) else { continue };
            for row in over.floor().max(0.0) as usize..=under.ceil() as usize {
                let (from, to) = (over.max(row as f64), under.min(row as f64 + 1.0));
                picture.blend(column, row, color, 0.2 * (to - from).clamp(0.0, 1.0));
            }
        }
    }

    /// Returns the value of a curve at a column of pixels, linearly interpolated; `None` beyond the curve's ends.
    fn at(&self, values: &[f64], column: f64) -> Option<f64> {
        let [left, right, ..] = self.area;
        let number = (column - left - 12.0) / (right - left - 24.0) * (self.last - 1) as f64;
        let (below, rest) = (number.floor(), number - number.floor());
        let value = |index: f64| (index >= 0.0).then(|| values.get(index as usize).copied()).flatten();
        Some((1.0 - rest) * value(below)? + rest * value(below + 1.0)?).filter(|value| value.is_finite())
    }

    fn curve(&self, picture: &mut Image, values: &[f64], color: [u8; 3]) {
        let places: Vec<[f64; 2]> =
            values.iter().enumerate().map(|(k, value)| [self.x(k as f64 + 1.0), self.y(*value)]).collect();
        let places: Vec<[f64; 2]> = places.into_iter().filter(|place| place[1].is_finite()).collect();
        places.windows(2).for_each(|ends| stroke(picture, ends[0], ends[1], HALF, color));
        places.iter().for_each(|place| stroke(picture, *place, *place, 4.0, color));
    }

    /// Draws the legend in the corner that the curves usually leave empty: at the bottom right if the first curve
    /// rises, otherwise at the top right.
    fn legend(&self, picture: &mut Image, panel: &CurvePanel<'_>) {
        let rising = panel.curves.first().is_some_and(|curve| curve.values.first() < curve.values.last());
        let count = panel.curves.len() as f64;
        let first = if rising { self.area[3] - (count + 0.6) * 1.4 * TEXT } else { self.area[2] + 4.0 };
        for (line, (curve, color)) in panel.curves.iter().zip(COLORS.iter().cycle()).enumerate() {
            let y = first + line as f64 * 1.4 * TEXT;
            let (right, middle) = (self.area[1] - 8.0, y + 0.6 * TEXT);
            stroke(picture, [right - 26.0, middle], [right, middle], HALF, *color);
            Label::new(curve.label, TEXT).ending(picture, right as usize - 34, y as usize, INK);
        }
    }
}

/// Returns a step between ticks of 1, 2 or 5 times a power of ten, such that about five steps reach the highest value.
fn tick_step(highest: f64) -> f64 {
    if highest <= 0.0 {
        return 1.0;
    }
    let rough = highest / 5.0;
    let power = 10.0_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * power
}

/// Draws a line segment, or a disc if both ends coincide; `half` is half of its width in pixels.
fn stroke(picture: &mut Image, a: [f64; 2], b: [f64; 2], half: f64, color: [u8; 3]) {
    let along = [b[0] - a[0], b[1] - a[1]];
    let square = along[0] * along[0] + along[1] * along[1];
    let range = |i: usize| {
        let (low, high) = (a[i].min(b[i]) - half - 1.0, a[i].max(b[i]) + half + 1.0);
        low.max(0.0) as usize..=high.max(0.0) as usize
    };
    for y in range(1) {
        for x in range(0) {
            let p = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
            let t = if square > 0.0 { ((p[0] * along[0] + p[1] * along[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
            let off = (p[0] - t * along[0]).hypot(p[1] - t * along[1]);
            let coverage = half + 0.5 - off;
            if coverage > 0.0 {
                picture.blend(x, y, color, coverage);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_drawn_where_their_values_are() {
        let values = [10.0, 5.0, 5.0];
        let curve = Curve { label: "a", values: &values, band: [&[8.0, 4.0, 4.0], &[10.0, 6.0, 6.0]] };
        let panel = CurvePanel { title: "t", x_label: "x", curves: vec![curve] };
        let picture = render_curves(&[panel.clone(), panel.clone()]).unwrap();
        assert_eq!((picture.width, picture.height), (1040, 400));
        let axes = Axes::of(&panel, 0);
        assert_eq!((axes.top, axes.step), (10.0, 2.0));
        let at = |picture: &Image, x: f64, y: f64| picture.get(x as usize, y as usize);
        assert_eq!(at(&picture, axes.x(2.5), axes.y(5.0)), COLORS[0]);
        // The first point is within the band but not on the curve. The second point is outside of both.
        let [band, above] = [4.5, 7.5].map(|value| at(&picture, axes.x(2.6), axes.y(value)));
        assert!(band[0] < 230 && band[2] > band[0] && band != COLORS[0], "{band:?}");
        assert_eq!(above, [255; 3]);
        // The second panel shows the same curve as the first.
        assert_eq!(at(&picture, 520.0 + axes.x(2.5), axes.y(5.0)), COLORS[0]);
        assert!(matches!(render_curves(&[]), Err(RenderError::NoPanels)));
    }

    #[test]
    fn steps_are_round_and_values_that_are_none_are_left_out() {
        for (highest, step) in [(1.0, 0.2), (0.034, 0.01), (7.6, 2.0), (5e-9, 1e-9), (0.0, 1.0)] {
            assert!((tick_step(highest) / step - 1.0).abs() < 1e-9, "{highest}");
        }
        for values in [&[f64::NAN, f64::INFINITY, 1.0][..], &[], &[0.0], &[1e300; 2]] {
            let curve = Curve { label: "a", values, band: [values, values] };
            render_curves(&[CurvePanel { title: "", x_label: "", curves: vec![curve] }]).unwrap();
        }
    }
}
