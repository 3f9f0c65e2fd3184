//! Lists the blocks of an Arrow file, and checks the sizes declared in the file before the crate `arrow-ipc` relies on
//! these sizes.
//!
//! The footer lists the file's blocks with their lengths. Each buffer of a compressed block begins with its
//! uncompressed size, and `arrow-ipc` allocates that many bytes. Source: Arrow columnar format, "IPC file format" and
//! "Compression".

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::read_footer_length;
use arrow_ipc::{Block, MetadataVersion, root_as_footer, root_as_message};
use arrow_schema::SchemaRef;
use spharm_surface::io::{check_room, most_expanded};

/// Number of bytes at the end of the file, which contain the footer's length and the magic number.
const TAIL: usize = 10;
/// Marker before the length of a message's metadata; files in an older version of the format lack it.
const MARK: [u8; 4] = [0xff; 4];
/// Number of bytes that a buffer may have in addition to 8 per row, because Arrow pads buffers.
const PADDING: u64 = 64;
/// Upper bound on the bytes to which one compressed byte can expand. zstd encodes a run of 128 KiB in four bytes, LZ4 a
/// run of 255 bytes in one byte.
const MOST_PER_BYTE: u64 = 1 << 15;
/// Value that takes the place of the uncompressed size in front of a buffer that isn't compressed, although its block
/// is.
const PLAIN: i64 = -1;

/// The columns of an Arrow file, and its blocks of rows.
pub(super) struct Contents {
    pub(super) schema: SchemaRef,
    pub(super) version: MetadataVersion,
    /// The blocks in the order of the file, with their numbers of rows.
    pub(super) blocks: Vec<(Block, u64)>,
}

/// Reads the footer of a file of `bytes` bytes. Checks that all blocks lie within the file, and that enough memory is
/// free to decompress each block.
///
/// # Errors
///
/// Returns a description of the problem.
pub(super) fn contents(file: &File, bytes: u64) -> Result<Contents, String> {
    let mut input = BufReader::new(file);
    let tail_at = bytes.checked_sub(TAIL as u64).ok_or("the end of the file")?;
    let tail: [u8; TAIL] = read(&mut input, tail_at, TAIL)?.try_into().map_err(|_| "the end of the file")?;
    let length = read_footer_length(tail).map_err(|error| error.to_string())?;
    let at = tail_at
        .checked_sub(length as u64)
        .ok_or_else(|| format!("a footer of {length} bytes, longer than the file"))?;
    let footer = read(&mut input, at, length)?;
    let footer = root_as_footer(&footer).map_err(|error| error.to_string())?;
    let schema = footer.schema().ok_or("a footer without columns")?;
    if !schema.endianness().equals_to_target_endianness() {
        return Err("numbers whose byte order (endianness) isn't this processor's".to_owned());
    }
    let schema = try_fb_to_schema(schema).map_err(|error| error.to_string())?;
    let mut blocks = Vec::new();
    for block in footer.recordBatches().into_iter().flatten() {
        let place =
            place(block, bytes).ok_or_else(|| format!("a block at byte {}, outside the file", block.offset()))?;
        blocks.push((*block, check_block(&mut input, &place)?));
    }
    Ok(Contents { schema: Arc::new(schema), version: footer.version(), blocks })
}

/// Reads the metadata and buffers of a block.
///
/// # Errors
///
/// Returns a description of the problem.
pub(super) fn read_block(file: &File, block: &Block) -> Result<Vec<u8>, String> {
    let place = place(block, u64::MAX).ok_or("a block outside the file")?;
    let length = usize::try_from(place.end - place.start).map_err(|_| "a block that is too large")?;
    read(&mut BufReader::new(file), place.start, length)
}

/// Byte offsets of a block's metadata and buffers, which have been checked to lie within the file.
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

/// Checks a block of rows, and returns the number of rows.
fn check_block(input: &mut BufReader<&File>, place: &Place) -> Result<u64, String> {
    let metadata = read(input, place.start, place.metadata)?;
    let message = metadata.strip_prefix(&MARK).unwrap_or(&metadata).get(4..).ok_or("a block without metadata")?;
    let message = root_as_message(message).map_err(|error| error.to_string())?;
    let batch = message.header_as_record_batch().ok_or("a block without rows")?;
    let compressed = batch.compression().is_some();
    let rows = u64::try_from(batch.length()).map_err(|_| "a block with a negative number of rows")?;
    // Memory is needed for the bytes of the block, and for its compressed buffers after expansion.
    let mut all = place.end - place.start;
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
        // A buffer of equal numbers compresses to almost nothing, so a high ratio is valid if the buffer isn't too
        // large for one number per row.
        let plausible = most_expanded(length).max(rows.saturating_mul(8).saturating_add(PADDING));
        if expanded > plausible.min(length.saturating_mul(MOST_PER_BYTE)) {
            return Err(format!("a buffer that expands from {length} to {expanded} bytes, too many for {rows} rows"));
        }
        all = all.saturating_add(expanded);
    }
    check_room(all).map_err(|room| format!("a block that needs {room}"))?;
    Ok(rows)
}

fn read(input: &mut BufReader<&File>, at: u64, length: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(length);
    input.seek(SeekFrom::Start(at)).map_err(|error| error.to_string())?;
    input.take(length as u64).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() == length { Ok(bytes) } else { Err("the end of the file".to_owned()) }
}
