//! A fitted surface, as shown in the report and the table.

use std::path::PathBuf;

use serde::Serialize;
use spharm::FitReport;
use spharm::assess::SurfaceDistances;
use spharm_cohort::Row;
use spharm_cohort::run::{Mapping, RowFit};

/// A fitted surface, as shown in the report.
#[derive(Debug, Serialize)]
pub(super) struct Fitted {
    /// The row's id, if the row is from a table.
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<String>,
    /// The model's name.
    name: String,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    input: PathBuf,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    pub(super) output: PathBuf,
    #[serde(flatten)]
    pub(super) report: FitReport,
    /// Number of vertices that were ignored because they are masked or have no value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unread: Option<usize>,
    /// Report on the mapping of the surface to a sphere, if no sphere was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    parametrization: Option<Mapping>,
}

impl Fitted {
    pub(super) fn new(row: &Row, fit: &RowFit) -> Self {
        Self {
            // Only rows of a table (`line` > 0) have ids given by the user.
            id: (row.line > 0).then(|| row.id.clone()),
            name: fit.files.name(),
            input: row.surface.clone(),
            output: fit.files.model.clone(),
            report: fit.report.clone(),
            unread: (fit.left_out > 0).then_some(fit.left_out),
            parametrization: fit.mapped.clone(),
        }
    }

    /// Returns the cells of the surface's row in the table.
    pub(super) fn cells(&self, columns: Columns) -> Option<Vec<String>> {
        let last = self.report.passes.last()?;
        let mut cells = vec![self.name.clone()];
        if columns.surface {
            let distance = &self.report.surface_distance;
            let of = |value: fn(&SurfaceDistances) -> f64| number(distance.as_ref().map(value));
            cells.extend([of(|d| d.rms_raw), of(|d| d.percentile95_raw), of(|d| d.hausdorff_raw)]);
        }
        cells.extend([number(last.msd), number(last.xsd)]);
        if !columns.surface {
            cells.extend([number(Some(last.rms())), number(Some(last.max()))]);
            cells.push(number(self.report.between.map(|between| between.rms())));
        }
        if columns.held_out {
            let held_out = self.report.held_out.as_ref();
            cells.push(number(held_out.map(|of| of.held_out.rms())));
        }
        if columns.denoise {
            // For a signal with several channels, the table shows only the estimates of the first channel.
            let removed = self.report.denoise.first();
            cells.push(number(removed.map(|of| of.noise.sigma)));
            cells.push(removed.map_or("-".to_owned(), |of| format!("{:.0}", of.noise.degrees_of_freedom)));
        }
        cells.push(self.output.display().to_string());
        Some(cells)
    }
}

pub(super) fn number(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), spharm_monitor::number)
}

/// Columns of the table in addition to msd and xsd.
#[derive(Clone, Copy)]
pub(super) struct Columns {
    /// Whether distances between model and surface replace the distances at the vertices.
    surface: bool,
    /// Whether distances at held-out vertices are shown.
    held_out: bool,
    /// Whether the noise removed by denoising is shown.
    denoise: bool,
}

impl Columns {
    pub(super) fn of(surfaces: &[Fitted]) -> Self {
        let any = |with: fn(&FitReport) -> bool| surfaces.iter().any(|fitted| with(&fitted.report));
        Self {
            surface: any(|r| r.surface_distance.is_some()),
            held_out: any(|r| r.held_out.is_some()),
            denoise: any(|r| !r.denoise.is_empty()),
        }
    }

    pub(super) fn head(self) -> Vec<String> {
        let mut head = vec!["model"];
        head.extend(if self.surface { &["rms", "95 %", "hausdorff", "msd", "xsd"][..] } else { &["msd", "xsd"] });
        head.extend(if self.surface { &[][..] } else { &["rms", "max", "between"] });
        head.extend(self.held_out.then_some("rms held out"));
        head.extend(if self.denoise { &["sigma", "freedom"][..] } else { &[] });
        head.push("file");
        head.into_iter().map(str::to_owned).collect()
    }

    pub(super) fn units(self) -> String {
        let units = if self.surface {
            "rms, 95 %, hausdorff: distances between model and surface in both directions, in the input's unit; msd, \
             xsd: mean and largest squared distance at the vertices, bounding box scaled to volume 1"
        } else {
            "msd, xsd: mean and largest squared distance, bounding box scaled to volume 1; rms, max: root mean square and \
             largest distance, in the input's unit; between: rms at the centres of triangles"
        };
        let held_out = if self.held_out { "; rms held out: at the held-out vertices, in the input's unit" } else { "" };
        format!("{units}{held_out}")
    }
}
