//! Reads and writes little-endian numbers in byte arrays.

#[cfg(target_endian = "big")]
compile_error!("the store maps little-endian arrays; big-endian machines are not supported");

/// Returns the `u32` at an offset. Callers must make sure that the array is long enough.
pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut value = [0; 4];
    value.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(value)
}

/// Returns the `u64` at an offset. Callers must make sure that the array is long enough.
pub(crate) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut value = [0; 8];
    value.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(value)
}

/// Returns the 32 bytes of a hash at an offset. Callers must make sure that the array is long enough.
pub(crate) fn hash_at(bytes: &[u8], at: usize) -> [u8; 32] {
    let mut hash = [0; 32];
    hash.copy_from_slice(&bytes[at..at + 32]);
    hash
}

/// Writes a value at an offset.
pub(crate) fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}
