//! Checks, before memory is allocated for a file's contents, that enough memory is free.
//!
//! A file states the size of its contents, and the contents of a compressed file can be a thousand times as large as
//! the file. Before readers allocate memory, and again during decoding, they compare the size of the contents with two
//! bounds. The first bound is the free memory, if the program has provided a function that returns it. The second bound
//! is [`most_expanded`], which no genuine file of numbers exceeds.

use std::fmt;
use std::sync::OnceLock;

/// The function that returns the number of bytes of free memory, if set.
static FREE: OnceLock<fn() -> usize> = OnceLock::new();

/// Number of bytes below which memory is allocated without a check.
const SMALL: u64 = 4 << 20;

/// Sets the function that returns the number of bytes of free memory, for all readers of this process. Only the first
/// call has an effect. If no function is set, memory is assumed to suffice.
pub fn ask_for_free_memory(free: fn() -> usize) {
    // A second call is ignored, because programs call this function once, at their start.
    let _ = FREE.set(free);
}

/// Checks that `needed` bytes of memory are free.
///
/// # Errors
///
/// [`NoRoom`] if less memory is free.
pub fn check_room(needed: u64) -> Result<(), NoRoom> {
    if needed < SMALL {
        return Ok(());
    }
    match FREE.get().map(|free| free() as u64) {
        Some(free) if free < needed => Err(NoRoom { needed, free }),
        _ => Ok(()),
    }
}

/// Returns the largest plausible size of the contents of a compressed file of `compressed` bytes. Text, and the numbers
/// in surface files, are compressed by a factor of two to ten. Constant values can be compressed up to a thousandfold,
/// but files contain few constant values.
#[must_use]
pub fn most_expanded(compressed: u64) -> u64 {
    compressed.saturating_mul(256).saturating_add(64 << 20)
}

/// The error for insufficient memory. Its message states the memory needed and the memory free, worded as the end of a
/// sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub struct NoRoom {
    /// Number of bytes needed.
    pub needed: u64,
    /// Number of bytes free.
    pub free: u64,
}

impl fmt::Display for NoRoom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of memory, but only {} are free", Bytes(self.needed), Bytes(self.free))
    }
}

/// A number of bytes, displayed in human-readable form.
pub(crate) struct Bytes(pub(crate) u64);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 as f64 {
            bytes if self.0 >= 1 << 30 => write!(f, "{:.1} GiB", bytes / f64::from(1 << 30)),
            bytes if self.0 >= 1 << 20 => write!(f, "{:.1} MiB", bytes / f64::from(1 << 20)),
            _ => write!(f, "{} bytes", self.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_shown_as_people_read_them() {
        for (bytes, text) in [
            (0, "0 bytes"),
            ((1 << 20) - 1, "1048575 bytes"),
            (1 << 20, "1.0 MiB"),
            (3 << 19, "1.5 MiB"),
            ((1 << 30) - 1, "1024.0 MiB"),
            (1 << 30, "1.0 GiB"),
            (5 << 29, "2.5 GiB"),
        ] {
            assert_eq!(Bytes(bytes).to_string(), text);
        }
        let room = NoRoom { needed: 5 << 29, free: 3 << 19 };
        assert_eq!(room.to_string(), "2.5 GiB of memory, but only 1.5 MiB are free");
    }

    /// If no function for the free memory is set, every amount of memory is accepted, but the size of decompressed data
    /// is still limited.
    #[test]
    fn expansion_is_bounded() {
        assert_eq!(check_room(u64::MAX), Ok(()));
        assert_eq!(most_expanded(0), 64 << 20);
        assert_eq!(most_expanded(1000), 256_000 + (64 << 20));
        assert_eq!(most_expanded(u64::MAX), u64::MAX);
    }
}
