//! Checks that memory suffices for the contents of files before it is allocated.
//!
//! A file states the size of its contents, and the contents of a compressed file may be a thousand times its size.
//! Readers check that size against two bounds before they allocate, and again while they decode: the free memory, if
//! the program has provided a way to query it, and [`most_expanded`], which no genuine file of numbers exceeds.

use std::fmt;
use std::sync::OnceLock;

/// The function that returns the bytes of free memory.
static FREE: OnceLock<fn() -> usize> = OnceLock::new();

/// Amounts below this are allocated without a check.
const SMALL: u64 = 4 << 20;

/// Sets the function by which the readers of this process query the bytes of free memory. Only the first call has an
/// effect; without one, memory is assumed to suffice.
pub fn ask_for_free_memory(free: fn() -> usize) {
    // A second call passes the same function: the program calls this at its start.
    let _ = FREE.set(free);
}

/// Checks that this many bytes of memory are free.
///
/// # Errors
///
/// [`NoRoom`] if they aren't.
pub fn check_room(needed: u64) -> Result<(), NoRoom> {
    if needed < SMALL {
        return Ok(());
    }
    match FREE.get().map(|free| free() as u64) {
        Some(free) if free < needed => Err(NoRoom { needed, free }),
        _ => Ok(()),
    }
}

/// Returns the largest plausible size of the contents of `compressed` bytes: numbers of surfaces and text compress two-
/// to tenfold, constants up to a thousandfold, but files contain few of those.
#[must_use]
pub fn most_expanded(compressed: u64) -> u64 {
    compressed.saturating_mul(256).saturating_add(64 << 20)
}

/// Insufficient memory. Its text gives the bytes needed and free, for the end of a sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub struct NoRoom {
    /// Bytes needed.
    pub needed: u64,
    /// Bytes that are free.
    pub free: u64,
}

impl fmt::Display for NoRoom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of memory, of which {} are free", Bytes(self.needed), Bytes(self.free))
    }
}

/// A size in human-readable form.
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
        assert_eq!(room.to_string(), "2.5 GiB of memory, of which 1.5 MiB are free");
    }

    /// If the program doesn't report free memory, nothing is rejected; the size of decompressed data is still bounded.
    #[test]
    fn expansion_is_bounded() {
        assert_eq!(check_room(u64::MAX), Ok(()));
        assert_eq!(most_expanded(0), 64 << 20);
        assert_eq!(most_expanded(1000), 256_000 + (64 << 20));
        assert_eq!(most_expanded(u64::MAX), u64::MAX);
    }
}
