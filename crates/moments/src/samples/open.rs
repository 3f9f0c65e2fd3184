//! Opens a table in the format indicated by the file-name extension.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use spharm_surface::SurfaceError;

use super::table::Table;
#[cfg(feature = "tables")]
use super::{arrow, las, parquet};
use super::{csv, npy, npz, ply, signal};
use crate::MomentsError;
use crate::moments::Shard;

/// Path that denotes standard input.
pub(crate) const STDIN: &str = "-";
/// Supported file-name extensions of tables.
pub const ENDINGS: [&str; 10] =
    [".npy", ".npz", ".csv", ".tsv", ".txt", ".parquet", ".arrow", ".feather", ".ply", ".las"];

/// File-name extensions of per-vertex files, which can only be read together with a sampling scheme. Other per-vertex
/// files of FreeSurfer have no fixed extension.
const SIGNALS: [&str; 3] = [".gii", ".mgh", ".mgz"];

/// An opened table, with the properties that are known before its rows are read.
pub(crate) struct Opened {
    pub(crate) table: Box<dyn Table>,
    /// Size of the file in bytes; `None` for standard input.
    pub(crate) bytes: Option<u64>,
    /// Number of rows in the shard, if known.
    pub(crate) rows: Option<u64>,
    /// Running hash of the bytes read from standard input, complete after the last byte has been read; `None` for
    /// files.
    pub(crate) hash: Option<Arc<Mutex<blake3::Hasher>>>,
}

/// Opens a shard of a table.
pub(crate) fn open(path: &Path, shard: Shard) -> Result<Opened, MomentsError> {
    if path.as_os_str() == STDIN {
        return standard_input(path, shard);
    }
    let (file, bytes) = open_file(path)?;
    fn known<T: Table + 'static>((table, rows): (T, u64)) -> (Box<dyn Table>, Option<u64>) {
        (Box::new(table), Some(rows))
    }
    let (table, rows) = match ending(path) {
        Some(".npy") => known(npy::open(path, file, bytes, shard)?),
        Some(".npz") => known(npz::open(path, file, shard)?),
        #[cfg(feature = "tables")]
        Some(".parquet") => known(parquet::open(path, file, shard)?),
        #[cfg(feature = "tables")]
        Some(".arrow" | ".feather") => known(arrow::open(path, file, shard)?),
        #[cfg(not(feature = "tables"))]
        Some(".parquet" | ".arrow" | ".feather" | ".las") => {
            return Err(MomentsError::LeftOut { path: path.to_owned() });
        }
        #[cfg(feature = "tables")]
        Some(".las") => known(las::open(path, file, bytes, shard)?),
        Some(".ply") => ply::open(path, file, bytes, shard)?,
        Some(_) => (Box::new(csv::open(path, file, bytes, shard)?) as Box<dyn Table>, None),
        None => return Err(MomentsError::UnknownFormat { path: path.to_owned(), expected: ENDINGS.to_vec() }),
    };
    Ok(Opened { table, bytes: Some(bytes), rows, hash: None })
}

/// Opens a table whose rows belong to the directions of a sampling scheme. The entire table is opened, even if only a
/// shard is used, because shards of text tables are byte ranges, but row numbers are needed to assign directions to
/// rows. Per-vertex files are also accepted.
pub(crate) fn open_over_scheme(path: &Path, shard: Shard) -> Result<Opened, MomentsError> {
    if path.as_os_str() == STDIN {
        return standard_input(path, shard);
    }
    if is_table(path) {
        return open(path, Shard::WHOLE);
    }
    let (_, bytes) = open_file(path)?;
    let table = signal::open(path).map_err(|error| match error {
        SurfaceError::UnknownFormat { path, .. } => {
            MomentsError::UnknownFormat { path, expected: [&ENDINGS[..], &SIGNALS].concat() }
        }
        error => MomentsError::Signal(error),
    })?;
    let rows = Some(table.rows());
    Ok(Opened { table: Box::new(table), bytes: Some(bytes), rows, hash: None })
}

/// Returns whether a file name has the extension of a table.
pub(crate) fn is_table(path: &Path) -> bool {
    ending(path).is_some()
}

fn ending(path: &Path) -> Option<&'static str> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    ENDINGS.into_iter().find(|ending| name.ends_with(ending))
}

/// Opens a regular, nonempty file. Returns the file and its size in bytes.
fn open_file(path: &Path) -> Result<(File, u64), MomentsError> {
    let file = spharm_files::open(path).map_err(MomentsError::io(path, "open"))?;
    let bytes = file.metadata().map_err(MomentsError::io(path, "open"))?.len();
    if bytes == 0 {
        return Err(MomentsError::Empty { path: path.to_owned() });
    }
    Ok((file, bytes))
}

/// Opens standard input. It is read as a NumPy array if it begins with NumPy's magic number, otherwise as text.
fn standard_input(path: &Path, shard: Shard) -> Result<Opened, MomentsError> {
    if shard != Shard::WHOLE {
        return Err(MomentsError::ShardOfStream);
    }
    let hash = Arc::new(Mutex::new(blake3::Hasher::new()));
    let mut input = BufReader::with_capacity(1 << 16, Hashed { input: io::stdin(), hash: Arc::clone(&hash) });
    let mut start = Vec::new();
    input.by_ref().take(npy::MAGIC.len() as u64).read_to_end(&mut start).map_err(MomentsError::io(path, "read"))?;
    if start.is_empty() {
        return Err(MomentsError::Empty { path: path.to_owned() });
    }
    let is_array = start == npy::MAGIC;
    let input: Box<dyn Read + Send> = Box::new(io::Cursor::new(start).chain(input));
    let (table, rows): (Box<dyn Table>, _) = if is_array {
        let (table, rows) = npy::of_stream(path, input)?;
        (Box::new(table), Some(rows))
    } else {
        (Box::new(csv::of_stream(path, input)?), None)
    };
    Ok(Opened { table, bytes: None, rows, hash: Some(hash) })
}

/// Reader that hashes the bytes read through it.
struct Hashed<R> {
    input: R,
    hash: Arc<Mutex<blake3::Hasher>>,
}

impl<R: Read> Read for Hashed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.hash.lock().unwrap_or_else(PoisonError::into_inner).update(&buffer[..count]);
        Ok(count)
    }
}
