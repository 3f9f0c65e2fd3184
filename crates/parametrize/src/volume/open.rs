//! Determines a volume's format from its name and its first bytes, and reads it.

use std::io::Read;
use std::path::Path;

use spharm_surface::io::MOST_EXPANSION;
use spharm_surface::npy;

use super::source::{Source, load};
use super::values::Volume;
use super::{mgh, nifti, nifti2, npy as array, nrrd, tiff};
use crate::error::ParametrizeError;

/// File name extensions of volumes.
const ENDINGS: [&str; 10] = [".nii", ".nii.gz", ".mgh", ".mgz", ".nrrd", ".nhdr", ".tif", ".tiff", ".npy", ".npy.gz"];

/// Returns whether a path has the file name extension of a format for volumes: NIfTI, FreeSurfer, NRRD, TIFF or NumPy.
///
/// FreeSurfer also stores values on the vertices of a surface in `.mgh` and `.mgz` files. Only the sizes in the file
/// distinguish such values from volumes; [`LabelVolume::read`](super::LabelVolume::read) rejects such files.
#[must_use]
pub fn is_volume(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    ENDINGS.iter().any(|ending| name.ends_with(ending))
}

/// Reads a volume in the format indicated by the file's first bytes. Also returns the voxel size in the file if the
/// size that the caller gave replaces it.
pub(super) fn read(source: &Source<'_>) -> Result<(Volume, Option<[f64; 3]>), ParametrizeError> {
    let bytes = load(source.path)?;
    let mut volume = if bytes.starts_with(&[0x1f, 0x8b]) {
        let most = (bytes.len() as u64).saturating_mul(MOST_EXPANSION);
        stream(source, flate2::bufread::MultiGzDecoder::new(&bytes[..]), most)?
    } else if tiff::is_tiff(&bytes) {
        tiff::parse(source, &bytes)?
    } else if bytes.starts_with(b"NRRD") {
        nrrd::parse(source, &bytes)?
    } else {
        stream(source, &bytes[..], bytes.len() as u64)?
    };
    let replaced = source.voxel_size.map(|size| {
        let found = volume.affine.voxel_size();
        volume.affine = volume.affine.with_voxel_size(size);
        found
    });
    Ok((volume, replaced))
}

/// Reads a NIfTI, FreeSurfer or NumPy file as a stream. NIfTI files begin with the header's size, in either byte order;
/// FreeSurfer files with their version.
fn stream(source: &Source<'_>, mut stream: impl Read, most: u64) -> Result<Volume, ParametrizeError> {
    let mut magic = Vec::with_capacity(6);
    // A stream of fewer than 6 bytes is empty or damaged; the parsers report this.
    let _ = (&mut stream).take(6).read_to_end(&mut magic);
    let first: Option<[u8; 4]> = magic.first_chunk().copied();
    let is_npy = magic == npy::MAGIC;
    let stream = magic.chain(stream);
    match first {
        Some([0, 0, 0, 1]) => mgh::parse(source, stream, most),
        _ if is_npy => array::parse(source, stream, most),
        Some([0x1c, 2, 0, 0] | [0, 0, 2, 0x1c]) => nifti2::parse(source, stream, most),
        None | Some([0x5c, 1, 0, 0] | [0, 0, 1, 0x5c]) => nifti::parse(source, stream, most),
        _ => Err(source.wrong(
            "a volume: NIfTI (.nii), FreeSurfer (.mgz), NRRD (.nrrd), TIFF (.tif) or NumPy (.npy)",
            "another format".to_owned(),
        )),
    }
}
