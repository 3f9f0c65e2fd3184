//! Large arrays in large pages, and freed memory for what comes next.
//!
//! A fit makes and drops arrays of megabytes in every step, and each page of 4 KiB that is new to the program is a
//! fault and has to be cleared: a quarter of the time of a small fit. So arrays from [`LARGE`] bytes on ask for pages
//! of 2 MiB, where the system grants them on request (`/sys/kernel/mm/transparent_hugepage/enabled`: `madvise`, the
//! default of most distributions). Memory is that of the system's allocator; an array that is touched in part takes at
//! most the rest of a page more.
//!
//! Arrays below that come and go in every step as well. The allocator would give their pages back to the system and
//! take others, which made a third of the time of a least-squares fit of a cortex at degree 100: [`keep_freed`] lets it
//! keep some.
//!
//! That is for programs to choose, not for libraries, as are OpenBLAS's kernels.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::ffi::OsString;

/// Bytes from which on an array asks for large pages: it has one of them wholly, wherever it begins.
const LARGE: usize = 4 << 20;

/// A large page.
const PAGE: usize = 2 << 20;

/// Most bytes that are kept when they are freed, for each thread.
const KEPT: usize = 128 << 20;

/// The largest array that glibc takes from what it keeps.
const LARGEST: usize = 32 << 20;

/// Lets the allocator keep freed memory, at the end of what each thread has: a sixteenth of what is free, shared among
/// the threads, at most [`KEPT`] for each. Not where that is less than it keeps of itself, where the user has said how
/// much memory may be used, or has set the allocator up. Verbs whose budget is small by default are not told apart:
/// they take less than it.
pub(crate) fn keep_freed(mut arguments: impl Iterator<Item = OsString>) {
    let limited = arguments.any(|argument| argument.as_encoded_bytes().starts_with(b"--memory"));
    let set_up = ["GLIBC_TUNABLES", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"];
    if limited || set_up.iter().any(|name| std::env::var_os(name).is_some()) {
        return;
    }
    let threads = std::thread::available_parallelism().map_or(1, |threads| threads.get());
    let kept = (spharm::machine::available_memory() / 16 / (threads + 1)).min(KEPT);
    // Left alone it keeps twice the largest array that it has given back to the system.
    if kept < 2 * LARGEST {
        return;
    }
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, LARGEST), (libc::M_TRIM_THRESHOLD, kept)] {
        // SAFETY: it sets a number of the allocator's, which it checks.
        unsafe { libc::mallopt(parameter, bytes as libc::c_int) };
    }
}

struct LargePages;

#[global_allocator]
static ALLOCATOR: LargePages = LargePages;

/// Asks for large pages within an array, and returns it. What the system doesn't grant changes nothing.
fn advised(array: *mut u8, bytes: usize) -> *mut u8 {
    if bytes < LARGE || array.is_null() {
        return array;
    }
    let before = array.align_offset(PAGE);
    let within = bytes.saturating_sub(before) / PAGE * PAGE;
    if within > 0 {
        // SAFETY: the range lies within the array, which is this program's; the advice doesn't change what is in it.
        unsafe { libc::madvise(array.wrapping_add(before).cast(), within, libc::MADV_HUGEPAGE) };
    }
    array
}

// SAFETY: all memory is the system allocator's, which is given what this is given.
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises are those of `System`.
        advised(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        advised(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn dealloc(&self, array: *mut u8, layout: Layout) {
        // SAFETY: as above; the array is one of `System`'s.
        unsafe { System.dealloc(array, layout) };
    }

    unsafe fn realloc(&self, array: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        // SAFETY: as above.
        advised(unsafe { System.realloc(array, layout, bytes) }, bytes)
    }
}
