//! Reads the input surfaces of a group, and plans the memory for them.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::OnceLock;

use anyhow::{Result, bail};
use serde::Deserialize;
use spharm::correspond::{CorrespondParams, Group};
use spharm::parametrize::volume::{LabelVolume, VolumeDoubt, VolumeDoubts, VolumeReading, is_volume};
use spharm::{Error, FileRecord, Kind, Mesh, Model, Silent, Sphere};
use spharm_cli::inputs::{expand_lists, stem, tidied};
use spharm_cli::memory::Memory;
use spharm_cli::names::NameTemplate;
use spharm_cli::paths::model_name;
use spharm_cli::threads::Threads;
use spharm_cohort::{Manifest, Row, is_model};
use spharm_surface::generate::icosphere_counts;
use spharm_surface::io::{bytes_to_read, read_mesh, read_signal};

use crate::table::{LANDMARKS, files_of};

/// Subdivisions of the icosphere on which models are evaluated: 10,242 directions.
const OF_MODELS: u32 = 5;

/// A surface to read.
#[derive(Debug, Default)]
pub(crate) struct Surface {
    pub(crate) name: String,
    pub(crate) path: PathBuf,
    /// Label in a volume; `None` for a mesh, or if the volume has a single label.
    pub(crate) label: Option<i64>,
    /// Settings for reading a volume.
    pub(crate) reading: VolumeReading,
    /// Radius within which a label's surface is smoothed, in voxels; `None` for the default.
    pub(crate) radius: Option<f64>,
    /// Whether the surface is mirrored first, x to -x.
    pub(crate) mirrored: bool,
    /// Files of signals (one value for each of the surface's vertices) to match.
    pub(crate) signals: Vec<PathBuf>,
    /// Surface of a label, and doubts about the voxel size and position of its volume; kept in memory because making
    /// the surface takes a long time.
    of_label: OnceLock<(Mesh, Vec<VolumeDoubt>)>,
}

/// Name of the column of a table that states for each surface whether it is mirrored: yes or no.
pub const MIRRORED: &str = "mirrored";

/// A signal to match and its weight, as given by `--with`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub struct With {
    /// Name of a column of the table, or of a file in the surface's folder. In a file's name, {stem} is replaced by the
    /// surface's name.
    pub name: String,
    /// A difference of one standard deviation of the signal counts as much as a distance of `weight` times the square
    /// root of the surface's area.
    pub weight: f64,
}

/// Default weight of a signal: close to the weight of normals, 0.12.
const WEIGHT: f64 = 0.1;

impl FromStr for With {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let weighted = text.rsplit_once(':').and_then(|(name, weight)| Some((name, weight.parse::<f64>().ok()?)));
        let (name, weight) = weighted.unwrap_or((text, WEIGHT));
        if name.is_empty() || !(weight > 0.0 && weight.is_finite()) {
            return Err("expected SIGNAL or SIGNAL:WEIGHT, with a weight above 0".to_owned());
        }
        Ok(Self { name: name.to_owned(), weight })
    }
}

impl TryFrom<String> for With {
    type Error = String;

    fn try_from(text: String) -> std::result::Result<Self, String> {
        text.parse()
    }
}

/// Finds the files of signals: in a column of the table, or in each surface's folder.
///
/// # Errors
///
/// If a file doesn't exist.
pub(super) fn find_signals(surfaces: &mut [Surface], with: &[With], table: Option<&Path>) -> Result<()> {
    let manifest = table.map(Manifest::read).transpose()?;
    for With { name, .. } in with {
        let of_column = match (&manifest, table) {
            (Some(manifest), Some(table)) => files_of(manifest, name, table)?,
            _ => None,
        };
        for (index, surface) in surfaces.iter_mut().enumerate() {
            let beside = || surface.path.with_file_name(name.replace("{stem}", &stem(&surface.path)));
            let path = of_column.as_ref().map_or_else(beside, |files| files[index].clone());
            if !path.is_file() {
                let column = if table.is_some() { ", and no column of the table has this name" } else { "" };
                bail!("--with {name}: {}: no such file{column}", path.display());
            }
            surface.signals.push(path);
        }
    }
    Ok(())
}

impl Surface {
    /// Returns the record of the file from which the surface is read.
    pub(super) fn record(&self) -> Result<FileRecord> {
        let (record, image) = (FileRecord::of(&self.path)?, self.reading.image);
        Ok(FileRecord { label: self.label, channel: image.channel, time: image.time, ..record })
    }

    /// Returns the order of the axes in which a volume is read; `None` for other files.
    pub(super) fn axes(&self) -> Option<String> {
        is_volume(&self.path).then(|| self.reading.axes.name().to_owned())
    }

    /// Reads the signals, each with one value per vertex.
    pub(super) fn read_signals(&self) -> std::result::Result<Vec<Vec<f64>>, Error> {
        let one = |path: &PathBuf| {
            let signal = read_signal(path)?;
            if signal.channels != 1 {
                let (expected, found) = ("one value per vertex".to_owned(), format!("{} values", signal.channels));
                return Err(Error::GroupFile { path: path.clone(), expected, found });
            }
            Ok(signal.values)
        };
        self.signals.iter().map(one).collect()
    }

    pub(crate) fn read(&self) -> std::result::Result<Mesh, Error> {
        if is_volume(&self.path) {
            if let Some((mesh, _)) = self.of_label.get() {
                return Ok(mesh.clone());
            }
            let volume = LabelVolume::read_with(&self.path, self.reading, &Silent)?;
            let mesh = volume.smooth_surface(self.label, self.radius, &Silent)?;
            return Ok(self.of_label.get_or_init(|| (mesh, volume.doubts())).0.clone());
        }
        if !is_model(&self.path) {
            return Ok(read_mesh(&self.path)?);
        }
        let model = Model::read(&self.path)?;
        if model.kind() != Kind::Surface {
            let (expected, found) = ("a model of a surface".to_owned(), "a signal".to_owned());
            return Err(Error::GroupFile { path: self.path.clone(), expected, found });
        }
        Ok(model.reconstruct(&Sphere::icosphere(OF_MODELS), model.coefficients.max_degree())?)
    }
}

/// Returns the warnings about voxel sizes and positions of the volumes read so far, one for each kind of doubt.
pub(super) fn volume_warnings<'a>(surfaces: impl IntoIterator<Item = &'a Surface>) -> Vec<String> {
    let mut doubts = VolumeDoubts::default();
    for surface in surfaces {
        if let Some((_, found)) = surface.of_label.get() {
            doubts.add(&surface.path, found);
        }
    }
    doubts.warnings()
}

/// Returns the warnings about the whole group.
pub(super) fn of_group(group: &Group, surfaces: &[Surface]) -> Vec<String> {
    let moved = surfaces.iter().zip(&group.similarities);
    let members: Vec<(&str, bool)> = moved.map(|(surface, moved)| (surface.name.as_str(), moved.mirrors())).collect();
    group.report.of_group(&members)
}

/// Reads a mesh from the file of a mesh, or evaluates the model in a file as a mesh.
pub(crate) fn read(path: &Path) -> Result<Mesh> {
    Ok(Surface { path: path.to_owned(), ..Surface::default() }.read()?)
}

/// Returns the surfaces named by paths and lists. Checks that all files exist and that all names are distinct.
pub(crate) fn surfaces(paths: &[PathBuf], template: &NameTemplate) -> Result<Vec<Surface>> {
    let mut surfaces: Vec<Surface> = Vec::new();
    for path in expand_lists(paths)? {
        check(&path)?;
        let by_template = template.name(&path, None);
        let name = if is_model(&path) { model_name(Path::new(&by_template)) } else { by_template };
        if let Some(other) = surfaces.iter().find(|other| other.name == name) {
            bail!(
                "{} and {}: both have the name {name}; distinguish them with --name-template, such as {{parent}}_{{stem}}",
                other.path.display(),
                path.display()
            );
        }
        surfaces.push(Surface { name, path, ..Surface::default() });
    }
    Ok(surfaces)
}

/// Returns the surfaces of a table, named by their ids, and the list of their landmark files. The list is empty if the
/// table has no column of landmarks.
pub(crate) fn of_table(table: &Path) -> Result<(Vec<Surface>, Vec<PathBuf>)> {
    let manifest = Manifest::read(table)?;
    let landmarks = files_of(&manifest, LANDMARKS, table)?.unwrap_or_default();
    let at = manifest.columns.iter().position(|name| name == MIRRORED);
    let surface = |row: &Row| {
        let path = tidied(&row.surface);
        check(&path)?;
        let mirrored = match at.map_or("no", |at| row.extra[at].trim()) {
            "yes" => true,
            "no" | "" => false,
            found => bail!(
                "{}: line {}: column {MIRRORED:?}: expected yes or no, found {found:?}",
                table.display(),
                row.line
            ),
        };
        Ok(Surface { name: row.id.clone(), path, label: row.label, mirrored, ..Surface::default() })
    };
    let surfaces = manifest.rows.iter().map(surface).collect::<Result<_>>()?;
    Ok((surfaces, landmarks.iter().map(|path| tidied(path)).collect()))
}

fn check(path: &Path) -> Result<()> {
    if path.is_dir() {
        bail!("{}: this path is a folder; give the files in the folder, or a list of paths as @LIST", path.display());
    }
    if !path.exists() {
        bail!("{}: no such file", path.display());
    }
    Ok(())
}

/// Adds the path of the surface to an error about a member.
pub(crate) fn named(error: Error, surfaces: &[Surface]) -> anyhow::Error {
    match error {
        Error::Member { index, source } if index < surfaces.len() => {
            anyhow::Error::from(*source).context(surfaces[index].path.display().to_string())
        }
        error => error.into(),
    }
}

/// Refuses groups that don't fit into memory. A new group needs memory for the corresponding points and the
/// coefficients of all members. If members are added to an existing group one after another, only `compared` existing
/// members are in memory.
pub(crate) fn plan(
    surfaces: &[PathBuf],
    params: &CorrespondParams,
    compared: Option<usize>,
    (memory, threads): (Memory, Threads),
) -> Result<()> {
    let threads = threads.count();
    let budget = memory.budget(threads);
    let largest = surfaces.iter().max_by_key(|path| bytes_to_read(path));
    let Some(largest) = largest else { return Ok(()) };
    budget.check_inputs("shape correspond", [largest.as_path()])?;
    let count = surfaces.len();
    let needed = needed(count as u64, bytes_to_read(largest), params, compared, threads as u64);
    let what = format!("shape correspond of {count} surfaces to degree {}", params.max_degree);
    budget.check(what, needed)
}

/// Returns the memory needed, in bytes:
/// - for each member in memory, several copies of its corresponding points and coefficients;
/// - for each thread, a surface with its search trees, and the arrays of a registration;
/// - for each existing member with which new members are compared, two copies of its values, with six channels;
/// - for the template, its kernels of 200 columns each and the factor of its thin plate.
///
/// In a new group, the template is also mapped to the sphere. If the mapping needs more memory than the registrations,
/// the memory of the mapping replaces theirs.
///
/// The file of a mesh with v vertices has at least 20 v bytes. Reading this mesh takes 60 v bytes of memory.
fn needed(count: u64, largest: u64, params: &CorrespondParams, compared: Option<usize>, threads: u64) -> u64 {
    let [n, _] = icosphere_counts(params.subdivisions());
    let (degree, whole) = (params.max_degree as u64, compared.is_none());
    let refined = if params.refinement.is_some() { 500 } else { 0 };
    let member = (150 + refined) * n + 144 * (degree + 1).pow(2);
    let stages = params.register.drift.len() as u64;
    let template = 1600 * stages * (n + 3000) + 6000 * n;
    let each = 4 * largest + 2000 * n + (8 << 20);
    let registering = template.saturating_add(threads.min(count).saturating_mul(each));
    let mapping = if whole { (4 << 20) + 50 * largest + 5500 * degree.max(40).pow(2) } else { 0 };
    let held = if whole { count } else { threads.min(count) };
    let comparing = compared.unwrap_or(0) as u64 * (100 * n + 24 * (degree + 1).pow(2));
    held.saturating_mul(member).saturating_add(comparing).saturating_add(registering.max(mapping))
}
