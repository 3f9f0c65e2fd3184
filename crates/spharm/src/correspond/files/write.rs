//! Writes a group's folder.

use std::path::{Path, PathBuf};

use ndarray::ArrayView2;
use serde::Serialize;
use spharm_model::arrays::{Entry, write_arrays};
use spharm_model::{Model, ModelError};
use spharm_surface::geometry::Vec3;
use spharm_surface::io::write_new;
use spharm_surface::{Kind, Similarity, SurfaceError};

use super::{GroupFiles, Member, MemberOrigin, Shared, VERSION, check_names, io, member_path, model_path, places_path};
use crate::Error;
use crate::correspond::{Group, GroupTemplate, MemberReport, NewMember};
use crate::model::{signed, versions};

impl Group {
    /// Writes the group into a folder, which is created if necessary. `origins` has one entry per member, in order. If
    /// writing fails, the files written so far are removed.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] if a name isn't valid as a file name or isn't unique; [`Error::Model`] or [`Error::Surface`]
    /// if a file can't be written, or exists and `overwrite` isn't set.
    pub fn write(&self, folder: &Path, origins: &[MemberOrigin], overwrite: bool) -> Result<(), Error> {
        let names: Vec<&str> = origins.iter().map(|origin| origin.name.as_str()).collect();
        check_names(&names, self.models.len())?;
        let report = &self.report;
        let stage = |stage: &spharm_shape::groupwise::StageReport| {
            serde_json::json!({
                "max_degree": stage.stage.max_degree,
                "field_degree": stage.stage.field_degree,
                "steps": stage.steps,
                "variance": stage.variance,
                "distortion": stage.distortion.rms,
                "converged": stage.converged,
            })
        };
        let shared = Shared {
            members: Some(names.iter().map(|name| (*name).to_owned()).collect()),
            template: report.template.map(|index| names[index].to_owned()),
            changes: report.changes.clone(),
            refinement: report.refinement.iter().flat_map(|found| found.stages.iter().map(stage)).collect(),
            seconds: report.seconds.iter().map(|(name, seconds)| ((*name).to_owned(), *seconds)).collect(),
            ..self.template.shared()
        };
        let mut writer = Writer { folder, overwrite, written: Vec::new() };
        writer.check(&names)?;
        let result = self.write_all(&mut writer, &shared, origins);
        writer.end(result)
    }

    fn write_all(&self, writer: &mut Writer<'_>, shared: &Shared, origins: &[MemberOrigin]) -> Result<(), Error> {
        // Remove `group.json`. Until it is written again, as the last file, the folder isn't a valid group.
        writer.begin()?;
        for (index, origin) in origins.iter().enumerate() {
            writer.member(
                origin,
                &self.models[index],
                (&self.places[index], &self.reached[index]),
                (&self.similarities[index], &self.report.members[index]),
            )?;
        }
        writer.mean(&self.template)?;
        writer.json(&writer.folder.join("group.json"), shared)
    }
}

impl GroupTemplate {
    fn shared(&self) -> Shared {
        let masked = self.masked.iter().enumerate().filter(|(_, masked)| **masked).map(|(index, _)| index);
        Shared {
            version: VERSION,
            tool: "shape correspond".to_owned(),
            versions: serde_json::to_value(versions()).unwrap_or_default(),
            members: None,
            max_degree: self.mean.max_degree(),
            directions: self.sphere.directions.len(),
            masked: masked.collect(),
            spread: self.spread,
            template: None,
            changes: Vec::new(),
            refinement: Vec::new(),
            seconds: Vec::new(),
        }
    }

    /// Creates a folder for members that are added to this finished group. If the folder exists and belongs to this
    /// group, it is left unchanged.
    ///
    /// # Errors
    ///
    /// [`Error::GroupFile`] if the folder belongs to another group; the errors of [`Group::write`].
    pub fn begin_folder(&self, folder: &Path) -> Result<(), Error> {
        let mut writer = Writer { folder, overwrite: false, written: Vec::new() };
        let same = |files: GroupFiles| -> Result<(), Error> {
            let there = files.template()?;
            if files.shared.members.is_some() || there.mean != self.mean || there.masked != self.masked {
                let expected = "the group to which the members are added";
                let found = "another group".to_owned();
                return Err(Error::GroupFile { path: folder.join("group.json"), expected: expected.to_owned(), found });
            }
            Ok(())
        };
        if folder.join("group.json").exists() {
            return same(GroupFiles::open(folder)?);
        }
        make_folders(folder)?;
        // A run that was interrupted before it wrote `group.json` may have left the mean's file.
        let is_there = Model::read(model_path(folder, "mean")).is_ok_and(|mean| mean.coefficients == self.mean);
        let mean = if is_there { Ok(()) } else { writer.mean(self) };
        let begun = mean.and_then(|()| writer.json(&folder.join("group.json"), &self.shared()));
        match begun {
            // Another process may have created the same folder in the meantime.
            Err(_) if folder.join("group.json").exists() => same(GroupFiles::open(folder)?),
            begun => writer.end(begun),
        }
    }
}

impl NewMember {
    /// Writes the member's files into a folder made by [`GroupTemplate::begin_folder`].
    ///
    /// # Errors
    ///
    /// The errors of [`Group::write`].
    pub fn write(&self, folder: &Path, origin: &MemberOrigin, overwrite: bool) -> Result<(), Error> {
        check_names(&[&origin.name], 1)?;
        let mut writer = Writer { folder, overwrite, written: Vec::new() };
        let found = (&self.similarity, &self.report);
        let written = writer.member(origin, &self.model, (&self.places, &self.reached), found);
        writer.end(written)
    }
}

/// Writes files and records their paths. If a file can't be written, all files written before it are removed.
struct Writer<'a> {
    folder: &'a Path,
    overwrite: bool,
    written: Vec<PathBuf>,
}

impl Writer<'_> {
    /// Returns an error if one of the files exists and `overwrite` isn't set. Called before any file is written.
    fn check(&self, names: &[&str]) -> Result<(), Error> {
        let of = |name: &&str| GroupFiles::of_member(self.folder, name);
        match GroupFiles::of_group(self.folder).into_iter().chain(names.iter().flat_map(of)).find(|path| path.exists())
        {
            Some(path) if !self.overwrite => Err(SurfaceError::OutputExists { path }.into()),
            _ => Ok(()),
        }
    }

    fn begin(&self) -> Result<(), Error> {
        make_folders(self.folder)?;
        let path = self.folder.join("group.json");
        match std::fs::remove_file(&path) {
            Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(io(&path, "replace", cause)),
            _ => Ok(()),
        }
    }

    fn member(
        &mut self,
        origin: &MemberOrigin,
        model: &Model,
        (places, reached): (&[Vec3], &[bool]),
        (similarity, report): (&Similarity, &MemberReport),
    ) -> Result<(), Error> {
        let name = &origin.name;
        let path = model_path(self.folder, name);
        model.write_with(&path, self.overwrite)?;
        self.written.push(path);
        let path = places_path(self.folder, name);
        let reached: Vec<f64> = reached.iter().map(|reached| f64::from(u8::from(*reached))).collect();
        let view = |values, columns| ArrayView2::from_shape((places.len(), columns), values);
        let shape =
            |error: ndarray::ShapeError| invalid(&path, format!("expected one value per corresponding point: {error}"));
        let entries = [
            ("places", Entry::Matrix(view(places.as_flattened(), 3).map_err(shape)?)),
            ("reached", Entry::Matrix(view(&reached, 1).map_err(shape)?)),
        ];
        write_arrays(&path, self.overwrite, &entries)?;
        self.written.push(path);
        let record = Member {
            version: VERSION,
            name: name.clone(),
            input: origin.input.clone(),
            mirrored: similarity.mirrors(),
            mirrored_first: Some(origin.mirrored),
            axes: origin.axes.clone(),
            to_group: *similarity,
            registration: *report,
            warnings: origin.warnings.clone(),
        };
        self.json(&member_path(self.folder, name), &record)
    }

    fn mean(&mut self, template: &GroupTemplate) -> Result<(), Error> {
        let path = model_path(self.folder, "mean");
        let mean = Model::new(template.sphere.clone(), template.mean.clone(), Kind::Surface);
        signed(mean, "shape correspond").write_with(&path, self.overwrite)?;
        self.written.push(path);
        Ok(())
    }

    fn json(&mut self, path: &Path, value: &impl Serialize) -> Result<(), Error> {
        write_new(path, self.overwrite, |out| {
            serde_json::to_writer_pretty(&mut *out, value)?;
            out.write_all(b"\n")
        })?;
        self.written.push(path.to_owned());
        Ok(())
    }

    fn end(self, result: Result<(), Error>) -> Result<(), Error> {
        if result.is_err() {
            // A failure to remove a file is ignored, since the error of writing is returned.
            self.written.iter().for_each(|path| drop(std::fs::remove_file(path)));
        }
        result
    }
}

fn make_folders(folder: &Path) -> Result<(), Error> {
    ["places", "members"].iter().try_for_each(|name| {
        let path = folder.join(name);
        std::fs::create_dir_all(&path).map_err(|cause| io(&path, "create", cause))
    })
}

fn invalid(path: &Path, problem: String) -> Error {
    ModelError::Invalid { path: path.to_owned(), problem }.into()
}
