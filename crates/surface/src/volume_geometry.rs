//! Represents the position of a surface within the volume from which the surface was made, as recorded by FreeSurfer.
//!
//! Coordinates in FreeSurfer's surfaces are relative to the centre of their volume. To convert coordinates to scanner
//! coordinates, the volume's size, axes and centre (`c_ras`) are needed. FreeSurfer's own format stores this geometry
//! as text after the triangles, and GIfTI files store it as metadata named `VolGeom...`. Both formats have the same
//! information, so the geometry is preserved when a surface is converted from one format to the other.
//!
//! Source: FreeSurfer's `writeVolGeom` (utils/transform.cpp) and `MRISwriteGIFTI` (utils/gifti.cpp).

use crate::mesh::Meta;

/// Size, axes and centre of the volume from which a surface was made.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeGeometry {
    /// Name of the volume's file, if known.
    pub filename: Option<String>,
    /// Number of voxels along the three axes.
    pub size: [u32; 3],
    /// Size of a voxel along the three axes, in mm.
    pub voxel_size: [f64; 3],
    /// Directions of the three axes, then the centre (`c_ras`) in mm, in scanner coordinates: right, anterior,
    /// superior.
    pub axes_and_centre: [[f64; 3]; 4],
}

/// Keys of the three axes and the centre in a FreeSurfer footer.
const ROWS: [&str; 4] = ["xras", "yras", "zras", "cras"];
/// Names of the three axes and the centre in GIfTI metadata. Each name is followed by one of [`DIRECTIONS`].
const GIFTI_ROWS: [&str; 4] = ["VolGeomX_", "VolGeomY_", "VolGeomZ_", "VolGeomC_"];
const DIRECTIONS: [&str; 3] = ["R", "A", "S"];
const GIFTI_SIZES: [&str; 3] = ["VolGeomWidth", "VolGeomHeight", "VolGeomDepth"];
const GIFTI_VOXELS: [&str; 3] = ["VolGeomXsize", "VolGeomYsize", "VolGeomZsize"];

impl VolumeGeometry {
    /// Returns the geometry in a mesh's metadata. It is read from the FreeSurfer footer if the metadata contain one,
    /// otherwise from GIfTI metadata.
    #[must_use]
    pub fn of(meta: &Meta) -> Option<Self> {
        let footer = meta.freesurfer_footer.as_deref().and_then(Self::of_footer);
        footer.or_else(|| Self::of_metadata(&meta.surface_metadata)).or_else(|| Self::of_metadata(&meta.file_metadata))
    }

    /// Parses the text in a FreeSurfer footer; `None` if the text is missing or marked as invalid.
    fn of_footer(footer: &[u8]) -> Option<Self> {
        let start = footer.windows(5).position(|w| w == b"valid")?;
        let text = String::from_utf8_lossy(&footer[start..]);
        let value = |key: &str| {
            let mut pairs = text.lines().filter_map(|line| line.split_once('='));
            pairs.find(|(name, _)| name.trim() == key).map(|(_, value)| value.trim())
        };
        if value("valid")?.split_whitespace().next() != Some("1") {
            return None;
        }
        let mut axes_and_centre = [[0.0; 3]; 4];
        for (row, key) in axes_and_centre.iter_mut().zip(ROWS) {
            *row = numbers(value(key)?)?;
        }
        Some(Self {
            filename: value("filename").filter(|name| !name.is_empty()).map(str::to_owned),
            size: numbers(value("volume")?)?,
            voxel_size: numbers(value("voxelsize")?)?,
            axes_and_centre,
        })
    }

    fn of_metadata(metadata: &[(String, String)]) -> Option<Self> {
        let value = |name: &str| metadata.iter().find(|(key, _)| key == name).map(|(_, value)| value.trim());
        let triple = |names: [&str; 3]| -> Option<String> {
            Some(names.map(value).into_iter().collect::<Option<Vec<_>>>()?.join(" "))
        };
        let mut axes_and_centre = [[0.0; 3]; 4];
        for (row, prefix) in axes_and_centre.iter_mut().zip(GIFTI_ROWS) {
            let names = DIRECTIONS.map(|direction| format!("{prefix}{direction}"));
            *row = numbers(&triple([&names[0], &names[1], &names[2]])?)?;
        }
        Some(Self {
            filename: None,
            size: numbers(&triple(GIFTI_SIZES)?)?,
            voxel_size: numbers(&triple(GIFTI_VOXELS)?)?,
            axes_and_centre,
        })
    }

    /// Returns the geometry as entries of a GIfTI point set's metadata.
    #[must_use]
    pub fn to_metadata(&self) -> Vec<(String, String)> {
        let sizes = GIFTI_SIZES.iter().zip(self.size).map(|(name, n)| ((*name).to_owned(), n.to_string()));
        let voxels = GIFTI_VOXELS.iter().zip(self.voxel_size).map(|(name, x)| ((*name).to_owned(), format!("{x:?}")));
        let rows = GIFTI_ROWS.iter().zip(self.axes_and_centre).flat_map(|(prefix, row)| {
            DIRECTIONS.iter().zip(row).map(move |(direction, x)| (format!("{prefix}{direction}"), format!("{x:?}")))
        });
        sizes.chain(voxels).chain(rows).collect()
    }

    /// Returns the geometry as the footer that follows a FreeSurfer surface's triangles.
    #[must_use]
    pub fn to_footer(&self) -> Vec<u8> {
        /// Three numbers: the tag of the flag for scanner coordinates, the flag's value 0 (no), and the tag of the
        /// volume's geometry.
        const TAGS: [i32; 3] = [2, 0, 20];
        let mut footer: Vec<u8> = TAGS.iter().flat_map(|tag| tag.to_be_bytes()).collect();
        let triple = |row: [f64; 3]| row.map(|x| format!("{x:.15e}")).join(" ");
        let mut line = |key: &str, value: &str| footer.extend(format!("{key} = {value}\n").bytes());
        line("valid", "1  # volume info valid");
        line("filename", self.filename.as_deref().unwrap_or_default());
        line("volume", &self.size.map(|n| n.to_string()).join(" "));
        line("voxelsize", &triple(self.voxel_size));
        for (key, row) in ROWS.iter().zip(self.axes_and_centre) {
            line(&format!("{key}  "), &triple(row));
        }
        footer
    }
}

/// Parses three numbers separated by white space.
fn numbers<T: std::str::FromStr>(text: &str) -> Option<[T; 3]> {
    let numbers: Vec<T> = text.split_whitespace().map(|word| word.parse().ok()).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> VolumeGeometry {
        VolumeGeometry {
            filename: Some("../mri/orig.mgz".to_owned()),
            size: [256, 256, 200],
            voxel_size: [1.0, 1.0, 0.8],
            axes_and_centre: [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [5.0, -17.5, 18.2]],
        }
    }

    #[test]
    fn footer_and_metadata_say_the_same() {
        let footer = Meta { freesurfer_footer: Some(geometry().to_footer()), ..Meta::default() };
        assert_eq!(VolumeGeometry::of(&footer), Some(geometry()));
        let gifti = Meta { surface_metadata: geometry().to_metadata(), ..Meta::default() };
        assert_eq!(VolumeGeometry::of(&gifti), Some(VolumeGeometry { filename: None, ..geometry() }));
        assert_eq!(gifti.surface_metadata.len(), 18);
    }

    #[test]
    fn what_is_not_valid_or_not_whole_is_none() {
        let text = String::from_utf8_lossy(&geometry().to_footer()).into_owned();
        let of =
            |text: String| VolumeGeometry::of(&Meta { freesurfer_footer: Some(text.into_bytes()), ..Meta::default() });
        assert_eq!(of(text.replace("valid = 1", "valid = 0")), None);
        assert_eq!(of(text.replace("cras", "dras")), None);
        assert_eq!(of(text.replace("256 256 200", "256 256")), None);
        assert_eq!(VolumeGeometry::of(&Meta::default()), None);
    }
}
