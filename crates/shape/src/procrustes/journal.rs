//! Saves the progress of a group's alignment in a file, from which an interrupted run resumes.
//!
//! An alignment computes a sequence of poses, one for every member in each round. Each pose follows from the
//! preceding poses, so only the poses have to be saved. The file consists of a header of 64 bytes, which identifies
//! the alignment, and a record for each pose in order of computation. All numbers are little-endian.
//!
//! | bytes | contents |
//! |---|---|
//! | 0..16 | `spharm group 1\r\n` |
//! | 16..48 | BLAKE3 of the members and settings |
//! | 48..64 | zero |
//! | 196 each | record of a pose |
//!
//! A record has 24 f64 values: the rotation of the parameters and the orthogonal matrix that is applied in space (9
//! values each, row by row), the distance, the stiffness, 3 singular values, and a flag that is 1 if directions are
//! replaced by their opposites, otherwise 0. The values are followed by the CRC32C of the header, the record's index
//! and the values.
//!
//! A run that is interrupted while writing leaves an incomplete record. A power failure may leave blocks that were
//! never written. Therefore everything after the last valid record is discarded and recomputed.

use std::fs::{File, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use spharm_harmonics::Coefficients;

use super::ProcrustesParams;
use crate::error::ShapeError;
use crate::group::Pose;
use crate::matrix3::Matrix3;
use crate::refine::Fit;
use crate::rotation::Rotation;

const MAGIC: &[u8; 16] = b"spharm group 1\r\n";
const HEADER: usize = 64;
const NUMBERS: usize = 24;
const RECORD: usize = 8 * NUMBERS + 4;

/// The journal of a group's alignment.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    header: [u8; HEADER],
    /// Poses from an earlier run that haven't been used yet, in reverse order.
    found: Vec<Pose>,
    /// Number of poses that this run has taken from the journal or added to it so far.
    number: u64,
}

impl Journal {
    /// Opens or creates the journal of an alignment of these members with these settings. Only one process at a time
    /// can open the journal.
    ///
    /// # Errors
    ///
    /// [`ShapeError::OtherJournal`] if the file isn't a journal, or belongs to other members or settings;
    /// [`ShapeError::JournalInUse`] if another process has the file open; [`ShapeError::Journal`] if the file can't be
    /// read or written.
    pub fn open(path: &Path, members: &[Coefficients], params: &ProcrustesParams) -> Result<Self, ShapeError> {
        let failed = |cause| ShapeError::Journal { path: path.to_owned(), cause };
        let options = File::options().read(true).write(true).create(true).truncate(false).clone();
        let mut file = spharm_files::open_with(path, &options).map_err(failed)?;
        match file.try_lock() {
            // On file systems without locks, a second process can't be excluded.
            Ok(()) | Err(TryLockError::Error(_)) => {}
            Err(TryLockError::WouldBlock) => return Err(ShapeError::JournalInUse { path: path.to_owned() }),
        }
        let header = header(members, params);
        let length = file.metadata().map_err(failed)?.len();
        let mut start = Vec::new();
        (&mut file).take(HEADER as u64).read_to_end(&mut start).map_err(failed)?;
        if start.len() < HEADER && header.starts_with(&start) {
            // The file is new, or writing was interrupted before the header was complete.
            file.set_len(0).and_then(|()| file.seek(SeekFrom::Start(0))).map_err(failed)?;
            // The header is synced before any pose is written. A power failure may then lose records, but not the
            // header that identifies them.
            file.write_all(&header).and_then(|()| file.sync_data()).map_err(failed)?;
            return Ok(Self { path: path.to_owned(), file, header, found: Vec::new(), number: 0 });
        }
        if start != header {
            return Err(ShapeError::OtherJournal { path: path.to_owned(), is_one: start.starts_with(MAGIC) });
        }
        let records = (length - HEADER as u64) / RECORD as u64;
        let mut found = Vec::new();
        let mut reader = io::BufReader::new(&file);
        let mut record = [0; RECORD];
        for number in 0..records {
            reader.read_exact(&mut record).map_err(failed)?;
            let Some(pose) = decoded(&record, &header, number) else { break };
            found.push(pose);
        }
        let end = (HEADER + RECORD * found.len()) as u64;
        file.set_len(end).and_then(|()| file.seek(SeekFrom::Start(end))).map_err(failed)?;
        found.reverse();
        Ok(Self { path: path.to_owned(), file, header, found, number: 0 })
    }

    /// Returns the number of poses from an earlier run that haven't been used yet.
    #[must_use]
    pub fn found(&self) -> usize {
        self.found.len()
    }

    /// Removes the next poses from an earlier run from the journal, at most `count`, and returns them.
    pub(super) fn take(&mut self, count: usize) -> Vec<Pose> {
        let rest = self.found.len().saturating_sub(count);
        let mut taken = self.found.split_off(rest);
        taken.reverse();
        self.number += taken.len() as u64;
        taken
    }

    /// Appends poses to the file, after the poses that this run has already taken from it or added to it.
    pub(super) fn add(&mut self, poses: &[Pose]) -> Result<(), ShapeError> {
        let mut bytes = Vec::with_capacity(RECORD * poses.len());
        for pose in poses {
            encode(pose, &self.header, self.number, &mut bytes);
            self.number += 1;
        }
        self.file.write_all(&bytes).map_err(|cause| ShapeError::Journal { path: self.path.clone(), cause })
    }
}

/// Returns the header, which identifies the alignment: any change of the members, the settings or the program's version
/// changes it.
fn header(members: &[Coefficients], params: &ProcrustesParams) -> [u8; HEADER] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
    hasher.update(format!("{params:?} {}", members.len()).as_bytes());
    for member in members {
        hasher.update(&(member.max_degree() as u64).to_le_bytes());
        member.values().iter().for_each(|value| {
            hasher.update(&value.to_le_bytes());
        });
    }
    let mut header = [0; HEADER];
    header[..16].copy_from_slice(MAGIC);
    header[16..48].copy_from_slice(hasher.finalize().as_bytes());
    header
}

fn checksum(numbers: &[u8], header: &[u8; HEADER], number: u64) -> [u8; 4] {
    crc32c::crc32c_append(crc32c::crc32c_append(crc32c::crc32c(header), &number.to_le_bytes()), numbers).to_le_bytes()
}

fn encode(pose: &Pose, header: &[u8; HEADER], number: u64, out: &mut Vec<u8>) {
    let Pose { fit, antipodal } = pose;
    let start = out.len();
    let (rotation, object) = (fit.rotation.matrix(), fit.orthogonal);
    let numbers = rotation.as_flattened().iter().chain(object.as_flattened());
    let numbers = numbers.chain([&fit.distance, &fit.stiffness]).chain(&fit.singular_values);
    numbers.chain([&f64::from(u8::from(*antipodal))]).for_each(|number| out.extend(number.to_le_bytes()));
    let checksum = checksum(&out[start..], header, number);
    out.extend(checksum);
}

/// Returns the pose that a record contains, or `None` if the record is invalid.
fn decoded(record: &[u8; RECORD], header: &[u8; HEADER], number: u64) -> Option<Pose> {
    let (numbers, found) = record.split_at(8 * NUMBERS);
    if checksum(numbers, header, number) != found {
        return None;
    }
    let mut values = numbers.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes));
    let mut next = || values.next().filter(|value| value.is_finite());
    let mut matrix = || -> Option<Matrix3> {
        let mut matrix = Matrix3::default();
        for value in matrix.as_flattened_mut() {
            *value = next()?;
        }
        Some(matrix)
    };
    let (rotation, orthogonal) = (matrix()?, matrix()?);
    // `from_matrix` serves only as validation, because its result is the nearest orthogonal matrix, which may differ
    // from the stored one in some bits.
    Rotation::from_matrix(rotation).ok()?;
    let (distance, stiffness) = (next()?, next()?);
    let singular_values = [next()?, next()?, next()?];
    let antipodal = next()? != 0.0;
    let rotation = Rotation::of_orthogonal(rotation);
    Some(Pose { fit: Fit { rotation, orthogonal, distance, stiffness, singular_values }, antipodal })
}

#[cfg(test)]
mod tests;
