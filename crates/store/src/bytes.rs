//! Little-endian numbers out of byte arrays.

#[cfg(target_endian = "big")]
compile_error!("the store maps little-endian arrays; a big-endian machine would need a converting reader");

/// The `u32` at an offset. Callers pass offsets inside of arrays of fixed length.
pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut value = [0; 4];
    value.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(value)
}

/// The `u64` at an offset. Callers pass offsets inside of arrays of fixed length.
pub(crate) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut value = [0; 8];
    value.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(value)
}
