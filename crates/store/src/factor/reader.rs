//! An open factor: checked, then read through windows on its tile columns.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::StoreError;
use crate::codec::Codec;
use crate::factor::header::FactorHeader;
use crate::factor::spec::FactorSpec;
use crate::factor::writer::ROOT_CONTEXT;
use crate::header::{ALIGNMENT, HEADER_LEN};
use crate::map::{Source, Window};
use crate::reader::{open_regular, pieces, read_at, read_table};
use crate::scheme::{Scalar, SchemeKey};
use crate::table::{ENTRY_LEN, Entry, FOOTER_LEN};

/// An open factor whose header, table and footer are sound. Tiles are checked when they are first read.
#[derive(Debug, Clone)]
pub struct FactorFile {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    source: Source,
    header: FactorHeader,
    entries: Vec<Entry>,
    file_len: u64,
    /// Tiles whose checksum has been found right by this process.
    checked: Vec<AtomicBool>,
}

impl FactorFile {
    /// Opens a file and checks all but its tiles.
    ///
    /// # Errors
    ///
    /// [`StoreError::NotAFile`], [`StoreError::Corrupt`], [`StoreError::Version`], [`StoreError::Io`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let (file, file_len, (path, metadata)) = open_regular(path)?;
        let least = HEADER_LEN + ENTRY_LEN + FOOTER_LEN;
        if file_len < least as u64 {
            return Err(StoreError::corrupt(&path, "length of the file", format!("at least {least}"), file_len));
        }
        let mut header_bytes = [0; HEADER_LEN];
        read_at(&file, &path, 0, &mut header_bytes)?;
        let header = FactorHeader::decode(&header_bytes, &path)?;
        let count = header.grid.count() as u64;
        let (table, table_offset) = read_table(&file, &path, file_len, &header_bytes, count, ROOT_CONTEXT)?;
        let entries = decode_table(&table, &header, table_offset, &path)?;
        let checked = entries.iter().map(|_| AtomicBool::new(false)).collect();
        let source = Source::new(path, file, &metadata);
        Ok(Self { inner: Arc::new(Inner { source, header, entries, file_len, checked }) })
    }

    /// What the file holds.
    pub fn header(&self) -> &FactorHeader {
        &self.inner.header
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.inner.source.path
    }

    /// Its length in bytes.
    pub fn file_len(&self) -> u64 {
        self.inner.file_len
    }

    /// Fails, with the name of what differs, unless it is the factor of this.
    ///
    /// # Errors
    ///
    /// [`StoreError::FactorDiffers`].
    pub fn expect(&self, spec: &FactorSpec) -> Result<(), StoreError> {
        let found = &self.header().spec;
        let differs = |what, expected: &dyn ToString, found: &dyn ToString| {
            let path = self.path().to_path_buf();
            Err(StoreError::FactorDiffers { path, what, expected: expected.to_string(), found: found.to_string() })
        };
        if found.key != spec.key {
            return differs("scheme", &spec.key, &found.key);
        }
        if found.rows != spec.rows {
            return differs("number of directions", &spec.rows, &found.rows);
        }
        if found.max_degree != spec.max_degree {
            return differs("degree", &spec.max_degree, &found.max_degree);
        }
        if found.weights != spec.weights {
            return differs("set of weights", &spec.weights, &found.weights);
        }
        if found.smoothness != spec.smoothness {
            return differs("smoothness", &spec.smoothness, &found.smoothness);
        }
        Ok(())
    }

    /// Maps the tiles of a tile column.
    ///
    /// # Errors
    ///
    /// [`StoreError::Io`].
    ///
    /// # Panics
    ///
    /// If there is no such column.
    pub fn window(&self, column: usize) -> Result<TileWindow, StoreError> {
        let Inner { header, entries, source, .. } = &*self.inner;
        let grid = header.grid;
        let (first, last) = (grid.index(column, column), grid.index(grid.columns() - 1, column));
        let offset = entries[first].offset;
        let len = (entries[last].offset + entries[last].stored_len - offset) as usize;
        let window = Window::new(source, offset, len)?;
        Ok(TileWindow { inner: self.inner.clone(), window, column, first })
    }

    /// Checks every BLAKE3 hash, every CRC and every padding byte, a megabyte at a time.
    fn verify(&self, buffer: &mut Vec<u8>) -> Result<(), StoreError> {
        let Inner { source, header, entries, file_len, .. } = &*self.inner;
        let table_offset = file_len - FOOTER_LEN as u64 - (entries.len() * ENTRY_LEN) as u64;
        for (at, ((row, column), entry)) in header.grid.tiles().zip(entries).enumerate() {
            let damaged = |what| StoreError::TileDamaged { path: source.path.clone(), row, column, what };
            let end = entry.offset + entry.stored_len;
            let (mut hasher, mut crc) = (blake3::Hasher::new(), 0);
            pieces(source, entry.offset..end, buffer, &mut |piece| {
                hasher.update(piece);
                crc = crc32c::crc32c_append(crc, piece);
            })?;
            if hasher.finalize().as_bytes() != &entry.hash {
                return Err(damaged("its BLAKE3 hash"));
            }
            if crc != entry.crc {
                return Err(damaged("its CRC-32C"));
            }
            let next = entries.get(at + 1).map_or(table_offset, |entry| entry.offset);
            let mut zeros = true;
            pieces(source, end..next, buffer, &mut |piece| zeros &= piece.iter().all(|&byte| byte == 0))?;
            if !zeros {
                return Err(damaged("the padding after it"));
            }
        }
        source.check()
    }
}

/// Checks every byte of a factor against its hashes. `buffer` is scratch space, a megabyte at most.
///
/// # Errors
///
/// [`StoreError::TileDamaged`], [`StoreError::ChangedWhileRead`], [`StoreError::Io`].
pub fn verify_factor(file: &FactorFile, buffer: &mut Vec<u8>) -> Result<(), StoreError> {
    file.verify(buffer)
}

/// The values of a tile, column-major without gaps.
#[derive(Debug, Clone, Copy)]
pub enum TileValues<'a> {
    /// Double precision.
    F64(&'a [f64]),
    /// Single precision.
    F32(&'a [f32]),
}

/// The tiles of one tile column, mapped.
#[derive(Debug)]
pub struct TileWindow {
    inner: Arc<Inner>,
    window: Window,
    column: usize,
    first: usize,
}

impl TileWindow {
    /// The tile column.
    pub fn column(&self) -> usize {
        self.column
    }

    /// The values of tile (row, column), in place. The first time in a process its checksum is verified, which also
    /// brings it into the cache for the one who asked.
    ///
    /// What is computed from them counts only once [`check`](Self::check) has passed.
    ///
    /// # Errors
    ///
    /// [`StoreError::TileDamaged`], [`StoreError::ChangedWhileRead`].
    ///
    /// # Panics
    ///
    /// If the tile lies above the diagonal or outside.
    pub fn values(&self, row: usize) -> Result<TileValues<'_>, StoreError> {
        let Inner { source, header, entries, checked, .. } = &*self.inner;
        let at = header.grid.index(row, self.column);
        let entry = &entries[at];
        let start = (entry.offset - entries[self.first].offset) as usize;
        let bytes = &self.window.bytes()[start..start + entry.stored_len as usize];
        if !checked[at].load(Ordering::Relaxed) {
            if crc32c::crc32c(bytes) != entry.crc {
                // A page that went missing shows as a wrong checksum too; say what really happened.
                self.check()?;
                let (path, column) = (source.path.clone(), self.column);
                return Err(StoreError::TileDamaged { path, row, column, what: "its CRC-32C" });
            }
            checked[at].store(true, Ordering::Relaxed);
        }
        // Tiles start at multiples of 64 bytes and maps at pages, so the casts don't fail.
        Ok(match header.scalar {
            Scalar::F64 => TileValues::F64(bytemuck::cast_slice(bytes)),
            Scalar::F32 => TileValues::F32(bytemuck::cast_slice(bytes)),
        })
    }

    /// Starts reading all of it from disk.
    pub fn will_need(&self) {
        self.window.will_need(0, self.window.bytes().len());
    }

    /// Maps its pages in one go, which costs less than a fault for each.
    pub fn populate(&self) {
        self.window.populate(0, self.window.bytes().len());
    }

    /// Fails when the file was truncated, changed or unreadable since it was opened.
    ///
    /// # Errors
    ///
    /// [`StoreError::ChangedWhileRead`].
    pub fn check(&self) -> Result<(), StoreError> {
        self.window.check(&self.inner.source)
    }
}

/// Reads the table and checks that its tiles follow each other from the header to the table, each of the size that the
/// header implies.
fn decode_table(bytes: &[u8], header: &FactorHeader, table_offset: u64, path: &Path) -> Result<Vec<Entry>, StoreError> {
    let mut entries = Vec::with_capacity(bytes.len() / ENTRY_LEN);
    let mut expected_offset = HEADER_LEN as u64;
    for (bytes, (row, column)) in bytes.chunks_exact(ENTRY_LEN).zip(header.grid.tiles()) {
        let entry = Entry::decode(bytes, path)?;
        let len = header.tile_len(row, column) as u64;
        if entry.offset != expected_offset {
            return Err(StoreError::corrupt(path, "offset of a tile", expected_offset, entry.offset));
        }
        if entry.stored_len != len {
            return Err(StoreError::corrupt(path, "stored length of a tile", len, entry.stored_len));
        }
        if entry.raw_len != len {
            return Err(StoreError::corrupt(path, "decoded length of a tile", len, entry.raw_len));
        }
        if entry.codec != Codec::Raw {
            return Err(StoreError::corrupt(path, "codec of a tile", "none", entry.codec.name()));
        }
        // 2^22 tiles of at most 2^23 bytes: no overflow.
        expected_offset = (entry.offset + entry.stored_len).next_multiple_of(ALIGNMENT);
        entries.push(entry);
    }
    if expected_offset != table_offset {
        return Err(StoreError::corrupt(path, "offset of the table", expected_offset, table_offset));
    }
    Ok(entries)
}

/// Whether a file name is that of a factor, and of which degree.
fn degree_of(name: &str) -> Option<usize> {
    let mut parts = name.strip_prefix("factor_")?.split('_');
    let (degree, scalar, hash, end) = (parts.next()?, parts.next()?, parts.next()?, parts.next());
    let digits = |text: &str| text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    let named = end.is_none() && matches!(scalar, "f64" | "f32") && hash.len() == 8 && digits(hash);
    let number: usize = degree.parse().ok()?;
    (named && number.to_string() == degree).then_some(number)
}

/// A factor of a scheme: its name, and the file, opened and checked, or what is wrong with it.
pub type FoundFactor = (String, Result<FactorFile, StoreError>);

/// The factors of a scheme's folder, by degree.
///
/// # Errors
///
/// [`StoreError::Io`] when the folder can't be listed.
pub fn factors(store: &Path, key: SchemeKey) -> Result<Vec<FoundFactor>, StoreError> {
    let folder = store.join(key.to_string());
    let mut names = Vec::new();
    for item in std::fs::read_dir(&folder).map_err(StoreError::io(&folder, "cannot open"))? {
        let name = item.map_err(StoreError::io(&folder, "cannot open"))?.file_name();
        if let Some((degree, name)) = name.to_str().and_then(|name| Some((degree_of(name)?, name.to_owned()))) {
            names.push((degree, name));
        }
    }
    names.sort_unstable();
    let open = |name: String| {
        let path = folder.join(&name);
        let file = FactorFile::open(&path).and_then(|file| {
            let header = file.header();
            let is = format!("{} of scheme {}", header.spec.file_name(header.scalar), header.spec.key.short());
            let expected = format!("{name} of scheme {}", key.short());
            if header.spec.key != key || is != expected {
                return Err(StoreError::corrupt(&path, "contents", expected, is));
            }
            Ok(file)
        });
        (name, file)
    };
    Ok(names.into_iter().map(|(_, name)| open(name)).collect())
}

/// Opens the factor of exactly this, of one scalar type or, for `None`, f64 before f32.
///
/// # Errors
///
/// [`StoreError::FactorMissing`], [`StoreError::FactorDiffers`], and those of [`FactorFile::open`].
pub fn open_factor(store: &Path, spec: &FactorSpec, scalar: Option<Scalar>) -> Result<FactorFile, StoreError> {
    let folder: PathBuf = store.join(spec.key.to_string());
    for candidate in [Scalar::F64, Scalar::F32] {
        if scalar.is_some_and(|scalar| scalar != candidate) {
            continue;
        }
        let path = folder.join(spec.file_name(candidate));
        match FactorFile::open(&path) {
            Err(StoreError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {}
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
        // No folder, no factors.
        Err(_) => Vec::new(),
    };
    let wanted = match scalar {
        Some(scalar) => format!("{spec} in {}", scalar.name()),
        None => spec.to_string(),
    };
    Err(StoreError::FactorMissing { store: store.to_path_buf(), key: spec.key, wanted, available })
}

#[cfg(test)]
mod tests {
    use super::*;

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
