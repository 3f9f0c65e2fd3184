//! Corrects check sums, lengths and offsets after the fuzzer changed bytes, so that the changes reach the code behind
//! these checks.

use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

const HEADER: usize = 4096;
const FOOTER: usize = 128;
const ENTRY: usize = 64;

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    if let Some(place) = bytes.get_mut(at..at.saturating_add(value.len())) {
        place.copy_from_slice(value);
    }
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..at + 8).map_or(0, |eight| u64::from_le_bytes(eight.try_into().expect("8 bytes")))
}

/// Corrects a basis file or a factor. The bits of `kind` choose what is corrected: 1 the hash of the header, 2 root and
/// hash of the footer, 4 the chunks' CRC and hash, 8 the offsets in the footer, 16 the offsets in the table.
pub(super) fn container(bytes: &[u8], kind: usize, root_context: &str) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if bytes.len() < HEADER + ENTRY + FOOTER {
        return bytes;
    }
    let (len, footer) = (bytes.len(), bytes.len() - FOOTER);
    if kind & 8 != 0 {
        let entries = u64_at(&bytes, footer + 16).clamp(1, ((footer - HEADER) / ENTRY) as u64);
        put(&mut bytes, footer + 8, &(footer as u64 - ENTRY as u64 * entries).to_le_bytes());
        put(&mut bytes, footer + 16, &entries.to_le_bytes());
        put(&mut bytes, footer + 24, &(len as u64).to_le_bytes());
    }
    let table = usize::try_from(u64_at(&bytes, footer + 8)).unwrap_or(0).clamp(HEADER, footer);
    let mut next = HEADER;
    for entry in (table..footer).step_by(ENTRY) {
        if kind & 16 != 0 {
            put(&mut bytes, entry, &(next as u64).to_le_bytes());
        }
        let start = usize::try_from(u64_at(&bytes, entry)).unwrap_or(len).min(len);
        let stored = usize::try_from(u64_at(&bytes, entry + 8)).unwrap_or(len);
        let end = start.saturating_add(stored).min(table.max(start));
        next = end.next_multiple_of(64);
        if kind & 4 != 0 {
            let (crc, hash) = (crc32c::crc32c(&bytes[start..end]), blake3::hash(&bytes[start..end]));
            put(&mut bytes, entry + 24, &crc.to_le_bytes());
            put(&mut bytes, entry + 32, hash.as_bytes());
        }
    }
    if kind & 1 != 0 {
        let hash = blake3::hash(&bytes[..HEADER - 32]);
        put(&mut bytes, HEADER - 32, hash.as_bytes());
    }
    if kind & 2 != 0 {
        let mut root = blake3::Hasher::new_derive_key(root_context);
        root.update(&bytes[..HEADER]).update(&bytes[table..footer]);
        put(&mut bytes, footer + 32, root.finalize().as_bytes());
        let hash = blake3::hash(&bytes[footer..footer + 96]);
        put(&mut bytes, footer + 96, hash.as_bytes());
    }
    bytes
}

/// Corrects a file of moments: its length, the hash of the header and the hash of the file.
pub(super) fn moments(bytes: &mut [u8]) {
    let len = bytes.len();
    // The header's hash follows its fields, of which version 1 has fewer.
    let fields = if bytes.get(8) == Some(&1) { 96 } else { 128 };
    if len < fields + 64 {
        return;
    }
    put(bytes, 16, &(len as u64).to_le_bytes());
    let hash = blake3::hash(&bytes[..fields]);
    put(bytes, fields, hash.as_bytes());
    let hash = blake3::hash(&bytes[..len - 32]);
    put(bytes, len - 32, hash.as_bytes());
}

/// Reads a number of variable length at `at`, and advances `at` past the number.
fn varint(bytes: &[u8], at: &mut usize) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = *bytes.get(*at)?;
        *at += 1;
        value |= u64::from(byte & 127).checked_shl(shift)?;
        if byte < 128 {
            return Some(value);
        }
    }
    None
}

/// Corrects a compressed model: the CRC of the header, and the CRCs of the segments as far as these can be found.
pub(super) fn sphz(bytes: &mut [u8]) {
    let Some(four) = bytes.get(6..10) else { return };
    let head = u32::from_le_bytes(four.try_into().expect("4 bytes")) as usize;
    if head < 14 || head > bytes.len() {
        return;
    }
    segments(bytes, head);
    let crc = crc32c::crc32c(&bytes[..head - 4]);
    put(bytes, head - 4, &crc.to_le_bytes());
}

fn segments(bytes: &mut [u8], head: usize) -> Option<()> {
    let mut at = 10;
    let _degree = varint(bytes, &mut at)?;
    let channels = varint(bytes, &mut at)?;
    let (_top, _guess) = (varint(bytes, &mut at)?, varint(bytes, &mut at)?);
    let steps = if bytes[5] & 1 == 1 { 1 } else { channels };
    at = at.checked_add(2)?.checked_add(usize::try_from(steps).ok()?.checked_mul(8)?)?;
    for _ in 0..channels {
        varint(bytes, &mut at)?;
    }
    let mut start = head;
    for _ in 0..varint(bytes, &mut at)? {
        let _degree = varint(bytes, &mut at)?;
        let end = start.checked_add(usize::try_from(varint(bytes, &mut at)?).ok()?)?;
        let crc = crc32c::crc32c(bytes.get(start..end)?);
        put(bytes, at, &crc.to_le_bytes());
        at += 4;
        start = end;
    }
    Some(())
}

/// Creates an archive of the members in `bytes`. Each member has one byte for its name, two for its length, and then
/// its content.
pub(super) fn archive(mut bytes: &[u8], deflated: bool) -> Vec<u8> {
    const NAMES: [&str; 13] = [
        "coefficients",
        "max_degree",
        "convention",
        "faces",
        "directions",
        "cut_from",
        "seam",
        "scheme_key",
        "provenance",
        "modes",
        "variances",
        "scores",
        "members",
    ];
    let method = if deflated { CompressionMethod::Deflated } else { CompressionMethod::Stored };
    let options = SimpleFileOptions::default().compression_method(method);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let mut there = [false; NAMES.len()];
    while let [name, low, high, rest @ ..] = bytes {
        let (member, rest) = rest.split_at(usize::from(u16::from_le_bytes([*low, *high])).min(rest.len()));
        let name = usize::from(*name) % NAMES.len();
        // The writer refuses a second member with the same name.
        if !std::mem::replace(&mut there[name], true) {
            zip.start_file(format!("{}.npy", NAMES[name]), options).expect("a new member");
            zip.write_all(member).expect("memory");
        }
        bytes = rest;
    }
    zip.finish().expect("an archive").into_inner()
}

/// Creates the journal of a group's alignment from the header `start` and the records' numbers, 192 bytes for each
/// record.
pub(super) fn journal(start: &[u8], numbers: &[u8]) -> Vec<u8> {
    let mut bytes = start.to_vec();
    for (number, record) in numbers.chunks(192).enumerate() {
        let begun = crc32c::crc32c_append(crc32c::crc32c(start), &(number as u64).to_le_bytes());
        bytes.extend(record);
        bytes.extend(crc32c::crc32c_append(begun, record).to_le_bytes());
    }
    bytes
}
