//! Checks the sizes declared in the blocks of an Arrow file, before the crate `arrow-ipc` relies on them.
//!
//! The footer lists the file's blocks with their lengths. Each buffer of a compressed block begins with its
//! uncompressed size, and `arrow-ipc` allocates that many bytes. Source: Arrow columnar format, "IPC file format" and
//! "Compression".

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use arrow_ipc::reader::read_footer_length;
use arrow_ipc::{Block, root_as_footer, root_as_message};
use spharm_surface::io::{check_room, most_expanded};

/// Size in bytes of the end of the file: the footer's length and the magic number.
const TAIL: usize = 10;
/// Marker before the length of a message's metadata; files in the format's older version lack it.
const MARK: [u8; 4] = [0xff; 4];
/// Bytes that a buffer may have in addition to one number of 64 bits per row, because Arrow pads buffers.
const PADDING: u64 = 64;
/// Upper bound on the bytes to which one compressed byte can expand. zstd encodes a run of 128 KiB in four bytes, LZ4 a
/// run of 255 bytes in one byte.
const MOST_PER_BYTE: u64 = 1 << 15;
/// Declared uncompressed size of a buffer that isn't compressed although its block is.
const PLAIN: i64 = -1;

/// Checks that all blocks lie within the file of `bytes` bytes, and that the free memory suffices for their
/// uncompressed size.
///
/// # Errors
///
/// Returns a description of the problem.
pub(super) fn check(file: &File, bytes: u64) -> Result<(), String> {
    let failed = |error: io::Error| error.to_string();
    let mut input = BufReader::new(file);
    let tail_at = bytes.checked_sub(TAIL as u64).ok_or("the end of the file")?;
    let tail: [u8; TAIL] = read(&mut input, tail_at, TAIL)?.try_into().map_err(|_| "the end of the file")?;
    let length = read_footer_length(tail).map_err(|error| error.to_string())?;
    let at = tail_at.checked_sub(length as u64).ok_or_else(|| format!("a footer of {length} bytes"))?;
    let footer = read(&mut input, at, length)?;
    let footer = root_as_footer(&footer).map_err(|error| error.to_string())?;
    for block in footer.dictionaries().into_iter().chain(footer.recordBatches()).flatten() {
        let place =
            place(block, bytes).ok_or_else(|| format!("a block at byte {}, outside the file", block.offset()))?;
        check_block(&mut input, &place)?;
    }
    input.seek(SeekFrom::Start(0)).map_err(failed)?;
    Ok(())
}

/// Byte offsets of a block's metadata and buffers, checked to lie within the file.
struct Place {
    start: u64,
    metadata: usize,
    body: u64,
    end: u64,
}

fn place(block: &Block, bytes: u64) -> Option<Place> {
    let (start, metadata) = (u64::try_from(block.offset()).ok()?, u64::try_from(block.metaDataLength()).ok()?);
    let body = start.checked_add(metadata)?;
    let end = body.checked_add(u64::try_from(block.bodyLength()).ok()?)?;
    (end <= bytes).then_some(Place { start, metadata: metadata as usize, body, end })
}

fn check_block(input: &mut BufReader<&File>, place: &Place) -> Result<(), String> {
    let metadata = read(input, place.start, place.metadata)?;
    let message = metadata.strip_prefix(&MARK).unwrap_or(&metadata).get(4..).ok_or("a block without metadata")?;
    let message = root_as_message(message).map_err(|error| error.to_string())?;
    let of_dictionary = message.header_as_dictionary_batch().and_then(|batch| batch.data());
    let Some(batch) = message.header_as_record_batch().or(of_dictionary) else { return Ok(()) };
    let compressed = batch.compression().is_some();
    let rows = u64::try_from(batch.length()).map_err(|_| "a block with a negative number of rows")?;
    let mut all = 0_u64;
    for buffer in batch.buffers().into_iter().flatten() {
        let at = u64::try_from(buffer.offset()).ok().and_then(|offset| place.body.checked_add(offset));
        let length = u64::try_from(buffer.length()).unwrap_or(u64::MAX);
        let at = at.filter(|at| at.checked_add(length).is_some_and(|end| end <= place.end));
        let at = at.ok_or("a buffer outside its block")?;
        if length < 8 || !compressed {
            continue;
        }
        let expanded: [u8; 8] = read(input, at, 8)?.try_into().map_err(|_| "the end of the file")?;
        let expanded = i64::from_le_bytes(expanded);
        if expanded == PLAIN {
            continue;
        }
        let expanded = u64::try_from(expanded).map_err(|_| "a buffer with a negative number of bytes")?;
        // A buffer of equal numbers compresses to almost nothing, so a high ratio is valid. But a valid buffer has at
        // most one number per row.
        let plausible = most_expanded(length).max(rows.saturating_mul(8).saturating_add(PADDING));
        if expanded > plausible.min(length.saturating_mul(MOST_PER_BYTE)) {
            return Err(format!("a buffer that expands from {length} to {expanded} bytes, for {rows} rows"));
        }
        all = all.saturating_add(expanded);
    }
    check_room(all).map_err(|room| format!("a block that needs {room}"))
}

fn read(input: &mut BufReader<&File>, at: u64, length: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    input.seek(SeekFrom::Start(at)).map_err(|error| error.to_string())?;
    input.take(length as u64).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() == length { Ok(bytes) } else { Err("the end of the file".to_owned()) }
}
