//! Detects files that are volumes or images, which can't be read as surfaces.

use super::mgh;

/// Returns the format of a volume or image, determined from the file's first bytes, or `None` for other files.
pub(super) fn kind(bytes: &[u8]) -> Option<&'static str> {
    let starts = |magic: &[u8]| bytes.starts_with(magic);
    let nifti = |at: usize, magics: [&[u8]; 2]| {
        magics.iter().any(|magic| bytes.get(at..).is_some_and(|rest| rest.starts_with(magic)))
    };
    if nifti(344, [b"n+1\0", b"ni1\0"]) {
        Some("NIfTI-1")
    } else if nifti(4, [b"n+2\0", b"ni2\0"]) {
        Some("NIfTI-2")
    } else if mgh::is_volume(bytes) {
        Some("FreeSurfer MGH")
    } else if starts(b"II*\0") || starts(b"MM\0*") || starts(b"II+\0") || starts(b"MM\0+") {
        Some("TIFF")
    } else if starts(b"\x93NUMPY") {
        Some("NumPy array")
    } else if starts(b"NRRD000") {
        Some("NRRD")
    } else {
        None
    }
}
