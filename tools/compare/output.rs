//! Output of `compare`: JSON, or a table.

use serde::Serialize;
use spharm_monitor::number;
use spharm_surface::metrics::{Directed, Distances, SurfaceDistance};

/// Report on the distances between two surfaces.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    /// Number of compared vertices of the original.
    vertices: usize,
    /// Distances between corresponding vertices; present if the meshes have the same triangles.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    vertexwise: Option<Vertexwise>,
    /// Cube root of the volume of the original's bounding box, in the input's unit.
    scale: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    surface_distance: Option<Surfaces>,
}

#[derive(Debug, Serialize)]
struct Vertexwise {
    msd: f64,
    xsd: f64,
    msd_raw: f64,
    xsd_raw: f64,
    rms_raw: f64,
    max_raw: f64,
    worst_vertex: usize,
}

/// Distances between the surfaces, in the input's unit.
#[derive(Debug, Serialize)]
struct Surfaces {
    mean: f64,
    rms: f64,
    percentile95: f64,
    hausdorff: f64,
    /// Error bound of the computed Hausdorff distance: the true distance may be larger by at most this amount.
    bound: f64,
    forward: OneWay,
    backward: OneWay,
}

#[derive(Debug, Serialize)]
struct OneWay {
    mean: f64,
    rms: f64,
    percentile95: f64,
    max: f64,
    worst: [f64; 3],
    samples: usize,
}

impl Report {
    /// Creates a report for an original with `vertices` compared vertices. At least one of the two kinds of distances
    /// must have been measured.
    pub(super) fn new(vertices: usize, vertexwise: Option<Distances>, surfaces: Option<SurfaceDistance>) -> Self {
        let scale = vertexwise.map(|d| d.scale).or(surfaces.map(|d| d.scale)).unwrap_or(f64::NAN);
        Self {
            vertices,
            vertexwise: vertexwise.map(Vertexwise::from),
            scale,
            surface_distance: surfaces.map(Surfaces::from),
        }
    }
}

impl From<Distances> for Vertexwise {
    fn from(d: Distances) -> Self {
        let Distances { msd, xsd, msd_raw, xsd_raw, rms_raw, max_raw, worst_vertex, .. } = d;
        Self { msd, xsd, msd_raw, xsd_raw, rms_raw, max_raw, worst_vertex }
    }
}

impl From<SurfaceDistance> for Surfaces {
    fn from(d: SurfaceDistance) -> Self {
        let SurfaceDistance { mean, rms, percentile95, hausdorff, bound, .. } = d;
        Self { mean, rms, percentile95, hausdorff, bound, forward: d.forward.into(), backward: d.backward.into() }
    }
}

impl From<Directed> for OneWay {
    fn from(d: Directed) -> Self {
        let Directed { mean, rms, percentile95, max, worst, samples, .. } = d;
        Self { mean, rms, percentile95, max, worst, samples }
    }
}

/// Returns the rows of the printed table. Each distance is given twice: for a bounding box of volume 1, and in the
/// input's unit.
pub(super) fn rows(report: &Report) -> Vec<Vec<String>> {
    let row = |name: &str, scaled: f64, raw: f64| vec![name.to_owned(), number(scaled), number(raw)];
    let mut rows = vec![["", "box volume 1", "input's unit"].map(str::to_owned).to_vec()];
    if let Some(d) = &report.vertexwise {
        rows.extend([
            row("mean squared distance (msd)", d.msd, d.msd_raw),
            row("maximal squared distance (xsd)", d.xsd, d.xsd_raw),
            row("root mean square", d.msd.sqrt(), d.rms_raw),
            row("maximum", d.xsd.sqrt(), d.max_raw),
        ]);
    }
    if let Some(d) = &report.surface_distance {
        let row = |name: &str, raw: f64| row(name, raw / report.scale, raw);
        rows.extend([
            row("between surfaces: mean", d.mean),
            row("between surfaces: root mean square", d.rms),
            row("between surfaces: 95th percentile", d.percentile95),
            row("between surfaces: Hausdorff", d.hausdorff),
            row("Hausdorff: underestimated by at most", d.bound),
        ]);
    }
    rows
}
