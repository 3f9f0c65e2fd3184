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
    /// Determines the hemisphere of a file from its metadata (GIfTI's `AnatomicalStructurePrimary`, such as
    /// `CortexLeft`). If the metadata don't state it, determines it from the file's name (`lh.pial`,
    /// `sub-01.lh.thickness.spharm.npz`, `sub-01_hemi-L_white.surf.gii`). Returns `None` if neither states the
    /// hemisphere.
    #[must_use]
    pub fn of(anatomical_structure: Option<&str>, path: Option<&Path>) -> Option<Self> {
        anatomical_structure.and_then(Self::of_structure).or_else(|| Self::of_name(path?))
    }

    /// Returns the hemisphere for the name of a side, such as `lh`, `left` or `L`, in upper or lower case. Returns
    /// `None` for other names.
    #[must_use]
    pub fn of_side(name: &str) -> Option<Self> {
        match name.to_lowercase().as_str() {
            "lh" | "left" | "l" | "hemi-l" => Some(Self::Left),
            "rh" | "right" | "r" | "hemi-r" => Some(Self::Right),
            _ => None,
        }
    }

    /// Returns the other hemisphere.
    #[must_use]
    pub fn opposite(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }

    /// Returns the name of an anatomical structure after mirroring: `CortexLeft` for `CortexRight`. The names of
    /// structures without a side, such as `Cortex`, don't change.
    #[must_use]
    pub fn mirrored_structure(structure: &str) -> String {
        match (structure.strip_suffix("Left"), structure.strip_suffix("Right")) {
            (Some(of), _) => format!("{of}Right"),
            (_, Some(of)) => format!("{of}Left"),
            _ => structure.to_owned(),
        }
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
        // The hemisphere is one of the parts of the file's name, which are separated by `.` in FreeSurfer and by `_` in
        // BIDS.
        name.split(['_', '.']).find_map(|part| match part {
            "lh" | "hemi-L" => Some(Self::Left),
            "rh" | "hemi-R" => Some(Self::Right),
            _ => None,
        })
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
        assert_eq!(of(None, "sub-01.lh.thickness.spharm.npz"), Some(Hemisphere::Left));
        assert_eq!(of(None, "s1_rh.spharm.npz"), Some(Hemisphere::Right));
        assert_eq!(of(None, "hippo_l.obj"), None);
        assert_eq!(of(None, "rhombus.obj"), None);
        assert_eq!(Hemisphere::of(None, None), None);
    }

    #[test]
    fn sides_have_hemispheres_and_mirror_images_the_opposite_structure() {
        for (left, right) in [("lh", "rh"), ("Left", "right"), ("L", "R"), ("hemi-L", "hemi-R")] {
            let [left, right] = [left, right].map(Hemisphere::of_side);
            assert_eq!((left, right), (Some(Hemisphere::Left), left.map(Hemisphere::opposite)));
        }
        assert_eq!(Hemisphere::of_side("affected"), None);
        for (structure, image) in [("CortexRight", "CortexLeft"), ("CortexLeft", "CortexRight"), ("Cortex", "Cortex")] {
            assert_eq!(Hemisphere::mirrored_structure(structure), image);
        }
    }
}
