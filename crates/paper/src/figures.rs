//! Selects the data of each figure's curves.

use crate::experiments::{Basis, Nlsf, Pass, Results, Sirf};
use crate::extent::Extent;
use crate::plots::{Axis, Curve, Panel, svg};

/// Returns the file names of all figures: first the figures that show all surfaces together, then figures 6 and 7 of
/// each surface.
pub(crate) fn names(surfaces: &[String]) -> Vec<String> {
    let of_all = ["figure3.svg", "figure5.svg", "table1.svg"].map(str::to_owned);
    of_all.into_iter().chain(surfaces.iter().map(|surface| format!("figures6-7.{surface}.svg"))).collect()
}

/// Returns the name and SVG text of every figure.
pub(crate) fn all(results: &Results, extent: &Extent, surfaces: &[String]) -> Vec<(String, String)> {
    let of_all = [figure3(&results.basis, extent), figure5(&results.sirf, surfaces), table1(&results.nlsf)];
    let of_each = surfaces.iter().map(|surface| figures6_7(&results.grid, extent, surface));
    names(surfaces).into_iter().zip(of_all.into_iter().chain(of_each)).collect()
}

const DEGREE: Axis = Axis::linear("largest degree L");
/// Logarithmic axis of the degree, on which powers of the degree are straight lines.
const LOG_DEGREE: Axis = Axis::log("largest degree L");
const PASSES: Axis = Axis::linear("passes p");
const MSD: Axis = Axis::log("msd (bounding-box volume 1)");
const XSD: Axis = Axis::log("xsd (bounding-box volume 1)");
const SECONDS: Axis = Axis::log("seconds");
const BYTES: Axis = Axis::log("size of the basis (MiB)");
const VERTICES: Axis = Axis::log("vertices n");

fn figure5(rows: &[Sirf], surfaces: &[String]) -> String {
    let panel = |y: Axis, value: &dyn Fn(&Sirf) -> f64| {
        let curve = |name: &String| {
            let of_surface = rows.iter().filter(|row| &row.surface == name);
            let points = of_surface.map(|row| (row.max_degree as f64, value(row))).collect();
            Curve { label: name.clone(), points }
        };
        Panel { x: DEGREE, y, curves: surfaces.iter().map(curve).collect() }
    };
    let panels = vec![
        panel(MSD, &|row| row.measured.quality.msd),
        panel(XSD, &|row| row.measured.quality.xsd),
        panel(SECONDS, &|row| row.measured.seconds),
    ];
    svg("Figure 5: SIRF, one degree per block and one pass", 3, panels)
}

fn figures6_7(rows: &[Pass], extent: &Extent, surface: &str) -> String {
    let panel = |x: Axis, y: Axis, point: &dyn Fn(&Pass) -> (f64, f64)| {
        let curve = |&granularity: &usize| {
            let of_curve = rows.iter().filter(|row| row.surface == surface && row.granularity == granularity);
            Curve { label: format!("g = {granularity}"), points: of_curve.map(point).collect() }
        };
        Panel { x, y, curves: extent.granularities.iter().map(curve).collect() }
    };
    let panels = vec![
        panel(PASSES, MSD, &|row| (row.pass as f64, row.measured.quality.msd)),
        panel(PASSES, XSD, &|row| (row.pass as f64, row.measured.quality.xsd)),
        panel(PASSES, SECONDS, &|row| (row.pass as f64, row.measured.seconds)),
        panel(SECONDS, MSD, &|row| (row.measured.seconds, row.measured.quality.msd)),
    ];
    svg(&format!("Figures 6 and 7: {surface}, IRF to degree {}", extent.max_degree), 2, panels)
}

fn table1(rows: &[Nlsf]) -> String {
    const MEMORY: Axis = Axis::log("memory (MiB)");
    const LARGEST: Axis = Axis::linear("largest degree L of NLSF");
    let point = |row: &Nlsf| Some((mib(row.memory as u64), row.max_degree? as f64));
    let curve = Curve { label: "NLSF".to_owned(), points: rows.iter().filter_map(point).collect() };
    let vertices = rows.first().map_or(0, |row| row.vertices);
    let title = format!("Table 1: the full least squares at {vertices} vertices");
    svg(&title, 1, vec![Panel { x: MEMORY, y: LARGEST, curves: vec![curve] }])
}

fn figure3(rows: &[Basis], extent: &Extent) -> String {
    let panel = |along: &str, x: Axis, y: Axis, point: &dyn Fn(&Basis) -> (f64, f64)| {
        let points = rows.iter().filter(|row| row.along == along).map(point).collect();
        Panel { x, y, curves: vec![Curve { label: "basis-build".to_owned(), points }] }
    };
    let panels = vec![
        panel("degree", LOG_DEGREE, SECONDS, &|row| (row.max_degree as f64, row.seconds)),
        panel("degree", LOG_DEGREE, BYTES, &|row| (row.max_degree as f64, mib(row.bytes))),
        panel("vertices", VERTICES, SECONDS, &|row| (row.vertices as f64, row.seconds)),
        panel("vertices", VERTICES, BYTES, &|row| (row.vertices as f64, mib(row.bytes))),
    ];
    let vertices = rows.iter().find(|row| row.along == "degree").map_or(0, |row| row.vertices);
    let degree = extent.basis_degree;
    svg(&format!("Figure 3: building the basis, top row for n = {vertices}, bottom row for L = {degree}"), 2, panels)
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
