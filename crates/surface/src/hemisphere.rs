//! Determines whether a file belongs to the left or the right hemisphere.

use std::fmt;
use std::path::Path;

/// A hemisphere of the brain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hemisphere {
    /// The left hemisphere.
    Left,
    /// The right hemisphere.
    Right,
}

impl Hemisphere {
    /// Returns the hemisphere of a file: from its metadata (GIfTI's `AnatomicalStructurePrimary`, such as
    /// `CortexLeft`), otherwise from its name (`lh.pial`, `sub-01_hemi-L_white.surf.gii`). `None` if neither contains
    /// it.
    #[must_use]
    pub fn of(anatomical_structure: Option<&str>, path: Option<&Path>) -> Option<Self> {
        anatomical_structure.and_then(Self::of_structure).or_else(|| Self::of_name(path?))
    }

    /// Returns the hemisphere's cortex as a value of GIfTI's `AnatomicalStructurePrimary`.
    #[must_use]
    pub fn cortex(self) -> &'static str {
        match self {
            Self::Left => "CortexLeft",
            Self::Right => "CortexRight",
        }
    }

    fn of_structure(structure: &str) -> Option<Self> {
        match (structure.ends_with("Left"), structure.ends_with("Right")) {
            (true, _) => Some(Self::Left),
            (_, true) => Some(Self::Right),
            _ => None,
        }
    }

    fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        // A BIDS name consists of parts separated by `_`; the hemisphere is one of them.
        let part = |wanted: &str| name.split(['_', '.']).any(|part| part == wanted);
        if name.starts_with("lh.") || part("hemi-L") {
            Some(Self::Left)
        } else if name.starts_with("rh.") || part("hemi-R") {
            Some(Self::Right)
        } else {
            None
        }
    }
}

impl fmt::Display for Hemisphere {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_count_more_than_names() {
        let of = |structure: Option<&str>, name: &str| Hemisphere::of(structure, Some(Path::new(name)));
        assert_eq!(of(Some("CortexRight"), "lh.pial"), Some(Hemisphere::Right));
        assert_eq!(of(Some("Cortex"), "a/lh.pial"), Some(Hemisphere::Left));
        assert_eq!(of(None, "sub-01_hemi-R_white.surf.gii"), Some(Hemisphere::Right));
        assert_eq!(of(None, "hippo_l.obj"), None);
        assert_eq!(Hemisphere::of(None, None), None);
    }
}
