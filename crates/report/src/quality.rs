//! Shows the quality of a group's correspondence in a page, with curves and a table that compare alignments.

use spharm_shape::Curve;

use crate::ReportError;
use crate::axis::Scale;
use crate::chart::{Chart, Line};
use crate::contents::Quality;
use crate::table::Table;
use crate::text::number;

/// CSS classes of the two lines of each alignment. The first line shows distances between points at equal directions,
/// the second line distances between surfaces.
const CLASSES: [(&str, &str); 4] = [("y", "y beside"), ("x", "x beside"), ("z", "z beside"), ("all", "all beside")];
/// Numbers of modes k for which the table has a column with the measures of the first k modes.
const SHOWN: [usize; 2] = [1, 3];

/// Returns the section as HTML; an empty string if there are no alignments.
pub(crate) fn section(measured: &[Quality]) -> Result<String, ReportError> {
    if measured.is_empty() {
        return Ok(String::new());
    }
    let charts = [
        chart(measured, "Compactness", "share of the variance", |of| (&of.compactness, None)),
        chart(measured, "Generalisation", "distance from the modes of the other members, length", |of| {
            (&of.generalisation, of.surface_generalisation.as_ref())
        }),
        chart(measured, "Specificity", "distance of a random shape from the nearest member, length", |of| {
            (&of.specificity, of.surface_specificity.as_ref())
        }),
    ];
    let charts: String = charts.into_iter().flatten().collect();
    Ok(format!(
        "<section class=\"quality\"><h2>Quality of the correspondence</h2>\n<p>Higher compactness is better; lower \
         generalisation and specificity are better. Bands cover 95 %; dashed lines are distances between surfaces, \
         measured to nearest points. None of these measures proves that directions correspond; only landmarks can show \
         that.</p>\n<div class=\"details\">{charts}</div></section>\n{}",
        table(measured).html()?
    ))
}

/// Returns a chart of a measure against the number of modes, with a curve for each alignment. If the measure was also
/// computed from distances between surfaces, the chart includes these values.
fn chart(
    measured: &[Quality],
    title: &str,
    y: &str,
    of: impl Fn(&Quality) -> (&Curve, Option<&Curve>),
) -> Option<String> {
    let mut lines = Vec::new();
    for (quality, (class, beside)) in measured.iter().zip(CLASSES.iter().cycle()) {
        let (points, surfaces) = of(quality);
        lines.push(line(class, quality.name.clone(), points));
        if let Some(surfaces) = surfaces {
            // The line measured between surfaces has no band, because its band would overlap the band of the line
            // measured at points.
            let name = format!("{}, between surfaces", quality.name);
            lines.push(Line { band: Vec::new(), ..line(beside, name, surfaces) });
        }
    }
    let marks = lines.iter().all(|line| line.points.len() <= 40);
    Chart { title, x: "modes", y, lines, scale: Scale::Linear, marks }.html()
}

fn line(class: &'static str, name: String, curve: &Curve) -> Line {
    let at = |k: usize| (k + 1) as f64;
    let band = curve.low.iter().zip(&curve.high).enumerate();
    Line {
        class,
        name,
        points: curve.values.iter().enumerate().map(|(k, value)| [at(k), *value]).collect(),
        band: band.map(|(k, (low, high))| [at(k), *low, *high]).collect(),
    }
}

/// Returns the table of the measures for the numbers of modes in [`SHOWN`].
fn table(measured: &[Quality]) -> Table {
    let surfaces = measured.iter().any(|of| of.surface_generalisation.is_some() || of.surface_specificity.is_some());
    let landmarks = measured.iter().any(|of| of.landmarks.is_some());
    let mut columns = vec!["alignment".to_owned(), "variance, length²".to_owned()];
    let mut rows: Vec<Vec<String>> = measured.iter().map(|of| vec![of.name.clone(), number(of.variance)]).collect();
    let mut add = |name: String, value: &dyn Fn(&Quality) -> Option<f64>| {
        columns.push(name);
        for (row, of) in rows.iter_mut().zip(measured) {
            row.push(value(of).map_or("–".to_owned(), number));
        }
    };
    let modes = |k: usize| if k == 1 { "1 mode".to_owned() } else { format!("{k} modes") };
    for (name, of) in [
        ("compactness", (|of: &Quality| Some(&of.compactness)) as fn(&Quality) -> Option<&Curve>),
        ("generalisation", |of| Some(&of.generalisation)),
        ("specificity", |of| Some(&of.specificity)),
        ("generalisation between surfaces", |of| of.surface_generalisation.as_ref()),
        ("specificity between surfaces", |of| of.surface_specificity.as_ref()),
    ] {
        if name.contains("surfaces") && !surfaces {
            continue;
        }
        for k in SHOWN {
            add(format!("{name}, {}", modes(k)), &|quality| of(quality)?.values.get(k - 1).copied());
        }
    }
    if landmarks {
        add("landmark error, mean".to_owned(), &|of| of.landmarks.map(|[mean, _]| mean));
        add("landmark error, median".to_owned(), &|of| of.landmarks.map(|[_, median]| median));
    }
    Table { title: "Quality with few modes".to_owned(), columns, rows, note: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(values: &[f64]) -> Curve {
        let band = |by: f64| values.iter().map(|value| value * by).collect();
        Curve { values: values.to_vec(), low: band(0.9), high: band(1.1) }
    }

    #[test]
    fn alignments_are_side_by_side() {
        let plain = Quality {
            name: "plain <i>".to_owned(),
            variance: 2.0,
            compactness: curve(&[0.5, 0.8, 0.9]),
            generalisation: curve(&[2.0, 1.5, 1.25]),
            specificity: curve(&[3.0, 3.5, 3.75]),
            ..Quality::default()
        };
        let other = Quality {
            name: "correspond".to_owned(),
            surface_generalisation: Some(curve(&[0.25])),
            landmarks: Some([2.5, 1.75]),
            ..plain.clone()
        };
        let html = section(&[other, plain]).unwrap();
        assert_eq!((html.matches("<svg").count(), html.matches("<polygon").count()), (3, 6));
        assert!(html.contains("plain &lt;i&gt;") && !html.contains("<i>"), "{html}");
        let rows: Vec<&str> = html.split("<tr>").skip(2).collect();
        assert_eq!(rows.len(), 2);
        for (row, cells) in rows.iter().zip([["0.25", "2.5"], ["–", "–"]]) {
            assert!(cells.iter().all(|cell| row.contains(&format!("<bdi>{cell}</bdi>"))), "{row}");
            assert!(row.contains("<bdi>1.25</bdi>") && row.contains("<bdi>3.75</bdi>"), "{row}");
        }
        assert_eq!(section(&[]).unwrap(), "");
    }
}
