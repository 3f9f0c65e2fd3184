//! Models evaluated on one sphere, beside them.

use std::path::PathBuf;

use anyhow::Result;
use spharm::files::ModelFiles;
use spharm::generate::{icosphere_bytes, icosphere_counts};
use spharm::io::WriteOptions;
use spharm::{Fit, Kind, Model, Sphere};
use spharm_cli::memory::Budget;
use spharm_cli::output::prepare;
use spharm_surface::Hemisphere;
use spharm_surface::io::{write_mesh, write_signal_of};

/// The icosphere on which models to a degree are evaluated, where there is memory for that; `option` is what asks for
/// it, up to the number.
pub(crate) fn icosphere_within(budget: Budget, option: &str, subdivisions: u32, degree: usize) -> Result<Sphere> {
    let needed = |subdivisions: u32| {
        let [vertices, faces] = icosphere_counts(subdivisions);
        icosphere_bytes(subdivisions).max(Model::bytes_to_evaluate(vertices, faces, 3, degree))
    };
    let (verb, setting) = option.split_once(' ').unwrap_or_default();
    let fewer = (0..subdivisions).rev().map(|fewer| (format!("{setting}{fewer}"), needed(fewer)));
    budget.check_or(format_args!("{verb} {setting}{subdivisions}"), needed(subdivisions), fewer)?;
    Ok(Sphere::icosphere(subdivisions))
}

/// A sphere on which every model is evaluated.
pub(crate) struct Evaluate {
    pub(crate) sphere: Sphere,
    /// What the files are called after the models: `ico6`.
    pub(crate) name: String,
}

impl Evaluate {
    /// The file of a surface, or of a signal.
    fn path(&self, files: &ModelFiles, kind: Kind) -> PathBuf {
        let ending = if kind == Kind::Surface { "surf.gii" } else { "shape.gii" };
        files.model.with_file_name(format!("{}.{}.{ending}", files.name(), self.name))
    }

    /// The file, before it is known what it holds: the one that is there, or a surface's.
    pub(super) fn file(&self, files: &ModelFiles) -> PathBuf {
        let signal = self.path(files, Kind::Signal);
        if signal.exists() { signal } else { self.path(files, Kind::Surface) }
    }

    /// Writes a fit's values on the sphere.
    pub(super) fn write(&self, files: &ModelFiles, sphere: &Sphere, fit: &Fit, overwrite: bool) -> Result<()> {
        let kind = fit.report.settings.kind;
        let model = Model::new(sphere.clone(), fit.clone(), kind);
        let (path, degree) = (self.path(files, kind), model.coefficients.max_degree());
        let options = WriteOptions { overwrite, double: false };
        let cortex =
            Hemisphere::of(sphere.anatomical_structure.as_deref(), sphere.path.as_deref()).map(Hemisphere::cortex);
        prepare(&path)?;
        match kind {
            Kind::Surface => {
                let mut mesh = model.reconstruct(&self.sphere, degree)?;
                let structure = &mut mesh.meta.anatomical_structure_primary;
                *structure = structure.take().or(cortex.map(str::to_owned));
                write_mesh(&path, &mesh, &options)?;
            }
            _ => write_signal_of(&path, &model.reconstruct_signal(&self.sphere, degree)?, cortex, &options)?,
        }
        Ok(())
    }
}
