//! Puts large arrays in huge pages, and lets the allocator keep freed memory.
//!
//! A fit allocates and drops arrays of megabytes in every step. Each new page of 4 KiB costs a page fault and must be
//! cleared. Page faults and clearing took a quarter of the time of a small fit. Therefore, [`LargePages`] requests huge
//! pages of 2 MiB for arrays of at least 4 MiB. The operating system grants huge pages if
//! `/sys/kernel/mm/transparent_hugepage/enabled` is `madvise`, the default of most distributions. The memory itself
//! comes from the system's allocator. An array that is only partly used takes at most one huge page more than its used
//! part.
//!
//! A fit also allocates and drops smaller arrays in every step. By default, the allocator returns the pages of freed
//! arrays to the system and later requests new pages. Returning and requesting pages took a third of the time of a
//! least-squares fit of a cortex at degree 100. [`keep_freed`] makes the allocator keep some of the freed pages
//! instead.
//!
//! The allocator and the kernels of OpenBLAS (`kernels.rs`) must be chosen by the program, not by a library. Python's
//! extension module uses [`LargePages`] too, because a Rust allocator in the module allocates only the module's own
//! memory. Only the program calls [`keep_freed`], because this function changes settings of the whole process.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::ffi::OsString;

/// Smallest size in bytes of an array for which huge pages are requested. An array of this size contains at least one
/// complete huge page, whatever the array's address.
const LARGE: usize = 4 << 20;

/// Size of a huge page, in bytes.
const PAGE: usize = 2 << 20;

/// Largest amount of freed memory kept for each thread, in bytes.
const KEPT: usize = 128 << 20;

/// Size in bytes below which arrays are allocated from glibc's heaps. glibc can keep freed memory only in its heaps.
const LARGEST: usize = 32 << 20;

/// Makes the allocator keep freed memory at the end of each thread's heap, instead of returning it to the system. The
/// threads share a sixteenth of the free memory equally, but each thread keeps at most 128 MiB. Does nothing if a
/// thread's share is less than what the allocator keeps by default, if the user has set a memory budget, or if the user
/// has configured the allocator. Verbs with a small default budget need no exception, because they free less memory
/// than the allocator keeps.
pub fn keep_freed(mut arguments: impl Iterator<Item = OsString>) {
    let limited = arguments.any(|argument| argument.as_encoded_bytes().starts_with(b"--memory"));
    let set_up = ["GLIBC_TUNABLES", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"];
    if limited || set_up.iter().any(|name| std::env::var_os(name).is_some()) {
        return;
    }
    let threads = std::thread::available_parallelism().map_or(1, |threads| threads.get());
    let kept = (spharm::machine::available_memory() / 16 / (threads + 1)).min(KEPT);
    // By default, glibc keeps twice the size of the largest array returned to the system.
    if kept < 2 * LARGEST {
        return;
    }
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, LARGEST), (libc::M_TRIM_THRESHOLD, kept)] {
        // SAFETY: sets a parameter of the allocator, which validates it.
        unsafe { libc::mallopt(parameter, bytes as libc::c_int) };
    }
}

/// The system's allocator, with huge pages for large arrays.
#[derive(Debug, Clone, Copy)]
pub struct LargePages;

/// Requests huge pages for the whole pages inside an array of `bytes` bytes, and returns the array. A request that the
/// system doesn't grant has no effect.
fn advised(array: *mut u8, bytes: usize) -> *mut u8 {
    if bytes < LARGE || array.is_null() {
        return array;
    }
    let before = array.align_offset(PAGE);
    let within = bytes.saturating_sub(before) / PAGE * PAGE;
    if within > 0 {
        // SAFETY: the range lies within an array of this program; the advice doesn't change its contents.
        unsafe { libc::madvise(array.wrapping_add(before).cast(), within, libc::MADV_HUGEPAGE) };
    }
    array
}

// SAFETY: all calls are forwarded unchanged to the system allocator.
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the method of `System` has the same contract, which the caller upholds.
        advised(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the method of `System` has the same contract, which the caller upholds.
        advised(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn dealloc(&self, array: *mut u8, layout: Layout) {
        // SAFETY: the method of `System` has the same contract, which the caller upholds; `System` allocated the array.
        unsafe { System.dealloc(array, layout) };
    }

    unsafe fn realloc(&self, array: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        // SAFETY: the method of `System` has the same contract, which the caller upholds; `System` allocated the array.
        advised(unsafe { System.realloc(array, layout, bytes) }, bytes)
    }
}
