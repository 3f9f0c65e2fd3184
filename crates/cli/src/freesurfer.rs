//! Gives the names and locations of files in FreeSurfer's subject folders.

use std::path::{Path, PathBuf};

use clap::ValueEnum;

/// A hemisphere, as FreeSurfer names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Hemi {
    /// The left hemisphere.
    Lh,
    /// The right hemisphere.
    Rh,
}

impl Hemi {
    /// Returns the hemisphere's prefix in FreeSurfer's file names, without the dot.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Lh => "lh",
            Self::Rh => "rh",
        }
    }

    /// Returns the hemisphere's label in BIDS file names.
    #[must_use]
    pub fn of_bids(self) -> &'static str {
        match self {
            Self::Lh => "hemi-L",
            Self::Rh => "hemi-R",
        }
    }

    /// Returns the other hemisphere.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Lh => Self::Rh,
            Self::Rh => Self::Lh,
        }
    }
}

/// Name of the FreeSurfer label whose vertices' values are read by default.
pub const CORTEX: &str = "cortex";

/// Returns the path of a hemisphere's label file in a subject's folder.
#[must_use]
pub fn label_file(subject: &Path, hemi: Hemi, name: &str) -> PathBuf {
    subject.join("label").join(format!("{}.{name}.label", hemi.name()))
}

/// Returns the path of the cortex label that belongs to a per-vertex file `surf/lh.NAME` in a subject's folder, if the
/// label exists.
#[must_use]
pub fn cortex_label(values: &Path) -> Option<PathBuf> {
    let surf = values.parent().filter(|folder| folder.file_name().is_some_and(|name| name == "surf"))?;
    let (hemi, _) = other_hemisphere(values)?;
    Some(label_file(surf.parent()?, hemi, CORTEX)).filter(|label| label.is_file())
}

/// Returns the hemisphere given by a file's name, as FreeSurfer (`lh.`) or BIDS (`hemi-L`) writes it, and the path of
/// the corresponding file of the other hemisphere.
#[must_use]
pub fn other_hemisphere(path: &Path) -> Option<(Hemi, PathBuf)> {
    let name = path.file_name()?.to_str()?;
    [Hemi::Lh, Hemi::Rh].into_iter().find_map(|hemi| {
        let other = match name.strip_prefix(hemi.name()).filter(|rest| rest.starts_with('.')) {
            Some(rest) => format!("{}{rest}", hemi.other().name()),
            None => {
                let (before, after) = name.split_once(hemi.of_bids()).filter(|(_, after)| after.starts_with('_'))?;
                format!("{before}{}{after}", hemi.other().of_bids())
            }
        };
        Some((hemi, path.with_file_name(other)))
    })
}
