//! The files of a fit: the model, and those beside it.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use ndarray::Array2;
use ndarray_npy::WriteNpyExt;
use spharm::io::{WriteOptions, read_mesh, write_mesh, write_new};
use spharm::parametrize::{Input, with_sphere};
use spharm::{
    Error, FileRecord, Fit, FitParams, MappedSurface, Monitor, Preparation, Sphere, SurfaceError, check_memory,
};
use spharm_model::csv::write_complex_csv;

use crate::origin::Origin;

/// Which files that exist are replaced.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Replace {
    /// The model.
    pub model: bool,
    /// The files beside it.
    pub beside: bool,
}

impl Replace {
    /// Every file.
    pub const ALL: Self = Self { model: true, beside: true };
}

/// Names of the files of one model: `NAME.spharm.npz` and those beside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelFiles {
    /// The model.
    pub model: PathBuf,
}

impl ModelFiles {
    /// Returns the name, `NAME`, for people.
    #[must_use]
    pub fn name(&self) -> String {
        self.file_name().to_string_lossy().into_owned()
    }

    /// Returns the name, `NAME`, exactly, for the names of other files.
    #[must_use]
    pub fn file_name(&self) -> OsString {
        let mut name = PathBuf::from(self.model.file_name().unwrap_or_default());
        for ending in ["npz", "spharm"] {
            if name.extension().is_some_and(|found| found == ending) {
                name = name.with_extension("");
            }
        }
        name.into_os_string()
    }

    /// The file of this ending beside the model.
    fn beside(&self, ending: &str) -> PathBuf {
        let mut name = self.file_name();
        name.push(ending);
        self.model.with_file_name(name)
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
        self.beside(".sphere.surf.gii")
    }

    /// Returns the surface around a volume's label, `NAME.surf.gii`.
    #[must_use]
    pub fn surface(&self) -> PathBuf {
        self.beside(".surf.gii")
    }

    /// Returns the surface that was cut where it had handles, `NAME.cut.surf.gii`.
    #[must_use]
    pub fn cut_surface(&self) -> PathBuf {
        self.beside(".cut.surf.gii")
    }

    /// Returns the mesh that was mended, `NAME.fixed.surf.gii`.
    #[must_use]
    pub fn fixed_surface(&self) -> PathBuf {
        self.beside(".fixed.surf.gii")
    }

    /// Returns all files that may belong to the model, itself the first.
    #[must_use]
    pub fn all(&self) -> [PathBuf; 7] {
        let model = self.model.clone();
        let [csv, errors, sphere] = [self.csv(), self.standard_errors(), self.sphere()];
        [model, csv, errors, sphere, self.surface(), self.cut_surface(), self.fixed_surface()]
    }

    /// Returns whether the sphere beside the model exists and was made of this input.
    #[must_use]
    pub fn has_sphere_of(&self, input: &FileRecord) -> bool {
        let origin = read_mesh(self.sphere()).ok().and_then(|sphere| Origin::of(&sphere.meta));
        origin.is_some_and(|origin| origin.is_of(input))
    }

    /// Maps a surface to a sphere of its own, which is written beside the model, as is the surface of a label, or one
    /// that was mended, or cut where it had handles. With `reuse` a mesh keeps the sphere that is there if that was
    /// made of the same file with the same settings. One of another file is only replaced with [`Replace::ALL`]. The
    /// memory of the fit is checked first. `record` says what `input` was read from.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`], [`Error::Parametrize`], and [`Error::Surface`] for files that can't be written.
    pub fn map(
        &self,
        input: &Input,
        record: &FileRecord,
        params: &FitParams,
        reuse: bool,
        replace: Replace,
        monitor: &dyn Monitor,
    ) -> Result<Mapped, Error> {
        let path = self.sphere();
        let origin = Origin::new(record, &params.map(), input.handles().is_some());
        let named = |mut surface: MappedSurface| {
            surface.parametrized.sphere.path = Some(path.clone());
            surface
        };
        // The sphere of a label may be of voxels of another size.
        if let Some(mesh) = input.mesh().filter(|_| reuse && record.label.is_none()) {
            let left_over = || {
                let sphere =
                    read_mesh(&path).ok().filter(|sphere| Origin::of(&sphere.meta).as_ref() == Some(&origin))?;
                with_sphere(mesh, &sphere).ok()
            };
            if let Some(found) = left_over() {
                check_memory(mesh, params)?;
                let surface = named(MappedSurface::of(input, found, params));
                return Ok(Mapped { surface, written: Vec::new() });
            }
        }
        let mut surface = MappedSurface::new(input, params, monitor)?;
        origin.write_to(&mut surface.parametrized.map.sphere.meta);
        make_folder_of(&path)?;
        // Mapping takes a while, in which another process may have written its sphere.
        let overwrite = replace == Replace::ALL || (replace.beside && self.has_sphere_of(record));
        let options = WriteOptions { overwrite, double: true };
        let changed = match input {
            Input::Label(_) => Some(self.surface()),
            Input::Cut(..) => Some(self.cut_surface()),
            Input::Fixed(..) => Some(self.fixed_surface()),
            Input::Mesh(_) => None,
        };
        // A label's surface with its handles is in no other file.
        let whole = input.cut().and(input.label()).map(|label| label.quads.triangles(|_| false));
        let mut mapped = Mapped { surface: named(surface), written: Vec::new() };
        // The surface last: where it is, the sphere says what they were made of.
        let map = &mapped.surface.parametrized.map;
        let whole = whole.iter().map(|whole| (self.surface(), whole));
        let changed = changed.map(|path| (path, &map.surface));
        for (path, mesh) in std::iter::once((path, &map.sphere)).chain(whole).chain(changed) {
            if let Err(error) = write_mesh(&path, mesh, &options) {
                mapped.remove();
                return Err(error.into());
            }
            mapped.written.push(path);
        }
        Ok(mapped)
    }

    /// Writes a fit's model, its standard errors if it has them, and with `csv` its complex coefficients; makes the
    /// folder. The model is written last, so that where it is, the others are.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] for files that exist, unless they are replaced, or can't be written.
    pub fn write(
        &self,
        sphere: &Sphere,
        fit: &Fit,
        made_of: &MadeOf<'_>,
        csv: bool,
        replace: Replace,
    ) -> Result<(), Error> {
        make_folder_of(&self.model)?;
        // What is beside a model that another process has written meanwhile belongs to that one.
        if !replace.model && self.model.exists() {
            return Err(SurfaceError::OutputExists { path: self.model.clone() }.into());
        }
        if csv {
            write_new(self.csv(), replace.beside, |out| write_complex_csv(&fit.coefficients, out))?;
        }
        if let Some(errors) = &fit.standard_errors {
            self.write_standard_errors(errors, replace.beside)?;
        }
        let mut model = fit.clone().into_model(sphere.clone());
        let provenance = &mut model.provenance;
        provenance.id = made_of.id.map(str::to_owned);
        provenance.input = made_of.input.cloned();
        provenance.region = made_of.region.cloned();
        let Preparation { voxel_size, fix, cut_handles } = made_of.preparation;
        (provenance.voxel_size, provenance.fix, provenance.cut_handles) = (voxel_size, fix, cut_handles);
        if let Some(surface) = made_of.surface {
            surface.record(provenance);
        }
        Ok(model.write_with(&self.model, replace.model)?)
    }

    /// Writes standard errors, (K, c), beside the model.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] for a file that exists, unless it is replaced, or can't be written.
    pub fn write_standard_errors(&self, errors: &Array2<f64>, replace: bool) -> Result<(), Error> {
        Ok(write_new(self.standard_errors(), replace, |out| errors.write_npy(out).map_err(io::Error::other))?)
    }
}

/// What a model was made of, for it to record.
#[derive(Debug, Clone, Copy, Default)]
pub struct MadeOf<'a> {
    /// What the surface is called, where it is from a table.
    pub id: Option<&'a str>,
    /// The surface's file.
    pub input: Option<&'a FileRecord>,
    /// The file of the vertices whose values were read, where the others were continued from its edge.
    pub region: Option<&'a FileRecord>,
    /// What was to be done to the surface before the fit.
    pub preparation: Preparation,
    /// The surface as it was mapped, if it came without a sphere.
    pub surface: Option<&'a MappedSurface>,
}

/// A surface mapped to a sphere of its own, and the files that were written of it.
#[derive(Debug, Clone)]
pub struct Mapped {
    /// The map.
    pub surface: MappedSurface,
    /// The files that were written: the sphere, and the surface where it isn't the input's; none where a sphere was
    /// there.
    pub written: Vec<PathBuf>,
}

impl Mapped {
    /// Removes the files that were written. Without their model they would stand in the way of the next attempt.
    pub fn remove(&self) {
        for path in &self.written {
            // A file that can't be removed stays: whatever failed before is the error to report.
            let _ = std::fs::remove_file(path);
        }
    }
}

pub(crate) fn make_folder_of(file: &Path) -> Result<(), Error> {
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
