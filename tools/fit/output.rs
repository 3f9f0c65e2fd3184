//! What `fit` prints: warnings with advice, the table, the report.

use std::collections::{BTreeMap, HashSet};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use serde_json::json;
use spharm::assess::SurfaceDistances;
use spharm::parametrize::HandlesReport;
use spharm::parametrize::volume::Repair;
use spharm::{BatchReport, Fit, FitParams, FitReport, FitWarning, ManyReport, Seconds};
use spharm_cli::advice;
use spharm_cli::machine::memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{prepare, print, print_json, table, write_json};

use super::args::Cli;
use super::items::{Item, Skipped};

/// A call of `fit`.
pub(super) struct Call<'a> {
    pub(super) cli: &'a Cli,
    pub(super) params: &'a FitParams,
    pub(super) monitor: &'a ConsoleMonitor,
    pub(super) started: Instant,
    /// What `--skip-existing` left out.
    pub(super) skipped: Vec<Skipped>,
    /// Warnings of whole batches, which are shown once.
    shown: Mutex<HashSet<String>>,
}

/// A fitted surface, as the report shows it.
#[derive(Debug, Serialize)]
pub(super) struct Fitted {
    /// The model's name.
    name: String,
    input: PathBuf,
    output: PathBuf,
    #[serde(flatten)]
    report: FitReport,
    /// Vertices that a mask left out or that had no value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unread: Option<usize>,
    /// Without --sphere: the sphere that was made, and how.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) parametrization: Option<Mapped>,
}

/// What the table shows beside msd and xsd.
#[derive(Clone, Copy)]
struct Columns {
    /// Distances between model and surface, in place of those at and between the vertices.
    surface: bool,
    /// Distances at the vertices that were held out.
    held_out: bool,
    /// The noise that was removed.
    denoise: bool,
}

impl Columns {
    fn of(surfaces: &[Fitted]) -> Self {
        let any = |with: fn(&FitReport) -> bool| surfaces.iter().any(|fitted| with(&fitted.report));
        Self {
            surface: any(|r| r.surface_distance.is_some()),
            held_out: any(|r| r.held_out.is_some()),
            denoise: any(|r| !r.denoise.is_empty()),
        }
    }

    fn head(self) -> Vec<String> {
        let mut head = vec!["model"];
        head.extend(if self.surface { &["rms", "95 %", "hausdorff", "msd", "xsd"][..] } else { &["msd", "xsd"] });
        head.extend(if self.surface { &[][..] } else { &["rms", "max", "between"] });
        head.extend(self.held_out.then_some("msd held out"));
        head.extend(if self.denoise { &["sigma", "freedom"][..] } else { &[] });
        head.push("file");
        head.into_iter().map(str::to_owned).collect()
    }

    fn units(self) -> &'static str {
        if self.surface {
            "rms, 95 %, hausdorff: between model and surface, both ways, in the input's unit; msd, xsd: at the vertices, \
             bounding box scaled to volume 1"
        } else {
            "msd, xsd: bounding box scaled to volume 1; rms, max: in the input's unit; between: rms at triangles' centres"
        }
    }
}

/// The sphere that a surface was mapped to.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Mapped {
    /// The file.
    pub(super) sphere: PathBuf,
    /// What `--fix` changed in the label, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) repair: Option<Repair>,
    /// What `--fix` mended in a mesh, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mesh_repair: Option<BTreeMap<&'static str, usize>>,
    /// What `--cut-handles` cut, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) handles: Option<HandlesReport>,
    #[serde(flatten)]
    pub(super) report: spharm::parametrize::Report,
}

impl Fitted {
    pub(super) fn new(item: &Item, report: FitReport) -> Self {
        let (name, output) = (item.files.name(), item.files.model.clone());
        Self { name, input: item.input.clone(), output, report, unread: None, parametrization: None }
    }

    /// The surface's row of the table.
    fn row(&self, columns: Columns) -> Option<Vec<String>> {
        let last = self.report.passes.last()?;
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4e}"));
        let mut row = vec![self.name.clone()];
        if columns.surface {
            let distance = &self.report.surface_distance;
            let of = |value: fn(&SurfaceDistances) -> f64| number(distance.as_ref().map(value));
            row.extend([of(|d| d.rms_raw), of(|d| d.percentile95_raw), of(|d| d.hausdorff_raw)]);
        }
        row.extend([number(last.msd), number(last.xsd)]);
        if !columns.surface {
            row.extend([number(Some(last.msd_raw.sqrt())), number(Some(last.xsd_raw.sqrt()))]);
            row.push(number(self.report.between.map(|between| between.msd_raw.sqrt())));
        }
        if columns.held_out {
            let held_out = self.report.held_out.as_ref();
            row.push(number(held_out.map(|of| of.held_out.msd.unwrap_or(of.held_out.msd_raw))));
        }
        if columns.denoise {
            // Of a signal with several channels the first.
            let removed = self.report.denoise.first();
            row.push(number(removed.map(|of| of.noise.sigma)));
            row.push(removed.map_or("-".to_owned(), |of| format!("{:.0}", of.noise.degrees_of_freedom)));
        }
        row.push(self.output.display().to_string());
        Some(row)
    }
}

impl<'a> Call<'a> {
    pub(super) fn new(cli: &'a Cli, params: &'a FitParams, monitor: &'a ConsoleMonitor) -> Self {
        Self { cli, params, monitor, started: Instant::now(), skipped: Vec::new(), shown: Mutex::default() }
    }

    /// Shows a fit's warnings: those of the surface with its name, those of its batch once.
    pub(super) fn warn_of(&self, item: &Item, fit: &Fit) {
        for warning in &fit.report.warnings {
            if let FitWarning::Oscillation { .. } = warning {
                let advice = advice::of_oscillation(self.params);
                self.monitor.console().warn(format!("{}: {warning}; {advice}", item.input.display()));
            } else if self.shown.lock().unwrap_or_else(PoisonError::into_inner).insert(warning.to_string()) {
                self.monitor.console().warn(warning);
            }
        }
    }

    /// Writes the report, and prints it or the table. `before` has the seconds of reading the sphere and of mapping.
    pub(super) fn finish(&self, surfaces: Vec<Fitted>, reports: Vec<ManyReport>, before: [f64; 2]) -> Result<()> {
        let sum = |of: fn(&Seconds) -> f64| reports.iter().map(|report| of(&report.seconds)).sum::<f64>();
        let (input, method, total) = (&self.cli.input, &self.params.method, self.started.elapsed().as_secs_f64());
        let batches: Vec<&BatchReport> = reports.iter().flat_map(|report| &report.batches).collect();
        let report = json!({
            "tool": "fit",
            "versions": spharm::versions(),
            "method": method.name(),
            "store": input.store,
            "sphere": input.sphere,
            // Of the sphere that all surfaces share.
            "scheme_key": input.sphere.as_ref().and(reports.first()).map(|report| report.scheme.to_string()),
            "dtype": reports.first().map(|report| report.scalar.name()),
            "weights": input.weights,
            "granularity": method.granularity(),
            "start_degree": method.start_degree(),
            "openblas": spharm_solver::blas::version(),
            "surfaces": surfaces,
            "skipped": self.skipped,
            "batches": batches,
            "seconds": {
                "read": before[0] + sum(|s| s.read),
                "parametrize": before[1],
                "plan": sum(|s| s.plan), "solve": sum(|s| s.solve), "write": sum(|s| s.write),
                "total": total,
            },
            "memory": memory(),
        });
        if let Some(path) = &self.cli.output.report {
            prepare(path)?;
            write_json(path, self.cli.output.force, &report)?;
        }
        if self.cli.output.json {
            return print_json(&report);
        }
        if surfaces.is_empty() {
            return print("nothing to do: every output exists");
        }
        let columns = Columns::of(&surfaces);
        let mut rows = vec![columns.head()];
        rows.extend(surfaces.iter().filter_map(|fitted| fitted.row(columns)));
        let units = columns.units();
        print(&format!("{}\n{units}\n{total:.2} s", table(&rows)))
    }
}
