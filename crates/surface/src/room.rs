//! Room in memory for what files hold, asked for before it is taken.
//!
//! A file says how much it holds, and a compressed one may hold a thousand times its size. Readers hold both against
//! two bounds before they allocate, and again while they decode: what is free, if the program has said how to find out,
//! and [`most_expanded`], beyond which no honest file of numbers swells.

use std::fmt;
use std::sync::OnceLock;

/// Returns the bytes of memory that are free.
static FREE: OnceLock<fn() -> usize> = OnceLock::new();

/// Less than this is taken without asking.
const SMALL: u64 = 4 << 20;

/// Tells the readers of this process how to ask for the bytes of memory that are free. The first call counts; without
/// one, nothing is known to be scarce.
pub fn ask_for_free_memory(free: fn() -> usize) {
    // A second call says the same: it is the program's, at its start.
    let _ = FREE.set(free);
}

/// Checks that bytes of memory are free.
///
/// # Errors
///
/// [`NoRoom`] where they aren't.
pub fn check_room(needed: u64) -> Result<(), NoRoom> {
    if needed < SMALL {
        return Ok(());
    }
    match FREE.get().map(|free| free() as u64) {
        Some(free) if free < needed => Err(NoRoom { needed, free }),
        _ => Ok(()),
    }
}

/// Most bytes that compressed ones may stand for: numbers of surfaces and text compress two- to tenfold, constants up
/// to a thousandfold, of which there aren't many.
#[must_use]
pub fn most_expanded(compressed: u64) -> u64 {
    compressed.saturating_mul(256).saturating_add(64 << 20)
}

/// Memory that isn't there. As text: what is needed and what is free, for the end of a sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub struct NoRoom {
    /// Bytes that would be taken.
    pub needed: u64,
    /// Bytes that are free.
    pub free: u64,
}

impl fmt::Display for NoRoom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of memory, of which {} are free", Bytes(self.needed), Bytes(self.free))
    }
}

/// A size as people read it.
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

    /// Without a program that says what is free nothing is refused; what compressed bytes may stand for is bounded all
    /// the same.
    #[test]
    fn expansion_is_bounded() {
        assert_eq!(check_room(u64::MAX), Ok(()));
        assert_eq!(most_expanded(0), 64 << 20);
        assert_eq!(most_expanded(1000), 256_000 + (64 << 20));
        assert_eq!(most_expanded(u64::MAX), u64::MAX);
    }
}
