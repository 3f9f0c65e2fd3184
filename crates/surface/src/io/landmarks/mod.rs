//! Reads and writes landmarks: named points placed by a person.
//!
//! | format | names | frame |
//! |---|---|---|
//! | 3D Slicer's markups | `.mrk.json` | `coordinateSystem` of each list, LPS or RAS |
//! | 3D Slicer's former fiducials | `.fcsv` | `# CoordinateSystem = `, LPS, RAS, 0 (RAS) or 1 (LPS) |
//! | a list of `{"id": "A", "coordinates": [x, y, z]}` | `.json` | not specified |
//! | table | `.csv`, `.tsv` of `name,x,y,z`, with or without a heading line; `.csv` also with `;` | not specified |
//!
//! Positions of landmarks are read as stored, in the file's unit, like positions of surfaces. The frame is read if the
//! file specifies it. Slicer writes both landmarks and meshes in LPS, so their frames agree. Surfaces from other
//! programs may be in RAS, for example GIfTI and FreeSurfer surfaces. [`Landmarks::in_frame`] converts landmarks to a
//! given frame; [`Landmarks::laid_on`] converts landmarks only if the conversion brings them much nearer to a surface.
//! Landmarks without a position are left out: undefined points of Slicer, and rows of a table whose coordinates are all
//! empty, `NA` or `NaN`.

mod json;
mod placed;
mod table;

use std::collections::{HashMap, HashSet};
use std::io::Write;
use std::path::Path;

pub use placed::{FarGuide, Placed, unit_factor, unit_hint};

use super::atomic::write_new;
use super::flaw::{Flaw, shown};
use crate::error::SurfaceError;
use crate::geometry::Vec3;

/// Largest number of bytes of a landmark file. Slicer needs about 600 bytes per landmark.
const MOST_BYTES: u64 = 16 << 20;

/// The anatomical axes of positions. LPS and RAS differ by half a turn about the third axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// Left, posterior, superior: used by DICOM and ITK, and in the files that Slicer writes.
    Lps,
    /// Right, anterior, superior: used by NIfTI, GIfTI and FreeSurfer.
    Ras,
}

impl Frame {
    /// Returns `LPS` or `RAS`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Lps => "LPS",
            Self::Ras => "RAS",
        }
    }

    /// Returns RAS for LPS, and LPS for RAS.
    fn other(self) -> Self {
        match self {
            Self::Lps => Self::Ras,
            Self::Ras => Self::Lps,
        }
    }

    /// Parses a frame's name, or the number written by earlier versions of Slicer: 0 for RAS, 1 for LPS.
    #[must_use]
    pub fn named(text: &str) -> Option<Self> {
        match text.trim() {
            "LPS" | "1" => Some(Self::Lps),
            "RAS" | "0" => Some(Self::Ras),
            _ => None,
        }
    }
}

/// The named points of a subject. Names are unique and positions finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks {
    /// Names of the n points.
    pub names: Vec<String>,
    /// Positions of the n points, in the file's unit.
    pub points: Vec<Vec3>,
    /// The frame of the positions, if the file specifies it.
    pub frame: Option<Frame>,
}

/// The landmarks common to several subjects.
#[derive(Debug, Clone, PartialEq)]
pub struct Matched {
    /// Names of the n common landmarks, in the order of the first subject.
    pub names: Vec<String>,
    /// Positions of the n common landmarks, for each subject.
    pub points: Vec<Vec<Vec3>>,
    /// For each subject, the names of its landmarks that at least one other subject lacks.
    pub alone: Vec<Vec<String>>,
}

impl Landmarks {
    /// Returns landmarks after checking that names are unique and not empty, and positions finite.
    ///
    /// # Errors
    ///
    /// [`LengthMismatch`](SurfaceError::LengthMismatch) if the numbers of names and points differ;
    /// [`Malformed`](SurfaceError::Malformed), with the number of the landmark, if a name is empty or repeated or a
    /// position isn't finite.
    pub fn new(names: Vec<String>, points: Vec<Vec3>, frame: Option<Frame>) -> Result<Self, SurfaceError> {
        if names.len() != points.len() {
            let (expected, found) = (names.len(), points.len());
            return Err(SurfaceError::LengthMismatch { what: "landmark positions", expected, found });
        }
        let mut gathered = Gathered::default();
        for (index, (name, point)) in names.iter().zip(points).enumerate() {
            let added = gathered.add(&format!("landmark {index} (counted from 0)"), name, point);
            added.map_err(|flaw| flaw.at(Path::new("landmarks"), "a list of landmarks"))?;
        }
        Ok(gathered.landmarks(frame))
    }

    /// Reads a file in the format implied by its name.
    ///
    /// # Errors
    ///
    /// [`UnknownFormat`](SurfaceError::UnknownFormat) for a name that implies no format; [`Io`](SurfaceError::Io) if
    /// the file can't be read or is larger than 16 MiB; [`Empty`](SurfaceError::Empty) if it has no landmarks;
    /// [`Malformed`](SurfaceError::Malformed), with the line or entry, for contents in another format, a repeated or
    /// empty name, or coordinates that are missing or not finite; [`Unsupported`](SurfaceError::Unsupported) for
    /// markups in a unit other than mm.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, SurfaceError> {
        let path = path.as_ref();
        let format = Format::of(path)?;
        let text = spharm_files::read_text(path, MOST_BYTES).map_err(|cause| SurfaceError::Io {
            path: path.to_owned(),
            action: "read",
            cause,
        })?;
        let found = match format {
            Format::Markups | Format::List => json::read(&text),
            Format::Fiducials => table::read_fiducials(&text),
            Format::Csv => table::read(&text, table::separator(&text)),
            Format::Tsv => table::read(&text, b'\t'),
        };
        let found = found.map_err(|flaw| flaw.at(path, format.title()))?;
        if found.names.is_empty() {
            return Err(SurfaceError::Empty { path: path.to_owned(), what: "landmark" });
        }
        Ok(found)
    }

    /// Writes a file in the format implied by its name, completely or not at all. Slicer's formats require a frame.
    /// Landmarks without a frame are written as LPS. Slicer also assumes LPS for meshes without a frame, so landmarks
    /// and mesh agree.
    ///
    /// # Errors
    ///
    /// [`UnknownFormat`](SurfaceError::UnknownFormat) if the name implies no format; the errors of [`write_new`].
    pub fn write(&self, path: impl AsRef<Path>, overwrite: bool) -> Result<(), SurfaceError> {
        let path = path.as_ref();
        let bytes = match Format::of(path)? {
            Format::Markups => json::markups(self),
            Format::List => json::list(self),
            Format::Fiducials => table::fiducials(self),
            Format::Csv => table::text(self, b','),
            Format::Tsv => table::text(self, b'\t'),
        };
        write_new(path, overwrite, |out: &mut dyn Write| out.write_all(&bytes))
    }

    /// Returns the landmarks converted to `frame`. Landmarks without a frame are returned unchanged.
    #[must_use]
    pub fn in_frame(&self, frame: Frame) -> Self {
        match self.frame {
            Some(own) if own != frame => Self { frame: Some(frame), ..self.turned() },
            _ => self.clone(),
        }
    }

    /// Returns the landmarks rotated by half a turn about the third axis. The rotation converts between LPS and RAS.
    fn turned(&self) -> Self {
        Self { points: self.points.iter().map(|&[x, y, z]| [-x, -y, z]).collect(), ..self.clone() }
    }

    /// Matches the landmarks of subjects by their names.
    ///
    /// Frames aren't compared; see [`in_frame`](Self::in_frame). The result is empty if no name is common to all
    /// subjects.
    pub fn matched(subjects: &[Self]) -> Matched {
        let places: Vec<HashMap<&str, usize>> = subjects
            .iter()
            .map(|subject| subject.names.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect())
            .collect();
        let common = |name: &&String| places.iter().all(|names| names.contains_key(name.as_str()));
        let first = subjects.first().map_or(&[][..], |subject| &subject.names);
        let names: Vec<String> = first.iter().filter(common).cloned().collect();
        let points = subjects.iter().zip(&places).map(|(subject, places)| {
            names.iter().filter_map(|name| places.get(name.as_str()).map(|&i| subject.points[i])).collect()
        });
        let alone = subjects.iter().map(|subject| subject.names.iter().filter(|name| !common(name)).cloned().collect());
        Matched { points: points.collect(), alone: alone.collect(), names }
    }
}

/// A format of landmark files, determined by the file's name.
#[derive(Clone, Copy)]
enum Format {
    Markups,
    List,
    Fiducials,
    Csv,
    Tsv,
}

impl Format {
    fn of(path: &Path) -> Result<Self, SurfaceError> {
        let name = path.file_name().map(|name| name.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        let endings = [
            (".mrk.json", Self::Markups),
            (".json", Self::List),
            (".fcsv", Self::Fiducials),
            (".csv", Self::Csv),
            (".tsv", Self::Tsv),
        ];
        let found = endings.into_iter().find(|(ending, _)| name.ends_with(ending));
        found.map(|(_, format)| format).ok_or_else(|| SurfaceError::UnknownFormat {
            path: path.to_owned(),
            expected: "a landmark file (.mrk.json, .fcsv, .json, .csv or .tsv)".to_owned(),
            found: path.extension().map_or("no extension".to_owned(), |ending| ending.to_string_lossy().into_owned()),
        })
    }

    fn title(self) -> &'static str {
        match self {
            Self::Markups => "a Slicer markups file",
            Self::List => "a list of landmarks",
            Self::Fiducials => "a Slicer fiducials file",
            Self::Csv | Self::Tsv => "a table of landmarks",
        }
    }
}

/// The landmarks read so far. Each landmark is checked when it is added.
#[derive(Default)]
struct Gathered {
    names: Vec<String>,
    points: Vec<Vec3>,
    known: HashSet<String>,
}

impl Gathered {
    /// Adds a landmark. `at` is its position in the file for error messages, such as "line 3".
    fn add(&mut self, at: &str, name: &str, point: Vec3) -> Result<(), Flaw> {
        let name = name.trim();
        if name.is_empty() {
            return Err(Flaw::new(format!("a name in {at}"), "none"));
        }
        if let Some(value) = point.iter().find(|value| !value.is_finite()) {
            return Err(Flaw::new(format!("finite coordinates in {at}"), value.to_string()));
        }
        if !self.known.insert(name.to_owned()) {
            let found = format!("{} again in {at}", shown(name.as_bytes()));
            return Err(Flaw::new("each name only once", found));
        }
        self.names.push(name.to_owned());
        self.points.push(point);
        Ok(())
    }

    fn landmarks(self, frame: Option<Frame>) -> Landmarks {
        Landmarks { names: self.names, points: self.points, frame }
    }
}

#[cfg(test)]
mod tests;
