//! Estimates the memory needed to read a file, from the file's size alone.

use std::fs::{File, metadata};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::load::is_gzip;

/// Returns an estimate of the number of bytes needed to read a mesh, a signal or a model, including the result.
/// Returns 0 if the path isn't a regular file.
///
/// A file of F bytes is read completely. Its mesh takes less than 2 F bytes in memory: 24 per vertex and 12 per
/// triangle. GIfTI and VTK's XML files contain compressed data in base64, which are a few times smaller than the
/// decoded data. The text in a 3MF file is compressed, too. Merging the vertices of a glTF file takes memory as well.
/// The size of a gzipped file's contents is in its last four bytes. Contents that are far larger than estimated from
/// the file's size are detected during decoding.
///
/// Memory measured on an icosphere of 655,362 vertices, as a multiple of F: PLY 2.3, OBJ, OFF and VTK 1.4, STL 2.1,
/// GIfTI 6.5, VTK's XML 2.2 to 5.1, glTF 3.1 to 4.6, 3MF 6.8, VRML 1.8.
#[must_use]
pub fn bytes_to_read(path: &Path) -> u64 {
    const PLAIN: u64 = 3;
    const PACKED: u64 = 8;
    // This factor is larger than the measured 6.8, because numbers with few digits compress better than those in the
    // measured file.
    const ZIPPED: u64 = 12;
    let Some(size) = metadata(path).ok().filter(|found| found.is_file()).map(|found| found.len()) else { return 0 };
    let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
    let name = name.trim_end_matches(".gz");
    let factor = match () {
        () if name.ends_with(".3mf") => ZIPPED,
        () if [".gii", ".vtp", ".vtu", ".glb", ".gltf"].iter().any(|ending| name.ends_with(ending)) => PACKED,
        () => PLAIN,
    };
    match inflated(path, size) {
        Some(inflated) => size.saturating_add(inflated.max(size).saturating_mul(factor)),
        None => size.saturating_mul(factor),
    }
}

/// Returns the uncompressed size recorded in a gzip file, modulo 2^32, or `None` for other files.
fn inflated(path: &Path, size: u64) -> Option<u64> {
    let mut file = File::open(path).ok()?;
    let (mut magic, mut last) = ([0; 2], [0; 4]);
    file.read_exact(&mut magic).ok()?;
    if !is_gzip(&magic) || size < 18 {
        return None;
    }
    file.seek(SeekFrom::End(-4)).ok()?;
    file.read_exact(&mut last).ok()?;
    Some(u64::from(u32::from_le_bytes(last)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::io::{WriteOptions, read_mesh, write_mesh};

    #[test]
    fn the_figure_covers_the_file_and_its_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = icosphere(5);
        for name in ["s.ply", "s.obj", "s.surf.gii", "s.off.gz", "s.stl", "lh.s", "s.vtp", "s.glb", "s.3mf"] {
            let path = folder.path().join(name);
            write_mesh(&path, &mesh, &WriteOptions::default()).unwrap();
            let read = read_mesh(&path).unwrap();
            let held = 24 * read.vertices.len() + 12 * read.faces.len();
            let size = metadata(&path).unwrap().len();
            let found = bytes_to_read(&path);
            assert!(found >= size + held as u64 && found < 20 * held as u64, "{name}: {found} of {size}, {held}");
        }
        assert_eq!(bytes_to_read(folder.path()), 0);
        assert_eq!(bytes_to_read(&folder.path().join("none")), 0);
    }
}
