//! Names, writes and removes the files of a fit: the model and the files beside it.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use ndarray::Array2;
use ndarray_npy::WriteNpyExt;
use serde::Serializer;
use spharm::io::{WriteOptions, read_mesh, write_mesh, write_new};
use spharm::parametrize::volume::{AxisOrder, VoxelValues};
use spharm::parametrize::{Input, with_sphere};
use spharm::{
    Error, FileRecord, Fit, FitParams, MappedSurface, Monitor, Preparation, Sphere, SurfaceError, check_memory,
};
use spharm_model::csv::write_complex_csv;

use crate::origin::Origin;

/// The existing files that a fit may replace.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Replace {
    /// Whether an existing model may be replaced.
    pub model: bool,
    /// Whether existing files beside the model may be replaced.
    pub beside: bool,
}

impl Replace {
    /// Allows every existing file to be replaced.
    pub const ALL: Self = Self { model: true, beside: true };
}

/// Paths of the files of one model: `NAME.spharm.npz` and the files beside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelFiles {
    /// Path of the model, `NAME.spharm.npz`.
    pub model: PathBuf,
}

impl ModelFiles {
    /// Returns `NAME`, the common beginning of the file names, as text for display.
    #[must_use]
    pub fn name(&self) -> String {
        self.file_name().to_string_lossy().into_owned()
    }

    /// Returns `NAME`, the common beginning of the file names, exactly as stored, even if it isn't valid UTF-8.
    #[must_use]
    pub fn file_name(&self) -> OsString {
        let mut name = PathBuf::from(self.model.file_name().unwrap_or_default());
        for ending in ["npz", "spharm"] {
            if name.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending)) {
                name = name.with_extension("");
            }
        }
        name.into_os_string()
    }

    /// Returns the path of the file in the model's folder whose name is `NAME` followed by `ending`.
    fn beside(&self, ending: &str) -> PathBuf {
        let mut name = self.file_name();
        name.push(ending);
        self.model.with_file_name(name)
    }

    /// Returns the path of the table of complex coefficients, `NAME.spharm.csv`.
    #[must_use]
    pub fn csv(&self) -> PathBuf {
        self.model.with_extension("csv")
    }

    /// Returns the path of the standard errors, `NAME.spharm.stderr.npy`.
    #[must_use]
    pub fn standard_errors(&self) -> PathBuf {
        self.model.with_extension("stderr.npy")
    }

    /// Returns the path of the sphere to which the surface was mapped, `NAME.sphere.surf.gii`.
    #[must_use]
    pub fn sphere(&self) -> PathBuf {
        self.beside(".sphere.surf.gii")
    }

    /// Returns the path of the surface around a volume's label, `NAME.surf.gii`.
    #[must_use]
    pub fn surface(&self) -> PathBuf {
        self.beside(".surf.gii")
    }

    /// Returns the path of the surface with its handles cut, `NAME.cut.surf.gii`.
    #[must_use]
    pub fn cut_surface(&self) -> PathBuf {
        self.beside(".cut.surf.gii")
    }

    /// Returns the path of the repaired mesh, `NAME.fixed.surf.gii`.
    #[must_use]
    pub fn fixed_surface(&self) -> PathBuf {
        self.beside(".fixed.surf.gii")
    }

    /// Returns the paths of all files that may belong to the model, the model first.
    #[must_use]
    pub fn all(&self) -> [PathBuf; 7] {
        let model = self.model.clone();
        let [csv, errors, sphere] = [self.csv(), self.standard_errors(), self.sphere()];
        [model, csv, errors, sphere, self.surface(), self.cut_surface(), self.fixed_surface()]
    }

    /// Returns whether a sphere exists beside the model and was made from the given input, with any settings.
    #[must_use]
    pub fn has_sphere_of(&self, input: &FileRecord) -> bool {
        Origin::of_file(&self.sphere()).is_some_and(|origin| origin.is_of(input))
    }

    /// Maps a surface to a sphere, and writes the sphere beside the model. The surface is also written if it was
    /// extracted from a label, repaired, or cut at its handles.
    ///
    /// If `reuse` is set, the existing sphere of a mesh is reused if it was made from the same file with the same
    /// settings. A sphere made from another file is replaced only with [`Replace::ALL`]. Before mapping, the memory
    /// needed for mapping and fitting is checked. `record` is the record of the file from which `input` was read.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] if the memory doesn't suffice, [`Error::Parametrize`] if the surface can't be mapped, and
    /// [`Error::Surface`] if a file can't be written.
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
        // Spheres for labels aren't reused, because the origin recorded in them doesn't include the voxel size.
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
        // Another process may have written its sphere while this process mapped the surface, so check the sphere's
        // origin only now.
        let overwrite = replace == Replace::ALL || (replace.beside && self.has_sphere_of(record));
        let options = WriteOptions { overwrite, double: true };
        let changed = match input {
            Input::Label(_) => Some(self.surface()),
            Input::Cut(..) => Some(self.cut_surface()),
            Input::Fixed(..) => Some(self.fixed_surface()),
            Input::Mesh(_) => None,
        };
        // For a label, the surface before its handles were cut isn't in any other file, so it is written too.
        let whole = input.cut().and(input.label()).map(|label| label.quads.triangles(|_| false));
        let mut mapped = Mapped { surface: named(surface), written: Vec::new() };
        // Write the surface last: if it exists, the sphere, which records the origin of both files, exists too.
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

    /// Writes the model of a fit, the standard errors if the fit has them, and, if `csv` is set, the complex
    /// coefficients. Creates the folder if necessary. The model is written last: if it exists, the other files exist
    /// too.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if a file exists and `replace` doesn't allow it to be replaced, or if a file can't be
    /// written; [`Error::Model`] if the model can't be written.
    pub fn write(
        &self,
        sphere: &Sphere,
        fit: &Fit,
        made_of: &MadeOf<'_>,
        csv: bool,
        replace: Replace,
    ) -> Result<(), Error> {
        make_folder_of(&self.model)?;
        // If another process has written the model since the decision to fit, the files beside the model also belong to
        // that process, so nothing is written.
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
        let Preparation { reading, fix, wrap, cut_handles, .. } = made_of.preparation;
        (provenance.voxel_size, provenance.fix, provenance.cut_handles) = (reading.voxel_size, fix, cut_handles);
        provenance.axes = (reading.axes != AxisOrder::default()).then(|| reading.axes.name().to_owned());
        provenance.wrap = wrap;
        match reading.values {
            VoxelValues::Labels => {}
            VoxelValues::Level(level) => provenance.threshold = Some(level),
            VoxelValues::Probability => provenance.probability = true,
        }
        if let Some(surface) = made_of.surface {
            surface.record(provenance);
        }
        Ok(model.write_with(&self.model, replace.model)?)
    }

    /// Writes the standard errors of the coefficients, one row per coefficient and one column per channel, to a file
    /// beside the model.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if the file exists and `replace` is false, or if it can't be written.
    pub fn write_standard_errors(&self, errors: &Array2<f64>, replace: bool) -> Result<(), Error> {
        Ok(write_new(self.standard_errors(), replace, |out| errors.write_npy(out).map_err(io::Error::other))?)
    }
}

/// The origin of a model, to be recorded in its provenance.
#[derive(Debug, Clone, Copy, Default)]
pub struct MadeOf<'a> {
    /// Id of the surface, if it is from a table.
    pub id: Option<&'a str>,
    /// Record of the surface's file.
    pub input: Option<&'a FileRecord>,
    /// Record of the region's file, if a signal was read only within a region. Values outside the region were
    /// extrapolated from its edge.
    pub region: Option<&'a FileRecord>,
    /// Changes that were requested to be made to the surface before the fit.
    pub preparation: Preparation,
    /// The mapped surface; `None` if the surface was fitted over a given sphere.
    pub surface: Option<&'a MappedSurface>,
}

/// A surface mapped to a sphere, and the files written for it.
#[derive(Debug, Clone)]
pub struct Mapped {
    /// The surface with its sphere and the report on the mapping.
    pub surface: MappedSurface,
    /// Paths of the files that were written: the sphere, and the surface if it differs from the surface in the input's
    /// file. Empty if an existing sphere was reused.
    pub written: Vec<PathBuf>,
}

impl Mapped {
    /// Removes the files that were written. If they remained without a model, the next run would be refused because of
    /// them.
    pub fn remove(&self) {
        for path in &self.written {
            // If a file can't be removed, the error is ignored, because the caller reports the error that caused the
            // removal.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Serialises a path as text, for `#[serde(serialize_with)]`. Bytes that aren't UTF-8 are replaced.
///
/// # Errors
///
/// The errors of `serializer`.
pub fn serialize_shown<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
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
        assert_eq!(files("out/LH.SPHARM.NPZ").sphere(), Path::new("out/LH.sphere.surf.gii"));
    }
}
