//! Evaluates every model on a common sphere, and writes each result to a file beside the model.

use std::path::PathBuf;

use spharm::io::WriteOptions;
use spharm::{Error, Fit, Kind, Sphere};
use spharm_surface::Hemisphere;
use spharm_surface::io::{write_mesh, write_signal_of};

use crate::files::{ModelFiles, make_folder_of};

/// A sphere on which every model is evaluated.
#[derive(Debug, Clone)]
pub struct Evaluate {
    /// The sphere for all models, except those evaluated on [`right`](Self::right).
    pub sphere: Sphere,
    /// The sphere for models of right hemispheres, if it differs from [`sphere`](Self::sphere).
    pub right: Option<Sphere>,
    /// Name of the sphere in file names, such as `ico6`.
    pub name: String,
}

impl Evaluate {
    /// Returns the path of the file for the evaluated surface or signal.
    fn path(&self, files: &ModelFiles, kind: Kind) -> PathBuf {
        let ending = if kind == Kind::Surface { "surf.gii" } else { "shape.gii" };
        files.model.with_file_name(format!("{}.{}.{ending}", files.name(), self.name))
    }

    /// Returns the path of the evaluated signal if that file exists, otherwise the path of the evaluated surface.
    /// Callers use it if they don't know the kind of the model.
    pub(crate) fn file(&self, files: &ModelFiles) -> PathBuf {
        let signal = self.path(files, Kind::Signal);
        if signal.exists() { signal } else { self.path(files, Kind::Surface) }
    }

    /// Evaluates a fit on the common sphere, and writes the values to a file.
    pub(crate) fn write(&self, files: &ModelFiles, sphere: &Sphere, fit: &Fit, overwrite: bool) -> Result<(), Error> {
        let kind = fit.report.settings.kind;
        let model = fit.clone().into_model(sphere.clone());
        let (path, degree) = (self.path(files, kind), model.coefficients.max_degree());
        let options = WriteOptions { overwrite, double: false };
        let hemisphere = sphere.hemisphere();
        let on = self.right.as_ref().filter(|_| hemisphere == Some(Hemisphere::Right)).unwrap_or(&self.sphere);
        // If the sphere was computed for the model's surface, the surface may be of any object, not only a brain, so
        // its anatomical structure isn't set to a cortex.
        let cortex = hemisphere.filter(|_| !sphere.parametrized).map(Hemisphere::cortex);
        make_folder_of(&path)?;
        match kind {
            Kind::Surface => {
                let mut mesh = model.reconstruct(on, degree)?;
                let structure = &mut mesh.meta.anatomical_structure_primary;
                *structure = structure.take().or(cortex.map(str::to_owned));
                write_mesh(&path, &mesh, &options)?;
            }
            _ => write_signal_of(&path, &model.reconstruct_signal(on, degree)?, cortex, &options)?,
        }
        Ok(())
    }
}
