//! `shape align` for meshes: aligns surfaces of any topology by nearest points alone.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::{Mesh, Monitor, Silent, Stage};
use spharm_cli::Usage;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare, write_json};
use spharm_cli::paths::shown;
use spharm_exchange::Format;
use spharm_monitor::number;
use spharm_surface::Similarity;
use spharm_surface::io::landmarks::Frame;
use spharm_surface::io::{Output, WriteOptions, read_mesh, to_write_mesh, write_mesh};
use spharm_surface::pose::{FixedSurface, NearerMirrored, Pose, PoseParams, PoseSurface, distance, group_poses};

use super::args::{ReportArgs, Resources};
use super::groups::axes_differ;
use super::outputs::{check_beside, finish};

/// A request to align meshes.
pub(super) struct Asked<'a> {
    pub(super) paths: &'a [PathBuf],
    /// The mesh to which the other meshes are aligned; `None` aligns the meshes to each other.
    pub(super) target: Option<&'a Path>,
    pub(super) output: &'a Path,
    pub(super) transforms: Option<&'a Path>,
    pub(super) params: PoseParams,
    pub(super) report: &'a ReportArgs,
    pub(super) resources: &'a Resources,
}

/// Rigid motions and scales of the meshes, and each mesh's distance from the target or from the other meshes, before
/// and after the alignment.
struct Found {
    motions: Vec<Similarity>,
    distances: Vec<[Option<f64>; 2]>,
    warnings: Vec<String>,
    typical: Option<usize>,
}

/// Returns whether files are meshes rather than models, judging by their names.
///
/// # Errors
///
/// If the files include both models and meshes, or coefficients of another package.
pub(super) fn are_meshes<'a>(files: impl IntoIterator<Item = &'a Path>) -> Result<bool> {
    let is_model = |path: &Path| {
        let name = path.to_string_lossy().to_ascii_lowercase();
        [".npz", ".sphz"].iter().any(|ending| name.ends_with(ending))
    };
    let (models, meshes): (Vec<&Path>, Vec<&Path>) = files.into_iter().partition(|path| is_model(path));
    if let Some(path) = meshes.iter().find(|path| are_coefficients(path)) {
        bail!(
            "{}: expected a model or a mesh, found a file of another package's coefficients (judging by its name); \
             make a model of it with `spharm import`",
            path.display()
        );
    }
    match (models.first(), meshes.first()) {
        (Some(model), Some(mesh)) => bail!(
            "expected only models or only meshes, found both: {} and {}; make meshes of models with `spharm \
             reconstruct`",
            model.display(),
            mesh.display()
        ),
        (_, meshes) => Ok(meshes.is_some()),
    }
}

/// Returns whether a file holds coefficients of another package, judging by the file's name. Only the extensions of
/// SPHARM-PDM and SPHARM-MAT are considered, because other packages use extensions, such as `.txt`, that files of
/// points or meshes may have too.
fn are_coefficients(path: &Path) -> bool {
    let name = path.to_string_lossy().to_ascii_lowercase();
    [Format::Pdm, Format::Mat].iter().flat_map(|format| format.endings()).any(|ending| name.ends_with(ending))
}

/// Runs `shape align` for meshes.
pub(super) fn run(asked: &Asked<'_>, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let targets = outputs(asked)?;
    let files = targets.iter().map(|path| OutputFile::holding(path, "--output", Output::Mesh));
    let json_out = asked.transforms.iter().map(|path| OutputFile::new(path, "--transforms"));
    check_beside(asked.paths, files.chain(json_out), asked.report)?;
    let inputs = asked.paths.iter().map(PathBuf::as_path).chain(asked.target);
    asked.resources.memory.budget(asked.resources.threads.count()).check_inputs("shape align", inputs)?;
    let found = asked.resources.threads.pool()?.install(|| match asked.target {
        Some(target) => to_target(asked, target, monitor),
        None => together(asked, monitor),
    })?;
    found.warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let options = WriteOptions { overwrite: asked.report.force, double: false };
    for ((path, motion), target) in asked.paths.iter().zip(&found.motions).zip(&targets) {
        monitor.check()?;
        prepare(target)?;
        write_mesh(target, &motion.apply_mesh(&read_mesh(path)?), &options)?;
    }
    let each: Vec<Value> = asked
        .paths
        .iter()
        .zip(&targets)
        .zip(found.motions.iter().zip(&found.distances))
        .map(|((path, target), (motion, [before, after]))| {
            json!({
                "surface": shown(path),
                "output": shown(target),
                "distance_before": before,
                "distance_after": after,
                "object": motion.orthogonal,
                "scale": motion.scale,
                "translation": motion.translation,
            })
        })
        .collect();
    if let Some(path) = asked.transforms {
        write_json(path, asked.report.force, &json!(each))?;
    }
    let cell = |distance: &Option<f64>| distance.map_or_else(|| "-".to_owned(), number);
    let names = if asked.target.is_some() {
        ["surface", "distance before", "after"]
    } else {
        ["surface", "distance from the others before", "after"]
    };
    let mut rows = vec![names.map(str::to_owned).to_vec()];
    for (target, [before, after]) in targets.iter().zip(&found.distances) {
        rows.push(vec![target.display().to_string(), cell(before), cell(after)]);
    }
    let report = json!({
        "surfaces": each,
        "pose": "surfaces",
        "to": asked.target.map(shown),
        "typical": found.typical.map(|member| shown(&asked.paths[member])),
        "warnings": found.warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("align", &report, &rows, asked.report)
}

/// Returns the output of each mesh: the named file for a single mesh, otherwise the mesh's own name in the output
/// folder.
fn outputs(asked: &Asked<'_>) -> Result<Vec<PathBuf>> {
    let named = to_write_mesh(asked.output).is_ok() && !asked.output.is_dir();
    match (asked.paths, named) {
        ([_], true) => Ok(vec![asked.output.to_owned()]),
        (_, true) => Err(Usage::conflict("--output must name a folder if several files are written").into()),
        (paths, false) => {
            Ok(paths.iter().map(|path| asked.output.join(path.file_name().unwrap_or(path.as_os_str()))).collect())
        }
    }
}

fn prepared<T>(path: &Path, prepare: impl FnOnce(&Mesh) -> Option<T>) -> Result<(T, Option<Frame>)> {
    let mesh: Mesh = read_mesh(path)?;
    let found = prepare(&mesh)
        .ok_or_else(|| anyhow!("{}: the surface has no area, so its pose can't be found", path.display()))?;
    Ok((found, mesh.meta.axes()))
}

fn to_target(asked: &Asked<'_>, target: &Path, monitor: &ConsoleMonitor) -> Result<Found> {
    let (fixed, _) = prepared(target, FixedSurface::new)?;
    monitor.begin(Stage::counted("align", "surfaces"), asked.paths.len() as u64);
    let one = |path: &PathBuf| -> Result<((Pose, Option<NearerMirrored>), f64)> {
        monitor.check()?;
        let (moving, _) = prepared(path, PoseSurface::new)?;
        let before = distance(&moving, fixed.surface(), &Similarity::default(), asked.params.trimmed);
        let found = fixed.pose(&moving, &asked.params, &Silent)?;
        monitor.step(1);
        Ok((found, before))
    };
    // Collect all results before returning an error, so that the error doesn't depend on the order in which threads
    // finish.
    let found: Vec<Result<_>> = asked.paths.par_iter().map(one).collect();
    monitor.end();
    let found = found.into_iter().collect::<Result<Vec<_>>>()?;
    let least = 1e-3 * fixed.surface().size();
    let doubts = |(path, ((pose, mirrored), _)): (&PathBuf, &((Pose, Option<NearerMirrored>), f64))| {
        let doubtful = pose.doubt(least).map(|(distance, second)| {
            format!(
                "the pose is doubtful: the distance between the surfaces is {distance:.4}, but another pose has a \
                 similar distance of {second:.4}"
            )
        });
        let mirrored = mirrored.as_ref().map(ToString::to_string);
        let texts = [doubtful, mirrored].into_iter().flatten();
        texts.map(|text| format!("{}: {text}", path.display())).collect::<Vec<_>>()
    };
    Ok(Found {
        motions: found.iter().map(|((pose, _), _)| pose.similarity).collect(),
        distances: found.iter().map(|((pose, _), before)| [Some(*before), Some(pose.distance)]).collect(),
        warnings: asked.paths.iter().zip(&found).flat_map(doubts).collect(),
        typical: None,
    })
}

fn together(asked: &Asked<'_>, monitor: &ConsoleMonitor) -> Result<Found> {
    let surfaces: Vec<Result<_>> = asked.paths.par_iter().map(|path| prepared(path, PoseSurface::new)).collect();
    let (surfaces, axes): (Vec<PoseSurface>, Vec<Option<Frame>>) =
        surfaces.into_iter().collect::<Result<Vec<_>>>()?.into_iter().unzip();
    let found = group_poses(&surfaces, &asked.params, monitor).context("shape align")?;
    let named = |member: usize, text: String| format!("{}: {text}", asked.paths[member].display());
    let axes = axes_differ(&axes, asked.paths, |path| path.display().to_string());
    let of_poses = found.warnings.iter().map(|warning| named(warning.member(), warning.of_member()));
    Ok(Found {
        motions: found.similarities,
        distances: found.distances.iter().map(|distance| [None, Some(*distance)]).collect(),
        warnings: axes.into_iter().chain(of_poses).collect(),
        typical: Some(found.template),
    })
}
