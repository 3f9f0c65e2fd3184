//! `generate --study` and `--volumes`: writes subjects of two groups, as meshes or as label volumes, and their table.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use nifti::NiftiHeader;
use nifti::writer::WriterOptions;
use spharm_cli::output::{OutputFile, check_outputs, prepare, print_line};
use spharm_surface::generate::{Study, Voxels, cortex_bytes, icosphere_counts};
use spharm_surface::io::{Output, WriteOptions, write_mesh, write_new};

use super::{Cli, WRITING};

/// Memory, in bytes, for holding and writing the voxels of one subject whose bump is at most [`HIGHEST`] high.
const VOXELS: u64 = 64 << 20;
/// Maximum height of the bump in label volumes, in mm. Higher bumps make the volumes larger.
const HIGHEST: f64 = 100.0;
/// Wrong voxel size, in mm, that one subject's header states; the true size is 1 mm.
const WRONG: f64 = 10.0;

/// A subject in a generated study.
struct Subject {
    name: String,
    group: &'static str,
    /// Index of the subject within its group, from 0.
    index: u64,
}

/// Writes the meshes of a study and its table.
pub(super) fn meshes(cli: &Cli, folder: &Path) -> Result<()> {
    let study = Generated::new(cli, folder, ("--study", "ply"), 0)?;
    for (subject, path) in study.subjects.iter().zip(&study.files) {
        let options = WriteOptions { overwrite: cli.force, double: cli.double };
        write_mesh(path, &study.mesh(subject), &options)?;
    }
    study.finish(cli, folder, "meshes, and study.csv")
}

/// Writes the label volumes of a study, one of which has a wrong header, and the study's table.
pub(super) fn volumes(cli: &Cli, folder: &Path) -> Result<()> {
    if !(-HIGHEST..=HIGHEST).contains(&cli.bump) {
        bail!("--bump: for --volumes, expected a value from -{HIGHEST} to {HIGHEST} mm, found {}", cli.bump);
    }
    let study = Generated::new(cli, folder, ("--volumes", "nii.gz"), VOXELS)?;
    let spoilt = study.subjects.iter().rposition(|subject| subject.group == "a");
    for (at, (subject, path)) in study.subjects.iter().zip(&study.files).enumerate() {
        let voxels = Voxels::of(&study.mesh(subject), 1.0);
        let bytes = nifti(&voxels, if Some(at) == spoilt { WRONG } else { 1.0 })?;
        write_new(path, cli.force, |out| out.write_all(&bytes))?;
    }
    let named = spoilt.map(|at| study.subjects[at].name.clone()).unwrap_or_default();
    let what = format!(
        "label volumes, and study.csv; the header of {named} wrongly states voxels of {WRONG} mm instead of 1 mm"
    );
    study.finish(cli, folder, &what)
}

/// Returns the bytes of a gzipped NIfTI file with `voxels`. `size` is the voxel size in mm that the header states.
fn nifti(voxels: &Voxels, size: f64) -> Result<Vec<u8>> {
    let row = |k: usize| {
        let mut row = [0.0; 4];
        (row[k], row[3]) = (size as f32, (size * voxels.origin[k]) as f32);
        row
    };
    let step = size as f32;
    let header = NiftiHeader {
        pixdim: [1.0, step, step, step, 1.0, 1.0, 1.0, 1.0],
        // The unit is millimetres, and the matrix maps voxels to the scanner's coordinates.
        xyzt_units: 2,
        sform_code: 1,
        // The qform and the sform describe the same coordinates, because a reader may use either of them.
        qform_code: 1,
        quatern_x: row(0)[3],
        quatern_y: row(1)[3],
        quatern_z: row(2)[3],
        srow_x: row(0),
        srow_y: row(1),
        srow_z: row(2),
        ..NiftiHeader::default()
    };
    let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
    let file = folder.path().join("labels.nii.gz");
    WriterOptions::new(&file)
        .reference_header(&header)
        .write_nifti(&voxels.values)
        .context("cannot write the volume")?;
    std::fs::read(&file).context("cannot read the volume")
}

/// A study to write, with one file for each subject.
struct Generated {
    study: Study,
    subjects: Vec<Subject>,
    files: Vec<PathBuf>,
    table: PathBuf,
}

impl Generated {
    /// Checks the arguments, the memory and the outputs. `more` is the memory in bytes needed in addition to a mesh.
    fn new(cli: &Cli, folder: &Path, (flag, ending): (&'static str, &str), more: u64) -> Result<Self> {
        if !cli.bump.is_finite() {
            bail!("--bump: expected a finite number, found {}", cli.bump);
        }
        let subdivisions = cli.subdivisions.unwrap_or(Study::default().subdivisions);
        let study = Study { subdivisions, seed: cli.variant, bump: cli.bump };
        let half = cli.subjects.div_ceil(2);
        let digits = cli.subjects.to_string().len().max(2);
        let subject = |number: u64| {
            let (group, index) = if number >= half { ("b", number - half) } else { ("a", number) };
            Subject { name: format!("{group}{:0digits$}", index + 1), group, index }
        };
        // Memory for a single mesh, because meshes are generated and written one after another.
        let needed = cortex_bytes(study.subdivisions) + WRITING * icosphere_counts(study.subdivisions)[0] + more;
        cli.memory.budget(1).check(format!("generate {flag}"), needed)?;
        let subjects: Vec<Subject> = (0..cli.subjects).map(subject).collect();
        let file = |subject: &Subject| folder.join(format!("{}.{ending}", subject.name));
        let files: Vec<PathBuf> = subjects.iter().map(file).collect();
        let table = folder.join("study.csv");
        let outputs = files.iter().map(|path| match ending {
            "ply" => OutputFile::holding(path, flag, Output::OrderedMesh),
            _ => OutputFile::new(path, flag),
        });
        check_outputs(outputs.chain([OutputFile::new(&table, flag)]), cli.force)?;
        prepare(&table)?;
        Ok(Self { study, subjects, files, table })
    }

    fn mesh(&self, subject: &Subject) -> spharm_surface::Mesh {
        self.study.subject(subject.index, subject.group == "b")
    }

    /// Writes the table of the subjects, and prints a summary of the written files.
    fn finish(&self, cli: &Cli, folder: &Path, what: &str) -> Result<()> {
        let row = |(subject, path): (&Subject, &PathBuf)| {
            let file = path.file_name().unwrap_or_default().display();
            format!("{},{file},{}\n", subject.name, subject.group)
        };
        let rows: String = self.subjects.iter().zip(&self.files).map(row).collect();
        let text = format!("id,surface,group\n{rows}");
        write_new(&self.table, cli.force, |out| out.write_all(text.as_bytes()))?;
        print_line(&format!("{}: {} {what}", folder.display(), self.files.len()))
    }
}
