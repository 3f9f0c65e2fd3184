//! Finds the factors in a scheme's folder: lists them, opens one, or starts a new one.

use std::path::Path;

use spharm_monitor::Monitor;

use crate::container::frame::{ALIGNMENT, HEADER_LEN};
use crate::container::table::{ENTRY_LEN, FOOTER_LEN};
use crate::error::{StoreError, StoreWarning};
use crate::factor::grid::TileGrid;
use crate::factor::reader::FactorFile;
use crate::factor::spec::FactorSpec;
use crate::factor::writer::FactorWriter;
use crate::scheme::{Scalar, SchemeKey};
use crate::{folder, temporary};

/// A factor of a scheme: its file name, and either the opened and checked file or the error of opening it.
pub type FoundFactor = (String, Result<FactorFile, StoreError>);

/// Lists and opens the factors of a scheme, in order of degree.
///
/// # Errors
///
/// [`StoreError::Io`] if the scheme's folder can't be listed.
pub fn factors(store: &Path, key: SchemeKey) -> Result<Vec<FoundFactor>, StoreError> {
    let folder = folder::of_scheme(store, key);
    let names = folder::list(&folder, "cannot open", |name| Some((degree_of(name)?, name.to_owned())))?;
    let open = |name: String| {
        let path = folder.join(&name);
        let file = FactorFile::open(&path).and_then(|file| {
            let header = file.header();
            let found = format!("{} of scheme {}", header.spec.file_name(header.scalar), header.spec.key.short());
            let expected = format!("{name} of scheme {}", key.short());
            if header.spec.key != key || found != expected {
                return Err(StoreError::corrupt(&path, "contents", expected, found));
            }
            Ok(file)
        });
        (name, file)
    };
    Ok(names.into_iter().map(|(_, name)| open(name)).collect())
}

/// Returns the degree in the name of a factor; `None` for other names.
fn degree_of(name: &str) -> Option<usize> {
    let mut parts = name.strip_prefix("factor_")?.split('_');
    let (degree, scalar, hash, end) = (parts.next()?, parts.next()?, parts.next()?, parts.next());
    let digits = |text: &str| text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    let named = end.is_none() && matches!(scalar, "f64" | "f32") && hash.len() == 8 && digits(hash);
    let number: usize = degree.parse().ok()?;
    (named && number.to_string() == degree).then_some(number)
}

/// Opens the factor that matches `spec`, with values of type `scalar`. If `scalar` is `None`, opens the f64 factor if
/// it exists, and the f32 factor otherwise.
///
/// # Errors
///
/// [`StoreError::FactorMissing`] if the store has no such factor, [`StoreError::FactorDiffers`] if the file holds
/// another factor, and the errors of [`FactorFile::open`].
pub fn open_factor(store: &Path, spec: &FactorSpec, scalar: Option<Scalar>) -> Result<FactorFile, StoreError> {
    let folder = folder::of_scheme(store, spec.key);
    for candidate in [Scalar::F64, Scalar::F32] {
        if scalar.is_some_and(|scalar| scalar != candidate) {
            continue;
        }
        let path = folder.join(spec.file_name(candidate));
        match FactorFile::open(&path) {
            Err(error) if error.is_not_found() => {}
            Err(error) => return Err(error),
            Ok(file) => {
                file.expect(spec)?;
                if file.header().scalar != candidate {
                    let (expected, found) = (candidate.name(), file.header().scalar.name());
                    return Err(StoreError::corrupt(&path, "scalar type", expected, found));
                }
                return Ok(file);
            }
        }
    }
    let available = match factors(store, spec.key) {
        Ok(found) => found.into_iter().map(|(name, _)| name).collect(),
        // The scheme's folder doesn't exist or can't be listed: report no available factors.
        Err(_) => Vec::new(),
    };
    let wanted = match scalar {
        Some(scalar) => format!("{spec} in {}", scalar.name()),
        None => spec.to_string(),
    };
    Err(StoreError::FactorMissing { store: store.to_path_buf(), key: spec.key, wanted, available })
}

/// Result of [`start_factor`]: the existing factor, or a writer for a new one.
#[derive(Debug)]
pub enum StartedFactor {
    /// The factor already exists.
    Present(FactorFile),
    /// The factor doesn't exist and is to be written.
    New {
        /// Writer for the factor's tiles.
        writer: Box<FactorWriter>,
        /// Warning about a damaged file that was removed; empty if the factor didn't exist.
        warnings: Vec<StoreWarning>,
    },
}

/// Starts writing a factor in `store`, unless it exists. If the existing file is damaged, it is removed and the factor
/// is written again.
///
/// With `read_back`, f32 tiles are also kept in double precision until the factor is published, so that
/// [`FactorWriter::get`] can return them. Sends a note to the monitor if the call waits for another process that builds
/// the same scheme.
///
/// # Errors
///
/// [`StoreError::NotAFile`] if the factor's path names something other than a regular file, [`StoreError::Version`] if
/// the existing file has another format version, [`StoreError::Io`] if the store can't be read or written,
/// [`StoreError::Interrupted`] if the monitor cancels the wait for another builder.
pub fn start_factor(
    store: &Path,
    spec: &FactorSpec,
    scalar: Scalar,
    grid: TileGrid,
    read_back: bool,
    monitor: &dyn Monitor,
) -> Result<StartedFactor, StoreError> {
    let folder = folder::of_scheme(store, spec.key);
    let path = folder.join(spec.file_name(scalar));
    // If the factor exists, nothing is written, so the call succeeds for a store on a read-only disk.
    if let Existing::Sound(file) = Existing::find(&path, spec)? {
        return Ok(StartedFactor::Present(file));
    }
    folder::create(store, &folder)?;
    let lock = folder::lock(&folder, monitor)?;
    temporary::remove_abandoned(&folder)?;
    let warnings = match Existing::find(&path, spec)? {
        Existing::Sound(file) => return Ok(StartedFactor::Present(file)),
        Existing::None => Vec::new(),
        Existing::Damaged(error) => {
            folder::remove_damaged(&path)?;
            vec![StoreWarning::Replaced(error)]
        }
    };
    let writer = FactorWriter::create(&folder, spec, scalar, grid, read_back, lock)?;
    Ok(StartedFactor::New { writer: Box::new(writer), warnings })
}

/// State of the file at a factor's path.
enum Existing {
    /// The file holds the factor.
    Sound(FactorFile),
    /// The file is damaged or holds another factor.
    Damaged(StoreError),
    /// There is no file.
    None,
}

impl Existing {
    fn find(path: &Path, spec: &FactorSpec) -> Result<Self, StoreError> {
        match FactorFile::open(path).and_then(|file| file.expect(spec).map(|()| file)) {
            Ok(file) => Ok(Self::Sound(file)),
            Err(error) if error.is_not_found() => Ok(Self::None),
            Err(
                error @ (StoreError::Corrupt { .. }
                | StoreError::ChangedWhileRead { .. }
                | StoreError::FactorDiffers { .. }),
            ) => Ok(Self::Damaged(error)),
            Err(error) => Err(error),
        }
    }
}

/// Returns an upper bound on the size of a factor's file in bytes.
fn file_bytes(grid: TileGrid, scalar: Scalar) -> u64 {
    // The padding after each tile is less than 64 bytes; the bound assumes 64 bytes.
    let values: u64 = grid.tiles().map(|(row, column)| grid.len(row, column) as u64).sum();
    values * scalar.size() as u64
        + grid.count() as u64 * (ENTRY_LEN as u64 + ALIGNMENT)
        + (HEADER_LEN + FOOTER_LEN) as u64
}

/// Checks that the disk has enough space for a factor. Returns the disk space in bytes that computing the factor needs.
/// `read_back` has the same meaning as in [`start_factor`].
///
/// # Errors
///
/// [`StoreError::Space`] for a factor larger than 64 GiB or than the free space, unless `allow_large` is set.
pub fn check_factor_space(
    store: &Path,
    grid: TileGrid,
    scalar: Scalar,
    read_back: bool,
    allow_large: bool,
) -> Result<u64, StoreError> {
    let scratch = if read_back && scalar == Scalar::F32 { file_bytes(grid, Scalar::F64) } else { 0 };
    let needed = file_bytes(grid, scalar) + scratch;
    if !allow_large {
        folder::check_space(store, "factor", needed)?;
    }
    Ok(needed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lower triangle of 9 columns in tiles of 8 has three tiles: 8 x 8, 1 x 8 and 1 x 1 values. Tiles on the
    /// diagonal are stored as full squares.
    #[test]
    fn a_factor_takes_its_tiles_table_header_and_footer() {
        let grid = TileGrid::new(9, 8).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let check = |scalar, read_back, allow_large| {
            check_factor_space(folder.path(), grid, scalar, read_back, allow_large).unwrap()
        };
        let values = 64 + 8 + 1;
        let around = 3 * (64 + 64) + 4096 + 128;
        assert_eq!(check(Scalar::F64, false, false), values * 8 + around);
        assert_eq!(check(Scalar::F32, false, false), values * 4 + around);
        // An f64 factor is read back from its own file. An f32 factor needs a second, f64 file for reading back.
        assert_eq!(check(Scalar::F64, true, true), values * 8 + around);
        assert_eq!(check(Scalar::F32, true, true), values * 12 + 2 * around);
        let large = TileGrid::new(1 << 17, 1024).unwrap();
        let refused = check_factor_space(folder.path(), large, Scalar::F64, false, false);
        assert!(matches!(refused, Err(StoreError::Space { what: "factor", .. })));
        assert!(
            check_factor_space(folder.path(), large, Scalar::F64, false, true).is_ok_and(|needed| needed > 64 << 30)
        );
    }

    #[test]
    fn only_names_of_factors_are_taken_for_factors() {
        assert_eq!(degree_of("factor_100_f64_0123abcd"), Some(100));
        assert_eq!(degree_of("factor_0_f32_0123abcd"), Some(0));
        for name in [
            "A_100",
            "factor_100_f64",
            "factor_0100_f64_0123abcd",
            "factor_1_f16_0123abcd",
            "factor_1_f64_0123ABCD",
            "factor_1_f64_0123abc",
            "factor_1_f64_0123abcd_",
            ".factor_1_f64_0123abcd.x.tmp",
        ] {
            assert_eq!(degree_of(name), None, "{name}");
        }
    }
}
