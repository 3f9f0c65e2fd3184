//! Reads a group's folder.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_model::arrays::Arrays;

use super::{
    GroupFiles, Member, MemberOrigin, Shared, VERSION, check_names, io, member_path, model_path, places_path, refused,
};
use crate::Error;
use crate::correspond::{CorrespondReport, Group, GroupTemplate, MemberReport};

/// Maximum size of a group's JSON file in bytes.
const MOST: u64 = 256 << 20;
/// Names that reports use for the steps of a correspondence.
const STEPS: [&str; 5] = ["poses", "template", "registration", "fits", "refinement"];

impl GroupFiles {
    /// Opens a group's folder.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if `group.json` can't be read; [`Error::GroupFile`] if it isn't a group's record, or its
    /// format version isn't supported.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self, Error> {
        let folder = folder.as_ref().to_owned();
        let path = folder.join("group.json");
        let shared: Shared = read_json(&path)?;
        if shared.version != VERSION {
            return Err(refused(&path, format!("format version {VERSION}"), shared.version));
        }
        if let Some(index) = shared.masked.iter().find(|index| **index >= shared.directions) {
            return Err(refused(&path, format!("indices of masked directions below {}", shared.directions), index));
        }
        let names = match &shared.members {
            Some(names) => names.clone(),
            None => names_in(&folder.join("members"))?,
        };
        check_names(&names.iter().map(String::as_str).collect::<Vec<_>>(), names.len())
            .map_err(|error| refused(&path, "unique names that are valid file names".to_owned(), error))?;
        Ok(Self { folder, shared, names })
    }

    /// Returns the paths of a member's files: its model, its corresponding points and its record. The record is
    /// written last.
    #[must_use]
    pub fn of_member(folder: &Path, name: &str) -> [PathBuf; 3] {
        [model_path(folder, name), places_path(folder, name), member_path(folder, name)]
    }

    /// Returns the paths of a group's files: its mean and its record. The record is written last.
    #[must_use]
    pub fn of_group(folder: &Path) -> [PathBuf; 2] {
        [model_path(folder, "mean"), folder.join("group.json")]
    }

    /// Returns the names of the members, in order.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns the origin of a member, or `None` if one of the member's files is missing.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if the record can't be read; [`Error::GroupFile`] if it is invalid.
    pub fn origin(folder: &Path, name: &str) -> Result<Option<MemberOrigin>, Error> {
        if Self::of_member(folder, name).iter().any(|path| !path.exists()) {
            return Ok(None);
        }
        let Member { name, input, mirrored, mirrored_first, axes, warnings, .. } =
            read_json(&member_path(folder, name))?;
        let mirrored = mirrored_first.unwrap_or(mirrored);
        Ok(Some(MemberOrigin { name, input, mirrored, axes, warnings }))
    }

    /// Reads the report on the registration of a member.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if the member's record can't be read; [`Error::GroupFile`] if it is invalid.
    pub fn registration(&self, name: &str) -> Result<MemberReport, Error> {
        let Member { registration, .. } = read_json(&member_path(&self.folder, name))?;
        Ok(registration)
    }

    /// Reads the data needed to add new members to the group.
    ///
    /// # Errors
    ///
    /// [`Error::GroupFile`] if the mean doesn't match the group; [`Error::Model`] if it can't be read.
    pub fn template(&self) -> Result<GroupTemplate, Error> {
        let path = model_path(&self.folder, "mean");
        let mean = Model::read(&path)?;
        self.check_model(&path, &mean)?;
        let sphere = mean.sphere.filter(|sphere| !sphere.faces.is_empty());
        let sphere = sphere.ok_or_else(|| refused(&path, "a sphere with triangles".to_owned(), "none"))?;
        if sphere.directions.len() != self.shared.directions {
            let expected = format!("{} directions", self.shared.directions);
            return Err(refused(&path, expected, sphere.directions.len()));
        }
        let mut masked = vec![false; self.shared.directions];
        self.shared.masked.iter().for_each(|index| masked[*index] = true);
        let (spread, refined) = (self.shared.spread, !self.shared.refinement.is_empty());
        Ok(GroupTemplate { sphere, mean: mean.coefficients, masked, spread, refined })
    }

    /// Reads the coefficients of all members. If there are more than `most` members, reads only `most` of them, evenly
    /// spaced in the list.
    ///
    /// # Errors
    ///
    /// [`Error::Model`] if a member's model can't be read; [`Error::GroupFile`] if it doesn't match the group.
    pub fn coefficients(&self, most: usize) -> Result<Vec<Coefficients>, Error> {
        let (count, taken) = (self.names.len(), self.names.len().min(most));
        let of = |k: usize| {
            let path = model_path(&self.folder, &self.names[k * count / taken.max(1)]);
            let model = Model::read(&path)?;
            self.check_model(&path, &model)?;
            Ok(model.coefficients)
        };
        (0..taken).map(of).collect()
    }

    /// Reads a part of the group as a separate group: the members with the given indices in [`names`](Self::names). Its
    /// report contains the members' figures but no warnings, since the files contain warnings only as text.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] if a member doesn't exist; [`Error::GroupFile`] if a file doesn't match the group;
    /// [`Error::Model`] if a model or corresponding points can't be read.
    pub fn members(&self, indices: &[usize]) -> Result<Group, Error> {
        let template = self.template()?;
        let first = self.shared.template.as_ref();
        let at = |index: &usize| first.is_some_and(|first| self.names.get(*index) == Some(first));
        let step = |(name, seconds): &(String, f64)| Some((*STEPS.iter().find(|step| *step == name)?, *seconds));
        let report = CorrespondReport {
            template: indices.iter().position(at),
            changes: self.shared.changes.clone(),
            members: Vec::new(),
            warnings: Vec::new(),
            axes: None,
            guide: None,
            refinement: None,
            seconds: self.shared.seconds.iter().filter_map(step).collect(),
        };
        let (models, similarities) = (Vec::new(), Vec::new());
        let mut group = Group { models, similarities, places: Vec::new(), reached: Vec::new(), template, report };
        for index in indices {
            let name = self.names.get(*index).ok_or_else(|| Error::Setting {
                what: "reading a group",
                expected: "the index of a member of the group, counted from 0",
                found: index.to_string(),
            })?;
            self.add(name, &mut group)?;
        }
        Ok(group)
    }

    /// Reads the whole group; see [`members`](Self::members).
    ///
    /// # Errors
    ///
    /// The errors of [`members`](Self::members).
    pub fn group(&self) -> Result<Group, Error> {
        self.members(&(0..self.names.len()).collect::<Vec<_>>())
    }

    /// Returns whether the members were scaled to one size.
    ///
    /// # Errors
    ///
    /// [`Error::GroupFile`] if a member's record can't be read.
    pub fn is_scaled(&self) -> Result<bool, Error> {
        for name in &self.names {
            if read_json::<Member>(&member_path(&self.folder, name))?.to_group.scale != 1.0 {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn add(&self, name: &str, group: &mut Group) -> Result<(), Error> {
        let path = member_path(&self.folder, name);
        let record: Member = read_json(&path)?;
        if record.version != VERSION || record.name != name {
            let found = format!("member {} in format version {}", record.name, record.version);
            return Err(refused(&path, format!("member {name} in format version {VERSION}"), found));
        }
        let scale = record.to_group.scale;
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(refused(&path, "a scale above 0".to_owned(), scale));
        }
        let path = model_path(&self.folder, name);
        let model = Model::read(&path)?;
        self.check_model(&path, &model)?;
        let path = places_path(&self.folder, name);
        let mut arrays = Arrays::open(&path)?;
        let (places, reached) = (arrays.matrix("places")?, arrays.matrix("reached")?);
        let n = self.shared.directions;
        for (what, found, expected) in [("places", places.dim(), (n, 3)), ("reached", reached.dim(), (n, 1))] {
            if found != expected {
                return Err(refused(&path, format!("`{what}` of shape {expected:?}"), format!("{found:?}")));
            }
        }
        if let Some(value) = places.iter().find(|value| !value.is_finite()) {
            return Err(refused(&path, "finite coordinates in `places`".to_owned(), value));
        }
        if let Some(value) = reached.iter().find(|value| **value != 0.0 && **value != 1.0) {
            return Err(refused(&path, "only 0 and 1 in `reached`".to_owned(), value));
        }
        group.models.push(model);
        group.similarities.push(record.to_group);
        group.places.push(places.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect());
        group.reached.push(reached.iter().map(|value| *value == 1.0).collect());
        group.report.members.push(record.registration);
        Ok(())
    }

    fn check_model(&self, path: &Path, model: &Model) -> Result<(), Error> {
        let (degree, channels) = (model.coefficients.max_degree(), model.coefficients.channels());
        if (degree, channels) != (self.shared.max_degree, 3) {
            let expected = format!("a surface (3 channels) of degree {}", self.shared.max_degree);
            return Err(refused(path, expected, format!("{channels} channels of degree {degree}")));
        }
        Ok(())
    }
}

/// Returns the names of the members whose records are in a folder, sorted.
fn names_in(folder: &Path) -> Result<Vec<String>, Error> {
    let entries = std::fs::read_dir(folder).map_err(|cause| io(folder, "read", cause))?;
    let mut names = Vec::new();
    for entry in entries {
        let name = entry.map_err(|cause| io(folder, "read", cause))?.file_name();
        names.extend(name.to_str().and_then(|name| name.strip_suffix(".json")).map(str::to_owned));
    }
    // The name of a file starts with a dot until the file is complete.
    names.retain(|name| !name.starts_with('.'));
    names.sort_unstable();
    Ok(names)
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let bytes = spharm_files::read(path, MOST).map_err(|cause| io(path, "read", cause))?;
    serde_json::from_slice(&bytes).map_err(|error| refused(path, "the JSON record of a group".to_owned(), error))
}
