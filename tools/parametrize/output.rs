//! Output of `parametrize`: JSON, or tables.

use serde::Serialize;
use spharm_cli::output::{counted, table};
use spharm_monitor::number;
use spharm_parametrize::handles::{CutLoop, HandlesReport};
use spharm_parametrize::volume::{Repair, VolumeSurface};
use spharm_parametrize::{Input, Parametrization, Quality, Report, Resampling};
use spharm_surface::repair::MeshRepair;

use super::args::Cli;
use super::items::Item;

/// Report on the mapping of one surface.
#[derive(Debug, Serialize)]
pub(super) struct Written {
    input: String,
    output: String,
    seed: u64,
    threads: usize,
    version: &'static str,
    #[serde(flatten)]
    report: Report,
    #[serde(skip_serializing_if = "Option::is_none")]
    volume: Option<Label>,
    /// Repairs of a mesh by `--fix`, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    mesh_repair: Option<MeshRepair>,
    /// Cuts by `--cut-handles`, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    handles: Option<HandlesReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<Distance>,
}

impl Written {
    pub(super) fn new(cli: &Cli, item: &Item, input: &Input, found: Parametrization) -> Self {
        Self {
            input: item.input.display().to_string(),
            output: item.sphere.display().to_string(),
            seed: cli.seed,
            threads: cli.threads.count(),
            version: env!("CARGO_PKG_VERSION"),
            report: found.report,
            volume: input.label().map(Label::from),
            mesh_repair: input.mesh_repair().copied(),
            handles: input.handles().cloned(),
            distance: found.resampling.map(Distance::from),
        }
    }

    /// Returns the table, preceded by a line that summarises the mapping.
    pub(super) fn table(&self) -> String {
        let summary = summary(&self.output, &self.report);
        match &self.handles {
            Some(handles) => format!("{summary}\n{}", cuts(handles)),
            None => summary,
        }
    }
}

/// The label from which a surface was made.
#[derive(Debug, Serialize)]
struct Label {
    label: i64,
    voxels: usize,
    /// The changes made by `--fix`, if any.
    repair: Option<Repair>,
}

impl From<&VolumeSurface> for Label {
    fn from(found: &VolumeSurface) -> Self {
        Self { label: found.label, voxels: found.voxels, repair: found.repair }
    }
}

/// Distance from the input's surface to the new surface, in the input's unit.
#[derive(Debug, Serialize)]
struct Distance {
    mean: f64,
    rms: f64,
    percentile95: f64,
    hausdorff: f64,
    /// Maximum amount by which the true Hausdorff distance may exceed `hausdorff`.
    bound: f64,
    /// Cube root of the bounding box's volume, in the input's unit.
    scale: f64,
    /// Number of pairs of the new surface's triangles that intersect, if checked.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_intersections: Option<usize>,
}

impl From<Resampling> for Distance {
    fn from(Resampling { distance: d, self_intersections, .. }: Resampling) -> Self {
        Self {
            mean: d.mean,
            rms: d.rms,
            percentile95: d.percentile95,
            hausdorff: d.hausdorff,
            bound: d.bound,
            scale: d.scale,
            self_intersections,
        }
    }
}

/// Describes an input mesh or volume in a few words.
pub(super) fn described(input: &Input) -> String {
    match input {
        Input::Mesh(mesh) | Input::Fixed(mesh, _) => {
            format!("{} vertices, {} triangles", mesh.vertices.len(), mesh.faces.len())
        }
        Input::Cut(cut, _) => {
            let (vertices, faces) = (cut.surface.vertices.len(), cut.surface.faces.len());
            let cut = format!("{vertices} vertices, {faces} triangles after the handles were cut and the cuts filled");
            input.label().map_or(cut.clone(), |label| format!("{}; {cut}", of_label(label)))
        }
        Input::Label(label) => {
            let (vertices, faces) = (label.quads.vertices.len(), label.quads.quads.len());
            format!("{}; {vertices} vertices, {faces} quadrangles", of_label(label))
        }
    }
}

fn of_label(found: &VolumeSurface) -> String {
    format!("label {}, {}", found.label, counted(found.voxels, "voxel"))
}

/// Returns a table with a row for each loop along which a handle was cut. The table has at most `MOST_ROWS` rows; the
/// JSON report lists all loops.
fn cuts(handles: &HandlesReport) -> String {
    const MOST_ROWS: usize = 12;
    let head = ["cut", "length", "vertices", "area added", "at"].map(str::to_owned).to_vec();
    let row = |cut: &CutLoop| {
        let [x, y, z] = cut.centre;
        let at = format!("{x:.4} {y:.4} {z:.4}");
        vec![cut.kind.to_string(), number(cut.length), cut.vertices.to_string(), number(cut.area_added), at]
    };
    let rows: Vec<Vec<String>> = std::iter::once(head).chain(handles.loops.iter().take(MOST_ROWS).map(row)).collect();
    let more = handles.loops.len().saturating_sub(MOST_ROWS);
    let more = if more > 0 { format!("\nand {more} more, listed in the report") } else { String::new() };
    format!("{handles}\n{}{more}", table(&rows))
}

fn summary(output: &str, report: &Report) -> String {
    let Quality { area_rms, area_p01, area_p99, angle_rms_degrees, stretch, length_worst, length_p99, .. } =
        report.quality;
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let rows = [
        row("flipped or degenerate triangles", (report.quality.flipped + report.quality.degenerate).to_string()),
        row("log area ratio, root mean square", format!("{area_rms:.4}")),
        row("  1st and 99th percentile", format!("{area_p01:.3} {area_p99:.3}")),
        row("angle distortion, root mean square", format!("{angle_rms_degrees:.2} degrees")),
        row("L2 stretch", format!("{stretch:.4}")),
        row("length distortion, worst", format!("{length_worst:.3}")),
        row("  99th percentile", format!("{length_p99:.3}")),
    ];
    format!(
        "{}: {} vertices by {}, {}, {:.2} s\n{}",
        output,
        report.vertices,
        report.method,
        counted(report.iterations, "iteration"),
        report.seconds,
        table(&rows)
    )
}
