//! Provides read-only windows on files: memory maps that detect changed and missing data.
//!
//! A memory map has two risks that reading with system calls doesn't have. First, the file may change while it is
//! mapped. Second, the file may lack a page that is accessed, because it was truncated or the disk failed. On Unix, a
//! `FaultGuard` (`platform`) lets the process survive access to a missing page. On Windows, other processes can't write
//! to or truncate a file while the store has it open. However, the process ends if the disk fails while a file is
//! mapped.
//!
//! After a window has been used, [`Window::check`] returns an error if a page was missing or if the file's size or
//! modification time has changed. Results computed from a window are valid only if this check then returns no error.
//!
//! A window gives access only to types for which every bit pattern is valid: bytes, integers and floating-point
//! numbers. If a file changes while it is mapped, the values may be wrong, but reading them is never undefined
//! behaviour. The check then rejects these values.

#![allow(unsafe_code)]

use std::io;

use memmap2::{Mmap, MmapOptions};

use crate::error::StoreError;
use crate::platform::{self, FaultGuard};
use crate::source::Source;

/// A range of a file's bytes, mapped read-only.
#[derive(Debug)]
pub(crate) struct Window {
    // Fields are dropped in this order: the guard before the map.
    guard: FaultGuard,
    map: Mmap,
}

impl Window {
    /// Maps `len > 0` bytes starting at `offset`, which need not be page-aligned.
    pub(crate) fn new(source: &Source, offset: u64, len: usize) -> Result<Self, StoreError> {
        // SAFETY: the map is read-only and private to this type. The file may change or shrink while it is mapped. The
        // documentation of this module describes how this case is handled: bytes are only read as plain numbers, and
        // `check` rejects the values read.
        let map = unsafe { MmapOptions::new().offset(offset).len(len).map(source.file()) }
            .map_err(StoreError::io(source.path(), "cannot map the file into memory"))?;
        let start = map.as_ptr() as usize;
        let guard = FaultGuard::new(start, start + len).ok_or_else(|| {
            let reason = "too many file ranges are mapped at the same time";
            StoreError::io(source.path(), "cannot map the file into memory")(io::Error::other(reason))
        })?;
        Ok(Self { guard, map })
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Asks the system to start reading a range of the window from disk. The request is only a hint, so a failure is
    /// ignored.
    pub(crate) fn will_need(&self, offset: usize, len: usize) {
        platform::map_will_need(&self.map, offset, len);
    }

    /// Maps all pages of a range with one system call, which costs less than one page fault per page. The request is
    /// only a hint, so a failure is ignored.
    pub(crate) fn populate(&self, offset: usize, len: usize) {
        platform::populate_map(&self.map, offset, len);
    }

    /// Returns an error if a page was missing when it was accessed, or if the file has changed since it was opened.
    pub(crate) fn check(&self, source: &Source) -> Result<(), StoreError> {
        if self.guard.faulted() {
            return Err(StoreError::ChangedWhileRead { path: source.path().to_path_buf() });
        }
        source.check()
    }
}

/// Prefetches a range of memory into the L2 cache. The range has the size of `values` and starts `ahead` bytes after
/// the beginning of `values`. This is useful because the processor's own prefetcher stops at page boundaries. The range
/// need not be mapped, because a prefetch is only a hint.
#[inline(always)]
pub fn prefetch<T>(values: &[T], ahead: isize) {
    #[cfg(target_arch = "x86_64")]
    {
        const LINE: usize = 64;
        let start = values.as_ptr().cast::<i8>().wrapping_offset(ahead);
        for at in (0..size_of_val(values)).step_by(LINE) {
            // SAFETY: a prefetch has no effect that the program could observe, and it never faults, whatever the
            // address; SSE is part of every x86-64.
            unsafe { std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T1 }>(start.wrapping_add(at)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, ahead);
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_file_truncated_under_a_window_reads_as_zeros_and_is_reported() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let len = 64 * 4096;
        std::fs::write(file.path(), vec![7u8; len]).unwrap();
        let source = Source::open(file.path()).unwrap();
        let window = Window::new(&source, 0, len).unwrap();
        assert_eq!(window.bytes()[len - 1], 7);
        window.check(&source).unwrap();
        file.as_file().set_len(4096).unwrap();
        let sum: u64 = window.bytes().iter().map(|&b| u64::from(b)).sum();
        assert_eq!(sum, 7 * 4096);
        assert!(window.guard.faulted());
        assert!(matches!(window.check(&source), Err(StoreError::ChangedWhileRead { .. })));
    }

    #[test]
    fn a_file_written_to_is_reported() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), [7u8; 4096]).unwrap();
        let source = Source::open(file.path()).unwrap();
        let window = Window::new(&source, 0, 4096).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20));
        std::fs::write(file.path(), [8u8; 4096]).unwrap();
        assert!(window.check(&source).is_err());
    }
}
