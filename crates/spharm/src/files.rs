//! The files of a fit: the model, and beside it what else was asked for.

use std::io;
use std::path::{Path, PathBuf};

use ndarray_npy::WriteNpyExt;
use spharm_model::csv::write_complex_csv;
use spharm_model::{FileRecord, Model};
use spharm_monitor::Monitor;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh, write_new};
use spharm_surface::{Sphere, SurfaceError};

use crate::parametrize::{CaldParams, Input, Parametrized, parametrize_with, with_sphere};
use crate::{Error, Fit, FitParams, check_memory};

/// Names of the files of one model: `NAME.spharm.npz` and those beside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelFiles {
    /// The model.
    pub model: PathBuf,
}

impl ModelFiles {
    /// Returns the name, `NAME`.
    #[must_use]
    pub fn name(&self) -> String {
        let name = self.model.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = name.strip_suffix(".npz").unwrap_or(&name);
        stem.strip_suffix(".spharm").unwrap_or(stem).to_owned()
    }

    /// Returns the table of complex coefficients, `NAME.spharm.csv`.
    #[must_use]
    pub fn csv(&self) -> PathBuf {
        self.model.with_extension("csv")
    }

    /// Returns the standard errors, `NAME.spharm.stderr.npy`.
    #[must_use]
    pub fn standard_errors(&self) -> PathBuf {
        self.model.with_extension("stderr.npy")
    }

    /// Returns the sphere that a surface was mapped to, `NAME.sphere.surf.gii`.
    #[must_use]
    pub fn sphere(&self) -> PathBuf {
        self.model.with_file_name(format!("{}.sphere.surf.gii", self.name()))
    }

    /// Returns the surface around a volume's label, `NAME.surf.gii`.
    #[must_use]
    pub fn surface(&self) -> PathBuf {
        self.model.with_file_name(format!("{}.surf.gii", self.name()))
    }

    /// Maps a surface to a sphere of its own, which is written beside the model to come, as is the surface of a label. With
    /// `reuse` the sphere that an earlier call left is taken if it is one of this mesh. Returns the map, and whether it is
    /// that one. The memory of the fit is checked first.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`], [`Error::Parametrize`], and [`Error::Surface`] for files that can't be written.
    pub fn map(
        &self,
        input: &Input,
        params: &FitParams,
        reuse: bool,
        replace: bool,
        monitor: &dyn Monitor,
    ) -> Result<(Parametrized, bool), Error> {
        let path = self.sphere();
        let named = |found: Parametrized| {
            let sphere = Sphere { path: Some(path.clone()), ..found.sphere };
            Parametrized { sphere, ..found }
        };
        if let Input::Mesh(mesh) = input {
            check_memory(mesh, params)?;
            let left_over = || with_sphere(mesh, &read_mesh(&path).ok()?).ok();
            if let Some(found) = if reuse && path.exists() { left_over() } else { None } {
                return Ok((named(found), true));
            }
        }
        let found = parametrize_with(input, &CaldParams::for_degree(params.max_degree), monitor)?;
        make_folder_of(&path)?;
        let options = WriteOptions { overwrite: replace, double: true };
        write_mesh(&path, &found.map.sphere, &options)?;
        if let Input::Label(_) = input {
            write_mesh(self.surface(), &found.map.surface, &options)?;
        }
        Ok((named(found), false))
    }

    /// Writes a fit's model, its standard errors if it has them, and with `csv` its complex coefficients; makes the folder.
    /// The model is written last, so that where it is, the others are.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] for files that exist, unless they are replaced, or can't be written.
    pub fn write(
        &self,
        sphere: &Sphere,
        fit: &Fit,
        input: Option<&FileRecord>,
        csv: bool,
        replace: bool,
    ) -> Result<(), Error> {
        let kind = fit.report.settings.kind;
        make_folder_of(&self.model)?;
        if csv {
            write_new(self.csv(), replace, |out| write_complex_csv(&fit.coefficients, out))?;
        }
        if let Some(errors) = &fit.standard_errors {
            write_new(self.standard_errors(), replace, |out| errors.write_npy(out).map_err(io::Error::other))?;
        }
        let mut model = Model::new(sphere.clone(), fit.clone(), kind);
        model.provenance.input = input.cloned();
        Ok(model.write_with(&self.model, replace)?)
    }
}

fn make_folder_of(file: &Path) -> Result<(), Error> {
    let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) else { return Ok(()) };
    std::fs::create_dir_all(folder)
        .map_err(|cause| Error::Surface(SurfaceError::Io { path: folder.to_owned(), action: "create", cause }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_beside_a_model_have_its_name() {
        let files = |model: &str| ModelFiles { model: model.into() };
        let usual = files("out/lh.pial.spharm.npz");
        assert_eq!(usual.name(), "lh.pial");
        assert_eq!(usual.csv(), Path::new("out/lh.pial.spharm.csv"));
        assert_eq!(usual.standard_errors(), Path::new("out/lh.pial.spharm.stderr.npy"));
        assert_eq!(usual.sphere(), Path::new("out/lh.pial.sphere.surf.gii"));
        assert_eq!(files("m.npz").sphere(), Path::new("m.sphere.surf.gii"));
    }
}
