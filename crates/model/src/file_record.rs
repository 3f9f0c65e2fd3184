//! Identifies the files from which a model was made.

use std::fmt;
use std::io;
use std::path::Path;

use serde::{Deserialize, Deserializer, Serialize};

use crate::error::ModelError;

/// Identity of a file from which a model was made.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Path of the file, as given by the user.
    pub path: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the file's contents, as 64 hexadecimal digits.
    pub blake3: String,
    /// Label from which the surface was extracted, if the file is a volume.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<i64>,
    /// Number of the volume's channel, from 1, if the user chose one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<usize>,
    /// Number of the volume's time point, from 1, if the user chose one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<usize>,
}

impl fmt::Display for FileRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.path)?;
        self.label.map_or(Ok(()), |label| write!(f, " label {label}"))?;
        self.channel.map_or(Ok(()), |channel| write!(f, " channel {channel}"))?;
        self.time.map_or(Ok(()), |time| write!(f, " time {time}"))
    }
}

impl FileRecord {
    /// Computes the size and hash of a file.
    ///
    /// # Errors
    ///
    /// [`Input`](ModelError::Input) if the file doesn't exist, isn't a regular file or can't be read.
    pub fn of(path: &Path) -> Result<Self, ModelError> {
        let refuse = |source: io::Error| {
            let is_missing = source.kind() == io::ErrorKind::NotFound;
            let source = if is_missing { io::Error::new(source.kind(), "no such file") } else { source };
            ModelError::Input { path: path.to_owned(), source }
        };
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(spharm_files::open(path).map_err(refuse)?).map_err(refuse)?;
        let (bytes, blake3) = (hasher.count(), hasher.finalize().to_hex().to_string());
        Ok(Self { path: path.to_string_lossy().into_owned(), bytes, blake3, ..Self::default() })
    }

    /// Adds to the record the label, and the numbers of the channel and time point from which the label was read.
    #[must_use]
    pub fn with_label(self, label: i64, [channel, time]: [Option<usize>; 2]) -> Self {
        Self { label: Some(label), channel, time, ..self }
    }

    /// Returns the values that identify the contents: the file's hash, the label, and the numbers of the channel and
    /// the time point. A number that the user didn't choose is 1, because the file then has only one channel or time
    /// point.
    #[must_use]
    pub fn contents(&self) -> (&str, Option<i64>, [usize; 2]) {
        (&self.blake3, self.label, [self.channel, self.time].map(|number| number.unwrap_or(1)))
    }

    /// Returns whether two records have the same contents, label, channel and time point, regardless of the paths.
    #[must_use]
    pub fn same_contents(&self, other: &Self) -> bool {
        (self.bytes, self.contents()) == (other.bytes, other.contents())
    }
}

/// Returns the name of a file from a recorded path, which may have been recorded on another operating system.
///
/// ```
/// use spharm_model::recorded_name;
/// assert_eq!(recorded_name("surf/lh.white"), "lh.white");
/// assert_eq!(recorded_name(r"surf\lh.white"), "lh.white");
/// ```
#[must_use]
pub fn recorded_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

/// Deserializes a file record. Returns `None` for models from version 0.1, which store only the file's name.
pub(crate) fn of_any_version<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<FileRecord>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either {
        Record(FileRecord),
        Other(serde::de::IgnoredAny),
    }
    Ok(match Option::<Either>::deserialize(deserializer)? {
        Some(Either::Record(record)) => Some(record),
        Some(Either::Other(_)) | None => None,
    })
}
