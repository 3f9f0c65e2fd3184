//! Draws curves as SVG, in panels side by side with a common legend.

use std::sync::Arc;

use kuva::backend::svg::SvgBackend;
use kuva::plot::{LegendEntry, LegendShape, LinePlot, MarkerShape, ScatterPlot};
use kuva::render::figure::Figure;
use kuva::render::layout::{Layout, TickFormat};
use kuva::render::plots::Plot;

/// Axis of a panel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Axis {
    pub(crate) label: &'static str,
    pub(crate) log: bool,
}

impl Axis {
    pub(crate) const fn linear(label: &'static str) -> Self {
        Self { label, log: false }
    }

    pub(crate) const fn log(label: &'static str) -> Self {
        Self { label, log: true }
    }
}

/// A curve through measured points.
#[derive(Debug)]
pub(crate) struct Curve {
    pub(crate) label: String,
    pub(crate) points: Vec<(f64, f64)>,
}

/// Panel of a figure: curves on a common pair of axes.
#[derive(Debug)]
pub(crate) struct Panel {
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) curves: Vec<Curve>,
}

/// Colours and markers of the curves. The colours are those of a palette that colour-blind people can distinguish (B.
/// Wong, Nature Methods 8, 2011), without its pale yellow. The markers also differ, so that the curves can be
/// distinguished in black and white.
const STYLES: [(&str, MarkerShape); 7] = [
    ("#0072B2", MarkerShape::Circle),
    ("#D55E00", MarkerShape::Square),
    ("#009E73", MarkerShape::Triangle),
    ("#CC79A7", MarkerShape::Diamond),
    ("#E69F00", MarkerShape::TriangleDown),
    ("#56B4E9", MarkerShape::Cross),
    ("#000000", MarkerShape::Plus),
];

/// Draws a figure with `columns` panels per row. The legend shows the labels of the first panel's curves, in their
/// order.
pub(crate) fn svg(title: &str, columns: usize, panels: Vec<Panel>) -> String {
    let legend: Vec<LegendEntry> = panels.first().map_or(Vec::new(), |panel| {
        let entry = |(curve, (color, marker)): (&Curve, &(&str, MarkerShape))| LegendEntry {
            label: curve.label.clone(),
            color: (*color).to_owned(),
            shape: LegendShape::Marker(*marker),
            dasharray: None,
        };
        panel.curves.iter().zip(STYLES.iter().cycle()).map(entry).collect()
    });
    let (plots, layouts): (Vec<Vec<Plot>>, Vec<Layout>) = panels.iter().map(draw).unzip();
    let mut figure = Figure::new(panels.len().div_ceil(columns), columns)
        .with_title(title)
        .with_title_size(16)
        .with_plots(plots)
        .with_layouts(layouts)
        .with_cell_size(430.0, 330.0);
    // A single curve needs no legend, because the axis labels describe it.
    if legend.len() > 1 {
        figure = figure.with_shared_legend_right_middle().with_shared_legend_entries(legend);
    }
    SvgBackend::default().render_scene(&figure.render())
}

fn draw(panel: &Panel) -> (Vec<Plot>, Layout) {
    let shown = |&(x, y): &(f64, f64)| {
        let on = |axis: Axis, value: f64| value.is_finite() && (value > 0.0 || !axis.log);
        on(panel.x, x) && on(panel.y, y)
    };
    let mut plots = Vec::new();
    for (curve, (color, marker)) in panel.curves.iter().zip(STYLES.iter().cycle()) {
        let points: Vec<(f64, f64)> = curve.points.iter().copied().filter(shown).collect();
        plots.push(Plot::Line(LinePlot::new().with_data(points.clone()).with_color(*color).with_stroke_width(1.5)));
        plots.push(Plot::Scatter(
            ScatterPlot::new().with_data(points).with_color(*color).with_marker(*marker).with_size(4.0),
        ));
    }
    // The automatic margins of kuva don't account for the labels of logarithmic ticks, so margins are set explicitly.
    let mut layout = Layout::auto_from_plots(&plots)
        .with_x_label(panel.x.label)
        .with_y_label(panel.y.label)
        .with_force_margins(LEFT_MARGIN, RIGHT_MARGIN);
    if panel.x.log {
        layout = layout.with_log_x().with_x_tick_format(TickFormat::Custom(Arc::new(tick)));
    }
    if panel.y.log {
        layout = layout.with_log_y().with_y_tick_format(TickFormat::Custom(Arc::new(tick)));
    }
    (plots, layout)
}

const LEFT_MARGIN: f64 = 75.0;
const RIGHT_MARGIN: f64 = 20.0;

/// Formats the label of a logarithmic tick with one significant digit, and without an exponent if the number is short.
fn tick(value: f64) -> String {
    if (0.009..99_999.0).contains(&value) {
        // Formatting with one digit and parsing again removes rounding errors such as 0.30000000000000004.
        format!("{}", format!("{value:.0e}").parse::<f64>().unwrap_or(value))
    } else {
        format!("{value:.0e}")
    }
}
