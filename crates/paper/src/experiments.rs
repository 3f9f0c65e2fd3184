//! Runs the experiments of figures 3, 5, 6 and 7 and of table 1.

use std::path::Path;

use anyhow::{Context, Result};
use spharm_harmonics::{Coefficients, Directions, basis_size, synthesis};
use spharm_monitor::Monitor;
use spharm_solver::irf::plan;
use spharm_solver::{DiskOperator, Method, Operator};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::metrics::{SurfaceDistance, SurfaceDistanceParams, surface_distance};

use crate::bench::{Bench, Measured};
use crate::extent::Extent;
use crate::families::Family;
use crate::published::{Quality, Reference};
use crate::surfaces::Surface;

/// Result of a fit for figure 5 by SIRF, the variant of iterative residual fitting (IRF) with one degree per block and
/// one pass.
#[derive(Debug)]
pub(crate) struct Sirf {
    pub(crate) surface: String,
    pub(crate) vertices: usize,
    pub(crate) max_degree: usize,
    pub(crate) measured: Measured,
    pub(crate) reference: Option<Quality>,
}

/// Result for figures 6 and 7: accuracy and time of a fit with a given granularity, after one of its passes.
#[derive(Debug)]
pub(crate) struct Pass {
    pub(crate) surface: String,
    pub(crate) vertices: usize,
    pub(crate) max_degree: usize,
    pub(crate) granularity: usize,
    pub(crate) pass: usize,
    pub(crate) measured: Measured,
    pub(crate) reference: Option<Quality>,
}

/// Distance between the surface and its reconstruction for the last fit of figures 6 and 7, measured all over both
/// surfaces instead of only at the vertices.
#[derive(Debug)]
pub(crate) struct Between {
    pub(crate) surface: String,
    pub(crate) vertices: usize,
    pub(crate) max_degree: usize,
    pub(crate) granularity: usize,
    pub(crate) pass: usize,
    pub(crate) distance: SurfaceDistance,
}

/// A row of table 1: the degrees that a full least-squares fit (NLSF) can reach within a memory limit.
#[derive(Debug)]
pub(crate) struct Nlsf {
    pub(crate) vertices: usize,
    /// Memory limit in bytes.
    pub(crate) memory: usize,
    /// Largest degree whose planned memory is within the limit; `None` if even degree 0 exceeds it.
    pub(crate) max_degree: Option<usize>,
    /// Whether `max_degree` is the highest degree of the basis, so that higher degrees weren't tried.
    pub(crate) capped: bool,
    /// Planned memory in bytes at `max_degree`.
    pub(crate) planned: Option<usize>,
    /// Degree and result of a fit within the memory limit, if such a fit was run.
    pub(crate) fitted: Option<(usize, Measured)>,
}

/// A point of figure 3: the time and size of a basis built from scratch.
#[derive(Debug)]
pub(crate) struct Basis {
    /// Quantity that varies along the curve of this point: `degree` or `vertices`.
    pub(crate) along: &'static str,
    pub(crate) vertices: usize,
    pub(crate) max_degree: usize,
    pub(crate) seconds: f64,
    pub(crate) bytes: u64,
}

/// Results of all experiments.
#[derive(Debug, Default)]
pub(crate) struct Results {
    pub(crate) sirf: Vec<Sirf>,
    pub(crate) grid: Vec<Pass>,
    pub(crate) between: Vec<Between>,
    pub(crate) nlsf: Vec<Nlsf>,
    pub(crate) families: Vec<Family>,
    pub(crate) basis: Vec<Basis>,
}

/// Runs the fits of figure 5. A fit by SIRF contains the fits to all lower degrees, but each degree is fitted
/// separately, to measure msd and time.
pub(crate) fn sirf(
    bench: &Bench<'_>,
    extent: &Extent,
    operator: &DiskOperator,
    surface: &Surface,
    reference: &Reference,
) -> Result<Vec<Sirf>> {
    let one = |&max_degree: &usize| -> Result<Sirf> {
        bench.note(format!("{}: figure 5, SIRF to degree {max_degree}", surface.name));
        let (sweeps, _) = bench.fit(operator, surface, Method::Sirf { start_degree: 0 }, max_degree)?;
        Ok(Sirf {
            surface: surface.name.clone(),
            vertices: surface.vertices.len(),
            max_degree,
            measured: *sweeps.last().context("the fit made no pass")?,
            reference: reference.sirf(&surface.name, max_degree),
        })
    };
    extent.sirf.iter().map(one).collect()
}

/// Runs the fits of figures 6 and 7. One fit per granularity g, with the largest number of passes, suffices, because
/// its state after p passes is the result of a fit with p passes.
pub(crate) fn grid(
    bench: &Bench<'_>,
    extent: &Extent,
    operator: &DiskOperator,
    surface: &Surface,
    reference: &Reference,
) -> Result<(Vec<Pass>, Option<Between>)> {
    let (passes, max_degree) = (extent.passes, extent.max_degree);
    let mut grid = Vec::new();
    let mut last = None;
    for &granularity in extent.granularities {
        bench.note(format!("{}: figures 6 and 7, g = {granularity}, {passes} passes", surface.name));
        let (sweeps, coefficients) = bench.fit(operator, surface, Method::Irf { passes, granularity }, max_degree)?;
        last = Some((granularity, coefficients));
        grid.extend(sweeps.into_iter().zip(1..).map(|(measured, pass)| Pass {
            surface: surface.name.clone(),
            vertices: surface.vertices.len(),
            max_degree,
            granularity,
            pass,
            measured,
            reference: reference.irf(&surface.name, pass, granularity, max_degree),
        }));
    }
    let between = |(granularity, coefficients): (usize, Coefficients)| {
        let distance = between(surface, &coefficients, bench.monitor).with_context(|| surface.name.clone())?;
        let (surface, vertices) = (surface.name.clone(), surface.vertices.len());
        Ok::<_, anyhow::Error>(Between { surface, vertices, max_degree, granularity, pass: passes, distance })
    };
    Ok((grid, last.map(between).transpose()?))
}

/// Measures the distance between a surface and its reconstruction, which is evaluated at about four times as many
/// vertices as the surface has. In contrast, msd and xsd measure the distance only at the fitted vertices. A fit isn't
/// constrained between these vertices.
fn between(surface: &Surface, coefficients: &Coefficients, monitor: &dyn Monitor) -> Result<SurfaceDistance> {
    let denser = surface.denser_sphere();
    let values = synthesis(&Directions::from_vertices(&denser.vertices)?, coefficients.values().view())?;
    let vertices = values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
    let given = Mesh::new(surface.vertices.clone(), surface.faces.clone());
    let found = Mesh::new(vertices, denser.faces);
    Ok(surface_distance(&given, &found, &SurfaceDistanceParams::default(), monitor)?)
}

/// Runs the experiment of table 1. For the memory limit and 1/2, 1/4 and 1/8 of it, finds the largest degree at which
/// the solver's plan for NLSF stays within the limit. For the full limit, also runs a fit at this degree or at degree
/// `extent.nlsf`, whichever is lower.
pub(crate) fn nlsf(
    bench: &Bench<'_>,
    extent: &Extent,
    operator: &DiskOperator,
    surface: &Surface,
) -> Result<Vec<Nlsf>> {
    let vertices = surface.vertices.len();
    let in_memory = |memory: usize| {
        let plan_to = |max_degree| plan(operator, 3, &Bench { memory, ..*bench }.params(Method::Nlsf, max_degree));
        let fits = (0..=operator.max_degree()).rev().find_map(|degree| Some((degree, plan_to(degree).ok()?.total)));
        let max_degree = fits.map(|(degree, _)| degree);
        let capped = max_degree == Some(operator.max_degree());
        Nlsf { vertices, memory, max_degree, capped, planned: fits.map(|(_, bytes)| bytes), fitted: None }
    };
    let memories = [bench.memory / 8, bench.memory / 4, bench.memory / 2, bench.memory];
    let mut rows: Vec<Nlsf> = memories.into_iter().map(in_memory).collect();
    if let Some(row) = rows.last_mut()
        && let Some(most) = row.max_degree
    {
        let degree = most.min(extent.nlsf);
        bench.note(format!("{}: table 1, NLSF to degree {degree}", surface.name));
        let (sweeps, _) = bench.fit(operator, surface, Method::Nlsf, degree)?;
        row.fitted = sweeps.last().map(|&measured| (degree, measured));
    }
    Ok(rows)
}

/// Builds the bases of figure 3, each in a separate temporary folder in `store`.
pub(crate) fn basis(bench: &Bench<'_>, extent: &Extent, store: &Path) -> Result<Vec<Basis>> {
    let by_degree = extent.basis_degrees.iter().map(|&degree| ("degree", extent.subdivisions, degree));
    let by_vertices = extent.basis_subdivisions.iter().map(|&s| ("vertices", s, extent.basis_degree));
    let one = |(along, subdivisions, max_degree): (&'static str, u32, usize)| -> Result<Basis> {
        let directions = Directions::from_vertices(&icosphere(subdivisions).vertices)?;
        let vertices = directions.len();
        bench.note(format!("figure 3: computing the basis at {vertices} vertices up to degree {max_degree}"));
        let scratch = tempfile::Builder::new()
            .prefix(".figure3.")
            .tempdir_in(store)
            .with_context(|| format!("{}: cannot create a folder", store.display()))?;
        let (report, seconds) = bench.build(scratch.path(), &directions, max_degree)?;
        Ok(Basis { along, vertices, max_degree, seconds, bytes: report.bytes })
    };
    by_degree.chain(by_vertices).map(one).collect()
}

impl Pass {
    /// Returns whether this is the result after `passes` passes at granularity `granularity`.
    pub(crate) fn is(&self, passes: usize, granularity: usize) -> bool {
        self.pass == passes && self.granularity == granularity
    }

    /// Returns the number of basis functions, K.
    pub(crate) fn columns(&self) -> usize {
        basis_size(self.max_degree)
    }
}
