//! Reads and writes files of moments; `docs/moments-format.md` specifies their bytes.

use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::Path;

use ndarray::Array2;
use spharm_harmonics::{MAX_DEGREE, basis_size};
use spharm_store::SchemeKey;
use spharm_surface::io::write_new;
use spharm_transform::{Occupied, SampleSums};

use crate::MomentsError;
use crate::moments::{MOST_SHARDS, Moments, Shard, Source};

/// Format version of the files written.
const VERSION: u32 = 2;
/// Format versions that can be read.
const VERSIONS_READ: RangeInclusive<u32> = 1..=VERSION;

const MAGIC: [u8; 8] = *b"SPHMOMNT";
/// Code for the convention of the harmonics: real and orthonormal, without the Condon-Shortley phase, in row
/// `l^2 + l + m`.
const CONVENTION: u32 = 1;

const VERSION_AT: usize = 8;
const HEADER_LEN_AT: usize = VERSION_AT + 4;
const FILE_LEN_AT: usize = HEADER_LEN_AT + 4;
const CONVENTION_AT: usize = FILE_LEN_AT + 8;
const DEGREE_AT: usize = CONVENTION_AT + 4;
const CHANNELS_AT: usize = DEGREE_AT + 4;
const SOURCES_AT: usize = CHANNELS_AT + 4;
const NAMES_AT: usize = SOURCES_AT + 4;
const CELLS_AT: usize = NAMES_AT + 4;
const ROWS_AT: usize = CELLS_AT + 4;
const COUNT_AT: usize = ROWS_AT + 8;
const WEIGHT_AT: usize = COUNT_AT + 8;
/// Offset of the sampling scheme's key, in files from version 2 on; the key is zero if there is no scheme. In version
/// 1, the reserved bytes start here.
const SCHEME_AT: usize = WEIGHT_AT + 8;
const RESERVED_AT: usize = SCHEME_AT + 32;
const HEADER_LEN: usize = 160;
const HEADER_LEN_V1: usize = 128;
/// Size of a hash in bytes. The header ends with a hash of the header, and the file ends with a hash of the file.
const HASH: usize = 32;
/// Size in bytes of an entry in the list of sources.
const SOURCE: usize = 48;
const MOST_SOURCES: usize = 1 << 24;
const LONGEST_NAMES: usize = 1 << 24;
/// Name that errors show instead of a path for moments that aren't in a file.
const IN_MEMORY: &str = "the moments";

impl Moments {
    /// Largest number of channels in a file.
    pub const MOST_CHANNELS: usize = 1 << 16;

    /// Writes a file of moments. On an error, no incomplete file is left. An existing file is replaced only if
    /// `overwrite` is set.
    ///
    /// # Errors
    ///
    /// [`MomentsError::Output`] if the file exists and `overwrite` isn't set, or if the file can't be written.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<(), MomentsError> {
        Ok(write_new(path, overwrite, |out| self.encode(out))?)
    }

    /// Reads a file of moments, and verifies every byte by the hash of the file.
    ///
    /// # Errors
    ///
    /// [`MomentsError::Io`] if the file can't be read, [`MomentsError::Corrupt`] if it is damaged or not a file of
    /// moments, and [`MomentsError::Version`] if its format version can't be read.
    pub fn read(path: &Path) -> Result<Self, MomentsError> {
        let mut file = spharm_files::open(path).map_err(MomentsError::io(path, "open"))?;
        let length = file.metadata().map_err(MomentsError::io(path, "open"))?.len();
        decode(&mut file, length, path)
    }

    /// Encodes the moments as the bytes of a file.
    ///
    /// # Errors
    ///
    /// [`MomentsError::Io`] if the format can't represent a size.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MomentsError> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes).map_err(MomentsError::io(Path::new(IN_MEMORY), "write"))?;
        Ok(bytes)
    }

    /// Decodes the bytes of a file, and verifies them by the hash at their end.
    ///
    /// # Errors
    ///
    /// [`MomentsError::Corrupt`] if the bytes are damaged or not a file of moments, and [`MomentsError::Version`] if
    /// their format version can't be read.
    pub fn from_bytes(mut bytes: &[u8]) -> Result<Self, MomentsError> {
        let length = bytes.len() as u64;
        decode(&mut bytes, length, Path::new(IN_MEMORY))
    }

    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        let names = encode_names(&self.channels);
        let cells = self.occupied.bytes();
        let sizes = Sizes {
            max_degree: self.sums.max_degree,
            channels: self.channels.len(),
            sources: self.sources.len(),
            names: names.len(),
            cells: cells.len(),
        };
        let mut header = [0; HEADER_LEN];
        let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
        let u32_of = |value: usize| u32::try_from(value).map_err(io::Error::other);
        put(0, &MAGIC);
        put(VERSION_AT, &VERSION.to_le_bytes());
        put(HEADER_LEN_AT, &u32_of(HEADER_LEN)?.to_le_bytes());
        put(FILE_LEN_AT, &sizes.file_len(HEADER_LEN).to_le_bytes());
        put(CONVENTION_AT, &CONVENTION.to_le_bytes());
        for (at, value) in [
            (DEGREE_AT, sizes.max_degree),
            (CHANNELS_AT, sizes.channels),
            (SOURCES_AT, sizes.sources),
            (NAMES_AT, sizes.names),
            (CELLS_AT, sizes.cells),
        ] {
            put(at, &u32_of(value)?.to_le_bytes());
        }
        put(ROWS_AT, &self.rows.to_le_bytes());
        put(COUNT_AT, &self.sums.count.to_le_bytes());
        put(WEIGHT_AT, &self.sums.weight.to_le_bytes());
        put(SCHEME_AT, &self.scheme.map_or([0; 32], |SchemeKey(key)| key));
        let (fields, hash) = header.split_at_mut(HEADER_LEN - HASH);
        hash.copy_from_slice(blake3::hash(fields).as_bytes());
        let mut out = Hashing { out, hasher: blake3::Hasher::new() };
        out.write_all(&header)?;
        for values in [&self.sums.squares, &self.sums.moments] {
            out.numbers(values.iter())?;
        }
        out.numbers(self.sums.right_sides.iter())?;
        for Source { key, shard, rows } in &self.sources {
            out.write_all(key)?;
            out.write_all(&shard.index.to_le_bytes())?;
            out.write_all(&shard.of.to_le_bytes())?;
            out.write_all(&rows.to_le_bytes())?;
        }
        out.write_all(&cells)?;
        out.write_all(&names)?;
        let hash = out.hasher.finalize();
        out.out.write_all(hash.as_bytes())
    }
}

/// The sizes that determine the length of a file.
struct Sizes {
    max_degree: usize,
    channels: usize,
    sources: usize,
    names: usize,
    cells: usize,
}

impl Sizes {
    fn numbers(&self) -> usize {
        self.channels + basis_size(2 * self.max_degree) + basis_size(self.max_degree) * self.channels
    }

    /// Returns the length of the file in bytes. The length is below 2^60, because all sizes have been checked against
    /// their limits.
    fn file_len(&self, header: usize) -> u64 {
        (header + 8 * self.numbers() + SOURCE * self.sources + self.cells + self.names + HASH) as u64
    }
}

/// A writer that also hashes the bytes written.
struct Hashing<'a> {
    out: &'a mut dyn Write,
    hasher: blake3::Hasher,
}

impl Hashing<'_> {
    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hasher.update(bytes);
        self.out.write_all(bytes)
    }

    fn numbers<'a>(&mut self, numbers: impl Iterator<Item = &'a f64>) -> io::Result<()> {
        let mut bytes = Vec::with_capacity(1 << 16);
        for number in numbers {
            bytes.extend_from_slice(&number.to_le_bytes());
            if bytes.len() == 1 << 16 {
                self.write_all(&bytes)?;
                bytes.clear();
            }
        }
        self.write_all(&bytes)
    }
}

fn encode_names(names: &[String]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for name in names {
        bytes.extend_from_slice(&(name.len() as u32).to_le_bytes());
        bytes.extend_from_slice(name.as_bytes());
    }
    bytes
}

fn decode_names(mut bytes: &[u8], count: usize) -> Option<Vec<String>> {
    let mut names = Vec::new();
    for _ in 0..count {
        let (length, rest) = bytes.split_at_checked(4)?;
        let length = u32::from_le_bytes(length.try_into().ok()?) as usize;
        let (name, rest) = rest.split_at_checked(length)?;
        names.push(String::from_utf8(name.to_vec()).ok()?);
        bytes = rest;
    }
    bytes.is_empty().then_some(names)
}

fn corrupt(path: &Path, what: &'static str, expected: &dyn ToString, found: &dyn ToString) -> MomentsError {
    let (path, expected, found) = (path.to_owned(), expected.to_string(), found.to_string());
    MomentsError::Corrupt { path, what, expected, found }
}

/// Reads the header of a file of `length` bytes, and checks its version and hash.
fn read_header(input: &mut dyn Read, length: u64, path: &Path) -> Result<Vec<u8>, MomentsError> {
    let mut header = Vec::new();
    let mut read_to = |end: usize, header: &mut Vec<u8>| {
        if length < (end + HASH) as u64 {
            return Err(corrupt(path, "length", &format!("at least {} bytes", end + HASH), &length));
        }
        let start = header.len();
        header.resize(end, 0);
        input.read_exact(&mut header[start..]).map_err(MomentsError::io(path, "read"))
    };
    read_to(HEADER_LEN_V1, &mut header)?;
    if header[..8] != MAGIC {
        return Err(corrupt(path, "magic number", &MAGIC.escape_ascii(), &header[..8].escape_ascii()));
    }
    let version = header[VERSION_AT..HEADER_LEN_AT].try_into().map_or(0, u32::from_le_bytes);
    if !VERSIONS_READ.contains(&version) {
        return Err(MomentsError::Version { path: path.to_owned(), expected: VERSIONS_READ, found: version });
    }
    if version > 1 {
        read_to(HEADER_LEN, &mut header)?;
    }
    let (fields, hash) = header.split_at(header.len() - HASH);
    if blake3::hash(fields).as_bytes() != hash {
        return Err(corrupt(path, "hash of the header", &"the stored hash", &"a different hash"));
    }
    Ok(header)
}

fn decode(input: &mut dyn Read, length: u64, path: &Path) -> Result<Moments, MomentsError> {
    let corrupt = |what, expected: &dyn ToString, found: &dyn ToString| corrupt(path, what, expected, found);
    let header = read_header(input, length, path)?;
    let fields = &header[..header.len() - HASH];
    let u32_at = |at: usize| fields[at..at + 4].try_into().map_or(0, u32::from_le_bytes);
    let u64_at = |at: usize| fields[at..at + 8].try_into().map_or(0, u64::from_le_bytes);
    let sizes = Sizes {
        max_degree: u32_at(DEGREE_AT) as usize,
        channels: u32_at(CHANNELS_AT) as usize,
        sources: u32_at(SOURCES_AT) as usize,
        names: u32_at(NAMES_AT) as usize,
        cells: u32_at(CELLS_AT) as usize,
    };
    for (what, most, found) in [
        ("degree", MAX_DEGREE, sizes.max_degree),
        ("channels", Moments::MOST_CHANNELS, sizes.channels),
        ("sources", MOST_SOURCES, sizes.sources),
        ("names", LONGEST_NAMES, sizes.names),
        ("cells", 1 << 28, sizes.cells),
    ] {
        if found > most {
            return Err(corrupt(what, &format!("at most {most}"), &found));
        }
    }
    if u32_at(HEADER_LEN_AT) as usize != header.len() {
        return Err(corrupt("header length", &header.len(), &u32_at(HEADER_LEN_AT)));
    }
    if u32_at(CONVENTION_AT) != CONVENTION {
        return Err(corrupt("convention", &CONVENTION, &u32_at(CONVENTION_AT)));
    }
    // Version 1 has no sampling scheme: its reserved bytes start at the offset of the scheme's key.
    let scheme = if u32_at(VERSION_AT) == 1 { None } else { fields[SCHEME_AT..].first_chunk() };
    let reserved = if scheme.is_none() { SCHEME_AT } else { RESERVED_AT };
    let scheme = scheme.copied().filter(|key| *key != [0; 32]).map(SchemeKey);
    if fields[reserved..].iter().any(|&byte| byte != 0) {
        return Err(corrupt("reserved bytes", &"zeros", &"other bytes"));
    }
    if sizes.file_len(header.len()) != length || u64_at(FILE_LEN_AT) != length {
        return Err(corrupt("length", &sizes.file_len(header.len()), &length));
    }
    // The sizes in the header have been checked against the file's length, so this allocation can't exceed the file's
    // size.
    let mut body = Vec::with_capacity(length as usize - header.len());
    input.read_to_end(&mut body).map_err(MomentsError::io(path, "read"))?;
    if body.len() != length as usize - header.len() {
        return Err(corrupt("length", &length, &(body.len() + header.len())));
    }
    let (content, hash) = body.split_at(body.len() - HASH);
    let mut hasher = blake3::Hasher::new();
    if hasher.update(&header).update(content).finalize().as_bytes() != hash {
        return Err(corrupt("hash of the file", &"the stored hash", &"a different hash"));
    }
    let (numbers, rest) = content.split_at(8 * sizes.numbers());
    let (sources, rest) = rest.split_at(SOURCE * sizes.sources);
    let (cells, names) = rest.split_at(sizes.cells);
    let mut numbers = numbers.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes));
    let mut take = |count: usize| -> Vec<f64> { numbers.by_ref().take(count).collect() };
    let (squares, moments) = (take(sizes.channels), take(basis_size(2 * sizes.max_degree)));
    let columns = basis_size(sizes.max_degree);
    let right = take(columns * sizes.channels);
    let right = Array2::from_shape_vec((columns, sizes.channels), right)
        .map_err(|error| corrupt("right-hand sides", &"a matrix", &error))?;
    let weight = f64::from_bits(u64_at(WEIGHT_AT));
    let all = squares.iter().chain(&moments).chain(&right).chain([&weight]);
    if let Some(value) = all.into_iter().find(|value| !value.is_finite()) {
        return Err(corrupt("sums", &"finite numbers", value));
    }
    let sources = sources.as_chunks::<SOURCE>().0.iter().map(|bytes| {
        let (mut key, mut index, mut of, mut rows) = ([0; 32], [0; 4], [0; 4], [0; 8]);
        key.copy_from_slice(&bytes[..32]);
        index.copy_from_slice(&bytes[32..36]);
        of.copy_from_slice(&bytes[36..40]);
        rows.copy_from_slice(&bytes[40..]);
        let shard = Shard { index: u32::from_le_bytes(index), of: u32::from_le_bytes(of) };
        let fits = shard.index < shard.of && shard.of <= MOST_SHARDS;
        fits.then_some(Source { key, shard, rows: u64::from_le_bytes(rows) })
    });
    let sources: Option<Vec<Source>> = sources.collect();
    let sources = sources.ok_or_else(|| {
        let expected = format!("an index below the number of shards, and at most {MOST_SHARDS} shards");
        corrupt("shard", &expected, &"other numbers")
    })?;
    let occupied = Occupied::from_bytes(sizes.max_degree, cells)
        .ok_or_else(|| corrupt("cells", &"one bit per cell, and zeros after the last cell", &"other bytes"))?;
    let channels = decode_names(names, sizes.channels)
        .ok_or_else(|| corrupt("names of the channels", &"one UTF-8 name per channel", &"other bytes"))?;
    let (max_degree, count) = (sizes.max_degree, u64_at(COUNT_AT));
    let sums = SampleSums { max_degree, moments, right_sides: right, squares, weight, count };
    Ok(Moments { channels, sums, rows: u64_at(ROWS_AT), occupied, scheme, sources })
}
