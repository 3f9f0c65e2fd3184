//! Output of `basis-build`: JSON, or a table.

use std::path::PathBuf;

use serde::Serialize;
use spharm_cli::machine::{Memory, Versions};
use spharm_cli::size::Size;
use spharm_solver::cholesky::FactorReport;
use spharm_store::{BuildParams, BuildReport};

/// Report on the build.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) tool: &'static str,
    pub(super) versions: Versions,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    pub(super) sphere: PathBuf,
    pub(super) scheme_key: String,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    pub(super) folder: PathBuf,
    pub(super) directions: usize,
    pub(super) dtype: &'static str,
    /// Summary of the basis; absent with --factor-only.
    #[serde(flatten)]
    pub(super) basis: Option<Basis>,
    pub(super) factor: Option<FactorRow>,
    pub(super) threads: usize,
    pub(super) memory: Memory,
    pub(super) seconds: f64,
}

/// Summary of a basis. Sizes are in bytes.
#[derive(Debug, Serialize)]
pub(super) struct Basis {
    max_degree: usize,
    codec: &'static str,
    chunk_rows: usize,
    degrees_built: usize,
    degrees_present: usize,
    bytes: u64,
    bytes_written: u64,
    planned_memory: usize,
}

/// Returns the rows of the printed table, each a name and a value.
pub(super) fn lines(report: &Report) -> Vec<Vec<String>> {
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let mut lines = vec![row("scheme", report.scheme_key.clone()), row("directions", report.directions.to_string())];
    if let Some(basis) = &report.basis {
        lines.extend([
            row("max degree", basis.max_degree.to_string()),
            row("degrees built", format!("{} ({} already existed)", basis.degrees_built, basis.degrees_present)),
            row("size", Size(basis.bytes as usize).to_string()),
            row("written", Size(basis.bytes_written as usize).to_string()),
        ]);
    }
    if let Some(factor) = &report.factor {
        let there = if factor.present { " (already existed)" } else { "" };
        lines.extend([
            row("factor", format!("degree {}, {}{there}", factor.max_degree, factor.dtype)),
            row("factor size", Size(factor.bytes as usize).to_string()),
            row("condition", format!("{:.1e}", 1.0 / factor.reciprocal_condition)),
        ]);
    }
    lines.push(row("seconds", format!("{:.2}", report.seconds)));
    lines
}

impl Basis {
    pub(super) fn new(report: &BuildReport, params: &BuildParams) -> Self {
        Self {
            max_degree: params.max_degree,
            codec: params.codec.name(),
            chunk_rows: report.chunk_rows,
            degrees_built: report.built,
            degrees_present: report.present,
            bytes: report.bytes,
            bytes_written: report.bytes_written,
            planned_memory: report.memory,
        }
    }
}

/// Summary of a factor. Sizes are in bytes.
#[derive(Debug, Serialize)]
pub(super) struct FactorRow {
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    pub(super) path: PathBuf,
    pub(super) max_degree: usize,
    pub(super) columns: usize,
    pub(super) dtype: &'static str,
    pub(super) smoothness: f64,
    pub(super) present: bool,
    pub(super) bytes: u64,
    pub(super) norm: f64,
    pub(super) reciprocal_condition: f64,
    pub(super) planned_memory: usize,
}

impl From<&FactorReport> for FactorRow {
    fn from(report: &FactorReport) -> Self {
        let header = report.file.header();
        Self {
            path: report.file.path().to_path_buf(),
            max_degree: header.spec.max_degree,
            columns: header.grid.size(),
            dtype: header.scalar.name(),
            smoothness: header.spec.smoothness,
            present: report.present,
            bytes: report.file.file_len(),
            norm: header.condition.norm,
            reciprocal_condition: header.condition.reciprocal,
            planned_memory: report.memory,
        }
    }
}
