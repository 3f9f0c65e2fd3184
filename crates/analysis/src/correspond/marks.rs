//! Carries each member's landmarks to other members of a group, to measure the error of the correspondence.

use std::path::{Path, PathBuf};

use anyhow::{Error, Result, anyhow, bail};
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::correspond::{Group, GuideLandmarks, GuideReport};
use spharm_cli::Usage;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::same_place;
use spharm_surface::geometry::{Vec3, dot, sub};

use super::super::landmarks::{Marks, of_surfaces};
use super::surfaces::Surface;

/// Maximum number of members to which each member's landmarks are carried.
const OTHERS: usize = 40;

/// Errors of carried landmarks: the distance of each carried landmark from the target member's own landmark.
pub(super) struct Errors {
    names: Vec<String>,
    mean: f64,
    median: f64,
    by_landmark: Vec<f64>,
    carried: usize,
    unreached: usize,
    pub(super) warnings: Vec<String>,
    guide: Option<GuideReport>,
}

impl Errors {
    pub(super) fn json(&self) -> Value {
        json!({
            "names": self.names,
            "mean": self.mean,
            "median": self.median,
            "by_landmark": self.by_landmark,
            "carried": self.carried,
            "unreached": self.unreached,
            "guide": self.guide,
        })
    }

    pub(super) fn line(&self) -> String {
        let Self { mean, median, carried, unreached, .. } = self;
        let of_guide = self.guide.as_ref().map_or_else(String::new, |guide| {
            let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
            let (guided, left_out) = (mean(&guide.guided), mean(&guide.left_out));
            format!("; mean error at the guiding landmarks: {guided:.3}, or {left_out:.3} when they are left out")
        });
        format!(
            "landmark error: mean {mean:.3}, median {median:.3} over {carried} carried landmarks; {unreached} had no \
             counterpart{of_guide}"
        )
    }
}

/// Reads the landmarks, if any are given.
pub(super) fn read(named: &[PathBuf], surfaces: &[Surface]) -> Result<Option<Marks>> {
    if named.is_empty() {
        return Ok(None);
    }
    let paths: Vec<PathBuf> = surfaces.iter().map(|surface| surface.path.clone()).collect();
    of_surfaces(named, &paths, |index| Ok(surfaces[index].read()?)).map(Some)
}

/// Returns the landmarks that guide the registration. A given template must be one of the surfaces, because the
/// landmarks of that surface are also used for the template.
pub(super) fn guide(marks: Option<&Marks>, template: Option<&Path>, paths: &[PathBuf]) -> Result<GuideLandmarks> {
    let Some(marks) = marks else {
        return Err(
            Usage::missing("--guide needs landmarks: give --landmarks, or a column `landmarks` in the table").into()
        );
    };
    let of_template = |file: &Path| match paths.iter().position(|path| same_place(path, file)) {
        Some(index) => Ok(marks.points[index].clone()),
        None => bail!("{}: with --guide, the template must be one of the surfaces", file.display()),
    };
    Ok(GuideLandmarks { members: marks.points.clone(), template: template.map(of_template).transpose()? })
}

/// Returns the error about a landmark that is too far from its surface to guide the registration. The returned error
/// states the surface's path and the landmark's name. Returns `None` if `error` has another cause.
pub(super) fn far(error: &spharm::Error, names: &[String], surfaces: &[Surface]) -> Option<Error> {
    let spharm::Error::Member { index, source } = error else { return None };
    let spharm::Error::FarGuide(far) = &**source else { return None };
    let path = surfaces.get(*index)?.path.display();
    Some(anyhow!("{path}: {}", far.reason(names.get(far.landmark)?)))
}

/// Carries the landmarks of each member to at most [`OTHERS`] other members, and measures the errors. Warns about
/// landmarks that seem to be swapped or misplaced.
pub(super) fn errors(marks: Marks, surfaces: &[Surface], group: &Group, monitor: &ConsoleMonitor) -> Result<Errors> {
    let count = group.models.len();
    // Carrying a member's landmarks to the same member gives the landmarks with which those carried from other members
    // are compared.
    let own = (0..count).into_par_iter().map(|member| group.carry(&marks.points[member], member, member));
    let own = own.collect::<Result<Vec<_>, _>>()?;
    let of_source = |source: usize| -> Result<Vec<Vec<(f64, bool)>>> {
        let others = (1..count).take(OTHERS).map(|step| (source + step) % count);
        others
            .map(|target| {
                spharm::Monitor::check(monitor)?;
                let carried = group.carry(&marks.points[source], source, target)?;
                let apart = carried.iter().zip(&own[target]);
                Ok(apart.map(|(carried, own)| (length(sub(carried.point, own.point)), carried.reached)).collect())
            })
            .collect()
    };
    let all = (0..count).into_par_iter().map(of_source).collect::<Result<Vec<_>>>()?.concat();
    let mut distances: Vec<f64> = all.iter().flatten().map(|found| found.0).collect();
    distances.sort_unstable_by(f64::total_cmp);
    let mean = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
        sum / f64::from(count.max(1))
    };
    let mut warnings = marks.warnings;
    for found in group.misplaced_landmarks(&marks.points)? {
        let text = found.of_member(|landmark| marks.names[landmark].clone());
        warnings.push(format!("{}: {text}", surfaces[found.member].name));
    }
    Ok(Errors {
        by_landmark: (0..marks.names.len()).map(|k| mean(&mut all.iter().map(|pair| pair[k].0))).collect(),
        mean: mean(&mut distances.iter().copied()),
        median: distances.get(distances.len() / 2).copied().unwrap_or(0.0),
        carried: distances.len(),
        unreached: all.iter().flatten().filter(|found| !found.1).count(),
        names: marks.names,
        warnings,
        guide: group.report.guide.clone(),
    })
}

fn length(v: Vec3) -> f64 {
    dot(v, v).sqrt()
}
